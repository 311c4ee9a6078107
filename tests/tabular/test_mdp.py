"""What is a process, and what is refused."""

import numpy as np
import pytest
from processes import dense, random_mdp, random_policy
from scipy.sparse import csr_array

from offairl_lite.tabular import (
    MDP,
    occupancy,
    soft_evaluation,
    soft_value_iteration,
)


def test_dense_and_sparse_transitions_are_the_same_process():
    one = random_mdp()
    two = MDP(one.transition.tocoo(), one.initial, 0.9)
    np.testing.assert_array_equal(dense(one), dense(two))
    assert (two.num_states, two.num_actions) == (6, 3)


def test_expectation_and_push_are_the_sums_they_are_called():
    mdp = random_mdp()
    value, flow = np.random.default_rng(0).normal(size=6), random_policy(mdp)
    np.testing.assert_allclose(mdp.expect(value), np.einsum("sat,t->sa", dense(mdp), value))
    np.testing.assert_allclose(mdp.push(flow), np.einsum("sat,sa->t", dense(mdp), flow))


def test_rewards_of_the_state_of_the_action_and_of_the_next_state():
    mdp = random_mdp()
    full = np.random.default_rng(0).normal(size=(6, 3, 6))
    expected = np.einsum("sat,sat->sa", dense(mdp), full)
    np.testing.assert_allclose(mdp.expected_reward(full), expected)
    np.testing.assert_array_equal(mdp.expected_reward(expected), expected)
    np.testing.assert_array_equal(mdp.expected_reward(full[:, 0, 0])[:, 2], full[:, 0, 0])


HALF = np.full((2, 3, 2), 0.5)
START_2 = np.array([1.0, 0.0])


def spoilt(where, value):
    transition = HALF.copy()
    transition[where] = value
    return transition


@pytest.mark.parametrize(
    ("transition", "initial", "discount", "horizon", "message"),
    [
        (spoilt((1, 2, 0), 0.4), START_2, 0.9, None, r"s=1, a=2.*sum to 1"),
        (spoilt((0, 1), [-0.5, 1.5]), START_2, 0.9, None, r"s=0, a=1.*at least 0"),
        (spoilt((0, 0, 0), np.nan), START_2, 0.9, None, "s=0, a=0"),
        (HALF[0], START_2, 0.9, None, r"\(S, A, S\).*not \(3, 2\)"),
        (HALF[..., :1], START_2, 0.9, None, r"not \(2, 3, 1\)"),
        (csr_array(np.full((3, 2), 0.5)), START_2, 0.9, None, r"\(S·A, S\), not \(3, 2\)"),
        (HALF, np.ones(3) / 3, 0.9, None, r"initial must be \(2,\)"),
        (HALF, np.ones(2), 0.9, None, r"initial.*sum to 1, not \[1\. 1"),
        (HALF, START_2, 0.9, 0, "horizon is 0; expected a whole number of at least 1, or None"),
        (HALF, START_2, 0.9, 2.5, "horizon is 2.5; expected a whole number of at least 1, or None"),
        (HALF, START_2, 1.1, 5, r"discount is 1\.1; expected a number in \[0, 1\]"),
        (HALF, START_2, 1.0, None, "without a horizon the discount must be below 1"),
    ],
)
def test_what_is_no_process_is_refused(transition, initial, discount, horizon, message):
    with pytest.raises(ValueError, match=message):
        MDP(transition, initial, discount, horizon)


@pytest.mark.parametrize("reward", [np.zeros(3), np.zeros((3, 6)), np.zeros((6, 6))])
def test_rewards_of_another_shape_are_refused(reward):
    with pytest.raises(ValueError, match=r"\(6,\), \(6, 3\) or \(6, 3, 6\), not"):
        soft_value_iteration(random_mdp(), reward)


def test_infinite_rewards_and_negative_temperatures_are_refused():
    with pytest.raises(ValueError, match="reward must be finite"):
        soft_value_iteration(random_mdp(), np.full(6, -np.inf))
    with pytest.raises(ValueError, match="temperature is -1; expected a number of at least 0"):
        soft_value_iteration(random_mdp(), np.zeros(6), -1)


def test_what_is_no_policy_is_refused():
    mdp, timed = random_mdp(), random_mdp(horizon=4)
    log_policy = soft_value_iteration(mdp, np.zeros(6)).log_policy
    with pytest.raises(ValueError, match="not their logarithms"):
        occupancy(mdp, log_policy)
    with pytest.raises(ValueError, match=r"is \(4, 6, 3\); expected one of \[\(6, 3\)\]"):
        occupancy(mdp, random_policy(timed, timed=True))
    with pytest.raises(ValueError, match=r"is \(3, 6\); expected one of \[\(6, 3\), \(4, 6, 3\)\]"):
        soft_evaluation(timed, np.full((3, 6), 1 / 6), np.zeros(6))
