"""The training loop: its schedule, its reproducibility, and what it refuses."""

import math
from contextlib import closing
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
import torch

from offairl_lite.config import RELEASE
from offairl_lite.core import absorbing
from offairl_lite.core import loop as imitate
from offairl_lite.core.acceleration import Execution
from offairl_lite.core.discriminator import Discriminator, Reward
from offairl_lite.core.loop import Trainer, complete, train
from offairl_lite.core.networks import Normaliser, StackedMLP
from offairl_lite.core.policies import Policy, SquashedGaussian
from offairl_lite.core.ppo import PPO
from offairl_lite.core.replay import Batch
from offairl_lite.core.rng import Streams
from offairl_lite.core.rollouts import NotFiniteError, rollout
from offairl_lite.core.sac import SAC, stochastic_actor
from offairl_lite.demonstrations import Demonstrations

MAZE, HOPPER = "offairl/PointMazeLeft-v0", "Hopper-v5"


@pytest.fixture
def maze(random_demonstrations):
    return random_demonstrations(MAZE)


def frozen_reward(members, env_id=MAZE, obs_dim=3, action_dim=0):
    """One of the state alone where `action_dim` is 0."""
    net = StackedMLP((obs_dim + action_dim, 4, 1), "tanh")
    params = net.init(Streams(range(members)))
    return Reward(env_id, net, not action_dim, params, Normaliser.identity(members, obs_dim))


def run(config, seeds, *given):
    return train(config, seeds, *given, progress=False)


def finish(trainer):
    """Take a trainer to its end; return the rows of each evaluation."""
    evaluations = []
    while not trainer.finished:
        if rows := trainer.advance():
            evaluations.append(rows)
    return evaluations


def until(trainer, reached):
    while not reached(trainer):
        trainer.advance()


def assert_same(one, other):
    """Two runs with the same seeds are the same, bit for bit."""
    assert torch.equal(one.policy.params, other.policy.params)
    assert [row._replace(learned_return=0) for row in one.rows] == [
        row._replace(learned_return=0) for row in other.rows
    ]
    np.testing.assert_array_equal(*([row.learned_return for row in r.rows] for r in (one, other)))
    if one.reward is not None:
        assert torch.equal(one.reward.params, other.reward.params)


def assert_same_rows(one, other):
    """The same evaluations, bit for bit; NaN equals NaN."""
    assert str(one) == str(other)


def test_a_run_has_the_threads_it_asks_for(tiny, maze):
    before = torch.get_num_threads()
    try:
        for threads in (2, 1):
            Trainer(tiny, (0,), maze, execution=Execution(threads=threads))
            assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)


def test_same_seeds_same_run(tiny, maze):
    assert_same(run(tiny, (1, 3), maze), run(tiny, (1, 3), maze))


ON_POLICY = {"generator": "ppo", "update_every": 50, "replay_size": 50, "epochs": 3}


def test_after_an_interruption_a_run_can_be_started_again(tiny, maze):
    def interrupt(rows):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(tiny, [0, 1], maze, on_evaluation=interrupt)
    again, never = train(tiny, [0, 1], maze), train(tiny, [0, 1], maze)
    assert again.rows == never.rows


def test_a_run_can_be_ended_early_with_what_is_there(tiny, maze):
    def enough(rows):
        assert rows[0].step == 100
        raise StopIteration

    early, whole = train(tiny, [0, 1], maze, on_evaluation=enough), train(tiny, [0, 1], maze)
    assert early.rows == whole.rows[:2]
    assert (len(early.policy), len(early.reward)) == (2, 2)
    assert not torch.equal(early.policy.params, whole.policy.params)


@pytest.mark.parametrize(
    "changes",
    [
        {"temperature": None},
        {**ON_POLICY, "reward": "implementation-2"},
        {**ON_POLICY, "reward": "gan-gcl", "update_every": 100, "replay_size": 100},
    ],
    ids=["sac", "ppo", "gan-gcl"],
)
def test_a_member_trains_alone_as_among_others(tiny, maze, changes):
    # The same numbers are drawn; sums differ in their order only, which 400 updates of each
    # network leave far below 1e-3.
    config = replace(tiny, total_steps=400, **changes)
    together, alone = run(config, (1, 3, 7), maze), run(config, (3,), maze)
    torch.testing.assert_close(together.policy.params[1:2], alone.policy.params, rtol=0, atol=1e-3)
    torch.testing.assert_close(together.reward.params[1:2], alone.reward.params, rtol=0, atol=1e-3)
    np.testing.assert_allclose(together.returns[1:2], alone.returns, rtol=1e-3)
    assert np.abs(together.returns[0] - together.returns[1]).max() > 1e-2
    rows = [row for row in together.rows if row.seed == 3]
    for one, other in zip(rows[:2], alone.rows[:2], strict=True):
        assert one.metrics == pytest.approx(other.metrics, rel=1e-2, abs=1e-3)
        assert one.learned_return == pytest.approx(other.learned_return, rel=1e-2)


@pytest.mark.parametrize("absorbing", ["none", "bootstrap", "analytic"])
def test_a_member_trains_alone_where_episodes_end(tiny, random_demonstrations, absorbing):
    shown = random_demonstrations(HOPPER)
    config = replace(tiny, env_id=HOPPER, temperature=None, update_every=50, absorbing=absorbing)
    together, alone = (run(config, seeds, shown) for seeds in ((1, 3, 7), (3,)))
    assert together.rows[-1].episodes > 5
    torch.testing.assert_close(together.policy.params[1:2], alone.policy.params, rtol=0, atol=1e-3)
    torch.testing.assert_close(together.reward.params[1:2], alone.reward.params, rtol=0, atol=1e-3)
    assert [row.episodes for row in together.rows if row.seed == 3] == [
        row.episodes for row in alone.rows
    ]


def test_blocks_of_an_episode_s_length_are_the_ends_of_episodes(tiny, maze):
    assert_same(run(tiny, (0, 1), maze), run(replace(tiny, update_every=100), (0, 1), maze))


