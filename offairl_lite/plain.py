"""Off-policy AIRL in ordinary PyTorch, for one seed: chapters 2 to 5."""

import math
from collections.abc import Callable, Iterator
from copy import deepcopy
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import torch
from gymnasium import Env
from jaxtyping import Float
from torch import Generator, Tensor, nn
from torch.nn.functional import softplus

HIDDEN, BATCH_SIZE = (64, 64), 64
adam = partial(torch.optim.Adam, lr=1e-3, fused=True)  # fused is faster

# Shapes: `*B` is a batch of transitions, or nothing for a single one.
Obs = Float[Tensor, "*B O"]
Action = Float[Tensor, "*B A"]
Vector = Float[Tensor, "*B"]  # one number for each transition
TwinQ = Float[Tensor, "2 *B"]  # the values of both critics
Scalar = Float[Tensor, ""]
Scale = Callable[[Obs], Obs]
Policy = Callable[[Obs], Action]


# Chapter 2: the parts of a discriminator.
def mlp(sizes: list[int], activation: type, rng: Generator) -> nn.Module:
    """Return a network with Glorot-uniform weights and a linear output."""
    layers = []
    for inputs, outputs in pairwise(sizes):
        linear = nn.Linear(inputs, outputs)
        nn.init.xavier_uniform_(linear.weight, generator=rng)
        nn.init.zeros_(linear.bias)
        layers += [linear, activation()]
    return nn.Sequential(*layers[:-1])


def cross_entropy(expert_logit: Vector, policy_logit: Vector) -> Scalar:
    """Return -E_expert log D - E_policy log(1 - D) for D = σ(logit)."""
    return softplus(-expert_logit).mean() + softplus(policy_logit).mean()


def gradient_penalty(f: Callable[..., Vector], *x: Obs) -> Scalar:
    """Return E (‖∇f(x)‖ - 1)²: no cliffs in f (Gulrajani et al. 2017)."""
    at = [part.detach().requires_grad_() for part in x]
    # The penalty is differentiated in turn, so ∇f needs a graph of its own.
    gradients = torch.autograd.grad(f(*at).sum(), at, create_graph=True)
    return (torch.cat(gradients, -1).norm(dim=-1) - 1).square().mean()


def descend(loss: Scalar, optimizer: torch.optim.Optimizer):
    """Take one step; change only this optimizer's parameters."""
    optimizer.zero_grad()
    # No gradient for others: a policy's loss passes through other networks.
    loss.backward(inputs=optimizer.param_groups[0]["params"])
    optimizer.step()


# Chapter 3: a reward inside the discriminator.
class Batch(NamedTuple):
    """Transitions with actions tanh(`pre_tanh`).

    `terminated` is 1 where the task ended for good, and 0 at a time limit.
    """

    obs: Obs
    pre_tanh: Action
    next_obs: Obs
    reward: Vector
    terminated: Vector


class Discriminator(nn.Module):
    """AIRL's D = eᶠ / (eᶠ + π), that is, σ(f - log π) (Fu et al. 2018)."""

    discount = 0.99

    def __init__(self, obs_dim: int, rng: Generator):
        super().__init__()
        self.reward = mlp([obs_dim, *HIDDEN, 1], nn.Tanh, rng)
        self.value = mlp([obs_dim, *HIDDEN, 1], nn.Tanh, rng)
        self.optimizer = adam(self.parameters())

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
    log_probs: list[Vector],
    mix: Float[Tensor, "B 1"],  # where between both the penalty is taken
    penalty_weight: float = 10.0,
) -> Scalar:
    """Return the cross-entropy of f - log π, plus the penalty of f."""
    expert_logit = f(expert.obs, expert.next_obs) - log_probs[0]
    policy_logit = f(policy.obs, policy.next_obs) - log_probs[1]
    obs = torch.lerp(policy.obs, expert.obs, mix)
    next_obs = torch.lerp(policy.next_obs, expert.next_obs, mix)
    loss = cross_entropy(expert_logit, policy_logit)
    return loss + penalty_weight * gradient_penalty(f, obs, next_obs)


# Chapter 4: soft actor-critic (Haarnoja et al. 2018).
def log_density(pre_tanh: Action, mean: Action, log_std: Action) -> Vector:
    """Return log π = log N(u; μ, σ²) - log(1 - tanh² u) of a = tanh(u)."""
    z = (pre_tanh - mean) / log_std.exp()
    log_normal = -0.5 * z.square() - log_std - 0.5 * math.log(2 * math.pi)
    # In this form log(1 - tanh² u) is exact for any u.
    log_slope = 2 * (math.log(2) - pre_tanh - softplus(-2 * pre_tanh))
    return (log_normal - log_slope).sum(-1)


