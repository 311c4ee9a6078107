"""Draw what becomes of the recipe if one of its four settings is changed.

The runs are those of the note *What decides*, and one without an absorbing
state: all seeds, after 100,000 steps.

PYTHONPATH=book .venv/bin/python book/_static/settings.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import plots
from offairl_lite import demonstrations
from offairl_lite.runs import records

BOOK = Path(__file__).parents[1]
ROBOTS = ("Hopper", "Walker2d", "HalfCheetah", "CustomAnt")
RECIPE = "what-decides-demo/{}-released-fixed-short"
CHANGED = {
    "the AIRL loss": "what-decides-demo/{}-exact-fixed-short",
    "a temperature of 1": "what-decides-demo/{}-released-one-short",
    "10,000 random steps": "what-decides-demo/{}-released-fixed-long",
    "nothing after the end": "hopper-none-demo/{}-released-fixed-short",
}


def ends(name, robot):
    """Return percent of the expert without noise after 100,000 steps."""
    folder = BOOK / "records" / name.format(robot)
    if not folder.is_dir():
        return np.empty(0)
    run = records.read(folder)
    noted = records.read_json(demonstrations.EXPERTS / f"{robot}.json")
    found = run.returns[:, run.steps == 100_000].ravel()
    return 100 * found / noted["returns"][0]


with plots.style():
    plt.rcParams["svg.hashsalt"] = "settings"
    fig, axes = plt.subplots(
        2, 2, figsize=(5.4, 4.8), sharex=True, sharey=True
    )
    for ax, (title, changed) in zip(
        axes.flat, CHANGED.items(), strict=True
    ):
        for row, robot in enumerate(ROBOTS):
            other = ends(changed, robot)
            if not len(other):
                continue
            for found, y, color in (
                (ends(RECIPE, robot), -0.16, plots.BLUE),
                (other, 0.16, plots.RED),
            ):
                at = np.full(len(found), row + y)
                ax.plot(found, at, "o", color=color, alpha=0.7, ms=5.5)
        ax.axvline(100, color=plots.EXPERT, ls="--", lw=1.2, zorder=0)
        ax.set_title(title, color=plots.RED)
        ax.set(xlim=(-8, 112), xticks=(0, 50, 100))
        ax.set(yticks=range(4), yticklabels=ROBOTS, ylim=(3.6, -0.6))
    for ax in axes[1]:
        ax.set(xlabel="% of the expert")
    axes[1, 1].text(5, 1.4, "the recipe", color=plots.BLUE)
    axes[1, 1].text(5, 2.3, "one setting\nchanged", color=plots.RED)
    fig.savefig(BOOK / "_static/settings.svg", metadata={"Date": None})
