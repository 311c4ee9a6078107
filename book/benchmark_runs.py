"""The benchmark's cells: a method on a robot, with so many demonstrations.

Runs are in `records/benchmark-demo/BLOCK/ROBOT-METHOD`, and clones are
recorded by `rollouts/benchmark.py`. Returns are in percent of what the
expert returns without noise.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import HTML
from jaxtyping import Float64
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import rollouts
from drawing import table
from offairl_lite import demonstrations, experiments
from offairl_lite.analysis import plots
from offairl_lite.analysis.statistics import (
    bootstrap_interval,
    difference,
    interquartile_mean,
)
from offairl_lite.core.loop import Run
from offairl_lite.runs import records

Ends = Float64[np.ndarray, "seeds"]

RECORDS = Path(__file__).parent / "records/benchmark-demo"
COLD = RECORDS.parent / "iq-learn-cold-demo"
ROBOTS = ("Hopper", "Walker2d", "HalfCheetah", "CustomAnt", "Ant")
METHODS = {
    "clone": "cloning",
    "airl": "the recipe",
    "dac": "DAC",
    "state-dac": "state-only DAC",
    "sqil": "SQIL",
    "iq-learn": "IQ-Learn",
    "airl-warm": "the recipe from a clone",
}
BLOCKS = {
    "1": "One demonstration",
    "4": "Four demonstrations",
    "50": "Fifty demonstrations",
    "4-thinned": "Four demonstrations, every 20th step",
    "4-long": "Four demonstrations, 500,000 steps",
}
_EVERYWHERE = dict.fromkeys(("clone", "airl", "dac", "state-dac"), ROBOTS)
PLAN: Mapping[str, Mapping[str, Sequence[str]]] = {
    "1": _EVERYWHERE,
    "4": dict.fromkeys(METHODS, ROBOTS),
    "50": _EVERYWHERE,
    "4-thinned": dict.fromkeys(("clone", "airl", "dac"), ROBOTS[:3]),
    "4-long": dict.fromkeys(("airl", "dac"), ROBOTS[:4]),
}
"""The robots of each method, for each block of the table."""

# The library `imitation`, folder `benchmarking` at commit 99b131f, and for
# GAIL on Hopper and HalfCheetah `benchmarking/results` at commit 9073e39:
# the mean returns of the seeds 100 to 104, in the order of their files.
THEIR_EXPERTS = {
    "Hopper": 2630.92,
    "Walker2d": 2672.96,
    "HalfCheetah": 3465.42,
    "Ant": 2408.22,
}
THEIRS = {
    "their cloning": {
        "Hopper": (2239.95, 2241.96, 2194.95, 2253.88, 2283.27),
        "Walker2d": (2493.52, 2546.03, 2431.11, 2497.32, 2593.77),
        "HalfCheetah": (3540.47, 3308.07, 3517.64, 3405.94, 3458.01),
        "Ant": (1499.7, 2253.66, 2079.42, 2059.98, 1870.14),
    },
    "their GAIL": {
        "Hopper": (2539.6, 2681.16, 2765.27, 2679.83, 2691.2),
        "Walker2d": (2720.91, 2600.9, 2539.56, 2712.06, 2642.98),
        "HalfCheetah": (3174.02, 3165.06, 2917.02, 2840.81, 2952.95),
        "Ant": (1649.79, 2377.56, 2494.22, 1789.58, 2320.07),
    },
    "their AIRL": {
        "Hopper": (2600.12, 2663.1, 2740.77, 2758.67, 2613.26),
        "Walker2d": (1044.57, 651.678, 1021.0, -8.05116, 898.306),
        "HalfCheetah": (1674.29, 3652.14, 3491.62, 4441.25, 3960.15),
        "Ant": (123.476, -378.377, -314.108, -0.402349, 18.9413),
    },
}


COUNTS = ("1", "4", "50")
"""The blocks that differ in the number of whole demonstrations only."""
BETWEEN = ("10", "20")
"""Numbers of whole demonstrations that only clones had."""


class Cell(NamedTuple):
    """How each seed ends, in percent; what it cost; how many diverged.

    `hours` are of one core, for all seeds together. A seed that diverged
    has no policy, and counts as 0 %.
    """

    ends: Ends
    steps: int
    hours: float
    diverged: int = 0


Cells = Mapping[tuple[str, str, str], Cell]
"""Cells by block, robot and method."""
Rows = Mapping[str, tuple[str, Mapping[str, Ends]]]
"""A method, and how its seeds end by robot, for each name."""


class Summary(NamedTuple):
    """The interquartile mean with its interval, and the worst seed."""

    mean: float
    low: float
    high: float
    worst: float


def env_id_of(robot: str) -> str:
    """Return the id of a robot's task."""
    return experiments.configure(f"benchmark/{robot}-airl", "demo").env_id


