"""Statistics of a few runs: interquartile means and bootstrap intervals (Agarwal et al. 2021)."""

from collections.abc import Callable

import numpy as np
import scipy.stats
from jaxtyping import Float


def interquartile_mean(values: Float[np.ndarray, "N ..."]) -> np.ndarray:
    """Return the mean of the middle half of the first axis (Agarwal et al. 2021)."""
    return scipy.stats.trim_mean(values, 0.25, axis=0)


def _percentiles(
    samples: tuple[np.ndarray, ...], statistic: Callable[..., np.ndarray], confidence: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the percentile bootstrap interval of a statistic over the samples' first axes."""
    interval = scipy.stats.bootstrap(
        samples,
        statistic,
        confidence_level=confidence,
        n_resamples=2_000,
        axis=0,
        method="percentile",
        rng=np.random.default_rng(0),
    ).confidence_interval
    return interval.low, interval.high


def bootstrap_interval(
    values: Float[np.ndarray, "N ..."], confidence: float = 0.95
) -> tuple[np.ndarray, np.ndarray]:
    """Return the percentile bootstrap interval of the interquartile mean over the first axis."""
    if len(values) < 2:
        return values[0], values[0]
    return _percentiles(
        (values,), lambda x, axis: scipy.stats.trim_mean(x, 0.25, axis=axis), confidence
    )


def interquartile_range(values: Float[np.ndarray, "N ..."]) -> np.ndarray:
    """Return how far the middle half of the first axis reaches."""
    return scipy.stats.iqr(values, axis=0)


def difference(
    one: Float[np.ndarray, "N"],
    other: Float[np.ndarray, "M"],
    statistic: Callable[[np.ndarray], np.ndarray] = interquartile_mean,
    confidence: float = 0.95,
) -> tuple[float, float, float]:
    """Return by how much a statistic of some runs is above that of others.

    Args:
        one: a return of each of N seeds.
        other: a return of each of M seeds.
        statistic: of the first axis: `interquartile_mean`, or `interquartile_range` for the spread.
        confidence: of the interval.

    Returns:
        The difference, and the ends of its percentile bootstrap interval over the seeds of both; a
        single seed tells nothing of others, and leaves the interval without ends.
    """

    def above(x, y, axis=0):
        return statistic(np.moveaxis(x, axis, 0)) - statistic(np.moveaxis(y, axis, 0))

    found = float(above(one, other))
    if min(len(one), len(other)) < 2:
        return found, -np.inf, np.inf
    low, high = _percentiles((one, other), above, confidence)
    return found, float(low), float(high)


def probability_of_improvement(
    one: Float[np.ndarray, "N"], other: Float[np.ndarray, "M"], confidence: float = 0.95
) -> tuple[float, float, float]:
    """Return how likely a run of `one` is better than a run of `other` (Agarwal et al. 2021).

    That is the share of pairs of seeds in which it is, equal ones counting half.

    Returns:
        The probability, and the ends of its percentile bootstrap interval over the seeds of both.
        It is too short where seeds are few and wins are sure. Of normal returns, where 95 % are
        asked for, it covers the truth in 94 to 84 cases of 100 with ten seeds a side, as the
        probability goes from 0.5 to 0.92; in 90 to 62 with five, and in 82 to 36 with three. Of a
        single run nothing is known: from 0 to 1.
    """
    found = float(np.heaviside(np.subtract.outer(one, other), 0.5).mean())
    if min(len(one), len(other)) < 2:
        return found, 0.0, 1.0

    def share(x, y, axis=-1):
        # The bootstrap moves the samples to the last axis, with resamples before it.
        x, y = np.expand_dims(x, -1), np.expand_dims(y, -2)
        return np.heaviside(x - y, 0.5).mean((-2, -1))

    low, high = _percentiles((one, other), share, confidence)
    return found, float(low), float(high)
