"""What the records say of the paper's claims: rules, answers, verdicts.

Each comparison gets one of the words of `WORDS` for an answer, and so does
each claim.
"""

from collections.abc import Iterable
from functools import cache
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from offairl_lite import experiments
from offairl_lite.analysis.statistics import (
    compare_successes,
    difference,
    interquartile_mean,
    probability_of_improvement,
    success_rate,
)
from offairl_lite.config import CORRECTED
from offairl_lite.core.loop import Run
from offairl_lite.runs import records
from offairl_lite.scale import Scale
from paper_claims import BAR, CLAIMS, RETURNS, Comparison
from paper_figures import record

RECORDS = Path(__file__).parent / "records"
SIZES: tuple[Scale, ...] = ("full", "demo")  # the larger one first
SEEDS, STEPS = len(experiments.SEEDS["full"]), CORRECTED.total_steps
RUNAWAY = 1000  # a temperature that has lost its target


# ---- Records ----


@cache
def recorded(run: str, size: Scale) -> Run | None:
    """Return the record of a run at one scale; None where there is none."""
    folder = RECORDS / record(run, size)
    if not any(folder.rglob("curve.csv")):  # Its seeds may be spread.
        return None
    found = records.read(folder)
    return found if len(found.steps) and whole(found).any() else None


def whole(found: Run) -> np.ndarray:
    """Return which seeds were evaluated every time."""
    return ~np.isnan(found.returns).any(1)


def largest(*runs: str, sizes: Iterable[Scale] = SIZES) -> Scale:
    """Return the first scale at which all of some runs are recorded.

    Raises:
        FileNotFoundError: there is none.
    """
    for size in sizes:
        if all(recorded(run, size) for run in runs):
            return size
    raise FileNotFoundError(f"no records of {runs} at one of {sizes}")


def networks(run: str, size: Scale) -> str:
    """Say how large the networks of a run are."""
    paper = (
        recorded(run, size).config.learner.hidden
        == CORRECTED.learner.hidden
    )
    return "paper-size networks" if paper else "small networks"


def described(run: str, size: Scale) -> str:
    """Say how large a recorded run is: networks, seeds, and steps."""
    found, protocol = recorded(run, size), experiments.configure(run, size)
    counts = (
        (
            whole(found).sum(),
            len(experiments.find(run.split("/")[0]).seeds[size]),
            "seeds",
        ),
        (found.steps[-1], protocol.total_steps, "steps"),
    )
    words = [
        f"{done:,} of {total:,} {unit}"
        if done < total
        else f"{done:,} {unit}"
        for done, total, unit in counts
    ]
    return ", ".join((networks(run, size), *words))


def runaways(found: Run) -> set[int]:
    """Return the seeds whose temperature was ever above `RUNAWAY`."""
    return {
        row.seed
        for row in found.rows
        if row.metrics.get("temperature", 0) > RUNAWAY
    }


# ---- Rules ----

CONFIRMED = "confirmed"
COULD_NOT_FAIL = "fits, but could not fail"
IN_PART = "confirmed in part"
UNDECIDED = "undecided"
CONFOUNDED = "confounded"
CONTRADICTED = "contradicted"
UNTESTED = "not yet tested"
WORDS = (
    CONFIRMED,
    COULD_NOT_FAIL,
    IN_PART,
    UNDECIDED,
    CONFOUNDED,
    CONTRADICTED,
    UNTESTED,
)


def support(
    question: str, low: float, high: float, margin: float = 0.0
) -> tuple[float, float]:
    """Turn an interval so that what is above 0 speaks for the claim."""
    if question == "fails":
        return -high, -low
    if question == "comparable":
        nearest, farthest = max(low, -high, 0), max(-low, high)
        return margin - farthest, margin - nearest
    return low, high


def seen(low: float, high: float) -> str:
    """Say what an interval looks like, however small the runs are."""
    if low > 0:
        return "as claimed"
    return "the opposite" if high < 0 else "unclear"


