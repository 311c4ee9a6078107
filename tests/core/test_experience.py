"""A block of training: its minibatches, log π, and the reward that the learner is given."""

import math
from dataclasses import replace
from functools import partial

import pytest
import torch

from offairl_lite.core import absorbing
from offairl_lite.core.discriminator import Discriminator
from offairl_lite.core.experience import labelled
from offairl_lite.core.loop import Trainer, train
from offairl_lite.core.replay import Batch, sample, split
from offairl_lite.core.rng import Rng
from offairl_lite.core.sac import SAC
from offairl_lite.core.td3 import TD3

HOPPER = "Hopper-v5"
ON_POLICY = {"learner": "ppo", "train_every": 50, "replay_size": 50}
run = partial(train, progress=False)


# Minibatches.


def test_blocks_that_are_no_multiple_of_a_chunk_are_trained_in_full(tiny, maze, record):
    updates, judged = record(SAC, "update"), record(Discriminator, "update")
    run(tiny.change(train_every=51, learning_starts=51, total_steps=102), (0,), maze)
    assert len(updates) == len(judged) == 102
    assert {batch.obs.shape for batch, *_ in updates} == {(1, 8, 3)}
    assert {side.obs.shape for minibatch in judged for side in minibatch[:2]} == {(1, 8, 3)}


