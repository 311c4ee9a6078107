"""The EPIC distance: blind to shift, scale and shaping, and to nothing else."""

import math

import pytest
import torch

from offairl_lite.analysis.epic import Transitions, canonical, distances, pearson_distance
from offairl_lite.core.rng import Rng

STATES, ACTIONS, GAMMA = 4, 3, 0.9


def table_reward(table):
    """R(s, a, s') of a table (S, A, S), for states and actions given as numbers."""
    return lambda s, a, t: table[s[:, 0], a[:, 0], t[:, 0]]


def everywhere():
    """Each (s, a, s') once: the uniform distribution, of which no sample is needed."""
    grid = torch.cartesian_prod(*map(torch.arange, (STATES, ACTIONS, STATES)))
    return Transitions(*(column.unsqueeze(1) for column in grid.unbind(1)))


def random_table(seed):
    return Rng([seed]).normal(STATES, ACTIONS, STATES)[0].double()


def shaping(potential):
    return (GAMMA * potential.view(1, 1, -1) - potential.view(-1, 1, 1)).expand(
        STATES, ACTIONS, STATES
    )


def distance(one, other, transitions=None, samples=None):
    transitions, samples = transitions or everywhere(), samples or everywhere()
    return distances([one, other], transitions, samples, GAMMA)[0, 1].item()


def test_on_all_transitions_shift_scale_and_shaping_make_no_difference():
    table, potential = random_table(0), random_table(1)[:, 0, 0]
    other = 3 * table + 5 + shaping(potential)
    assert distance(table_reward(table), table_reward(other)) < 1e-12
    # Nor does the canonical form itself know of the shaping, but for a constant.
    forms = [canonical(table_reward(t), everywhere(), everywhere(), GAMMA) for t in
             (table, table + shaping(potential))]  # fmt: skip
    torch.testing.assert_close(*forms)


def test_the_canonical_form_is_that_of_the_definition():
    table = random_table(2)
    mean_from = table.mean((1, 2))
    expected = (
        table + GAMMA * mean_from.view(1, 1, -1) - mean_from.view(-1, 1, 1) - GAMMA * table.mean()
    )
    ours = canonical(table_reward(table), everywhere(), everywhere(), GAMMA)
    torch.testing.assert_close(ours, expected.flatten())


def test_shaping_makes_no_difference_whatever_the_samples():
    streams = Rng([3])
    transitions, samples = (
        Transitions(*(streams.normal(n, k)[0].double() for k in (2, 1, 2))) for n in (30, 7)
    )

    def reward(obs, action, next_obs):
        return obs[:, 0] * action[:, 0] - next_obs[:, 1].square()

    def shaped(obs, action, next_obs):
        potential = [x.sin().sum(-1) for x in (obs, next_obs)]
        return 2 * reward(obs, action, next_obs) + GAMMA * potential[1] - potential[0] - 4

    assert distance(reward, shaped, transitions, samples) < 1e-12


def test_it_is_a_distance():
    rewards = [table_reward(random_table(seed)) for seed in range(4)]
    matrix = distances(rewards, everywhere(), everywhere(), GAMMA)
    torch.testing.assert_close(matrix, matrix.T)
    assert (matrix.diagonal() < 1e-12).all()
    assert (matrix <= 1).all()
    assert (matrix.unsqueeze(1) <= matrix.unsqueeze(2) + matrix.unsqueeze(0) + 1e-12).all()
    assert matrix[0, 1] > 0.3


@pytest.mark.parametrize(
    ("x", "y", "expected"),
    [
        ([1, 2, 3], [10, 20, 30], 0.0),
        ([1, 2, 3], [3, 2, 1], 1.0),
        ([1, -1, 1, -1], [1, 1, -1, -1], math.sqrt(1 / 2)),  # uncorrelated
        ([1, 2, 3], [1, 3, 2], math.sqrt((1 - 0.5) / 2)),
    ],
)
def test_known_distances(x, y, expected):
    x, y = (torch.tensor(z, dtype=torch.float64) for z in (x, y))
    assert pearson_distance(x, y).item() == pytest.approx(expected, abs=1e-12)


def test_a_reward_and_its_negative_are_as_far_apart_as_can_be():
    table = random_table(4)
    assert distance(table_reward(table), table_reward(-table)) == pytest.approx(1)


def test_two_states_by_hand():
    """R₁ pays in state 1, R₂ for action 1, each apart from the other: no correlation."""
    states, actions = torch.zeros(STATES, ACTIONS, STATES), torch.zeros(STATES, ACTIONS, STATES)
    states[1], actions[:, 1] = 1.0, 1.0
    assert distance(table_reward(states.double()), table_reward(actions.double())) == pytest.approx(
        math.sqrt(1 / 2)
    )


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("size", [0.0, 1.0, 1000.0])
def test_what_is_nothing_but_shaping_has_no_distance(size, dtype):
    table = shaping(size * random_table(1)[:, 0, 0]).to(dtype)
    with pytest.raises(ValueError, match="reward 1 is nothing but shaping"):
        distance(table_reward(random_table(0).to(dtype)), table_reward(table))


def test_a_constant_has_no_correlation():
    with pytest.raises(ValueError, match="the same for all transitions"):
        pearson_distance(torch.ones(3), torch.arange(3.0))


def test_the_canonical_form_takes_its_means_over_the_samples():
    table = random_table(2)
    samples = Transitions(*(torch.tensor([x]).T for x in ([0, 3], [2, 1], [1, 1])))
    mean_from = (table[:, 2, 1] + table[:, 1, 1]) / 2
    mean = (table[0, 2, 1] + table[3, 1, 1]) / 2
    expected = table + GAMMA * mean_from.view(1, 1, -1) - mean_from.view(-1, 1, 1) - GAMMA * mean
    ours = canonical(table_reward(table), everywhere(), samples, GAMMA)
    torch.testing.assert_close(ours, expected.flatten())
