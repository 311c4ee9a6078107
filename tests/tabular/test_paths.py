"""Distributions over paths against enumerated paths."""

import numpy as np
import pytest
from processes import deterministic_mdp, paths_by_force, random_mdp, random_reward

from offairl_lite.tabular import (
    MDP,
    occupancy,
    path_messages,
    path_occupancy,
    soft_value_iteration,
)


def test_messages_are_sums_over_all_paths():
    mdp = random_mdp(states=3, actions=2, discount=1, horizon=4)
    reward = random_reward(mdp)
    total, visits = np.zeros(3), np.zeros((3, 3, 2))
    for path, weight in paths_by_force(mdp, reward, 0.7):
        first = path[0][0]
        total[first] += weight
        for s, a in path:
            visits[first, s, a] += weight
    messages = path_messages(mdp, reward, 0.7)
    np.testing.assert_allclose(messages.value[0], 0.7 * np.log(total), rtol=1e-12)
    expected = np.einsum("f,fsa->sa", mdp.initial / total, visits)
    np.testing.assert_allclose(path_occupancy(mdp, messages, 0.7), expected, rtol=1e-12)


def test_both_forms_agree_where_nothing_is_random():
    mdp = deterministic_mdp(horizon=12)
    reward = random_reward(mdp)
    causal, paths = soft_value_iteration(mdp, reward, 0.5), path_messages(mdp, reward, 0.5)
    for one, other in zip(causal, paths, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-10)
    visits = occupancy(mdp, causal.policy)
    np.testing.assert_allclose(path_occupancy(mdp, paths, 0.5), visits, rtol=1e-10)


def test_the_path_form_gambles():
    """Two ways to the same mean: in state 0, stay at 0, or draw ±x. 2008 hopes for +x."""
    x = 2.0
    transition = np.repeat(np.eye(3)[:, None], 2, axis=1)
    transition[0, 1] = [0, 0.5, 0.5]
    mdp = MDP(transition, np.eye(3)[0], 1.0, 2)
    reward = np.array([0, x, -x])
    causal, paths = soft_value_iteration(mdp, reward), path_messages(mdp, reward)
    assert causal.policy[0, 0, 1] == pytest.approx(0.5)
    assert paths.policy[0, 0, 1] == pytest.approx(np.cosh(x) / (1 + np.cosh(x)))
    # And so much of its probability as it hopes for the better draw:
    lucky = path_occupancy(mdp, paths)
    assert lucky[1].sum() / lucky[2].sum() == pytest.approx(np.exp(2 * x))


def test_messages_do_not_overflow():
    mdp = random_mdp(discount=1, horizon=50)
    messages = path_messages(mdp, 1e4 * random_reward(mdp), 0.1)
    np.testing.assert_allclose(messages.policy.sum(-1), 1, rtol=1e-9)
    assert path_occupancy(mdp, messages, 0.1).sum() == pytest.approx(50)


def test_paths_need_a_horizon_and_no_discount():
    for mdp in (random_mdp(), random_mdp(discount=0.9, horizon=3)):
        with pytest.raises(ValueError, match="needs a horizon and discount 1, not horizon"):
            path_messages(mdp, np.zeros(6))
