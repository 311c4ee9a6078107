"""The runs of what makes off-policy AIRL work on robots, for the notes.

A run's name is `robot-loss-temperature-warmup`, as in the experiment
`what-decides`. Returns are in percent of the mean return of the robot's
usual demonstrations.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import HTML
from jaxtyping import Float64
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drawing import table
from offairl_lite import demonstrations, experiments
from offairl_lite.analysis import plots
from offairl_lite.runs import records

Ends = Float64[np.ndarray, "seeds"]

RECORDS = Path(__file__).parent / "records"
GRID = "what-decides-demo"
OTHERS = "decides-gpu-demo"  # on other demonstrations of CustomAnt
RECIPE = "released-fixed-short"
LOSSES = {
    "released": "log-ratio loss",
    "dac": "DAC",
    "mixture": "mixture",
    "exact": "AIRL loss",
}
TEMPERATURES = {"fixed": "α = 0.2", "learned": "α learned", "one": "α = 1"}
WARMUPS = {"short": "1,000", "long": "10,000"}
VARIANTS = tuple(experiments.find("what-decides").variants)
ROBOTS = tuple(dict.fromkeys(name.split("-")[0] for name in VARIANTS))


def demonstrated(robot: str) -> float:
    """Return the mean return of the first expert's demonstrations."""
    noted = records.read_json(demonstrations.EXPERTS / f"{robot}.json")
    return noted["demonstrated"][0]


def _percent(
    folder: str, after: int = 0
) -> Float64[np.ndarray, "seeds evaluations"]:
    """Return a run's evaluations after a step, up to the 100,000th."""
    run = records.read(RECORDS / folder)
    shown = (after < run.steps) & (run.steps <= 100_000)
    assert run.steps[shown][-1] == 100_000
    assert not run.diverged
    robot, *_ = folder.split("/")[-1].split("-")
    return 100 * run.returns[:, shown] / demonstrated(robot)


def ended(*folders: str) -> Ends:
    """Return how each seed of these runs does after 100,000 steps."""
    return np.concatenate([_percent(folder)[:, -1] for folder in folders])


def last_four(*folders: str) -> Ends:
    """Return the same, as the mean of the last four evaluations."""
    found = [_percent(folder, after=60_000) for folder in folders]
    assert all(returns.shape[1] == 4 for returns in found)
    return np.concatenate([returns.mean(1) for returns in found])


def tried(place: str, kind: str = RECIPE) -> dict[str, Ends]:
    """Return how seeds ended, for each robot that has such a run.

    Args:
        place: the folder of the records.
        kind: the rest of the run's name, without the robot.
    """
    names = {robot: f"{place}/{robot}-{kind}" for robot in ROBOTS}
    return {
        robot: ended(name)
        for robot, name in names.items()
        if (RECORDS / name).is_dir()
    }


def grid(place: str = GRID) -> dict[str, Ends]:
    """Return how seeds ended, for each run of the grid that is there."""
    names = [name for name in VARIANTS if (RECORDS / place / name).is_dir()]
    return {name: ended(f"{place}/{name}") for name in names}


def numbers_of(
    rows: Mapping[str, Mapping[str, Ends]],
    columns: Sequence[str] = ROBOTS,
    what: str = "% of the demonstrations",
) -> HTML:
    """Return a table of medians, with the lowest and the highest seed."""

    def cell(ends: Ends | None) -> str:
        if ends is None:
            return "–"
        low, middle, high = ends.min(), np.median(ends), ends.max()
        text = f"{middle:,.0f} ({low:,.0f} to {high:,.0f})"
        return text.replace("-0", "0").replace("-", "−")

    return table(
        [what, *columns],
        [
            (label, *(cell(found.get(column)) for column in columns))
            for label, found in rows.items()
        ],
    )


