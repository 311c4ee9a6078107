"""Collecting: warm-up actions, the guide, absorbing states, and tasks that fail."""

from contextlib import closing
from functools import partial

import gymnasium
import numpy as np
import pytest
import torch

from offairl_lite.core.loop import Trainer, complete, train

HOPPER = "Hopper-v5"
ON_POLICY = {"learner": "ppo", "train_every": 50, "replay_size": 50}
run = partial(train, progress=False)


def end_episodes(trainer, terminated=(), truncated=()):
    """From now on, the episodes of these members end at every step, and no others."""
    env, members = trainer.collector.env, np.arange(len(trainer.seeds))
    step = env.step

    def ending(action):
        obs, reward, _, _, info = step(action)
        return obs, reward, np.isin(members, terminated), np.isin(members, truncated), info

    env.step = ending


def test_the_warm_up_holds_an_action_as_long_as_it_says(tiny):
    steps = {"learning_starts": 1001, "total_steps": 1101}
    trainer = Trainer(tiny.change(reward="environment", random_hold=4.0, **steps), range(10))
    for _ in range(1000):
        trainer.collector.step(None)
    actions = trainer.collector.replay.last(1000).pre_tanh
    fresh = (actions.diff(dim=1) != 0).all(-1).float().mean()
    assert abs(fresh - 1 / 4) < 4 * (0.25 * 0.75 / 9_990) ** 0.5  # four standard errors


@pytest.mark.parametrize(
    ("changes", "warned"),
    [
        ({}, True),
        ({"absorbing": "bootstrap"}, False),
        ({"reward": "environment"}, False),
        ({"reward": "sqil"}, True),
        ({**ON_POLICY, "reward": "gail-survival"}, False),
    ],
)
def test_a_run_that_leaves_the_end_of_episodes_to_chance_warns_once(
    tiny, random_demonstrations, caplog, changes, warned
):
    config = tiny.change(**{"env_id": HOPPER, "train_every": 50, **changes})
    shown = random_demonstrations(HOPPER) if config.imitates else None
    run(config, (0, 1), shown)
    assert len(caplog.messages) == warned
    for message in caplog.messages:
        assert "An episode of Hopper-v5 has terminated" in message
        assert "Set absorbing='bootstrap'" in message


def test_the_absorbing_state_is_kept_for_the_member_that_came_to_it(tiny, random_demonstrations):
    config = tiny.change(env_id=HOPPER, train_every=50, absorbing="bootstrap")
    trainer = Trainer(config, (0, 1), random_demonstrations(HOPPER))
    end_episodes(trainer, terminated=[1])
    trainer.collector.step(None)
    replay = trainer.collector.replay
    assert replay.sizes == [1, 2]
    assert (replay.held(0).next_obs[:, -1] == 0).all()
    there = torch.tensor([*[0.0] * 11, 1.0])
    step, loop = replay.held(1).obs
    assert step[-1] == 0
    assert torch.equal(loop, there)
    assert torch.equal(replay.held(1).next_obs, there.expand(2, 12))


def test_a_time_limit_makes_no_absorbing_state(tiny, maze, until):
    trainer = Trainer(tiny.change(absorbing="bootstrap"), (0, 1), maze)
    until(trainer, lambda t: t.finished)
    replay = trainer.collector.replay
    assert replay.sizes == [200, 200]
    for member in (0, 1):
        held = replay.held(member)
        assert (held.obs[:, -1] == 0).all()
        # Nor a termination.
        assert (held.terminated == 0).all()


# The guide.


def test_a_guide_acts_at_the_start_and_its_steps_are_not_learned_from(tiny, until, earlier_policy):
    config = tiny.change(reward="environment", guide_steps=40, total_steps=400)
    guide = earlier_policy(config, 2)
    trainer = Trainer(config, range(2), guide=guide)
    acting = trainer.collector
    step, actions, lengths = acting.env.step, [], []

    def watch(action):
        if len(actions) % 100 == 0:  # an episode begins
            lengths.append(acting.guided.clone())
        seen = torch.from_numpy(acting.obs).float().unsqueeze(1)
        guides = guide.act(seen)[:, 0].numpy()
        actions.append((acting.guided.clone().numpy() > 0, action, guides))
        return step(action)

    acting.env.step = watch
    until(trainer, lambda t: t.finished)
    for guided, action, guides in actions:
        np.testing.assert_allclose(action[guided], guides[guided], atol=1e-6)
        assert not np.isclose(action[~guided], guides[~guided]).all(1).any()
    guided_steps = sum(torch.from_numpy(guided).long() for guided, *_ in actions)
    assert (guided_steps > 0).all()
    assert acting.replay.added.tolist() == (400 - guided_steps).tolist()
    drawn = torch.stack(lengths)
    acts = np.stack([guided for guided, *_ in actions]).reshape(4, 100, 2)
    assert (acts == (np.arange(100)[:, None] < drawn.numpy()[:, None])).all()
    assert (drawn <= 40).all()
    assert len(drawn.unique()) > 4


