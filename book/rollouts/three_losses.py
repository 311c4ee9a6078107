"""Which rewards survive a change of the world, for the three losses.

The games are those of the page: its own cells are run here.
"""

import json
from pathlib import Path

import numpy as np
from scipy.special import expit, log_softmax

from offairl_lite import tabular

PAGE = Path(__file__).parents[1] / "notes/three_losses.ipynb"
CELLS = ("nwd-rooms", "nwd-ce", "nwd-forms", "nwd-game")
SHARES = (0.01, 0.5)
"""Of random actions in the replay."""
TRIED = {
    "exact logit, α = 1": ("exact", 1.0),
    "exact logit, α = 1.2": ("exact", 1.2),
    "density of the replay, α = 1": ("replay", 1.0),
    "released, α = 1": ("released", 1.0),
    "released, α = 0.2": ("released", 0.2),
}


def record():
    """Return scores in the changed world, by share and what was learned."""
    page = _page()
    world, shut = page["world"], page["rooms"]((4,))
    rooms, worlds = {}, {}
    for share in SHARES:
        reward = page["true_reward"]
        rooms[f"{share}"] = _transfer(page, world, shut, reward, share, 60)
        many = []
        for seed in range(10):
            rng = np.random.default_rng(seed)
            old, new = _random_world(rng), _random_world(rng)
            reward = 2 * rng.normal(size=20)
            many.append(_transfer(page, old, new, reward, share, 40))
        worlds[f"{share}"] = {
            name: [one[name] for one in many] for name in many[0]
        }
    return {"rooms": rooms, "worlds": worlds}


def _page():
    # What the page's cells define.
    cells = json.loads(PAGE.read_text("utf-8"))["cells"]
    source = {cell["id"]: "".join(cell["source"]) for cell in cells}
    names = {
        "np": np,
        "expit": expit,
        "log_softmax": log_softmax,
        "tabular": tabular,
    }
    for cell in CELLS:
        exec(source[cell], names)
    return names


def _random_world(rng, states=20, actions=4):
    p = np.zeros((states, actions, states))
    to = rng.integers(states, size=(states, actions))
    p[np.arange(states)[:, None], np.arange(actions), to] = 1
    return tabular.MDP(p, np.full(states, 1 / states), 0.9)


def _transfer(page, old, new, reward, share, rounds):
    # The score in the new world of each learned reward.
    expert = tabular.soft_value_iteration(old, reward).policy
    learned = {}
    for name, (loss, temperature) in TRIED.items():
        learned[name], log_pi, _ = page["play"](
            old, reward, loss, temperature, share, rounds
        )
    mixed = page["replay"](old, np.exp(log_pi), share)
    ratio = np.log(page["visits"](old, expert) / mixed)
    learned["DAC's f(s, a), α = 0.2"] = ratio
    plans = {
        name: tabular.soft_value_iteration(new, r, 0.0).policy
        for name, r in learned.items()
    }
    plans["the old policy"] = expert
    return {name: _score(new, reward, p) for name, p in plans.items()}


def _score(mdp, reward, policy):
    # True return, from 0 for a random policy to 100 for the best.
    best = tabular.soft_value_iteration(mdp, reward, 0.0).policy
    random = np.full(policy.shape, 1 / policy.shape[1])
    low, high, reached = (
        tabular.policy_return(mdp, p, reward)
        for p in (random, best, policy)
    )
    return 100 * (reached - low) / (high - low)
