"""The paper's eight claims, and what the records say of each.

A claim is a list of comparisons. Each asks one question of one or two
runs, about the returns of their seeds or about which seeds succeed, and
gets one of the words of `WORDS` for an answer.
"""

from collections.abc import Iterable
from functools import cache
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
from paper_figures import PAPER, record

RECORDS = Path(__file__).parent / "records"
SIZES: tuple[Scale, ...] = ("full", "demo")  # the larger one first
SEEDS, STEPS = len(experiments.SEEDS["full"]), CORRECTED.total_steps

BAR = -14  # nobody returns more on the maze without passing the barrier
HALF = PAPER["DisabledAnt"][0] / 2
RUNAWAY = 1000  # a temperature that has lost its target


# ---- Records ----


@cache
def recorded(run: str, size: Scale) -> Run | None:
    """Return the record of a run at one scale; None where there is none."""
    folder = RECORDS / record(run, size)
    if not (folder / "curve.csv").is_file():
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
    paper = recorded(run, size).config.hidden == CORRECTED.hidden
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


def runaways(found: Run) -> int:
    """Count the seeds whose temperature was ever above `RUNAWAY`."""
    return len(
        {
            row.seed
            for row in found.rows
            if row.metrics.get("temperature", 0) > RUNAWAY
        }
    )


# ---- Rules ----

