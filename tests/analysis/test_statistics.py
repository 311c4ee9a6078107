import itertools
import math
from functools import partial

import numpy as np
import pytest
import scipy.stats

from offairl_lite.analysis import statistics
from offairl_lite.analysis.statistics import (
    bootstrap_interval,
    compare_successes,
    difference,
    interquartile_mean,
    probability_of_improvement,
    success_rate,
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
    low, high = bootstrap_interval(values)
    np.testing.assert_allclose([low[0], high[0]], np.quantile(means, [0.025, 0.975]), atol=0.03)
    assert low < interquartile_mean(values) < high


interquartile_range = partial(scipy.stats.iqr, axis=0)


@pytest.mark.parametrize("statistic", [interquartile_mean, interquartile_range])
def test_a_difference_is_that_of_the_statistics_with_the_interval_of_resampled_ones(statistic):
    rng = np.random.default_rng(0)
    one, other = rng.normal(1, 3, size=12), rng.normal(size=20)
    found, low, high = difference(one, other, statistic)
    assert found == pytest.approx(statistic(one) - statistic(other))
    drawn = [statistic(x[rng.integers(len(x), size=(20_000, len(x)))].T) for x in (one, other)]
    expected = np.quantile(drawn[0] - drawn[1], [0.025, 0.975])
    np.testing.assert_allclose([low, high], expected, atol=0.1)
    back = difference(other, one, statistic)
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


def middle(values):
    """The ends of the middle 95 % of equally likely values."""
    values, beyond = np.sort(values), 0.025 * len(values)
    low = values[math.ceil(beyond - 1e-9) - 1]
    return low, values[len(values) - math.ceil(beyond - 1e-9)]


@pytest.mark.parametrize("n", [2, 3, 4, 5])
def test_the_interval_of_few_values_is_that_of_all_resamples(n):
    values = np.random.default_rng(n).normal(size=(n, 2))
    drawn = np.array([*itertools.product(range(n), repeat=n)])
    means = interquartile_mean(values[drawn.T])
    low, high = bootstrap_interval(values)
    np.testing.assert_allclose(np.transpose([low, high]), [middle(x) for x in means.T])


def resampled_pairs(one, other, found):
    """A statistic of every resample of one with every resample of the other."""
    return np.array(
        [
            found(np.array(x), np.array(y))
            for x in itertools.product(one, repeat=len(one))
            for y in itertools.product(other, repeat=len(other))
        ]
    )


def test_the_interval_of_a_difference_of_few_is_that_of_all_resamples():
    rng = np.random.default_rng(2)
    one, other = rng.normal(1, 2, size=4), rng.normal(size=3)
    for statistic in (interquartile_mean, interquartile_range):
        every = resampled_pairs(one, other, lambda x, y, of=statistic: of(x) - of(y))
        _, low, high = difference(one, other, statistic)
        np.testing.assert_allclose([low, high], middle(every))


def test_the_interval_of_a_probability_of_few_is_that_of_all_resamples():
    one, other = np.array([3.0, 5.0, 1.0, 2.5]), np.array([2.0, 3.0, 4.0])
    every = resampled_pairs(
        one, other, lambda x, y: np.heaviside(np.subtract.outer(x, y), 0.5).mean()
    )
    _, low, high = probability_of_improvement(one, other)
    np.testing.assert_allclose([low, high], middle(every.round(12)))


def test_random_resamples_come_close_to_all_of_them(monkeypatch):
    rng = np.random.default_rng(4)
    one, other = rng.normal(1, size=5), rng.normal(size=5)

    def intervals():
        low, high = bootstrap_interval(one)
        return [low, high, *difference(one, other), *probability_of_improvement(one, other)]

    all_of_them = intervals()
    monkeypatch.setattr(statistics, "ENUMERATED", 0)
    np.testing.assert_allclose(intervals(), all_of_them, atol=0.05)


@pytest.mark.parametrize(("successes", "n"), [(0, 10), (1, 3), (8, 10), (10, 10), (7, 50)])
def test_wilsons_interval_is_its_closed_form(successes, n):
    """The shares p at which the score test of p just does not refuse what was seen."""
    rate, low, high = success_rate(np.arange(n) < successes)
    assert rate == successes / n
    z = scipy.stats.norm.ppf(0.975)
    centre = (successes + z**2 / 2) / (n + z**2)
    half = z / (n + z**2) * (successes * (n - successes) / n + z**2 / 4) ** 0.5
    np.testing.assert_allclose([low, high], [centre - half, centre + half], atol=1e-12)
    for p in {low, high} - {0.0, 1.0}:
        if 1e-9 < p < 1 - 1e-9:
            assert (rate - p) ** 2 == pytest.approx(z**2 * p * (1 - p) / n)


def test_wilsons_interval_covers_the_truth_about_as_often_as_it_says():
    """On average over p it does; for the worst p it is short (Brown, Cai and DasGupta 2001)."""
    n, truth = 10, np.linspace(0.0005, 0.9995, 1000)
    ends = np.array([success_rate(np.arange(n) < k)[1:] for k in range(n + 1)])
    inside = (ends[:, :1] <= truth) & (truth <= ends[:, 1:])
    seen = scipy.stats.binom.pmf(np.arange(n + 1)[:, None], n, truth)
    covered = (seen * inside).sum(0)
    assert covered.mean() == pytest.approx(0.95, abs=0.01)
    assert 0.82 < covered.min() < 0.85


def test_a_success_rate_mirrors_that_of_failures():
    succeeded = np.array([True, False, True, True])
    rate, low, high = success_rate(succeeded)
    np.testing.assert_allclose(success_rate(~succeeded), [1 - rate, 1 - high, 1 - low])


def paired(both, only_one, only_other, neither):
    """Outcomes of pairs: so many in which both succeed, only one, only the other, neither."""
    counts = [both, only_one, only_other, neither]
    return np.repeat([True, True, False, False], counts), np.repeat(
        [True, False, True, False], counts
    )


def test_mcnemars_test_counts_the_pairs_of_which_one_succeeds():
    # Of n such pairs all are one's: twice a half to the power of n.
    assert compare_successes(*paired(4, 6, 0, 0), paired=True) == pytest.approx((0.6, 2 / 2**6))
    assert compare_successes(*paired(0, 0, 3, 7), paired=True) == pytest.approx((-0.3, 2 / 2**3))
    # What is the same in both says nothing.
    for both, neither in ((0, 0), (90, 5)):
        _, p = compare_successes(*paired(both, 5, 1, neither), paired=True)
        assert p == pytest.approx(2 * (1 + 6) / 2**6)
    assert compare_successes(*paired(3, 0, 0, 7), paired=True) == (0, 1)


def test_mcnemars_test_of_many_pairs_is_near_its_chi_squared():
    """Approval of a prime minister, twice (Agresti 2002, section 10.1): 794, 150, 86 and 570."""
    change, p = compare_successes(*paired(794, 150, 86, 570), paired=True)
    assert change == pytest.approx(64 / 1600)
    continuity_corrected = scipy.stats.chi2.sf((150 - 86 - 1) ** 2 / (150 + 86), 1)
    assert p == pytest.approx(continuity_corrected, rel=0.1)
    assert p < 1e-4


def test_fishers_test_of_the_lady_tasting_tea():
    """Three of four cups of each kind told rightly: one-sided 17/70, two-sided 34/70."""
    one, other = np.arange(4) < 3, np.arange(4) < 1
    assert compare_successes(one, other, paired=False) == pytest.approx((0.5, 34 / 70))
    # All right: 1/70, and as much for all wrong.
    assert compare_successes(one | True, other & False, paired=False)[1] == pytest.approx(2 / 70)


def test_the_exact_tests_find_a_difference_that_is_not_there_in_at_most_one_case_of_twenty():
    n = 6
    outcomes = [np.arange(n) < k for k in range(n + 1)]
    fisher = np.array([[compare_successes(x, y, False)[1] for y in outcomes] for x in outcomes])
    for p in (0.2, 0.5, 0.8):
        seen = scipy.stats.binom.pmf(np.arange(n + 1), n, p)
        assert seen @ (fisher < 0.05) @ seen <= 0.05
    mcnemar = [compare_successes(*paired(0, k, 12 - k, 0), True)[1] for k in range(13)]
    by_chance = scipy.stats.binom.pmf(np.arange(13), 12, 0.5)
    assert by_chance @ (np.array(mcnemar) < 0.05) <= 0.05


def test_only_as_many_seeds_of_both_are_pairs():
    for other in (np.ones(2, bool), np.ones(1, bool)):
        with pytest.raises(ValueError, match=r"3 and . seeds are no pairs"):
            compare_successes(np.ones(3, bool), other, paired=True)
    assert compare_successes(np.ones(3, bool), np.ones(3, bool), paired=True) == (0, 1)