def test_another_block_length_is_another_run(tiny, maze):
    one, other = run(tiny, (0,), maze), run(replace(tiny, update_every=50), (0,), maze)
    assert not torch.equal(one.policy.params, other.policy.params)


def test_as_many_updates_as_steps_after_each_episode_those_of_the_warm_up_made_up(tiny, maze):
    config = replace(tiny, total_steps=400, warmup_steps=250, eval_every=50)
    trainer = Trainer(config, (0, 1), maze)
    done = []
    while not trainer.finished:
        if rows := trainer.advance():
            done.append((rows[0].step, trainer.generator.updates))
    assert done == [(250, 200), (300, 300), (350, 300), (400, 400)]
    assert trainer.episodes.tolist() == [4, 4]


def test_blocks_that_are_no_multiple_of_a_chunk_are_trained_in_full(tiny, maze):
    config = replace(tiny, update_every=51, warmup_steps=51, total_steps=102)
    trainer = Trainer(config, (0,), maze)
    finish(trainer)
    assert trainer.generator.updates == 102


def test_the_discriminator_is_trained_first_and_the_generator_after_it(tiny, maze, monkeypatch):
    order = []
    for kind in (Discriminator, SAC):
        original = kind.update

        def update(self, *batch, original=original):
            order.append(type(self))
            return original(self, *batch)

        monkeypatch.setattr(kind, "update", update)
    run(tiny, (0,), maze)
    assert order == ([Discriminator] * 100 + [SAC] * 100) * 2


@pytest.mark.parametrize(("size", "share"), [(1000, 1 / 2), (150, 1 / 3), (100, 0.0)])
def test_the_density_can_be_that_of_the_replay_with_its_share_of_random_actions(
    tiny, maze, monkeypatch, size, share
):
    """π is made to exclude every action, so what is left is the uniform part."""
    seen, paid = [], []

    def log_prob(self, batch, params=None):
        return torch.full_like(batch.reward, -1e4)

    def spy(record, original):
        def called(self, *args):
            record.append(args)
            return original(self, *args)

        return called

    monkeypatch.setattr(SAC, "log_prob", log_prob)
    monkeypatch.setattr(Discriminator, "update", spy(seen, Discriminator.update))
    monkeypatch.setattr(Discriminator, "reward", spy(paid, Discriminator.reward))
    config = replace(tiny, reward="implementation-1", replay_density="mixture", replay_size=size)
    run(config, (0,), maze)
    for densities in [(args[2], args[3]) for args in seen], [(args[1],) for args in paid]:
        for given, w in (densities[0], 1.0), (densities[-1], share):
            expected = math.log(w / 4) if w else -1e4
            torch.testing.assert_close(given, tuple(torch.full_like(x, expected) for x in given))


def test_a_centred_reward_has_no_constant(tiny):
    """With another constant in the reward it is the same run, but for rounding."""
    config, reward = replace(tiny, reward="frozen", centre_reward=True), frozen_reward(1)
    shifted = replace(reward, params=reward.params.clone())
    shifted.net.layers(shifted.params)[-1][0].add_(3)
    obs = Streams((0,)).normal(5, 3)
    torch.testing.assert_close(shifted(obs), reward(obs) + 3)

    def weights(reward, **changes):
        trainer = Trainer(replace(config, **changes), (0,), None, reward)
        until(trainer, lambda t: t.trained == 100)
        return trainer.generator.critic_params.detach()

    torch.testing.assert_close(weights(shifted), weights(reward), rtol=0, atol=1e-4)
    plain = [weights(r, centre_reward=False) for r in (shifted, reward)]
    assert (plain[0] - plain[1]).abs().max() > 0.01


def test_the_absorbing_state_s_reward_is_centred_with_the_others(
    tiny, random_demonstrations, monkeypatch
):
    seen = {False: [], True: []}
    config = replace(tiny, env_id=HOPPER, update_every=50, absorbing="analytic")
    for centred, pairs in seen.items():
        original = SAC.update

        def update(self, batch, reward, absorbing_reward, noise, pairs=pairs, original=original):
            pairs.append((reward, absorbing_reward))
            return original(self, batch, reward, absorbing_reward, noise)

        with monkeypatch.context() as patch:
            patch.setattr(SAC, "update", update)
            trainer = Trainer(
                replace(config, centre_reward=centred), (0, 1), random_demonstrations(HOPPER)
            )
            until(trainer, lambda t: t.trained == 50)
    (plain, there), (centred, centred_there) = (
        (torch.cat([r for r, _ in pairs], 1), pairs[0][1]) for pairs in seen.values()
    )
    torch.testing.assert_close(centred, plain - plain.mean(1, keepdim=True))
    torch.testing.assert_close(centred_there, there - plain.mean(1, keepdim=True))


def updates_of(monkeypatch):
    """What SAC is updated with from now on: batch, reward, reward of the absorbing state."""
    seen, original = [], SAC.update

    def update(self, batch, reward, there, noise):
        seen.append((batch, reward, there))
        return original(self, batch, reward, there, noise)

    monkeypatch.setattr(SAC, "update", update)
    return seen


def test_a_reward_is_scaled(tiny, monkeypatch):
    seen = updates_of(monkeypatch)
    run(replace(tiny, reward="environment", reward_scale=3.0), (0,))
    assert all(torch.equal(reward, 3 * batch.reward) for batch, reward, _ in seen)


@pytest.mark.parametrize("reward", ["dac", "implementation-1"])
def test_the_absorbing_state_is_paid_its_own_reward(
    tiny, random_demonstrations, monkeypatch, reward
):
    seen = updates_of(monkeypatch)
    changes = {"env_id": HOPPER, "update_every": 50, "absorbing": "analytic"}
    config = replace(tiny, **changes, reward=reward, reward_scale=2.0)
    trainer = Trainer(config, (0, 1), random_demonstrations(HOPPER))
    until(trainer, lambda t: t.trained == 50)
    there, zero = absorbing.absorbing_state(torch.empty(2, 1, 12)), torch.zeros(2, 1)
    own = Batch(there, torch.zeros(2, 1, 3), there, zero, zero)
    torch.testing.assert_close(seen[-1][2], 2 * trainer.discriminator.reward(own, zero))


