"""Members of any Gymnasium task, stepped one after another."""

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from copy import deepcopy

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.wrappers.vector import RescaleAction

from offairl_lite.envs.batched import (
    Step,
    generator_words,
    member_seeds,
    require_episodes,
    require_layout,
    reset_mask,
    set_generator_words,
)


class TaskError(RuntimeError):
    """A task's own code has failed; the exception's cause shows where."""


@contextmanager
def own_code(task: str, what: str) -> Iterator[None]:
    """Turn an exception of a task's own code into a TaskError.

    Gymnasium's errors and failed imports pass unchanged: their messages say what to do.
    """
    try:
        yield
    except (gymnasium.error.Error, ImportError):
        raise
    except Exception as error:
        why = f"{type(error).__name__}: {error}"
        raise TaskError(f"{task} has failed in its {what}, {why}") from error


class BoundedAction(RescaleAction):
    """Gymnasium's `RescaleAction`, whose rounding never leaves the bounds of the task."""

    def actions(self, actions: np.ndarray) -> np.ndarray:
        """Return the actions in the units of the task."""
        space = self.env.action_space
        return np.clip(super().actions(actions), space.low, space.high)


class SerialEnv(VectorWrapper):
    """Gymnasium's `SyncVectorEnv` with the seeds and the saved state of a `BatchedEnv`.

    The variables inside a member are unknown. Its state is therefore the state of its random
    generator before the reset, and the actions since then; it is restored by playing the episode
    again. Actions are converted to the type of the action space.

    Args:
        env: a new `SyncVectorEnv` in mode `DISABLED`, or a `BoundedAction` around one.
        seeds: one seed per member, for its first reset.
    """

    def __init__(self, env: VectorEnv, seeds: Sequence[int]):
        super().__init__(env)
        self._members = env.unwrapped.envs
        self._rescaled = env.actions if isinstance(env, BoundedAction) else np.copy
        self._seeds = member_seeds(seeds, env.num_envs)
        self._starts = [seeding.np_random(seed)[0] for seed in self._seeds]
        self._observations = np.zeros_like(env.observation_space.low)
        self._actions = []  # As many as the longest episode has steps.
        self._clock = np.zeros(env.num_envs, np.int64)
        self._idle = np.ones(env.num_envs, bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict | None = None
    ) -> tuple[np.ndarray, dict]:
        """Start new episodes, as `BatchedEnv.reset`; TaskError if the task itself fails."""
        mask = reset_mask(options, self.num_envs)
        seeds = member_seeds(seed, self.num_envs)
        seeds = [b if a is None else a for a, b in zip(seeds, self._seeds, strict=True)]
        starts = {
            i: deepcopy(self._members[i].unwrapped.np_random)
            if seeds[i] is None
            else seeding.np_random(seeds[i])[0]
            for i in np.flatnonzero(mask)
        }
        # Gymnasium removes the mask from the options, so it gets a copy.
        with self._own("reset"):
            observations, info = self.env.reset(seed=seeds, options=options and dict(options))
        observations[~mask] = self._observations[~mask]
        self._observations = observations.copy()
        self._clock[mask], self._idle[mask] = 0, False
        del self._actions[: len(self._actions) - self._clock.max()]
        for i, start in starts.items():
            self._seeds[i], self._starts[i] = None, start
        return observations, info

    def step(self, actions: np.ndarray) -> Step:
        """Advance every member by one step.

        Raises:
            RuntimeError: a member has no episode in progress.
            TaskError: the task's own code has failed.
        """
        require_episodes(self._idle)
        actions = np.array(actions, self.action_space.dtype)
        with self._own("step"):
            observations, rewards, terminated, truncated, info = self.env.step(actions.copy())
        self._actions.append(actions)
        self._clock += 1
        self._observations, self._idle = observations.copy(), terminated | truncated
        return observations, rewards, terminated, truncated, info

    def _own(self, what: str) -> AbstractContextManager[None]:
        return own_code(str(self.unwrapped), what)

    def get_state(self) -> dict[str, np.ndarray]:
        """Return everything that later steps depend on, as arrays for `set_state`.

        The episode of a member has the last `clock` rows of `actions`.

        Raises:
            ValueError: a member's `np_random` is not a PCG64 generator.
        """
        new = self._idle & (self._clock == 0)
        generators = [
            start if never_reset else member.unwrapped.np_random
            for member, start, never_reset in zip(self._members, self._starts, new, strict=True)
        ]
        actions = np.array(self._actions, self.action_space.dtype)
        return {
            "starts": generator_words(self._starts, self.unwrapped),
            "actions": actions.reshape(-1, *self.action_space.shape),
            "clock": self._clock.copy(),
            "idle": self._idle.copy(),
            "observations": self._observations.copy(),
            "generators": generator_words(generators, self.unwrapped),
        }

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Continue exactly from a state that `get_state` returned, here or in another environment.

        Raises:
            ValueError: the state is of another task or number of members; or the episodes come out
                differently when they are played again, and the environment must then be reset.
        """
        like = self.get_state()
        steps = np.shape(state.get("actions"))[:1]
        like["actions"] = np.empty((*steps, *self.action_space.shape), self.action_space.dtype)
        require_layout(state, like)

        generators = [member.unwrapped.np_random for member in self._members]
        set_generator_words(generators, state["starts"])
        self._seeds, self._starts = [None] * self.num_envs, deepcopy(generators)
        # All members, since `SyncVectorEnv` cannot reset a few before it has reset all.
        with self._own("reset"):
            first, _ = self.env.reset()
        new = state["idle"] & (state["clock"] == 0)
        for i in np.flatnonzero(new):
            set_generator_words([self._members[i].unwrapped.np_random], state["starts"][[i]])
        self._observations = np.where(new[:, None], state["observations"], first)
        self._actions = list(state["actions"].copy())
        self._clock, self._idle = state["clock"].copy(), new
        with self._own("step"):
            self._play()

        again = self.get_state()
        wrong = [k for k in state if not np.array_equal(again[k], state[k], equal_nan=True)]
        if wrong:
            raise ValueError(
                f"{self.unwrapped}: {', '.join(wrong)} came out differently when the episodes were "
                "played again; expected a task whose episodes depend only on the actions and on "
                "np_random as it was before the reset"
            )

    def _play(self) -> None:
        """Play the episodes again, from their starts."""
        for left, actions in zip(range(len(self._actions), 0, -1), self._actions, strict=True):
            played = self._rescaled(actions)
            # Episodes have different lengths, and `SyncVectorEnv` would step all members.
            for i in np.flatnonzero(self._clock >= left):
                observation, _, terminated, truncated, _ = self._members[i].step(played[i])
                self._observations[i], self._idle[i] = observation, terminated or truncated
