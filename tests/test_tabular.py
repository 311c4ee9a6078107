"""Tabular MDPs against brute force: enumerated paths, finite differences, long sums."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array, eye_array
from scipy.special import entr, logsumexp

from offairl_lite import envs, tabular
from offairl_lite.core.discriminator import shaped_reward
from offairl_lite.envs.models import GOAL, START, walls
from offairl_lite.tabular import (
    MDP,
    MOVES,
    Trajectories,
    empirical_occupancy,
    log_likelihood,
    maxent_irl,
    maze,
    occupancy,
    path_messages,
    path_occupancy,
    policy_return,
    sample,
    soft_evaluation,
    soft_value_iteration,
)


def random_mdp(seed=0, states=6, actions=3, discount=0.9, horizon=None):
    rng = np.random.default_rng(seed)
    transition = rng.dirichlet(np.full(states, 0.3), (states, actions))
    return MDP(transition, rng.dirichlet(np.ones(states)), discount, horizon)


def random_policy(mdp, seed=1, timed=False):
    time = (mdp.horizon,) if timed else ()
    rng = np.random.default_rng(seed)
    return rng.dirichlet(np.ones(mdp.num_actions), (*time, mdp.num_states))


def random_reward(mdp, seed=2):
    return np.random.default_rng(seed).normal(size=(mdp.num_states, mdp.num_actions))


def dense(mdp):
    return mdp.transition.toarray().reshape(mdp.num_states, mdp.num_actions, -1)


# The process


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
        (spoilt((1, 2, 0), 0.4), START_2, 0.9, None, r"s=1, a=2.*sum 0\.9 \(1 of 6 rows"),
        (spoilt((0, 1), [-0.5, 1.5]), START_2, 0.9, None, r"s=0, a=1.*least is -0\.5"),
        (spoilt((0, 0, 0), np.nan), START_2, 0.9, None, r"s=0, a=0.*nan"),
        (HALF[0], START_2, 0.9, None, r"array \(S, A, S\).*not an array \(3, 2\)"),
        (HALF[..., :1], START_2, 0.9, None, r"not an array \(2, 3, 1\)"),
        (csr_array(np.full((3, 2), 0.5)), START_2, 0.9, None, r"S·A rows.*not \(3, 2\)"),
        (HALF, np.ones(3) / 3, 0.9, None, r"initial must have shape \(2,\), not \(3,\)"),
        (HALF, np.ones(2), 0.9, None, r"initial.*sum 2"),
        (HALF, START_2, 0.9, 0, "horizon must be a whole number.*not 0"),
        (HALF, START_2, 0.9, 2.5, "horizon must be a whole number.*not 2.5"),
        (HALF, START_2, 1.1, 5, "discount must be from 0 to 1, not 1.1"),
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
    with pytest.raises(ValueError, match="temperature must be at least 0 and finite, not -1"):
        soft_value_iteration(random_mdp(), np.zeros(6), -1)


def test_what_is_no_policy_is_refused():
    mdp, timed = random_mdp(), random_mdp(horizon=4)
    log_policy = soft_value_iteration(mdp, np.zeros(6)).log_policy
    with pytest.raises(ValueError, match=r"sums are from -3\.29.*not their logarithms"):
        occupancy(mdp, log_policy)
    with pytest.raises(ValueError, match=r"shape \(6, 3\), not \(4, 6, 3\)"):
        occupancy(mdp, random_policy(timed, timed=True))
    with pytest.raises(ValueError, match=r"shape \(6, 3\) or \(4, 6, 3\), not \(3, 6\)"):
        soft_evaluation(timed, np.full((3, 6), 1 / 6), np.zeros(6))


# Soft optimality


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
    mdp = MDP(HALF, START_2, 0.9)
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


# Occupancies


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


# Demonstrations


@pytest.mark.parametrize("timed", [False, True])
def test_demonstrations_visit_what_the_occupancy_says(timed):
    mdp = random_mdp(discount=0.8, horizon=6 if timed else None)
    policy = random_policy(mdp, timed=timed)
    paths = sample(mdp, policy, 20_000, np.random.default_rng(0), None if timed else 40)
    assert paths.states.shape == (20_000, 7 if timed else 41)
    assert paths.actions.shape == (20_000, 6 if timed else 40)
    # Over rng seeds 0-9 the largest error is from 0.008 to 0.024.
    expected = occupancy(mdp, policy)
    np.testing.assert_allclose(empirical_occupancy(mdp, paths), expected, atol=0.04)


def test_sampling_belongs_to_its_generator():
    mdp = random_mdp(horizon=5)
    one, two, other = (
        sample(mdp, random_policy(mdp), 10, np.random.default_rng(seed)) for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(one.states, two.states)
    assert (one.states != other.states).any()


def test_counts_are_discounted_and_averaged():
    mdp = MDP(HALF, START_2, 0.5)
    paths = Trajectories(np.array([[0, 1, 1], [0, 0, 1]]), np.array([[2, 0], [2, 1]]))
    expected = np.array([[0, 0.25, 1.0], [0.25, 0, 0]])
    np.testing.assert_allclose(empirical_occupancy(replace(mdp, horizon=2), paths), expected)
    # What comes after the end is as what was seen.
    np.testing.assert_allclose(empirical_occupancy(mdp, paths), 4 / 3 * expected)


def test_lengths_that_cannot_be_are_refused():
    mdp, timed = random_mdp(), random_mdp(horizon=4)
    rng, policy = np.random.default_rng(0), random_policy(mdp)
    for process, length in ((mdp, None), (mdp, 0), (timed, 5)):
        with pytest.raises(ValueError, match=f"length must be .* not {length}"):
            sample(process, policy, 1, rng, length)
    with pytest.raises(ValueError, match=r"3 actions .* the horizon 4; make the two equal"):
        empirical_occupancy(timed, sample(timed, policy, 1, rng, 3))


def test_demonstrations_of_another_process_are_refused():
    grid = maze(5, "Left")
    start = int(grid.mdp.initial.argmax())
    good = np.array([[start, start + 5]]), np.array([[2]])
    empirical_occupancy(grid.mdp, Trajectories(*good))
    for states, actions, message in (
        ([[start, start + 6]], [[2]], f"demonstration 0 .* step 0 from state {start} by action 2 "),
        ([[start, start], [0, 0]], [[0], [0]], "demonstration 1 starts in state 0, whose"),
        ([[start, 25]], [[2]], "state must be from 0 to 24, but they are from 2 to 25"),
        ([[start, start]], [[-1]], "action must be from 0 to 4, but they are from -1 to -1"),
        ([[start, start]], [[0, 0]], r"got \(1, 2\) and \(1, 2\)"),
    ):
        with pytest.raises(ValueError, match=message):
            empirical_occupancy(grid.mdp, Trajectories(np.array(states), np.array(actions)))


# Distributions over paths


def paths_by_force(mdp, reward, temperature):
    """Every path from every first state, with its weight exp(R/α) Π p, by enumeration."""
    p, states = dense(mdp), range(mdp.num_states)
    pairs = list(itertools.product(states, range(mdp.num_actions)))
    for path in itertools.product(pairs, repeat=mdp.horizon):
        for last in states:
            following = [s for s, _ in path[1:]] + [last]
            chance = np.prod([p[s, a, t] for (s, a), t in zip(path, following, strict=True)])
            yield path, chance * np.exp(sum(reward[s, a] for s, a in path) / temperature)


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


def deterministic_mdp(horizon):
    goes_to = np.random.default_rng(7).integers(6, size=(6, 3))
    return MDP(np.eye(6)[goes_to], np.full(6, 1 / 6), 1.0, horizon)


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


# Likelihood


PROCESSES = {
    "no end": (random_mdp(), "causal"),
    "horizon": (random_mdp(horizon=6), "causal"),
    "paths": (random_mdp(discount=1, horizon=6), "paths"),
}


@pytest.mark.parametrize(("mdp", "form"), PROCESSES.values(), ids=PROCESSES)
def test_the_gradient_of_the_likelihood_is_a_difference_of_occupancies(mdp, form):
    reward = random_reward(mdp)
    demonstrated = occupancy(mdp, random_policy(mdp))
    _, gradient = log_likelihood(mdp, reward, demonstrated, 0.6, form)
    for s, a in np.ndindex(6, 3):
        step = np.zeros((6, 3))
        step[s, a] = 1e-5
        up, down = (
            log_likelihood(mdp, reward + d, demonstrated, 0.6, form)[0] for d in (step, -step)
        )
        assert (up - down) / 2e-5 == pytest.approx(gradient[s, a], abs=1e-6)


def test_the_causal_likelihood_is_that_of_the_actions():
    mdp, reward = random_mdp(), random_reward(random_mdp())
    demonstrated = occupancy(mdp, random_policy(mdp))
    value, _ = log_likelihood(mdp, reward, demonstrated, 0.6)
    log_policy = soft_value_iteration(mdp, reward, 0.6).log_policy
    assert value == pytest.approx((demonstrated * log_policy).sum())


def test_the_path_likelihood_is_that_of_the_paths():
    mdp = random_mdp(states=3, actions=2, discount=1, horizon=4)
    reward, demonstrated = random_reward(mdp), occupancy(mdp, random_policy(mdp))
    value, _ = log_likelihood(mdp, reward, demonstrated, 0.7, "paths")
    total = np.zeros(3)
    for path, weight in paths_by_force(mdp, reward, 0.7):
        total[path[0][0]] += weight
    expected = (demonstrated * reward).sum() / 0.7 - mdp.initial @ np.log(total)
    assert value == pytest.approx(expected)


# Maximum entropy IRL


@pytest.mark.parametrize(("mdp", "form"), PROCESSES.values(), ids=PROCESSES)
@pytest.mark.parametrize("of_state", [True, False])
def test_features_of_sampled_demonstrations_are_matched(mdp, form, of_state):
    rng = np.random.default_rng(0)
    features = rng.normal(size=(6 if of_state else 18, 3))
    paths = sample(mdp, random_policy(mdp), 200, rng, mdp.horizon or 30)
    demonstrated = empirical_occupancy(mdp, paths)
    fit = maxent_irl(mdp, demonstrated, features, 0.5, form)
    if form == "paths":
        visits = path_occupancy(mdp, path_messages(mdp, fit.reward, 0.5), 0.5)
    else:
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
    yield (mdp, -demonstrated, features), {}, "demonstrated must hold visits"
    yield (mdp, 0.9 * demonstrated, features), {}, "adds up to 9, but every occupancy .* to 10; "
    yield (mdp, demonstrated, eye_array(3)), {}, r"\(6, K\) or \(18, K\), not \(3, 3\)"
    yield (mdp, demonstrated, features, 0), {}, "temperature must be above 0 and finite, not 0"
    yield (mdp, demonstrated, features), {"penalty": -1}, "penalty must be at least 0, not -1"
    yield (mdp, demonstrated, features), {"form": "path"}, "'causal' or 'paths', not 'path'"
    yield (mdp, demonstrated, features), {"form": "paths"}, "needs a horizon and discount 1"


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
        with pytest.raises(ValueError, match=r"visit 1 states .* the first of them 3"):
            learn(0, 3)
    with pytest.raises(ValueError, match="no policy reaches"):
        learn(0, 4)


# The maze


@pytest.mark.parametrize("side", ["Left", "Right"])
@pytest.mark.parametrize("cells", [3, 4, 7, 10, 21, 30])
def test_moves_stop_at_walls_and_nowhere_else(cells, side):
    grid = maze(cells, side)
    size, barrier = 0.7 / cells, walls(side)[4]
    goes_to = dense(grid.mdp).argmax(-1)
    assert set(np.unique(grid.mdp.transition.data)) == {1.0}
    for s, x in enumerate(grid.positions):
        for a, move in enumerate(MOVES):
            y = x + size * move
            inside = ((y > -0.1) & (y < 0.6)).all()
            crossing = (x[1] - 0.3) * (y[1] - 0.3) < 0
            blocked = crossing and barrier[0, 0] < x[0] < barrier[1, 0]
            arrival = x if blocked or not inside else y
            np.testing.assert_allclose(grid.positions[goes_to[s, a]], arrival, atol=1e-12)


@pytest.mark.parametrize("side", ["Left", "Right"])
def test_the_grid_is_the_maze_of_the_simulator(side):
    """Start, target and reward are those of the environment, and the best way is by the gap."""
    grid = maze(30, side)
    start = grid.mdp.initial.argmax()
    np.testing.assert_allclose(grid.positions[start], START, atol=0.012)
    env = envs.make(f"offairl/PointMaze{side}-v0", 1, 0)
    env.reset()
    reward = env.step(np.zeros((1, 2)))[1][0]
    assert grid.reward[start] == pytest.approx(reward, abs=0.02)
    np.testing.assert_allclose(grid.positions[grid.reward.argmax()], GOAL, atol=0.012)

    best = occupancy(grid.mdp, soft_value_iteration(grid.mdp, grid.reward, 0).policy)
    assert best.sum(1).argmax() == grid.reward.argmax()
    under = np.abs(grid.positions[:, 1] - 0.29) < 0.011
    gap = grid.positions[under & (best[:, 2] > 0), 0]
    assert len(gap)
    assert (gap > 0.4).all() if side == "Left" else (gap < 0.2).all()


def test_the_barrier_is_all_that_differs_between_the_sides():
    left, right = maze(20, "Left"), maze(20, "Right")
    np.testing.assert_array_equal(left.positions, right.positions)
    np.testing.assert_array_equal(left.reward, right.reward)
    changed = np.flatnonzero((dense(left.mdp) != dense(right.mdp)).any((1, 2)))
    assert len(changed)
    assert (np.abs(left.positions[changed, 1] - 0.3) < 0.035).all()


def test_slipping_replaces_the_action_by_any():
    sure, slippery = dense(maze(6, "Left").mdp), dense(maze(6, "Left", slip=0.4).mdp)
    expected = 0.6 * sure + 0.4 * sure.mean(1, keepdims=True)
    np.testing.assert_allclose(slippery, expected, atol=1e-15)


def test_mazes_that_cannot_be_are_refused():
    with pytest.raises(ValueError, match="at least 3 cells a side, not 2"):
        maze(2, "Left")
    with pytest.raises(ValueError, match=r"slip is a probability, not 1\.5"):
        maze(10, "Left", slip=1.5)
    for side in ("Up", None):
        with pytest.raises(ValueError, match=f"side must be 'Left' or 'Right', not {side!r}"):
            maze(10, side)


# The best discriminator


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
