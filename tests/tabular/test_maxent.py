"""Likelihoods and learned rewards."""

from dataclasses import replace

import numpy as np
import pytest
from processes import random_mdp, random_policy, random_reward
from scipy.sparse import eye_array

from offairl_lite.tabular import (
    MDP,
    empirical_occupancy,
    log_likelihood,
    maxent_irl,
    maze,
    occupancy,
    policy_return,
    sample,
    soft_value_iteration,
)

PROCESSES = {"no end": random_mdp(), "horizon": random_mdp(horizon=6)}


@pytest.mark.parametrize("mdp", PROCESSES.values(), ids=PROCESSES)
def test_the_gradient_of_the_likelihood_is_a_difference_of_occupancies(mdp):
    reward = random_reward(mdp)
    demonstrated = occupancy(mdp, random_policy(mdp))
    _, gradient = log_likelihood(mdp, reward, demonstrated, 0.6)
    for s, a in np.ndindex(6, 3):
        step = np.zeros((6, 3))
        step[s, a] = 1e-5
        up, down = (log_likelihood(mdp, reward + d, demonstrated, 0.6)[0] for d in (step, -step))
        assert (up - down) / 2e-5 == pytest.approx(gradient[s, a], abs=1e-6)


def test_the_causal_likelihood_is_that_of_the_actions():
    mdp, reward = random_mdp(), random_reward(random_mdp())
    demonstrated = occupancy(mdp, random_policy(mdp))
    value, _ = log_likelihood(mdp, reward, demonstrated, 0.6)
    log_policy = soft_value_iteration(mdp, reward, 0.6).log_policy
    assert value == pytest.approx((demonstrated * log_policy).sum())


@pytest.mark.parametrize("mdp", PROCESSES.values(), ids=PROCESSES)
@pytest.mark.parametrize("of_state", [True, False])
def test_features_of_sampled_demonstrations_are_matched(mdp, of_state):
    rng = np.random.default_rng(0)
    features = rng.normal(size=(6 if of_state else 18, 3))
    paths = sample(mdp, random_policy(mdp), 200, rng, mdp.horizon or 30)
    demonstrated = empirical_occupancy(mdp, paths)
    fit = maxent_irl(mdp, demonstrated, features, 0.5)
    visits = occupancy(mdp, soft_value_iteration(mdp, fit.reward, 0.5).policy)
    difference = demonstrated - visits
    gap = features.T @ (difference.sum(1) if of_state else difference.ravel())
    np.testing.assert_allclose(gap, 0, atol=1e-6)
    assert fit.mismatch == pytest.approx(np.abs(gap).max(), abs=1e-9)
    np.testing.assert_allclose(fit.reward.ravel(), features @ fit.weights)


def test_the_fit_tells_its_history():
    mdp = random_mdp()
    demonstrated = occupancy(mdp, random_policy(mdp))
    fit = maxent_irl(mdp, demonstrated, eye_array(6), penalty=0.01)
    assert len(fit.history) == len(fit.log_likelihood)
    np.testing.assert_array_equal(fit.history[0], 0)
    np.testing.assert_array_equal(fit.history[-1], fit.weights)
    for weights, value in zip(fit.history, fit.log_likelihood, strict=True):
        assert log_likelihood(mdp, weights, demonstrated)[0] == pytest.approx(value)
    penalised = fit.log_likelihood - 0.005 * (fit.history**2).sum(1)
    assert (np.diff(penalised) > -1e-9).all()
    # At the maximum the gradient is that of the penalty.
    gradient = log_likelihood(mdp, fit.reward, demonstrated)[1].sum(1)
    np.testing.assert_allclose(gradient, 0.01 * fit.weights, atol=1e-6)


def test_dense_and_sparse_features_are_the_same():
    mdp = random_mdp()
    demonstrated = occupancy(mdp, random_policy(mdp))
    one, other = (maxent_irl(mdp, demonstrated, f, penalty=0.1) for f in (eye_array(6), np.eye(6)))
    np.testing.assert_allclose(one.reward, other.reward, atol=1e-8)


