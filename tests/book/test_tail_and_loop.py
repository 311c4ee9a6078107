"""The runs of chapter 6 that have the tail of log π, or the loop, alone."""

from contextlib import closing

import pytest
import torch

from offairl_lite import demonstrations, experiments
from offairl_lite.core.loop import Trainer
from rollouts import tail_and_loop

TINY = {
    **{"total_steps": 300, "learning_starts": 100, "eval_every": 300, "batch_size": 8},
    **dict.fromkeys(("hidden", "reward_hidden", "shaping_hidden"), (8,)),
}
LOGIT = experiments.configure("maze-rewards/implementation-1", "demo").change(**TINY)


def run(change, kind=tail_and_loop.Paid):
    """A tiny run at its end."""
    shown = demonstrations.load(LOGIT.env_id, trajectories=2)
    with closing(kind(LOGIT, (0, 1), shown)) as trainer:
        trainer.change = change
        for _ in trainer.run():
            pass
    return trainer


def test_without_a_change_it_is_the_run_as_it_is():
    ours, usual = run(tail_and_loop.own), run(None, Trainer)
    assert torch.equal(ours.learner.actor_params, usual.learner.actor_params)


@pytest.mark.parametrize("name", ["clipped", "anothers"])
def test_what_is_paid_is_changed_and_the_discriminator_s_log_pi_is_not(name):
    trainer = run(tail_and_loop.own)
    now = trainer.learner.actor_params.detach()
    early, late = now + 1, now + 2
    changes = {
        "clipped": tail_and_loop.clipped,
        "anothers": lambda *given: tail_and_loop.anothers(
            {0: early, trainer.trained: late, trainer.trained + 1: now}, *given
        ),
    }
    trainer.change = changes[name]
    experience = trainer.experience()
    batch = experience.scaled(trainer.collector.replay.sample(trainer.rng, 500))
    own, paid = experience.log_density(batch), trainer.paid_log_pi(batch)
    of = trainer.learner.log_prob
    assert torch.equal(own, of(now, batch.obs, batch.pre_tanh))
    wanted = {
        "clipped": own.clamp(min=-tail_and_loop.MOST),
        "anothers": of(late, batch.obs, batch.pre_tanh),
    }
    assert torch.equal(paid, wanted[name])
    assert not torch.equal(paid, own) or own.min() > -tail_and_loop.MOST
    f = experience.reward(batch, batch) + paid
    assert torch.allclose(f, trainer.discriminator.f(trainer.discriminator.transitions(batch, own)))


def test_a_frozen_discriminator_pays_as_it_did_and_stays():
    state_pairs = LOGIT.change(reward="dac", ablation="state-pairs")
    shown = demonstrations.load(LOGIT.env_id, trajectories=2)
    with (
        closing(Trainer(state_pairs, (0, 1), shown)) as earlier,
        closing(tail_and_loop.Frozen(state_pairs, (0, 1), shown)) as later,
    ):
        for trainer in (earlier, later):
            later.earlier = earlier
            for _ in trainer.run():
                pass
        assert torch.equal(earlier.discriminator.reward_params, later.discriminator.reward_params)
        batch = later.collector.replay.sample(later.rng, 50)
        paid = [each.experience().paid(batch).reward for each in (earlier, later)]
        assert torch.equal(*paid)
