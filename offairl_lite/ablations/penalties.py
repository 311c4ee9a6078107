"""Other ways to keep a discriminator from being too steep or too sure (chapter 6)."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from offairl_lite.config import DiscriminatorConfig
from offairl_lite.core.discriminator import Discriminator, Mixing, Transitions, make_discriminator
from offairl_lite.core.networks import TINY, StackedMLP, zeros
from offairl_lite.core.rewards import Reward, log_odds
from offairl_lite.core.rng import Rng
from offairl_lite.core.shapes import Layout, Metrics, OtherParams, Params, Vector


@dataclass(frozen=True)
class OneSidedConfig(DiscriminatorConfig):
    """A one-sided penalty."""

    kind = "one-sided"


class OneSided(Discriminator):
    """Punishes only slopes above 1, max(0, ‖∇f‖ - 1)²: flat is no fault (Petzka et al. 2018)."""

    def gradient_norm(self, expert: Transitions, policy: Transitions, mixing: Mixing) -> Vector:
        """Return ‖∇f‖, or 1 where it is smaller."""
        return super().gradient_norm(expert, policy, mixing).clamp(min=1)


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


Vectors = Float[Tensor, "S V"]  #: A unit vector for each layer, as long as its output, end to end.


def init_vectors(net: StackedMLP, rng: Rng) -> Vectors:
    """Draw unit vectors for `power_iteration`."""
    return _unit(rng.normal(sum(net.sizes[1:])).split(net.sizes[1:], 1))


@torch.no_grad()
def power_iteration(net: StackedMLP, params: Params, vectors: Vectors) -> Vectors:
    """Turn unit vectors towards each weight matrix's first right singular vector."""
    pairs = zip(net.layers(params), vectors.split(net.sizes[1:], 1), strict=True)
    return _unit([(w.transpose(1, 2) @ (w @ u.unsqueeze(-1))).squeeze(-1) for (_, w), u in pairs])


def spectrally_normalised(net: StackedMLP, params: Params, vectors: Vectors) -> Params:
    """Return `params` with each weight matrix divided by its largest singular value.

    That is ‖W u‖ for `power_iteration`'s u, held constant in gradients (Miyato et al. 2018).
    """
    parts = []
    pairs = zip(net.layers(params), vectors.split(net.sizes[1:], 1), strict=True)
    for (bias, weight), u in pairs:
        norm = torch.linalg.vector_norm(weight @ u.unsqueeze(-1), dim=(1, 2), keepdim=True)
        parts += [bias.squeeze(1), (weight / norm.clamp(min=TINY)).flatten(1)]
    return torch.cat(parts, 1)


def _unit(parts: Sequence[Tensor]) -> Tensor:
    return torch.cat([normalize(part, dim=1, eps=TINY) for part in parts], 1)


@dataclass(frozen=True)
class SpectralNormConfig(DiscriminatorConfig):
    """Spectral normalisation."""

    kind, selects = "spectral-norm", False


class SpectralNorm(Discriminator):
    """Divides each weight matrix of r and V by its largest singular value: slopes are at most 1."""

    def __init__(self, config: DiscriminatorConfig, layout: Layout) -> None:
        super().__init__(config, layout)
        nets = self.reward_net, self.value_net
        self.vectors = [zeros(layout, sum(net.sizes[1:])) for net in nets]
        self.state |= zip(("reward.vectors", "value.vectors"), self.vectors, strict=True)

    @torch.no_grad()
    def init(self, rng: Rng, reward: Reward | None = None) -> None:
        """Draw the initial weights, and vectors for the power iteration."""
        super().init(rng, reward)
        for vectors, net in zip(self.vectors, self.trained, strict=True):
            vectors.copy_(init_vectors(net, rng))

    @property
    def weights(self) -> tuple[OtherParams, OtherParams]:
        """The weights of `reward_net` and `value_net`, made of those that are trained."""
        of_reward, of_value = self.vectors
        reward = spectrally_normalised(self.reward_net, self.reward_params, of_reward)
        return reward, spectrally_normalised(self.value_net, self.value_params, of_value)

    def update(self, expert: Transitions, policy: Transitions, mixing: Mixing) -> Metrics:
        """Turn the vectors towards the singular ones, and take one step down the loss."""
        of_reward, of_value = self.vectors
        of_reward.copy_(power_iteration(self.reward_net, self.reward_params, of_reward))
        of_value.copy_(power_iteration(self.value_net, self.value_params, of_value))
        return super().update(expert, policy, mixing)


make_discriminator.register(OneSidedConfig, OneSided)
make_discriminator.register(OnProbabilityConfig, OnProbability)
make_discriminator.register(SpectralNormConfig, SpectralNorm)