CONFIRMED = "confirmed"
IN_PART = "confirmed in part"
UNDECIDED = "undecided"
CONFOUNDED = "confounded"
CONTRADICTED = "contradicted"
UNTESTED = "not yet tested"
WORDS = (
    CONFIRMED,
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


def joined(verdicts: list[str]) -> str:
    """Return the verdict on a claim from those on its comparisons."""
    for word in (CONTRADICTED, UNTESTED):
        if word in verdicts:
            return word
    if CONFIRMED in verdicts:
        return CONFIRMED if {*verdicts} == {CONFIRMED} else IN_PART
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


# ---- Claims ----


class Comparison(NamedTuple):
    """A question about one run, or about a run and another or a bar."""

    what: str
    question: str
    one: str
    other: str | float | None = None


class Claim(NamedTuple):
    """A claim, what decides it, and what is compared beside it.

    What stands beside it need not be recorded.
    """

    text: str
    comparisons: tuple[Comparison, ...]
    instead: tuple[Comparison, ...] = ()


RETURNS = ("better", "comparable", "fails")
SUCCESSES = ("arrives", "varies", "mostly fails", "more arrive")

ANT, MAZE = "ant-rewards/implementation-", "maze-retraining/"
CLAIMS = {
    1: Claim(
        "Implementation 4 is the best reward.",
        tuple(
            Comparison(
                f"CustomAnt: 4 above {n}", "better", f"{ANT}4", f"{ANT}{n}"
            )
            for n in (1, 2, 3)
        ),
        tuple(
            Comparison(
                f"PointMazeLeft: 4 above {n}",
                "better",
                "maze-rewards/implementation-4",
                f"maze-rewards/implementation-{n}",
            )
            for n in (1, 2, 3)
        ),
    ),
    2: Claim(
        "Off-policy AIRL is better than DAC on Hopper and Walker2d, and "
        "comparable on HalfCheetah and Ant.",
        tuple(
            Comparison(
                f"{task}: AIRL {word} DAC",
                question,
                f"locomotion/{task}-airl",
                f"locomotion/{task}-dac",
            )
            for task, question, word in (
                ("Hopper", "better", "above"),
                ("Walker2d", "better", "above"),
                ("HalfCheetah", "comparable", "like"),
                ("Ant", "comparable", "like"),
            )
        ),
        (
            Comparison(
                "PointMazeLeft: AIRL above DAC",
                "better",
                "maze-imitation",
                "maze-dac/sac",
            ),
            *(
                Comparison(
                    f"{task}: AIRL by the recipe above DAC",
                    "better",
                    f"recipe/{task}-airl",
                    f"recipe/{task}-dac",
                )
                for task in ("Hopper", "Walker2d", "HalfCheetah")
            ),
        ),
    ),
    3: Claim(
        "The transfer to DisabledAnt fails.",
        tuple(
            Comparison(
                f"DisabledAnt, {kept}: below the bar",
                "fails",
                f"ant-transfer/{run}",
                HALF,
            )
            for kept, run in (
                ("SAC", "policy"),
                ("SAC-MCP, k = 4", "4-both"),
                ("SAC-MCP, k = 8", "8-both"),
            )
        ),
    ),
    4: Claim(
        "The transfer to PointMazeRight works, with high variance.",
        (
            Comparison(
                "policy kept: more arrive than before retraining",
                "arrives",
                f"{MAZE}policy",
            ),
            Comparison(
                "policy kept: some arrive, some do not",
                "varies",
                f"{MAZE}policy",
            ),
        ),
        (
            Comparison(
                "from scratch more arrive",
                "more arrive",
                f"{MAZE}scratch",
                f"{MAZE}policy",
            ),
        ),
    ),
    5: Claim(
        "SAC-MCP improves imitation on HalfCheetah and Ant.",
        tuple(
            Comparison(
                f"{task}: k = {k} above SAC",
                "better",
                f"locomotion/{task}-mcp-{k}",
                f"locomotion/{task}-airl",
            )
            for task in ("HalfCheetah", "Ant")
            for k in (4, 8)
        ),
        tuple(
            Comparison(
                f"PointMazeLeft: k = {k} above SAC",
                "better",
                f"maze-mcp/{k}-softmax",
                "maze-mcp/plain",
            )
            for k in (4, 8)
        ),
    ),
    6: Claim(
        "Retraining the gate alone fails on the maze.",
        tuple(
            Comparison(
                f"gate only, k = {k}", "mostly fails", f"{MAZE}{k}-gate"
            )
            for k in (4, 8)
        ),
    ),
    7: Claim(
        "With eight primitives the transfer varies less than with SAC.",
        *(
            (
                Comparison(
                    f"k = 8 against {than}",
                    "more arrive",
                    f"{MAZE}8-both",
                    f"{MAZE}{run}",
                ),
            )
            for than, run in (("SAC", "policy"), ("k = 4", "4-both"))
        ),
    ),
    8: Claim(
        "Random starts improve the transfer, and make it vary less.",
        tuple(
            Comparison(
                f"{kept}, an expert's starts against none",
                "more arrive",
                f"{MAZE}{run}-expert-starts",
                f"{MAZE}{run}",
            )
            for kept, run in (
                ("SAC", "policy"),
                ("k = 4", "4-both"),
                ("k = 8", "8-both"),
                ("gate only, k = 4", "4-gate"),
                ("gate only, k = 8", "8-gate"),
            )
        ),
    ),
}


# ---- What the records say ----


class Found(NamedTuple):
    """What the records say of a comparison.

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
    size = largest(*runs, sizes=sizes)
    found = [recorded(run, size) for run in runs]
    enough = large_enough(found, size)
    common = set.intersection(*(set(each.steps) for each in found))
    steps = [int(max(common))] * len(found)
    if comparison.question in RETURNS:
        if enough:
            steps = [int(each.steps[-1]) for each in found]
        ends = list(map(_at, found, steps))
        effect, chance, told = _of_returns(comparison, ends)
    else:
        # The seeds that all of the runs have are pairs.
        kept = [np.array(each.seeds)[whole(each)] for each in found]
        pairs = sorted(set.intersection(*map(set, kept)))
        ends = [_at(each, steps[0], pairs) for each in found]
        before = _at(found[0], found[0].steps[0], pairs)
        effect, chance, told = _of_successes(
            comparison.question, [end > BAR for end in ends], before > BAR
        )
    seeds = min(map(len, ends))
    away = sum(map(runaways, found))
    length = " and ".join(f"{step:,}" for step in dict.fromkeys(steps))
    return Found(
        comparison.what,
        f"{networks(runs[0], size)}, {seeds} seeds, {length} steps",
        seeds,
        effect,
        chance,
        told,
        verdict(told, enough, away > 0),
        away,
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


def decided() -> tuple[dict[int, list[Found]], dict[int, str]]:
    """Return what is found of each claim, and the verdict on each."""
    found = {
        n: [*map(compare, claim.comparisons)] for n, claim in CLAIMS.items()
    }
    return found, {
        n: joined([each.verdict for each in found[n]]) for n in found
    }


# ---- Words ----


def number(x: float, digits: int = 0) -> str:
    """Write a number, with a proper minus."""
    return f"{x:,.{digits}f}".replace("-", "−")


def interval(numbers: tuple | None, digits: int) -> str:
    """Write a number with its interval; a dash for none."""
    if numbers is None:
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
    """Write the effect of a comparison, and how sure it is."""
    if of_successes(found):
        rates = [rate(each, found.seeds) for each in found.effect]
        p = found.chance
        return " against ".join(rates), "–" if p is None else f"p = {p:.2g}"
    digits = 0 if abs(found.effect[0]) > 100 else 1
    return (
        interval(found.effect, digits),
        f"P = {interval(found.chance, 2)}",
    )


def evidence(found: list[Found]) -> str:
    """Say in a line what a verdict rests on."""
    if not of_successes(found[0]):
        words = [each.seen for each in found]
        counts = [
            f"{words.count(word)} {word}" for word in dict.fromkeys(words)
        ]
        return "seen so far: " + ", ".join(counts)
    seeds = found[0].seeds
    if len({each.effect for each in found}) == 1 == len(found[0].effect):
        text = f"{rate(found[0].effect[0], seeds)} seeds arrive"
        away = [str(each.runaways) for each in found]
        if any(each.runaways for each in found):
            text += f"; temperature above {RUNAWAY:,} in "
            text += " and ".join(away) + " seeds"
        return text
    mark = " against " if len(found) == 1 else " : "
    pairs = [
        mark.join(f"{share * seeds:.0f}" for share, *_ in each.effect)
        for each in found
    ]
    text = ", ".join(pairs) + f" of {seeds} seeds"
    if len(found) == 1:
        return f"{text}, {cells(found[0])[1]}"
    claimed = sum(each.seen == "as claimed" for each in found)
    return f"{text}; as claimed in {claimed} of {len(found)} cases"


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

    That is measured: Hopper with networks of the paper's size.
    """
    paces = [
        records.read_json(path)["wall_s"]
        / len(records.read(path.parent).rows)
        / records.read(path.parent).config.eval_every
        for path in RECORDS.glob("locomotion-full/Hopper-*/run.json")
    ]
    return float(np.mean(paces)) * SEEDS * STEPS / 3600


def needed(n: int, word: str) -> str:
    """Say what would decide a claim that is not decided."""
    wanted = []
    if runs := missing(n):
        days = f"{hours() * len(runs) / 24:.0f} days"
        wanted.append(f"{len(runs)} runs, about {days}")
    if runs := out_of_bounds(n):
        took = sum(
            records.read_json(RECORDS / record(run, "full") / "run.json")[
                "wall_s"
            ]
            for run in runs
        )
        wanted.append(
            f"{len(runs)} runs with a bounded temperature, about "
            f"{took / 3600:.0f} hours"
        )
    if word in (UNDECIDED, IN_PART):
        wanted.append("more seeds")
    return "; ".join(wanted) or "–"


def out_of_bounds(n: int) -> list[str]:
    """Return the runs of a claim whose temperature ran away."""
    runs = [
        run
        for each in CLAIMS[n].comparisons
        for run in (each.one, each.other)
        if isinstance(run, str) and recorded(run, "full")
    ]
    return [
        run
        for run in dict.fromkeys(runs)
        if runaways(recorded(run, "full"))
    ]