def expert(robot: str) -> tuple[float, float]:
    """Return what the strongest expert returns without noise, and with it.

    The second is the mean of its fifty demonstrations.
    """
    noted = records.read_json(demonstrations.EXPERTS / f"{robot}.json")
    best = int(np.argmax(noted["returns"]))
    return noted["returns"][best], noted["mean_returns"][best]


def folders() -> dict[tuple[str, str, str], Path]:
    """Return the folders of the runs that have ended, by cell."""
    found = {}
    for place in sorted(RECORDS.glob("*/*-*")):
        robot, _, method = place.name.partition("-")
        parts = records.run_folders(place)
        states = {
            records.read_state(part)["state"]
            for part in parts
            if (part / "run.json").is_file()
        }
        if states and states <= {records.FINISHED, records.DIVERGED}:
            found[place.parent.name, robot, method] = place
    return found


def read() -> Cells:
    """Return all cells that are recorded."""
    found = {}
    for key, place in folders().items():
        run = records.read(place)
        alive = [seed not in run.diverged for seed in run.seeds]
        ends = np.zeros(len(run.seeds))
        if any(alive):
            ends[alive] = run.returns[alive, -1]
        seconds = sum(
            about["wall_s"] * about["threads"]
            for about in map(records.read_state, records.run_folders(place))
        )
        found[key] = Cell(
            100 * ends / expert(key[1])[0],
            run.config.total_steps,
            seconds / 3600,
            len(run.diverged),
        )
    for block, robots in clones().items():
        for robot, cell in robots.items():
            found[block, robot, "clone"] = Cell(
                100 * cell["returns"] / expert(robot)[0],
                0,
                cell["seconds"] / 3600,
            )
    return found


def longer(
    runs: Mapping[tuple[str, str, str], Path],
) -> dict[str, list[Run]]:
    """Return the longer runs of robots with both: the recipe, then DAC."""
    pairs = {
        robot: [("4-long", robot, method) for method in ("airl", "dac")]
        for robot in PLAN["4-long"]["airl"]
    }
    return {
        robot: [records.read(runs[key]) for key in pair]
        for robot, pair in pairs.items()
        if {*pair} <= {*runs}
    }


def clones() -> dict[str, dict]:
    """Return what is recorded of clones, by block and robot."""
    found = rollouts.read("benchmark")
    return {block: found[block] for block in BLOCKS if block in found}


def planned() -> set[tuple[str, str, str]]:
    """Return the cells that the table is to have."""
    return {
        (block, robot, method)
        for block, methods in PLAN.items()
        for method, robots in methods.items()
        for robot in robots
    }


def filled(cells: Cells) -> str:
    """Say how many cells there are, of how many."""
    wanted, there = planned(), set(cells)
    rows = {(block, method) for block, _, method in wanted & there}
    more = sum(len(found[2]) for row in rows if (found := row_beside(*row)))
    text = (
        f"{len(wanted & there)} of {len(wanted)} cells of the plan are "
        f"filled, and {more} more, in rows with another setting."
    )
    if wanted - there:
        blocks = {BLOCKS[block] for block, *_ in wanted - there}
        text += f" Not run yet: {'; '.join(sorted(blocks))}."
    lost = sum(cell.diverged for cell in cells.values())
    if lost:
        text += f" Seeds that diverged count as 0 %: {lost}."
    return text