def test_the_absorbing_state_is_kept_for_the_member_that_came_to_it(tiny, random_demonstrations):
    config = replace(tiny, env_id=HOPPER, update_every=50, absorbing="bootstrap")
    trainer = Trainer(config, (0, 1), random_demonstrations(HOPPER))
    obs, one = torch.zeros(1, 11), torch.ones(1)
    trainer._store(Batch(obs, torch.zeros(1, 3), obs, one, one), torch.tensor([1]))
    assert trainer.replay.sizes == [0, 2]


def test_log_prob_in_the_reward_is_that_of_before_the_block(tiny, maze, monkeypatch):
    seen, original = [], SAC.log_prob

    def log_prob(self, batch, params=None):
        if params is not None:
            seen.append(params.clone())
        return original(self, batch, params)

    monkeypatch.setattr(SAC, "log_prob", log_prob)
    trainer = Trainer(replace(tiny, reward="implementation-1"), (0,), maze)
    until(trainer, lambda t: t.trained == 100)  # in two chunks
    assert len(seen) == 2
    assert torch.equal(*seen)
    assert not torch.equal(seen[0], trainer.generator.actor_params)


def test_rows_are_of_their_member_s_own_episodes(tiny):
    # One of the net's last weights: r is 1 for the first member, 2 for the second, everywhere.
    reward = frozen_reward(2, HOPPER, 11)
    reward.params.zero_()
    reward.params[:, reward.net.num_params - 5] = torch.tensor([1.0, 2.0])
    config = replace(tiny, env_id=HOPPER, update_every=50, reward="frozen", eval_episodes=5)
    result = run(config, (3, 7), None, reward)
    episodes = rollout(result.policy, HOPPER, (3, 7), 5)
    assert len(np.unique(episodes.lengths)) > 1
    for i, row in enumerate(result.rows[-2:]):
        np.testing.assert_array_equal(row.returns, episodes.returns[i])
        assert row.learned_return == pytest.approx((i + 1) * episodes.lengths[i].mean())


def test_the_warm_up_holds_an_action_as_long_as_it_says(tiny):
    steps = {"warmup_steps": 1001, "total_steps": 1101}
    trainer = Trainer(replace(tiny, reward="environment", warmup_hold=4.0, **steps), range(10))
    until(trainer, lambda t: t.steps == 1000)
    fresh = (trainer.replay.last(1000).pre_tanh.diff(dim=1) != 0).all(-1).float().mean()
    assert abs(fresh - 1 / 4) < 4 * (0.25 * 0.75 / 9_990) ** 0.5  # four standard errors


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({}, True),
        ({"absorbing": "bootstrap"}, False),
        ({"reward": "environment"}, False),
        ({**ON_POLICY, "reward": "gail-survival"}, False),
    ],
)
def test_who_leaves_the_end_of_episodes_to_chance_is_told_once(
    tiny, random_demonstrations, caplog, changes, told
):
    imitate._say_that_ends_matter.cache_clear()
    config = replace(tiny, **{"env_id": HOPPER, "update_every": 50, **changes})
    shown = random_demonstrations(HOPPER) if config.learns_reward else None
    run(config, (0, 1), shown)
    assert len(caplog.messages) == told
    for message in caplog.messages:
        assert "An episode of Hopper-v5 has terminated" in message
        assert "Set absorbing='bootstrap'" in message


def test_where_an_episode_has_ended_the_replay_s_density_is_still_certain(
    tiny, random_demonstrations, monkeypatch
):
    seen, original = [], Discriminator.update

    def update(self, expert, policy, expert_log_prob, policy_log_prob, *rest):
        seen.append((policy.obs, policy_log_prob))
        return original(self, expert, policy, expert_log_prob, policy_log_prob, *rest)

    monkeypatch.setattr(Discriminator, "update", update)
    config = replace(tiny, env_id=HOPPER, update_every=50, absorbing="bootstrap")
    config = replace(config, replay_density="mixture")
    run(config, (0,), random_demonstrations(HOPPER))
    there = torch.cat([absorbing.is_absorbing(obs) for obs, _ in seen], 1)
    density = torch.cat([log_prob for _, log_prob in seen], 1)
    assert there.any()
    assert (density[there] == 0).all()
    assert density[~there].min() > math.log(0.5 / 2**3) - 1e-4


@pytest.mark.parametrize(
    "change",
    [
        {"reward": "implementation-1"},
        {"reward": "implementation-2", "log_density": "released"},
        {"reward": "implementation-3"},
        {"reward": "dac", "generator": "td3"},
        {"reward": "dac"},
        {"reward": "gail-survival"},
        {"reward": "gail-termination", "generator": "td3"},
        {"reward": "gail-survival", **ON_POLICY},
        {"reward": "implementation-4", **ON_POLICY, "discriminator_updates": 5},
        {"warmup_hold": 5.0, "temperature": None},
    ],
    ids=str,
)
def test_every_variant_trains_and_evaluates(tiny, maze, change):
    result = run(replace(tiny, **change), (0, 1), maze)
    assert result.steps.tolist() == [100, 200]
    assert result.returns.shape == (2, 2)
    assert all(np.isfinite(row.learned_return) for row in result.rows)
    first, last = result.rows[0], result.rows[-1]
    assert (first.seed, last.seed, last.step, last.episodes) == (0, 1, 200, 2)
    assert last.mean_return == pytest.approx(np.mean(last.returns))
    assert len(last.returns) == 2
    assert {"critic_loss", "cross_entropy", "penalty"} <= set(last.metrics)