@pytest.mark.parametrize("slip", [0.0, 0.2])
def test_a_reward_of_the_state_is_recovered_up_to_a_constant(slip):
    grid = maze(6, "Left", slip, discount=0.9)
    everywhere = replace(grid.mdp, initial=np.full(36, 1 / 36))
    expert = soft_value_iteration(everywhere, grid.reward, 0.2)
    fit = maxent_irl(everywhere, occupancy(everywhere, expert.policy), eye_array(36), 0.2)
    difference = fit.reward - grid.reward
    np.testing.assert_allclose(difference, difference.mean(), atol=1e-4)


def test_what_was_learned_outlives_the_wall_only_as_a_reward_of_the_state():
    left, right = (maze(10, side) for side in ("Left", "Right"))
    everywhere = replace(left.mdp, initial=np.full(100, 0.01))
    expert = soft_value_iteration(everywhere, left.reward, 0.05)
    fit = maxent_irl(everywhere, occupancy(everywhere, expert.policy), eye_array(100), 0.05)

    def end(grid, reward):
        policy = soft_value_iteration(grid.mdp, reward, 0.05).policy
        return policy_return(grid.mdp, policy, grid.reward)

    by_heart = 0.05 * expert.log_policy
    # Both explain the demonstrations.
    assert end(left, fit.reward) == pytest.approx(end(left, left.reward), abs=0.01)
    assert end(left, by_heart) == pytest.approx(end(left, left.reward), abs=1e-9)
    # One of them finds the new way; the other brings the old policy back, wherever it is.
    assert end(right, fit.reward) == pytest.approx(end(right, right.reward), abs=0.02)
    carried = policy_return(right.mdp, expert.policy, right.reward)
    assert end(right, by_heart) == pytest.approx(carried, abs=1e-9)
    assert carried < 2 * end(right, right.reward)


def refused():
    mdp = random_mdp()
    demonstrated, features = occupancy(mdp, random_policy(mdp)), eye_array(6)
    yield (mdp, demonstrated.T, features), {}, r"demonstrated must have shape \(6, 3\), not \(3, 6"
    yield (mdp, 0.9 * demonstrated, features), {}, "adds up to 9, every occupancy .* to 10: "
    yield (mdp, demonstrated, eye_array(3)), {}, r"\(6, K\) or \(18, K\), not \(3, 3\)"
    yield (mdp, demonstrated, features, 0), {}, "temperature is 0; expected a number above 0"
    yield (
        (mdp, demonstrated, features),
        {"penalty": -1},
        "penalty is -1; expected a number of at least 0",
    )


@pytest.mark.parametrize(("arguments", "options", "message"), list(refused()))
def test_what_cannot_be_learned_from_is_refused(arguments, options, message):
    with pytest.raises(ValueError, match=message):
        maxent_irl(*arguments, **options)


@pytest.mark.parametrize("horizon", [None, 3])
def test_unreachable_demonstrations_are_refused(horizon):
    """A corridor of four states; with three actions no policy is seen to act at its end."""
    walk = np.eye(5)[[[0, 1], [1, 2], [2, 3], [3, 3], [4, 4]]]
    mdp = MDP(walk, np.eye(5)[0], 0.9, horizon)
    mass = 10 if horizon is None else 1 + 0.9 + 0.81

    def learn(*visited):
        demonstrated = np.zeros((5, 2))
        demonstrated[list(visited)] = mass / (2 * len(visited))
        maxent_irl(mdp, demonstrated, eye_array(5), iterations=1)

    learn(0, 1, 2)
    if horizon is None:
        learn(0, 3)
    else:
        with pytest.raises(ValueError, match=r"no policy reaches: \[3\]"):
            learn(0, 3)
    with pytest.raises(ValueError, match="no policy reaches"):
        learn(0, 4)


def test_a_fit_stops_after_as_many_steps_as_it_is_told():
    mdp = random_mdp()
    demonstrated = occupancy(mdp, random_policy(mdp))
    few, many = (maxent_irl(mdp, demonstrated, eye_array(6), iterations=n) for n in (2, 500))
    assert len(few.history) == 3 < len(many.history)
    np.testing.assert_array_equal(few.history, many.history[:3])
