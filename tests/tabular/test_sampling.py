"""Demonstrations against occupancies."""

from dataclasses import replace

import numpy as np
import pytest
from processes import random_mdp, random_policy

from offairl_lite.tabular import (
    MDP,
    Trajectories,
    empirical_occupancy,
    maze,
    occupancy,
    sample,
)


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
    mdp = MDP(np.full((2, 3, 2), 0.5), np.array([1.0, 0.0]), 0.5)
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
    with pytest.raises(ValueError, match="have 3 actions, and the horizon is 4"):
        empirical_occupancy(timed, sample(timed, policy, 1, rng, 3))


def test_demonstrations_of_another_process_are_refused():
    grid = maze(5, "Left")
    start = int(grid.mdp.initial.argmax())
    good = np.array([[start, start + 5]]), np.array([[2]])
    empirical_occupancy(grid.mdp, Trajectories(*good))
    for states, actions, message in (
        ([[start, start + 6]], [[2]], f"demonstration 0, step 0: from state {start} by action 2"),
        ([[start, start], [0, 0]], [[0], [0]], "demonstration 1, step 0: .* or the start"),
    ):
        with pytest.raises(ValueError, match=message):
            empirical_occupancy(grid.mdp, Trajectories(np.array(states), np.array(actions)))


def test_a_sample_that_is_cut_short_begins_with_the_policy_s_first_steps():
    policy = np.eye(3)[np.broadcast_to([[0], [1], [2], [0]], (4, 6))]
    paths = sample(random_mdp(horizon=4), policy, 5, np.random.default_rng(0), 2)
    np.testing.assert_array_equal(paths.actions, np.tile([0, 1], (5, 1)))