def test_the_released_preset_trains(tiny, maze):
    config = replace(
        RELEASE, total_steps=200, warmup_steps=100, batch_size=8, hidden=(8,), eval_episodes=2
    )
    config = replace(config, reward_hidden=(8,), shaping_hidden=(8,))
    assert np.isfinite(run(config, (0,), maze).returns).all()


def test_the_learned_return_is_the_sum_of_the_reward_along_the_episode(tiny):
    reward = frozen_reward(1)
    reward.params.zero_()
    reward.params[:, reward.net.num_params - 5] = 2.0  # the last bias, followed by 4 weights
    result = run(replace(tiny, reward="frozen"), (0,), None, reward)
    assert result.rows[-1].learned_return == pytest.approx(2.0 * 100)


def test_the_task_s_own_reward_needs_no_demonstrations(tiny):
    result = run(replace(tiny, reward="environment"), (0,))
    assert result.reward is None
    assert np.isnan(result.rows[-1].learned_return)


def test_a_frozen_reward_is_given_back_unchanged(tiny):
    reward = frozen_reward(2)
    before = reward.params.clone()
    result = run(replace(tiny, reward="frozen"), (0, 1), None, reward)
    assert torch.equal(result.reward.params, before)


def test_the_evaluation_s_own_members_do_not_disturb_the_training(tiny, maze):
    often, rarely = (run(replace(tiny, eval_every=n), (0,), maze) for n in (50, 200))
    assert torch.equal(often.policy.params, rarely.policy.params)


def test_inputs_are_scaled_by_the_demonstrations_and_the_warm_up(tiny, maze):
    trainer = Trainer(tiny, (0,), maze)
    until(trainer, lambda t: t.generator is not None)
    seen = trainer.replay.held(0).obs
    assert len(seen) == 100
    expected = Normaliser.of(seen.unsqueeze(0), maze.transitions.obs.unsqueeze(0))
    for part, wanted in zip(trainer.generator.normaliser, expected, strict=True):
        torch.testing.assert_close(part, wanted)
    assert trainer.discriminator.normaliser is trainer.generator.normaliser
    plain = Trainer(replace(tiny, normalise=False), (0,), maze)
    until(plain, lambda t: t.generator is not None)
    assert (plain.generator.normaliser.mean == 0).all()
    assert (plain.generator.normaliser.std == 1).all()


# Episodes that end when they like.


@pytest.mark.parametrize("mode", ["none", "bootstrap", "analytic"])
@pytest.mark.parametrize("generator", ["sac", "td3"])
def test_members_that_end_at_different_times_train_in_blocks(
    tiny, random_demonstrations, mode, generator
):
    config = replace(
        tiny,
        env_id=HOPPER,
        update_every=50,
        absorbing=mode,
        generator=generator,
        reward="implementation-1" if generator == "sac" else "dac",
    )
    trainer = Trainer(config, (0, 1), random_demonstrations(HOPPER, episodes=5))
    rows = [row for both in finish(trainer) for row in both]
    assert all(np.isfinite([row.mean_return, row.learned_return]).all() for row in rows)
    assert trainer.generator.updates == 200
    assert (trainer.episodes > 1).all()
    # Each termination adds the loop, which is the absorbing state's only transition.
    loops = trainer.episodes if mode != "none" else np.zeros(2)
    np.testing.assert_array_equal(trainer.replay.sizes, 200 + loops)
    if mode != "none":
        indicators = [trainer.replay.held(i).obs[:, -1] for i in range(2)]
        np.testing.assert_array_equal([(x == 1).sum() for x in indicators], loops)
        # The indicator stays 0 or 1 for the networks.
        assert (trainer.generator.normaliser.mean[..., -1] == 0).all()
        assert (trainer.generator.normaliser.std[..., -1] == 1).all()
        # Demonstrations have their loops too.
        assert (trainer.demonstrations.obs[:, -1] == 1).sum() == 5


# On-policy training.


def test_ppo_learns_from_each_block_once_and_never_from_the_warm_up(tiny, monkeypatch):
    blocks, original = [], PPO.rollout

    def rollout(self, block, reward):
        blocks.append(block)
        return original(self, block, reward)

    monkeypatch.setattr(PPO, "rollout", rollout)
    config = replace(tiny, reward="environment", **ON_POLICY, warmup_steps=70, total_steps=200)
    trainer = Trainer(replace(config, replay_size=1000), (0, 1))
    finish(trainer)
    # From step 70 on, in blocks of 50; the last 30 steps are no block.
    assert [block.obs.shape[1] for block in blocks] == [50, 50]
    for member in (0, 1):
        held = trainer.replay.held(member)
        for parts in zip(held, *blocks, strict=True):
            everything, *some = parts
            assert torch.equal(everything[70:170], torch.cat([x[member] for x in some]))


def test_ppo_updates_so_many_epochs_of_minibatches_and_the_discriminator_as_told(
    tiny, maze, monkeypatch
):
    order = []
    for kind in (Discriminator, PPO):
        original = kind.update

        def update(self, *batch, original=original):
            order.append(type(self))
            return original(self, *batch)

        monkeypatch.setattr(kind, "update", update)
    config = replace(tiny, **ON_POLICY, discriminator_updates=4)
    run(config, (0,), maze)
    # 50 steps are six minibatches of 8, and one of 2.
    assert order == ([Discriminator] * 4 + [PPO] * 3 * 7) * 2


def test_the_discriminator_s_negatives_are_the_last_block_if_replay_is_no_longer(
    tiny, maze, monkeypatch
):
    seen, original = [], Discriminator.update

    def update(self, expert, policy, *rest):
        seen.append(policy)
        return original(self, expert, policy, *rest)

    monkeypatch.setattr(Discriminator, "update", update)
    trainer = Trainer(replace(tiny, **ON_POLICY), (0,), maze)
    until(trainer, lambda t: seen)
    block = {tuple(row) for row in trainer.replay.last(50).obs[0].tolist()}
    assert {tuple(row) for batch in seen for row in batch.obs[0].tolist()} <= block


