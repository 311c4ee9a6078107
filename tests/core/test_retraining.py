"""Retraining on a frozen reward is soft actor-critic from replay, and nothing else."""

import torch

from offairl_lite.core.loop import Trainer
from offairl_lite.core.sac import ACTOR_DELAY


def retrain(trainer, reward, updates):
    """Update SAC from replay, with a frozen reward of the state."""
    size = trainer.config.schedule.batch_size
    batch = trainer.collector.replay.sample(trainer.rng, updates * size)
    rewards = reward(batch.obs)
    noise = trainer.rng.normal(2, updates * size, 2).transpose(0, 1)
    parts = zip(batch.split(size), rewards.split(size, 1), noise.split(size, 2), strict=True)
    for k, (minibatch, r, eps) in enumerate(parts, 1):
        given = minibatch, r, torch.zeros(1, 1), eps  # no absorbing state
        trainer.models.learner.update(*given, k % ACTOR_DELAY == 0)


def test_retraining_is_plain_sac(tiny, frozen_reward):
    config = tiny.change(reward="frozen", total_steps=300, warmup_steps=200, batch_size=16)
    reward = frozen_reward(1)
    by_hand, package = (Trainer(config, (0,), frozen_reward=reward) for _ in range(2))
    for trainer in (by_hand, package):
        for _ in range(config.schedule.warmup_steps):
            trainer.collector.step(explore=None)
        trainer.build(trainer.normaliser())
    retrain(by_hand, reward, 20)
    package.fit(20)
    ours, theirs = (trainer.models.learner.state for trainer in (by_hand, package))
    assert all(torch.equal(ours[name], theirs[name]) for name in ours)
