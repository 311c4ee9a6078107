"""Soft actor-critic (Haarnoja et al. 2018), for a population.

The losses are pure functions in the symbols of the book (chapter 4), with the slips of the paper's
print mended: the smaller critic, entropy inside γ, no value after a termination. They are summed
over members, so that none influences another, and averaged over the batch.
"""

import math
from collections.abc import Callable, Iterator

import torch
from torch import Tensor

from offairl_lite.config import SACConfig, TD3Config
from offairl_lite.core.absorbing import is_absorbing
from offairl_lite.core.acceleration import is_large, piecewise
from offairl_lite.core.experience import Experience
from offairl_lite.core.networks import Adam, TwinCritic, descend, states_of, zeros
from offairl_lite.core.policies import make_actor
from offairl_lite.core.replay import Batch, chunks
from offairl_lite.core.rng import Rng
from offairl_lite.core.shapes import (
    Action,
    Column,
    Layout,
    Metrics,
    Noises,
    Obs,
    Params,
    Scalar,
    TwinQ,
    Vector,
)

INITIAL_TEMPERATURE = 0.2  #: Where a learned α begins (released code).
POLICY_DELAY = 2  #: Critic updates for one of actor, temperature, targets (Arnob 2020, section 3).


def soft_value(q: TwinQ, alpha: Column, log_prob: Vector) -> Vector:
    """Return V(s) = min(Q₁, Q₂) - α log π, at an action drawn from π."""
    return q.amin(0) - alpha * log_prob


def bellman_target(
    reward: Vector, terminated: Vector, next_value: Vector, discount: float
) -> Vector:
    """Return y = r + γ (1 - terminated) V(s')."""
    return reward + discount * (1 - terminated) * next_value


def critic_loss(q: TwinQ | Vector, target: Vector) -> Scalar:
    """Return J_Q = E (Q - y)², summed over both critics; PPO has one."""
    return (q - target).square().mean(-1).sum()


def actor_loss(log_prob: Vector, q: Vector, alpha: Column) -> Scalar:
    """Return J_π = E[α log π - Q], at reparametrised actions."""
    return (alpha * log_prob - q).mean(-1).sum()


def temperature_loss(
    log_alpha: Column, log_prob: Vector, target_entropy: float, mask: Vector
) -> Scalar:
    """Return J_α = E[-α (log π + H̄)], of states with `mask` 1; α rises while entropy is below H̄."""
    return -(log_alpha.exp() * (mask * (log_prob.detach() + target_entropy))).mean(-1).sum()


class OffPolicy:
    """What SAC and TD3 have in common: actor, twin critics and their targets of `S` members.

    Observations come scaled, with the indicator last if `absorbs`; weights are zeros until `init`.
    """

    draws = 2  #: Actions that an update draws in each state: the next ones, and the actor's own.
    value: Callable[[Obs, Action], Vector]
    """Returns V(s) by the target critics, for standard normal noise; each learner's own."""
    update_actor: Callable[[Obs, Action], None]
    """Takes one step with the actor, for standard normal noise; each learner's own."""

    def __init__(self, config: SACConfig | TD3Config, layout: Layout) -> None:
        self.config, self.absorbs = config, layout.absorbs
        self.actor = make_actor(config, layout.obs_dim, layout.action_dim)
        self.critic = TwinCritic(layout.obs_dim, layout.action_dim, config.hidden)
        self.actor_params = zeros(layout, self.actor.num_params)
        self.critic_params = torch.stack([zeros(layout, self.critic.net.num_params)] * 2)
        self.target_params = self.critic_params.clone()
        self.actor_optimizer = Adam(self.actor_params, config.learning_rate)
        self.critic_optimizer = Adam(self.critic_params, config.learning_rate)
        trained = states_of(actor=self.actor_optimizer, critic=self.critic_optimizer)
        self.state = {"target": self.target_params, **trained}

    @torch.no_grad()
    def init(self, rng: Rng) -> None:
        """Draw the initial weights, in place."""
        self.actor_params.copy_(self.actor.init(rng))
        self.critic_params.copy_(self.critic.init(rng))
        self.target_params.copy_(self.critic_params)

    def minibatches(
        self, experience: Experience, updates: int, done: int
    ) -> Iterator[tuple[Batch, Noises, bool]]:
        """Yield arguments of so many updates after `done`; each `POLICY_DELAY`-th has the actor."""
        for count in chunks(updates):
            minibatches = experience.minibatches(count)
            size, action_dim = minibatches[0].pre_tanh.shape[1:]
            noise = experience.rng.normal(self.draws, count * size, action_dim).transpose(0, 1)
            for minibatch, eps in zip(minibatches, noise.split(size, 2), strict=True):
                done += 1
                yield minibatch, eps, done % POLICY_DELAY == 0

    def update(self, batch: Batch, noise: Noises, update_actor: bool) -> Metrics:
        """Train critics, at times the actor, with standard normal `noise`; then targets follow."""
        target = self.target(batch, noise[0])
        q = self.critic(self.critic_params, batch.obs, batch.action)
        descend(self.critic_loss(q, target, batch.obs, noise[-1]), self.critic_optimizer)
        if update_actor:
            self.update_actor(batch.obs, noise[1])
            with torch.no_grad():
                self.target_params.lerp_(self.critic_params, self.config.target_rate)
        loss = (q.detach() - target).square().mean(-1).sum(0)
        return {"critic_loss": loss, "q": q.detach().mean((0, 2))}

    def critic_loss(self, q: TwinQ, target: Vector, obs: Obs, noise: Action) -> Scalar:
        """Return what the critics descend; that of IQ-Learn needs `noise` for V(s)."""
        return critic_loss(q, target)

    @torch.no_grad()
    def target(self, batch: Batch, noise: Action) -> Vector:
        """Return y, towards which the critics are drawn."""
        next_value = self.value(batch.next_obs, noise)
        return bellman_target(batch.reward, batch.terminated, next_value, self.config.discount)

    def mask_absorbing(self, obs: Obs, *decided: Tensor) -> tuple[Tensor, ...]:
        """Return `pre_tanh` and log π: in the absorbing state both are 0, without a gradient."""
        if not self.absorbs:
            return decided
        ended = is_absorbing(obs)
        masks = (ended.unsqueeze(-1) if x.ndim > ended.ndim else ended for x in decided)
        return tuple(x.masked_fill(mask, 0) for x, mask in zip(decided, masks, strict=True))


