"""The picture of a run, `curve.png` in its folder: what to look at while it trains."""

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter
from PIL import Image

from offairl_lite.analysis import plots
from offairl_lite.core.results import Row
from offairl_lite.runs import records

COLOURS = (plots.BLUE, plots.ORANGE, plots.GREEN, plots.RED, plots.PURPLE)
"""Of the first five seeds; those of the next five are dashed."""
RETURN = "return, by the task's own reward"
LEARNED = "return, by the frozen reward:\nit should rise"


def numbers(row: Row, before: Row) -> dict[str, float]:
    """Return what is drawn of an evaluation, by its title; NaN where there is none."""
    metric, episodes = row.metrics.get, row.episodes - before.episodes
    gap = metric("expert_logit", math.nan) - metric("policy_logit", math.nan)
    return {
        RETURN: row.mean_return,
        LEARNED: row.learned_return,
        "logit gap, expert minus policy:\na few nats, it should shrink": gap,
        "entropy of the verdict:\nit should rise": metric("entropy", math.nan),
        "steps of an episode in training:\nabout as many as demonstrated": (
            (row.step - before.step) / episodes if episodes else math.nan
        ),
    }


def draw(folder: Path) -> None:
    """Draw the evaluations of a run so far in its `curve.png`, which is always whole.

    A panel that would show nothing but 0 is left out, as is the return of a task without a reward,
    one of numbers that the run does not have, and the return by a reward that still changes.
    """
    run = records.read(folder)
    start = Row(0, 0, 0, math.nan, (), math.nan, {})
    members = [[start, *(row for row in run.rows if row.seed == seed)] for seed in run.seeds]
    drawn = [[numbers(row, before) for before, row in pairwise(rows)] for rows in members]
    panels = {k: [[at[k] for at in row] for row in drawn] for k in numbers(start, start)}
    panels = {k: y for k, y in panels.items() if np.nan_to_num(np.concatenate(y)).any()}
    if run.config.reward != "frozen":
        panels.pop(LEARNED, None)
    if not panels:
        return
    names = [*panels, *list(panels)[len(panels) - len(panels) % 2 :]]  # two in a row, for phones
    mosaic: Any = [names[i : i + 2] for i in range(0, len(names), 2)]
    with plots.style():
        # Where panels and margins are is said here: to find it out would double the time it takes.
        height = 2.5 * len(mosaic) + 0.8
        figure = Figure(figsize=(6, height), dpi=120)
        figure.set_layout_engine("none")
        canvas = FigureCanvasAgg(figure)
        edges = {"left": 0.09, "right": 0.97, "bottom": 0.75 / height, "top": 1 - 0.75 / height}
        places = figure.subplot_mosaic(mosaic, gridspec_kw={**edges, "hspace": 0.55, "wspace": 0.3})
        for title, axes in places.items():
            for i, ((_, *rows), y) in enumerate(zip(members, panels[title], strict=True)):
                x, dash = [row.step for row in rows], ".--" if i % 10 > 4 else ".-"
                axes.plot(x, y, dash, color=COLOURS[i % 5], label=f"seed {run.seeds[i]}")
            axes.set_title(title, loc="left")
            axes.set_xlim(0, run.config.total_steps)
            axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        if len(run.seeds) <= 10:
            seeds = axes.get_legend_handles_labels()
            figure.legend(*seeds, loc="lower center", ncols=5, columnspacing=1, handlelength=1.5)
        failed = f"; diverged: {', '.join(map(str, run.diverged))}" if run.diverged else ""
        step, total = (f"{n:,}" for n in (run.steps[-1], run.config.total_steps))
        name = f"{folder.absolute().name} on {run.config.env_id}"
        figure.suptitle(f"{name}: step {step} of {total}{failed}", wrap=True)
        canvas.draw()
    # Few colours will do, and make the file a third as large.
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB").quantize(64)
    records.write_whole(folder / records.PICTURE, lambda part: picture.save(part, "png"))
