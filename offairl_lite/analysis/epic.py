r"""How far apart two rewards are, whatever their shift, scale and shaping: the EPIC distance.

Gleave et al., "Quantifying Differences in Reward Functions" (2021). A reward is first brought into
a form that potential shaping leaves alone,

$$C(R)(s, a, s') = R(s, a, s') + \mathbb{E}\big[
    \gamma R(s', A, S') - R(s, A, S') - \gamma R(S, A, S')\big],$$

with S, A and S' drawn independently of one another; then two of them are compared by Pearson's
distance $\sqrt{(1 - \rho) / 2}$ over transitions (section 4 of the paper).
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor


class Transitions(NamedTuple):
    """States, actions and next states, row by row."""

    obs: Float[Tensor, "N O"]
    action: Float[Tensor, "N A"]
    next_obs: Float[Tensor, "N O"]


RewardFunction = Callable[
    [Float[Tensor, "N O"], Float[Tensor, "N A"], Float[Tensor, "N O"]], Float[Tensor, "N"]
]
"""R(s, a, s') of transitions."""


def canonical(
    reward: RewardFunction, transitions: Transitions, samples: Transitions, discount: float
) -> Float[Tensor, "N"]:
    """Return the canonically shaped reward of transitions.

    Shaping by any potential adds one and the same constant to it, whatever the samples.

    Args:
        reward: R(s, a, s').
        transitions: where it is wanted, N of them.
        samples: M draws of (S, A, S'), each column independent of the others.
        discount: γ.
    """
    count, draws = len(transitions.obs), len(samples.obs)
    action = samples.action.repeat(count, 1)
    next_obs = samples.next_obs.repeat(count, 1)

    def mean_from(obs: Float[Tensor, "N O"]) -> Float[Tensor, "N"]:
        """E R(s, A, S')."""
        start = obs.repeat_interleave(draws, 0)
        return reward(start, action, next_obs).view(count, draws).mean(1)

    shaping = discount * mean_from(transitions.next_obs) - mean_from(transitions.obs)
    return reward(*transitions) + shaping - discount * reward(*samples).mean()


def pearson_distance(x: Float[Tensor, "N"], y: Float[Tensor, "N"]) -> Float[Tensor, ""]:
    """Return sqrt((1 - ρ) / 2): 0 for the same up to shift and scale, 1 for the opposite.

    Raises:
        ValueError: one of them is constant, so that they have no correlation.
    """
    x, y = x - x.mean(), y - y.mean()
    norms = x.norm() * y.norm()
    if not norms > 0:
        raise ValueError("a reward that is the same for all transitions has no correlation")
    # From ‖x̂ - ŷ‖² = 2 (1 - ρ), which, other than 1 - ρ itself, is exact near ρ = 1.
    return (x / x.norm() - y / y.norm()).norm() / 2


def distances(
    rewards: Sequence[RewardFunction],
    transitions: Transitions,
    samples: Transitions,
    discount: float,
) -> Float[Tensor, "K K"]:
    """Return the EPIC distance of each reward to each, from 0 to 1.

    Args:
        rewards: K functions R(s, a, s').
        transitions: the coverage distribution's, over which they are compared.
        samples: see `canonical`.
        discount: γ of the shaping that makes no difference.

    Raises:
        ValueError: a reward is nothing but shaping on these transitions, up to rounding.
    """
    shaped = [canonical(reward, transitions, samples, discount) for reward in rewards]
    for i, (reward, left) in enumerate(zip(rewards, shaped, strict=True)):
        if not left.std() > 1e-5 * reward(*transitions).std():
            raise ValueError(f"reward {i} is nothing but shaping: there is nothing to compare")
    return torch.stack([torch.stack([pearson_distance(x, y) for y in shaped]) for x in shaped])
