"""Random processes, and what brute force says of them."""

import numpy as np

from offairl_lite.tabular import MDP


def random_mdp(seed=0, states=6, actions=3, discount=0.9, horizon=None):
    rng = np.random.default_rng(seed)
    transition = rng.dirichlet(np.full(states, 0.3), (states, actions))
    return MDP(transition, rng.dirichlet(np.ones(states)), discount, horizon)


def random_policy(mdp, seed=1, timed=False):
    time = (mdp.horizon,) if timed else ()
    rng = np.random.default_rng(seed)
    return rng.dirichlet(np.ones(mdp.num_actions), (*time, mdp.num_states))


def random_reward(mdp, seed=2):
    return np.random.default_rng(seed).normal(size=(mdp.num_states, mdp.num_actions))


def dense(mdp):
    return mdp.transition.toarray().reshape(mdp.num_states, mdp.num_actions, -1)


def deterministic_mdp(horizon):
    goes_to = np.random.default_rng(7).integers(6, size=(6, 3))
    return MDP(np.eye(6)[goes_to], np.full(6, 1 / 6), 1.0, horizon)
