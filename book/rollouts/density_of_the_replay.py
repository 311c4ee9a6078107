"""Of the note on the density of the replay: how probable actions are.

How probable the steps of the expert and of the warm-up are to the policies
at the end of training, on the maze and on HalfCheetah; and how learned
rewards rank 25 imitators on the maze.
"""

import math
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from scipy.stats import spearmanr
from torch import Tensor

from offairl_lite import demonstrations, envs
from offairl_lite.config import Config
from offairl_lite.core.policies import (
    Policy,
    defensive_log_density,
    unsquash,
)
from offairl_lite.core.rng import Rng
from offairl_lite.core.rollouts import rollout
from offairl_lite.runs import records
from rollouts import RECORDS

QUANTILES = 200
"""Number of parts into which the densities are divided for the figure."""


def record() -> dict[str, Any]:
    """Return what the note says of densities and of ranks."""
    expert = demonstrations.load("HalfCheetah-v5", experts=1)
    shown = expert.transitions
    return {
        "share beyond 0.9": (shown.action.abs() > 0.9).float().mean(),
        "median log π": {
            "maze": medians(
                "maze-imitation-demo",
                demonstrations.load("offairl/PointMazeLeft-v0", 50),
            ),
            "HalfCheetah": medians(
                "locomotion-first-short-demo/HalfCheetah-airl", expert
            ),
        },
        "mixture": mixture(shown.obs, shown.action),
        "rank correlations": ranks(),
    }


def log_prob_of(
    policy: Policy,
    obs: Float[Tensor, "N obs"],
    action: Float[Tensor, "N action"],
    count: int = 1_000,
) -> Float[Tensor, "S count"]:
    """Return log π of the first actions, each in its state."""
    obs, action = (
        x[:count].expand(len(policy), -1, -1) for x in (obs, action)
    )
    obs = policy.normaliser(obs)
    return policy.actor.log_prob(policy.params, obs, unsquash(action))


def warm_up(
    config: Config, motors: int, steps: int = 1_000
) -> Iterator[Tensor]:
    """Return observations and random actions, as a training begins."""
    rng, each, rows = Rng([0]), 1 / config.schedule.random_hold, []
    with closing(envs.make(config.env_id, 1, 0)) as env:
        obs, _ = env.reset()
        for _ in range(steps):
            if not rows or rng.uniform(1).item() < each:
                action = 2 * rng.uniform(motors) - 1
            rows.append((torch.tensor(obs, dtype=torch.float32), action))
            obs, _, terminated, truncated, _ = env.step(action.numpy())
            if (done := terminated | truncated).any():
                obs, _ = env.reset(options={"reset_mask": done})
    return (torch.cat(part) for part in zip(*rows, strict=True))


def medians(name: str, shown: demonstrations.Demonstrations) -> dict:
    """Return each seed's median log π, of the expert's and random steps."""
    run, steps = records.read(RECORDS / name), shown.transitions
    motors = steps.action.shape[1]
    sides = {
        "expert": (steps.obs, steps.action),
        "warm-up": warm_up(run.config, motors),
    }
    return {
        side: log_prob_of(run.policy, *pair).median(1).values
        for side, pair in sides.items()
    }


def mixture(
    obs: Float[Tensor, "N obs"], action: Float[Tensor, "N action"]
) -> dict[str, Any]:
    """Return how the mixture sees the expert's and its own actions."""
    run = records.read(
        RECORDS / "locomotion-first-short-demo/HalfCheetah-airl-mixture"
    )
    w = run.config.schedule.learning_starts / run.config.total_steps
    floor = math.log(w) - 6 * math.log(2)
    exact = log_prob_of(run.policy, obs, action)
    defended = defensive_log_density(exact, w, action_dim=6)
    policy, noise = run.policy, Rng(run.seeds).normal(1_000, 6)
    places = policy.normaliser(obs[:1_000].expand(5, -1, -1))
    own = policy.actor.sample(policy.params, places, noise)[1]
    longer = records.read(
        RECORDS / "locomotion-first-demo/HalfCheetah-airl-mixture"
    )
    later = log_prob_of(longer.policy, obs, action)
    shares = np.linspace(0, 1, QUANTILES + 1)
    return {
        "floor": floor,
        "lowest": defended.min(),
        "median exact": exact.median(),
        "median mixture": defended.median(),
        "below the floor": (exact < floor).float().mean(),
        "own above the floor": (own > floor).float().mean(),
        "later above the floor": (later > floor).float().mean(),
        "quantiles": {
            "exact": np.quantile(exact, shares),
            "mixture": np.quantile(defended, shares),
        },
    }


def ranks() -> list[float]:
    """Return how each of five learned rewards ranks 25 imitators.

    That is the rank correlation with the true return, over the episodes
    of five seeds each of five variants of the maze's training.
    """
    reward = records.read(RECORDS / "maze-imitation-demo").reward
    true, learned = [], []
    for variant in ("", "-raw", "-fresh", "-2", "-released-loss"):
        run = records.read(RECORDS / f"maze-imitation{variant}-demo")
        walks = rollout(
            run.policy, run.config.env_id, run.seeds, episodes=2
        )
        obs = torch.as_tensor(walks.obs, dtype=torch.float32).flatten(0, 2)
        r = reward(obs.expand(5, -1, -1)).numpy()
        true.append(walks.returns.ravel())
        learned.append(r.reshape(5, -1, walks.obs.shape[2]).sum(-1))
    returns, values = np.concatenate(true), np.concatenate(learned, 1)
    return [spearmanr(returns, each).statistic for each in values]
