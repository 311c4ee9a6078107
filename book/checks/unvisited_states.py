"""What the note on states that nobody visits says."""

import numpy as np

import rollouts
from checks import exact, recorded
from offairl_lite.envs.models import GOAL
from offairl_lite.tabular import occupancy, soft_value_iteration


@exact
def hardly_visited(demonstrated):
    """From the bottom some squares are visited less than 1e-40 times."""
    assert demonstrated.sum(1).min() < 1e-40


@exact
def visits_know_the_reward(solved, true_reward):
    """The exact visits give the reward to nine decimals."""
    assert np.ptp(solved - true_reward) < 1e-9


@exact
def exact_visits_from_the_bottom(exact_return, best_right, carried):
    """Exact visits from the bottom do better than the old policy, and worse
    than the true reward."""
    assert carried + 3 < exact_return < best_right - 0.4


@recorded
def as_good_as_exact_visits(sampled, exact_return, best_right):
    """More paths from the bottom would not help."""
    assert sampled["the bottom"].max() < best_right - 0.4
    assert np.abs(sampled["the bottom"] - exact_return).max() < 0.3


@exact
def exact_visits_from_everywhere(from_everywhere, best_right):
    """From everywhere, exact visits suffice."""
    assert from_everywhere > best_right - 0.2


@recorded
def starts_help(sampled, best_right):
    """From everywhere, three of five samples suffice."""
    assert np.sort(sampled["everywhere"])[2] > best_right - 0.2


@recorded
def starts_can_mislead(sampled, best_right):
    """One sample from everywhere is no better, and one is so bad that the
    average is lower."""
    bad, worse, *_ = np.sort(sampled["everywhere"])
    assert bad < best_right - 2
    assert worse < sampled["the bottom"].min()
    assert sampled["everywhere"].mean() < sampled["the bottom"].mean()


@recorded
def stays_under_the_barrier(right, alpha):
    """In the bad sample a square under the barrier is nearly as good as the
    star, and the policy stays there."""
    noisy = rollouts.read("unvisited_states")["worst reward"]
    stuck = soft_value_iteration(right.mdp, noisy, alpha).policy
    stays = occupancy(right.mdp, stuck).sum(1).argmax()
    at_star = noisy[np.linalg.norm(right.positions - GOAL, axis=1).argmin()]
    assert 0.2 < right.positions[stays][1] < 0.3  # the barrier is at 0.3
    assert 0.85 * at_star < noisy[stays] < at_star