def summary(ends: Ends) -> Summary:
    """Return the four numbers of a cell, in percent."""
    low, high = bootstrap_interval(ends)
    mean = interquartile_mean(ends)
    return Summary(float(mean), float(low), float(high), float(ends.min()))


def average(cells: Cells, block: str, method: str) -> float | None:
    """Return the mean over the robots of a row; None if one is missing."""
    keys = [(block, robot, method) for robot in PLAN[block][method]]
    if not all(key in cells for key in keys):
        return None
    return float(np.mean([summary(cells[key].ends).mean for key in keys]))


def clear(
    cells: Cells,
    block: str,
    one: str,
    other: str,
    robots: Iterable[str] = ROBOTS,
) -> tuple[list[str], list[str]]:
    """Return on which robots one method is clearly ahead, and behind.

    A difference is clear if the 95 % interval of the difference of the
    interquartile means excludes 0.
    """
    ahead, behind = [], []
    for robot in robots:
        pair = [cells[block, robot, method].ends for method in (one, other)]
        _, low, high = difference(*pair)
        if low > 0:
            ahead.append(robot)
        elif high < 0:
            behind.append(robot)
    return ahead, behind


def noise(robots: Iterable[str] = ROBOTS) -> HTML:
    """Return what the experts return, and what their demonstrations do."""
    kept, rows = clones(), []
    for robot in robots:
        without, shown = expert(robot)
        few = [kept.get(block, {}).get(robot) for block in ("4", "1")]
        means = [shown, *(one and one["demonstrations"] for one in few)]
        parts = [number(100 * x / without) if x else "–" for x in means]
        rows.append((robot, f"{without:,.0f}", *parts))
    heads = (
        "expert",
        "return<br>without noise",
        "fifty, %",
        "first four, %",
        "first, %",
    )
    return table(heads, rows)


def clones_beside(block: str) -> dict[str, Ends]:
    """Return clones that the plan does not have, in percent, by robot.

    Blocks are `10` and `20` demonstrations, and `1-small` and `4-small`,
    with networks of 64-64.
    """
    return {
        robot: 100 * cell["returns"] / expert(robot)[0]
        for robot, cell in rollouts.read("benchmark")[block].items()
    }


def iq_learn_cold() -> dict[str, Ends]:
    """Return IQ-Learn at its authors' default temperature, 0.01.

    With four demonstrations, in percent, by robot.
    """
    found = {}
    for robot in ROBOTS:
        run = records.read(COLD / f"{robot}-iq-learn")
        found[robot] = 100 * run.returns[:, -1] / expert(robot)[0]
    return found


def row_beside(
    block: str, method: str
) -> tuple[str, str, Mapping[str, Ends]] | None:
    """Return a method's row with another setting than the plan's, if any.

    It has a name, the option of the command, and the ends by robot.
    """
    if method == "clone" and block in ("1", "4"):
        small = clones_beside(f"{block}-small")
        return "cloning, with networks of 64-64", "--hidden 64 64", small
    if method == "iq-learn" and block == "4":
        return "IQ-Learn at 0.01", "--temperature 0.01", iq_learn_cold()
    return None


def lead(
    ones: Sequence[Ends], others: Sequence[Ends], samples: int = 20_000
) -> tuple[float, float, float]:
    """Return by how much one method leads another on average over robots.

    It is the mean over robots of the difference of interquartile means,
    with its 95 % interval: the seeds of each robot are drawn anew.
    """
    rng, drawn, found = np.random.default_rng(0), np.zeros(samples), 0.0
    for sign, ends in [(1, x) for x in ones] + [(-1, x) for x in others]:
        which = rng.integers(len(ends), size=(len(ends), samples))
        drawn += sign * interquartile_mean(ends[which])
        found += sign * float(interquartile_mean(ends))
    low, high = np.percentile(drawn, (2.5, 97.5)) / len(ones)
    return found / len(ones), float(low), float(high)


