"""One reward for several worlds: against one world, exact solutions, and bad inputs."""

import numpy as np
import pytest
import torch

from offairl_lite import tabular, worlds
from offairl_lite.config import CORRECTED
from offairl_lite.core import loop
from offairl_lite.core.discriminator import Transitions, make_discriminator
from offairl_lite.core.networks import Normaliser
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rng import Rng
from offairl_lite.core.shapes import Layout
from offairl_lite.tabular import MDP, occupancy, soft_value_iteration

LEFT, RIGHT = "offairl/PointMazeLeft-v0", "offairl/PointMazeRight-v0"
SEEDS = (0, 1)


@pytest.fixture
def pair(random_demonstrations):
    return [random_demonstrations(env_id) for env_id in (LEFT, RIGHT)]


@pytest.mark.parametrize("reward", ["r-sa", "logit-s"])
def test_twice_the_same_world_is_that_world(tiny, pair, reward):
    config = tiny.change(reward=reward)
    alone = loop.train(config, SEEDS, pair[0], progress=False)
    for run in worlds.train(config, SEEDS, [pair[0]] * 2, progress=False):
        assert torch.equal(run.reward.params, alone.reward.params)
        assert torch.equal(run.policy.params, alone.policy.params)
        assert run.rows == alone.rows


def test_worlds_share_reward_and_scaling_and_nothing_else(tiny, pair):
    config = tiny.change(reward="r-sa")
    left, right = worlds.train(config, SEEDS, pair, progress=False)
    assert [run.config.env_id for run in (left, right)] == [LEFT, RIGHT]
    assert left.reward.params.shape == (2, left.reward.net.num_params)
    assert torch.equal(left.reward.params, right.reward.params)
    assert not torch.equal(left.policy.params, right.policy.params)
    for ours, theirs in zip(left.reward.normaliser, right.policy.normaliser, strict=True):
        assert torch.equal(ours, theirs)
    assert [row.step for row in left.rows] == [100, 100, 200, 200]


def test_another_world_changes_the_reward(tiny, pair):
    alone = loop.train(tiny, SEEDS, pair[0], progress=False)
    together, _ = worlds.train(tiny, SEEDS, pair, progress=False)
    assert not torch.allclose(together.reward.params, alone.reward.params, atol=1e-2)


def test_the_same_seeds_give_the_same_numbers(tiny, pair):
    first, again = (worlds.train(tiny, (3,), pair, progress=False) for _ in range(2))
    for one, other in zip(first, again, strict=True):
        assert one.rows == other.rows
        assert torch.equal(one.reward.params, other.reward.params)


def test_a_new_policy_is_paid_by_the_reward_in_another_world(tiny, pair, tmp_path):
    run, _ = worlds.train(tiny, SEEDS, pair, progress=False)
    run.reward.save(tmp_path / "reward.safetensors")
    reward = Reward.load(tmp_path / "reward.safetensors")
    config = tiny.change(env_id="offairl/PointMarsh-v0", reward="frozen")
    retrained = loop.train(config, SEEDS, frozen_reward=reward, progress=False)
    assert np.isfinite(retrained.returns).all()


def test_a_seed_that_diverges_in_one_world_is_given_up_in_all(tiny, pair):
    both = worlds.Worlds(tiny, SEEDS, pair)
    one = both.worlds[0]
    original = one.update_learner

    def broken(*minibatch):
        one.learner.state["actor.params"][0] = torch.nan
        return original(*minibatch)

    one.update_learner = broken
    with pytest.warns(UserWarning, match="seed 0 diverged"):
        left, right = both.run()
    both.close()
    assert set(left.diverged) == set(right.diverged) == {0}
    assert "another world" in right.diverged[0]
    assert not right.reward.params[0].any()
    assert right.reward.params[1].isfinite().all()


def test_scaling_is_that_of_all_worlds():
    one, two = (torch.randn(2, 50, 3, generator=torch.Generator().manual_seed(i)) for i in (0, 1))
    mixed = worlds.mixture([Normaliser.of(one), Normaliser.of(two * 3 + 1)])
    for ours, theirs in zip(mixed, Normaliser.of(one, two * 3 + 1), strict=True):
        torch.testing.assert_close(ours, theirs)


