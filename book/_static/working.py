"""Draw what a good and a failed run look like from inside.

The runs are those of the table of `recipe_working.md`.

.venv/bin/python book/_static/working.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from offairl_lite.analysis import plots
from offairl_lite.runs import records

BOOK = Path(__file__).parents[1]
RUNS = {
    "works": ("what-decides-demo/{}-released-fixed-short", plots.BLUE),
    "fails": ("locomotion-first-demo/{}-airl", plots.RED),
}


def numbers(run, value):
    """Return a diagnostic of all seeds (K, S) at K evaluations."""
    found = [value(row.metrics) for row in run.rows]
    return np.reshape(found, (len(run.steps), len(run.seeds)))


with plots.style():
    plt.rcParams["svg.hashsalt"] = "working"
    fig, axes = plt.subplots(
        2, 2, figsize=(6.2, 4.6), sharex=True, sharey="row"
    )
    for (top, low), robot in zip(
        axes.T, ("Hopper", "Walker2d"), strict=True
    ):
        for name, color in RUNS.values():
            run = records.read(BOOK / "records" / name.format(robot))
            early = run.steps <= 100_000
            steps = run.steps[early] / 1_000
            gap = numbers(
                run, lambda m: m["expert_logit"] - m["policy_logit"]
            )
            entropy = numbers(run, lambda m: m["entropy"])
            top.semilogy(steps, gap[early], color=color, lw=1.3, alpha=0.8)
            low.plot(steps, entropy[early], color=color, lw=1.3, alpha=0.8)
        top.set_title(robot)
        low.axhline(np.log(2), color=plots.GREY, ls="--", lw=1.2)
        low.set(xlabel="thousand steps", ylim=(0, 0.75), xlim=(0, 102))
    axes[0, 0].set(ylabel="logit gap")
    axes[1, 0].set(ylabel="entropy of the verdict")
    axes[0, 0].text(60, 3.4, "works", color=plots.BLUE)
    axes[0, 0].text(45, 600, "fails", color=plots.RED)
    axes[1, 1].text(
        100, 0.63, "cannot tell them apart", color=plots.GREY, ha="right"
    )
    fig.savefig(BOOK / "_static/working.svg", metadata={"Date": None})
