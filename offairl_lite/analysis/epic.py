r"""The EPIC distance between two rewards, which ignores their shift, scale and shaping.

Gleave et al., "Quantifying Differences in Reward Functions" (2021). A reward is first brought into
a canonical form that potential shaping does not change,

$$C(R)(s, a, s') = R(s, a, s') + \mathbb{E}\big[
    \gamma R(s', A, S') - R(s, A, S') - \gamma R(S, A, S')\big],$$

with S, A and S' drawn independently of one another. Two canonical rewards are then compared by the
Pearson distance $\sqrt{(1 - \rho) / 2}$ over transitions (section 4 of the paper).
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor


class Transitions(NamedTuple):
    """N transitions, one per row."""

    obs: Float[Tensor, "N O"]
    action: Float[Tensor, "N A"]
    next_obs: Float[Tensor, "N O"]


RewardFunction = Callable[[Tensor, Tensor, Tensor], Float[Tensor, "N"]]
"""A function that returns R(s, a, s') of the three parts of `Transitions`."""


def canonical(
    reward: RewardFunction, transitions: Transitions, samples: Transitions, discount: float
) -> Float[Tensor, "N"]:
    """Return C(R)(s, a, s') of transitions, to which shaping adds the same constant everywhere.

    Samples are draws of (S, A, S'), each column independent of the others.
    """
    count, draws = len(transitions.obs), len(samples.obs)
    action = samples.action.repeat(count, 1)
    next_obs = samples.next_obs.repeat(count, 1)

    def mean_from(obs):  # E R(s, A, S')
        start = obs.repeat_interleave(draws, 0)
        return reward(start, action, next_obs).view(count, draws).mean(1)

    shaping = discount * mean_from(transitions.next_obs) - mean_from(transitions.obs)
    return reward(*transitions) + shaping - discount * reward(*samples).mean()


def pearson_distance(x: Float[Tensor, "N"], y: Float[Tensor, "N"]) -> Float[Tensor, ""]:
    """Return sqrt((1 - ρ) / 2): 0 for equal, 1 for opposite; ValueError if one is constant."""
    x, y = x - x.mean(), y - y.mean()
    norms = x.norm() * y.norm()
    if not norms > 0:
        raise ValueError("a reward that is the same for all transitions has no correlation")
    # From ‖x̂ - ŷ‖² = 2 (1 - ρ): near ρ = 1 this loses no digits, as 1 - ρ itself would.
    return (x / x.norm() - y / y.norm()).norm() / 2


def distances(
    rewards: Sequence[RewardFunction],
    transitions: Transitions,
    samples: Transitions,
    discount: float,
) -> Float[Tensor, "K K"]:
    """Return the EPIC distance of each pair of rewards, from 0 to 1, over these transitions.

    `samples` and `discount` are those of `canonical`. ValueError: a reward is mere shaping.
    """
    shaped = [canonical(reward, transitions, samples, discount) for reward in rewards]
    for i, (reward, left) in enumerate(zip(rewards, shaped, strict=True)):
        if not left.std() > 1e-5 * reward(*transitions).std():
            why = "is nothing but shaping on these transitions"
            raise ValueError(f"reward {i} {why}: leave it out")
    return torch.stack([torch.stack([pearson_distance(x, y) for y in shaped]) for x in shaped])
