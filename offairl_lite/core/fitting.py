"""One block of training: the discriminator's updates, then the learner's.

The discriminator is trained on the demonstrations and the replay while the policy stays as it is;
then the learner is trained on the reward, which stays as it is. So log π and rewards of many
minibatches are computed in one pass. Both functions return the diagnostics of the last update.
"""

from collections.abc import Iterator

import torch

from offairl_lite.config import Labels
from offairl_lite.core.discriminator import LogDensity
from offairl_lite.core.models import Models
from offairl_lite.core.ppo import EPOCHS, PPO
from offairl_lite.core.replay import Batch, Replay, choose
from offairl_lite.core.rng import Rng
from offairl_lite.core.sac import ACTOR_DELAY
from offairl_lite.core.shapes import Metrics

CHUNK = 50
"""Minibatches that are gathered, and given log π or rewards, in one pass."""


def fit_discriminator(
    models: Models, shown: Batch | None, replay: Replay, steps: int, log_density: LogDensity
) -> Metrics:
    """Train the discriminator, if there is one, on demonstrations (axes `N`) and as much of replay.

    It has `discriminator_updates`, or as many as the block has steps.
    """
    discriminator, rng, metrics = models.discriminator, models.rng, {}
    if discriminator is None or shown is None:
        return {}
    horizon = discriminator.horizon
    size = max(models.config.schedule.batch_size // horizon, 1) * horizon
    for minibatches in _chunks(discriminator.config.updates or steps):
        count = minibatches * size
        index = choose(rng, [len(shown.obs)] * len(rng), count, horizon)
        expert = Batch(*(part[index] for part in shown))
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
    steps: int,
    log_density: LogDensity,
    done: int,
    shown: Batch | None = None,
) -> Metrics:
    """Train the learner as often as the block has steps, after `done` updates before.

    SAC and TD3 learn from replay, and every `ACTOR_DELAY`-th update has the actor. PPO learns from
    the block itself, and SQIL and IQ-Learn from what is `shown` (axes `N`) as well.
    """
    if isinstance(models.learner, PPO):
        return _fit_on_policy(models, models.learner, replay.last(steps), log_density)
    rng, batch_size = models.rng, models.config.schedule.batch_size
    metrics: Metrics = {}
    for minibatches in _chunks(steps):
        batch = replay.sample(rng, minibatches * batch_size)
        if shown is not None and isinstance(models.config.discriminator, Labels):
            batch = labelled(shown, batch, rng, batch_size)
        r = models.reward_of(batch, log_density)
        r_absorbing = models.absorbing_reward_of(batch, log_density)
        if models.learner.config.centre_reward:
            mean = r.mean(1, keepdim=True)
            r, r_absorbing = r - mean, r_absorbing - mean
        noise = rng.normal(models.learner.draws, *batch.pre_tanh.shape[1:]).transpose(0, 1)
        size = r.shape[1] // minibatches
        parts = batch.split(size), r.split(size, 1), noise.split(size, 2)
        for minibatch, r_minibatch, eps in zip(*parts, strict=True):
            done += 1
            delayed = done % ACTOR_DELAY == 0
            metrics |= models.update_learner(minibatch, r_minibatch, r_absorbing, eps, delayed)
    return metrics


def labelled(shown: Batch, replayed: Batch, rng: Rng, size: int) -> Batch:
    """Return minibatches, each of `size` demonstrations, paid 1, and `size` of replay, paid 0.

    `shown` has axes `N`, `replayed` and what is returned `S B` (Reddy et al. 2020, algorithm 1).
    """
    index = choose(rng, [len(shown.obs)] * len(rng), replayed.obs.shape[1])
    expert = Batch(*(part[index] for part in shown))
    expert = expert._replace(reward=torch.ones_like(expert.reward))
    policy = replayed._replace(reward=torch.zeros_like(replayed.reward))
    halves = zip(expert, policy, strict=True)
    in_turn = ([part.unflatten(1, (-1, size)) for part in pair] for pair in halves)
    return Batch(*(torch.cat(pair, 2).flatten(1, 2) for pair in in_turn))


def _fit_on_policy(models: Models, ppo: PPO, block: Batch, log_density: LogDensity) -> Metrics:
    """Train PPO on the steps, in order, that the present policy has just taken."""
    rollout = ppo.rollout(block, models.reward_of(block, log_density))
    rng, batch_size = models.rng, models.config.schedule.batch_size
    metrics: Metrics = {}
    for _ in range(EPOCHS):
        order = rng.uniform(block.obs.shape[1]).argsort(1).split(batch_size, 1)
        noise = rng.normal(*block.pre_tanh.shape[1:]).split(batch_size, 1)
        for index, eps in zip(order, noise, strict=True):
            metrics = models.update_learner(rollout.rows(index), eps)
    return metrics


def _chunks(updates: int) -> Iterator[int]:
    return (min(CHUNK, updates - done) for done in range(0, updates, CHUNK))