def test_gan_gcl_s_minibatches_are_whole_episodes(tiny, maze, monkeypatch):
    seen, original = [], Discriminator.update

    def update(self, expert, policy, *rest):
        seen.append((expert, policy))
        return original(self, expert, policy, *rest)

    monkeypatch.setattr(Discriminator, "update", update)
    blocks = {**ON_POLICY, "update_every": 200, "replay_size": 200, "total_steps": 300}
    config = replace(tiny, **blocks, reward="gan-gcl", batch_size=250, discriminator_updates=3)
    trainer = Trainer(config, (0, 1), maze)
    until(trainer, lambda t: seen)
    assert len(seen) == 3
    shown, last = maze.transitions.obs.view(-1, 100, 3), trainer.replay.last(200).obs
    for expert, policy in seen:
        assert expert.obs.shape == policy.obs.shape == (2, 200, 3)
        for member in (0, 1):
            for episode in expert.obs[member].view(2, 100, 3):
                assert any(torch.equal(episode, whole) for whole in shown)
            for episode in policy.obs[member].view(2, 100, 3):
                assert any(torch.equal(episode, whole) for whole in last[member].view(2, 100, 3))


def test_gan_gcl_is_for_episodes_of_one_length(tiny, maze, random_demonstrations):
    config = replace(tiny, **ON_POLICY, reward="gan-gcl")
    with pytest.raises(ValueError, match=r"whole episodes of one length.*multiples"):
        Trainer(config, (0,), maze)
    hopper = replace(config, env_id=HOPPER)
    with pytest.raises(ValueError, match=r"whole episodes of one length: the demonstrations"):
        Trainer(hopper, (0,), random_demonstrations(HOPPER, episodes=3))
    # Demonstrations that are all of one length, on a task where ours are not.
    pendulum = random_demonstrations("Pendulum-v1")
    short = Demonstrations("Pendulum-v1", pendulum.transitions, (100,) * 4)
    config = replace(config, env_id="Pendulum-v1", update_every=100, replay_size=100)
    with pytest.raises(ValueError, match=r"100 as demonstrated, and Pendulum-v1 has ended"):
        run(config, (0,), short)


def test_a_time_limit_makes_no_absorbing_state(tiny, maze):
    trainer = Trainer(replace(tiny, absorbing="bootstrap"), (0, 1), maze)
    finish(trainer)
    assert trainer.replay.sizes == [200, 200]
    for member in (0, 1):
        held = trainer.replay.held(member)
        assert (held.obs[:, -1] == 0).all()
        # Nor a termination.
        assert (held.terminated == 0).all()


def test_without_blocks_members_must_end_together(tiny):
    config = replace(tiny, env_id=HOPPER, reward="environment")
    with pytest.raises(ValueError, match=r"different times.*update_every"):
        run(config, (0, 1))


# Divergence.


@pytest.mark.parametrize(("delay", "tensor"), [(2, "actor"), (10**9, "critic")])
def test_divergence_names_seed_step_and_tensor_and_spares_the_others(tiny, delay, tensor):
    reward = frozen_reward(2)
    reward.params[1] = torch.nan
    config = replace(tiny, reward="frozen", actor_delay=delay)
    message = f"seed 7 diverged by step 100: its {tensor} is not finite"
    with pytest.warns(UserWarning, match=message):
        result = run(config, (3, 7), None, reward)
    assert list(result.diverged) == [7]
    assert [row.seed for row in result.rows] == [3, 3]
    assert np.isfinite(result.returns[0]).all()
    assert np.isnan(result.returns[1]).all()
    assert (result.policy.params[1] == 0).all()
    # The other one is as it would have been beside a member that is well.
    beside = run(config, (3, 7), None, frozen_reward(2))
    assert torch.equal(result.policy.params[0], beside.policy.params[0])
    assert result.rows[-1] == beside.rows[-2]


@pytest.mark.parametrize("temperature", [None, 0.2])
def test_a_learned_temperature_is_among_what_may_have_diverged(tiny, temperature):
    reward = frozen_reward(2)
    reward.params[1] = torch.nan
    config = replace(tiny, reward="frozen", temperature=temperature)
    with pytest.warns(UserWarning, match="lower learning_rate"):
        why = run(config, (3, 7), None, reward).diverged[7]
    assert ("or set temperature" in why) == (temperature is None)


def test_who_was_given_up_stays_at_zero(tiny):
    trainer = Trainer(replace(tiny, reward="environment", total_steps=400), (3, 7))
    until(trainer, lambda t: t.steps == 150)
    trainer.generator.actor_params.data[1, 0] = torch.nan
    with pytest.warns(UserWarning, match="seed 7 diverged by step 150: its actions"):
        finish(trainer)
    assert trainer.trained == 400  # in blocks of 100, of which two came after
    for weights in trainer._learned().values():
        assert (weights[1] == 0).all()
        assert (weights[0] != 0).any()


def test_a_guide_s_steps_are_drawn_for_those_alone_who_begin(tiny):
    config = replace(tiny, reward="environment", start_steps=40)
    trainer = Trainer(config, range(2), guide=earlier_policy(config, 2))
    guided, before = trainer.guided.clone(), trainer.streams.state.clone()
    trainer._start(np.array([True, False]))
    assert (trainer.streams.state != before).any(1).tolist() == [True, False]
    assert trainer.guided[1] == guided[1]


def test_when_every_member_has_diverged_the_run_stops_and_its_rows_are_there(tiny, monkeypatch):
    original, rows = SAC.update, []

    def update(self, *batch):
        if self.updates == 150:
            self.critic_params.data[1] = -torch.inf
        return original(self, *batch)

    monkeypatch.setattr(SAC, "update", update)
    trainer = Trainer(replace(tiny, reward="environment"), (3, 7))
    with (
        pytest.warns(UserWarning, match="diverged"),
        pytest.raises(FloatingPointError, match=r"seed 3 diverged by step 200.*seed 7"),
    ):
        complete(trainer, False, rows.append)
    assert [both[0].step for both in rows if both] == [100]


