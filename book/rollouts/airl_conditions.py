"""Of the note on AIRL's conditions: what policies do in both mazes.

The maze's displacements as a linear model predicts them from the
demonstrations, and roll-outs of an expert and of the policies that learned
rewards have trained in the new maze.
"""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from offairl_lite import demonstrations
from offairl_lite.core.loop import Run
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rollouts import Episodes, rollout
from offairl_lite.runs import records
from rollouts import RECORDS

LEFT, RIGHT = "offairl/PointMazeLeft-v0", "offairl/PointMazeRight-v0"
TRAINED = "maze-transfer-airl-ppo-demo"
KINDS = {  # where r was learned, and what it trained in the new maze
    "the last block": ("maze-airl-ppo-demo/state", f"{TRAINED}/state"),
    "20 blocks": (
        "maze-airl-memory-demo/recent",
        f"{TRAINED}/memory-recent",
    ),
    "all steps": ("maze-airl-memory-demo/all", f"{TRAINED}/memory-all"),
    "off-policy AIRL": ("maze-imitation-demo", "maze-transfer-demo"),
}
DRAWN = 3
"""Digits of a place that are kept."""


def record() -> dict[str, Any]:
    """Return what the note says of demonstrations and of roll-outs."""
    # An expert of the new maze, once for each of the five rewards.
    shipped = demonstrations.expert(RIGHT).member(*[0] * 5)
    expert = rollout(shipped, RIGHT, range(5), 5)
    kinds, paths = {}, {}
    for name, pair in KINDS.items():
        source, trained = map(recorded, pair)
        walks = rollout(trained.policy, RIGHT, range(5), episodes=5)
        gain = returns(source.reward, walks) - returns(
            source.reward, expert
        )
        kinds[name] = {"gain": gain, "return": walks.returns.mean(1)}
        paths[name] = np.round(walks.obs[:, 0, :, :2], DRAWN).tolist()
    last = recorded("maze-airl-ppo-demo/state").policy
    behind = rollout(last, LEFT, range(5), 5).next_obs[..., -20:, 1] - 0.5
    gail = recorded("maze-gail-demo/log-odds")
    carried = rollout(gail.policy, RIGHT, gail.seeds, episodes=10)
    return {
        "left open": left_open(),
        "new maze": kinds,
        "paths": paths,
        "behind the star": behind.mean((1, 2)),
        "GAIL's policy": carried.returns.mean(1),
    }


def recorded(name: str) -> Run:
    """Return a recorded run."""
    return records.read(RECORDS / name)


def returns(reward: Reward, episodes: Episodes) -> np.ndarray:
    """Return each seed's mean sum of a learned reward over an episode."""
    obs, action = (
        torch.as_tensor(x, dtype=torch.float32).flatten(1, 2)
        for x in (episodes.obs, episodes.action)
    )
    r = reward(obs, action).view(episodes.reward.shape)
    return r.sum(-1).mean(1).numpy()


def left_open() -> dict[str, np.ndarray]:
    """Return the share of the displacements' variance that fits leave.

    The displacements are those of the demonstrations, in x and in y.
    """
    data = demonstrations.load(LEFT).transitions
    place, action, after = (
        part.view(-1, 100, part.shape[-1]).double()
        for part in (data.obs, data.action, data.next_obs)
    )
    step = (after - place)[..., :2]

    def share(*inputs: Tensor) -> np.ndarray:
        ones = torch.ones(*step.shape[:2], 1)
        x = torch.cat([*inputs, ones], 2)[:, 1:].flatten(0, 1)
        y = step[:, 1:].flatten(0, 1)
        rest = y - x @ torch.linalg.lstsq(x, y).solution
        return (rest.var(0) / y.var(0)).numpy()

    known = place[..., :2], action
    return {
        "place and action": share(*known),
        "place, action, last displacement": share(*known, step.roll(1, 1)),
    }
