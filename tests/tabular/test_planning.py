"""Soft optimality against long sums, finite differences and other policies."""

from dataclasses import replace

import numpy as np
import pytest
from processes import dense, deterministic_mdp, random_mdp, random_policy, random_reward
from scipy.special import entr, logsumexp

from offairl_lite import tabular
from offairl_lite.core.discriminator import shaped_reward
from offairl_lite.tabular import (
    MDP,
    occupancy,
    soft_evaluation,
    soft_value_iteration,
)


@pytest.mark.parametrize("temperature", [0.0, 0.02, 1.0, 30.0])
@pytest.mark.parametrize("discount", [0.0, 0.9, 0.99])
def test_the_solution_is_the_fixed_point_of_value_iteration(temperature, discount):
    mdp, reward = random_mdp(discount=discount), random_reward(random_mdp())
    solution = soft_value_iteration(mdp, reward, temperature)
    value = np.zeros(6)
    for _ in range(2 if discount == 0 else int(40 / (1 - discount))):
        q = reward + discount * mdp.expect(value)
        soft = temperature * logsumexp(q / temperature, axis=1) if temperature else None
        value = soft if temperature else q.max(1)
    np.testing.assert_allclose(solution.value, value, rtol=1e-10)
    np.testing.assert_allclose(solution.action_value, q, rtol=1e-10)
    np.testing.assert_allclose(solution.policy.sum(1), 1, rtol=1e-12)


@pytest.mark.parametrize("horizon", [None, 5])
def test_no_policy_has_more_return_and_entropy_than_the_soft_optimum(horizon):
    mdp, reward = random_mdp(horizon=horizon), random_reward(random_mdp())
    best = soft_value_iteration(mdp, reward, 0.5)
    # It is worth what it says it is worth,
    same = soft_evaluation(mdp, best.policy, reward, 0.5)
    np.testing.assert_allclose(same.value, best.value, rtol=1e-10)
    np.testing.assert_allclose(same.action_value, best.action_value, rtol=1e-10)
    # and others are worth less in every state, at every time.
    for seed in range(50):
        other = 0.9 * best.policy + 0.1 * random_policy(mdp, seed, timed=horizon is not None)
        assert (soft_evaluation(mdp, other, reward, 0.5).value < best.value - 1e-6).all()


@pytest.mark.parametrize("horizon", [None, 60])
def test_the_hard_optimum_is_the_limit_of_the_soft_values(horizon):
    mdp, reward = random_mdp(horizon=horizon), random_reward(random_mdp())
    hard = soft_value_iteration(mdp, reward, 0)
    soft = soft_value_iteration(mdp, reward, 1e-4)
    np.testing.assert_allclose(soft.value, hard.value, atol=1e-4 * np.log(3) / 0.1)
    np.testing.assert_allclose(soft.policy, hard.policy, atol=1e-8)


def test_the_hard_optimum_chooses_uniformly_among_the_best():
    mdp = MDP(np.full((2, 3, 2), 0.5), np.array([1.0, 0.0]), 0.9)
    policy = soft_value_iteration(mdp, np.array([[1.0, 1.0, 0.0], [0.0, 2.0, 0.0]]), 0).policy
    np.testing.assert_array_equal(policy, [[0.5, 0.5, 0], [0, 1, 0]])


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e9])
def test_the_unit_of_the_reward_makes_no_difference(size):
    mdp, reward = random_mdp(discount=0.99), random_reward(random_mdp())
    one = soft_value_iteration(mdp, reward, 0.1)
    other = soft_value_iteration(mdp, size * reward, size * 0.1)
    np.testing.assert_allclose(other.log_policy, one.log_policy, rtol=1e-9)
    np.testing.assert_allclose(other.value, size * one.value, rtol=1e-9)


def test_probabilities_stay_exact_where_values_are_large():
    mdp, reward = random_mdp(discount=0.999), random_reward(random_mdp())
    solution = soft_value_iteration(mdp, 1e3 + reward, 1e-3)
    np.testing.assert_allclose(solution.policy.sum(1), 1, rtol=1e-14)