def test_an_action_that_is_no_number_is_noticed_before_it_is_taken(tiny, monkeypatch):
    original = SquashedGaussian.explore

    def explore(self, params, obs, noise):
        pre_tanh = original(self, params, obs, noise)
        pre_tanh[0] = torch.nan
        return pre_tanh

    monkeypatch.setattr(SquashedGaussian, "explore", explore)
    with pytest.warns(UserWarning, match="seed 3 diverged by step 100: its actions"):
        result = run(replace(tiny, reward="environment"), (3, 7))
    assert list(result.diverged) == [3]


class Faulty(gymnasium.Env):
    """A task whose sensor fails, for about half of the members, after the first episode."""

    observation_space = gymnasium.spaces.Box(-1, 1, (3,))
    action_space = gymnasium.spaces.Box(-1, 1, (2,))
    closed = 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        if seed is not None:
            self.ill = self.np_random.integers(2) == 1
        self.fails = seed is None and self.ill
        return np.zeros(3, np.float32), {}

    def step(self, action):
        obs = np.full(3, np.nan if self.fails else 0.5, np.float32)
        return obs, 1.0, False, False, {}

    def close(self):
        Faulty.closed += 1


@pytest.fixture
def faulty():
    given = {"max_episode_steps": 10, "disable_env_checker": True}
    gymnasium.register("Faulty-v0", entry_point=Faulty, **given)
    yield "Faulty-v0"
    gymnasium.registry.pop("Faulty-v0")


def test_a_first_observation_that_is_no_number_costs_one_member_too(faulty, tiny, monkeypatch):
    def reset(self, *, seed=None, options=None):
        gymnasium.Env.reset(self, seed=seed)
        self.ill = self.ill if seed is None else self.np_random.integers(2) == 1
        self.fails = False
        return np.full(3, np.nan if seed is None and self.ill else 0, np.float32), {}

    monkeypatch.setattr(Faulty, "reset", reset)
    config = replace(tiny, env_id=faulty, reward="environment", update_every=20)
    with pytest.warns(UserWarning, match=r"seed . diverged by step .*mend Faulty-v0"):
        result = run(config, range(6))
    assert 0 < len(result.diverged) < 6
    assert all("mend Faulty-v0" in why for why in result.diverged.values())


@pytest.mark.parametrize("warmup_steps", [20, 100])
def test_a_task_that_gives_no_numbers_is_named_and_costs_one_member(faulty, tiny, warmup_steps):
    changes = {"env_id": faulty, "reward": "environment", "update_every": 20}
    config = replace(tiny, **changes, warmup_steps=warmup_steps)
    with pytest.warns(UserWarning, match=r"seed . diverged by step .*mend Faulty-v0"):
        result = run(config, range(6))
    assert 0 < len(result.diverged) < 6
    for why in result.diverged.values():
        assert "its observation or reward is not finite; mend Faulty-v0" in why
    assert len(result.rows) == 2 * (6 - len(result.diverged))
    assert all(np.isfinite(row.metrics["critic_loss"]) for row in result.rows)


def test_what_an_evaluation_cannot_count_costs_one_member(tiny, monkeypatch):
    def broken(policy, env_id, seeds, *given, **more):
        if 5 in seeds:
            raise NotFiniteError(env_id, [seeds.index(5)])
        return rollout(policy, env_id, seeds, *given, **more)

    monkeypatch.setattr("offairl_lite.core.loop.rollout", broken)
    with pytest.warns(UserWarning, match=r"seed 5 diverged by step .*mend offairl/PointMazeLeft"):
        result = run(replace(tiny, reward="environment"), (3, 5, 7))
    assert list(result.diverged) == [5]
    assert {row.seed for row in result.rows} == {3, 7}
    monkeypatch.undo()
    whole = run(replace(tiny, reward="environment"), (3, 5, 7))
    assert [row.returns for row in result.rows] == [r.returns for r in whole.rows if r.seed != 5]


def test_where_nothing_was_trained_it_is_said(tiny):
    config = replace(tiny, reward="environment", total_steps=90, warmup_steps=50, update_every=None)
    with pytest.warns(UserWarning, match=r"nothing was trained: .* step 50, .* and step 90; raise"):
        run(config, (3,))


def test_environments_are_closed(faulty, tiny, monkeypatch):
    monkeypatch.setattr(Faulty, "closed", 0)
    with closing(Trainer(replace(tiny, env_id=faulty, reward="environment"), range(4))):
        pass
    assert Faulty.closed == 4


# Putting a run back where it was.


@pytest.mark.parametrize("steps", [50, 100, 160])
def test_put_back_with_a_guide_held_actions_and_an_odd_number_of_updates(tiny, tmp_path, steps):
    config = replace(tiny, reward="environment", update_every=31, warmup_hold=5.0, start_steps=40)

    def trainer():
        guide, path = earlier_policy(config, 2), tmp_path / "replay"
        return Trainer(config, (0, 1), guide=guide, replay_file=path, memory=60)

    expected, one = finish(trainer()), trainer()
    until(one, lambda t: t.steps == steps)
    state = {name: tensor.clone() for name, tensor in one.state().items()}
    other = trainer()
    other.restore(state)
    rows = finish(other)
    assert_same_rows(rows, expected[len(expected) - len(rows) :])


