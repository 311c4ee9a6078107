"""Members of any Gymnasium task, stepped one after another."""

import linecache
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from copy import deepcopy
from importlib.metadata import packages_distributions, version

import gymnasium
import mujoco
import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.vector.utils import batch_space
from gymnasium.wrappers.utils import rescale_box

from offairl_lite.envs import batched


class TaskError(RuntimeError):
    """A task's own code has failed; the exception's cause shows where."""


@contextmanager
def own_code(task: object, what: str) -> Iterator[None]:
    """Turn an error of a task's own code into a TaskError, but not Gymnasium's or an import's."""
    try:
        yield
    except (gymnasium.error.Error, ImportError):
        raise
    except Exception as error:
        raise TaskError(f"{task} has failed in its {what}, {_explained(error)}") from error


def _explained(error: Exception) -> str:
    """Return what an exception says; of one without words where it is from, with what versions."""
    if str(error):
        return f"{type(error).__name__}: {error}"
    frame, line = list(traceback.walk_tb(error.__traceback__))[-1]
    file, module = frame.f_code.co_filename, frame.f_globals.get("__name__", "").partition(".")[0]
    code = linecache.getline(file, line).strip()
    said = f"{type(error).__name__} in {file}, line {line}, `{code}`"
    for name in packages_distributions().get(module, [])[:1]:
        said += (
            f". That is {name} {version(name)}, with MuJoCo {mujoco.__version__}: if it was made "
            "for an older one, pip install 'mujoco<3.12', with which such tasks train here as well"
        )
    return said


def as_reward(task: object, reward: object) -> float:
    """Return a task's reward as a number; ValueError if it is none."""
    if reward is None or np.ndim(reward) or np.asarray(reward).dtype.kind not in "biuf":  # type: ignore
        wrong = f"its step has returned {reward!r} for a reward"
        raise ValueError(f"{task}: {wrong}; expected a number, 0.0 where there is none")
    return float(reward)  # type: ignore[arg-type]


class SerialEnv(SyncVectorEnv):
    """New `members` of one task with the actions, seeds and saved states of a `BatchedEnv`.

    The variables inside a member are unknown. Its state is therefore that of its random generator
    before the reset, and the actions since then; it is restored by playing the episode again.
    Actions from -1 to 1 are converted to `units`, the task's own. `seeds` are for first resets.
    """

    single_observation_space: Box
    single_action_space: Box

    def __init__(self, members: Sequence[gymnasium.Env], units: Box, seeds: Sequence[int | None]):
        making = [lambda member=member: member for member in members]
        super().__init__(making, autoreset_mode=AutoresetMode.DISABLED)
        self.spec, self._units, ones = members[0].spec, units, np.ones_like(units.low)
        self.single_action_space, _, self._in_units = rescale_box(units, -ones, ones)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._seeds = list(seeds)
        self._starts = [seeding.np_random(seed)[0] for seed in seeds]
        for member, start in zip(members, self._starts, strict=True):
            member.unwrapped.np_random = deepcopy(start)
        self._last = np.stack([np.zeros_like(self.single_observation_space.low)] * self.num_envs)
        self._actions: list[np.ndarray] = []  # As many as the longest episode has steps.
        self._clock = np.zeros(self.num_envs, np.int64)
        self._idle = np.ones(self.num_envs, bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict | None = None
    ) -> tuple[np.ndarray, dict]:
        """Start new episodes, as `BatchedEnv.reset`; TaskError if the task itself fails."""
        mask = batched.reset_mask(options, self.num_envs)
        seeds = batched.member_seeds(seed, self.num_envs)
        for i in np.flatnonzero(mask).tolist():
            self._begin(i, self._seeds[i] if seeds[i] is None else seeds[i])
        del self._actions[: len(self._actions) - self._clock.max()]
        return self._last.copy(), {}

    def step(self, actions: np.ndarray) -> batched.Step:
        """Advance every member by one step, as `BatchedEnv.step`; TaskError if the task fails."""
        batched.require_episodes(self._idle)
        self._actions.append(batched.checked_actions(actions, self).astype(self._units.dtype))
        ends = [self._advance(i, action) for i, action in enumerate(self._actions[-1])]
        rewards, terminated, truncated = zip(*ends, strict=True)
        return self._last.copy(), np.array(rewards), np.array(terminated), np.array(truncated), {}

    def get_state(self) -> dict[str, np.ndarray]:
        """Return arrays for `set_state`, with the last `clock` actions. Generators are PCG64."""
        actions = np.array(self._actions, self._units.dtype)
        return {
            "starts": batched.generator_words(self._starts, self),
            "actions": actions.reshape(-1, self.num_envs, *self._units.shape),
            "clock": self._clock.copy(),
            "idle": self._idle.copy(),
            "observations": self._last.copy(),
            "generators": batched.generator_words(self.np_random, self),
        }

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Continue exactly from a state that `get_state` returned, here or in another environment.

        ValueError: it is of another task, or its episodes come out differently here.
        """
        like, steps = self.get_state(), np.shape((state or {}).get("actions", ()))[:1]
        like["actions"] = np.empty((*steps, *like["actions"].shape[1:]), self._units.dtype)
        batched.require_layout(state, like)
        batched.set_generator_words(self.np_random, state["starts"])
        self._seeds, self._starts = [None] * self.num_envs, deepcopy(list(self.np_random))
        self._last, self._actions = state["observations"].copy(), list(state["actions"].copy())
        self._clock, self._idle = np.zeros_like(state["clock"]), np.ones_like(state["idle"])
        never_reset = state["idle"] & (state["clock"] == 0)
        for i in np.flatnonzero(~never_reset).tolist():
            self._begin(i)
            for actions in self._actions[len(self._actions) - state["clock"][i] :]:
                self._advance(i, actions[i])
        again = self.get_state()
        wrong = [k for k in state if not np.array_equal(again[k], state[k], equal_nan=True)]
        if wrong:
            raise ValueError(
                f"{self}: {', '.join(wrong)} came out differently when the episodes were "
                "played again, so a run on it cannot be resumed: let the task draw from "
                "self.np_random alone, in reset and step, and keep nothing from before the reset"
            )

    def _begin(self, i: int, seed: int | None = None) -> None:
        """Start an episode of one member, whose generator continues if there is no seed."""
        member = self.envs[i]
        generator = member.unwrapped.np_random
        self._starts[i] = deepcopy(generator) if seed is None else seeding.np_random(seed)[0]
        with own_code(self, "reset"):
            self._observe(i, member.reset(seed=seed)[0])
        self._seeds[i], self._clock[i], self._idle[i] = None, 0, False

    def _advance(self, i: int, action: np.ndarray) -> tuple[float, bool, bool]:
        """Return reward, terminated and truncated of one member's next step."""
        # Rounding must not leave the bounds of the task.
        scaled = self._in_units(action).astype(action.dtype)
        with own_code(self, "step"):
            step = self.envs[i].step(np.clip(scaled, self._units.low, self._units.high))
            obs, reward, terminated, truncated, _ = step
            self._observe(i, obs)
            ended = bool(terminated), bool(truncated)
        self._clock[i] += 1
        self._idle[i] = any(ended)
        return as_reward(self, reward), *ended

    def _observe(self, i: int, observation: np.ndarray) -> None:
        """Keep a member's observation; ValueError if it does not fit the space."""
        shape, expected = np.shape(observation), self.single_observation_space.shape
        if shape != expected:
            why = "as observation_space says (reset returns observation, info)"
            raise ValueError(f"an observation has the shape {shape}; expected {expected}, {why}")
        np.stack([observation], out=self._last[i : i + 1])
