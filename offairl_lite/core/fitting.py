"""One block of training: the discriminator's updates, then the learner's.

The discriminator is trained on the demonstrations and the replay while the policy stays as it is;
then the learner is trained on the reward, which stays as it is. So log π and rewards of many
minibatches are computed in one pass. All functions return the diagnostics of the last update.
"""

from collections.abc import Iterator

from jaxtyping import Float
from torch import Tensor

from offairl_lite.core.models import Models, OfBatch
from offairl_lite.core.ppo import EPOCHS
from offairl_lite.core.replay import Batch, Replay, choose
from offairl_lite.core.rng import Rng
from offairl_lite.core.sac import ACTOR_DELAY

CHUNK = 50
"""Minibatches that are gathered, and given log π or rewards, in one pass."""

Metrics = dict[str, Float[Tensor, "S"]]


def fit_discriminator(
    models: Models,
    demonstrations: Batch,
    replay: Replay,
    rng: Rng,
    updates: int,
    batch_size: int,
    log_density: OfBatch,
) -> Metrics:
    """Train the discriminator on demonstrations (axes `N`) and on replay, half and half."""
    discriminator = models.discriminator
    horizon = discriminator.horizon
    size = max(batch_size // horizon, 1) * horizon
    for minibatches in _chunks(updates):
        count = minibatches * size
        index = choose(rng, [len(demonstrations.obs)] * len(rng), count, horizon)
        expert = Batch(*(part[index] for part in demonstrations))
        policy = replay.sample(rng, count, horizon)
        coefficient = rng.uniform(count, 4)
        log_probs = [[None] * minibatches] * 2
        if discriminator.needs_log_prob:
            log_probs = [log_density(side).split(size, 1) for side in (expert, policy)]
        sides = expert.split(size), policy.split(size)
        for minibatch in zip(*sides, *log_probs, coefficient.split(size, 1), strict=True):
            metrics = models.update_discriminator(*minibatch)
    return metrics


def fit_learner(
    models: Models,
    replay: Replay,
    rng: Rng,
    updates: int,
    batch_size: int,
    reward: OfBatch,
    done: int,
) -> Metrics:
    """Train SAC or TD3 on replay; after `done` updates every `ACTOR_DELAY`-th has the actor."""
    metrics: Metrics = {}
    absorbing_reward = models.absorbing_reward_of(reward)
    for minibatches in _chunks(updates):
        batch = replay.sample(rng, minibatches * batch_size)
        r, r_absorbing = reward(batch), absorbing_reward(batch)
        if models.config.learner.centre_reward:
            mean = r.mean(1, keepdim=True)
            r, r_absorbing = r - mean, r_absorbing - mean
        action_dim = batch.pre_tanh.shape[-1]
        noise = rng.normal(2, minibatches * batch_size, action_dim).transpose(0, 1)
        parts = batch.split(batch_size), r.split(batch_size, 1), noise.split(batch_size, 2)
        for minibatch, r_minibatch, eps in zip(*parts, strict=True):
            done += 1
            delayed = done % ACTOR_DELAY == 0
            metrics |= models.update_learner(minibatch, r_minibatch, r_absorbing, eps, delayed)
    return metrics


def fit_on_policy(
    models: Models, block: Batch, rng: Rng, batch_size: int, reward: OfBatch
) -> Metrics:
    """Train PPO on the steps, in order, that the present policy has just taken."""
    rollout = models.learner.rollout(block, reward(block))
    steps, action_dim = rollout.advantage.shape[1], block.pre_tanh.shape[-1]
    for _ in range(EPOCHS):
        order = rng.uniform(steps).argsort(1)
        noise = rng.normal(steps, action_dim)
        pairs = zip(order.split(batch_size, 1), noise.split(batch_size, 1), strict=True)
        for index, eps in pairs:
            metrics = models.update_learner(rollout.rows(index), eps)
    return metrics


def _chunks(updates: int) -> Iterator[int]:
    return (min(CHUNK, updates - done) for done in range(0, updates, CHUNK))
