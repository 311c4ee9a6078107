"""Two experts on three ants, and what learned rewards say of them."""

from typing import Any

import torch

from offairl_lite import demonstrations
from offairl_lite.core.rollouts import rollout
from offairl_lite.runs import records
from rollouts import RECORDS

ANTS = ("CustomAnt", "DisabledAnt", "DisabledAntReleased")
REWARDS = {
    "whole state": "ant-rewards-demo/implementation-4-mixture",
    "whole state, centred": (
        "ant-rewards-centred-demo/implementation-4-mixture"
    ),
    "DAC": "ant-rewards-demo/dac",
    "velocity": "ant-rewards-demo/implementation-4-velocity",
    "whole state, recipe": "locomotion-demo/CustomAnt-airl",
    "DAC, recipe": "locomotion-demo/CustomAnt-dac",
    "velocity, recipe": (
        "decides-velocity-demo/CustomAnt-released-fixed-short"
    ),
}
GAITS = {
    "helpless": ("CustomAnt", "DisabledAnt"),
    "walk": ("DisabledAnt", "DisabledAnt"),
    "home": ("CustomAnt", "CustomAnt"),
}
"""Of which expert, and on which ant."""
EPISODES = 10


def per_step(reward, episodes):
    """Return the mean learned reward of a step, for each of its seeds."""
    obs, action = (
        torch.as_tensor(x, dtype=torch.float32).flatten(1, 2)
        for x in (episodes.obs, episodes.action)
    )
    seeds = len(reward)
    obs, action = (x.expand(seeds, -1, -1) for x in (obs, action))
    return reward(obs, action).mean(1)


def record() -> dict[str, Any]:
    """Return true returns, and the learned rewards of a step."""
    returns, walks = {}, {}
    for name in ANTS[:2]:
        able = demonstrations.expert(f"offairl/{name}-v0").member(0)
        returns[name] = {}
        for ant in ANTS:
            found = rollout(able, f"offairl/{ant}-v0", (0,), EPISODES)
            returns[name][ant] = float(found.returns.mean())
            walks[name, ant] = found
    paid = {}
    for name, folder in REWARDS.items():
        reward = records.read(RECORDS / folder).reward
        paid[name] = {
            gait: per_step(reward, walks[pair])
            for gait, pair in GAITS.items()
        }
    return {"returns": returns, "per_step": paid}