def verdict(told: str, tested: bool, confounded: bool = False) -> str:
    """Return the verdict on a comparison of which `seen` has told."""
    if not tested:
        return UNTESTED
    if told != "unclear" and confounded:
        return CONFOUNDED
    return {"as claimed": CONFIRMED, "the opposite": CONTRADICTED}.get(
        told, UNDECIDED
    )


def joined(verdicts: list[str], can_fail: bool = True) -> str:
    """Return the verdict on a claim from those on its comparisons."""
    for word in (CONTRADICTED, UNTESTED):
        if word in verdicts:
            return word
    if {*verdicts} == {CONFIRMED}:
        return CONFIRMED if can_fail else COULD_NOT_FAIL
    if CONFIRMED in verdicts:
        return IN_PART
    return CONFOUNDED if CONFOUNDED in verdicts else UNDECIDED


def drift(found: Run, until: int) -> tuple[float, tuple]:
    """Return where a record ends, and how far its last third moved.

    The change is a mean over the seeds, with its interval: later half of
    the evaluations less earlier half.
    """
    late = (found.steps > until * 2 / 3) & (found.steps <= until)
    returns, half = found.returns[whole(found)][:, late], late.sum() // 2
    if half < 2:
        return np.nan, (np.nan, -np.inf, np.inf)
    change = returns[:, -half:].mean(1) - returns[:, :half].mean(1)
    moved = difference(change, np.zeros(2), lambda x: x.mean(0))
    return float(interquartile_mean(returns[:, -1])), moved


def at_plateau(found: Run, until: int) -> bool:
    """Say whether a record has stopped moving by some step."""
    end, (_, low, high) = drift(found, until)
    return bool(max(-low, high) < abs(end) / 10)


def large_enough(found: list[Run], size: Scale) -> bool:
    """Say whether records are long enough, and of enough seeds."""
    return size == "full" and all(
        whole(each).sum() >= SEEDS
        and (
            each.steps[-1] >= STEPS or at_plateau(each, int(each.steps[-1]))
        )
        for each in found
    )


# ---- Answers ----

NOT_RUN = "not run"


class Found(NamedTuple):
    """What the records say of a comparison.

    `scale` is the size of the networks, and seeds × thousands of steps.
    `effect` is a difference of interquartile means with its interval, or
    the success rates, each with its own; `chance` the probability of
    improvement with its interval, or a p-value.
    """

    what: str
    scale: str
    seeds: int
    effect: tuple
    chance: tuple[float, float, float] | float | None
    seen: str
    verdict: str
    runaways: int


def compare(
    comparison: Comparison, sizes: Iterable[Scale] = SIZES
) -> Found:
    """Return what the largest records say of a comparison."""
    asked = (comparison.one, comparison.other)
    runs = [run for run in asked if isinstance(run, str)]
    try:
        size = largest(*runs, sizes=sizes)
    except FileNotFoundError:
        nothing = (np.nan,) * 3
        return Found(
            comparison.what, NOT_RUN, 0, nothing, None, "", UNTESTED, 0
        )
    found = [recorded(run, size) for run in runs]
    enough = large_enough(found, size)
    common = set.intersection(*(set(each.steps) for each in found))
    steps = [int(max(common))] * len(found)
    away = [runaways(each) for each in found]
    if comparison.question in RETURNS:
        if enough:
            steps = [int(each.steps[-1]) for each in found]
        ends = list(map(_at, found, steps))
        effect, chance, told = _of_returns(comparison, ends)
        confounded = any(away)
    else:
        # The seeds that all of the runs have are pairs.
        kept = [np.array(each.seeds)[whole(each)] for each in found]
        pairs = sorted(set.intersection(*map(set, kept)))
        ends = [_at(each, steps[0], pairs) for each in found]
        before = _at(found[0], found[0].steps[0], pairs) > BAR
        question, arrived = comparison.question, [end > BAR for end in ends]
        effect, chance, told = _of_successes(question, arrived, before)
        lost = [np.isin(pairs, list(each)) for each in away]
        confounded = _could_turn(question, told, arrived, lost, before)
    seeds = min(map(len, ends))
    length = " and ".join(f"{s / 1000:g}k" for s in dict.fromkeys(steps))
    return Found(
        comparison.what,
        f"{networks(runs[0], size).removesuffix(' networks')}, "
        f"{seeds} × {length}",
        seeds,
        effect,
        chance,
        told,
        verdict(told, enough, confounded),
        sum(map(len, away)),
    )