@pytest.mark.parametrize("timed", [False, True])
@pytest.mark.parametrize("temperature", [0.0, 0.7])
def test_evaluation_is_the_sum_over_time(timed, temperature):
    mdp = random_mdp(horizon=8 if timed else None)
    policy, reward = random_policy(mdp, timed=timed), random_reward(mdp)
    steps = policy if timed else np.broadcast_to(policy, (500, 6, 3))
    gain = (steps * reward + temperature * entr(steps)).sum(-1)
    weight, expected = np.eye(6), 0
    for t in range(len(steps)):
        expected = expected + weight @ gain[t]
        weight = 0.9 * weight @ np.einsum("sa,sat->st", steps[t], dense(mdp))
    value = soft_evaluation(mdp, policy, reward, temperature).value
    np.testing.assert_allclose(value[0] if timed else value, expected, rtol=1e-10)


def test_evaluation_knows_that_impossible_actions_have_no_entropy():
    mdp = random_mdp()
    policy = np.eye(3)[[0, 1, 2, 0, 1, 2]]
    soft = soft_evaluation(mdp, policy, random_reward(mdp), 1.0)
    hard = soft_evaluation(mdp, policy, random_reward(mdp), 0.0)
    np.testing.assert_array_equal(soft.value, hard.value)
    np.testing.assert_array_equal(soft.policy, policy)


@pytest.mark.parametrize("horizon", [None, 7])
def test_shaping_moves_the_values_by_the_potential_and_no_policy(horizon):
    """With a horizon the potential at the end is paid, too; it has to be the same everywhere."""
    mdp, reward = random_mdp(horizon=horizon), random_reward(random_mdp())
    potential = np.random.default_rng(5).normal(size=6) * 10
    shaped = reward + tabular.shaping(mdp, potential)
    plain, other = (soft_value_iteration(mdp, r, 0.3) for r in (reward, shaped))
    if horizon is None:
        np.testing.assert_allclose(other.policy, plain.policy, rtol=1e-9)
        np.testing.assert_allclose(other.value, plain.value - potential, rtol=1e-9)
    else:
        assert np.abs(other.policy[-1] - plain.policy[-1]).max() > 0.1


@pytest.mark.parametrize("timed", [False, True])
def test_occupancy_is_the_discounted_sum_of_visits(timed):
    mdp = random_mdp(horizon=8 if timed else None)
    policy = random_policy(mdp, timed=timed)
    steps = policy if timed else np.broadcast_to(policy, (500, 6, 3))
    states, expected = mdp.initial, 0
    for t in range(len(steps)):
        expected = expected + 0.9**t * states[:, None] * steps[t]
        states = np.einsum("s,sa,sat->t", states, steps[t], dense(mdp))
    np.testing.assert_allclose(occupancy(mdp, policy), expected, rtol=1e-10)
    reward = random_reward(mdp)
    assert tabular.policy_return(mdp, policy, reward) == pytest.approx((expected * reward).sum())


@pytest.mark.parametrize("horizon", [None, 6])
def test_the_gradient_of_the_soft_value_is_the_occupancy(horizon):
    mdp, reward = random_mdp(horizon=horizon), random_reward(random_mdp())

    def start_value(r):
        value = soft_value_iteration(mdp, r, 0.4).value
        return mdp.initial @ (value if horizon is None else value[0])

    visits = occupancy(mdp, soft_value_iteration(mdp, reward, 0.4).policy)
    for s, a in np.ndindex(6, 3):
        step = np.zeros((6, 3))
        step[s, a] = 1e-5
        slope = (start_value(reward + step) - start_value(reward - step)) / 2e-5
        assert slope == pytest.approx(visits[s, a], abs=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_the_best_discriminator_contains_the_reward_of_the_state_whoever_the_policy_is(seed):
    """log π + log ρ_E/ρ_π = r + γ V(s') - V(s), with r that of the expert but for log d_E/d_π."""
    mdp = replace(deterministic_mdp(horizon=1), discount=0.9, horizon=None)
    reward = np.random.default_rng(seed).normal(size=mdp.num_states)
    expert, policy = soft_value_iteration(mdp, reward), random_policy(mdp, seed)
    seen, visits = occupancy(mdp, expert.policy), occupancy(mdp, policy)
    ratio = np.log(seen.sum(1) / visits.sum(1))
    f = shaped_reward(
        (reward + ratio)[:, None], expert.value[:, None], mdp.expect(expert.value), mdp.discount
    )
    np.testing.assert_allclose(np.log(policy) + np.log(seen / visits), f, atol=1e-10)
