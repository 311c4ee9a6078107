"""What rewards of sampled paths do, for the note on unvisited states."""

from dataclasses import replace

import numpy as np
from scipy.sparse import eye_array

from offairl_lite import tabular

ALPHA = 0.05


def record():
    """Return true returns of five samples each, and the worst reward."""
    left, right = (tabular.maze(20, side) for side in ("Left", "Right"))
    S = left.mdp.num_states
    expert = tabular.soft_value_iteration(left.mdp, left.reward, ALPHA)
    starts = {
        "the bottom": left.mdp,
        "everywhere": replace(left.mdp, initial=np.full(S, 1 / S)),
    }
    returns, worst = {}, (np.inf, None)
    for name, process in starts.items():
        returns[name] = []
        for seed in range(5):
            rng = np.random.default_rng(seed)
            paths = tabular.sample(
                process, expert.policy, 50, rng, length=400
            )
            reward = _reward(process, paths)
            moved = tabular.soft_value_iteration(right.mdp, reward, ALPHA)
            true = tabular.policy_return(
                right.mdp, moved.policy, left.reward
            )
            returns[name].append(true)
            worst = min(worst, (true, reward), key=lambda pair: pair[0])
    return {"returns": returns, "worst reward": worst[1]}


def _reward(process, paths):
    # r(s) of greatest likelihood, with a small penalty on the weights.
    visits = tabular.empirical_occupancy(process, paths)
    each = eye_array(process.num_states)
    return tabular.maxent_irl(
        process, visits, each, ALPHA, penalty=0.1, iterations=60
    ).reward
