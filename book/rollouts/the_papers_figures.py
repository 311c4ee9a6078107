"""Of the note on the paper's figures: how often few seeds decide."""

from typing import Any

import numpy as np

from offairl_lite.analysis.statistics import difference

PAIRS = 1_000
"""Number of pairs of runs of each kind."""


def record() -> dict[str, Any]:
    """Return how often the interval of a difference excludes 0.

    For a number of seeds that is the share of pairs of runs whose returns
    are normal, without a difference and with one of one standard
    deviation.
    """
    return {
        "excluded": {
            str(n): [share(n, shift) for shift in (0.0, 1.0)]
            for n in (3, 5, 10)
        }
    }


def share(n: int, shift: float) -> float:
    """Return the share for n seeds and one difference."""
    rng, excluded = np.random.default_rng(0), 0
    for _ in range(PAIRS):
        one, other = rng.normal(shift, 1, n), rng.normal(0, 1, n)
        _, low, high = difference(one, other)
        excluded += not low <= 0 <= high
    return excluded / PAIRS