def costs(cells: Cells) -> HTML:
    """Return what the cells of each method that has any have cost."""
    rows = []
    for method, name in METHODS.items():
        own = [
            cell
            for (block, _, m), cell in cells.items()
            if m == method and block in COUNTS
        ]
        if not own:
            continue
        minutes = [60 * cell.hours for cell in own]
        spread = f"{min(minutes):.0f} to {max(minutes):.0f}"
        row = (f"{own[0].steps:,}", spread, f"{sum(minutes) / 60:.1f}")
        rows.append((name, str(len(own)), *row))
    heads = (
        "method",
        "cells",
        "steps of<br>a seed",
        "minutes<br>of a cell",
        "hours<br>of all",
    )
    return table(heads, rows)


DUELS = (
    ("1", "airl", "clone"),
    ("1", "dac", "airl"),
    ("1", "state-dac", "airl"),
    ("4", "airl", "clone"),
    ("4", "airl-warm", "clone"),
    ("4", "airl-warm", "airl"),
    ("4", "dac", "airl"),
    ("4", "state-dac", "airl"),
    ("4", "state-dac", "dac"),
    ("50", "airl", "clone"),
    ("50", "dac", "clone"),
    ("50", "dac", "airl"),
    ("50", "state-dac", "airl"),
)
"""Two methods with the same demonstrations: which is ahead?"""


class Duel(NamedTuple):
    """Two methods with the same demonstrations, as far as they were run.

    `signs` has, by robot, 1 where the first is clearly ahead, -1 where it
    is clearly behind, and 0 where neither is clear; `lead` is the first's
    on average over the robots, with its interval, or None if one of them
    is missing.
    """

    block: str
    one: str
    other: str
    signs: Mapping[str, int]
    lead: tuple[float, float, float] | None


def duels(cells: Cells) -> list[Duel]:
    """Return the duels of which there is anything to tell."""
    found = []
    for block, *pair in DUELS:
        ends = {
            robot: [cells[block, robot, method].ends for method in pair]
            for robot in ROBOTS
            if {(block, robot, method) for method in pair} <= set(cells)
        }
        if not ends:
            continue
        ahead, behind = clear(cells, block, *pair, ends)
        signs = {r: (r in ahead) - (r in behind) for r in ends}
        whole = len(ends) == len(ROBOTS)
        by = lead(*zip(*ends.values(), strict=True)) if whole else None
        found.append(Duel(block, *pair, signs, by))
    return found


def rows_of_four(cells: Cells) -> Rows:
    """Return the rows for four demonstrations.

    Each name has its method, and the ends of its seeds by robot, as far as
    they are recorded.
    """
    rows = {}
    for method, name in METHODS.items():
        keys = {robot: ("4", robot, method) for robot in ROBOTS}
        ends = {
            r: cells[key].ends for r, key in keys.items() if key in cells
        }
        if ends:
            rows[name] = method, ends
        if method == "iq-learn":
            name, _, ends = row_beside("4", method)
            rows[name] = method, ends
    return rows


def short(cells: Cells) -> str:
    """Return the README's table, in Markdown: four demonstrations."""
    lines = [f"| | {' | '.join(ROBOTS)} |", "|---" * 6 + "|"]
    for name, (_, ends) in rows_of_four(cells).items():
        means = [
            number(summary(ends[robot]).mean) if robot in ends else "–"
            for robot in ROBOTS
        ]
        lines.append(f"| {' | '.join([name, *means])} |")
    return "\n".join(lines)


# Tables and a figure.


