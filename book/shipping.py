"""The shipped experts: chosen from a population, with what they show."""

import hashlib
import json
import lzma
from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from offairl_lite import demonstrations, envs
from offairl_lite.core.policies import Policy
from offairl_lite.core.rollouts import LONGEST, Episodes, rollout
from offairl_lite.demonstrations import (
    ACTIONS,
    BLOCK,
    expert,
    expert_file,
    first_episodes,
)

EPISODES = 50
"""How many demonstrations of each expert are shipped."""
FILTERS = [
    {"id": lzma.FILTER_LZMA2, "preset": 9, "lc": 0, "lp": 2, "pb": 2}
]
"""How they are compressed: numbers of four bytes, hardly ever equal."""


def ship(policy: Policy, seeds: Sequence[int], count: int = 5) -> Path:
    """Make the `count` best members of a population the shipped experts.

    Members are ranked by the mean return of 20 episodes of their mode,
    which `seeds` draw, and keep their order: put experts that are shipped
    already first, so that results of the first expert alone can be
    repeated. The weights are stored in half precision if that changes no
    expert's mean return over ten episodes by more than 1 %. Returned is
    the file of the experts; `write_reference` writes those beside it.
    """
    ranking = rollout(policy, policy.env_id, seeds, 20).returns.mean(1)
    kept = policy.member(*np.sort(np.argsort(-ranking)[:count]).tolist())
    rounded = replace(kept, params=kept.params.half().float())
    before, after = _mode_returns(kept), _mode_returns(rounded)
    if (np.abs(after - before) <= 0.01 * np.abs(before)).all():
        kept = replace(kept, params=kept.params.half())
    name = demonstrations.short_name(policy.env_id)
    path = demonstrations.EXPERTS / f"{name}.safetensors"
    kept.save(path)
    write_reference(policy.env_id)
    return path


def write_reference(env_id: str) -> Path:
    """Write beside the shipped experts of a task what they do.

    One file has the actions of the first 50 episodes of each expert, as
    it samples them here, zeros after an episode's end. They are played
    again wherever the demonstrations are loaded.

    The other is JSON: `returns`, the mean return of each expert's mode
    over ten episodes; `demonstrated`, the mean return of 50
    demonstrations by the first expert, by the first two, and so on, as
    `experts` of `demonstrations.load` counts them; `mean_returns`, those
    of each expert's 50; SHA-256 of the `experts`' file and of each
    block of ten of each expert's `demonstrations`; and the version of
    `mujoco`. Returned is the JSON file.
    """
    path, policy = expert_file(env_id).with_suffix(".json"), expert(env_id)
    blocks = [
        first_episodes(policy, env_id, first)
        for first in range(0, EPISODES, BLOCK)
    ]
    _write_actions(blocks, env_id)
    returns = np.concatenate([made.returns for made in blocks], 1)
    digests = [demonstrations.digests(made) for made in blocks]
    content = {
        "returns": [
            round(float(mean), 4) for mean in _mode_returns(policy)
        ],
        "demonstrated": _demonstrated(returns),
        "experts": hashlib.sha256(
            expert_file(env_id).read_bytes()
        ).hexdigest(),
        "demonstrations": [
            list(of_one) for of_one in zip(*digests, strict=True)
        ],
        "mean_returns": [round(float(mean), 4) for mean in returns.mean(1)],
        "mujoco": version("mujoco"),
    }
    path.write_text(json.dumps(content, indent=2) + "\n")
    return path


def _write_actions(blocks: Sequence[Episodes], env_id: str) -> None:
    """Write the experts' actions, `(S, 50, T, A)`, T the time limit."""
    experts, _, _, size = blocks[0].action.shape
    limit = envs.spec(env_id).max_episode_steps or LONGEST
    actions = np.zeros((experts, EPISODES, limit, size), np.float32)
    for i, made in enumerate(blocks):
        steps = made.action.shape[2]
        place = slice(i * BLOCK, (i + 1) * BLOCK)
        actions[:, place, :steps] = made.action
    with lzma.open(
        expert_file(env_id).with_suffix(ACTIONS), "wb", filters=FILTERS
    ) as file:
        np.save(file, actions)


def _mode_returns(policy: Policy) -> np.ndarray:
    """Return the mean return of each member's mode over ten episodes."""
    return rollout(
        policy, policy.env_id, range(len(policy)), 10
    ).returns.mean(1)


def _demonstrated(returns: np.ndarray) -> list[float]:
    """Return mean returns of the first expert, the first two, and so on."""
    i = np.arange(EPISODES)
    return [
        round(float(returns[i % n, i // n].mean()), 4)
        for n in range(1, len(returns) + 1)
    ]