@pytest.mark.parametrize("steps", [0, 50, 100, 130, 175])
@pytest.mark.parametrize(
    "changes",
    [
        {"temperature": None},
        {"env_id": HOPPER, "update_every": 30, "absorbing": "bootstrap", "replay_size": 60},
        {"env_id": HOPPER, "update_every": 30, "absorbing": "analytic", "reward": "dac"},
        {"env_id": "Pendulum-v1", "reward": "environment", "generator": "td3", "update_every": 40},
        {**ON_POLICY, "env_id": HOPPER, "reward": "gail-survival"},
        {**ON_POLICY, "reward": "gan-gcl", "update_every": 100, "replay_size": 100},
    ],
    ids=["maze", "bootstrap", "analytic", "td3", "ppo", "gan-gcl"],
)
def test_a_run_that_is_put_back_goes_the_same_way(
    tiny, random_demonstrations, tmp_path, steps, changes
):
    """To the bit, although the replay's file has gone on since."""
    config = replace(tiny, **changes)
    given = random_demonstrations(config.env_id) if config.learns_reward else None

    def trainer():
        return Trainer(config, (0, 1), given, replay_file=tmp_path / "replay", memory=60)

    one = trainer()
    until(one, lambda t: t.steps == steps)
    state = {name: tensor.clone() for name, tensor in one.state().items()}
    until(one, lambda t: t.finished or t.steps == steps + 60)
    expected = finish(trainer())
    other = trainer()
    until(other, lambda t: t.steps == min(steps + 60, 200))
    other = trainer()
    other.restore(state)
    rows = finish(other)
    assert_same_rows(rows, expected[len(expected) - len(rows) :])


def test_every_piece_of_work_is_a_place_to_go_on_from(tiny, maze, tmp_path):
    config = replace(tiny, total_steps=120, warmup_steps=60, update_every=20, eval_every=30)

    def trainer():
        return Trainer(config, (0,), maze, replay_file=tmp_path / "replay", memory=200)

    expected, one, pieces = finish(trainer()), trainer(), 0
    while not one.finished:
        one.advance()
        pieces += 1
        state = {name: tensor.clone() for name, tensor in one.state().items()}
        if pieces % 29 == 0 or one._due:
            other = trainer()
            other.restore(state)
            rows = finish(other)
            assert_same_rows(rows, expected[len(expected) - len(rows) :])
    assert pieces == 120 + 6 + 3


def test_a_state_of_another_run_is_refused(tiny, maze):
    state = Trainer(tiny, (0, 1), maze).state()
    with pytest.raises(ValueError, match="not a state of this"):
        Trainer(tiny, (0,), maze).restore(state)
    with pytest.raises(ValueError, match="not a state of this run: 'counts'"):
        Trainer(tiny, (0,), maze).restore({})


# Refusals.


def test_no_seed_twice(tiny, maze):
    with pytest.raises(ValueError, match=r"seeds are \(1, 1\)"):
        Trainer(tiny, (1, 1), maze)


def test_demonstrations_must_be_given_and_of_the_task(tiny, maze):
    with pytest.raises(ValueError, match="'implementation-4' is learned from demonstrations"):
        Trainer(tiny, (0,))
    right = replace(tiny, env_id="offairl/PointMazeRight-v0")
    with pytest.raises(ValueError, match=r"demonstrations of .*Left-v0 for a run on .*Right-v0"):
        Trainer(right, (0,), maze)


def test_before_anything_is_done_r_is_refused_what_it_cannot_see(tiny, maze):
    with pytest.raises(ValueError, match=r"reward_sees is \(0, 3\); .* have 3 numbers"):
        Trainer(replace(tiny, reward_sees=(0, 3)), (0,), maze)


@pytest.mark.parametrize(
    ("kind", "obs_dim", "gives", "cure"),
    [
        ("none", 5, 3, "it was learned on Hopper-v5; give the reward of a task like offairl/"),
        ("none", 2, 3, "it was learned on Hopper-v5; give"),
        ("none", 4, 3, "on Hopper-v5; if that had an absorbing state, set absorbing='bootstrap'"),
        ("bootstrap", 3, 4, "on Hopper-v5; if that had no absorbing state, set absorbing='none'"),
        ("analytic", 5, 4, "it was learned on Hopper-v5; give"),
    ],
)
def test_a_frozen_reward_of_other_observations_is_refused(tiny, kind, obs_dim, gives, cure):
    frozen = replace(tiny, reward="frozen", absorbing=kind)
    message = f"sees {obs_dim} numbers; with absorbing='{kind}', .* gives {gives}: .*{cure}"
    with pytest.raises(ValueError, match=message):
        Trainer(frozen, (0,), None, frozen_reward(1, HOPPER, obs_dim))


@pytest.mark.parametrize("kind", ["none", "bootstrap"])
def test_a_frozen_reward_of_other_actions_is_refused(tiny, kind):
    frozen, obs_dim = replace(tiny, reward="frozen", absorbing=kind), 3 + (kind != "none")
    with pytest.raises(ValueError, match=r"Hopper-v5, with 3 actions, and .*Left-v0 has 2: give"):
        Trainer(frozen, (0,), None, frozen_reward(1, HOPPER, obs_dim, action_dim=3))
    assert len(run(frozen, (0,), None, frozen_reward(1, obs_dim=obs_dim, action_dim=2)).rows) == 2


def test_a_frozen_reward_must_be_given_for_every_seed_and_only_then(tiny, maze):
    frozen = replace(tiny, reward="frozen")
    with pytest.raises(ValueError, match=r"3 frozen rewards for 2 seeds: .* --seeds 0 1 2$"):
        Trainer(frozen, (0, 1), None, frozen_reward(3))
    with pytest.raises(ValueError, match="go together"):
        Trainer(frozen, (0, 1))
    with pytest.raises(ValueError, match="go together"):
        Trainer(tiny, (0,), maze, frozen_reward(1))


@pytest.mark.parametrize("seeds", [(), np.arange(0)], ids=["tuple", "array"])
def test_no_seeds_no_run(tiny, maze, seeds):
    with pytest.raises(ValueError, match="no seeds"):
        Trainer(tiny, seeds, maze)


def test_seeds_may_be_an_array(tiny, maze):
    one = run(tiny, np.array([1, 3]), maze)
    assert_same(one, run(tiny, (1, 3), maze))
    assert {type(seed) for seed in [*one.seeds, *(row.seed for row in one.rows)]} == {int}


def test_an_unknown_task_is_refused(tiny):
    with pytest.raises(ValueError, match="unknown environment 'Nowhere-v0'"):
        Trainer(replace(tiny, env_id="Nowhere-v0", reward="environment"), (0,))