def test_for_how_long_a_guide_acts_is_uniform(tiny, earlier_policy):
    config = tiny.change(reward="environment", guide_steps=3, train_every=50)
    trainer = Trainer(config, range(100), guide=earlier_policy(config, 100))
    end_episodes(trainer, truncated=range(100))
    counts = torch.zeros(4)
    for _ in range(20):
        trainer.collector.step(None)
        counts += trainer.collector.guided.bincount(minlength=4)
    assert (counts / counts.sum()).sub(0.25).abs().max() < 0.04  # 4 standard deviations


def test_a_guide_s_steps_are_drawn_only_for_members_whose_episodes_begin(tiny, earlier_policy):
    config = tiny.change(reward="environment", guide_steps=40)
    ending, going_on = (
        Trainer(config, range(2), guide=earlier_policy(config, 2)) for _ in range(2)
    )
    end_episodes(ending, truncated=[0])
    for trainer in (ending, going_on):
        trainer.collector.step(None)
    assert (ending.rng.state != going_on.rng.state).any(1).tolist() == [True, False]
    assert ending.collector.guided[1] == going_on.collector.guided[1]


# Tasks that give no numbers.


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


def test_a_first_observation_that_is_no_number_is_named_too(faulty, tiny, monkeypatch):
    def reset(self, *, seed=None, options=None):
        gymnasium.Env.reset(self, seed=seed)
        self.ill = self.ill if seed is None else self.np_random.integers(2) == 1
        self.fails = False
        return np.full(3, np.nan if seed is None and self.ill else 0, np.float32), {}

    monkeypatch.setattr(Faulty, "reset", reset)
    config = tiny.change(env_id=faulty, reward="environment", train_every=20)
    found = r"Faulty-v0, seed \d+, is at fault in step 9: its observation.0. is nan, not within"
    with pytest.raises(ValueError, match=found):
        run(config, range(6))


@pytest.mark.parametrize("learning_starts", [20, 100])
def test_a_task_that_gives_no_numbers_is_named(faulty, tiny, learning_starts):
    changes = {"env_id": faulty, "reward": "environment", "train_every": 20}
    config = tiny.change(**changes, learning_starts=learning_starts)
    found = r"Faulty-v0, seed \d+, is at fault in step 10: its observation.0. is nan, not within"
    with pytest.raises(ValueError, match=found):
        run(config, range(6))


def test_what_a_task_gives_to_a_member_that_was_given_up_does_not_matter(faulty, tiny):
    config = tiny.change(env_id=faulty, reward="environment", train_every=20)
    trainer = Trainer(config, range(6))
    ill = torch.tensor([env.unwrapped.ill for env in trainer.collector.env.envs])
    with pytest.warns(UserWarning, match="seed . diverged by step 0: its eye is red"):
        trainer.members.give_up(ill, 0, "eye is red")
    rows = complete(trainer, progress=False).rows
    assert {row.seed for row in rows} == {*torch.nonzero(~ill).flatten().tolist()}
    assert all(np.isfinite(row.metrics["critic_loss"]) for row in rows)


def test_environments_are_closed(faulty, tiny, monkeypatch):
    monkeypatch.setattr(Faulty, "closed", 0)
    with closing(Trainer(tiny.change(env_id=faulty, reward="environment"), range(4))):
        pass
    assert Faulty.closed == 4


def test_warm_up_actions_are_uniform(tiny):
    trainer = Trainer(tiny.change(reward="environment"), range(10))
    for _ in range(100):
        trainer.collector.step(None)
    actions = torch.tanh(trainer.collector.replay.last(100).pre_tanh).flatten()
    quarters = torch.histc(actions, 4, -1, 1) / actions.numel()
    torch.testing.assert_close(quarters, torch.full((4,), 0.25), rtol=0, atol=0.04)
