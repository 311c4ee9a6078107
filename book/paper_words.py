"""Verdicts in words: the cells of the tables that tell them."""

import numpy as np

from offairl_lite.runs import records
from paper_claims import CLAIMS
from paper_figures import record
from paper_verdicts import (
    CONFOUNDED,
    RECORDS,
    SEEDS,
    STEPS,
    UNDECIDED,
    Found,
    large_enough,
    recorded,
    runaways,
)


def number(x: float, digits: int = 0) -> str:
    """Write a number, with a proper minus, and 0 without one."""
    return f"{round(x, digits) + 0.0:,.{digits}f}".replace("-", "−")


def interval(numbers: tuple, digits: int) -> str:
    """Write a number with its interval, or a dash if there is none."""
    if np.isnan(numbers[0]):
        return "–"
    middle, *ends = (number(x, digits) for x in numbers)
    if np.isinf(numbers[1]):
        return f"{middle} [?]"
    return f"{middle} [{', '.join(ends)}]"


def rate(found: tuple[float, float, float], seeds: int) -> str:
    """Write how many seeds arrive, with the interval of their share."""
    share, low, high = found
    interval = f"[{100 * low:.0f} %, {100 * high:.0f} %]"
    return f"{share * seeds:.0f} of {seeds} {interval}"


def of_successes(found: Found) -> bool:
    """Say whether a comparison is of seeds that arrive."""
    return isinstance(found.effect[0], tuple)


def cells(found: Found) -> tuple[str, str]:
    """Write the effect of a comparison, and how sure it is.

    That is the probability of improvement, or a p-value.
    """
    p = found.chance
    if of_successes(found):
        first, *other = (rate(each, found.seeds) for each in found.effect)
        if other:
            shares = (share for share, *_ in found.effect)
            one, two = (f"{share * found.seeds:.0f}" for share in shares)
            first = f"{one} against {two}"
        return first, "–" if p is None else f"{p:.2g}"
    digits = 0 if max(map(abs, found.effect)) > 100 else 1
    return interval(found.effect, digits), "–" if p is None else number(
        p[0], 2
    )


def missing(n: int) -> list[str]:
    """Return the runs that a claim needs and that are not large enough."""
    runs = dict.fromkeys(
        run
        for each in CLAIMS[n].comparisons
        for run in (each.one, each.other)
        if isinstance(run, str)
    )
    return [
        run
        for run in runs
        if not recorded(run, "full")
        or not large_enough([recorded(run, "full")], "full")
    ]


def hours() -> float:
    """Return how long the paper's seeds and steps take on one core.

    That is measured: runs of the recipe and of DAC on robots, with
    networks of the paper's size.
    """
    paces = [
        records.read_json(path)["wall_s"]
        / len(records.read(path.parent).rows)
        / records.read(path.parent).config.schedule.eval_every
        for path in RECORDS.glob("locomotion-full/*/run.json")
    ]
    return float(np.mean(paces)) * SEEDS * STEPS / 3600


def needed(n: int, found: list[Found]) -> str:
    """Say what would decide a claim that is not decided."""
    wanted = []
    if runs := missing(n):
        wanted.append(f"{len(runs)} runs, {hours() * len(runs):.0f} hours")
    if runs := out_of_bounds(n, found):
        took = sum(
            records.read_json(RECORDS / record(run, "full") / "run.json")[
                "wall_s"
            ]
            for run in runs
        )
        wanted.append(
            f"{len(runs)} run{'s' * (len(runs) > 1)} with a bounded "
            f"temperature, {took / 60:.0f} minutes"
        )
    if any(each.verdict == UNDECIDED for each in found):
        wanted.append("more seeds")
    return "; ".join(wanted) or "–"


def out_of_bounds(n: int, found: list[Found]) -> list[str]:
    """Return the runs of a claim whose temperature ran away, and counts."""
    runs = [
        run
        for each, answer in zip(CLAIMS[n].comparisons, found, strict=True)
        for run in (each.one, each.other)
        if isinstance(run, str) and answer.verdict == CONFOUNDED
    ]
    return [
        run
        for run in dict.fromkeys(runs)
        if runaways(recorded(run, "full"))
    ]
