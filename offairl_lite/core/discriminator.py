r"""The discriminator: AIRL's, which contains a reward, and GAIL's, which is one.

It tells the expert's transitions (label 1) from the policy's (label 0). AIRL's logit is

$$\ell = f(s, a, s') - \log \pi(a|s), \qquad f = r_\psi + \gamma V_\omega(s') - V_\omega(s),$$

with $r_\psi(s)$ or $r_\psi(s, a)$. The log-ratio loss leaves $\log \pi$ out: $\ell = f$. GAIL's and
DAC's is the special case $\ell = r_\psi(s, a)$, without shaping.
"""

from collections.abc import Callable
from functools import singledispatch
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import softplus

from offairl_lite.config import DiscriminatorConfig
from offairl_lite.core.networks import TINY, Adam, Normaliser, StackedMLP, descend, states_of, zeros
from offairl_lite.core.replay import Batch, LogDensity
from offairl_lite.core.rewards import IMPLEMENTATIONS, OF_LOGIT, Implementation, Reward, log_odds
from offairl_lite.core.rng import Rng
from offairl_lite.core.shapes import (
    Action,
    Layout,
    Metrics,
    Obs,
    OtherParams,
    PerMember,
    Scalar,
    Vector,
)

LEARNING_RATE = 1e-3  #: Adam's, for r and V (Arnob 2020, section 5).


def shaped_reward(r: Vector, value: Vector, next_value: Vector, discount: float) -> Vector:
    """Return f = r + γ V(s') - V(s) (Fu et al. 2018, equation 4)."""
    return r + discount * next_value - value


class Loss(NamedTuple):
    """A discriminator's loss and its two terms, of each member."""

    total: PerMember
    cross_entropy: PerMember
    penalty: PerMember


