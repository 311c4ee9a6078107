"""Environments: the paper's eight tasks, stepped in batches, and any other Gymnasium task.

Importing this package registers its own, the ids of `TASKS` that begin with `offairl/`, for
`gymnasium.make` and `gymnasium.make_vec`.
"""

import importlib
import sys
import uuid
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from copy import deepcopy
from difflib import get_close_matches
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.spaces import Box, Dict, Discrete, Space, flatten_space
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import FlattenObservation

from offairl_lite.config.settings import Count, checked
from offairl_lite.envs.batched import Batch, BatchedEnv, member_seeds
from offairl_lite.envs.serial import SerialEnv, TaskError, own_code
from offairl_lite.envs.tasks import TASKS

__all__ = ["TASKS", "BatchedEnv", "OneHotActions", "SerialEnv", "SingleEnv", "TaskError"]
__all__ += ["AnyTask", "flatten", "make", "parts", "register", "require_boxes", "spaces", "spec"]

AnyTask = str | gymnasium.Env | Callable[[], gymnasium.Env]
"""A Gymnasium id, an environment, or a function that makes one."""


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


class OneHotActions(gymnasium.ActionWrapper, RecordConstructorArgs):
    """A task with n discrete actions, as n numbers in [-1, 1]: the largest acts; see `encode`."""

    def __init__(self, env: gymnasium.Env):
        RecordConstructorArgs.__init__(self)
        super().__init__(env)
        if not isinstance(env.action_space, Discrete):
            raise ValueError(f"actions are {env.action_space}; expected gymnasium.spaces.Discrete")
        self._discrete = env.action_space
        self.action_space = Box(-1, 1, (int(env.action_space.n),), np.float32)

    def action(self, action: np.ndarray) -> np.integer:
        """Return the discrete action for n numbers (n,)."""
        return self._discrete.start + np.argmax(action)

    def encode(self, actions: np.ndarray) -> np.ndarray:
        """Return discrete actions (...) as numbers (..., n): 1 for the one chosen, -1 elsewhere."""
        chosen = np.asarray(actions)[..., None] - self._discrete.start
        return np.where(chosen == np.arange(self._discrete.n), 1, -1).astype(np.float32)


def spec(env_id: str) -> EnvSpec:
    """Return the registered specification of a task; for `my_module:MyTask-v0`, import the module.

    Raises:
        ModuleNotFoundError: there is no such module.
        TaskError: the module fails.
        ValueError: there is no such task; lists those there are.
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
        near = " or ".join(get_close_matches(name, gymnasium.registry))
        near, why = f"; did you mean {near}?" if near else "", f"unknown environment {env_id!r}"
        if module:
            file = getattr(sys.modules[module], "__file__", module)
            raise ValueError(f"{why}: {file} does not register {name!r}{near}") from error
        raise ValueError(
            f"{why}{near or '.'} Known are {', '.join(TASKS)}, and Gymnasium's. If it is your own, "
            f"let env_id name its module, too: my_module:{name or 'MyTask-v0'}"
        ) from error


def register(env: AnyTask, env_id: str | None = None) -> str:
    """Return the id of a task, under which an environment, or a function, is registered.

    An environment is copied each time that the task is made. Without an `env_id` it gets a new one.
    """
    if isinstance(env, str):
        spec(env)
        return env
    if not isinstance(env, gymnasium.Env) and not callable(env):
        raise ValueError(f"env is {env!r}; expected a Gymnasium id, an environment, or a function")
    make: Any = env if callable(env) else lambda: deepcopy(env)
    first = make()
    wrapped, limit = first, None
    while isinstance(wrapped, gymnasium.Wrapper):
        if isinstance(wrapped, gymnasium.wrappers.TimeLimit):
            limit = wrapped._max_episode_steps
        wrapped = wrapped.env
    env_id = env_id or f"airl/{type(wrapped).__name__}-{uuid.uuid4().hex[:8]}-v0"
    made = [first]
    gymnasium.registry.pop(env_id, None)
    entry_point: Any = lambda: made.pop() if made else make()  # noqa: E731
    gymnasium.register(env_id, entry_point, max_episode_steps=limit)
    return env_id


def require_boxes(env_id: str, observation_space: Space, action_space: Space) -> tuple[Box, Box]:
    """Return a task's spaces as boxes with one axis; ValueError if they cannot be made so.

    Dictionaries of observations are flattened; actions must be floats with finite bounds.
    """
    if isinstance(observation_space, Dict):
        observation_space = flatten_space(observation_space)
    for name, space in (("observation", observation_space), ("action", action_space)):
        if not isinstance(space, Box) or len(space.shape) != 1 or 0 in space.shape:
            cure = "see gymnasium.wrappers.FlattenObservation"
            if name == "action":
                cure = "gymnasium.wrappers.TransformAction makes such actions of a Box's numbers"
            if isinstance(space, Discrete) and name == "action":
                cure = "offairl_lite.envs.OneHotActions chooses the action whose number is largest"
            raise ValueError(
                f"{env_id}: the {name} space {space} is not supported; observations and actions "
                "must each be a gymnasium.spaces.Box with one axis, not empty. Wrap the task, for "
                f"AIRL or in a function that gymnasium.register is given: {cure}"
            )
    assert isinstance(observation_space, Box)
    assert isinstance(action_space, Box)
    where = f"{env_id}: the action space {action_space}"
    if not np.issubdtype(action_space.dtype, np.floating):
        raise ValueError(f"{where} must be a Box of floats: round in the task's own step")
    if not action_space.is_bounded():
        raise ValueError(
            f"{where} has no bounds, from which random actions are drawn: give it some that no "
            "demonstrated action exceeds, gymnasium.wrappers.TransformAction(env, lambda a: a, "
            f"gymnasium.spaces.Box(-10, 10, {action_space.shape}))"
        )
    if not (action_space.low < action_space.high).all():
        raise ValueError(f"{where} must have low < high: leave out what cannot be chosen")
    return observation_space, action_space


_SPACES: dict[str, tuple[EnvSpec, Space, Box, Box]] = {}
"""The spaces of tasks that were made, as long as they are registered as they were: that of
observations as the task has it, and those of vectors."""


def parts(env_id: str) -> list[str]:
    """Return the parts of a task's observations in their order in a vector, if they have names."""
    spaces(env_id)
    space = _SPACES[env_id][1]
    return [*map(str, space)] if isinstance(space, Dict) else []


