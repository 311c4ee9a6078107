r"""The discriminator: AIRL's, which contains a reward, and GAIL's, which is one.

It tells the expert's transitions (label 1) from the policy's (label 0). AIRL's logit is

$$\ell = f(s, a, s') - \log \pi(a|s), \qquad f = r_\psi + \gamma V_\omega(s') - V_\omega(s),$$

with $r_\psi(s)$ or $r_\psi(s, a)$. GAIL's and DAC's is the special case $\ell = r_\psi(s, a)$: no
shaping, no log π. GAN-GCL's judges an episode at once: $\ell = \sum_t r_\psi(s_t, a_t) - \log
\pi(a_t|s_t)$.
"""

from dataclasses import dataclass, replace
from os import PathLike
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import softplus

from offairl_lite.config import Config
from offairl_lite.core.absorbing import fit
from offairl_lite.core.networks import (
    TINY,
    Adam,
    Bottleneck,
    Normaliser,
    StackedMLP,
    descend,
    load_weights,
    optimizer_states,
    save_weights,
)
from offairl_lite.core.replay import Batch
from offairl_lite.core.rewards import IMPLEMENTATIONS, OF_LOGIT, Implementation, log_odds
from offairl_lite.core.rng import Streams


def shaped_reward(
    r: Float[Tensor, "*batch"],
    value: Float[Tensor, "*batch"],
    next_value: Float[Tensor, "*batch"],
    discount: float,
) -> Float[Tensor, "*batch"]:
    """Return f = r + γ V(s') - V(s) (Fu et al. 2018, equation 4)."""
    return r + discount * next_value - value


def binary_cross_entropy(
    expert_logit: Float[Tensor, "*S B"], policy_logit: Float[Tensor, "*S B"]
) -> Float[Tensor, "*S"]:
    """Return -E_expert log D - E_policy log(1 - D), for D = σ(logit)."""
    return (softplus(-expert_logit) + softplus(policy_logit)).mean(-1)