def airl_loss(
    expert_logit: Vector,
    policy_logit: Vector,
    grad_norm: Float[Tensor, "S _"],
    penalty_weight: float,
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


class Transitions(NamedTuple):
    """Scaled observations, actions, and log π, which is 0 where the logit does not contain it."""

    obs: Obs
    action: Action
    next_obs: Obs
    log_prob: Vector


Mixing = Float[Tensor, "S B 4"]
"""Uniform in [0, 1): where s, a, s' and log π are, from the policy's (0) to the expert's (1)."""

Gradients = tuple[Obs, Action, Obs]  #: ∇f by s, a and s'.


def both_sides(expert: Transitions, policy: Transitions) -> Transitions:
    """Return both in one batch, the expert's first."""
    return Transitions(*(torch.cat(parts, 1) for parts in zip(expert, policy, strict=True)))


class Discriminator:
    """r and V of `S` members, and how they are trained; the weights are zeros until `init`.

    The penalty holds ‖∇f‖ near 1 in scaled observations: their scale is part of the algorithm.
    """

    log_prob_in_penalty = False  #: Whether the gradient penalty contains log π.

    def __init__(
        self,
        config: DiscriminatorConfig,
        layout: Layout,
        wrap: Callable[[StackedMLP], Any] = lambda net: net,
    ) -> None:
        self.config = config
        self.is_airl = config.reward in IMPLEMENTATIONS
        self.policy_in_logit = self.is_airl and config.loss != "log-ratio"
        self.needs_log_prob = self.policy_in_logit or (self.is_airl and self.log_prob_in_penalty)
        kind = IMPLEMENTATIONS.get(config.reward, Implementation(False, False))
        self.state_only, self.reward_is_logit = kind
        inputs = layout.obs_dim + (0 if self.state_only else layout.action_dim)
        self.reward_net = StackedMLP((inputs, *config.reward_hidden, 1), config.activation)
        self.value_net = StackedMLP((layout.obs_dim, *config.shaping_hidden, 1), config.activation)
        # What is trained: these networks, or what an ablation makes of them.
        self.trained = wrap(self.reward_net), wrap(self.value_net)
        self.reward_params = zeros(layout, self.trained[0].num_params)
        self.value_params = zeros(layout, self.trained[1].num_params)
        self.reward_optimizer = Adam(self.reward_params, LEARNING_RATE)
        self.value_optimizer = Adam(self.value_params, LEARNING_RATE)
        self.state = states_of(reward=self.reward_optimizer, value=self.value_optimizer)
        # What r must not see, its first layer multiplies with 0.
        self.mask = None
        if config.reward_sees is not None:
            # The indicator, too: what the end is worth is no matter of what r sees elsewhere.
            indicator = [layout.obs_dim - 1] * layout.absorbs
            visible = [*config.reward_sees, *indicator, *range(layout.obs_dim, inputs)]
            self.mask = self.reward_net.mask(visible).to(layout.device)

    @torch.no_grad()
    def init(self, rng: Rng, reward: Reward | None = None) -> None:
        """Draw the initial weights, in place, or take those of r from an earlier reward."""
        for params, net in zip((self.reward_params, self.value_params), self.trained, strict=True):
            params.copy_(net.init(rng))
        if reward is not None:
            self.reward_params.copy_(reward.params)

    @property
    def weights(self) -> tuple[OtherParams, OtherParams]:
        """The weights of `reward_net` and `value_net`, made of those that are trained."""
        seeing = self.reward_params if self.mask is None else self.reward_params * self.mask
        return seeing, self.value_params

    def transitions(self, batch: Batch, log_prob: Vector) -> Transitions:
        """Return scaled transitions as the discriminator looks at them."""
        return Transitions(batch.obs, batch.action, batch.next_obs, log_prob)

    def reward_input(self, transitions: Transitions) -> Float[Tensor, "S B in"]:
        """Return what r sees: s, or s and a."""
        obs, action = transitions[:2]
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

    def f_and_gradients(self, transitions: Transitions) -> tuple[Vector, Gradients]:
        """Return f and its gradients ∇f by s, a and s'."""
        obs, next_obs = transitions.obs, transitions.next_obs
        (of_reward, of_value), obs_dim = self.weights, obs.shape[-1]
        x = self.reward_input(transitions)
        r, slope = self.reward_net.value_and_input_gradient(of_reward, x)
        by_obs, by_action = slope[..., :obs_dim], slope[..., obs_dim:]
        if not self.is_airl:
            return r, (by_obs, by_action, torch.zeros_like(by_obs))
        states = torch.cat([obs, next_obs], 1)
        both = self.value_net.value_and_input_gradient(of_value, states)
        (value, next_value), (slope, next_slope) = (part.chunk(2, 1) for part in both)
        f = shaped_reward(r, value, next_value, self.config.discount)
        return f, (by_obs - slope, by_action, self.config.discount * next_slope)

    def gradient_norm(self, expert: Transitions, policy: Transitions, mixing: Mixing) -> Vector:
        """Return ‖∇f‖ at a random point between each expert's and policy's transition."""
        share = mixing[..., :1]  # for s, a and s' alike
        points = [torch.lerp(p, e, share) for p, e in zip(policy[:3], expert[:3], strict=True)]
        # f does not see log π.
        between = policy._replace(obs=points[0], action=points[1], next_obs=points[2])
        gradients = self.f_and_gradients(between)[1]
        by_obs, by_action, by_next_obs = (part.square().sum(-1) for part in gradients)
        return (by_obs + by_action + by_next_obs + TINY).sqrt()

    def logits(self, expert: Transitions, policy: Transitions) -> tuple[Vector, Vector]:
        """Return ℓ = f - log π, or ℓ = f, of the expert's and of the policy's transitions."""
        expert_f, policy_f = self.f(both_sides(expert, policy)).chunk(2, 1)
        if not self.policy_in_logit:
            # In one piece, as a difference is: functions of rows round their ends otherwise.
            return expert_f.contiguous(), policy_f.contiguous()
        return log_odds(expert_f, expert.log_prob), log_odds(policy_f, policy.log_prob)

    def loss(
        self, expert: Transitions, policy: Transitions, mixing: Mixing
    ) -> tuple[Scalar, Metrics]:
        """Return the loss, summed over members, with its penalty at `mixing`, and diagnostics."""
        expert_logit, policy_logit = self.logits(expert, policy)
        grad_norm = self.gradient_norm(expert, policy, mixing)
        loss = airl_loss(expert_logit, policy_logit, grad_norm, self.config.gradient_penalty)
        return loss.total.sum(), diagnostics(loss, expert_logit, policy_logit)

    def update(self, expert: Transitions, policy: Transitions, mixing: Mixing) -> Metrics:
        """Take one step down the loss."""
        loss, metrics = self.loss(expert, policy, mixing)
        value = [self.value_optimizer] if self.is_airl else []
        descend(loss, self.reward_optimizer, *value)
        return metrics

    @torch.no_grad()
    def reward(self, batch: Batch, log_density: LogDensity) -> Vector:
        """Return the learner's reward of scaled transitions, with log π where it is a part."""
        pays_log_prob = self.reward_is_logit and self.config.log_prob_in_reward
        log_prob = log_density(batch) if pays_log_prob else torch.zeros_like(batch.reward)
        transitions = self.transitions(batch, log_prob)
        if self.reward_is_logit:
            return log_odds(self.f(transitions), log_prob)
        r = self.reward_net(self.weights[0], self.reward_input(transitions)).squeeze(-1)
        return r if self.is_airl else OF_LOGIT[self.config.reward](r)

    def snapshot(self, env_id: str, normaliser: Normaliser) -> Reward | None:
        """Return r as it is now; later updates do not change it."""
        params = self.weights[0].detach().clone()
        return Reward(env_id, self.reward_net, self.state_only, params, normaliser)


@singledispatch
def make_discriminator(config: DiscriminatorConfig, layout: Layout) -> Discriminator:
    """Return the discriminator that its settings ask for; an ablation has settings of its own."""
    return Discriminator(config, layout)
