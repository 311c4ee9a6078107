"""What chapter 1 says."""

from dataclasses import replace

import numpy as np
from scipy.sparse import eye_array

from checks import demo_scale_only, exact
from offairl_lite import tabular
from offairl_lite.tabular import (
    log_likelihood,
    maxent_irl,
    occupancy,
    soft_evaluation,
    soft_value_iteration,
)


@exact
def copying_is_not_enough(best_left, best_right, carried):
    """Both mazes are equally hard for their experts, but the old policy is
    no good in the second."""
    assert abs(best_left - best_right) < 0.2
    assert carried < 1.5 * best_right


@exact
def shaping_changes_no_policy(mdp, shaped, same, expert, true_reward):
    """A shaped reward looks like noise and has the same best policy, with
    entropy and without."""
    assert np.allclose(same.policy, expert.policy, atol=1e-9)
    hard, hard_shaped = (
        soft_value_iteration(mdp, r, 0).policy
        for r in (true_reward, shaped)
    )
    assert np.allclose(hard, hard_shaped)
    assert np.ptp(shaped) > 2 * np.ptp(true_reward)


@exact
def soft_value_iteration_solves_it(
    soft_values, mdp, true_reward, alpha, expert
):
    """Soft value iteration finds the values and the policy of the
    expert."""
    value, policy = soft_values(mdp, true_reward, alpha)
    assert np.allclose(value, expert.value, atol=1e-9)
    assert np.allclose(policy, expert.policy, atol=1e-9)


@exact
def how_much_worse_another_policy_is(mdp, S, A, true_reward, alpha, expert):
    """Another policy loses its discounted divergence from the soft-optimal
    one, times the temperature."""
    uniform = np.full((S, A), 1 / A)
    worse = soft_evaluation(mdp, uniform, true_reward, alpha).value
    kl = (uniform * (np.log(uniform) - expert.log_policy)).sum(1)
    loss = mdp.initial @ (expert.value - worse)
    assert np.isclose(loss, alpha * occupancy(mdp, uniform).sum(1) @ kl)


@exact
def the_gradient_is_the_difference_of_visits(measured, predicted):
    """The slope of the log-likelihood is that of the gradient."""
    assert np.isclose(measured, predicted, rtol=1e-5)


@exact
def the_likelihood_is_the_packages(
    likelihood, mdp, guess, demonstrated, alpha
):
    """The likelihood and its gradient are those of the package, and the
    expert's log-likelihood under the policy."""
    by_hand = likelihood(mdp, guess, demonstrated, alpha)
    value, gradient = log_likelihood(mdp, guess, demonstrated, alpha)
    assert np.isclose(value, by_hand[0])
    assert np.allclose(gradient, by_hand[1], atol=1e-8)
    log_policy = soft_value_iteration(mdp, guess, alpha).log_policy
    assert np.isclose(value, (demonstrated * log_policy).sum())


@exact
def the_gradient_holds_for_pairs(mdp, guess, demonstrated, alpha, S, A):
    """The gradient is right for rewards of state and action as well."""
    direction = np.random.default_rng(1).normal(size=(S, A))
    up, down = (
        log_likelihood(mdp, guess[:, None] + d, demonstrated, alpha)[0]
        for d in (1e-6 * direction, -1e-6 * direction)
    )
    _, gradient = log_likelihood(mdp, guess, demonstrated, alpha)
    slope = (up - down) / 2e-6
    assert np.isclose(slope, (gradient * direction).sum(), rtol=1e-5)


@exact
def five_features_match(fit, mdp, found, features, counted, size):
    """The learned reward's policy matches the average features of the
    demonstrations, after fewer than thirty steps."""
    assert fit.mismatch < 1e-3
    matched = occupancy(mdp, found).sum(1) @ features
    assert np.allclose(matched, counted.sum(1) @ features, atol=1e-3)
    demo_scale_only(size)
    assert len(fit.history) - 1 < 30


