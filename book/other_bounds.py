"""Other ways to keep a discriminator from being too steep or too sure.

Only the note on penalties uses them. This module is a command line that
knows them, for one run at a time, in one process:

    PYTHONPATH=book python -m other_bounds run maze-imitation \\
        --gradient-penalty 0 --ablation spectral-norm
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize, softplus

from offairl_lite import experiments
from offairl_lite.config import Config, DiscriminatorConfig
from offairl_lite.config.settings import Count, Positive
from offairl_lite.core.discriminator import (
    Discriminator,
    Loss,
    Mixing,
    Transitions,
    airl_loss,
    both_sides,
    diagnostics,
    make_discriminator,
)
from offairl_lite.core.networks import TINY, StackedMLP, zeros
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rng import Rng
from offairl_lite.core.shapes import (
    Layout,
    Metrics,
    OtherParams,
    Params,
    PerMember,
    Scalar,
    Vector,
)
from offairl_lite.scale import Scale

VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "none": {"gradient_penalty": 0.0},
    "logit": {},
    "one-sided": {"ablation": "one-sided"},
    "probability": {"ablation": "penalty-on-probability"},
    "spectral": {"gradient_penalty": 0.0, "ablation": "spectral-norm"},
    "bottleneck": {
        "gradient_penalty": 0.0,
        "ablation": "bottleneck",
        "bottleneck_rate": 1e-3,
    },
}


def configure(variant: str, scale: Scale) -> Config:
    """Return what a variant of the note trains with."""
    base = experiments.configure("maze-imitation", scale)
    return base.change(**VARIANTS[variant])


@dataclass(frozen=True)
class OneSidedConfig(DiscriminatorConfig):
    """A one-sided penalty."""

    kind = "one-sided"


class OneSided(Discriminator):
    """Punishes only slopes above 1, max(0, ‖∇f‖ - 1)²: flat is no fault.

    Source: Petzka et al. (2018).
    """

    def gradient_norm(
        self, expert: Transitions, policy: Transitions, mixing: Mixing
    ) -> Vector:
        """Return ‖∇f‖, or 1 where it is smaller."""
        return super().gradient_norm(expert, policy, mixing).clamp(min=1)


# A unit vector for each layer, as long as its output, end to end.
Vectors = Float[Tensor, "S V"]


def init_vectors(net: StackedMLP, rng: Rng) -> Vectors:
    """Draw unit vectors for `power_iteration`."""
    return _unit(rng.normal(sum(net.sizes[1:])).split(net.sizes[1:], 1))


@torch.no_grad()
def power_iteration(
    net: StackedMLP, params: Params, vectors: Vectors
) -> Vectors:
    """Turn unit vectors towards each matrix's first singular vector."""
    pairs = zip(
        net.layers(params), vectors.split(net.sizes[1:], 1), strict=True
    )
    return _unit(
        [
            (w.transpose(1, 2) @ (w @ u.unsqueeze(-1))).squeeze(-1)
            for (_, w), u in pairs
        ]
    )


def spectrally_normalised(
    net: StackedMLP, params: Params, vectors: Vectors
) -> Params:
    """Return weights, each matrix divided by its largest singular value.

    That is ‖W u‖ for `power_iteration`'s u, held constant in gradients
    (Miyato et al. 2018).
    """
    parts = []
    pairs = zip(
        net.layers(params), vectors.split(net.sizes[1:], 1), strict=True
    )
    for (bias, weight), u in pairs:
        norm = torch.linalg.vector_norm(
            weight @ u.unsqueeze(-1), dim=(1, 2), keepdim=True
        )
        parts += [
            bias.squeeze(1),
            (weight / norm.clamp(min=TINY)).flatten(1),
        ]
    return torch.cat(parts, 1)


def _unit(parts: Sequence[Tensor]) -> Tensor:
    return torch.cat(
        [normalize(part, dim=1, eps=TINY) for part in parts], 1
    )


@dataclass(frozen=True)
class SpectralNormConfig(DiscriminatorConfig):
    """Spectral normalisation."""

    kind, selects = "spectral-norm", False


