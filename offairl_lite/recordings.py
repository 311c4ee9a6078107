"""Recordings of episodes: out of flat arrays, and of a function that acts."""

import logging
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from copy import deepcopy
from itertools import pairwise
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from tqdm.auto import tqdm

from offairl_lite import envs, minari_storage
from offairl_lite.core.rollouts import LONGEST, require_end, require_sound
from offairl_lite.envs.serial import as_reward
from offairl_lite.minari_storage import Recording

log = logging.getLogger(__name__)

NAMES = {
    "obs": ("obs", "observations"),
    "action": ("action", "actions", "acts"),
    "starts": ("episode_starts",),
    "terminated": ("terminated", "terminations", "terminals"),
    "ends": ("dones", "truncated", "truncations", "timeouts"),
    "next_obs": ("next_obs", "next_observations"),
    "reward": ("reward", "rewards"),
}
"""What flat arrays are called by Stable-Baselines, D4RL, imitation and Gymnasium."""


def from_flat(arrays: Mapping[str, np.ndarray]) -> list[Recording]:
    """Cut flat arrays, one row a step, into recordings.

    Episodes are told apart by `episode_starts` or by their ends: `dones`, `truncated` or
    `timeouts`, and `terminated` or `terminals`, which alone tell an end for good. `obs`, `actions`
    and `rewards` have one row a step, as in files of Stable-Baselines, which lack the last
    observation of an episode: its last action, of which nobody knows where it led, is then left
    out, and with it a termination, of which the log speaks. With `next_obs` nothing is, and an
    episode also ends where the next row begins elsewhere. Of a task whose observations are
    dictionaries, `obs` is a dictionary of such arrays.

    Raises:
        ValueError: an array is missing or of another length, or all episodes have one step.
    """
    columns = {part: arrays[n] for part, names in NAMES.items() for n in names[::-1] if n in arrays}
    rows = {part: _rows(array) for part, array in columns.items()}
    steps, available = len(rows.get("action", ())), sorted(arrays)
    if not {"obs", "action"} <= rows.keys():
        raise ValueError(f"flat arrays {available}; expected obs and actions among them")
    if wrong := {n: len(array) for n, array in rows.items() if len(array) != steps}:
        many = f"{wrong} rows, and {steps} actions"
        raise ValueError(f"flat arrays: {many}; expected as many of each")
    names = NAMES["terminated"] + NAMES["ends"]
    marks = [np.ravel(arrays[n]) != 0 for n in names if n in arrays]
    starts = np.arange(steps) == 0
    if "starts" in rows:
        starts |= rows["starts"].astype(bool)
    elif marks:
        starts[1:] |= np.any(marks, 0)[:-1]
    elif "next_obs" not in rows:
        raise ValueError(
            f"flat arrays {available}; expected episode_starts or dones among them. Of one episode "
            "give episode_starts=np.arange(len(actions)) == 0"
        )
    if "next_obs" in rows and rows["obs"].dtype != object:
        led = np.isclose(rows["next_obs"][:-1], rows["obs"][1:], 1e-4, 1e-4)
        jumps = ~led.reshape(steps - 1, -1).all(1) & ~starts[1:]
        starts[1:] |= jumps
        if jumps.any():
            log.warning(f"{jumps.sum()} rows do not begin where next_obs led: episodes end there")
        if "terminated" not in rows and "dones" in arrays:
            log.warning("dones may be time limits: no episode terminates unless terminated says so")
    bounds = [*np.flatnonzero(starts), steps]
    recordings, dropped = [], 0
    for begin, end in pairwise(bounds):
        obs = rows["obs"][begin:end]
        ended = "terminated" in rows and bool(rows["terminated"][end - 1])
        if "next_obs" in rows:
            obs = np.concatenate([obs, rows["next_obs"][end - 1 : end]])
        else:
            dropped, ended, end = dropped + ended, False, end - 1
        if end > begin:
            reward = rows["reward"][begin:end] if "reward" in rows else None
            recordings.append(Recording(obs, rows["action"][begin:end], ended, reward))
    if not recordings:
        raise ValueError("flat arrays: no episode has two observations")
    if dropped:
        log.warning(
            f"{dropped} of {len(bounds) - 1} episodes terminated, and the observation after it is "
            "not there: they are taken for recordings that were cut; next_obs would show the end"
        )
    return recordings