def entropy(logit: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Return the entropy, in nats, of D = σ(logit): log 2 where it cannot tell, 0 where it can."""
    return softplus(logit) - logit * torch.sigmoid(logit)


def per_episode(logit: Float[Tensor, "S B"], horizon: int) -> Float[Tensor, "S E"]:
    """Return the sum of the logits of each `horizon` steps (Finn et al. 2016)."""
    return logit.unflatten(1, (-1, horizon)).sum(-1)


def gradient_penalty(
    square: Float[Tensor, "S B"], sides: Literal["two", "one"] = "two"
) -> Float[Tensor, "S"]:
    """Return E (‖∇‖ - 1)², from ‖∇‖² (Gulrajani et al. 2017).

    One-sided it is E max(0, ‖∇‖ - 1)²: flat is no fault (Petzka et al. 2018).
    """
    # The root's slope at 0 must be finite.
    excess = (square + TINY).sqrt() - 1
    return (excess if sides == "two" else excess.relu()).square().mean(-1)


def expected_cross_entropy(
    expert_logit: Float[Tensor, "S B"],
    policy_logit: Float[Tensor, "S B"],
    expert_variance: Float[Tensor, "S B"],
    policy_variance: Float[Tensor, "S B"],
    quadrature: Float[Tensor, "2 K"],
) -> Float[Tensor, "S"]:
    """Return the mean of `binary_cross_entropy` for Gaussian logits, of these means and variances.

    Args:
        expert_logit: means on the expert's side.
        policy_logit: means on the policy's side.
        expert_variance: of the expert's logits.
        policy_variance: of the policy's logits.
        quadrature: nodes and weights, as of `gauss_hermite`.
    """
    nodes, weights = quadrature
    sides = (expert_logit, expert_variance), (policy_logit, policy_variance)
    logits = [m + (v + TINY).sqrt() * nodes.view(-1, 1, 1) for m, v in sides]
    return weights @ binary_cross_entropy(*logits)


def gauss_hermite(count: int = 32) -> Float[Tensor, "2 K"]:
    """Return nodes and weights of the mean over a standard normal variable.

    With 32, the mean softplus of a normal variable is exact to 1e-3 up to a spread of 5.
    """
    nodes, weights = np.polynomial.hermite_e.hermegauss(count)
    return torch.tensor(np.stack([nodes, weights / weights.sum()]), dtype=torch.float32)


@dataclass(frozen=True)
class Reward:
    """A population of learned rewards, frozen: r(s) or r(s, a).

    Args:
        env_id: the task it was learned on.
        net: the architecture.
        state_only: whether it sees the state alone.
        params: its weights.
        normaliser: how it scales observations.
    """

    env_id: str
    net: StackedMLP
    state_only: bool
    params: Float[Tensor, "S P"]
    normaliser: Normaliser

    def __len__(self) -> int:
        return len(self.params)

    def member(self, *index: int) -> "Reward":
        """Return the population of these members alone."""
        params, normaliser = self.params[list(index)], self.normaliser.member(*index)
        return replace(self, params=params, normaliser=normaliser)

    def to(self, device: str | torch.device) -> "Reward":
        """Return the same rewards on a device."""
        params, normaliser = self.params.to(device), self.normaliser.to(device)
        return replace(self, params=params, normaliser=normaliser)

    @torch.no_grad()
    def __call__(
        self, obs: Float[Tensor, "S B O"], action: Float[Tensor, "S B A"] | None = None
    ) -> Float[Tensor, "S B"]:
        """Return r of each member; `action` may be left out of a reward of the state alone.

        Args:
            obs: float32, as the task gives them; the indicator of an absorbing state may be there.
            action: float32, scaled to [-1, 1].

        Raises:
            ValueError: it is left out of a reward of state and action, or the observations are of
                another size.
        """
        if not self.state_only and action is None:
            raise ValueError(f"the reward of {self.env_id} is r(s, a): give it the actions, too")
        size = self.normaliser.mean.shape[-1]
        obs = self.normaliser(fit(obs, size, f"the reward of {self.env_id}"))
        x = obs if self.state_only else torch.cat([obs, action], -1)
        return self.net(self.params, x).squeeze(-1)

    def save(self, path: str | PathLike) -> None:
        """Write the population to a safetensors file."""
        save_weights(
            path,
            {"params": self.params, "mean": self.normaliser.mean, "std": self.normaliser.std},
            {
                "kind": "reward",
                "env_id": self.env_id,
                "state_only": self.state_only,
                "sizes": self.net.sizes,
                "activation": self.net.activation,
            },
        )

    @classmethod
    def load(cls, path: str | PathLike) -> "Reward":
        """Read a population written by `save`.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: the file holds something else, or weights of another shape.
        """
        tensors, about = load_weights(path, "reward")
        net = StackedMLP(tuple(about["sizes"]), about["activation"])
        params, normaliser = tensors["params"], Normaliser(tensors["mean"], tensors["std"])
        if params.shape[1:] != (net.num_params,):
            raise ValueError(
                f"{path}: weights {tuple(params.shape)}, expected (S, {net.num_params})"
            )
        return cls(about["env_id"], net, about["state_only"], params, normaliser)


class Discriminator:
    """r and V of `S` members, and how they are trained.

    Args:
        config: hyper-parameters; `config.reward` chooses the variant.
        obs_dim: O, with the absorbing indicator where there is one.
        action_dim: A.
        streams: for the initial weights.
        normaliser: scales every observation that comes in. The penalty holds ‖∇‖ near 1 in the
            coordinates that it gives, so their scale is part of the algorithm.
        horizon: steps that are judged together: an episode's for GAN-GCL, otherwise 1.
    """

    def __init__(
        self,
        config: Config,
        obs_dim: int,
        action_dim: int,
        streams: Streams,
        normaliser: Normaliser,
        horizon: int = 1,
    ) -> None:
        self.config, self.normaliser, self.horizon = config, normaliser, horizon
        self.is_airl = config.reward in IMPLEMENTATIONS
        self.sees_policy = self.is_airl or config.reward == "gan-gcl"
        kind = IMPLEMENTATIONS.get(config.reward, Implementation(False, self.sees_policy))
        self.state_only, self.reward_is_logit = kind
        inputs = obs_dim if self.state_only else obs_dim + action_dim
        activation = config.discriminator_activation
        self.reward_net = StackedMLP((inputs, *config.reward_hidden, 1), activation)
        self.value_net = StackedMLP((obs_dim, *config.shaping_hidden, 1), activation)
        self.reward_form, self.value_form = self.reward_net, self.value_net
        if config.bottleneck is not None:
            self.reward_form, self.value_form = (
                Bottleneck(net.sizes, config.bottleneck_size, activation)
                for net in (self.reward_net, self.value_net)
            )
        self.reward_params = self.reward_form.init(streams)
        self.value_params = self.value_form.init(streams)
        self.reward_optimizer = Adam(self.reward_params, config.discriminator_learning_rate)
        self.value_optimizer = Adam(self.value_params, config.discriminator_learning_rate)
        # What r does not see, its first layer ignores.
        self.mask = None
        if config.reward_sees is not None:
            seen = [*config.reward_sees, *range(obs_dim, inputs)]
            self.mask = self.reward_net.mask(seen).to(streams.device)
        # What else an update changes, where there is such: the singular vectors of r's and of V's
        # weights, and the multiplier β of the bottleneck.
        self.vectors = self.multiplier = None
        if config.spectral_norm:
            self.vectors = [net.init_vectors(streams) for net in (self.reward_net, self.value_net)]
        if config.bottleneck is not None:
            self.multiplier = torch.zeros(len(streams), 1, device=streams.device)
            self.quadrature = gauss_hermite().to(streams.device)
        self.step = self._step
        """One update. A faster form of it may take its place."""

    @property
    def state(self) -> dict[str, Tensor]:
        """Everything that updates change: the tensors themselves."""
        state = optimizer_states({"reward": self.reward_optimizer, "value": self.value_optimizer})
        if self.vectors is not None:
            state |= dict(zip(("reward.vectors", "value.vectors"), self.vectors, strict=True))
        if self.multiplier is not None:
            state["multiplier"] = self.multiplier
        return state

    @property
    def reward_weights(self) -> Float[Tensor, "S P"]:
        """The weights of `reward_net`, made of those that are trained."""
        return self._weights(0, self.reward_form, self.reward_params)

    @property
    def value_weights(self) -> Float[Tensor, "S P"]:
        """The weights of `value_net`, made of those that are trained."""
        return self._weights(1, self.value_form, self.value_params)

    def _weights(
        self, part: int, form: StackedMLP | Bottleneck, params: Float[Tensor, "S P"]
    ) -> Float[Tensor, "S Q"]:
        if self.vectors is not None:
            return form.spectrally_normalised(params, self.vectors[part])
        if self.mask is not None and part == 0:
            return params * self.mask
        return params if self.multiplier is None else form.at_mean(params)

    def f(
        self,
        obs: Float[Tensor, "S B O"],
        action: Float[Tensor, "S B A"],
        next_obs: Float[Tensor, "S B O"],
    ) -> Float[Tensor, "S B"]:
        """Return f(s, a, s') of normalised observations; without AIRL there is no shaping."""
        x = obs if self.state_only else torch.cat([obs, action], -1)
        r = self.reward_net(self.reward_weights, x).squeeze(-1)
        if not self.is_airl:
            return r
        values = self.value_net(self.value_weights, torch.cat([obs, next_obs], 1)).squeeze(-1)
        value, next_value = values.chunk(2, 1)
        return shaped_reward(r, value, next_value, self.config.discriminator_discount)

    def f_and_gradients(
        self,
        obs: Float[Tensor, "S B O"],
        action: Float[Tensor, "S B A"],
        next_obs: Float[Tensor, "S B O"],
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return f and its gradients by s, a and s'."""
        x = obs if self.state_only else torch.cat([obs, action], -1)
        r, by_x = self.reward_net.value_and_input_gradient(self.reward_weights, x)
        by_obs, by_action = by_x[..., : obs.shape[-1]], by_x[..., obs.shape[-1] :]
        if not self.is_airl:
            return r, by_obs, by_action, torch.zeros_like(by_obs)
        states = torch.cat([obs, next_obs], 1)
        values, slopes = self.value_net.value_and_input_gradient(self.value_weights, states)
        (value, next_value), (slope, next_slope) = values.chunk(2, 1), slopes.chunk(2, 1)
        discount = self.config.discriminator_discount
        f = shaped_reward(r, value, next_value, discount)
        return f, by_obs - slope, by_action, discount * next_slope

    def spread(
        self,
        obs: Float[Tensor, "S B O"],
        action: Float[Tensor, "S B A"],
        next_obs: Float[Tensor, "S B O"],
    ) -> tuple[Float[Tensor, "S B"], Float[Tensor, "S B"]]:
        """Return the variance of f through the bottleneck's code, and its divergence in nats.

        The code of a transition is that of r's input, that of V's at s and that at s', drawn
        independently of one another.
        """
        x = obs if self.state_only else torch.cat([obs, action], -1)
        variance, divergence = self.reward_form.spread(self.reward_params, x)
        if not self.is_airl:
            return variance, divergence
        states = torch.cat([obs, next_obs], 1)
        both = self.value_form.spread(self.value_params, states)
        (now, then), (divergence_now, divergence_then) = (part.chunk(2, 1) for part in both)
        discount = self.config.discriminator_discount
        variance = variance + now + discount**2 * then
        return variance, divergence + divergence_now + divergence_then

    def loss(
        self,
        expert: Batch,
        policy: Batch,
        expert_log_prob: Float[Tensor, "S B"] | None,
        policy_log_prob: Float[Tensor, "S B"] | None,
        coefficient: Float[Tensor, "S B 4"],
    ) -> tuple[Float[Tensor, ""], dict[str, Float[Tensor, "S"]]]:
        """Return cross-entropy plus weighted penalty, and diagnostics of each member.

        With a bottleneck the cross-entropy is the expected one, and β (KL - I_c) is added; the
        penalty, where there is one, is that of the code's mean.

        Args:
            expert: demonstrations.
            policy: transitions from replay.
            expert_log_prob: log π of the expert's actions, or what stands for it, see
                `Config.replay_density`; None for GAIL and DAC.
            policy_log_prob: the same of the policy's actions.
            coefficient: uniform in [0, 1): where between both the penalty is taken. The first
                column serves for all parts of a transition, or, where the penalty is on the
                probability, each column for its own (s, a, s', log π).
        """
        sides = [
            (self.normaliser(b.obs), b.action, self.normaliser(b.next_obs))
            for b in (expert, policy)
        ]
        transitions = [torch.cat(parts, 1) for parts in zip(*sides, strict=True)]
        f = self.f(*transitions)
        expert_f, policy_f = f.chunk(2, 1)
        on_probability = self.config.penalty_on == "probability"
        part = coefficient.unbind(-1) if on_probability else [coefficient[..., 0]] * 4
        mixed = [
            torch.lerp(p, e, c.unsqueeze(-1)) for e, p, c in zip(*sides, part[:3], strict=True)
        ]
        mixed_f, by_obs, by_action, by_next_obs = self.f_and_gradients(*mixed)

        expert_logit, policy_logit, mixed_logit = expert_f, policy_f, mixed_f
        if self.sees_policy:
            mixed_logit = log_odds(mixed_f, torch.lerp(policy_log_prob, expert_log_prob, part[3]))
        if self.sees_policy and self.config.policy_in_logit:
            expert_logit = log_odds(expert_f, expert_log_prob)
            policy_logit = log_odds(policy_f, policy_log_prob)
        expert_logit = per_episode(expert_logit, self.horizon)
        policy_logit = per_episode(policy_logit, self.horizon)

        square = by_obs.square().sum(-1)
        if on_probability:
            d = torch.sigmoid(mixed_logit)
            square = square * (d * (1 - d)).square()
        else:
            square = square + by_action.square().sum(-1) + by_next_obs.square().sum(-1)
        penalty = gradient_penalty(square, self.config.penalty_sides)
        if self.multiplier is None:
            cross_entropy = binary_cross_entropy(expert_logit, policy_logit)
        else:
            variance, divergence = self.spread(*transitions)
            variances = variance.chunk(2, 1)
            cross_entropy = expected_cross_entropy(
                expert_logit, policy_logit, *variances, self.quadrature
            )
        metrics = {
            "cross_entropy": cross_entropy.detach(),
            "penalty": penalty.detach(),
            "expert_logit": expert_logit.detach().mean(-1),
            "policy_logit": policy_logit.detach().mean(-1),
            "accuracy": ((expert_logit > 0).float() + (policy_logit < 0).float()).mean(-1) / 2,
            "entropy": (entropy(expert_logit) + entropy(policy_logit)).detach().mean(-1) / 2,
        }
        loss = cross_entropy + self.config.gradient_penalty * penalty
        if self.multiplier is not None:
            excess = divergence.mean(-1) - self.config.bottleneck
            multiplier = self.multiplier.squeeze(-1)
            loss = loss + multiplier * excess
            metrics |= {"excess": excess.detach(), "multiplier": multiplier.clone()}
        return loss.sum(), metrics

    def update(
        self,
        expert: Batch,
        policy: Batch,
        expert_log_prob: Float[Tensor, "S B"] | None,
        policy_log_prob: Float[Tensor, "S B"] | None,
        coefficient: Float[Tensor, "S B 4"],
    ) -> dict[str, Float[Tensor, "S"]]:
        """Take one step down `loss`; return its diagnostics."""
        return self.step(expert, policy, expert_log_prob, policy_log_prob, coefficient)

    def _step(
        self,
        expert: Batch,
        policy: Batch,
        expert_log_prob: Float[Tensor, "S B"] | None,
        policy_log_prob: Float[Tensor, "S B"] | None,
        coefficient: Float[Tensor, "S B 4"],
    ) -> dict[str, Float[Tensor, "S"]]:
        if self.vectors is not None:
            trained = (self.reward_net, self.reward_params), (self.value_net, self.value_params)
            for (net, params), vectors in zip(trained, self.vectors, strict=True):
                vectors.copy_(net.power_iteration(params, vectors))
        loss, metrics = self.loss(expert, policy, expert_log_prob, policy_log_prob, coefficient)
        if self.is_airl:
            descend(loss, self.reward_optimizer, self.value_optimizer)
        else:
            descend(loss, self.reward_optimizer)
        if self.multiplier is not None:
            with torch.no_grad():
                ascent = self.config.bottleneck_rate * metrics["excess"].unsqueeze(-1)
                self.multiplier.add_(ascent).clamp_(min=0)
        return metrics

    @torch.no_grad()
    def reward(self, batch: Batch, log_prob: Float[Tensor, "S B"] | None) -> Float[Tensor, "S B"]:
        """Return the generator's reward, as the module `rewards` has it.

        Args:
            batch: transitions.
            log_prob: log π of their actions, looked at where `reward_is_logit`.
        """
        if self.reward_is_logit:
            f = self.f(self.normaliser(batch.obs), batch.action, self.normaliser(batch.next_obs))
            return log_odds(f, log_prob) if self.config.log_prob_in_reward else f
        r = self.frozen(batch.obs, batch.action)
        return r if self.is_airl else OF_LOGIT[self.config.reward](r)

    @property
    def frozen(self) -> Reward:
        """r as it is now; later updates do not change it."""
        params, env_id = self.reward_weights.detach().clone(), self.config.env_id
        return Reward(env_id, self.reward_net, self.state_only, params, self.normaliser)
