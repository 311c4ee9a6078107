"""Soft actor-critic (Haarnoja et al. 2018), for a population.

The losses are functions of values and log-densities, written as in the paper, with its slips
mended: the target takes the smaller critic, the entropy term stands inside γ, and a termination
has no next value. Losses are summed over members and averaged over the batch, so that members do
not influence one another.
"""

import math
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from offairl_lite.config import Config
from offairl_lite.core.absorbing import analytic_return, is_absorbing
from offairl_lite.core.acceleration import is_large, piecewise
from offairl_lite.core.networks import Adam, Normaliser, TwinCritic, descend, optimizer_states
from offairl_lite.core.policies import MultiplicativeGaussian, Policy, SquashedGaussian
from offairl_lite.core.replay import Batch
from offairl_lite.core.rng import Streams

INITIAL_TEMPERATURE = 0.2


def soft_value(
    q: Float[Tensor, "2 S B"], alpha: Float[Tensor, "S 1"], log_prob: Float[Tensor, "S B"]
) -> Float[Tensor, "S B"]:
    """Return V(s) = min(Q₁, Q₂) - α log π, at an action drawn from π."""
    return q.amin(0) - alpha * log_prob


def bellman_target(
    reward: Float[Tensor, "S B"],
    terminated: Float[Tensor, "S B"],
    next_value: Float[Tensor, "S B"],
    discount: float,
) -> Float[Tensor, "S B"]:
    """Return y = r + γ (1 - terminated) V(s')."""
    return reward + discount * (1 - terminated) * next_value


def critic_loss(q: Float[Tensor, "2 S B"], target: Float[Tensor, "S B"]) -> Float[Tensor, ""]:
    """Return J_Q = E (Q - y)², summed over both critics."""
    return (q - target).square().mean(-1).sum()


def actor_loss(value: Float[Tensor, "S B"], weight: Float[Tensor, "S B"]) -> Float[Tensor, ""]:
    """Return J_π = -E V(s), for soft values at reparametrised actions; `weight` masks states."""
    return -(weight * value).mean(-1).sum()


def temperature_loss(
    log_alpha: Float[Tensor, "S 1"], log_prob: Float[Tensor, "S B"], target_entropy: float
) -> Float[Tensor, ""]:
    """Return J_α = E[-α (log π + H̄)]; it raises α while the entropy is below H̄."""
    return -(log_alpha.exp() * (log_prob.detach() + target_entropy)).mean(-1).sum()


def stochastic_actor(config: Config, obs_dim: int, action_dim: int) -> SquashedGaussian:
    """Return the actor that a configuration asks for: one Gaussian, or a product of several."""
    dims = obs_dim, action_dim
    if config.primitives is None:
        return SquashedGaussian(*dims, config.hidden, config.log_std_range)
    return MultiplicativeGaussian(
        *dims,
        config.trunk_hidden,
        config.log_std_range,
        config.primitives,
        config.primitive_hidden,
        config.gate_hidden,
        config.gating,
        config.composition,
    )


