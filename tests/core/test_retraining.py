"""Retraining on a frozen reward is soft actor-critic from replay, and nothing else."""

import torch

from offairl_lite.core.loop import Trainer
from offairl_lite.core.replay import Batch, split
from offairl_lite.core.sac import POLICY_DELAY


def retrain(trainer, reward, updates):
    """Update SAC from replay, with a frozen reward of the state."""
    size = trainer.config.schedule.batch_size
    batch = trainer.collector.replay.sample(trainer.rng, updates * size)
    scaled = [trainer.normaliser(x) for x in (batch.obs, batch.next_obs)]
    batch = Batch(scaled[0], batch.pre_tanh, scaled[1], reward(batch.obs), batch.terminated)
    noise = trainer.rng.normal(2, updates * size, 2).transpose(0, 1)
    parts = zip(split(batch, size), noise.split(size, 2), strict=True)
    for k, (minibatch, eps) in enumerate(parts, 1):
        trainer.learner.update(minibatch, eps, k % POLICY_DELAY == 0)


def test_retraining_is_plain_sac(tiny, frozen_reward):
    config = tiny.change(reward="frozen", total_steps=300, learning_starts=200, batch_size=16)
    reward = frozen_reward(1)
    by_hand, package = (Trainer(config, (0,), frozen_reward=reward) for _ in range(2))
    for trainer in (by_hand, package):
        for _ in range(config.schedule.learning_starts):
            trainer.collector.step(explore=None)
        trainer.start()
    retrain(by_hand, reward, 20)
    package.block_start = 20
    package.train_on_block(20)
    ours, theirs = (trainer.learner.state for trainer in (by_hand, package))
    assert all(torch.equal(ours[name], theirs[name]) for name in ours)
