"""Evaluations: whose episodes they are, what they count, and that they change nothing."""

from functools import partial

import numpy as np
import pytest
import torch

from offairl_lite.core.loop import train
from offairl_lite.core.rollouts import ReadingError, rollout

HOPPER = "Hopper-v5"
run = partial(train, progress=False)


def test_rows_are_of_their_member_s_own_episodes(tiny, frozen_reward):
    # One of the net's last weights: r is 1 for the first member, 2 for the second, everywhere.
    reward = frozen_reward(2, HOPPER, 11)
    reward.params.zero_()
    reward.params[:, reward.net.num_params - 5] = torch.tensor([1.0, 2.0])
    config = tiny.change(env_id=HOPPER, update_every=50, reward="frozen", eval_episodes=5)
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


def test_what_an_evaluation_cannot_count_costs_one_member(tiny, monkeypatch):
    def broken(policy, env_id, seeds, *given, **more):
        if 5 in seeds:
            raise ReadingError(env_id, [seeds.index(5)])
        return rollout(policy, env_id, seeds, *given, **more)

    monkeypatch.setattr("offairl_lite.core.evaluation.rollout", broken)
    with pytest.warns(UserWarning, match=r"seed 5 diverged by step .*mend offairl/PointMazeLeft"):
        result = run(tiny.change(reward="environment"), (3, 5, 7))
    assert list(result.diverged) == [5]
    assert {row.seed for row in result.rows} == {3, 7}
    monkeypatch.undo()
    whole = run(tiny.change(reward="environment"), (3, 5, 7))
    assert [row.returns for row in result.rows] == [r.returns for r in whole.rows if r.seed != 5]
