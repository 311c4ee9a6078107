"""Evaluations: whose episodes they are, what they count, and that they change nothing."""

from functools import partial

import numpy as np
import pytest
import torch

from offairl_lite.core.loop import train
from offairl_lite.core.networks import Normaliser
from offairl_lite.core.policies import Policy, SquashedGaussian
from offairl_lite.core.results import learned_returns
from offairl_lite.core.rng import Rng
from offairl_lite.core.rollouts import rollout

HOPPER = "Hopper-v5"
run = partial(train, progress=False)


def test_rows_are_of_their_member_s_own_episodes(tiny, frozen_reward):
    # One of the net's last weights: r is 1 for the first member, 2 for the second, everywhere.
    reward = frozen_reward(2, HOPPER, 11)
    reward.params.zero_()
    reward.params[:, reward.net.num_params - 5] = torch.tensor([1.0, 2.0])
    config = tiny.change(env_id=HOPPER, train_every=50, reward="frozen", eval_episodes=5)
    result = run(config, (3, 7), None, reward)
    episodes = rollout(result.policy, HOPPER, (3, 7), 5)
    assert len(np.unique(episodes.lengths)) > 1
    for i, row in enumerate(result.rows[-2:]):
        np.testing.assert_array_equal(row.returns, episodes.returns[i])
        assert row.learned_return == pytest.approx((i + 1) * episodes.lengths[i].mean())


def test_the_learned_return_is_the_sum_of_the_reward_along_the_episode(tiny, frozen_reward):
    reward = frozen_reward(1)
    reward.params.zero_()
    reward.params[:, reward.net.num_params - 5] = 2.0  # the last bias, followed by 4 weights
    result = run(tiny.change(reward="frozen"), (0,), None, reward)
    assert result.rows[-1].learned_return == pytest.approx(2.0 * 100)


def test_the_evaluation_s_own_members_do_not_disturb_the_training(tiny, maze):
    often, rarely = (run(tiny.change(eval_every=n), (0,), maze) for n in (50, 200))
    assert torch.equal(often.policy.params, rarely.policy.params)


def test_the_learned_return_is_of_the_states_and_actions_of_the_episode(frozen_reward):
    reward, actor = frozen_reward(2, HOPPER, 11, action_dim=3), SquashedGaussian(11, 3, (8,))
    policy = Policy(HOPPER, actor, actor.init(Rng((3, 7))), Normaliser.identity(2, 11))
    episodes = rollout(policy, HOPPER, (3, 7), 4)
    learned = learned_returns(episodes, reward)
    for s, e in np.ndindex(2, 4):
        steps = np.arange(episodes.lengths[s, e])
        parts = episodes.obs[s, e, steps], episodes.action[s, e, steps]
        paid = reward.member(s)(*(torch.tensor(x, dtype=torch.float32)[None] for x in parts))
        assert learned[s, e] == pytest.approx(paid.sum().item(), rel=1e-4)
