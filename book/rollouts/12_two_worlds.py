"""How much has to be seen of two worlds, for chapter 12.

An expert's steps are drawn independently, as often as it visits a pair of
square and action. `tabular.identification` learns the reward, with a ridge
for rewards of about 0.3 m.
"""

from dataclasses import replace
from itertools import product

import numpy as np

from grid_worlds import CELLS, wall
from offairl_lite import tabular
from offairl_lite.tabular import (
    MDP,
    occupancy,
    policy_return,
    soft_value_iteration,
)
from offairl_lite.tabular.identification import shared_reward

STEPS = (1_000, 10_000, 100_000, 1_000_000, 10_000_000)
SEEDS = 5
PLANNED = 0.05
"""The temperature of every policy that is planned on a learned reward."""


def record():
    """Return score and correlation by expert, start, worlds and reward."""
    dry = tabular.maze(CELLS, "Left")
    wet = tabular.maze(CELLS, "Left", slip=0.3)
    worlds = {
        "dry": [dry.mdp],
        "dry and wet": [dry.mdp, wet.mdp],
    }
    result = {"steps": STEPS}
    for careful, wide, (name, mdps), of_state in product(
        (True, False), (False, True), worlds.items(), (False, True)
    ):
        key = (
            "careful" if careful else "sloppy",
            "everywhere" if wide else "one start",
            name,
            "r(s)" if of_state else "r(s, a)",
        )
        temperature = 0.05 if careful else 0.3
        result[", ".join(key)] = [
            [
                learned(mdps, dry.reward, temperature, wide, of_state, *run)
                for run in product([steps], range(SEEDS))
            ]
            for steps in STEPS
        ]
    return result


def learned(mdps, truth, temperature, wide, of_state, steps, seed):
    """Return score in the third maze, and correlation with the truth."""
    rng = np.random.default_rng(seed)
    counts = [
        drawn(mdp, truth, temperature, wide, steps // len(mdps), rng)
        for mdp in mdps
    ]
    reward = shared_reward(
        mdps,
        [logs for logs, _ in counts],
        temperature,
        [weights for _, weights in counts],
        ridge=(temperature / 0.3) ** 2,
        of_state=of_state,
    )
    pairs = np.repeat(truth, reward.shape[1])
    return score(reward, truth), np.corrcoef(reward.ravel(), pairs)[0, 1]


def drawn(mdp: MDP, truth, temperature, wide, steps, rng):
    """Return log π estimated from so many steps, and its weights.

    Half a step is added to each action of every square that was visited.
    """
    if wide:
        initial = np.full(mdp.num_states, 1 / mdp.num_states)
        mdp = replace(mdp, initial=initial)
    expert = soft_value_iteration(mdp, truth, temperature).policy
    often = occupancy(mdp, expert)
    count = rng.multinomial(steps, often.ravel() / often.sum())
    count = count.reshape(often.shape) + 0.5
    total = count.sum(1, keepdims=True)
    visited = total > 0.5 * mdp.num_actions
    return np.log(count / total), count * visited


def score(reward, truth):
    """Return 0 for a copy of the first expert, 1 for the third maze's."""
    third = wall()
    dry = tabular.maze(CELLS, "Left").mdp
    copied, best, new = (
        policy_return(
            third, soft_value_iteration(mdp, r, PLANNED).policy, truth
        )
        for mdp, r in ((dry, truth), (third, truth), (third, reward))
    )
    return (new - copied) / (best - copied)