def _at(found: Run, step: int, seeds: list | None = None) -> np.ndarray:
    """Return the returns at a step, of some seeds or of all whole ones."""
    if seeds is None:
        seeds = np.array(found.seeds)[whole(found)]
    rows = [found.seeds.index(seed) for seed in seeds]
    return found.returns[rows, np.flatnonzero(found.steps == step)[0]]


def _of_returns(comparison: Comparison, ends: list[np.ndarray]) -> tuple:
    """Return effect, probability of improvement, and what is seen."""
    if len(ends) == 1:
        ends = [*ends, np.full(2, comparison.other)]
    effect = difference(*ends)
    margin = abs(float(interquartile_mean(ends[1]))) / 10
    low, high = support(comparison.question, *effect[1:], margin)
    several = min(map(len, ends)) > 1
    chance = probability_of_improvement(*ends) if several else None
    return effect, chance, seen(low, high)


def _of_successes(
    question: str, succeeded: list[np.ndarray], before: np.ndarray
) -> tuple:
    """Return success rates, p-value, and what is seen."""
    rates = tuple(map(success_rate, succeeded))
    if question == "varies":
        some = 0 < rates[0][0] < 1
        return rates, None, "as claimed" if some else "unclear"
    if question == "mostly fails":
        _, low, high = rates[0]
        return rates, None, seen(0.5 - high, 0.5 - low)
    pair = (succeeded[0], before if question == "arrives" else succeeded[1])
    above, p = compare_successes(*pair, paired=True)
    sign = np.sign(above) if p < 0.05 else 0
    return (
        rates,
        p,
        ("the opposite", "unclear", "as claimed")[int(sign) + 1],
    )


def _could_turn(
    question: str,
    told: str,
    arrived: list[np.ndarray],
    lost: list[np.ndarray],
    before: np.ndarray,
) -> bool:
    """Say whether the answer would change if lost seeds arrived or not."""
    return any(
        _of_successes(
            question,
            [
                np.where(away, value, seeds)
                for away, value, seeds in zip(
                    lost, values, arrived, strict=True
                )
            ],
            before,
        )[2]
        != told
        for values in product((False, True), repeat=len(arrived))
    )


def beside(n: int) -> list[Found]:
    """Return what is found beside a claim, as far as it is recorded."""
    return [
        compare(each)
        for each in CLAIMS[n].instead
        if any(
            recorded(each.one, size) and recorded(each.other, size)
            for size in SIZES
        )
    ]


def could_fail(comparison: Comparison) -> bool:
    """Say whether some result would give the opposite of what is claimed.

    About one run the worst is that nobody arrives. Then a claim that
    seeds arrive is contradicted only if enough had arrived before.
    """
    if comparison.question not in ("arrives", "varies"):
        return True
    run = comparison.one
    found = recorded(run, largest(run))
    assert found is not None
    before = _at(found, found.steps[0]) > BAR
    nobody = [np.zeros_like(before)]
    told = _of_successes(comparison.question, nobody, before)[2]
    return told == "the opposite"


def decided() -> tuple[dict[int, list[Found]], dict[int, str]]:
    """Return what is found of each claim, and the verdict on each."""
    found = {
        n: [*map(compare, claim.comparisons)] for n, claim in CLAIMS.items()
    }
    return found, {
        n: joined(
            [each.verdict for each in found[n]],
            any(map(could_fail, claim.comparisons)),
        )
        for n, claim in CLAIMS.items()
    }
