r"""The discriminator: AIRL's, which contains a reward, and GAIL's, which is one.

It tells the expert's transitions (label 1) from the policy's (label 0). AIRL's logit is

$$\ell = f(s, a, s') - \log \pi(a|s), \qquad f = r_\psi + \gamma V_\omega(s') - V_\omega(s),$$

with $r_\psi(s)$ or $r_\psi(s, a)$. The released loss leaves $\log \pi$ out: $\ell = f$. GAIL's and
DAC's is the special case $\ell = r_\psi(s, a)$, without shaping. GAN-GCL judges a whole episode:
$\ell = \sum_t r_\psi(s_t, a_t) - \log \pi(a_t|s_t)$.
"""

from collections.abc import Callable
from functools import singledispatch
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import softplus

from offairl_lite.config import DiscriminatorConfig
from offairl_lite.core.networks import TINY, Adam, Normaliser, StackedMLP, descend, optimizer_states
from offairl_lite.core.replay import Batch
from offairl_lite.core.rewards import IMPLEMENTATIONS, OF_LOGIT, Implementation, Reward, log_odds
from offairl_lite.core.rng import Rng
from offairl_lite.core.shapes import Action, Metrics, Obs, Params, PerMember, Scalar, Vector

LEARNING_RATE = 1e-3
"""Adam's, for r and V (Arnob 2020, section 5)."""

LogDensity = Callable[[Batch], Vector]
"""log π of each transition of a batch."""


def shaped_reward(r: Vector, value: Vector, next_value: Vector, discount: float) -> Vector:
    """Return f = r + γ V(s') - V(s) (Fu et al. 2018, equation 4)."""
    return r + discount * next_value - value


class Loss(NamedTuple):
    """A discriminator's loss and its two terms, of each member."""

    total: PerMember
    cross_entropy: PerMember
    penalty: PerMember


def airl_loss(
    expert_logit: Vector, policy_logit: Vector, grad_norm: Vector, penalty_weight: float
) -> Loss:
    """Return -E_expert log D - E_policy log(1 - D) + λ E (‖∇f‖ - 1)², for D = σ(logit)."""
    cross_entropy = (softplus(-expert_logit) + softplus(policy_logit)).mean(-1)
    penalty = (grad_norm - 1).square().mean(-1)
    return Loss(cross_entropy + penalty_weight * penalty, cross_entropy, penalty)


def entropy(logit: Vector) -> Vector:
    """Return the entropy, in nats, of D = σ(logit): log 2 where it cannot tell, 0 where it can."""
    return softplus(logit) - logit * torch.sigmoid(logit)


def diagnostics(loss: Loss, expert_logit: Vector, policy_logit: Vector) -> Metrics:
    """Return what tells how a discriminator is doing."""
    return {
        "cross_entropy": loss.cross_entropy.detach(),
        "penalty": loss.penalty.detach(),
        "expert_logit": expert_logit.detach().mean(-1),
        "policy_logit": policy_logit.detach().mean(-1),
        "accuracy": ((expert_logit > 0).float() + (policy_logit < 0).float()).mean(-1) / 2,
        "entropy": (entropy(expert_logit) + entropy(policy_logit)).detach().mean(-1) / 2,
    }


def per_episode(logit: Vector, horizon: int) -> Float[Tensor, "S E"]:
    """Return the sum of the logits of each `horizon` steps (Finn et al. 2016)."""
    return logit.unflatten(1, (-1, horizon)).sum(-1)


class Transitions(NamedTuple):
    """What a discriminator looks at: normalised observations, and actions."""

    obs: Obs
    action: Action
    next_obs: Obs


Sides = tuple[Transitions, Transitions]
LogProbs = tuple[Vector, Vector]
"""Of the expert and of the policy."""

Mixing = Float[Tensor, "S B 4"]
"""Uniform in [0, 1): where s, a, s' and log π are, from the policy's (0) to the expert's (1)."""


class Judgement(NamedTuple):
    """What a discriminator says of a minibatch of the expert's and one of the policy's."""

    transitions: Transitions
    expert_logit: Vector
    policy_logit: Vector
    grad_norm: Vector