class SpectralNorm(Discriminator):
    """r and V whose weight matrices have no singular value above 1.

    So their slopes are at most 1.
    """

    def __init__(self, config: DiscriminatorConfig, layout: Layout) -> None:
        super().__init__(config, layout)
        nets = self.reward_net, self.value_net
        self.vectors = [zeros(layout, sum(net.sizes[1:])) for net in nets]
        self.state |= zip(
            ("reward.vectors", "value.vectors"), self.vectors, strict=True
        )

    @torch.no_grad()
    def init(self, rng: Rng, reward: Reward | None = None) -> None:
        """Draw the initial weights, and vectors for the power iteration."""
        super().init(rng, reward)
        for vectors, net in zip(self.vectors, self.trained, strict=True):
            vectors.copy_(init_vectors(net, rng))

    @property
    def weights(self) -> tuple[OtherParams, OtherParams]:
        """The weights of r and V, made of those that are trained."""
        of_reward, of_value = self.vectors
        reward = spectrally_normalised(
            self.reward_net, self.reward_params, of_reward
        )
        return reward, spectrally_normalised(
            self.value_net, self.value_params, of_value
        )

    def update(
        self, expert: Transitions, policy: Transitions, mixing: Mixing
    ) -> Metrics:
        """Turn the vectors, and take one step down the loss."""
        of_reward, of_value = self.vectors
        of_reward.copy_(
            power_iteration(self.reward_net, self.reward_params, of_reward)
        )
        of_value.copy_(
            power_iteration(self.value_net, self.value_params, of_value)
        )
        return super().update(expert, policy, mixing)


def expected_cross_entropy(
    expert_logit: Vector,
    policy_logit: Vector,
    expert_variance: Vector,
    policy_variance: Vector,
    quadrature: Float[Tensor, "2 K"],
) -> PerMember:
    """Return the mean cross-entropy of Gaussian logits."""
    nodes, weights = quadrature
    sides = (expert_logit, expert_variance), (policy_logit, policy_variance)
    expert, policy = (
        m + (v + TINY).sqrt() * nodes.view(-1, 1, 1) for m, v in sides
    )
    return weights @ (softplus(-expert) + softplus(policy)).mean(-1)


def gauss_hermite(count: int = 32) -> Float[Tensor, "2 K"]:
    """Return nodes and weights of a standard normal mean.

    The mean of a softplus is exact to 1e-3 up to σ = 5.
    """
    nodes, weights = np.polynomial.hermite_e.hermegauss(count)
    return torch.tensor(
        np.stack([nodes, weights / weights.sum()]), dtype=torch.float32
    )


class Code:
    """A scalar that is linear in a code z ~ N(μ(x), σ(x)²).

    The code has `size` numbers. At z = μ the scalar is that of `net`.
    """

    def __init__(self, net: StackedMLP, size: int) -> None:
        self.net, self.size = net, size
        self.encoder = StackedMLP(
            (*net.sizes[:-1], 2 * size), net.activation
        )  # x to μ, log σ
        self.head = StackedMLP((size, 1))  # z to the scalar

    def init(self, rng: Rng) -> Params:
        """Draw the weights of encoder and head."""
        return torch.cat([self.encoder.init(rng), self.head.init(rng)], 1)

    @property
    def num_params(self) -> int:
        """P: weights of encoder and head."""
        return self.encoder.num_params + self.head.num_params

    def _parts(self, params: Params) -> tuple[OtherParams, Tensor, Tensor]:
        """Return the encoder's weights, and the head's bias and weight."""
        encoder, head = params.split(
            [self.encoder.num_params, self.head.num_params], 1
        )
        return encoder, *self.head.layers(head)[0]

    def at_mean(self, params: Params) -> OtherParams:
        """Return the weights of `net`; head and μ are one linear layer."""
        encoder, head_bias, head_weight = self._parts(params)
        *_, (bias, weight) = self.encoder.layers(encoder)
        bias = bias[..., : self.size] @ head_weight + head_bias
        weight = weight[..., : self.size] @ head_weight
        kept = self.net.num_params - self.net.sizes[-2] - 1
        return torch.cat(
            [encoder[:, :kept], bias.flatten(1), weight.flatten(1)], 1
        )

    def spread(
        self, params: Params, x: Float[Tensor, "S B in"]
    ) -> tuple[Vector, Vector]:
        """Return its variance, and KL(N(μ, σ²) ‖ N(0, I)) in nats."""
        encoder, _, head_weight = self._parts(params)
        mean, log_std = self.encoder(encoder, x).chunk(2, -1)
        variance = (2 * log_std).exp()
        divergence = (mean.square() + variance - 1).sum(
            -1
        ) / 2 - log_std.sum(-1)
        return (variance * head_weight.square().transpose(1, 2)).sum(
            -1
        ), divergence