class Grid:
    """A deterministic world with exact policies, whose features are one-hot."""

    def __init__(self, mdp, expert_reward):
        self.mdp = MDP(mdp.transition, np.full(mdp.num_states, 1 / mdp.num_states), mdp.discount)
        self.pairs, self.to = mdp.transition.shape[0], mdp.transition.toarray().argmax(1)
        self.shown = soft_value_iteration(self.mdp, expert_reward).log_policy
        self.log_policy = np.full_like(self.shown, -np.log(mdp.num_actions))

    def drawn(self, log_policy, rng, count=512):
        """Draw transitions as often as a policy makes them."""
        often = occupancy(self.mdp, np.exp(log_policy)).ravel()
        return self.at(rng.choice(self.pairs, count, p=often / often.sum()))

    def at(self, pair):
        """Return the transitions of pairs (s, a)."""
        states, pairs = torch.eye(self.mdp.num_states), torch.eye(self.pairs)
        log_prob = torch.from_numpy(self.log_policy.ravel()[pair]).float()
        obs = states[pair // self.mdp.num_actions]
        parts = obs, pairs[pair], states[self.to[pair]], log_prob
        return Transitions(*(part.unsqueeze(0) for part in parts))

    def improve(self, reward, share=0.3):
        best = soft_value_iteration(self.mdp, reward).log_policy
        mixed = (1 - share) * self.log_policy + share * best
        self.log_policy = mixed - np.log(np.exp(mixed).sum(1, keepdims=True))


def game(mdps, truth, rounds=25, updates=25):
    """Return the reward (S, A) that discriminators find from tabular features."""
    grids, rng = [Grid(mdp, truth) for mdp in mdps], np.random.default_rng(0)
    layout = Layout(1, mdps[0].num_states, grids[0].pairs)
    config = CORRECTED.change(
        reward="r-sa",
        reward_hidden=(64,),
        shaping_hidden=(64,),
        gradient_penalty=0.0,
        discount=mdps[0].discount,
    )
    discriminators = [make_discriminator(config.discriminator, layout) for _ in mdps]
    for each in discriminators:
        each.init(Rng((0,)))
    worlds.share(*discriminators)
    everything = grids[0].at(np.arange(grids[0].pairs))
    for k in range(rounds):
        for each in discriminators:
            each.reward_optimizer.learning_rate = 0.02 * (1 - k / rounds)
            each.value_optimizer.learning_rate = 0.02 * (1 - k / rounds)
        for _ in range(updates):
            minibatches = [
                (
                    grid.drawn(grid.shown, rng),
                    grid.drawn(grid.log_policy, rng),
                    torch.zeros(1, 512, 4),
                )
                for grid in grids
            ]
            worlds.update(discriminators, *minibatches)
        own = discriminators[0]
        r = own.reward_net(own.reward_params.detach(), own.reward_input(everything))
        reward = r.double().numpy().reshape(grids[0].shown.shape)
        for grid in grids:
            grid.improve(reward)
    return reward, [grid.shown for grid in grids]


def correlation(one, other):
    return np.corrcoef(np.ravel(one), np.ravel(other))[0, 1]


def test_with_tabular_features_two_worlds_find_the_exact_reward():
    left = tabular.maze(4, "Left", discount=0.9)
    turned = left.mdp.transition.toarray().reshape(16, 5, 16)[:, [0, 2, 3, 4, 1]]
    mdps = [left.mdp, MDP(turned, left.mdp.initial, 0.9)]
    assert tabular.separation(mdps).free == 1
    truth = left.reward / 0.3
    learned, shown = game(mdps, truth)
    exact = tabular.shared_reward(mdps, shown)
    assert correlation(exact, np.repeat(truth, 5)) > 0.999
    alone, _ = game(mdps[:1], truth)
    print(
        correlation(learned, exact),
        correlation(alone, exact),
        np.ptp(learned - exact),
        np.ptp(exact),
    )
    assert correlation(learned, exact) > 0.97
    assert correlation(alone, exact) < 0.8


def test_bad_inputs_are_refused(tiny, pair, own, random_demonstrations):
    with pytest.raises(ValueError, match="at least; for one use"):
        worlds.train(tiny, SEEDS, pair[:1])
    other = random_demonstrations(own("mine/Arm-v0"))
    with pytest.raises(ValueError, match=r"same observations and actions, not .*mine/Arm-v0"):
        worlds.train(tiny, SEEDS, [pair[0], other])
    with pytest.raises(ValueError, match="'dac'; worlds share logit-sa"):
        worlds.train(tiny.change(reward="dac"), SEEDS, pair)
    with pytest.raises(ValueError, match="without an ablation"):
        worlds.train(tiny.change(ablation="penalty-on-probability"), SEEDS, pair)
    with pytest.raises(ValueError, match="a pretrained policy go together"):
        worlds.train(tiny.change(pretrained="policy"), SEEDS, pair)


def test_worlds_whose_blocks_do_not_end_together_are_refused(tiny, own, random_demonstrations):
    shown = [random_demonstrations(own(f"mine/Arm{i}-v0")) for i in range(2)]
    short = tiny.change(learning_starts=12, train_every=5, total_steps=20)
    with pytest.raises(ValueError, match="warm-ups end at different times: set train_every"):
        worlds.train(short, SEEDS, shown)
    pair = worlds.train(short.change(learning_starts=10), SEEDS, shown, progress=False)
    assert [run.rows[-1].step for run in pair] == [20, 20]
