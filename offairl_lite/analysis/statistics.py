"""Statistics of a few runs: of their returns, and of which of them succeed.

Returns are summed up by interquartile means with bootstrap intervals (Agarwal et al. 2021),
successes by proportions with Wilson's interval and by exact tests of 2 × 2 tables.
"""

import math
from collections.abc import Callable
from itertools import combinations_with_replacement

import numpy as np
import scipy  # Its parts are imported when they are used: `stats` takes half a second.
from jaxtyping import Bool, Float, Int

RESAMPLES = 10_000  #: How many a bootstrap draws where there are too many to take them all.
TAIL = (1 - 0.95) / 2  #: At most this much lies beyond each end of an interval: 95 % in all.
ENUMERATED = 20_000  #: Up to so many distinct resamples all are taken: eight seeds, or five a side.


def interquartile_mean(values: Float[np.ndarray, "N ..."]) -> np.ndarray:
    """Return the mean of the middle half of the first axis (Agarwal et al. 2021)."""
    quarter = len(values) // 4
    return np.sort(values, axis=0)[quarter : len(values) - quarter].mean(axis=0)


def _resamples(*sizes: int) -> tuple[list[Int[np.ndarray, "R n"]], Float[np.ndarray, "R"] | None]:
    """Return resamples of samples of these sizes, as indices, and how probable each row is.

    They are all there are, or if these are too many, random ones; None: equally probable.
    """
    if math.prod(math.comb(2 * n - 1, n) for n in sizes) > ENUMERATED:
        rng = np.random.default_rng(0)
        return [rng.integers(n, size=(RESAMPLES, n)) for n in sizes], None
    rows = np.indices([math.comb(2 * n - 1, n) for n in sizes]).reshape(len(sizes), -1)
    drawn, probability = [], np.ones(rows.shape[1])
    for n, row in zip(sizes, rows, strict=True):
        each = np.array([*combinations_with_replacement(range(n), n)])
        counts = (each[..., None] == np.arange(n)).sum(1).tolist()
        ways = [math.factorial(n) / math.prod(map(math.factorial, count)) for count in counts]
        drawn.append(each[row])
        probability = probability * (np.array(ways) / n**n)[row]
    return drawn, probability


def _percentiles(
    drawn: Float[np.ndarray, "R ..."], probability: Float[np.ndarray, "R"] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends of the middle of a distribution; None: all values are equally likely."""
    low, high = (
        np.quantile(values, TAIL, axis=0, method="inverted_cdf", weights=probability)[()]
        for values in (drawn, -drawn)
    )
    return low, -high


def bootstrap_interval(values: Float[np.ndarray, "N ..."]) -> tuple[np.ndarray, np.ndarray]:
    """Return the interquartile mean's percentile bootstrap interval, of all resamples or 10,000."""
    (drawn,), probability = _resamples(len(values))
    return _percentiles(interquartile_mean(values[drawn.T]), probability)


def difference(
    one: Float[np.ndarray, "N"],
    other: Float[np.ndarray, "M"],
    statistic: Callable[[np.ndarray], np.ndarray] = interquartile_mean,
) -> tuple[float, float, float]:
    """Return by how much a statistic of some runs' returns is above that of others.

    With it come the ends of its percentile bootstrap interval; with a single seed it has none.
    """
    gain = float(statistic(one) - statistic(other))
    if min(len(one), len(other)) < 2:
        return gain, -np.inf, np.inf
    (x, y), probability = _resamples(len(one), len(other))
    drawn = statistic(one[x.T]) - statistic(other[y.T])
    low, high = _percentiles(drawn, probability)
    return gain, float(low), float(high)


def probability_of_improvement(
    one: Float[np.ndarray, "N"], other: Float[np.ndarray, "M"]
) -> tuple[float, float, float]:
    """Return how likely a run of `one` is better than a run of `other` (Agarwal et al. 2021).

    That is the share of pairs of seeds in which it is, equal ones counting half. With it come the
    ends of its percentile bootstrap interval over the seeds of both, which is too short where seeds
    are few and wins are sure. Of a single run nothing is known.
    """
    won = np.heaviside(np.subtract.outer(one, other), 0.5)
    if min(won.shape) < 2:
        return float(won.mean()), 0.0, 1.0
    (x, y), probability = _resamples(*won.shape)
    drawn = won[x[:, :, None], y[:, None, :]].mean((1, 2))
    low, high = _percentiles(drawn, probability)
    return float(won.mean()), float(low), float(high)


def success_rate(succeeded: Bool[np.ndarray, "N"]) -> tuple[float, float, float]:
    """Return the share of seeds that succeed, with the ends of Wilson's interval (Wilson 1927)."""
    test = scipy.stats.binomtest(int(np.sum(succeeded)), len(succeeded))
    interval = test.proportion_ci(0.95, method="wilson")
    return float(np.mean(succeeded)), float(interval.low), float(interval.high)


def compare_successes(
    one: Bool[np.ndarray, "N"], other: Bool[np.ndarray, "M"], paired: bool
) -> tuple[float, float]:
    """Return by how much the success rate of some seeds is above that of others, and a p-value.

    The p-value is two-sided. Seeds are paired if the i-th of both have something in common, such as
    a reward. Then the test is McNemar's exact one, which counts the pairs of which only one
    succeeds; if not, it is Fisher's exact one.
    """
    one, other = np.asarray(one, bool), np.asarray(other, bool)
    above = float(one.mean() - other.mean())
    if not paired:
        table = [[one.sum(), (~one).sum()], [other.sum(), (~other).sum()]]
        return above, float(scipy.stats.fisher_exact(table).pvalue)
    if len(one) != len(other):
        raise ValueError(f"{len(one)} and {len(other)} seeds are no pairs: give as many of both")
    only_one, only_other = int((one & ~other).sum()), int((other & ~one).sum())
    return above, float(scipy.stats.binomtest(only_one, max(only_one + only_other, 1)).pvalue)
