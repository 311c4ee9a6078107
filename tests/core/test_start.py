"""The end of the warm-up: what scales observations, and where the networks start."""

import warnings
from functools import partial

import pytest
import torch

from offairl_lite.core.loop import Trainer, train
from offairl_lite.core.networks import Normaliser
from offairl_lite.core.rng import Rng

MCP = {"primitives": 3, "trunk_hidden": (8,), "primitive_hidden": (6,), "gate_hidden": (8,)}
run = partial(train, progress=False)


def test_there_is_nothing_to_take_out_before_the_warm_up_is_over(tiny, maze, until):
    trainer = Trainer(tiny, (0, 1), maze)
    until(trainer, lambda t: t.steps == 100)
    assert (trainer.policy, trainer.reward) == (None, None)
    assert all(
        (x == 0).all() for x in (trainer.learner.actor_params, trainer.discriminator.reward_params)
    )
    until(trainer, lambda t: t.started)
    assert (len(trainer.policy), len(trainer.reward)) == (2, 2)


def test_later_updates_change_no_policy_and_no_reward_that_was_taken_out(tiny, maze, until):
    trainer = Trainer(tiny, (0,), maze)
    until(trainer, lambda t: t.trained == 100)
    policy, reward = trainer.policy, trainer.reward
    before = policy.params.clone(), reward.params.clone()
    until(trainer, lambda t: t.finished)
    for kept, now, weights in zip(
        (policy, reward), (trainer.policy, trainer.reward), before, strict=True
    ):
        assert torch.equal(kept.params, weights)
        assert not torch.equal(now.params, weights)


def test_inputs_are_scaled_by_the_demonstrations_and_the_warm_up(tiny, maze, until):
    trainer = Trainer(tiny, (0,), maze)
    until(trainer, lambda t: t.started)
    seen = trainer.collector.replay.held(0).obs
    assert len(seen) == 100
    expected = Normaliser.of(seen.unsqueeze(0), maze.transitions.obs.unsqueeze(0))
    for part, wanted in zip(trainer.normaliser, expected, strict=True):
        torch.testing.assert_close(part, wanted)
    plain = Trainer(tiny.change(normalise=False), (0,), maze)
    until(plain, lambda t: t.started)
    assert (plain.normaliser.mean == 0).all()
    assert (plain.normaliser.std == 1).all()


@pytest.mark.parametrize(("far", "warned"), [(1e7, True), (-2e5, True), (9e4, False)])
def test_a_reading_that_would_scale_all_others_to_nothing_is_named(far, warned, tiny, until):
    trainer = Trainer(tiny.change(reward="environment", train_every=50), (3, 7))
    until(trainer, lambda t: t.steps == 100)
    trainer.collector.replay.rows[41, 1, 2] = far
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        until(trainer, lambda t: t.started)
    said = f"observation[2] of member 1 of {tiny.env_id} is {far:.6g} in step 41 of the warm-up"
    assert [said in str(warning.message) for warning in found] == [True] * warned


@pytest.fixture
def built(until):
    """Return the networks of a run that have been made and not yet trained."""

    def build(config, **given):
        # The warm-up ends within an episode, where there is nothing to train on.
        config = config.change(learning_starts=90, eval_every=90)
        trainer = Trainer(config, range(2), **given)
        until(trainer, lambda t: t.started)
        assert (trainer.steps, trainer.trained) == (90, 0)
        return trainer

    return build


@pytest.mark.parametrize("kind", [{}, MCP])
def test_a_pretrained_policy_acts_as_before(tiny, built, earlier_policy, kind):
    config = tiny.change(reward="environment", pretrained="policy", **kind)
    policy = earlier_policy(config, 2, shift=0.3)
    now = built(config, pretrained_policy=policy).policy
    assert torch.equal(now.params, policy.params)
    obs = Rng((0, 1)).normal(5, 3)
    torch.testing.assert_close(now.act(obs), policy.act(obs))


def test_primitives_are_carried_over_and_the_gate_begins_anew(tiny, built, earlier_policy):
    config = tiny.change(reward="environment", pretrained="primitives", **MCP)
    policy = earlier_policy(config, 2)
    fresh = built(config.change(pretrained="nothing")).learner
    carried = built(config, pretrained_policy=policy).learner
    *others, gate = carried.actor.split(carried.actor_params.detach())
    *expected, earlier_gate = carried.actor.split(policy.params)
    assert all(map(torch.equal, others, expected))
    assert not torch.equal(gate, earlier_gate)
    assert torch.equal(gate, fresh.actor.split(fresh.actor_params)[-1])


def test_of_a_pretrained_policy_only_the_gate_need_learn(tiny, earlier_policy):
    config = tiny.change(
        reward="environment", pretrained="primitives", fixed_primitives=True, **MCP
    )
    policy = earlier_policy(config, 2)
    end = run(config, range(2), pretrained_policy=policy).policy
    before, after = (policy.actor.split(p.params) for p in (policy, end))
    assert all(map(torch.equal, after[:2], before[:2]))
    assert not torch.equal(after[2], before[2])
