"""Off-policy AIRL for one seed in ordinary PyTorch, as chapters 2 to 5 write it.

`core` is the same program for many seeds at once. Whatever needs random
numbers is given them, or a generator `rng` to draw them from.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import gymnasium
import torch
from jaxtyping import Float
from torch import Generator, Tensor, nn
from torch.nn.functional import softplus

HIDDEN = 64, 64
adam = partial(torch.optim.Adam, lr=1e-3)

# Shapes: `*B` is a batch of transitions, or nothing for a single one.
Obs = Float[Tensor, "*B O"]
Action = Float[Tensor, "*B A"]
Vector = Float[Tensor, "*B"]  # one number for each transition
TwinQ = Float[Tensor, "2 *B"]  # the values of both critics
Scalar = Float[Tensor, ""]

# Chapter 2: the parts of a discriminator.


def mlp(
    sizes: Sequence[int], activation: type[nn.Module], rng: Generator
) -> nn.Sequential:
    """Return a network with layers of these sizes and a linear output.

    Its weights are Glorot-uniform (Glorot and Bengio 2010), its biases zero.
    """
    layers = []
    for inputs, outputs in pairwise(sizes):
        linear = nn.Linear(inputs, outputs)
        nn.init.xavier_uniform_(linear.weight, generator=rng)
        nn.init.zeros_(linear.bias)
        layers += [linear, activation()]
    return nn.Sequential(*layers[:-1])


def binary_cross_entropy(expert_logit: Vector, policy_logit: Vector) -> Scalar:
    """Return -E_expert log D - E_policy log(1 - D) for D = σ(logit)."""
    # softplus(x) = log(1 + eˣ) is right even where D rounds to 0 or 1.
    return softplus(-expert_logit).mean() + softplus(policy_logit).mean()


def gradient_penalty(
    f: Callable[[Float[Tensor, "B X"]], Vector],
    expert: Float[Tensor, "B X"],
    policy: Float[Tensor, "B X"],
    mix: Float[Tensor, "B 1"],
) -> Scalar:
    """Return E (‖∇f(x)‖ - 1)² at x = mix · expert + (1 - mix) · policy.

    It keeps f from becoming a cliff between the two (Gulrajani et al. 2017).
    """
    x = torch.lerp(policy, expert, mix).requires_grad_()
    # The penalty is differentiated in turn, so ∇f needs a graph of its own.
    (gradient,) = torch.autograd.grad(f(x).sum(), x, create_graph=True)
    return (gradient.norm(dim=-1) - 1).square().mean()


def descend(loss: Scalar, optimizer: torch.optim.Optimizer) -> None:
    """Step down the gradient of `loss` by the optimizer's own parameters."""
    # Nothing else gets a gradient: the actor's loss leaves none in the critics.
    parameters = optimizer.param_groups[0]["params"]
    gradients = torch.autograd.grad(loss, parameters)
    for parameter, gradient in zip(parameters, gradients, strict=True):
        parameter.grad = gradient
    optimizer.step()


# Chapter 3: a reward inside the discriminator.


class Batch(NamedTuple):
    """Transitions, whose actions are tanh(`pre_tanh`).

    `terminated` is 1 where the task ended for good. A time limit does not
    terminate: the next state still has a value.
    """

    obs: Obs
    pre_tanh: Action
    next_obs: Obs
    reward: Vector
    terminated: Vector


class Discriminator(nn.Module):
    """AIRL's D = eᶠ / (eᶠ + π), that is, σ(f - log π) (Fu et al. 2018)."""

    def __init__(self, obs_dim: int, rng: Generator, discount: float = 0.99):
        super().__init__()
        self.reward = mlp((obs_dim, *HIDDEN, 1), nn.Tanh, rng)
        self.value = mlp((obs_dim, *HIDDEN, 1), nn.Tanh, rng)
        self.discount = discount

    def r(self, obs: Obs) -> Vector:
        """Return the reward r(s), which the policy is trained on."""
        return self.reward(obs).squeeze(-1)

    def f(self, obs: Obs, next_obs: Obs) -> Vector:
        """Return f = r(s) + γ V(s') - V(s)."""
        shaping = self.discount * self.value(next_obs) - self.value(obs)
        return self.r(obs) + shaping.squeeze(-1)


