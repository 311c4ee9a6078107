"""A task of one's own."""

import gymnasium
import numpy as np

BOX = gymnasium.spaces.Box


class Arm(gymnasium.Env):
    """A task of one's own, five steps long; the observation is the last action."""

    def __init__(self, observations=None, actions=None, mass=1.0):
        self.observation_space = observations or BOX(-9, 9, (2,))
        self.action_space = actions or BOX(np.float32([-2, 0]), np.float32([4, 1]))
        self.mass = mass

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.np_random.uniform(-1, 1, 2).astype(np.float32), {}

    def step(self, action):
        return np.float32(action) / np.float32(self.mass), float(action.sum()), False, False, {}


class Noisy(Arm):
    """An arm whose steps draw from outside `np_random`, so that no episode can be played again."""

    def step(self, action):
        obs, *rest = super().step(action)
        return obs + np.float32(np.random.normal()), *rest  # noqa: NPY002


class Goal(Arm):
    """An arm whose observations are dictionaries, one part of them discrete."""

    def __init__(self):
        super().__init__()
        self.observation_space = gymnasium.spaces.Dict(
            {"b": BOX(-9, 9, (1,)), "a": BOX(-9, 9, (1,)), "c": gymnasium.spaces.Discrete(3)}
        )

    def reset(self, *, seed=None, options=None):
        obs, info = super().reset(seed=seed)
        return as_parts(obs), info

    def step(self, action):
        obs, *rest = super().step(action)
        return as_parts(obs), *rest


def as_parts(obs):
    """The dictionary, or dictionaries, of observations (..., 2)."""
    a, b = np.split(np.float32(obs), 2, -1)
    return {"b": b, "c": np.int64(a[..., 0] > 0), "a": a}


def scaled():
    """An arm whose observations depend on all those before, of earlier episodes as well."""
    return gymnasium.wrappers.NormalizeObservation(Arm())
