"""Environments: the paper's eight tasks, stepped in batches, and any other Gymnasium task.

Importing this package registers its own tasks with Gymnasium, for `gymnasium.make` and
`gymnasium.make_vec`:

- `offairl/PointMazeLeft-v0`, `offairl/PointMazeRight-v0`: the shifting maze;
- `offairl/CustomAnt-v0`, `offairl/DisabledAnt-v0`: the ant, and the ant with two weak legs;
- `offairl/DisabledAntReleased-v0`: DisabledAnt with its actuators in the released code's order;
- `offairl/PointMarsh-v0`, `offairl/PointMarshWest-v0`: a marsh, costly to cross, instead of the
  barrier, with two different starts.
"""

import importlib
import sys
from collections.abc import Sequence
from difflib import get_close_matches

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.spaces import Box, Space
from gymnasium.vector import AutoresetMode

from offairl_lite.config.settings import Count, checked
from offairl_lite.envs.batched import BatchedEnv, member_seeds
from offairl_lite.envs.serial import SerialEnv, TaskError, own_code
from offairl_lite.envs.tasks import TASKS

__all__ = ["TASKS", "BatchedEnv", "SerialEnv", "SingleEnv", "TaskError"]
__all__ += ["make", "require_boxes", "spec"]


class SingleEnv(gymnasium.Env):
    """One member of a task of `TASKS` as an ordinary environment, without a time limit."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012

    def __init__(self, task: str, render_mode: str | None = None):
        # Gymnasium's TimeLimit, which `gymnasium.make` adds, is the only clock.
        self._members = BatchedEnv(task, render_mode=render_mode, max_episode_steps=10**9)
        self.render_mode = render_mode
        self.action_space = self._members.single_action_space
        self.observation_space = self._members.single_observation_space

    def reset(self, *, seed=None, options=None) -> tuple[np.ndarray, dict]:
        """Start a new episode; `options` are not used."""
        super().reset(seed=seed)
        self._members.np_random = (self.np_random,)
        observations, info = self._members.reset()
        return observations[0], info

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Advance by one step; `action` is (A,) and finite."""
        observations, rewards, terminated, _, info = self._members.step(np.asarray(action)[None])
        return observations[0], float(rewards[0]), bool(terminated[0]), False, info

    def render(self) -> np.ndarray:
        """Return the current frame, (height, width, 3) uint8."""
        return self._members.render()[0]


def spec(env_id: str) -> EnvSpec:
    """Return the registered specification of a task; for `my_module:MyTask-v0`, import the module.

    Raises ModuleNotFoundError, TaskError, or a ValueError that lists the tasks there are.
    """
    module, _, name = checked("env_id", env_id, str).rpartition(":")
    try:
        if module:
            with own_code(env_id, "module"):
                importlib.import_module(module)
        return gymnasium.spec(name)
    except ModuleNotFoundError as error:
        cure = f"{module} imports it; install it, in the environment of this package"
        if f"{module}.".startswith(f"{error.name}."):
            cure = f"expected a module that registers {name}: start in its folder, or add that "
            cure += "folder to PYTHONPATH"
        raise ModuleNotFoundError(f"{env_id}: {error}; {cure}") from error
    except gymnasium.error.Error as error:
        if module:
            near = " or ".join(get_close_matches(name, gymnasium.registry))
            why = f"{getattr(sys.modules[module], '__file__', module)} does not register {name!r}"
            why += f"; did you mean {near}?" if near else ""
            raise ValueError(f"unknown environment {env_id!r}: {why}") from error
        raise ValueError(
            f"unknown environment {env_id!r}. Known are {', '.join(TASKS)}, and Gymnasium's. If it "
            "is your own, name the module that calls gymnasium.register: "
            f"--env-id my_module:{name or 'MyTask-v0'}"
        ) from error


def require_boxes(env_id: str, observation_space: Space, action_space: Space) -> tuple[Box, Box]:
    """Return a task's spaces; ValueError unless both are boxes with one axis.

    The action space must consist of floats with finite bounds, low < high.
    """
    for name, space in (("observation", observation_space), ("action", action_space)):
        if not isinstance(space, Box) or len(space.shape) != 1 or 0 in space.shape:
            raise ValueError(
                f"{env_id}: the {name} space {space} is not supported; observations and actions "
                "must each be a gymnasium.spaces.Box with one axis, not empty (see "
                "gymnasium.wrappers.FlattenObservation)"
            )
    assert isinstance(observation_space, Box)
    assert isinstance(action_space, Box)
    bounded = action_space.is_bounded() and (action_space.low < action_space.high).all()
    if not bounded or not np.issubdtype(action_space.dtype, np.floating):
        raise ValueError(
            f"{env_id}: the action space {action_space} must be a Box of floats with finite "
            "bounds, low < high: round in the task's own step, and leave out what cannot be chosen"
        )
    return observation_space, action_space


def make(
    env_id: str,
    population: int,
    seed: int | Sequence[int],
    *,
    num_threads: int = 1,
    render_mode: str | None = None,
) -> BatchedEnv | SerialEnv:
    """Return a vector environment with one member per seed, without automatic resets.

    `env_id` is a key of `TASKS`, or the id of any Gymnasium environment with flat `Box` spaces,
    whose members are then stepped one after another. A single seed s stands for s, s + 1, ...

    Members start when the first `reset()` is called. A finished member must be reset, with
    `reset(options={"reset_mask": finished})`, before the next `step`. Actions range from -1 to 1 in
    every dimension, and are rescaled for an environment with other bounds. `get_state()` returns
    arrays from which `set_state(state)` continues exactly, here or in another environment made with
    the same id and population. With `"rgb_array"` for a `render_mode`, `render()` returns frames.

    It is a ValueError if an argument is not as above, or see `spec` and `require_boxes`, and a
    TaskError if the task's own code has failed.
    """
    for name, count in (("population", population), ("num_threads", num_threads)):
        checked(name, count, Count)
    seeds = member_seeds(seed, population)
    if None in seeds:
        raise ValueError(f"seed is {seed}; expected a number, or one for each of {population}")
    if checked("env_id", env_id, str) in TASKS:
        return BatchedEnv(
            env_id,
            population,
            seeds=seeds,
            num_threads=num_threads,
            autoreset_mode=AutoresetMode.DISABLED,
            render_mode=render_mode,
        )
    spec(env_id)  # Its error for an unknown task is more helpful than Gymnasium's.
    # An environment without frames need not have this argument.
    options: dict = {} if render_mode is None else {"render_mode": render_mode}
    with own_code(env_id, "making"):
        members = [gymnasium.make(env_id, **options) for _ in seeds]
    _, units = require_boxes(env_id, members[0].observation_space, members[0].action_space)
    return SerialEnv(members, units, seeds)


for _id in filter(lambda _id: _id.startswith("offairl/"), TASKS):
    gymnasium.register(
        _id,
        entry_point="offairl_lite.envs:SingleEnv",
        vector_entry_point="offairl_lite.envs:BatchedEnv",
        max_episode_steps=TASKS[_id].max_episode_steps,
        kwargs={"task": _id},
    )
