"""Draw a run that was killed five times, for `running_at_scale.md`.

.venv/bin/python book/_static/killed.py
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

BOOK = Path(__file__).parents[1]
sys.path.insert(0, str(BOOK))

import plots  # noqa: E402
import rollouts  # noqa: E402

kept = rollouts.read("killed")
with plots.style():
    plt.rcParams["svg.hashsalt"] = "killed"
    fig, axes = plt.subplots(
        2, 1, figsize=(5.4, 4.8), sharex=True, height_ratios=(5, 4)
    )
    top, low = axes
    steps = kept["steps"]
    for i, (alone, killed) in enumerate(
        zip(kept["alone"], kept["killed"], strict=True)
    ):
        names = (
            ("left alone", "killed five times") if not i else (None,) * 2
        )
        wide = {"color": plots.ORANGE, "lw": 8, "alpha": 0.4}
        top.plot(steps, alone, label=names[0], **wide)
        top.plot(
            steps, killed, ".-", color=plots.BLUE, label=names[1], lw=1
        )
    top.set(ylabel="return of three seeds", ylim=(-30, -5))
    top.legend(loc="lower right")
    *died, last = kept["lives"]
    for y, (begin, end) in enumerate(kept["lives"], 1):
        low.plot([begin, end], [y, y], color=plots.BLUE, lw=5, alpha=0.6)
    for y, (_, end) in enumerate(died, 1):
        low.plot(end, y, "X", color=plots.RED, ms=11, mec="white")
    low.plot(last[1], len(died) + 1, "*", color=plots.STAR, ms=15)
    names = [f"life {n}" for n in range(1, len(kept["lives"]) + 1)]
    low.set_yticks(range(1, len(names) + 1), names)
    low.set(ylim=(len(names) + 0.6, 0.4), xlabel="steps")
    low.set_xlim(0, 6200)
    fig.savefig(BOOK / "_static/killed.svg", metadata={"Date": None})
