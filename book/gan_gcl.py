"""GAN-GCL with PPO, in ordinary PyTorch, for one seed.

Its discriminator judges whole episodes (Finn et al. 2016). Networks,
densities and the penalty are those of `offairl_lite.plain`. Episodes are
all of one length T, which a time limit ends; E are played side by side.
"""

from collections.abc import Callable, Iterator

import torch
from jaxtyping import Float
from torch import Generator, Tensor, nn

from offairl_lite import plain
from offairl_lite.core.ppo import (
    CLIP,
    EPOCHS,
    GAE_DECAY,
    clipped_surrogate,
    gae,
)
from offairl_lite.envs import BatchedEnv
from offairl_lite.plain import Batch, adam, descend

Steps = Float[Tensor, "E T"]  # a number for each step of each episode

DISCOUNT, ENTROPY, MINIBATCH = 0.99, 1e-3, 250  # PPO's
UPDATES, EPISODES = 100, 2  # the discriminator's, after each block


def trajectory_logit(r: Steps, log_prob: Steps) -> Float[Tensor, "E"]:
    """Return ℓ(τ) = Σ_t r(s_t, a_t) - log π(a_t | s_t)."""
    return (r - log_prob).sum(-1)


def gan_gcl_loss(
    r: Callable[[plain.Obs, plain.Action], Steps],
    expert: Batch,
    policy: Batch,
    log_probs: list[Steps],
    mix: Float[Tensor, "E T 1"],  # where the penalty is taken
) -> plain.Scalar:
    """Return the cross-entropy of whole episodes, plus r's penalty."""
    sides = [(side.obs, side.pre_tanh.tanh()) for side in (expert, policy)]
    expert_logit, policy_logit = (
        trajectory_logit(r(*side), log_prob)
        for side, log_prob in zip(sides, log_probs, strict=True)
    )
    between = [torch.lerp(p, e, mix) for e, p in zip(*sides, strict=True)]
    penalty = plain.gradient_penalty(r, *between)
    return plain.cross_entropy(expert_logit, policy_logit) + 10 * penalty


class Actor(plain.Actor):
    """A policy that remains wide: only its noise leads out of the trap."""

    def forward(self, obs: plain.Obs) -> tuple[plain.Action, plain.Action]:
        """Return μ(s), and log σ(s) between -2 and 2."""
        mean, raw = self.net(obs).chunk(2, -1)
        return mean, 2 * torch.tanh(raw)


class GANGCL:
    """r(s, a), the policy, its value network, and their optimizers."""

    def __init__(self, obs_dim: int, action_dim: int, rng: Generator):
        sizes = [obs_dim + action_dim, *plain.HIDDEN, 1]
        self.reward = plain.mlp(sizes, nn.Tanh, rng)
        self.actor = Actor(obs_dim, action_dim, rng)
        self.value = plain.mlp([obs_dim, *plain.HIDDEN, 1], nn.ReLU, rng)
        with torch.no_grad():  # The first actions have no preference.
            self.actor.net[-1].weight *= 0.01
        nets = self.reward, self.actor, self.value
        self.optimizers = [adam(net.parameters()) for net in nets]

    def r(self, obs: plain.Obs, action: plain.Action) -> Steps:
        """Return the reward r(s, a)."""
        return self.reward(torch.cat([obs, action], -1)).squeeze(-1)

    @torch.no_grad()
    def log_odds(self, batch: Batch) -> Steps:
        """Return r - log π of each step, which the policy is paid."""
        r = self.r(batch.obs, batch.pre_tanh.tanh())
        return r - plain.log_pi(self.actor, batch)


def update_reward(
    model: GANGCL, expert: Batch, block: Batch, rng: Generator
):
    """Train D to tell demonstrated episodes from the policy's."""
    sides = []
    for side in (expert, block):
        rows = torch.randint(len(side.reward), (EPISODES,), generator=rng)
        sides.append(Batch(*(column[rows] for column in side)))
    log_probs = [plain.log_pi(model.actor, side) for side in sides]
    mix = torch.rand(*sides[0].reward.shape, 1, generator=rng)
    loss = gan_gcl_loss(model.r, *sides, log_probs, mix)
    descend(loss, model.optimizers[0])


def update_policy(model: GANGCL, block: Batch, rng: Generator):
    """Train the policy on a block of its own episodes, by PPO."""
    with torch.no_grad():
        seen, reward = (block.obs, block.next_obs), model.log_odds(block)
        values = [model.value(obs).squeeze(-1) for obs in seen]
        ends = torch.arange(1, 1 + reward.shape[1]) == reward.shape[1]
        ends = ends.expand_as(reward)
        after = block.terminated, ends, DISCOUNT, GAE_DECAY
        gain = gae(reward, *values, *after)
        old = plain.log_pi(model.actor, block)
    scaled = (gain - gain.mean()) / gain.std()
    columns = block.obs, block.pre_tanh, old, scaled, gain + values[0]
    rows = [column.flatten(0, 1) for column in columns]
    for _ in range(EPOCHS):
        order = torch.randperm(len(rows[0]), generator=rng)
        for index in order.split(MINIBATCH):
            obs, u, old, gain, target = (column[index] for column in rows)
            log_prob = plain.log_density(u, *model.actor(obs))
            noise = torch.randn(u.shape, generator=rng)
            entropy = -model.actor.sample(obs, noise)[1].mean()
            surrogate = clipped_surrogate(log_prob, old, gain, CLIP)
            descend(surrogate - ENTROPY * entropy, model.optimizers[1])
            error = model.value(obs).squeeze(-1) - target
            descend(error.square().mean(), model.optimizers[2])


@torch.no_grad()
def run_episodes(env: BatchedEnv, policy: plain.Policy) -> Batch:
    """Return an episode of each member; the policy gives u of tanh(u)."""
    steps, ended = [], False
    obs = torch.tensor(env.reset()[0], dtype=torch.float32)
    while not ended:
        u = policy(obs)
        *seen, truncated, _ = env.step(u.tanh().numpy())
        next_obs, *numbers = (torch.tensor(x).float() for x in seen)
        steps.append((obs, u, next_obs, *numbers))
        obs, ended = next_obs, truncated.all()
    return Batch(*(torch.stack(x, 1) for x in zip(*steps, strict=True)))


def train(
    env: BatchedEnv, demos: Batch, rng: Generator, blocks: int
) -> Iterator[tuple[GANGCL, Batch, Batch]]:
    """Run GAN-GCL; after each block yield both sides, scaled, axes E T."""
    dims = demos.obs.shape[-1], demos.pre_tanh.shape[-1]
    runs = [plain.sticky_actions(dims[1], rng) for _ in range(env.num_envs)]
    warmup = run_episodes(env, lambda _: torch.stack([*map(next, runs)]))
    scale = plain.normaliser(
        warmup.obs.flatten(0, 1), demos.obs.flatten(0, 1)
    )

    def scaled(batch: Batch) -> Batch:
        obs, next_obs = scale(batch.obs), scale(batch.next_obs)
        return batch._replace(obs=obs, next_obs=next_obs)

    model, expert = GANGCL(*dims, rng), scaled(demos)
    policy = plain.policy_of(model.actor, scale, rng)
    for _ in range(blocks):
        block = scaled(run_episodes(env, policy))
        for _ in range(UPDATES):
            update_reward(model, expert, block, rng)
        update_policy(model, block, rng)
        yield model, expert, block