class SAC(OffPolicy):
    """Actor, twin critics, their targets and the temperature of `S` members."""

    config: SACConfig

    def __init__(self, config: SACConfig, layout: Layout) -> None:
        super().__init__(config, layout)
        alpha = INITIAL_TEMPERATURE if config.temperature is None else config.temperature
        self.log_alpha = torch.full_like(self.actor_params.detach()[:, :1], math.log(alpha))
        wanted = config.target_entropy
        self.target_entropy = -float(self.actor.action_dim) if wanted is None else wanted
        self.alpha_optimizer = Adam(self.log_alpha, config.learning_rate)
        self.state |= states_of(alpha=self.alpha_optimizer)

    @torch.no_grad()
    def log_prob(self, actor_params: Params, obs: Obs, pre_tanh: Action) -> Vector:
        """Return log π(a|s) of the actions tanh(`pre_tanh`), under any weights of the actor."""
        in_pieces = is_large(self.config.hidden) and obs.device.type == "cpu"
        density = piecewise(self.actor.log_prob) if in_pieces else self.actor.log_prob
        return self.mask_absorbing(obs, density(actor_params, obs, pre_tanh))[0]

    def update(self, batch: Batch, noise: Noises, update_actor: bool) -> Metrics:
        """Make the update of `OffPolicy`; the temperature is reported as it was before."""
        temperature = self.log_alpha.detach().exp().squeeze(-1)
        return super().update(batch, noise, update_actor) | {"temperature": temperature}

    def update_actor(self, obs: Obs, noise: Action) -> None:
        """Take one step with the actor, and one with the temperature, if it is learned."""
        params = self.actor_params
        if self.config.fixed_primitives:
            params = self.actor.with_fixed_primitives(params)
        pre_tanh, log_prob = self.mask_absorbing(obs, *self.actor.sample(params, obs, noise))
        # Detached, so that no gradient of the critics' weights is computed.
        q = self.critic(self.critic_params.detach(), obs, torch.tanh(pre_tanh)).amin(0)
        alpha = self.log_alpha.detach().exp()
        descend(actor_loss(log_prob, q, alpha), self.actor_optimizer)
        if self.config.temperature is None:
            (mask,) = self.mask_absorbing(obs, torch.ones_like(log_prob))
            loss = temperature_loss(self.log_alpha, log_prob, self.target_entropy, mask)
            descend(loss, self.alpha_optimizer)

    def value(self, obs: Obs, noise: Action) -> Vector:
        """Return V(s) by the target critics, at an action that `noise` draws from π."""
        sampled = self.actor.sample(self.actor_params, obs, noise)
        pre_tanh, log_prob = self.mask_absorbing(obs, *sampled)
        q = self.critic(self.target_params, obs, torch.tanh(pre_tanh))
        return soft_value(q, self.log_alpha.exp(), log_prob)