@dataclass(frozen=True)
class BottleneckConfig(DiscriminatorConfig):
    """The settings of a discriminator with a bottleneck."""

    kind, selects = "bottleneck", False

    bottleneck: Positive = 0.5
    """I_c: the most nats that a transition's code may carry on average."""
    bottleneck_size: Count = 8
    """Dimension of the code of r's input, and of that of V's."""
    bottleneck_rate: Positive = 1e-5
    """Step of the dual ascent that enforces `bottleneck`."""


class Bottleneck(Discriminator):
    """r and V see independent codes, of I_c nats on average at most.

    `multiplier`, β, is the price of a nat; dual ascent raises it while
    there are too many (Peng et al. 2019).
    """

    config: BottleneckConfig

    def __init__(self, config: BottleneckConfig, layout: Layout) -> None:
        super().__init__(
            config, layout, lambda net: Code(net, config.bottleneck_size)
        )
        self.multiplier = self.state["multiplier"] = zeros(layout, 1)
        self.quadrature = gauss_hermite().to(layout.device)

    @property
    def weights(self) -> tuple[OtherParams, OtherParams]:
        """The weights of r and V at the code's mean."""
        of_reward, of_value = self.trained
        return of_reward.at_mean(self.reward_params), of_value.at_mean(
            self.value_params
        )

    def spread(self, transitions: Transitions) -> tuple[Vector, Vector]:
        """Return the variance of f, and the code's divergence in nats."""
        of_reward, of_value = self.trained
        x = self.reward_input(transitions)
        variance, divergence = of_reward.spread(self.reward_params, x)
        if not self.is_airl:
            return variance, divergence
        states = torch.cat([transitions.obs, transitions.next_obs], 1)
        both = of_value.spread(self.value_params, states)
        (now, then), (divergence_now, divergence_then) = (
            part.chunk(2, 1) for part in both
        )
        variance = variance + now + self.config.discount**2 * then
        return variance, divergence + divergence_now + divergence_then

    def loss(
        self, expert: Transitions, policy: Transitions, mixing: Mixing
    ) -> tuple[Scalar, Metrics]:
        """Return the expected loss plus β (KL - I_c)."""
        expert_logit, policy_logit = self.logits(expert, policy)
        grad_norm = self.gradient_norm(expert, policy, mixing)
        variance, divergence = self.spread(both_sides(expert, policy))
        of_expert, of_policy = variance.chunk(2, 1)
        expected = expected_cross_entropy(
            expert_logit,
            policy_logit,
            of_expert,
            of_policy,
            self.quadrature,
        )
        weight = self.config.gradient_penalty
        penalty = airl_loss(
            expert_logit, policy_logit, grad_norm, weight
        ).penalty
        loss = Loss(expected + weight * penalty, expected, penalty)
        excess = divergence.mean(-1) - self.config.bottleneck
        multiplier = self.multiplier.squeeze(-1)
        metrics = diagnostics(loss, expert_logit, policy_logit)
        metrics |= {
            "excess": excess.detach(),
            "multiplier": multiplier.clone(),
        }
        return (loss.total + multiplier * excess).sum(), metrics

    def update(
        self, expert: Transitions, policy: Transitions, mixing: Mixing
    ) -> Metrics:
        """Take one step down the loss, and one up with the multiplier."""
        metrics = super().update(expert, policy, mixing)
        with torch.no_grad():
            ascent = self.config.bottleneck_rate * metrics[
                "excess"
            ].unsqueeze(-1)
            self.multiplier.add_(ascent).clamp_(min=0)
        return metrics


make_discriminator.register(OneSidedConfig, OneSided)
make_discriminator.register(SpectralNormConfig, SpectralNorm)
make_discriminator.register(BottleneckConfig, Bottleneck)


if __name__ == "__main__":
    from offairl_lite.runs import cli

    cli.main()