def airl_loss(
    f: Callable[[Obs, Obs], Vector],
    expert: Batch,
    policy: Batch,
    log_probs: tuple[Vector, Vector],
    mix: Float[Tensor, "B 1"],
    penalty_weight: float = 10.0,
) -> Scalar:
    """Return the cross-entropy of the logits f - log π, plus the penalty of f."""
    expert_logit = f(expert.obs, expert.next_obs) - log_probs[0]
    policy_logit = f(policy.obs, policy.next_obs) - log_probs[1]
    x = (torch.cat([side.obs, side.next_obs], -1) for side in (expert, policy))
    penalty = gradient_penalty(lambda x: f(*x.chunk(2, -1)), *x, mix)
    loss = binary_cross_entropy(expert_logit, policy_logit)
    return loss + penalty_weight * penalty


# Chapter 4: soft actor-critic (Haarnoja et al. 2018).


def log_density(pre_tanh: Action, mean: Action, log_std: Action) -> Vector:
    """Return log π(a) = log N(u; μ, σ²) - log(1 - tanh² u) of a = tanh(u).

    It takes u, `pre_tanh`, which an a that was rounded to ±1 has lost.
    """
    z = (pre_tanh - mean) / log_std.exp()
    log_normal = -0.5 * z.square() - log_std - 0.5 * math.log(2 * math.pi)
    # log(1 - tanh² u), in a form that is exact for any u:
    log_slope = 2 * (math.log(2) - pre_tanh - softplus(-2 * pre_tanh))
    return (log_normal - log_slope).sum(-1)


class Actor(nn.Module):
    """The policy: a = tanh(u) with u ~ N(μ(s), σ(s)²)."""

    def __init__(self, obs_dim: int, action_dim: int, rng: Generator):
        super().__init__()
        self.net = mlp((obs_dim, *HIDDEN, 2 * action_dim), nn.ReLU, rng)

    def forward(self, obs: Obs) -> tuple[Action, Action]:
        """Return μ(s) and log σ(s), the latter between -5 and 2."""
        mean, raw = self.net(obs).chunk(2, -1)
        return mean, -5 + 3.5 * (torch.tanh(raw) + 1)

    def sample(self, obs: Obs, noise: Action) -> tuple[Action, Vector]:
        """Return u = μ + σ · noise, and log π of its action."""
        mean, log_std = self(obs)
        pre_tanh = mean + log_std.exp() * noise
        return pre_tanh, log_density(pre_tanh, mean, log_std)

    @torch.no_grad()
    def log_prob(self, batch: Batch) -> Vector:
        """Return log π(a|s) of given actions, as numbers without gradient."""
        return log_density(batch.pre_tanh, *self(batch.obs))


class TwinCritic(nn.Module):
    """Q₁ and Q₂, of which the smaller counts (Fujimoto et al. 2018)."""

    def __init__(self, obs_dim: int, action_dim: int, rng: Generator):
        super().__init__()
        sizes = obs_dim + action_dim, *HIDDEN, 1
        self.nets = nn.ModuleList(mlp(sizes, nn.ReLU, rng) for _ in range(2))

    def forward(self, obs: Obs, pre_tanh: Action) -> TwinQ:
        """Return both values of the action tanh(`pre_tanh`)."""
        x = torch.cat([obs, torch.tanh(pre_tanh)], -1)
        return torch.stack([net(x).squeeze(-1) for net in self.nets])


def critic_target(
    reward: Vector, terminated: Vector, next_value: Vector, discount: float
) -> Vector:
    """Return y = r + γ (1 - terminated) V(s')."""
    return reward + discount * (1 - terminated) * next_value


def soft_value(log_prob: Vector, q: TwinQ, alpha: Scalar) -> Vector:
    """Return V(s) = min Q(s, a) - α log π(a|s) for an a drawn from π."""
    return q.amin(0) - alpha * log_prob


