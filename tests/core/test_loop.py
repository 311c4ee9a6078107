"""Algorithm 1: its schedule, its order, its reproducibility, divergence, going on from a state."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

import other_bounds  # noqa: F401  (registers the bottleneck)
from offairl_lite.ablations.released import RELEASE
from offairl_lite.core import sac
from offairl_lite.core.acceleration import Execution
from offairl_lite.core.discriminator import Discriminator
from offairl_lite.core.loop import Stop, Trainer, complete, train
from offairl_lite.core.policies import SquashedGaussian
from offairl_lite.core.ppo import EPOCHS, PPO
from offairl_lite.core.rng import Rng
from offairl_lite.core.sac import SAC
from offairl_lite.core.td3 import TD3

HOPPER, MAZE = "Hopper-v5", "offairl/PointMazeLeft-v0"
ON_POLICY = {"learner": "ppo", "train_every": 50, "replay_size": 50}
run = partial(train, progress=False)


def finish(trainer):
    """Take a trainer to its end; return the rows of each evaluation."""
    return [rows for rows in trainer.run() if rows]


def copied(state):
    return {name: tensor.clone() for name, tensor in state.items()}


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


# Reproducibility.


def test_same_seeds_same_run(tiny, maze):
    assert_same(run(tiny, (1, 3), maze), run(tiny, (1, 3), maze))


@pytest.mark.parametrize(
    ("changes", "needed"),
    [
        ({}, False),
        ({"loss": "airl"}, True),
        ({"reward": "dac"}, True),
        ({"reward": "r-sa"}, True),
    ],
    ids=["recipe", "exact", "dac", "r(s, a)"],
)
@pytest.mark.parametrize("env_id", [MAZE, HOPPER])
def test_only_the_recipe_does_without_the_demonstrated_actions(
    tiny, random_demonstrations, env_id, changes, needed
):
    """Whoever has recorded observations alone may write zeros."""
    ends = {"absorbing": "bootstrap", "train_every": 100} if env_id == HOPPER else {}
    released = {"loss": "log-ratio", "reward": "r-s"}
    config = tiny.change(env_id=env_id, **ends, **{**released, **changes})
    shown = random_demonstrations(env_id)
    zeros = torch.zeros_like(shown.transitions.pre_tanh)
    blind = replace(shown, transitions=shown.transitions._replace(pre_tanh=zeros))
    one, other = run(config, [0, 1], shown), run(config, [0, 1], blind)
    assert torch.equal(one.policy.params, other.policy.params) != needed
    if not needed:
        assert_same(one, other)


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
        raise Stop

    early, whole = train(tiny, [0, 1], maze, on_evaluation=enough), train(tiny, [0, 1], maze)
    assert early.rows == whole.rows[:2]
    assert (len(early.policy), len(early.reward)) == (2, 2)
    assert not torch.equal(early.policy.params, whole.policy.params)


@pytest.mark.parametrize(
    "changes",
    [
        {"temperature": None},
        {**ON_POLICY, "reward": "logit-s"},
    ],
    ids=["sac", "ppo"],
)
def test_a_member_trains_alone_as_among_others(tiny, maze, changes):
    # The same numbers are drawn; sums differ in their order only, which 400 updates of each
    # network leave far below 1e-3.
    config = tiny.change(total_steps=400, **changes)
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
    config = tiny.change(env_id=HOPPER, temperature=None, train_every=50, absorbing=absorbing)
    together, alone = (run(config, seeds, shown) for seeds in ((1, 3, 7), (3,)))
    assert together.rows[-1].episodes > 5
    torch.testing.assert_close(together.policy.params[1:2], alone.policy.params, rtol=0, atol=1e-3)
    torch.testing.assert_close(together.reward.params[1:2], alone.reward.params, rtol=0, atol=1e-3)
    assert [row.episodes for row in together.rows if row.seed == 3] == [
        row.episodes for row in alone.rows
    ]


def test_seeds_may_be_an_array(tiny, maze):
    one = run(tiny, np.array([1, 3]), maze)
    assert_same(one, run(tiny, (1, 3), maze))
    assert {type(seed) for seed in [*one.seeds, *(row.seed for row in one.rows)]} == {int}


# The schedule, and the order of updates.


def test_blocks_of_an_episode_s_length_are_the_ends_of_episodes(tiny, maze):
    assert_same(run(tiny, (0, 1), maze), run(tiny.change(train_every=100), (0, 1), maze))


def test_another_block_length_is_another_run(tiny, maze):
    one, other = run(tiny, (0,), maze), run(tiny.change(train_every=50), (0,), maze)
    assert not torch.equal(one.policy.params, other.policy.params)


def test_as_many_updates_as_steps_after_each_episode_those_of_the_warm_up_made_up(
    tiny, maze, record
):
    config = tiny.change(total_steps=400, learning_starts=250, eval_every=50)
    updates, trainer = record(SAC, "update"), Trainer(config, (0, 1), maze)
    done = [(rows[0].step, trainer.trained, len(updates)) for rows in trainer.run() if rows]
    assert done == [(250, 200, 200), (300, 300, 300), (350, 300, 300), (400, 400, 400)]
    assert trainer.collector.episodes.tolist() == [4, 4]


def test_a_run_pauses_after_each_block_and_each_evaluation(tiny, maze):
    trainer = Trainer(tiny.change(total_steps=300, learning_starts=200), (0, 1), maze)
    pauses = [(trainer.steps, trainer.trained, len(rows)) for rows in trainer.run()]
    warm_up, made_up = [(100, 0, 0), (200, 0, 0)], [(200, 100, 0), (200, 200, 0)]
    assert pauses == [*warm_up, *made_up, (200, 200, 2), (300, 300, 0), (300, 300, 2)]
    assert trainer.finished
    assert list(trainer.run()) == []


def order_of_updates(monkeypatch, *kinds):
    """Return a list to which every update adds who was updated."""
    order = []
    for kind in kinds:
        original = kind.update

        def update(self, *batch, original=original):
            order.append(type(self))
            return original(self, *batch)

        monkeypatch.setattr(kind, "update", update)
    return order


def test_the_discriminator_is_trained_first_and_the_learner_after_it(tiny, maze, monkeypatch):
    order = order_of_updates(monkeypatch, Discriminator, SAC)
    run(tiny, (0,), maze)
    assert order == ([Discriminator] * 100 + [SAC] * 100) * 2


def test_ppo_updates_so_many_epochs_of_minibatches_and_the_discriminator_as_told(
    tiny, maze, monkeypatch
):
    order = order_of_updates(monkeypatch, Discriminator, PPO)
    run(tiny.change(**ON_POLICY, discriminator_updates=4), (0,), maze)
    # 50 steps are six minibatches of 8, and one of 2.
    assert order == ([Discriminator] * 4 + [PPO] * EPOCHS * 7) * 2


def test_ppo_learns_from_each_block_once_and_never_from_the_warm_up(tiny, record):
    seen = record(PPO, "rollout")
    config = tiny.change(reward="environment", **ON_POLICY, learning_starts=70, total_steps=200)
    trainer = Trainer(config.change(replay_size=1000, normalise=False), (0, 1))
    finish(trainer)
    blocks = [block for (block,) in seen]
    # From step 70 on, in blocks of 50; the last 30 steps are no block.
    assert [block.obs.shape[1] for block in blocks] == [50, 50]
    for member in (0, 1):
        held = trainer.collector.replay.held(member)
        for parts in zip(held, *blocks, strict=True):
            everything, *some = parts
            assert torch.equal(everything[70:170], torch.cat([x[member] for x in some]))


@pytest.mark.parametrize("mode", ["none", "bootstrap", "analytic"])
@pytest.mark.parametrize("learner", ["sac", "td3"])
def test_members_that_end_at_different_times_train_in_blocks(
    tiny, random_demonstrations, record, mode, learner
):
    updates = record({"sac": SAC, "td3": TD3}[learner], "update")
    config = tiny.change(
        env_id=HOPPER,
        train_every=50,
        absorbing=mode,
        learner=learner,
        reward="logit-sa" if learner == "sac" else "dac",
    )
    trainer = Trainer(config, (0, 1), random_demonstrations(HOPPER, episodes=5))
    rows = [row for both in finish(trainer) for row in both]
    assert all(np.isfinite([row.mean_return, row.learned_return]).all() for row in rows)
    assert trainer.trained == len(updates) == 200
    assert (trainer.collector.episodes > 1).all()
    # Each termination adds the loop, which is the absorbing state's only transition.
    loops = trainer.collector.episodes if mode != "none" else np.zeros(2)
    np.testing.assert_array_equal(trainer.collector.replay.sizes, 200 + loops)
    if mode != "none":
        indicators = [trainer.collector.replay.held(i).obs[:, -1] for i in range(2)]
        np.testing.assert_array_equal([(x == 1).sum() for x in indicators], loops)
        # The indicator stays 0 or 1 for the networks.
        assert (trainer.normaliser.mean[..., -1] == 0).all()
        assert (trainer.normaliser.std[..., -1] == 1).all()
        # Demonstrations have their loops too.
        assert (trainer.demonstrations.obs[:, -1] == 1).sum() == 5


def test_without_blocks_members_must_end_together(tiny):
    config = tiny.change(env_id=HOPPER, reward="environment")
    with pytest.raises(ValueError, match=r"different times.*train_every"):
        run(config, (0, 1))


def test_where_nothing_was_trained_it_is_said(tiny):
    config = tiny.change(reward="environment", total_steps=90, learning_starts=50, train_every=None)
    with pytest.warns(UserWarning, match=r"nothing was trained: .* step 50, .* and step 90; raise"):
        run(config, (3,))


# Variants.


@pytest.mark.parametrize(
    "change",
    [
        {"reward": "logit-sa"},
        {"reward": "logit-s", "learner": "sac-released"},
        {"reward": "r-sa"},
        {"reward": "dac", "learner": "td3"},
        {"reward": "dac"},
        {"reward": "gail-survival"},
        {"reward": "gail-termination", "learner": "td3"},
        {"reward": "gail-survival", **ON_POLICY},
        {"reward": "r-s", **ON_POLICY, "discriminator_updates": 5},
        {"random_hold": 5.0, "temperature": None},
    ],
    ids=str,
)
def test_every_variant_trains_and_evaluates(tiny, maze, change):
    result = run(tiny.change(**change), (0, 1), maze)
    assert result.steps.tolist() == [100, 200]
    assert result.returns.shape == (2, 2)
    assert all(np.isfinite(row.learned_return) for row in result.rows)
    first, last = result.rows[0], result.rows[-1]
    assert (first.seed, last.seed, last.step, last.episodes) == (0, 1, 200, 2)
    assert last.mean_return == pytest.approx(np.mean(last.returns))
    assert len(last.returns) == 2
    assert {"critic_loss", "cross_entropy", "penalty"} <= set(last.metrics)


def test_the_released_preset_trains(tiny, maze):
    config = RELEASE.change(
        total_steps=200, learning_starts=100, batch_size=8, hidden=(8,), eval_episodes=2
    )
    config = config.change(reward_hidden=(8,), shaping_hidden=(8,))
    assert np.isfinite(run(config, (0,), maze).returns).all()


def test_the_task_s_own_reward_needs_no_demonstrations(tiny):
    result = run(tiny.change(reward="environment"), (0,))
    assert result.reward is None
    assert np.isnan(result.rows[-1].learned_return)


def test_a_frozen_reward_is_given_back_unchanged(tiny, frozen_reward):
    reward = frozen_reward(2)
    before = reward.params.clone()
    result = run(tiny.change(reward="frozen"), (0, 1), None, reward)
    assert torch.equal(result.reward.params, before)


# Divergence.


@pytest.mark.parametrize(("delay", "tensor"), [(2, "actor"), (10**9, "critic")])
def test_divergence_names_seed_step_and_tensor_and_spares_the_others(
    tiny, frozen_reward, monkeypatch, delay, tensor
):
    monkeypatch.setattr(sac, "POLICY_DELAY", delay)
    reward = frozen_reward(2)
    reward.params[1] = torch.nan
    config = tiny.change(reward="frozen")
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


def test_a_learned_temperature_is_among_what_may_have_diverged(tiny, frozen_reward):
    reward = frozen_reward(2)
    reward.params[1] = torch.nan
    with pytest.warns(UserWarning, match="lower learning_rate"):
        why = run(tiny.change(reward="frozen", temperature=None), (3, 7), None, reward).diverged[7]
    assert why.endswith("set temperature, if a learned one rose (curve.csv)")


def test_a_member_that_was_given_up_stays_at_zero(tiny, until):
    config = tiny.change(reward="environment", total_steps=400, eval_every=50)
    trainer = Trainer(config, (3, 7))
    until(trainer, lambda t: t.steps == 150)
    trainer.learner.actor_params.data[1, 0] = torch.nan
    with pytest.warns(UserWarning, match="seed 7 diverged by step 150: its actions"):
        rows = finish(trainer)
    assert trainer.trained == 400  # in blocks of 100, of which three came after
    assert {row.seed for each in rows for row in each} == {3}
    for name, tensor in trainer.weights().items():
        if tensor.ndim > 1:
            assert (tensor[..., 1, :] == 0).all(), name
    learner = trainer.learner
    for weights in (learner.actor_params, learner.critic_params, learner.target_params):
        assert (weights[..., 0, :] != 0).any()


def test_a_discriminator_that_is_not_finite_is_noticed(tiny, maze, until):
    trainer = Trainer(tiny, (3, 7), maze)
    until(trainer, lambda t: t.trained == 100)
    trainer.discriminator.value_params.data[0, 0] = torch.nan
    with pytest.warns(UserWarning, match="seed 3 diverged by step 200: its (actor|critic|reward)"):
        rows = finish(trainer)
    assert [row.seed for row in rows[-1]] == [7]


def test_when_every_member_has_diverged_the_run_stops_and_its_rows_are_there(tiny, monkeypatch):
    original, rows, updates = SAC.update, [], []

    def update(self, *batch):
        if len(updates) == 150:
            self.critic_params.data[1] = -torch.inf
        updates.append(batch)
        return original(self, *batch)

    monkeypatch.setattr(SAC, "update", update)
    trainer = Trainer(tiny.change(reward="environment"), (3, 7))
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
        result = run(tiny.change(reward="environment"), (3, 7))
    assert list(result.diverged) == [3]


# Putting a run back where it was.


@pytest.mark.parametrize(("steps", "trained"), [(31, 0), (100, 31), (160, 155)])
def test_put_back_with_a_guide_held_actions_and_an_odd_number_of_updates(
    tiny, tmp_path, earlier_policy, until, steps, trained
):
    config = tiny.change(reward="environment", train_every=31, eval_every=20)
    config = config.change(random_hold=5.0, guide_steps=40)

    def trainer():
        guide, path = earlier_policy(config, 2), tmp_path / "replay"
        return Trainer(config, (0, 1), guide=guide, replay_file=path, memory=60)

    expected, one = finish(trainer()), trainer()
    until(one, lambda t: t.steps == steps)
    assert (one.steps, one.trained) == (steps, trained)
    state = copied(one.state())
    other = trainer()
    other.restore(state)
    rows = finish(other)
    assert_same_rows(rows, expected[len(expected) - len(rows) :])
    assert rows


@pytest.mark.parametrize(
    ("steps", "trained"), [(0, 0), (50, 0), (100, 1), (125, 1), (175, 1)], ids=lambda x: str(x)
)
@pytest.mark.parametrize(
    "changes",
    [
        {"temperature": None},
        {"env_id": HOPPER, "train_every": 30, "absorbing": "bootstrap", "replay_size": 60},
        {"env_id": HOPPER, "train_every": 30, "absorbing": "analytic", "reward": "dac"},
        {"env_id": "Pendulum-v1", "reward": "environment", "learner": "td3", "train_every": 40},
        {**ON_POLICY, "env_id": HOPPER, "reward": "gail-survival"},
        {"reward": "sqil", "env_id": HOPPER, "train_every": 30, "absorbing": "bootstrap"},
        {"reward": "iq-learn", "temperature": None},
    ],
    ids=["maze", "bootstrap", "analytic", "td3", "ppo", "sqil", "iq-learn"],
)
def test_a_run_that_is_put_back_goes_the_same_way(
    tiny, random_demonstrations, tmp_path, until, steps, trained, changes
):
    """To the bit, although the replay's file has gone on since.

    It is put back where it paused first after so many steps and as many that were trained on: at
    the start, in the warm-up, and from there on between blocks as well as within one.
    """
    config = tiny.change(eval_every=25, **changes)
    given = random_demonstrations(config.env_id) if config.imitates else None

    def trainer():
        return Trainer(config, (0, 1), given, replay_file=tmp_path / "replay", memory=60)

    one = trainer()
    if steps:
        until(one, lambda t: t.steps >= steps and t.trained >= trained)
    state, start = copied(one.state()), one.steps
    # Pauses are 25 steps apart at most, so that it goes on for no more than 60.
    until(one, lambda t: t.steps >= start + 35)
    gone_on = min(one.steps, 200)
    expected = finish(trainer())
    other = trainer()
    until(other, lambda t: t.steps == gone_on)
    other = trainer()
    other.restore(state)
    rows = finish(other)
    assert_same_rows(rows, expected[len(expected) - len(rows) :])
    assert rows


def test_every_pause_is_a_place_to_go_on_from(tiny, maze, tmp_path):
    config = tiny.change(total_steps=120, learning_starts=60, train_every=20, eval_every=30)

    def trainer():
        return Trainer(config, (0,), maze, replay_file=tmp_path / "replay", memory=200)

    expected, one, pauses = finish(trainer()), trainer(), 0
    for rows in one.run():
        pauses += 1
        state, finished = copied(one.state()), one.finished
        other = trainer()
        other.restore(state)
        assert other.finished == finished
        after = finish(other)
        assert len(after) == sum(each[0].step > one.evaluated for each in expected)
        assert_same_rows(after, expected[len(expected) - len(after) :])
        assert bool(rows) == (one.evaluated == one.steps)
    assert pauses == 3 + 6 + 3


def test_a_state_of_another_run_is_refused(tiny, maze):
    state = Trainer(tiny, (0, 1), maze).state()
    with pytest.raises(ValueError, match="not a state of this"):
        Trainer(tiny, (0,), maze).restore(state)
    with pytest.raises(ValueError, match=r"not a state of this run: 'normaliser\.mean'"):
        Trainer(tiny, (0,), maze).restore({})


MCP = {"primitives": 3, "trunk_hidden": (8,), "primitive_hidden": (6,), "gate_hidden": (8,)}
BOTTLENECK = {"ablation": "bottleneck"}


@pytest.mark.parametrize(
    ("base", "change"),
    [
        ({}, {"discount": 0.5}),
        ({}, {"learning_rate": 1e-2}),
        ({}, {"target_rate": 0.5}),
        ({}, {"temperature": 0.7}),
        ({}, {"log_std_range": (-2.0, 1.0)}),
        ({}, {"reward_scale": 3.0}),
        ({}, {"centre_reward": True}),
        ({}, {"discriminator_discount": 0.5}),
        ({}, {"discriminator_activation": "relu"}),
        ({}, {"reward_hidden": (6,)}),
        ({}, {"shaping_hidden": (6,)}),
        ({}, {"gradient_penalty": 1.0}),
        ({}, {"discriminator_updates": 3}),
        (MCP, {"gating": "sigmoid"}),
        (MCP, {"gate_hidden": (6,)}),
        ({**MCP, "learner": "sac-released"}, {"gating": "softplus"}),
        (ON_POLICY, {"discount": 0.5}),
        (ON_POLICY, {"temperature": 0.7}),
        (ON_POLICY, {"learning_rate": 1e-2}),
        (BOTTLENECK, {"bottleneck_size": 3}),
        (BOTTLENECK, {"bottleneck_rate": 1.0}),
    ],
    ids=str,
)
def test_a_setting_that_is_given_is_heard(tiny, maze, base, change):
    config = tiny.change(**base)
    one, other = (run(c, (0,), maze).policy for c in (config, config.change(**change)))
    obs = Rng((0,)).normal(5, 3)
    assert not torch.equal(one.act(obs), other.act(obs))


def test_ppo_goes_through_its_block_ten_times_each_step_once(tiny, record):
    updates = record(PPO, "update")
    run(tiny.change(reward="environment", **ON_POLICY), (0,))
    assert len(updates) == 2 * 10 * 7  # 50 steps are six minibatches of 8, and one of 2.
    for epoch in range(20):
        parts = updates[7 * epoch : 7 * (epoch + 1)]
        assert len(torch.cat([rows.pre_tanh[0] for rows, _ in parts]).unique(dim=0)) == 50
    noise = torch.cat([eps.flatten() for _, eps in updates])
    assert abs(noise.std() - 1) < 0.1