class Discriminator:
    """r and V of `S` members, and how they are trained.

    `normaliser` scales every observation that comes in. The penalty holds ‖∇f‖ near 1 in the
    coordinates that it gives, so their scale is part of the algorithm. `horizon` steps are judged
    together: an episode's for GAN-GCL, otherwise 1. `env_id` names the rewards that are learned.
    """

    log_prob_in_penalty = False
    """Whether the gradient penalty contains log π, of a policy that has one."""

    def __init__(
        self,
        config: DiscriminatorConfig,
        obs_dim: int,
        action_dim: int,
        rng: Rng,
        normaliser: Normaliser,
        horizon: int = 1,
        env_id: str = "",
    ) -> None:
        self.config, self.normaliser = config, normaliser
        self.horizon, self.env_id = horizon, env_id
        self.is_airl = config.reward in IMPLEMENTATIONS
        self.has_policy = self.is_airl or config.reward == "gan-gcl"
        self.policy_in_logit = self.has_policy and config.loss != "released"
        # Whether the loss contains log π, in the logit or in the penalty.
        self.needs_log_prob = self.policy_in_logit or (self.has_policy and self.log_prob_in_penalty)
        kind = IMPLEMENTATIONS.get(config.reward, Implementation(False, self.has_policy))
        self.state_only, self.reward_is_logit = kind
        inputs = obs_dim if self.state_only else obs_dim + action_dim
        self.reward_net = StackedMLP((inputs, *config.reward_hidden, 1), config.activation)
        self.value_net = StackedMLP((obs_dim, *config.shaping_hidden, 1), config.activation)
        # Everything that updates change: the tensors themselves.
        self.state: dict[str, Tensor] = {}
        self.reward_params, self.value_params = self.init(rng)
        self.reward_optimizer = Adam(self.reward_params, LEARNING_RATE)
        self.value_optimizer = Adam(self.value_params, LEARNING_RATE)
        optimizers = {"reward": self.reward_optimizer, "value": self.value_optimizer}
        self.state |= optimizer_states(**optimizers)
        # What r does not see, its first layer ignores.
        self.mask = None
        if config.reward_sees is not None:
            seen = [*config.reward_sees, *range(obs_dim, inputs)]
            self.mask = self.reward_net.mask(seen).to(rng.device)

    def init(self, rng: Rng) -> tuple[Params, Params]:
        """Draw the initial weights of r and V."""
        return self.reward_net.init(rng), self.value_net.init(rng)

    @property
    def weights(self) -> tuple[Params, Params]:
        """The weights of `reward_net` and `value_net`, made of those that are trained."""
        seeing = self.reward_params if self.mask is None else self.reward_params * self.mask
        return seeing, self.value_params

    def seen(self, batch: Batch) -> Transitions:
        """Return transitions as the discriminator sees them."""
        obs, next_obs = self.normaliser(batch.obs), self.normaliser(batch.next_obs)
        return Transitions(obs, batch.action, next_obs)

    def reward_input(self, transitions: Transitions) -> Float[Tensor, "S B in"]:
        """Return what r sees: s, or s and a."""
        obs, action, _ = transitions
        return obs if self.state_only else torch.cat([obs, action], -1)

    def f(self, transitions: Transitions) -> Vector:
        """Return f(s, a, s') = r + γ V(s') - V(s); without AIRL there is no shaping."""
        of_reward, of_value = self.weights
        r = self.reward_net(of_reward, self.reward_input(transitions)).squeeze(-1)
        if not self.is_airl:
            return r
        states = torch.cat([transitions.obs, transitions.next_obs], 1)
        value, next_value = self.value_net(of_value, states).squeeze(-1).chunk(2, 1)
        return shaped_reward(r, value, next_value, self.config.discount)

    def f_and_gradients(self, transitions: Transitions) -> tuple[Vector, Transitions]:
        """Return f and its gradients ∇f by s, a and s'."""
        (obs, _, next_obs), (of_reward, of_value) = transitions, self.weights
        x, obs_dim = self.reward_input(transitions), obs.shape[-1]
        r, slope = self.reward_net.value_and_input_gradient(of_reward, x)
        by_obs, by_action = slope[..., :obs_dim], slope[..., obs_dim:]
        if not self.is_airl:
            return r, Transitions(by_obs, by_action, torch.zeros_like(by_obs))
        states = torch.cat([obs, next_obs], 1)
        both = self.value_net.value_and_input_gradient(of_value, states)
        (value, next_value), (slope, next_slope) = (part.chunk(2, 1) for part in both)
        f = shaped_reward(r, value, next_value, self.config.discount)
        return f, Transitions(by_obs - slope, by_action, self.config.discount * next_slope)

    def logit(self, f: Vector, log_prob: Vector) -> Float[Tensor, "S E"]:
        """Return ℓ = f - log π, or f alone; GAN-GCL's is summed over each episode."""
        return per_episode(log_odds(f, log_prob) if self.policy_in_logit else f, self.horizon)

    def gradient_norm(self, sides: Sides, log_probs: LogProbs, coefficient: Mixing) -> Vector:
        """Return ‖∇f‖ at a random point between each expert's and policy's transition."""
        share = coefficient[..., :1]  # for s, a and s' alike
        mixed = Transitions(*(torch.lerp(p, e, share) for e, p in zip(*sides, strict=True)))
        gradients = self.f_and_gradients(mixed)[1]
        by_obs, by_action, by_next_obs = (part.square().sum(-1) for part in gradients)
        return (by_obs + by_action + by_next_obs + TINY).sqrt()

    def judge(
        self,
        expert: Batch,
        policy: Batch,
        expert_log_prob: Vector,
        policy_log_prob: Vector,
        coefficient: Mixing,
    ) -> Judgement:
        """Return logits and ‖∇f‖, from which the loss is made.

        log π, or what stands for it (`DiscriminatorConfig.loss`), may be None unless
        `needs_log_prob`. `coefficient` says where between both sides the penalty is taken.
        """
        sides = self.seen(expert), self.seen(policy)
        both = Transitions(*(torch.cat(parts, 1) for parts in zip(*sides, strict=True)))
        expert_f, policy_f = self.f(both).chunk(2, 1)
        return Judgement(
            both,
            self.logit(expert_f, expert_log_prob),
            self.logit(policy_f, policy_log_prob),
            self.gradient_norm(sides, (expert_log_prob, policy_log_prob), coefficient),
        )

    def loss(self, judgement: Judgement) -> tuple[Scalar, Metrics]:
        """Return the loss and diagnostics."""
        _, expert_logit, policy_logit, grad_norm = judgement
        loss = airl_loss(expert_logit, policy_logit, grad_norm, self.config.gradient_penalty)
        return loss.total.sum(), diagnostics(loss, expert_logit, policy_logit)

    def update(self, *minibatch: Any) -> Metrics:
        """Take one step down the loss of a minibatch, which `judge` describes."""
        loss, metrics = self.loss(self.judge(*minibatch))
        value = [self.value_optimizer] if self.is_airl else []
        descend(loss, self.reward_optimizer, *value)
        return metrics

    @torch.no_grad()
    def reward(self, batch: Batch, log_density: LogDensity) -> Vector:
        """Return the learner's reward; `log_density` is asked for log π where it is a part."""
        if not self.reward_is_logit:
            r = self.frozen(batch.obs, batch.action)
            return r if self.is_airl else OF_LOGIT[self.config.reward](r)
        f = self.f(self.seen(batch))
        return log_odds(f, log_density(batch)) if self.config.log_prob_in_reward else f

    @property
    def frozen(self) -> Reward:
        """r as it is now; later updates do not change it."""
        params = self.weights[0].detach().clone()
        return Reward(self.env_id, self.reward_net, self.state_only, params, self.normaliser)


@singledispatch
def make_discriminator(config: DiscriminatorConfig, *given: Any, **named: Any) -> Discriminator:
    """Return the discriminator that its settings ask for; an ablation has settings of its own."""
    return Discriminator(config, *given, **named)
