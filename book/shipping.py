"""The shipped experts: chosen from a population, with a note of each."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from offairl_lite import demonstrations
from offairl_lite.core.policies import Policy
from offairl_lite.core.rollouts import Episodes, rollout
from offairl_lite.demonstrations import (
    BLOCK,
    expert,
    expert_file,
    first_episodes,
)


def ship(policy: Policy, seeds: Sequence[int], count: int = 5) -> Path:
    """Make the `count` best members of a population the shipped experts.

    Members are ranked by the mean return of 20 episodes of their mode,
    which `seeds` draw, and keep their order: put experts that are shipped
    already first, so that results of the first expert alone can be
    repeated. The weights are stored in half precision if that changes no
    expert's mean return over ten episodes by more than 1 %. Returned is
    the file of the experts; `write_reference` writes the JSON file beside
    it.
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
    """Write beside the shipped experts of a task what they do, as JSON.

    It holds `returns`, the mean return of each expert's mode over ten
    episodes; `demonstrated`, the mean return of 50 demonstrations by the
    first expert, by the first two, and so on, as `experts` of
    `demonstrations.load` counts them; and the `fingerprint` of their
    first demonstrations. Written anew on another machine or with another
    MuJoCo, the file shows whether the demonstrations are others there.
    """
    path, policy = expert_file(env_id).with_suffix(".json"), expert(env_id)
    content = {
        "returns": [
            round(float(mean), 4) for mean in _mode_returns(policy)
        ],
        "demonstrated": _demonstrated(policy, env_id),
        **fingerprint(first_episodes(policy, env_id), env_id),
    }
    path.write_text(json.dumps(content, indent=2) + "\n")
    return path


def fingerprint(made: Episodes, env_id: str) -> dict[str, Any]:
    """Return what tells one machine's demonstrations from another's.

    These are SHA-256 of the `experts`' file and of each expert's
    `demonstrations`, as `first_episodes` made them, their `mean_returns`,
    and the version of `mujoco`.
    """
    members = zip(
        made.obs,
        made.action,
        made.next_obs,
        made.reward,
        made.running,
        strict=True,
    )
    return {
        "experts": hashlib.sha256(
            expert_file(env_id).read_bytes()
        ).hexdigest(),
        "demonstrations": [
            hashlib.sha256(
                b"".join(part[running].tobytes() for part in parts)
            ).hexdigest()
            for *parts, running in members
        ],
        "mean_returns": [
            round(float(mean), 4) for mean in made.returns.mean(1)
        ],
        "mujoco": version("mujoco"),
    }


def _mode_returns(policy: Policy) -> np.ndarray:
    """Return the mean return of each member's mode over ten episodes."""
    return rollout(
        policy, policy.env_id, range(len(policy)), 10
    ).returns.mean(1)


def _demonstrated(
    policy: Policy, env_id: str, count: int = 50
) -> list[float]:
    """Return mean returns of the first expert, the first two, and so on."""
    blocks = [
        first_episodes(policy, env_id, first).returns
        for first in range(0, count, BLOCK)
    ]
    returns, i = np.concatenate(blocks, 1), np.arange(count)
    return [
        round(float(returns[i % n, i // n].mean()), 4)
        for n in range(1, len(policy) + 1)
    ]