def commands(block: str, method: str, robot: str = "Hopper") -> list[str]:
    """Return what makes one cell of a row."""
    count, _, kind = block.partition("-")
    env_id, out = env_id_of(robot), f"clones/{robot.lower()}.safetensors"
    clone = f"offairl clone {env_id} --trajectories {count} --experts best"
    if method == "clone":
        if kind == "thinned":  # The command line thins for runs only.
            shown = f'"{env_id}", {count}, subsample=20, experts="best"'
            return [
                f"cloning.clone(demonstrations.load({shown}), range(10))"
            ]
        return [f"{clone} --seeds 0 1 2 3 4 5 6 7 8 9 --out {out}"]
    more = {"thinned": " --subsample 20", "long": " --total-steps 500000"}
    run = f"--only {robot}-{method} --trajectories {count}"
    run += more.get(kind, "")
    if method != "airl-warm":
        return [f"offairl run benchmark {run}"]
    config = experiments.configure(f"benchmark/{robot}-airl", "demo")
    absorbs = config.schedule.absorbing != "none"
    return [
        f"{clone} --hidden 64 64{' --absorbing-state' * absorbs} "
        f"--seeds 0 1 2 3 4 --out {out}",
        f"offairl run benchmark-warm {run} --pretrained-policy {out}",
    ]


def number(value: float) -> str:
    """Return a rounded number with a true minus sign."""
    return f"{value:.0f}".replace("-0", "0").replace("-", "−")


def text_of(ends: Ends | None) -> str:
    """Return a cell of a table: the mean, its interval, the worst seed."""
    if ends is None:
        return "–"
    mean, low, high, worst = map(number, summary(ends))
    rest = _small(f"{low}&nbsp;to&nbsp;{high}<br>({worst})")
    return f"<b>{mean}</b><br>{rest}"


def _small(text: str) -> str:
    return f'<span style="font-size: 0.85em">{text}</span>'


def _code(line: str) -> str:
    """Return a command that is broken between its words only."""
    words = (
        f'<span style="white-space: nowrap">{word}</span>'
        for word in line.split(" ")
    )
    return f"<code>{' '.join(words)}</code>"


def duration(hours: float) -> str:
    """Return hours, or minutes if they are few, in words."""
    if hours < 0.1:
        return f"{60 * hours:.1f} minutes"
    return f"{hours:.1f} hours"


def _row(cells: Sequence[str], tag: str = "td") -> str:
    """Return a row of a table whose columns are robots."""
    width = f"width: {100 / len(cells):.0f}%"
    side = f'<{tag} style="text-align: center; {width}">'
    return f"<tr>{''.join(f'{side}{cell}</{tag}>' for cell in cells)}</tr>"


def _title(text: str, columns: int, tag: str = "td") -> str:
    """Return a row of one cell that stands above rows of numbers."""
    style = "border-bottom: none; padding-bottom: 0"
    cell = f'<{tag} colspan="{columns}" style="{style}">{text}</{tag}>'
    return f"<tr>{cell}</tr>"


def _heads(robots: Iterable[str]) -> list[str]:
    """Return names that may be broken into two lines."""
    pattern = r"(Walker|Half|Custom)"
    return [re.sub(pattern, r"\1<wbr>", robot) for robot in robots]


def block_table(cells: Cells, block: str) -> str:
    """Return the table of one number of demonstrations, as HTML.

    A method has two rows, so that five robots fit on a telephone: what it
    costs, with the command folded below, and its numbers. Methods without a
    number are in the last row, with their commands folded, too.
    """
    robots = [
        r for r in ROBOTS if any(r in x for x in PLAN[block].values())
    ]
    methods = [
        method
        for method in METHODS
        if method in PLAN[block]
        or any((block, robot, method) in cells for robot in robots)
    ]
    width = len(robots)
    lines, waiting = [], {}
    for method in methods:
        row = [cells.get((block, robot, method)) for robot in robots]
        there = [cell for cell in row if cell]
        how = "<br>".join(map(_code, commands(block, method)))
        if not there:
            waiting[METHODS[method]] = how
            continue
        hours = float(np.mean([cell.hours for cell in there]))
        cost = f"{there[0].steps:,} steps, {duration(hours)}"
        folded = (
            f"<details><summary>{_small(cost)}</summary>{how}</details>"
        )
        about = f"<b>{METHODS[method]}</b>{folded}"
        texts = [text_of(cell.ends if cell else None) for cell in row]
        lines += [_title(about, width), _row(texts)]
        if beside := row_beside(block, method):
            name, option, ends = beside
            how = _code(f"{commands(block, method)[0]} {option}")
            folded = f"<details><summary>{_small(option)}</summary>{how}"
            folded += "</details>"
            texts = [text_of(ends[robot]) for robot in robots]
            lines += [_title(f"<b>{name}</b>{folded}", width), _row(texts)]
    if lines:
        lines.insert(0, _row(_heads(robots), "th"))
    if waiting:
        lines.append(_title(_not_run(waiting), width))
    title = _title(BLOCKS[block], width, "th")
    return f'<table class="table">{title}{"".join(lines)}</table>'