@pytest.mark.parametrize(("learner", "kind"), [("sac", SAC), ("td3", TD3)])
def test_every_second_update_has_the_actor_wherever_blocks_end(tiny, record, learner, kind):
    updates = record(kind, "update")
    run(tiny.change(reward="environment", learner=learner, train_every=31), (0,))
    assert [update_actor for *_, update_actor in updates] == [False, True] * (6 * 31 // 2)


def test_the_discriminator_s_negatives_are_the_last_block_if_replay_is_no_longer(
    tiny, maze, record, until
):
    seen = record(Discriminator, "update")
    trainer = Trainer(tiny.change(**ON_POLICY), (0,), maze)
    until(trainer, lambda t: seen)
    block = trainer.normaliser(trainer.collector.replay.last(50).obs)
    block = {tuple(row) for row in block[0].tolist()}
    assert {tuple(row) for _, policy, *_ in seen for row in policy.obs[0].tolist()} <= block


@pytest.mark.parametrize("size", [1, 4])
def test_labelled_minibatches_are_demonstrations_and_then_replay(maze, size):
    replayed = Batch(*(torch.rand(2, 12, *part.shape[1:]) for part in maze.transitions))
    batch = labelled(sample(maze.transitions, Rng((0, 1)), 12), replayed, size)
    rows = {tuple(row) for row in maze.transitions.obs.tolist()}
    halves = zip(split(batch, 2 * size), split(replayed, size), strict=True)
    for both, own in halves:
        expert, policy = (Batch(*half) for half in zip(*(x.chunk(2, 1) for x in both), strict=True))
        assert {tuple(row) for row in expert.obs.flatten(0, 1).tolist()} <= rows
        assert (expert.reward == 1).all()
        assert (policy.reward == 0).all()
        for part, same in zip(policy._replace(reward=own.reward), own, strict=True):
            assert torch.equal(part, same)
    # A transition of the demonstrations is a whole one, drawn by each member on its own.
    where = {tuple(row): i for i, row in enumerate(maze.transitions.obs.tolist())}
    first = [where[tuple(row)] for row in batch.obs[:, 0].tolist()]
    for part, shown in zip(batch[:3], maze.transitions[:3], strict=True):
        assert torch.equal(part[:, 0], shown[first])
    assert not torch.equal(batch.obs[0, :size], batch.obs[1, :size])


@pytest.mark.parametrize("absorbing", ["none", "bootstrap"])
def test_sqil_is_sac_that_is_paid_1_for_demonstrations_and_0_for_replay(
    tiny, random_demonstrations, record, absorbing
):
    updates = record(SAC, "update")
    config = tiny.change(env_id=HOPPER, train_every=50, reward="sqil")
    config = config.change(reward_scale=3.0, normalise=False)
    shown = random_demonstrations(HOPPER)
    result = run(config.change(absorbing=absorbing), (0, 1), shown)
    rows = {tuple(row) for row in shown.transitions.obs.tolist()}
    assert len(updates) == 4 * 50
    for batch, *_ in updates:
        assert batch.reward.shape == (2, 2 * config.schedule.batch_size)
        assert (batch.reward == torch.tensor([3.0, 0.0]).repeat_interleave(8)).all()
        ordinary = batch.obs[:, :8].flatten(0, 1)[:, :11]
        seen = {tuple(row) for row in ordinary.tolist() if any(row)}
        assert seen <= rows
    assert result.reward is None
    assert all(math.isnan(row.learned_return) for row in result.rows)


def test_plain_reinforcement_learning_does_not_look_at_demonstrations_that_are_at_hand(tiny, maze):
    config = tiny.change(reward="environment", normalise=False)
    with_them, without = run(config, (0,), maze), run(config, (0,))
    assert torch.equal(with_them.policy.params, without.policy.params)


# The density of actions.


@pytest.mark.parametrize(("size", "share"), [(1000, 1 / 2), (150, 1 / 3), (100, 0.0)])
def test_the_density_can_be_that_of_the_replay_with_its_share_of_random_actions(
    tiny, maze, monkeypatch, record, size, share
):
    """π is made to exclude every action, so what is left is the uniform part."""

    def log_prob(self, actor_params, obs, pre_tanh):
        return torch.full(obs.shape[:-1], -1e4)

    monkeypatch.setattr(SAC, "log_prob", log_prob)
    seen, rewarded = record(Discriminator, "update"), record(Discriminator, "reward")
    config = tiny.change(reward="logit-sa", loss="airl-mixture", replay_size=size)
    run(config, (0,), maze)
    paid = [(log_density(batch),) for batch, log_density in rewarded]
    for densities in [(expert.log_prob, policy.log_prob) for expert, policy, _ in seen], paid:
        for given, w in (densities[0], 1.0), (densities[-1], share):
            expected = math.log(w / 4) if w else -1e4
            torch.testing.assert_close(given, tuple(torch.full_like(x, expected) for x in given))


def test_where_an_episode_has_ended_the_replay_s_density_is_still_certain(
    tiny, random_demonstrations, record
):
    seen = record(Discriminator, "update")
    config = tiny.change(env_id=HOPPER, train_every=50, absorbing="bootstrap")
    config = config.change(loss="airl-mixture")
    run(config, (0,), random_demonstrations(HOPPER))
    there = torch.cat([absorbing.is_absorbing(policy.obs) for _, policy, _ in seen], 1)
    density = torch.cat([policy.log_prob for _, policy, _ in seen], 1)
    assert there.any()
    assert (density[there] == 0).all()
    assert density[~there].min() > math.log(0.5 / 2**3) - 1e-4


def test_log_prob_is_that_of_before_the_block(tiny, maze, record, until):
    seen = record(SAC, "log_prob")
    trainer = Trainer(tiny.change(reward="logit-sa"), (0,), maze)
    until(trainer, lambda t: t.trained == 100)
    # In two chunks: of both sides for the discriminator, and once for the reward.
    assert len(seen) == 2 * 2 + 2
    weights = [params for params, *_ in seen]
    assert all(torch.equal(params, weights[0]) for params in weights)
    assert not torch.equal(weights[0], trainer.learner.actor_params)


# The reward.


def test_a_reward_is_scaled(tiny, record):
    plain, scaled = [], []
    for scale, seen in ((1.0, plain), (3.0, scaled)):
        updates = record(SAC, "update")
        # The first updates, before the actors differ.
        config = tiny.change(reward="environment", reward_scale=scale, total_steps=100)
        run(config, (0,))
        seen += [batch.reward for batch, *_ in updates]
    assert len(plain) == len(scaled) == 100
    assert all(torch.equal(three, 3 * one) for one, three in zip(plain, scaled, strict=True))


def test_both_networks_see_scaled_observations(tiny, maze, record, until):
    judged, updates = record(Discriminator, "update"), record(SAC, "update")
    trainer = Trainer(tiny, (0, 1), maze)
    until(trainer, lambda t: t.trained == 100)
    held = torch.stack([trainer.collector.replay.held(i).obs for i in range(2)])
    held = trainer.normaliser(held)
    for member in range(2):
        known = {tuple(row) for row in held[member].tolist()}
        for obs in (judged[0][1].obs, updates[0][0].obs):
            assert {tuple(row) for row in obs[member].tolist()} <= known


def test_a_centred_reward_has_no_constant(tiny, frozen_reward, until):
    """With another constant in the reward it is the same run, but for rounding."""
    config, reward = tiny.change(reward="frozen", centre_reward=True), frozen_reward(1)
    shifted = replace(reward, params=reward.params.clone())
    shifted.net.layers(shifted.params)[-1][0].add_(3)
    obs = Rng((0,)).normal(5, 3)
    torch.testing.assert_close(shifted(obs), reward(obs) + 3)

    def weights(reward, **changes):
        trainer = Trainer(config.change(**changes), (0,), None, reward)
        until(trainer, lambda t: t.trained == 100)
        return trainer.learner.critic_params.detach()

    torch.testing.assert_close(weights(shifted), weights(reward), rtol=0, atol=1e-4)
    plain = [weights(r, centre_reward=False) for r in (shifted, reward)]
    assert (plain[0] - plain[1]).abs().max() > 0.01


def test_the_absorbing_state_s_reward_is_centred_with_the_others(
    tiny, random_demonstrations, record, until
):
    updates, found = record(SAC, "update"), []
    config = tiny.change(env_id=HOPPER, train_every=50, absorbing="analytic")
    for centred in (False, True):
        updates.clear()
        trainer = Trainer(
            config.change(centre_reward=centred), (0, 1), random_demonstrations(HOPPER)
        )
        until(trainer, lambda t: t.trained == 50)
        found.append(torch.cat([batch.reward for batch, *_ in updates], 1))
        ends = torch.cat([absorbing.is_absorbing(batch.next_obs) for batch, *_ in updates], 1)
        assert ends.any()
    plain, centred = found
    for member in range(2):
        shift = plain[member] - centred[member]
        # R_T = r + γ r(s_a) / (1 - γ) has the mean 1 / (1 - γ) times.
        torch.testing.assert_close(
            shift[ends[member]],
            shift[~ends[member]].mean() * torch.ones(ends[member].sum()) * 100,
            rtol=1e-3,
            atol=1e-3,
        )


@pytest.mark.parametrize("reward", ["dac", "logit-sa"])
def test_the_absorbing_state_has_its_own_reward(tiny, random_demonstrations, record, until, reward):
    updates, paid = record(SAC, "update"), record(Discriminator, "reward")
    changes = {"env_id": HOPPER, "train_every": 50, "absorbing": "analytic"}
    config = tiny.change(**changes, reward=reward, reward_scale=2.0)
    trainer = Trainer(config, (0, 1), random_demonstrations(HOPPER))
    until(trainer, lambda t: t.trained == 50)
    there, zero = absorbing.absorbing_state(torch.empty(2, 1, 12)), torch.zeros(2, 1)
    there = trainer.normaliser(there)
    own = Batch(there, torch.zeros(2, 1, 3), there, zero, zero)
    r_there = 2 * trainer.discriminator.reward(own, lambda _: zero)
    minibatches = [batch for batch, *_ in updates]
    rows = Batch(*(torch.cat(parts, 1) for parts in zip(*minibatches, strict=True)))
    (looped, log_density), *_ = [call for call in paid if call[0].obs.shape[1] > 1]
    first = 2 * trainer.discriminator.reward(looped, log_density)
    ends = absorbing.is_absorbing(rows.next_obs)
    expected = first + ends * 0.99 * r_there / (1 - 0.99)
    torch.testing.assert_close(rows.reward, expected)
    assert torch.equal(rows.terminated, ends.float())


def test_all_demonstrations_are_shown_alike_and_the_penalty_is_anywhere_between(
    tiny, maze, record, until
):
    seen = record(Discriminator, "update")
    trainer = Trainer(tiny, (0, 1), maze)
    until(trainer, lambda t: len(seen) == 100)
    shown, half = trainer.normaliser(maze.transitions.obs[None]), len(maze.transitions.obs) // 2
    for member, all_of_it in zip(torch.cat([e.obs for e, *_ in seen], 1), shown, strict=True):
        drawn = (member.unsqueeze(1) == all_of_it).all(-1)
        assert drawn.any(1).all()
        assert drawn.any(0).float().mean() > 0.9  # Of 200, in 800 draws.
        assert abs(drawn[:, :half].any(1).float().mean() - 0.5) < 4 * (0.25 / 800) ** 0.5
    share = torch.cat([coefficient for *_, coefficient in seen], 1)[..., 0].flatten()
    quarters = torch.histc(share, 4, 0, 1) / share.numel()
    torch.testing.assert_close(quarters, torch.full((4,), 0.25), rtol=0, atol=0.05)


def test_a_frozen_reward_is_scaled_as_well(tiny, frozen_reward, record):
    seen, reward = record(SAC, "update"), frozen_reward(1, action_dim=2)
    config = tiny.change(reward="frozen", reward_scale=3.0, normalise=False)
    run(config, (0,), None, reward)
    assert seen
    for batch, *_ in seen:
        torch.testing.assert_close(batch.reward, 3 * reward(batch.obs, batch.action))
