"""Soft actor-critic (Haarnoja et al. 2018), for a population.

The losses are pure functions in the symbols of the book (chapter 4), with the slips of the paper's
print mended: the target takes the smaller critic, the entropy term stands inside γ, and a
termination has no next value. Losses are summed over members and averaged over the batch, so that
members do not influence one another.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from offairl_lite.config import SACConfig
from offairl_lite.core.absorbing import analytic_return, hold_still, is_absorbing
from offairl_lite.core.acceleration import is_large, piecewise
from offairl_lite.core.networks import Adam, Normaliser, TwinCritic, descend, optimizer_states
from offairl_lite.core.policies import make_actor
from offairl_lite.core.replay import Batch
from offairl_lite.core.rng import Rng

INITIAL_TEMPERATURE = 0.2
"""Where a learned α begins (released code)."""

ACTOR_DELAY = 2
"""Critic updates for one update of actor, temperature and targets (Arnob 2020, section 3)."""


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


def actor_loss(
    log_prob: Float[Tensor, "S B"], q: Float[Tensor, "S B"], alpha: Float[Tensor, "S 1"]
) -> Float[Tensor, ""]:
    """Return J_π = E[α log π - Q], at reparametrised actions."""
    return (alpha * log_prob - q).mean(-1).sum()


def temperature_loss(
    log_alpha: Float[Tensor, "S 1"],
    log_prob: Float[Tensor, "S B"],
    target_entropy: float,
    mask: Float[Tensor, "S B"],
) -> Float[Tensor, ""]:
    """Return J_α = E[-α (log π + H̄)]; it raises α while the entropy is below H̄.

    `mask` is 0 in states where nothing is decided, whose entropy says nothing.
    """
    return -(log_alpha.exp() * (mask * (log_prob.detach() + target_entropy))).mean(-1).sum()


class SAC:
    """Actor, twin critics, their targets and the temperature of `S` members.

    Args:
        config: its settings.
        obs_dim: O, with the absorbing indicator where there is one.
        action_dim: A.
        rng: for the initial weights.
        normaliser: scales every observation that comes in, but not the absorbing indicator.
        absorbing: what follows a termination, as in `Schedule.absorbing`.
    """

    def __init__(
        self,
        config: SACConfig,
        obs_dim: int,
        action_dim: int,
        rng: Rng,
        normaliser: Normaliser,
        absorbing: str = "none",
    ) -> None:
        self.config, self.normaliser, self.absorbing = config, normaliser, absorbing
        self.actor = make_actor(config, obs_dim, action_dim)
        self.critic = TwinCritic(obs_dim, action_dim, config.hidden)
        self.actor_params = self.actor.init(rng)
        self.critic_params = self.critic.init(rng)
        self.target_params = self.critic_params.clone()
        alpha = INITIAL_TEMPERATURE if config.temperature is None else config.temperature
        self.log_alpha = torch.full((len(rng), 1), math.log(alpha), device=rng.device)
        self.target_entropy = (
            -float(action_dim) if config.target_entropy is None else config.target_entropy
        )
        self.actor_optimizer = Adam(self.actor_params, config.learning_rate)
        self.critic_optimizer = Adam(self.critic_params, config.learning_rate)
        self.alpha_optimizer = Adam(self.log_alpha, config.learning_rate)

    @property
    def state(self) -> dict[str, Tensor]:
        """Everything that updates change: the tensors themselves."""
        optimizers = {
            "actor": self.actor_optimizer,
            "critic": self.critic_optimizer,
            "alpha": self.alpha_optimizer,
        }
        return {"target": self.target_params, **optimizer_states(optimizers)}

    @torch.no_grad()
    def log_prob(
        self,
        actor_params: Float[Tensor, "S P"],
        obs: Float[Tensor, "S B O"],
        pre_tanh: Float[Tensor, "S B A"],
    ) -> Float[Tensor, "S B"]:
        """Return log π(a|s) of the actions tanh(`pre_tanh`), under any weights of the actor."""
        obs = self.normaliser(obs)
        density = self.actor.log_prob
        if is_large(self.config) and obs.device.type == "cpu":
            density = piecewise(density)
        log_prob = density(actor_params, obs, pre_tanh)
        return log_prob if self.absorbing == "none" else hold_still(obs, log_prob)[0]

    def sample(
        self,
        actor_params: Float[Tensor, "S P"],
        obs: Float[Tensor, "S B O"],
        noise: Float[Tensor, "S B A"],
    ) -> tuple[Float[Tensor, "S B A"], Float[Tensor, "S B"]]:
        """Return a ~ π(·|s), as `pre_tanh`, and log π(a|s), of normalised observations."""
        decided = self.actor.sample(actor_params, obs, noise)
        return decided if self.absorbing == "none" else hold_still(obs, *decided)

    def update(
        self,
        batch: Batch,
        reward: Float[Tensor, "S B"],
        absorbing_reward: Float[Tensor, "S 1"],
        noise: Float[Tensor, "2 S B A"],
        delayed: bool,
    ) -> dict[str, Float[Tensor, "S"]]:
        """Train the critics and, if it is their turn, actor, temperature and targets.

        Args:
            batch: transitions; their own reward is not looked at.
            reward: what to maximise.
            absorbing_reward: r(s_a), used where `absorbing` is `analytic`.
            noise: standard normal, for the next actions and for the actor's own.
            delayed: whether it is the turn of actor, temperature and targets.

        Returns:
            Losses and diagnostics of each member.
        """
        obs = self.normaliser(batch.obs)
        target = self.target(batch, reward, absorbing_reward, noise[0])
        q = self.critic(self.critic_params, obs, batch.action)
        descend(critic_loss(q, target), self.critic_optimizer)
        metrics = {
            "critic_loss": (q.detach() - target).square().mean(-1).sum(0),
            "q": q.detach().mean((0, 2)),
            "temperature": self.log_alpha.detach().exp().squeeze(-1),
        }
        if delayed:
            self._update_actor(obs, noise[1])
            with torch.no_grad():
                self.target_params.lerp_(self.critic_params, self.config.target_rate)
        return metrics

    def _update_actor(self, obs: Float[Tensor, "S B O"], noise: Float[Tensor, "S B A"]) -> None:
        params = self.actor_params
        if self.config.fixed_primitives:
            params = self.actor.with_fixed_primitives(params)
        pre_tanh, log_prob = self.sample(params, obs, noise)
        # Detached, so that no gradient of the critics' weights is computed.
        q = self.critic(self.critic_params.detach(), obs, torch.tanh(pre_tanh)).amin(0)
        alpha = self.log_alpha.detach().exp()
        descend(actor_loss(log_prob, q, alpha), self.actor_optimizer)
        if self.config.temperature is None:
            mask = torch.ones_like(log_prob)
            if self.absorbing != "none":
                mask = (~is_absorbing(obs)).to(log_prob)
            loss = temperature_loss(self.log_alpha, log_prob, self.target_entropy, mask)
            descend(loss, self.alpha_optimizer)

    @torch.no_grad()
    def target(
        self,
        batch: Batch,
        reward: Float[Tensor, "S B"],
        absorbing_reward: Float[Tensor, "S 1"],
        noise: Float[Tensor, "S B A"],
    ) -> Float[Tensor, "S B"]:
        """Return y, towards which the critics are drawn."""
        next_obs = self.normaliser(batch.next_obs)
        pre_tanh, log_prob = self.sample(self.actor_params, next_obs, noise)
        q = self.critic(self.target_params, next_obs, torch.tanh(pre_tanh))
        next_value = soft_value(q, self.log_alpha.exp(), log_prob)
        target = bellman_target(reward, batch.terminated, next_value, self.config.discount)
        if self.absorbing == "analytic":
            known = analytic_return(reward, absorbing_reward, self.config.discount)
            target = torch.where(is_absorbing(next_obs), known, target)
        return target
