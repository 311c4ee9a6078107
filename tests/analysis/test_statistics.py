import numpy as np
import pytest
import scipy.stats

from offairl_lite.analysis.statistics import (
    bootstrap_interval,
    difference,
    interquartile_mean,
    interquartile_range,
    probability_of_improvement,
)


def test_the_interquartile_mean_is_that_of_the_middle_half():
    values = np.array([1e6, 3.0, 4.0, 2.0, 5.0, -1e6, 0.0, 9.0])
    assert interquartile_mean(values) == (2 + 3 + 4 + 5) / 4
    columns = np.stack([values, np.arange(8.0)], 1)
    np.testing.assert_array_equal(interquartile_mean(columns), [3.5, 3.5])


def test_the_interval_of_two_values_is_between_them():
    # A quarter of the resamples is twice the lower value, a quarter twice the higher.
    low, high = bootstrap_interval(np.array([[1.0, 7.0], [2.0, 5.0]]))
    assert (low.tolist(), high.tolist()) == ([1, 5], [2, 7])


def test_the_interval_of_equal_values_and_of_one_has_no_width():
    for values in (np.full((5, 1), 3.0), np.array([[3.0]])):
        low, high = bootstrap_interval(values)
        assert low == high == 3


def test_the_interval_is_that_of_resampled_means():
    values = np.random.default_rng(3).normal(size=(20, 1))
    rng = np.random.default_rng(5)
    means = scipy.stats.trim_mean(values[rng.integers(20, size=(20, 20_000)), 0], 0.25)
    low, high = bootstrap_interval(values, 0.9)
    np.testing.assert_allclose([low[0], high[0]], np.quantile(means, [0.05, 0.95]), atol=0.03)
    assert low < interquartile_mean(values) < high
    wider = bootstrap_interval(values, 0.99)
    assert wider[0] < low < high < wider[1]


def test_the_interquartile_range_is_the_reach_of_the_middle_half():
    values = np.array([4.0, 0.0, 3.0, 1.0, 2.0])
    assert interquartile_range(values) == 3 - 1
    columns = np.stack([values, 10 * values], 1)
    np.testing.assert_array_equal(interquartile_range(columns), [2, 20])


@pytest.mark.parametrize("statistic", [interquartile_mean, interquartile_range])
def test_a_difference_is_that_of_the_statistics_with_the_interval_of_resampled_ones(statistic):
    rng = np.random.default_rng(0)
    one, other = rng.normal(1, 3, size=12), rng.normal(size=20)
    found, low, high = difference(one, other, statistic, 0.9)
    assert found == pytest.approx(statistic(one) - statistic(other))
    drawn = [statistic(x[rng.integers(len(x), size=(20_000, len(x)))].T) for x in (one, other)]
    expected = np.quantile(drawn[0] - drawn[1], [0.05, 0.95])
    np.testing.assert_allclose([low, high], expected, atol=0.1)
    back = difference(other, one, statistic, 0.9)
    np.testing.assert_allclose(back, (-found, -high, -low), atol=0.1)


def test_a_difference_from_a_single_run_has_no_interval():
    one, other = np.array([3.0]), np.array([1.0, 2.0, 3.0, 4.0])
    assert difference(one, other) == (0.5, -np.inf, np.inf)
    assert difference(other, np.full(2, 2.5))[0] == 0


def test_probability_of_improvement_is_the_share_of_pairs_won():
    one, other = np.array([3.0, 5.0, 1.0]), np.array([2.0, 3.0])
    # Won: 3 over 2, 5 over both; 3 and 3 are equal.
    share, low, high = probability_of_improvement(one, other)
    assert share == pytest.approx(3.5 / 6)
    assert 0 <= low <= share <= high <= 1
    back, *_ = probability_of_improvement(other, one)
    assert back == pytest.approx(1 - share)
    assert probability_of_improvement(one + 9, other) == (1, 1, 1)
    assert probability_of_improvement(one[:1], other) == (0.75, 0, 1)


def test_the_interval_of_the_probability_covers_it():
    """Of 800 draws 92 % cover it, the interval being somewhat short; of these 60 it is 50."""
    true = scipy.stats.norm.cdf(1 / 2**0.5)
    covered = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        one, other = rng.normal(1, size=10), rng.normal(size=10)
        _, low, high = probability_of_improvement(one, other)
        covered += low <= true <= high
    assert covered >= 45
