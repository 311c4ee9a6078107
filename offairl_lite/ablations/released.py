"""What the paper's released code optimises, where that is not the mathematics."""

from dataclasses import dataclass
from typing import Literal

import torch

from offairl_lite.config import Config, DiscriminatorConfig, SACConfig
from offairl_lite.core import policies
from offairl_lite.core.discriminator import Discriminator, Mixing, Transitions, make_discriminator
from offairl_lite.core.networks import TINY
from offairl_lite.core.rewards import log_odds
from offairl_lite.core.shapes import Action, Obs, Params, Vector

Variant = Literal["exact", "released"]


@dataclass(frozen=True)
class ReleasedSACConfig(SACConfig):
    """SAC with the released density, or the released product of primitives, or both."""

    kind = "sac-released"

    log_density: Variant = "released"
    """Density of a squashed action in the discriminator. `released`: the Gaussian density taken
    at the squashed action, without the tanh's Jacobian."""

    composition: Variant = "released"
    """The product of Gaussians; `released`: with standard deviations in the place of variances."""


class ReleasedGaussian(policies.SquashedGaussian):
    """The squashed Gaussian with the density of the released code."""

    def log_prob(self, params: Params, obs: Obs, pre_tanh: Action) -> Vector:
        """Return the Gaussian's log density at the squashed action, without the Jacobian."""
        return policies.gaussian_log_density(torch.tanh(pre_tanh), *self.distribution(params, obs))


class ReleasedProduct(policies.MultiplicativeGaussian):
    """The product of primitives with standard deviations in the place of variances."""

    def distribution(self, params: Params, obs: Obs) -> tuple[Action, Action]:
        """Return μ and log σ of `pre_tanh`, as the released code has them."""
        mean, log_std, weight = self.parts(params, obs)
        precision = weight.unsqueeze(-1) * torch.exp(-log_std)
        total = precision.sum(-2)
        return (precision * mean).sum(-2) / total, (-total.log()).clamp(*self.log_std_range)


class ReleasedDensityOfProduct(policies.MultiplicativeGaussian):
    """The exact product with the density of the released code."""

    log_prob = ReleasedGaussian.log_prob


class ReleasedPolicy(ReleasedProduct):
    """The released product with the density of the released code."""

    log_prob = ReleasedGaussian.log_prob


@policies.make_actor.register
def _(config: ReleasedSACConfig, obs_dim: int, action_dim: int) -> policies.SquashedGaussian:
    exact = policies.make_actor.dispatch(SACConfig)(config, obs_dim, action_dim)
    density = config.log_density == "released"
    if config.primitives is None:
        kind = ReleasedGaussian if density else policies.SquashedGaussian
    elif config.composition == "released":
        kind = ReleasedPolicy if density else ReleasedProduct
    else:
        kind = ReleasedDensityOfProduct if density else policies.MultiplicativeGaussian
    return kind(**vars(exact))


@dataclass(frozen=True)
class OnProbabilityConfig(DiscriminatorConfig):
    """The released penalty."""

    kind = "penalty-on-probability"


class OnProbability(Discriminator):
    """The released penalty: ‖∇_s D‖; s, a, s' and log π have a mixing coefficient each."""

    log_prob_in_penalty = True

    def gradient_norm(self, expert: Transitions, policy: Transitions, mixing: Mixing) -> Vector:
        """Return ‖∇_s D‖ for D = σ(ℓ), which is D (1 - D) ‖∇_s ℓ‖."""
        *shares, share = mixing.split(1, -1)
        obs, action, next_obs = (
            torch.lerp(p, e, c) for p, e, c in zip(policy[:3], expert[:3], shares, strict=True)
        )
        log_prob = torch.lerp(policy.log_prob, expert.log_prob, share.squeeze(-1))
        between = Transitions(obs, action, next_obs, log_prob)
        f, (by_obs, _, _) = self.f_and_gradients(between)
        d = torch.sigmoid(log_odds(f, log_prob))
        square = by_obs.square().sum(-1) * (d * (1 - d)).square()
        return (square + TINY).sqrt()


make_discriminator.register(OnProbabilityConfig, OnProbability)

RELEASE = Config.of(
    learner="sac-released",
    hidden=(256, 256),
    temperature=None,
    log_std_range=(-20.0, 2.0),
    loss="log-ratio",
    discriminator_discount=0.9,
    reward_hidden=(256, 256),
    shaping_hidden=(100, 100),
    discriminator_activation="relu",
    ablation="penalty-on-probability",
    normalise=False,
)
"""What the released code optimises; its absorbing vectors and orthogonal initialisation are not
reproduced."""