def _not_run(waiting: Mapping[str, str]) -> str:
    """Return the names of methods, and their commands, which unfold."""
    commands = "".join(
        f"<p><b>{name}</b><br>{_small(how)}</p>"
        for name, how in waiting.items()
    )
    names = f"Not run yet: {', '.join(waiting)} (commands)."
    return f"<details><summary>{names}</summary>{commands}</details>"


def show(cells: Cells, *blocks: str) -> HTML:
    """Return the tables of some blocks."""
    tables = "".join(block_table(cells, block) for block in blocks)
    return HTML(tables)


SIGNS = {
    1: f'<b style="color: var(--pst-color-info, {plots.BLUE})">▲</b>',
    -1: f'<b style="color: var(--pst-color-warning, {plots.ORANGE})">▼</b>',
    0: "·",
}
"""How a table says who is ahead: the first, the second, nobody clearly."""


def show_duels(found: Iterable[Duel]) -> HTML:
    """Return duels as a table, below the titles of their blocks.

    Names of robots stand upright, so that it fits on a telephone.
    """
    upright = 'style="writing-mode: vertical-rl; transform: rotate(180deg)"'
    names = "".join(f"<th><span {upright}>{r}</span></th>" for r in ROBOTS)
    lines, title = [f"<tr><th></th>{names}<th>average lead</th></tr>"], None
    for duel in found:
        if duel.block != title:
            title = duel.block
            lines.append(_title(BLOCKS[title], len(ROBOTS) + 2, "th"))
        one, other = METHODS[duel.one], METHODS[duel.other]
        marks = [SIGNS.get(duel.signs.get(robot), "–") for robot in ROBOTS]
        average = "–"
        if duel.lead:
            mean, low, high = map(number, duel.lead)
            average = (
                f"<b>{mean}</b> {_small(f'({low}&nbsp;to&nbsp;{high})')}"
            )
        pair = f"<b>{one}</b>, against {other}"
        row = "".join(f"<td>{x}</td>" for x in (pair, *marks, average))
        lines.append(f"<tr>{row}</tr>")
    return HTML(f'<table class="table">{"".join(lines)}</table>')


def show_theirs() -> HTML:
    """Return the table of the published figures of `imitation`."""
    rows = {
        method: [
            100 * np.array(robots[robot]) / shown
            for robot, shown in THEIR_EXPERTS.items()
        ]
        for method, robots in THEIRS.items()
    }
    return _compared("Percent of their experts", list(THEIR_EXPERTS), rows)


def _compared(
    title: str,
    robots: Sequence[str],
    rows: Mapping[str, Iterable[Ends | None]],
) -> HTML:
    """Return a table with a title, and two rows for each name."""
    width = len(robots)
    lines = [_title(title, width, "th"), _row(_heads(robots), "th")]
    for name, row in rows.items():
        lines += [
            _title(f"<b>{name}</b>", width),
            _row([text_of(ends) for ends in row]),
        ]
    return HTML(f'<table class="table">{"".join(lines)}</table>')


COLORS = {
    "clone": "black",
    "airl": plots.BLUE,
    "dac": plots.ORANGE,
    "state-dac": plots.GREEN,
    "sqil": plots.RED,
    "iq-learn": plots.PURPLE,
    "airl-warm": "#56B4E9",
}


