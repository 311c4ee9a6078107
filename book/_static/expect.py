"""Draw how far every recorded seed of the recipe and of DAC has come.

The runs are those of the table of `recipe_settings.md`.

PYTHONPATH=book .venv/bin/python book/_static/expect.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import plots
from offairl_lite import demonstrations
from offairl_lite.runs import records

BOOK = Path(__file__).parents[1]
ROBOTS = ("Hopper", "Walker2d", "HalfCheetah", "CustomAnt", "Ant")
METHODS = {"airl": ("the recipe", plots.BLUE), "dac": ("DAC", plots.ORANGE)}


def ends(robot, method, steps):
    """Return percent of the expert after so many steps, of all seeds."""
    loss = "released" if method == "airl" else method
    found = []
    for name in (
        f"what-decides-demo/{robot}-{loss}-fixed-short",
        f"what-decides-more-demo/{robot}-{loss}-fixed-short",
        f"locomotion-demo/{robot}-{method}",
        f"locomotion-again-demo/{robot}-{method}",
    ):
        if (BOOK / "records" / name).is_dir():
            run = records.read(BOOK / "records" / name)
            found.append(run.returns[:, run.steps == steps].ravel())
    noted = records.read_json(demonstrations.EXPERTS / f"{robot}.json")
    return 100 * np.concatenate(found) / noted["returns"][0]


with plots.style():
    plt.rcParams["svg.hashsalt"] = "expect"
    fig, axes = plt.subplots(1, 2, figsize=(6.2, 3.9), sharey=True)
    for ax, steps in zip(axes, (100_000, 500_000), strict=True):
        for row, robot in enumerate(ROBOTS):
            for (method, (_, color)), y in zip(
                METHODS.items(), (-0.18, 0.18), strict=True
            ):
                found = np.sort(ends(robot, method, steps))
                spread = row + y + np.linspace(-0.1, 0.1, len(found))
                ax.plot(found, spread, "o", color=color, alpha=0.6, ms=5)
                ax.plot(np.median(found), row + y, "|k", ms=13, mew=2)
        ax.axvline(100, color=plots.EXPERT, ls="--", lw=1.2, zorder=0)
        ax.set(title=f"{steps:,} steps", xlim=(-5, 172))
        ax.set(xticks=(0, 50, 100, 150), xlabel="% of the expert")
    axes[0].set(yticks=range(5), yticklabels=ROBOTS, ylim=(4.6, -0.6))
    axes[0].text(118, -0.12, "the recipe", color=plots.BLUE)
    axes[0].text(118, 0.25, "DAC", color=plots.ORANGE)
    fig.savefig(BOOK / "_static/expect.svg", metadata={"Date": None})