class Actor(nn.Module):
    """The policy: a = tanh(u) with u ~ N(μ(s), σ(s)²)."""

    def __init__(self, obs_dim: int, action_dim: int, rng: Generator):
        super().__init__()
        self.net = mlp([obs_dim, *HIDDEN, 2 * action_dim], nn.ReLU, rng)

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
def log_pi(actor: Actor, batch: Batch) -> Vector:
    """Return log π(a|s) of given actions, without gradients."""
    return log_density(batch.pre_tanh, *actor(batch.obs))


class TwinCritic(nn.Module):
    """Q₁ and Q₂, of which the smaller counts (Fujimoto et al. 2018)."""

    def __init__(self, obs_dim: int, action_dim: int, rng: Generator):
        super().__init__()
        sizes = [obs_dim + action_dim, *HIDDEN, 1]
        nets = [mlp(sizes, nn.ReLU, rng) for _ in range(2)]
        self.nets = nn.ModuleList(nets)

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
    alpha: Scalar,
    log_prob: Vector,
    target_entropy: float,
) -> Scalar:
    """Return J_α = -E[α (log π + H̄)], by which the entropy becomes H̄."""
    return -(alpha * (log_prob.detach() + target_entropy)).mean()


class SAC:
    """Actor, critics with their slow copies, and the temperature α."""

    discount = 0.99
    target_rate = 0.01  # τ, by which the slow copies follow
    target_entropy = -1.0
    actor_delay = 2  # critic updates per actor update

    def __init__(self, obs_dim: int, action_dim: int, rng: Generator):
        self.actor = Actor(obs_dim, action_dim, rng)
        self.critic = TwinCritic(obs_dim, action_dim, rng)
        self.slow_critic = deepcopy(self.critic)
        self.log_alpha = torch.tensor(math.log(0.2), requires_grad=True)
        self.actor_optimizer = adam(self.actor.parameters())
        self.critic_optimizer = adam(self.critic.parameters())
        self.alpha_optimizer = adam([self.log_alpha])
        self.updates = 0


def update_critic(sac: SAC, batch: Batch, reward: Vector, noise: Action):
    """Move Q(s, a) towards y."""
    with torch.no_grad():
        next_u, log_prob = sac.actor.sample(batch.next_obs, noise)
        next_q = sac.slow_critic(batch.next_obs, next_u)
        value = soft_value(log_prob, next_q, sac.log_alpha.exp())
        y = critic_target(reward, batch.terminated, value, sac.discount)
    q = sac.critic(batch.obs, batch.pre_tanh)
    descend(critic_loss(q, y), sac.critic_optimizer)


def update_actor(sac: SAC, obs: Obs, noise: Action):
    """Move π to actions of larger value, and its entropy towards H̄."""
    alpha = sac.log_alpha.exp()
    u, log_prob = sac.actor.sample(obs, noise)
    loss = actor_loss(log_prob, sac.critic(obs, u), alpha.detach())
    descend(loss, sac.actor_optimizer)
    loss = temperature_loss(alpha, log_prob, sac.target_entropy)
    descend(loss, sac.alpha_optimizer)


def follow(slow: nn.Module, fast: nn.Module, rate: float):
    """Move the weights of a slow copy towards those of its original."""
    weights = fast.state_dict()
    for name, weight in slow.state_dict().items():
        weight.lerp_(weights[name], rate)


def update_sac(sac: SAC, batch: Batch, reward: Vector, rng: Generator):
    """Train on a reward for each row, the batch's own or another."""
    noise = torch.randn(2, *batch.pre_tanh.shape, generator=rng)
    sac.updates += 1
    update_critic(sac, batch, reward, noise[0])
    if sac.updates % sac.actor_delay == 0:
        update_actor(sac, batch.obs, noise[1])
        follow(sac.slow_critic, sac.critic, sac.target_rate)


# Chapter 5: off-policy AIRL (Arnob 2020).
def normaliser(*sources: Obs) -> Scale:
    """Return the scaling to mean 0 and variance 1 of an even mixture."""
    mean = torch.stack([obs.mean(0) for obs in sources]).mean(0)
    squares = [(obs - mean).square().mean(0) for obs in sources]
    std = torch.stack(squares).mean(0).sqrt()
    std = torch.where(std > 1e-6, std, 1.0)  # A constant is only centred.
    return lambda obs: (obs - mean) / std