class SAC:
    """Actor, twin critics, their targets and the temperature of `S` members.

    Args:
        config: hyper-parameters.
        obs_dim: O, with the absorbing indicator where there is one.
        action_dim: A.
        streams: for the initial weights.
        normaliser: scales every observation that comes in.
    """

    def __init__(
        self,
        config: Config,
        obs_dim: int,
        action_dim: int,
        streams: Streams,
        normaliser: Normaliser,
    ) -> None:
        self.config, self.normaliser = config, normaliser
        self.actor = stochastic_actor(config, obs_dim, action_dim)
        self.critic = TwinCritic(obs_dim, action_dim, config.hidden)
        self.actor_params = self.actor.init(streams)
        self.critic_params = self.critic.init(streams)
        self.target_params = self.critic_params.clone()
        alpha = INITIAL_TEMPERATURE if config.temperature is None else config.temperature
        self.log_alpha = torch.full((len(streams), 1), math.log(alpha), device=streams.device)
        self.target_entropy = (
            -float(action_dim) if config.target_entropy is None else config.target_entropy
        )
        self.actor_optimizer = Adam(self.actor_params, config.learning_rate)
        self.critic_optimizer = Adam(self.critic_params, config.learning_rate)
        self.alpha_optimizer = Adam(self.log_alpha, config.learning_rate)
        self.updates = 0
        self.step = self._step
        """One update, the delayed part too or not. A faster form of it may take its place."""

    @property
    def state(self) -> dict[str, Tensor]:
        """Everything that updates change, but their number: the tensors themselves."""
        optimizers = {
            "actor": self.actor_optimizer,
            "critic": self.critic_optimizer,
            "alpha": self.alpha_optimizer,
        }
        return {"target": self.target_params, **optimizer_states(optimizers)}

    @property
    def policy(self) -> Policy:
        """The actor as it is now; later updates do not change it."""
        params = self.actor_params.detach().clone()
        return Policy(self.config.env_id, self.actor, params, self.normaliser)

    @torch.no_grad()
    def log_prob(
        self, batch: Batch, actor_params: Float[Tensor, "S P"] | None = None
    ) -> Float[Tensor, "S B"]:
        """Return log π(a|s) of the batch's actions, under the current actor or under another.

        In the absorbing state the one thing to do is done with certainty: log π = 0.
        """
        params = self.actor_params if actor_params is None else actor_params
        obs = self.normaliser(batch.obs)
        log_prob = partial(self.actor.log_prob, density=self.config.log_density)
        if is_large(self.config) and obs.device.type == "cpu":
            log_prob = piecewise(log_prob)
        log_prob = log_prob(params, obs, batch.pre_tanh)
        if self.config.absorbing == "none":
            return log_prob
        return log_prob.masked_fill(is_absorbing(batch.obs), 0)

    def update(
        self,
        batch: Batch,
        reward: Float[Tensor, "S B"],
        absorbing_reward: Float[Tensor, "S 1"],
        noise: Float[Tensor, "2 S B A"],
    ) -> dict[str, Float[Tensor, "S"]]:
        """Train the critics once, and every `actor_delay`-th time actor, temperature and targets.

        Args:
            batch: transitions; their own reward is not looked at.
            reward: what to maximise.
            absorbing_reward: r(s_a), used where `absorbing` is `analytic`.
            noise: standard normal, for the next actions and for the actor's own.

        Returns:
            Losses and diagnostics of each member.
        """
        self.updates += 1
        delayed = self.updates % self.config.actor_delay == 0
        return self.step(batch, reward, absorbing_reward, noise, delayed)

    def _step(
        self,
        batch: Batch,
        reward: Float[Tensor, "S B"],
        absorbing_reward: Float[Tensor, "S 1"],
        noise: Float[Tensor, "2 S B A"],
        delayed: bool,
    ) -> dict[str, Float[Tensor, "S"]]:
        config = self.config
        obs = self.normaliser(batch.obs)
        target = self._target(batch, reward, absorbing_reward, noise[0])
        q = self.critic(self.critic_params, obs, batch.action)
        descend(critic_loss(q, target), self.critic_optimizer)
        metrics = {
            "critic_loss": (q.detach() - target).square().mean(-1).sum(0),
            "q": q.detach().mean((0, 2)),
            "temperature": self.log_alpha.detach().exp().squeeze(-1),
        }
        if delayed:
            params = self.actor_params
            if config.fixed_primitives:
                params = self.actor.with_fixed_primitives(params)
            pre_tanh, log_prob = self.actor.sample(params, obs, noise[1])
            q = self.critic(self.critic_params.detach(), obs, torch.tanh(pre_tanh))
            value = soft_value(q, self.log_alpha.detach().exp(), log_prob)
            weight = torch.ones_like(value)
            if config.absorbing != "none":
                # Nothing is decided in the absorbing state, and its entropy is as it should be.
                weight = (~is_absorbing(batch.obs)).to(value)
                log_prob = log_prob.masked_fill(weight == 0, -self.target_entropy)
            descend(actor_loss(value, weight), self.actor_optimizer)
            if config.temperature is None:
                loss = temperature_loss(self.log_alpha, log_prob, self.target_entropy)
                descend(loss, self.alpha_optimizer)
            with torch.no_grad():
                self.target_params.lerp_(self.critic_params, config.target_rate)
        return metrics

    @torch.no_grad()
    def _target(
        self,
        batch: Batch,
        reward: Float[Tensor, "S B"],
        absorbing_reward: Float[Tensor, "S 1"],
        noise: Float[Tensor, "S B A"],
    ) -> Float[Tensor, "S B"]:
        config = self.config
        next_obs = self.normaliser(batch.next_obs)
        pre_tanh, log_prob = self.actor.sample(self.actor_params, next_obs, noise)
        if config.absorbing != "none":
            ended = is_absorbing(batch.next_obs)
            pre_tanh = pre_tanh.masked_fill(ended.unsqueeze(-1), 0)
            log_prob = log_prob.masked_fill(ended, 0)
        q = self.critic(self.target_params, next_obs, torch.tanh(pre_tanh))
        next_value = soft_value(q, self.log_alpha.exp(), log_prob)
        target = bellman_target(reward, batch.terminated, next_value, config.discount)
        if config.absorbing == "analytic":
            known = analytic_return(reward, absorbing_reward, config.discount)
            target = torch.where(ended, known, target)
        return target