def critic_loss(q: TwinQ, target: Vector) -> Scalar:
    """Return J_Q = E (Q₁ - y)² + E (Q₂ - y)²."""
    return (q - target).square().mean(-1).sum()


def actor_loss(log_prob: Vector, q: TwinQ, alpha: Scalar) -> Scalar:
    """Return J_π = E[α log π(a|s) - min Q(s, a)]."""
    return (alpha * log_prob - q.amin(0)).mean()


def temperature_loss(
    alpha: Scalar, log_prob: Vector, target_entropy: float
) -> Scalar:
    """Return J_α = -E[α (log π + H̄)]: α grows while the entropy is below H̄."""
    return -(alpha * (log_prob.detach() + target_entropy)).mean()


class SAC:
    """Actor, critics with their slow copies, and the temperature α."""

    discount = 0.99
    target_rate = 0.01  # τ, by which the slow copies follow
    target_entropy = -1.0
    actor_delay = 2  # updates of the critics for one of the rest

    def __init__(self, obs_dim: int, action_dim: int, rng: Generator):
        self.actor = Actor(obs_dim, action_dim, rng)
        self.critic = TwinCritic(obs_dim, action_dim, rng)
        self.slow_critic = deepcopy(self.critic)
        self.log_alpha = torch.tensor(math.log(0.2), requires_grad=True)
        self.actor_optimizer = adam(self.actor.parameters())
        self.critic_optimizer = adam(self.critic.parameters())
        self.alpha_optimizer = adam([self.log_alpha])
        self.updates = 0

    def update(self, batch: Batch, reward: Vector, noise: Action) -> None:
        """Train on a reward, the batch's or another; noise is (2, B, A)."""
        self.updates += 1
        update_critic(self, batch, reward, noise[0])
        if self.updates % self.actor_delay == 0:
            update_actor(self, batch.obs, noise[1])
            follow(self.slow_critic, self.critic, self.target_rate)


def update_critic(
    sac: SAC, batch: Batch, reward: Vector, noise: Action
) -> None:
    """Move Q(s, a) towards y."""
    with torch.no_grad():
        next_action, log_prob = sac.actor.sample(batch.next_obs, noise)
        next_q = sac.slow_critic(batch.next_obs, next_action)
        value = soft_value(log_prob, next_q, sac.log_alpha.exp())
        target = critic_target(reward, batch.terminated, value, sac.discount)
    q = sac.critic(batch.obs, batch.pre_tanh)
    descend(critic_loss(q, target), sac.critic_optimizer)


def update_actor(sac: SAC, obs: Obs, noise: Action) -> None:
    """Move π towards actions of larger value, and its entropy towards H̄."""
    alpha = sac.log_alpha.exp()
    action, log_prob = sac.actor.sample(obs, noise)
    loss = actor_loss(log_prob, sac.critic(obs, action), alpha.detach())
    descend(loss, sac.actor_optimizer)
    loss = temperature_loss(alpha, log_prob, sac.target_entropy)
    descend(loss, sac.alpha_optimizer)


@torch.no_grad()
def follow(target: nn.Module, source: nn.Module, rate: float) -> None:
    """Move the weights of `target` towards those of `source`."""
    pairs = zip(target.parameters(), source.parameters(), strict=True)
    for slow, fast in pairs:
        slow.lerp_(fast, rate)


# Chapter 5: off-policy AIRL (Arnob 2020).


class Normaliser:
    """Scales observations: an even mix of both sources gets mean 0, variance 1."""

    def __init__(self, replayed: Obs, shown: Obs):
        self.mean = (replayed.mean(0) + shown.mean(0)) / 2
        sides = [(obs - self.mean).square().mean(0) for obs in (replayed, shown)]
        std = (sum(sides) / 2).sqrt()
        self.std = torch.where(std > 1e-6, std, 1.0)  # some never vary

    def __call__(self, obs: Obs) -> Obs:
        """Return scaled observations."""
        return (obs - self.mean) / self.std


def draw(data: Batch, count: int, scale: Normaliser, rng: Generator) -> Batch:
    """Return `count` random transitions, their observations scaled."""
    rows = torch.randint(len(data.reward), (count,), generator=rng)
    obs, pre_tanh, next_obs, *end = (column[rows] for column in data)
    return Batch(scale(obs), pre_tanh, scale(next_obs), *end)