def draw(cells: Cells) -> Figure:
    """Draw four demonstrations: a panel for each robot, one for all.

    The last is the average of the methods that all robots have been run
    with.
    """
    rows = rows_of_four(cells)
    size = 5.6, 2.2 + 3 * 0.28 * len(rows)
    fig, axes = plt.subplots(3, 2, figsize=size, sharey=True)
    for ax, robot in zip(axes.flat, ROBOTS, strict=False):
        _panel(ax, robot, rows)
    _average_panel(axes[2, 1], rows)
    names = [name.replace(" from", "\nfrom") for name in rows]
    axes[0, 0].set_yticks(range(len(rows)), names)
    axes[0, 0].set_ylim(len(rows) - 0.4, -0.6)
    for ax in axes[2]:
        ax.set_xlabel("% of the expert")
    return fig


def _average_panel(ax: Axes, rows: Rows) -> None:
    """Draw averages over the robots, with their intervals."""
    ax.axvline(100, color=plots.GREY, linestyle="--", linewidth=1)
    for y, (method, ends) in enumerate(rows.values()):
        if len(ends) == len(ROBOTS):
            none = [np.zeros(1)] * len(ends)
            _mark(ax, y, COLORS[method], *lead(list(ends.values()), none))
    _frame(ax, "average of the five")


def _panel(ax: Axes, robot: str, rows: Rows) -> None:
    """Draw one robot: a mark, its interval and the worst seed in a row."""
    without, shown = expert(robot)
    ax.axvline(100, color=plots.GREY, linestyle="--", linewidth=1)
    ax.axvline(
        100 * shown / without, color=plots.GREY, linestyle=":", lw=1.3
    )
    for y, (method, ends) in enumerate(rows.values()):
        if robot in ends:
            *numbers, worst = summary(ends[robot])
            _mark(ax, y, COLORS[method], *numbers)
            ax.plot(worst, y, "|", color=COLORS[method], ms=9, mew=1.5)
    _frame(ax, robot)


def _mark(
    ax: Axes, y: int, color: str, mean: float, low: float, high: float
) -> None:
    """Draw a mean with its interval, and print it beside the panel."""
    ax.plot([low, high], [y, y], color=color, lw=2, alpha=0.6)
    ax.plot(mean, y, "o", color=color, ms=6)
    beside = ax.get_yaxis_transform()
    ax.text(1.02, y, str(round(mean)), transform=beside, va="center")


def _frame(ax: Axes, title: str) -> None:
    """Give a panel its title and its limits."""
    ax.set(xlim=(-8, 118), title=title)
    ax.tick_params(axis="y", length=0)
    ax.grid(visible=False, axis="y")


def draw_clones(cells: Cells) -> Figure:
    """Draw clones by the number of demonstrations, a line for a robot."""
    ends = {
        count: clones_beside(count)
        if count in BETWEEN
        else {robot: cells[count, robot, "clone"].ends for robot in ROBOTS}
        for count in sorted((*COUNTS, *BETWEEN), key=int)
    }
    counts = [int(count) for count in ends]
    fig, ax = plt.subplots(figsize=(5.6, 2.8))
    ax.axhline(100, color=plots.GREY, linestyle="--", linewidth=1)
    places = {
        robot: [summary(of[robot]).mean for of in ends.values()]
        for robot in ROBOTS
    }
    # Labels stand in the order of the lines' ends, apart from each other.
    order = sorted(ROBOTS, key=lambda robot: places[robot][-1])
    colors = plots.BLUE, plots.ORANGE, plots.GREEN, plots.PURPLE, plots.RED
    for height, robot in zip(np.linspace(50, 110, 5), order, strict=True):
        color = colors[ROBOTS.index(robot)]
        ax.plot(counts, places[robot], "o-", ms=4, lw=1.4, color=color)
        ax.annotate(
            robot,
            (50, places[robot][-1]),
            (66, height),
            color=color,
            va="center",
            arrowprops={
                "arrowstyle": "-",
                "color": color,
                "lw": 0.8,
                "relpos": (0, 0.5),
            },
        )
    ax.set(xscale="log", xlim=(0.85, 190), ylim=(-8, 122))
    ax.set_xticks(counts, list(ends))
    ax.minorticks_off()
    ax.set(xlabel="demonstrations", ylabel="% of the expert")
    return fig
