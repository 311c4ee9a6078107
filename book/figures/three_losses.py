"""The picture of the note on three losses."""

from collections.abc import Mapping

import matplotlib.pyplot as plt

from offairl_lite.analysis import plots

EXPERTS = {"HalfCheetah": 9_947, "Walker2d": 4_545}
"""What each robot's expert returns without noise."""
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


def causes(robots: Mapping[str, Mapping]) -> None:
    """Draw how each run ends, and its best evaluation, in percent."""
    rows = [name for name in CAUSES if name in robots["HalfCheetah"]]
    with plots.style():
        _, axes = plt.subplots(
            1, 2, figsize=(5.4, 0.36 * len(rows) + 0.9), sharey=True
        )
        for ax, (robot, runs) in zip(axes, robots.items(), strict=True):
            for y, name in enumerate(rows):
                if name not in runs:
                    continue
                color = CAUSES[name][1]
                returns = 100 * runs[name]["returns"] / EXPERTS[robot]
                look = {"color": color, "mew": 1.5}
                ax.plot(returns[:, -1], [y] * 5, "o", alpha=0.7, **look)
                ax.plot(returns.max(), y, "|", ms=11, **look)
            ax.axvline(0, color=plots.GREY, lw=0.8)
            ax.set(title=robot, xlabel="% of the expert")
            ax.grid(visible=False, axis="y")
        axes[0].set_yticks(range(len(rows)), [CAUSES[x][0] for x in rows])
        axes[0].set(ylim=(len(rows) - 0.5, -0.6))
        plt.show()