@torch.no_grad()
def run_episode(env: gymnasium.Env, policy: Callable[[Obs], Action]) -> Batch:
    """Return one episode of a policy, which gives u for the action tanh(u)."""
    steps, done = [], False
    obs = torch.tensor(env.reset()[0], dtype=torch.float32)
    while not done:
        u = policy(obs)
        observed, reward, terminated, truncated, _ = env.step(u.tanh().numpy())
        next_obs = torch.tensor(observed, dtype=torch.float32)
        steps.append((obs, u, next_obs, *torch.tensor([reward, terminated])))
        obs, done = next_obs, terminated or truncated
    return Batch(*map(torch.stack, zip(*steps, strict=True)))


def sticky_actions(
    action_dim: int, rng: Generator, hold: int = 10
) -> Iterator[Float[Tensor, "A"]]:
    """Yield u of uniform actions, each held for `hold` steps on average.

    Whoever pushes in a new direction at every step stays where it is.
    """
    while True:
        u = torch.atanh(1.999999 * (torch.rand(action_dim, generator=rng) - 0.5))
        yield u
        while torch.rand((), generator=rng) > 1 / hold:
            yield u


class Replay:
    """All transitions so far."""

    def __init__(self, capacity: int, obs_dim: int, action_dim: int):
        sizes = (obs_dim,), (action_dim,), (obs_dim,), (), ()
        self.rows = Batch(*(torch.zeros(capacity, *size) for size in sizes))
        self.size = 0

    def add(self, episode: Batch) -> None:
        """Store an episode."""
        for column, values in zip(self.rows, episode, strict=True):
            column[self.size : self.size + len(values)] = values
        self.size += len(episode.reward)


def train(
    env: gymnasium.Env,
    expert: Batch,
    rng: Generator,
    total_steps: int = 6_000,
    warmup_steps: int = 3_000,
    batch_size: int = 64,
) -> Iterator[tuple[int, float, SAC, Discriminator, Normaliser]]:
    """Learn a reward and a policy from demonstrations (Algorithm 1).
    """
    env.reset(seed=int(torch.randint(2**31, (), generator=rng)))
    (_, obs_dim), (_, action_dim) = expert.obs.shape, expert.pre_tanh.shape
    random = sticky_actions(action_dim, rng)
    replay = Batch(*(column[:0] for column in expert))
    while len(replay.reward) < warmup_steps:
        replay = append(replay, run_episode(env, lambda obs: next(random)))
    scale = Normaliser(replay.obs, expert.obs)
    discriminator, sac = Discriminator(obs_dim, rng), SAC(obs_dim, action_dim, rng)
    optimizer = adam(discriminator.parameters())
    learned = 0  # steps that have been learned from
    while learned < total_steps:
        if learned == len(replay.reward):
            noise = partial(torch.randn, action_dim, generator=rng)
            policy = lambda obs: sac.actor.sample(scale(obs), torch.randn(action_dim, generator=rng))[0]
            replay = append(replay, run_episode(env, policy))
        steps = min(100, len(replay.reward) - learned)
        for _ in range(steps):
            sides = [draw(x, batch_size, scale, rng) for x in (expert, replay)]
            log_probs = [sac.actor.log_prob(side) for side in sides]
            mix = torch.rand(batch_size, 1, generator=rng)
            descend(airl_loss(discriminator.f, *sides, log_probs, mix), optimizer)
        for _ in range(steps):
            batch = draw(replay, batch_size, scale, rng)
            reward = discriminator.r(batch.obs).detach()
            noise = torch.randn(2, batch_size, action_dim, generator=rng)
            sac.update(batch, reward, noise)
        learned += steps
        if learned == len(replay.reward):
            returns = [run_episode(env, lambda obs: sac.actor(scale(obs))[0]).reward.sum() for _ in range(10)]
            yield learned, float(sum(returns)) / 10, sac, discriminator, scale


def append(replay, episode):
    return Batch(*map(torch.cat, zip(replay, episode, strict=True)))
