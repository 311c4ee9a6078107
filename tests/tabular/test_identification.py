"""What several worlds tell of one reward, against exact solutions and proofs."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
import scipy
from processes import dense, random_mdp, random_policy, random_reward

from offairl_lite import tabular
from offairl_lite.tabular import (
    MDP,
    apart,
    counted,
    hidden,
    sample,
    separation,
    shapings,
    shared_reward,
    soft_value_iteration,
)

CELLS = 6


def world(side="Left", **changes):
    return tabular.maze(CELLS, side, **changes).mdp


def failing(mdp, p, instead):
    """The command fails with probability p; then s' is drawn from `instead`, whatever it was."""
    return replace(mdp, transition=(1 - p) * dense(mdp) + p * instead[:, None])


def experts(worlds, reward, temperature=0.5):
    return [soft_value_iteration(mdp, reward, temperature).log_policy for mdp in worlds]


def error(learned, reward):
    return np.ptp(learned - np.asarray(reward).reshape(len(reward), -1))


def dimension_hidden(first, second):
    """The dimension of the pairs of potentials with equal shapings: an independent count."""
    return scipy.linalg.null_space(np.hstack([shapings(first), -shapings(second)]), 1e-10).shape[1]


def test_shapings_are_those_of_planning():
    mdp, potential = random_mdp(), np.random.default_rng(3).normal(size=6)
    made = (shapings(mdp) @ potential).reshape(6, 3)
    np.testing.assert_allclose(made, tabular.shaping(mdp, potential), atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_two_random_worlds_identify_any_reward_and_one_does_not(seed):
    worlds = [random_mdp(seed), random_mdp(seed + 10)]
    reward = random_reward(worlds[0], seed)
    assert separation(worlds[:1]).free == 6
    assert separation(worlds[:1]).distance == 0
    apart = separation(worlds)
    assert apart.free == dimension_hidden(*worlds) == 1
    assert 0 < apart.distance <= 1
    shown = experts(worlds, reward)
    assert error(shared_reward(worlds, shown, 0.5), reward) < 1e-9
    assert error(shared_reward(worlds[:1], shown[:1], 0.5), reward) > 0.1


def test_what_is_hidden_changes_no_expert_and_nothing_else_is_hidden():
    worlds = [world("Left"), world("Right")]
    basis = hidden(worlds)
    assert basis.shape == (CELLS**2, 5, separation(worlds).free)
    flat = basis.reshape(-1, basis.shape[2])
    np.testing.assert_allclose(flat.T @ flat, np.eye(flat.shape[1]), atol=1e-12)
    reward = random_reward(worlds[0])
    other = reward + basis @ np.random.default_rng(4).normal(size=flat.shape[1])
    for before, after in zip(experts(worlds, reward), experts(worlds, other), strict=True):
        np.testing.assert_allclose(before, after, atol=1e-8)
    constant = hidden([world(), world(slip=0.3)])
    assert constant.shape == (CELLS**2, 5, 1)
    assert np.ptp(constant) < 1e-6


def test_a_reward_that_is_learned_explains_every_expert():
    """Identified or not: the moved wall leaves much open, and still both policies come out."""
    worlds = [world("Left"), world("Right")]
    reward = random_reward(worlds[0])
    learned = shared_reward(worlds, experts(worlds, reward), 0.5)
    assert error(learned, reward) > 1
    for mdp, shown in zip(worlds, experts(worlds, reward), strict=True):
        same = soft_value_iteration(mdp, learned, 0.5).log_policy
        np.testing.assert_allclose(same, shown, atol=1e-8)


@pytest.mark.parametrize("slip", [0.0, 0.3])
def test_a_wall_that_moves_tells_of_its_two_sides_alone(slip):
    """Potentials must agree across the wall where it is in one world only, and nowhere else."""
    left, right = (dense(world(side))[:, 2].argmax(1) for side in ("Left", "Right"))
    moved = (left != right).sum()
    assert 0 < moved < CELLS
    pair = [world("Left", slip=slip), world("Right", slip=slip)]
    assert separation(pair) == (CELLS**2 - moved, 0)


@pytest.mark.parametrize("p", [0.05, 0.5, 1.0])
def test_controls_that_fail_identify_whatever_happens_instead(p):
    rng = np.random.default_rng(5)
    instead = rng.dirichlet(np.ones(CELLS**2), CELLS**2)
    assert separation([world(), failing(world(), p, instead)]).free == 1
    assert separation([world(), world(slip=p)]).free == 1


@pytest.mark.parametrize("second", ["failing", "impatient"])
def test_they_identify_no_more_than_one_world_does_of_rewards_of_the_state(second):
    """Neither where two groups of states are never linked by a choice."""
    p = np.zeros((6, 2, 6))
    p[:, 0, :3], p[:, 1, 3:] = 1 / 3, 1 / 3
    p[:3, 1], p[3:, 0] = p[:3, 0], p[3:, 1]  # no choice at all
    for_choices = p.copy()
    for_choices[0, 0], for_choices[0, 1] = np.eye(6)[0], np.eye(6)[1]
    for transition in (p, for_choices):
        mdp = MDP(transition, np.full(6, 1 / 6), 0.9)
        instead = random_policy(random_mdp(actions=6))
        other = failing(mdp, 0.4, instead) if second == "failing" else replace(mdp, discount=0.5)
        differences = (dense(mdp) - dense(mdp)[:, :1]).reshape(-1, 6)
        linked = 6 - np.linalg.matrix_rank(differences)
        assert separation([mdp, other]).free == linked > 1


def test_a_discount_a_wet_floor_and_the_first_discount_again():
    patient, hasty = world(), world(discount=0.5)
    assert separation([patient, hasty]).free == 1
    assert separation([patient, patient]).free == CELLS**2
    far = separation([patient, world(slip=0.9)]).distance
    near = separation([patient, world(slip=0.1)]).distance
    assert far > 5 * near > 0


@pytest.mark.parametrize("seed", range(3))
def test_noise_is_not_magnified_more_than_the_distance_says(seed):
    worlds = [world(), world(slip=0.3)]
    rng, reward = np.random.default_rng(seed), random_reward(worlds[0])
    shown = experts(worlds, reward)
    noise = rng.normal(0, 0.1, (2, *reward.shape))
    off = shared_reward(worlds, np.stack(shown) + noise, 0.5) - reward
    bound = 0.5 * np.linalg.norm(noise) / separation(worlds).distance
    assert np.linalg.norm(off - off.mean()) < bound


def test_the_bound_is_met_by_the_worst_noise():
    worlds = [random_mdp(0), random_mdp(1)]
    hides = [
        np.eye(18) - scipy.linalg.orth(x) @ scipy.linalg.orth(x).T for x in map(shapings, worlds)
    ]
    _, sizes, directions = np.linalg.svd(np.vstack(hides))
    assert sizes[-2] == pytest.approx(separation(worlds).distance)
    noise = [(part @ directions[-2]).reshape(6, 3) for part in hides]
    off = shared_reward(worlds, noise).ravel()
    assert np.linalg.norm(off - off.mean()) == pytest.approx(
        np.linalg.norm(noise) / separation(worlds).distance
    )


def test_rewards_of_the_state_weights_and_a_ridge():
    mdp = world()
    reward = np.random.default_rng(0).normal(size=CELLS**2)
    shown = experts([mdp], reward)
    assert error(shared_reward([mdp], shown, 0.5, of_state=True), reward) < 1e-9
    worlds = [mdp, world(slip=0.3)]
    shown = experts(worlds, reward)
    weights = [np.full((CELLS**2, 5), 2.0)] * 2
    light = shared_reward(worlds, shown, 0.5, weights, ridge=1e-7)
    assert error(light, reward) < 1e-3
    assert np.abs(shared_reward(worlds, shown, 0.5, weights, ridge=1e9)).max() < 1e-6
    # Where nothing is seen, nothing is learned, and the rest is as before.
    weights[0] = weights[1] = np.where(np.arange(CELLS**2)[:, None] == 0, 0.0, 2.0) * np.ones(5)
    assert np.abs(shared_reward(worlds, shown, 0.5, weights, ridge=1e-7)[0]).max() < 1e-9


def test_counted_transitions_are_those_of_the_process():
    mdp = replace(world(slip=0.3), initial=np.full(CELLS**2, 1 / CELLS**2))
    uniform = np.full((CELLS**2, 5), 0.2)
    paths = sample(mdp, uniform, 2_000, np.random.default_rng(0), 100)
    guess, taken = counted(paths, CELLS**2, 5, 0.97)
    assert taken.sum() == 200_000
    assert np.abs(dense(guess) - dense(mdp)).max() < 0.1
    few, taken = counted(
        tabular.Trajectories(paths.states[:1, :3], paths.actions[:1, :2]), 36, 5, 1 / 2
    )
    assert taken.sum() == 2
    np.testing.assert_array_equal(
        dense(few)[taken == 0], np.repeat(np.eye(36), 5, 0)[(taken == 0).ravel()]
    )


def test_worlds_that_differ_look_further_apart_than_halves_of_one():
    """The test for data of one's own: sampled transitions never agree exactly."""

    def observed(slip, seed):
        mdp = replace(world(slip=slip), initial=np.full(CELLS**2, 1 / CELLS**2))
        uniform = np.full((CELLS**2, 5), 0.2)
        paths = sample(mdp, uniform, 400, np.random.default_rng(seed), 100)
        return counted(paths, CELLS**2, 5, 0.97)

    (one, n), (half, m), (other, k) = observed(0.3, 0), observed(0.3, 1), observed(0.8, 2)
    floor = separation([one, half], (n > 0) & (m > 0)).distance
    apart = separation([one, other], (n > 0) & (k > 0)).distance
    true = separation([world(slip=0.3), world(slip=0.8)]).distance
    assert 0 < floor < apart / 3
    assert apart == pytest.approx(true, rel=0.2)


def test_worlds_of_other_sizes_are_refused():
    with pytest.raises(ValueError, match="the same states and actions"):
        separation([random_mdp(), random_mdp(states=5)])


class Line(NamedTuple):
    """Steps on a line from 0 to 1: an action in [-1, 1] moves by `strength` tenths of it."""

    obs: np.ndarray
    action: np.ndarray
    next_obs: np.ndarray


def line(strength, seed, count=20_000):
    rng = np.random.default_rng(seed)
    obs, action = rng.uniform(0, 1, (count, 1)), rng.uniform(-1, 1, (count, 1))
    return Line(obs, action, np.clip(obs + 0.1 * strength * action, 0, 1))


def test_recordings_tell_whether_worlds_differ():
    base, alike, weak, turned = line(1, 0), line(1, 1), line(0.5, 2), line(-1, 3)
    same, differ, opposite = (
        apart([base, other], num_states=15, num_actions=3) for other in (alike, weak, turned)
    )
    assert same.worlds < 1.5 * same.halves
    assert differ.worlds > 2 * same.worlds
    assert opposite.worlds > 5 * opposite.halves > 0


def test_recorded_distances_are_those_of_the_counted_worlds():
    """With as many clusters as places there is nothing to estimate but probabilities."""
    mdps = [random_mdp(), random_mdp(10)]
    recordings, rng = [], np.random.default_rng(0)
    for mdp in mdps:
        pairs = np.repeat(np.arange(18), 4_000)
        cumulated = mdp.transition.toarray().cumsum(1)
        to = (rng.random((len(pairs), 1)) > cumulated[pairs]).sum(1)
        mixed = rng.permutation(len(pairs))
        parts = (x[mixed, None] for x in (pairs // 3, pairs % 3, to))
        recordings.append(Line(*parts))
    found = apart(recordings, num_states=6, num_actions=3, discount=mdps[0].discount)
    assert found.worlds == pytest.approx(separation(mdps).distance, rel=0.1)
    assert found.halves < found.worlds / 5


def test_one_recording_is_not_compared():
    with pytest.raises(ValueError, match="recordings is 1"):
        apart([line(1, 0)])