def draw_rows(
    rows: Mapping[str, Mapping[str, Sequence[tuple[Ends | None, str]]]],
    height: float = 0.3,
    robots: Sequence[str] = ROBOTS,
    columns: int = 0,
) -> tuple[Figure, Sequence[Axes]]:
    """Draw a dot for each seed and a bar for the median.

    Args:
        rows: for each setting and robot its runs, each with its colour.
        height: of a row, in inches.
        robots: the panels.
        columns: how many panels stand in a row; all, if 0.
    """
    columns = columns or len(robots)
    lines = -(-len(robots) // columns)
    size = (min(7.4, 2.7 * columns), 1.2 + height * len(rows) * lines)
    fig, grid_of = plt.subplots(
        lines, columns, figsize=size, sharey=True, squeeze=False
    )
    axes = list(grid_of.flat)
    for ax in axes[len(robots) :]:
        ax.axis("off")
    for ax, robot in zip(axes[: len(robots)], robots, strict=True):
        for y, panels in enumerate(rows.values()):
            arms = panels[robot]
            for arm, (ends, color) in enumerate(arms):
                if ends is None:
                    continue
                at = y + 0.4 * (arm - (len(arms) - 1) / 2)
                dots = {"color": color, "markersize": 4.5, "alpha": 0.6}
                ax.plot(ends, np.full(len(ends), at), "o", **dots)
                ax.plot(np.median(ends), at, "k|", markersize=9)
        ax.axvline(100, color=plots.GREY, linestyle="--", linewidth=1)
        ax.set(xlim=(-15, 170), ylim=(len(rows) - 0.5, -0.5))
        ax.set_xticks([0, 100])
        ax.grid(visible=False, axis="y")
        ax.set_title(robot)
    axes[0].set_yticks(range(len(rows)), list(rows))
    fig.supxlabel("% of the demonstrations' mean return", fontsize="medium")
    return fig, axes


COSTS = {
    **{f"{robot}, 100,000 steps": f"{GRID}/{robot}-*" for robot in ROBOTS},
    "the recipe, 500,000 steps": "locomotion-demo/*-airl",
    "DAC with SAC, 500,000 steps": "locomotion-demo/*-dac",
    "DAC with TD3, 500,000 steps": "locomotion-demo/*-td3",
    "4 and 8 primitives": "locomotion-demo/*-mcp-*",
    "the paper's networks": "locomotion-full/*",
    "networks of 256-256": "decides-wide-demo/*",
    "HalfCheetah, a million steps": "locomotion-long-demo/*",
    "Walker2d, ten more seeds": "locomotion-again-demo/*",
    "a stronger expert of the Ant": "locomotion-strong-demo/*",
    "experts, 650,000 steps and more": "experts-long/*",
    "small experts, a million steps": "experts-small/*",
    "AIRL loss, temperature 1.2": "decides-1.2-demo/*",
    "temperature 1, penalty 0.1": "decides-steeper-demo/*",
    "penalties of 0.1 and 1": "decides-penalty-*demo/*",
    "a logit f/α − log π": "decides-scaled-*demo/*",
    "shorter blocks": "decides-blocks-demo/*",
    "a replay of 10,000 steps": "decides-forget-demo/*",
    "no updates for the warm-up": "decides-skip-demo/*",
    "neither, and a short replay": "decides-both-demo/*",
    "the warm-up, five more seeds": "*decides*-more-demo/*-released-*",
    "demonstrations without noise": "decides-mode-demo/*",
    "four demonstrations": "decides-four-*demo/*",
    "CustomAnt, four rewards": "decides-ant-rewards-demo/*/*",
    "CustomAnt, no ant falls": "decides-upright-demo/*/*",
    "the same on a GPU": "decides-gpu-demo/*",
    "transfer to DisabledAnt": "decides-transfer-demo/*/*",
    "the marsh": "decides-marsh-demo/*/*",
}
"""Recorded runs, by what they are about."""


def costs() -> dict[str, tuple[int, float]]:
    """Return how many runs of each kind there are, and their hours."""
    found = {}
    for what, pattern in COSTS.items():
        seconds = [
            records.read_json(path)["wall_s"]
            for path in RECORDS.glob(f"{pattern}/run.json")
        ]
        found[what] = len(seconds), sum(seconds) / 3600
    return found


def draw_costs(found: Mapping[str, tuple[int, float]]) -> Figure:
    """Draw the hours of the ten costliest kinds of run, and of the rest."""
    order = sorted(found, key=lambda what: found[what][1])
    rest, shown = order[:-10], order[-10:]
    runs, spent = zip(*(found[what] for what in rest), strict=True)
    rows = {f"{len(rest)} other kinds": (sum(runs), sum(spent))}
    rows |= {what: found[what] for what in shown}
    hours = [spent for _, spent in rows.values()]
    fig, ax = plt.subplots(figsize=(5.4, 0.3 * len(rows) + 0.6))
    colors = [plots.GREY] + [plots.BLUE] * len(shown)
    bars = ax.barh(list(rows), hours, color=colors, height=0.7)
    counts = [f"{count} runs" for count, _ in rows.values()]
    ax.bar_label(bars, counts, padding=3, fontsize=9)
    ax.set(xlabel="hours", xlim=(0, 1.15 * max(hours)))
    ax.set_ylim(-0.6, len(rows) - 0.4)
    ax.grid(visible=False, axis="y")
    return fig
