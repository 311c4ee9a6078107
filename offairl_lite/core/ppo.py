"""Proximal policy optimisation (Schulman et al. 2017), for a population.

It learns from the steps that the present policy has just taken, a few epochs long, and never looks
at them again. The actor is SAC's, so that log π is the same thing for the discriminator.
"""

from collections.abc import Iterator
from typing import NamedTuple

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from offairl_lite.config import PPOConfig
from offairl_lite.core.experience import Experience
from offairl_lite.core.networks import Adam, StackedMLP, descend, states_of, zeros
from offairl_lite.core.policies import make_actor
from offairl_lite.core.replay import Batch
from offairl_lite.core.rng import Rng
from offairl_lite.core.sac import critic_loss
from offairl_lite.core.shapes import Action, Layout, Metrics, Obs, Params, Scalar, Vector

CLIP = 0.2  #: How far the ratio of new to old density may move before it stops to pay.
EPOCHS = 10  #: How often a block of steps is gone through (Schulman et al. 2017, table 3).
GAE_DECAY = 0.95  #: λ of generalised advantage estimation.
#: Factor on the actor's last layer when it is drawn, so that the first actions have no preference
#: (Andrychowicz et al. 2021, section 3.2).
FIRST_SCALE = 0.01


def episode_ends(obs: Obs, next_obs: Obs) -> Bool[Tensor, "S B"]:
    """Tell which steps are the last ones known of an episode: the next begins somewhere else.

    A reset to just where an episode was cut off goes unnoticed, which does no harm.
    """
    ends = (next_obs[:, :-1] != obs[:, 1:]).any(-1)
    return torch.nn.functional.pad(ends, (0, 1), value=True)


def gae(
    reward: Vector,
    value: Vector,
    next_value: Vector,
    terminated: Vector,
    ends: Bool[Tensor, "S B"],
    discount: float,
    decay: float,
) -> Vector:
    r"""Return advantages $A_t = \sum_k (\gamma \lambda)^k \delta_{t + k}$ to the episode's end.

    With $\delta = r + \gamma (1 - \text{terminated}) V(s') - V(s)$ (Schulman et al. 2016, equation
    16). A termination has no next value. A time limit and the end of the block have one.
    """
    delta = reward + discount * (1 - terminated) * next_value - value
    goes_on = discount * decay * (1 - torch.maximum(terminated, ends.to(terminated)))
    advantage, after = torch.empty_like(delta), torch.zeros_like(delta[:, 0])
    for t in reversed(range(delta.shape[1])):
        after = advantage[:, t] = delta[:, t] + goes_on[:, t] * after
    return advantage


def clipped_surrogate(
    log_prob: Vector, old_log_prob: Vector, advantage: Vector, clip: float
) -> Scalar:
    """Return -E min(ρ A, clip(ρ, 1 ± ε) A), ρ = π / π_old (Schulman et al. 2017, equation 7)."""
    ratio = torch.exp(log_prob - old_log_prob)
    clipped = ratio.clamp(1 - clip, 1 + clip)
    return -torch.minimum(ratio * advantage, clipped * advantage).mean(-1).sum()


class Rollout(NamedTuple):
    """Steps of the present policy, with all that they teach; advantages are standardised."""

    obs: Obs
    pre_tanh: Action
    log_prob: Vector
    advantage: Vector
    target: Vector

    def rows(self, index: Int[Tensor, "S M"]) -> "Rollout":
        """Return some steps of each member."""
        members = torch.arange(len(index), device=index.device).unsqueeze(1)
        return Rollout(*(part[members, index] for part in self))


class PPO:
    """Actor and value network of `S` members; observations come scaled."""

    def __init__(self, config: PPOConfig, layout: Layout) -> None:
        self.config = config
        self.actor = make_actor(config, layout.obs_dim, layout.action_dim)
        self.critic = StackedMLP((layout.obs_dim, *config.hidden, 1))
        self.actor_params = zeros(layout, self.actor.num_params)
        self.critic_params = zeros(layout, self.critic.num_params)
        self.actor_optimizer = Adam(self.actor_params, config.learning_rate)
        self.critic_optimizer = Adam(self.critic_params, config.learning_rate)
        self.state = states_of(actor=self.actor_optimizer, critic=self.critic_optimizer)

    @torch.no_grad()
    def init(self, rng: Rng) -> None:
        """Draw the initial weights, in place."""
        self.actor_params.copy_(self.actor.init(rng))
        self.critic_params.copy_(self.critic.init(rng))
        for last in self.actor.net.layers(self.actor_params)[-1]:
            last *= FIRST_SCALE

    @torch.no_grad()
    def log_prob(self, actor_params: Params, obs: Obs, pre_tanh: Action) -> Vector:
        """Return log π(a|s) of the actions tanh(`pre_tanh`), under any weights of the actor."""
        return self.actor.log_prob(actor_params, obs, pre_tanh)

    def minibatches(
        self, experience: Experience, steps: int, done: int
    ) -> Iterator[tuple[Rollout, Action]]:
        """Yield the arguments of the updates on the last block of steps: `EPOCHS` times all."""
        rollout = self.rollout(experience.last(steps))
        rng, size = experience.rng, experience.config.schedule.batch_size
        for _ in range(EPOCHS):
            order = rng.uniform(steps).argsort(1).split(size, 1)
            noise = rng.normal(steps, self.actor.action_dim).split(size, 1)
            for index, eps in zip(order, noise, strict=True):
                yield rollout.rows(index), eps

    @torch.no_grad()
    def rollout(self, block: Batch) -> Rollout:
        """Return what a block teaches: the last steps, in the order in which they were taken."""
        value, next_value = (
            self.critic(self.critic_params, x).squeeze(-1) for x in (block.obs, block.next_obs)
        )
        ends, gamma = episode_ends(block.obs, block.next_obs), self.config.discount
        advantage = gae(block.reward, value, next_value, block.terminated, ends, gamma, GAE_DECAY)
        mean, std = advantage.mean(1, keepdim=True), advantage.std(1, keepdim=True)
        log_prob = self.actor.log_prob(self.actor_params, block.obs, block.pre_tanh)
        scaled = (advantage - mean) / (std + 1e-8)
        return Rollout(block.obs, block.pre_tanh, log_prob, scaled, advantage + value)

    def update(self, minibatch: Rollout, noise: Action) -> Metrics:
        """Take a step with actor and value network; `noise` is to estimate the entropy."""
        obs, pre_tanh, old_log_prob, advantage, target = minibatch
        log_prob = self.actor.log_prob(self.actor_params, obs, pre_tanh)
        entropy = -self.actor.sample(self.actor_params, obs, noise)[1].mean(-1)
        surrogate = clipped_surrogate(log_prob, old_log_prob, advantage, CLIP)
        descend(surrogate - self.config.temperature * entropy.sum(), self.actor_optimizer)
        value = self.critic(self.critic_params, obs).squeeze(-1)
        descend(critic_loss(value, target), self.critic_optimizer)
        loss = (value.detach() - target).square().mean(-1)
        return {"critic_loss": loss, "q": value.detach().mean(-1)}