def flatten(task: str | Space, obs: Any) -> Any:
    """Return observations as networks see them: parts of a dictionary in the order of its space.

    Args:
        task: its id, or the space of its observations.
        obs: an observation, a dictionary of arrays (..., N), or a list of dictionaries. What is
            none of these is returned as it is.

    Raises:
        ValueError: there are other parts than the task has, or they have different lengths.
    """
    if isinstance(task, str):
        spaces(task)
        task = _SPACES[task][1]
    if isinstance(task, Dict) and isinstance(obs, Mapping):
        if obs.keys() != task.keys():
            raise ValueError(f"observations have the parts {[*obs]}; expected {[*task]}")
        return np.concatenate([_vectors(space, obs[name]) for name, space in task.items()], -1)
    several = isinstance(obs, list | tuple | np.ndarray) and np.size(obs)
    if isinstance(task, Dict) and several and isinstance(obs[0], Mapping):
        return np.stack([flatten(task, one) for one in obs])
    return obs


def _vectors(space: Space, part: Any) -> np.ndarray:
    """Return one part of an observation, or of several, as vectors."""
    if isinstance(space, Dict):
        return flatten(space, part)
    if np.ndim(part) > len(space.shape or ()):
        return np.stack([_vectors(space, one) for one in part])
    return np.asarray(gymnasium.spaces.flatten(space, part))


def spaces(env_id: str) -> tuple[Box, Box]:
    """Return a task's spaces of observations, flattened, and actions; it is made once at most."""
    registered = spec(env_id)  # Its error for an unknown task is more helpful than Gymnasium's.
    if env_id not in _SPACES or _SPACES[env_id][0] is not registered:
        with own_code(env_id, "making"), closing(gymnasium.make(env_id)) as env:
            boxes = env.observation_space, env.action_space
        _SPACES[env_id] = registered, boxes[0], *require_boxes(env_id, *boxes)
    return _SPACES[env_id][2:]


def make(
    env_id: str,
    population: int,
    seed: int | Sequence[int],
    *,
    num_threads: int = 1,
    render_mode: str | None = None,
) -> BatchedEnv | SerialEnv:
    """Return a vector environment with one member per seed, without automatic resets.

    Members start when the first `reset()` is called. A finished one must be reset, with
    `reset(options={"reset_mask": finished})`, before the next `step`. Actions range from -1 to 1 in
    every dimension. `get_state()` returns arrays from which `set_state(state)` continues exactly,
    here or in another environment made with the same id and population.

    Args:
        env_id: a key of `TASKS`, or any Gymnasium id with flat `Box` spaces, or dictionaries of
            observations, which are flattened; members of those are stepped one after another.
        population: number of members.
        seed: one for each, or s for s, s + 1, ...
        num_threads: of the batched physics.
        render_mode: `"rgb_array"`, for frames by `render()`.

    Raises:
        ValueError: an argument is not as above, or see `spec` and `require_boxes`.
        TaskError: the task's own code has failed.
    """
    for name, count in (("population", population), ("num_threads", num_threads)):
        checked(name, count, Count)
    seeds = member_seeds(seed, population)
    if None in seeds:
        raise ValueError(f"seed is {seed}; expected a number, or one for each of {population}")
    if checked("env_id", env_id, str) in TASKS and (Batch or env_id.startswith("offairl/")):
        return BatchedEnv(
            env_id,
            population,
            seeds=seeds,
            num_threads=num_threads,
            autoreset_mode=AutoresetMode.DISABLED,
            render_mode=render_mode,
        )
    registered = spec(env_id)  # Its error for an unknown task is more helpful than Gymnasium's.
    # An environment without frames need not have this argument.
    options: dict = {} if render_mode is None else {"render_mode": render_mode}
    members: list[gymnasium.Env] = []
    with ExitStack() as undo:
        for _ in seeds:
            with own_code(env_id, "making"):
                members.append(gymnasium.make(env_id, **options))
            undo.callback(members[-1].close)
        seen = members[0].observation_space
        flat, units = require_boxes(env_id, seen, members[0].action_space)
        if flat is not seen:
            members = [FlattenObservation(member) for member in members]
        env = SerialEnv(members, units, seeds)
        undo.pop_all()
    _SPACES[env_id] = registered, seen, flat, units
    return env


for _id in filter(lambda _id: _id.startswith("offairl/"), TASKS):
    gymnasium.register(
        _id,
        entry_point="offairl_lite.envs:SingleEnv",
        vector_entry_point="offairl_lite.envs:BatchedEnv",
        max_episode_steps=TASKS[_id].max_episode_steps,
        kwargs={"task": _id},
    )