@exact
def the_star_is_found(
    fit,
    size,
    value_of,
    found,
    found_right,
    left,
    right,
    best_left,
    best_right,
):
    """The optimiser finds the weight of the star, each corner gets less
    than a third, and the reward finds the other gap as well."""
    # In ten other samples, seeds 0-9: 0.94 to 1.05; the others up to 0.45.
    assert abs(fit.weights[4] - 1) < 0.3
    # Over seeds 0-9: -4.91 to -4.86 left, -5.00 to -4.83 right.
    assert value_of(found, left) > best_left - 0.2
    assert value_of(found_right, right) > best_right - 0.5
    demo_scale_only(size)
    assert np.abs(fit.weights[:4]).max() < fit.weights[4] / 3


@exact
def any_function_of_the_state(seen, state_fit):
    """The fit of one weight for each square misplaces less than 0.05 of 33
    discounted visits."""
    assert np.isclose(seen.sum(), 1 / (1 - 0.97))
    assert state_fit.mismatch < 0.05


@exact
def a_policy_tells_the_reward(r, small, free):
    """From the exact policy we recover the exact reward, up to a
    constant."""
    assert np.ptp(r - small.reward) < 1e-9
    assert free == 1


@exact
def errors_tell_what_errors_cost():
    """Maximum likelihood comes closer to the reward if the expert errs
    more often."""
    maze = tabular.maze(8, "Left", discount=0.9)
    mdp = replace(maze.mdp, initial=np.full(64, 1 / 64))
    errors = []
    for alpha in (0.05, 0.2):
        expert = soft_value_iteration(mdp, maze.reward, alpha)
        visits = occupancy(mdp, expert.policy)
        fit = maxent_irl(mdp, visits, eye_array(64), alpha, iterations=150)
        errors.append(np.ptp(fit.reward - maze.reward))
    assert errors[0] > 5 * errors[1]


@exact
def all_four_explain_the_expert(
    rewards, mdp, alpha, value_of, left, best_left
):
    """All four rewards explain the expert of the first maze."""
    for reward in rewards.values():
        home = soft_value_iteration(mdp, reward, alpha).policy
        assert value_of(home, left) > best_left - 0.1


@exact
def the_wall_moves(moved, value_of, right, best_right, carried):
    """When the wall moves the learned reward of the state finds the new
    gap; that of state and action does not, and log π gives the old
    policy."""
    assert value_of(moved["learned r(s)"], right) > best_right - 0.2
    assert value_of(moved["learned r(s, a)"], right) < best_right - 0.3
    assert np.isclose(value_of(moved["α log π"], right), carried)


@exact
def nothing_warns_in_the_first_maze(curves, size):
    """In the first maze both rewards get better all the way, with the same
    returns."""
    demo_scale_only(size)
    state, pair = (curves[name, "first"][1] for name in ("r(s)", "r(s, a)"))
    assert np.abs(state - pair).max() < 0.1
    assert np.diff(pair).min() > -0.01


@exact
def the_second_maze_tells_them_apart(curves, size, best_right, carried):
    """In the second maze the reward of the state gets better at every
    step where we look; that of state and action is useful for a while,
    and then becomes the old policy."""
    demo_scale_only(size)
    kept, lost = (curves[name, "second"][1] for name in ("r(s)", "r(s, a)"))
    assert np.diff(kept).min() > -0.01
    assert kept[-1] > best_right - 0.1
    assert max(lost) > best_right - 0.7
    assert lost[-1] < carried + 0.2


