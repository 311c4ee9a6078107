"""Roll-outs and short trainings of Hopper: settings that failed."""

from typing import Any

import numpy as np
import torch

from offairl_lite import demonstrations
from offairl_lite.config import CORRECTED
from offairl_lite.core import absorbing
from offairl_lite.core.loop import train
from offairl_lite.core.networks import Normaliser, StackedMLP
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rng import Rng
from offairl_lite.core.rollouts import rollout
from offairl_lite.runs import records
from rollouts import RECORDS

MODES = ("none", "bootstrap", "analytic")
LONG = {
    "DAC": "Hopper-dac",
    "AIRL, exact": "Hopper-airl",
    "AIRL, mixture": "Hopper-airl-mixture",
    "AIRL, mixture, α = 1": "Hopper-airl-soft",
}
SPEED = {"Hopper": 5, "Walker2d": 8, "HalfCheetah": 8}
"""The forward speed of the torso among the observations."""
SETTINGS = CORRECTED.change(
    env_id="Hopper-v5",
    reward="frozen",
    total_steps=2_000,
    learning_starts=1_000,
    train_every=250,
    batch_size=64,
    hidden=(64, 64),
    discount=0.95,
    temperature=0.05,
    target_rate=0.02,
    eval_every=500,
    eval_episodes=3,
)

pays, seeds = np.repeat([1.0, -1.0], 5), range(10)  # five seeds each


def constant(obs_dim):
    "A frozen reward that is the same everywhere: a layer's bias."
    net = StackedMLP((obs_dim, 1))
    params = torch.zeros(len(pays), net.num_params)
    params[:, 0] = torch.as_tensor(pays)
    scaling = Normaliser.identity(len(pays), obs_dim)
    return Reward("Hopper-v5", net, True, params, scaling)


def gaits(folder: str, episodes: int) -> dict[str, Any]:
    """Return the mean speeds and the lengths of a policy's episodes."""
    run = records.read(RECORDS / folder)
    found = rollout(run.policy, run.config.env_id, run.seeds, episodes)
    place = SPEED[run.config.env_id.removesuffix("-v5")]
    speed = found.obs[..., place].sum(-1) / found.lengths
    return {"speed": speed, "lengths": found.lengths}


def pay(name: str) -> dict[str, Any]:
    """Return what a learned reward pays for a step, less than for the end.

    On average for a demonstrated step and, unless its policy was not kept,
    for the mode's own steps, where α times the entropy is `entropy`.
    """
    run = records.read(RECORDS / f"locomotion-first-demo/{LONG[name]}")
    moves = demonstrations.load("Hopper-v5", experts=1).transitions
    end = absorbing.absorbing_state(torch.zeros(3, 1, 12))
    r_end = run.reward(end, torch.zeros(3, 1, 3))[:, 0]
    theirs = run.reward(
        absorbing.extend(moves.obs).expand(3, -1, -1),
        moves.action.expand(3, -1, -1),
    )
    found = {"demonstrated": theirs.mean(1) - r_end}
    if name == "AIRL, exact":
        return found
    episodes = rollout(run.policy, "Hopper-v5", run.seeds, 1)
    obs = torch.from_numpy(episodes.obs[:, 0]).float()
    obs = absorbing.extend(obs)
    alive = torch.from_numpy(episodes.running[:, 0])
    policy, noise = run.policy, Rng(run.seeds).normal(obs.shape[1], 3)
    with torch.no_grad():
        u, log_prob = policy.actor.sample(
            policy.params, policy.normaliser(obs), noise
        )
    last = [row for row in run.rows if row.step == run.steps[-1]]
    alpha = np.array([row.metrics["temperature"] for row in last])
    paid, entropy = (
        (x * alive).sum(1) / alive.sum(1)
        for x in (run.reward(obs, torch.tanh(u)), -log_prob)
    )
    return found | {
        "own": paid - r_end,
        "entropy": alpha * entropy.numpy(),
        "lengths": episodes.lengths[:, 0],
    }


def of_constants() -> dict[str, Any]:
    """Train on +1 in seeds 0 to 4, and on −1 in 5 to 9, for each end."""
    lengths, ends = {}, {}
    for mode in MODES:
        frozen = constant(11 + (mode != "none"))  # the indicator
        config = SETTINGS.change(absorbing=mode)
        run = train(config, seeds, frozen_reward=frozen)
        sums = np.reshape(
            [row.learned_return for row in run.rows], (-1, 10)
        )
        lengths[mode] = sums.T / pays[:, None]
        ends[mode] = run.returns[:, -1]
    begun = np.array([row.episodes for row in run.rows[:10]])
    return {
        "steps": run.steps,
        "lengths": lengths,
        "returns": ends,
        "random": float(1_000 / begun.mean()),  # steps of the warm-up
    }


def record() -> dict[str, Any]:
    """Return all of it."""
    shown = demonstrations.load("Hopper-v5", experts=1)
    return {
        "demonstrations": {
            "lengths": shown.lengths,
            "returns": shown.returns,
        },
        "gaits": {
            mode: gaits(f"hopper-absorbing-demo/dac-{mode}", 2)
            for mode in MODES[1:]
        },
        "warm": {
            task: gaits(f"locomotion-first-demo/{task}-airl-soft", 1)
            for task in ("Walker2d", "HalfCheetah")
        },
        "pay": {name: pay(name) for name in LONG},
        "constant": of_constants(),
    }