def join(episodes: list[Batch]) -> Batch:
    """Return the transitions of all episodes: the replay buffer."""
    return Batch(*map(torch.cat, zip(*episodes, strict=True)))


def draw(data: Batch, scale: Scale, rng: Generator) -> Batch:
    """Return a random minibatch, with scaled observations."""
    rows = torch.randint(len(data.reward), (BATCH_SIZE,), generator=rng)
    obs, pre_tanh, next_obs, *rest = (column[rows] for column in data)
    return Batch(scale(obs), pre_tanh, scale(next_obs), *rest)


@torch.no_grad()
def run_episode(env: Env, policy: Policy) -> Batch:
    """Return an episode of a policy that gives u for the action tanh(u)."""
    steps, done = [], False
    obs = torch.tensor(env.reset()[0], dtype=torch.float32)
    while not done:
        u = policy(obs)
        seen, reward, terminated, truncated, _ = env.step(u.tanh().numpy())
        next_obs = torch.tensor(seen, dtype=torch.float32)
        numbers = torch.tensor([reward, terminated], dtype=torch.float32)
        steps.append((obs, u, next_obs, *numbers))
        obs, done = next_obs, terminated or truncated
    return Batch(*map(torch.stack, zip(*steps, strict=True)))


def sticky_actions(action_dim: int, rng: Generator) -> Iterator[Action]:
    """Yield u of uniform actions, each held for ten steps on average."""
    while True:
        action = 2 * torch.rand(action_dim, generator=rng) - 1
        yield (u := torch.atanh(0.999999 * action))
        while torch.rand((), generator=rng) < 0.9:
            yield u


def explore(
    env: Env,
    action_dim: int,
    num_episodes: int,
    rng: Generator,
) -> list[Batch]:
    """Return episodes of held random actions, after seeding the task."""
    env.reset(seed=int(torch.randint(2**31, (), generator=rng)))
    u = sticky_actions(action_dim, rng)
    runs = range(num_episodes)
    return [run_episode(env, lambda _: next(u)) for _ in runs]


def policy_of(
    actor: Actor,
    scale: Scale,
    rng: Generator | None = None,
) -> Policy:
    """Return π for unscaled observations, or its mean without an rng."""

    def act(obs: Obs) -> Action:
        mean, log_std = actor(scale(obs))
        if rng is None:
            return mean
        return mean + log_std.exp() * torch.randn(mean.shape, generator=rng)

    return act


def evaluate(env: Env, policy: Policy) -> float:
    """Return the mean return of five episodes."""
    rewards = join([run_episode(env, policy) for _ in range(5)]).reward
    return rewards.sum().item() / 5


def update_discriminator(
    airl: Discriminator,
    actor: Actor,
    expert: Batch,
    policy: Batch,
    rng: Generator,
):
    """Train D to tell the expert's steps from those in the buffer."""
    log_probs = [log_pi(actor, batch) for batch in (expert, policy)]
    mix = torch.rand(BATCH_SIZE, 1, generator=rng)
    loss = airl_loss(airl.f, expert, policy, log_probs, mix)
    descend(loss, airl.optimizer)


def train(
    env: Env, demos: Batch, rng: Generator, num_episodes: int, warmup: int
) -> Iterator[tuple[int, SAC, Discriminator, Scale]]:
    """Run Algorithm 1; yield the steps and the learners so far."""
    dims = demos.obs.shape[1], demos.pre_tanh.shape[1]
    episodes = explore(env, dims[1], warmup, rng)
    scale = normaliser(join(episodes).obs, demos.obs)
    airl, sac = Discriminator(dims[0], rng), SAC(*dims, rng)
    for k in range(num_episodes):
        if k >= warmup:  # Until then the learners catch up.
            episodes += [run_episode(env, policy_of(sac.actor, scale, rng))]
        replay = join(episodes)
        for _ in episodes[k].reward:
            expert, policy = (draw(x, scale, rng) for x in (demos, replay))
            update_discriminator(airl, sac.actor, expert, policy, rng)
        for _ in episodes[k].reward:
            batch = draw(replay, scale, rng)
            update_sac(sac, batch, airl.r(batch.obs), rng)
        if k + 1 >= warmup:
            yield len(replay.reward), sac, airl, scale
