r"""The generator's reward: one function a variant, with the expert labelled 1.

A discriminator is a logit $\ell$ with $D = \sigma(\ell)$, so $\log D - \log(1 - D) = \ell$.
AIRL's is $\ell = f - \log \pi$, with $f(s, a, s') = r + \gamma V(s') - V(s)$. GAN-GCL's, of a whole
episode, is the sum of its steps' $r(s, a) - \log \pi$, so that each step's share of it is log odds,
too.
"""

from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import logsigmoid


class Implementation(NamedTuple):
    """A row of the paper's comparison: what r sees, and whether the reward is r or the logit."""

    state_only: bool
    reward_is_logit: bool


IMPLEMENTATIONS = {
    "implementation-1": Implementation(state_only=False, reward_is_logit=True),
    "implementation-2": Implementation(state_only=True, reward_is_logit=True),
    "implementation-3": Implementation(state_only=False, reward_is_logit=False),
    "implementation-4": Implementation(state_only=True, reward_is_logit=False),
}
"""1: log D - log(1 - D) with r(s, a); 2: the same with r(s); 3: r(s, a) itself; 4: r(s) itself."""


def log_odds(
    f: Float[Tensor, "*batch"], log_prob: Float[Tensor, "*batch"]
) -> Float[Tensor, "*batch"]:
    """Return log D - log(1 - D) = f - log π: Implementations 1 and 2, and GAN-GCL."""
    return f - log_prob


def dac(logit: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Return DAC's reward log D - log(1 - D), of either sign."""
    return logit


def gail_survival(logit: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Return -log(1 - D) ≥ 0: every step pays, so to go on is rewarded in itself."""
    return -logsigmoid(-logit)


def gail_termination(logit: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Return log D ≤ 0: every step costs, so to stop is rewarded in itself."""
    return logsigmoid(logit)


OF_LOGIT = {"dac": dac, "gail-survival": gail_survival, "gail-termination": gail_termination}
"""The rewards of a discriminator without log π, by their names in a configuration."""