@exact
def the_optimiser_learns_no_shaping(
    linear_system,
    mdp,
    S,
    A,
    alpha,
    expert,
    pair_fit,
    left,
    right,
    value_of,
    best_left,
    carried,
):
    """The rewards that the optimiser passes contain no shaping, and come
    nearer and nearer to the explanation of least norm, which gives the
    expert in the old maze and the old policy in the new one."""
    basis, _ = np.linalg.qr(linear_system(mdp)[:, S:])  # of the shapings
    answers = alpha * expert.log_policy.ravel()
    least_norm = answers - basis @ (basis.T @ answers)
    met = np.array(pair_fit.history)
    assert np.abs(met @ basis).max() < 1e-8
    off = np.linalg.norm(met - least_norm, axis=1)
    assert (np.diff(off[::20]) < 0).all()
    for maze, expected in ((left, best_left), (right, carried)):
        planned = soft_value_iteration(
            maze.mdp, least_norm.reshape(S, A), alpha
        )
        assert abs(value_of(planned.policy, maze) - expected) < 0.05


@exact
def no_better_than_the_old_policy(moved, value_of, right, carried, size):
    """The learned reward of state and action ends with a policy that
    returns −9.6, no better than the old one."""
    demo_scale_only(size)
    assert abs(carried + 9.6) < 0.05
    learned = value_of(moved["learned r(s, a)"], right)
    assert f"{learned:.1f}" == "-9.6"


@exact
def a_move_that_can_be_repeated(
    mdp, right, expert, expert_right, pair_fit, S, A, size
):
    """In the second maze the expert's move through the old gap can be
    repeated, and from about step 100 on it pays more than staying at the
    star."""
    demo_scale_only(size)
    star, trap = (
        occupancy(right.mdp, policy).sum(1).argmax()
        for policy in (expert_right.policy, expert.policy)
    )
    met = np.array(pair_fit.history).reshape(-1, S, A)
    pays = met[:, [star, trap]]
    action = pays[-1, 1].argmax()
    assert (pays[150:, 1].argmax(1) == action).all()
    move = trap * A + action  # it leads on, and no more
    assert mdp.transition.toarray()[move].argmax() != trap
    assert right.mdp.transition.toarray()[move].argmax() == trap
    more = pays[:, 1].max(1) > pays[:, 0].max(1)
    assert 85 < more.argmax() < 120
    assert more[120:].all()


@exact
def a_chess_board_changes_no_behaviour(
    linear_system, torus, with_rest, moving, n
):
    """Without links between the colours a second direction is free: a
    chess board changes no behaviour."""
    for process, directions in ((torus, 2), (with_rest, 1)):
        rank = np.linalg.matrix_rank(linear_system(process))
        assert 2 * n**2 - rank == directions
    one, other = moving
    assert np.allclose(one.policy, other.policy, atol=1e-9)


@exact
def resting_shows_the_chess_board(rested):
    """Once the agent may rest, it rests on one square, or with the chess
    board on fifty."""
    resting = [int((s.policy[:, 4] > 0.5).sum()) for s in rested]
    assert resting == [1, 50]


@exact
def the_hard_maximum_has_another_gradient(slope, claimed, gap):
    """With the hard maximum the difference of visits is not the gradient,
    and even at the true reward more than 4 of 33 visits are misplaced."""
    assert abs(slope - claimed) > 0.1 * abs(slope)
    assert gap > 8  # it counts them twice


@exact
def the_order_of_the_loops(visits, P, small):
    """With the states in the outer loop fewer than 4 of 30 visits are
    left."""
    start = small.mdp.initial
    assert np.isclose(visits(P, start, 30, time_first=True), 30)
    assert visits(P, start, 30, time_first=False) < 4


@exact
def two_discounts(counted, frequency, theirs, wrong, near):
    """Plain counts do not match discounted visits: they are nearly all
    near the star, the others a good half, and the weights run into the
    tens of thousands."""
    ours = np.abs(counted / counted.sum() - theirs).sum()
    assert np.abs(frequency - theirs).sum() > 3 * ours
    assert np.abs(wrong.weights).max() > 10_000
    assert frequency[near].sum() > 0.9
    assert 0.5 < theirs[near].sum() < 0.7


@exact
def shaping_with_an_end(by_time):
    """If episodes end, shaping changes the policy near the end."""
    assert by_time[0] < 0.01 < 0.2 < by_time[-1]
