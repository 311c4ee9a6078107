"""Draw what one recorded episode is: T + 1 observations, T actions.

.venv/bin/python book/_static/recordings.py
"""

from pathlib import Path

import matplotlib.pyplot as plt

from offairl_lite.analysis import plots

BOOK = Path(__file__).parents[1]
ENDS = (
    (3, "terminated=True", "it fell, or finished", plots.RED),
    (4, "terminated=False", "time limit, or cut off", plots.GREEN),
)

with plots.style():
    plt.rcParams["svg.hashsalt"] = "recordings"
    fig, ax = plt.subplots(figsize=(4.4, 2.5))
    for row, (steps, written, why, color) in enumerate(ENDS):
        y = -1.75 * row
        for t in range(steps):
            ax.annotate(
                "",
                (t + 0.84, y),
                (t + 0.16, y),
                arrowprops={"arrowstyle": "-|>", "color": plots.ORANGE},
            )
        ax.plot(range(steps), [y] * steps, "o", color=plots.BLUE, ms=11)
        ax.plot(steps, y, "o", color=color, ms=11)
        ax.text(
            steps, y - 0.42, written, color=color, ha="center", va="top"
        )
        ax.text(steps, y - 0.78, why, ha="center", va="top", fontsize=9)
    ax.text(0.1, 0.35, "an observation", color=plots.BLUE, ha="center")
    ax.text(1.9, 0.35, "an action", color=plots.ORANGE, ha="center")
    ax.text(
        3.5, 0, "3 actions,\n4 observations", va="center", color=plots.GREY
    )
    ax.set(xlim=(-0.7, 5.4), ylim=(-3, 0.8))
    ax.axis("off")
    fig.savefig(BOOK / "_static/recordings.svg", metadata={"Date": None})
