"""The picture of the note on three losses."""

from collections.abc import Mapping

import matplotlib.pyplot as plt

from offairl_lite.analysis import plots

EXPERT = 9_947
"""What HalfCheetah's expert returns without noise."""
CAUSES = {
    "log-ratio": ("the log-ratio loss", plots.BLUE),
    "exact": ("the AIRL loss", plots.RED),
    "density of the replay": ("the replay's own density", plots.GREEN),
    "clip -10": ("log π cut off at −10", plots.GREY),
    "clip -20": ("log π cut off at −20", plots.GREY),
    "last 1,000": ("the last 1,000 steps alone", plots.GREY),
    "last 10,000": ("the last 10,000 steps alone", plots.GREY),
    "penalty 1": ("a penalty of 1", plots.GREY),
    "penalty 0.1": ("a penalty of 0.1", plots.GREY),
    "penalty 0": ("no penalty", plots.GREY),
    "temperature 1.2": ("a temperature of 1.2", plots.GREY),
    "temperature 1.2, penalty 0.1": ("1.2, a penalty of 0.1", plots.ORANGE),
    "temperature 1.2, penalty 0": ("1.2, no penalty", plots.ORANGE),
}


def causes(robot: Mapping[str, Mapping]) -> None:
    """Draw how each run ends, and its best evaluation, in percent."""
    rows = {name: robot[name] for name in CAUSES if name in robot}
    with plots.style():
        _, ax = plt.subplots(figsize=(5.4, 0.42 * len(rows) + 0.6))
        for y, (name, run) in enumerate(rows.items()):
            color = CAUSES[name][1]
            returns = 100 * run["returns"] / EXPERT
            ax.plot(returns[:, -1], [y] * 5, "o", color=color, alpha=0.7)
            ax.plot(returns.max(), y, "|", color=color, ms=11, mew=1.5)
        ax.axvline(0, color=plots.GREY, lw=0.8)
        names = [CAUSES[name][0] for name in rows]
        ax.set_yticks(range(len(rows)), names)
        ax.set(ylim=(len(rows) - 0.5, -0.6), xlabel="% of the expert")
        ax.grid(visible=False, axis="y")
        plt.show()
