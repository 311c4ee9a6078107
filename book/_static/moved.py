"""Draw the maze whose wall has moved, with its old and its new policies.

The runs are `maze-imitation` and `maze-transfer`, at demo scale.

.venv/bin/python book/_static/moved.py
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

BOOK = Path(__file__).parents[1]
sys.path.append(str(BOOK))

import plots  # noqa: E402
from figures.transfer import EDGE, RIGHT, walk  # noqa: E402
from offairl_lite.runs import records  # noqa: E402

source, again = (
    records.read(BOOK / f"records/maze-{name}-demo")
    for name in ("imitation", "transfer")
)
with plots.style():
    plt.rcParams["svg.hashsalt"] = "moved"
    fig, axes = plt.subplots(1, 2, figsize=(5.4, 2.9))
    for ax, title, policy, color in zip(
        axes,
        ("the old policies", "new policies, old reward"),
        (source.policy, again.policy),
        (plots.COPY, plots.AGENT),
        strict=True,
    ):
        plots.reward_map(ax, source.reward, "Right", 0)
        ax.axis("off")
        ax.set_title(title)
        for path in walk(policy, RIGHT):
            (line,) = ax.plot(*path.T, color=color, lw=2.6, zorder=4)
            line.set_path_effects(EDGE)
            ax.plot(
                *path[-1], "o", color=color, ms=8, mec="white", zorder=5
            )
    fig.savefig(BOOK / "_static/moved.svg", metadata={"Date": None})