def _rows(array: Any) -> np.ndarray:
    """Return an array with a row for each step: a dictionary each, of a dictionary of arrays."""
    if not isinstance(array, Mapping):
        return np.asarray(array)
    columns = [_rows(part) for part in array.values()]
    if len(lengths := {len(column) for column in columns}) > 1:
        raise ValueError(f"flat arrays: {[*array]} have {sorted(lengths)} rows; expected as many")
    return np.array([dict(zip(array, row, strict=True)) for row in zip(*columns, strict=True)])


def recording_of(i: int, parts: Any, limit: int | None) -> Recording:
    """Return an episode that is one, a tuple, named arrays, or as imitation has it.

    Imitation's `terminal` is true at the task's time `limit` as well.
    """
    if hasattr(parts, "acts"):
        ended = bool(parts.terminal) and len(parts.acts) != limit
        return Recording(parts.obs, parts.acts, ended, getattr(parts, "rews", None))
    if isinstance(parts, np.ndarray):
        raise ValueError(
            f"recording {i} is an array of shape {parts.shape}; expected a list of episodes, each "
            "(obs, action). Of flat arrays give the names: dict(obs=..., actions=..., dones=...)"
        )
    try:
        return _named(parts) if isinstance(parts, Mapping) else Recording(*parts)
    except TypeError as error:
        why = f"expected a Recording, or its parts {Recording._fields}"
        raise ValueError(f"recording {i} is a {type(parts).__name__}; {why}: {error}") from error


def _named(arrays: Mapping[str, Any]) -> Recording:
    """Return an episode whose arrays have any of `NAMES`; see `from_flat` if it lacks an end."""
    part = {part: arrays[n] for part, names in NAMES.items() for n in names if n in arrays}
    if not {"obs", "action"} <= part.keys():
        raise TypeError(f"it has {sorted(arrays)}; expected obs and actions among them")
    ended, steps = bool(np.any(part.get("terminated", False))), len(part["action"])
    if len(_rows(part["obs"])) != steps:
        return Recording(part["obs"], part["action"], ended, part.get("reward"))
    last = np.arange(steps) == steps - 1
    kept = {n: part[n] for n in ("obs", "action", "next_obs", "reward") if n in part}
    return from_flat(kept | {"terminated": last & ended, "truncated": last})[0]


def played(
    act: Callable[[np.ndarray], np.ndarray], env_id: str, units: Box, seeds: Sequence[int]
) -> list[Recording]:
    """Return episodes of a function that acts, one for each seed."""
    recordings, returns = [], list[float]()
    with (
        closing(gymnasium.make(env_id)) as env,
        tqdm(seeds, unit="episode", desc=f"demonstrations of {env_id}") as bar,
    ):
        for i, seed in enumerate(bar):
            # Copies, since whoever acts, and the task, may go on writing into their own.
            obs, actions, rewards = [deepcopy(env.reset(seed=seed)[0])], list[np.ndarray](), []
            terminated = truncated = False
            while not (terminated or truncated):
                require_end(env_id, len(actions), LONGEST)
                where = f"episode {i}, step {len(actions)}"
                seen = np.array(envs.flatten(env_id, obs[-1]))
                require_sound(env_id, where, [seed], observation=seen[None])
                action = act(deepcopy(obs[-1]))
                _require_action(action, units, where)
                actions.append(np.array(action, units.dtype))
                seen, reward, terminated, truncated, _ = env.step(actions[-1].copy())
                obs.append(deepcopy(seen))
                rewards.append(as_reward(env_id, reward))
            bar.set_postfix_str(f"return {np.mean(returns := [*returns, sum(rewards)]):.4g}")
            flat = np.stack(envs.flatten(env_id, obs))
            parts = flat, np.stack(actions), bool(terminated), np.array(rewards)
            recordings.append(Recording(*parts))
    return recordings


def _require_action(action: Any, units: Box, where: str) -> None:
    """Raise ValueError, with the episode and the step, unless a task can take an action."""
    with suppress(ValueError, TypeError):  # What is no array is refused below.
        array = np.asarray(action)
        like = array.shape == units.shape and array.dtype.kind in "biuf"
        if like and np.isfinite(array).all() and not minari_storage.outside(array, units).any():
            return
    raise ValueError(
        f"{where}: the action is {action!r}; expected finite numbers in the task's own units, "
        f"within {units}: mend the policy, or clip what it returns (a model of Stable-Baselines3: "
        "model.predict(obs)[0])"
    )
