"""Twin delayed deterministic policy gradient (Fujimoto et al. 2018), for a population.

DAC's learner and one of the paper's candidates for an expert. It differs from SAC in what it
adds to the next action, a clipped noise that smooths the critic, and in having no entropy.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from offairl_lite.config import TD3Config
from offairl_lite.core.absorbing import analytic_return, hold_still, is_absorbing
from offairl_lite.core.networks import Adam, Normaliser, TwinCritic, descend, optimizer_states
from offairl_lite.core.policies import make_actor
from offairl_lite.core.replay import Batch
from offairl_lite.core.rng import Rng
from offairl_lite.core.sac import bellman_target, critic_loss

SMOOTHING_STD = 0.2
SMOOTHING_CLIP = 0.5


def smoothed_action(
    action: Float[Tensor, "S B A"], noise: Float[Tensor, "S B A"]
) -> Float[Tensor, "S B A"]:
    """Return clip(a + clip(ε, ±0.5), ±1) with ε of standard deviation 0.2 (their equation 14)."""
    noise = (SMOOTHING_STD * noise).clamp(-SMOOTHING_CLIP, SMOOTHING_CLIP)
    return (action + noise).clamp(-1, 1)


class TD3:
    """Actor, twin critics and all their targets, for `S` members.

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
        config: TD3Config,
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
        self.target_actor_params = self.actor_params.clone()
        self.target_params = self.critic_params.clone()
        self.actor_optimizer = Adam(self.actor_params, config.learning_rate)
        self.critic_optimizer = Adam(self.critic_params, config.learning_rate)

    @property
    def state(self) -> dict[str, Tensor]:
        """Everything that updates change: the tensors themselves."""
        optimizers = {"actor": self.actor_optimizer, "critic": self.critic_optimizer}
        targets = {"target": self.target_params, "target_actor": self.target_actor_params}
        return {**targets, **optimizer_states(optimizers)}

    def update(
        self,
        batch: Batch,
        reward: Float[Tensor, "S B"],
        absorbing_reward: Float[Tensor, "S 1"],
        noise: Float[Tensor, "2 S B A"],
        delayed: bool,
    ) -> dict[str, Float[Tensor, "S"]]:
        """Train the critics and, if it is their turn, actor and targets.

        Args:
            batch: transitions; their own reward is not looked at.
            reward: what to maximise.
            absorbing_reward: r(s_a), used where `absorbing` is `analytic`.
            noise: standard normal; only the first half is used.
            delayed: whether it is the turn of actor and targets.

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
        }
        if delayed:
            action = self._still(obs, self.actor.mode(self.actor_params, obs))
            q = self.critic(self.critic_params.detach(), obs, action)[0]
            descend(-q.mean(-1).sum(), self.actor_optimizer)
            with torch.no_grad():
                rate = self.config.target_rate
                self.target_params.lerp_(self.critic_params, rate)
                self.target_actor_params.lerp_(self.actor_params, rate)
        return metrics

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
        action = smoothed_action(self.actor.mode(self.target_actor_params, next_obs), noise)
        action = self._still(next_obs, action)
        next_value = self.critic(self.target_params, next_obs, action).amin(0)
        target = bellman_target(reward, batch.terminated, next_value, self.config.discount)
        if self.absorbing == "analytic":
            known = analytic_return(reward, absorbing_reward, self.config.discount)
            target = torch.where(is_absorbing(next_obs), known, target)
        return target

    def _still(self, obs: Float[Tensor, "S B O"], action: Float[Tensor, "S B A"]) -> Tensor:
        return action if self.absorbing == "none" else hold_still(obs, action)[0]