# What comes from other runs.


def earlier_policy(config, members, shift=0.0):
    actor = stochastic_actor(config, 3, 2)
    normaliser = Normaliser(torch.full((members, 1, 3), shift), torch.full((members, 1, 3), 2.0))
    return Policy(MAZE, actor, actor.init(Streams(range(10, 10 + members))), normaliser)


MCP = {"primitives": 3, "trunk_hidden": (8,), "primitive_hidden": (6,), "gate_hidden": (8,)}


def built(config, **given):
    """A trainer whose learners have just been made."""
    trainer = Trainer(config, range(2), **given)
    until(trainer, lambda trainer: trainer.generator is not None)
    return trainer


@pytest.mark.parametrize("kind", [{}, MCP])
def test_a_policy_that_is_carried_over_acts_as_before(tiny, kind):
    config = replace(tiny, reward="environment", carry="policy", **kind)
    policy = earlier_policy(config, 2, shift=0.3)
    now = built(config, pretrained_policy=policy).generator.policy
    assert torch.equal(now.params, policy.params)
    obs = Streams((0, 1)).normal(5, 3)
    torch.testing.assert_close(now.act(obs), policy.act(obs))


def test_primitives_are_carried_over_and_the_gate_begins_anew(tiny):
    config = replace(tiny, reward="environment", carry="primitives", **MCP)
    policy, fresh = earlier_policy(config, 2), built(replace(config, carry="nothing"))
    carried = built(config, pretrained_policy=policy).generator
    *others, gate = carried.actor.split(carried.actor_params.detach())
    *expected, earlier_gate = carried.actor.split(policy.params)
    assert all(map(torch.equal, others, expected))
    assert not torch.equal(gate, earlier_gate)
    assert torch.equal(gate, fresh.generator.actor.split(fresh.generator.actor_params)[-1])


def test_of_a_carried_policy_only_the_gate_need_learn(tiny):
    config = replace(
        tiny, reward="environment", carry="primitives", fixed_primitives=True, actor_delay=1, **MCP
    )
    policy = earlier_policy(config, 2)
    end = run_with(config, pretrained_policy=policy).policy
    before, after = (policy.actor.split(p.params) for p in (policy, end))
    assert all(map(torch.equal, after[:2], before[:2]))
    assert not torch.equal(after[2], before[2])


def run_with(config, **given):
    return train(config, range(2), **given, progress=False)


def test_a_guide_acts_at_the_start_and_its_steps_are_not_learned_from(tiny):
    config = replace(tiny, reward="environment", start_steps=40, total_steps=400)
    guide = earlier_policy(config, 2)
    trainer = Trainer(config, range(2), guide=guide)
    step, actions, lengths = trainer.env.step, [], []

    def watch(action):
        seen = torch.from_numpy(trainer.obs).float().unsqueeze(1)
        theirs = guide.act(seen)[:, 0].numpy()
        actions.append((trainer.guided.clone().numpy() > 0, action, theirs))
        return step(action)

    trainer.env.step = watch
    while not trainer.finished:
        if trainer.steps == 100 * len(lengths) < 400:  # an episode begins
            lengths.append(trainer.guided.clone())
        trainer.advance()
    for guided, action, theirs in actions:
        np.testing.assert_allclose(action[guided], theirs[guided], atol=1e-6)
        assert not np.isclose(action[~guided], theirs[~guided]).all(1).any()
    guided_steps = sum(torch.from_numpy(guided).long() for guided, *_ in actions)
    assert (guided_steps > 0).all()
    assert trainer.replay.added.tolist() == (400 - guided_steps).tolist()
    drawn = torch.stack(lengths)
    acts = np.stack([guided for guided, *_ in actions]).reshape(4, 100, 2)
    assert (acts == (np.arange(100)[:, None] < drawn.numpy()[:, None])).all()
    assert (drawn <= 40).all()
    assert len(drawn.unique()) > 4


def test_for_how_long_a_guide_acts_is_uniform(tiny):
    config = replace(tiny, reward="environment", start_steps=3, update_every=50)
    trainer = Trainer(config, range(100), guide=earlier_policy(config, 100))
    counts = torch.zeros(4)
    for _ in range(20):
        trainer._start(np.ones(100, bool))
        counts += trainer.guided.bincount(minlength=4)
    assert (counts / counts.sum()).sub(0.25).abs().max() < 0.04  # 4 standard deviations


@pytest.mark.parametrize(
    ("change", "given", "message"),
    [
        ({"carry": "policy"}, (), "carry='policy' and a pretrained policy"),
        ({}, ("pretrained_policy",), "carry='nothing' and a pretrained policy"),
        ({"start_steps": 5}, (), "start_steps=5 and a guide"),
        ({}, ("guide",), "start_steps=0 and a guide"),
    ],
)
def test_what_comes_from_other_runs_is_needed_and_not_more(tiny, change, given, message):
    config = replace(tiny, reward="environment", **change)
    with pytest.raises(ValueError, match=message):
        Trainer(config, (0,), **{name: earlier_policy(config, 1) for name in given})


def test_policies_must_be_as_many_and_of_the_architecture(tiny, maze):
    config = replace(tiny, reward="environment", carry="policy")
    with pytest.raises(ValueError, match="3 pretrained policies for 2 seeds"):
        Trainer(config, range(2), pretrained_policy=earlier_policy(config, 3))
    with pytest.raises(ValueError, match=r"is a SquashedGaussian\(.*MultiplicativeGaussian\("):
        Trainer(replace(config, **MCP), range(2), pretrained_policy=earlier_policy(config, 2))
    seeing = replace(config, carry="nothing", start_steps=5, reward="dac", absorbing="bootstrap")
    with pytest.raises(ValueError, match="sees 3 numbers and gives 2; this run has 4 and 2"):
        Trainer(seeing, range(2), maze, guide=earlier_policy(config, 2))
