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
    fig, (lives, curves) = plt.subplots(
        2, 1, figsize=(5.4, 4.8), sharex=True, height_ratios=(4, 5)
    )
    begins, ends = zip(*kept["lives"], strict=True)
    for y, (begin, end) in enumerate(kept["lives"], 1):
        saved = begins[y] if y < len(begins) else end
        whole = {"lw": 7, "solid_capstyle": "butt", "color": plots.BLUE}
        lives.plot([begin, saved], [y, y], **whole)
        lives.plot([saved, end], [y, y], alpha=0.3, **whole)
        if y < len(begins):
            lives.plot(end, y, "X", color=plots.RED, ms=11, mec="white")
            lives.plot([saved] * 2, [y, y + 1], color=plots.BLUE, lw=1)
    lives.plot(ends[-1], len(ends), "*", color=plots.STAR, ms=15)
    names = [f"life {n}" for n in range(1, len(ends) + 1)]
    lives.set_yticks(range(1, len(names) + 1), names)
    lives.set_ylim(len(names) + 0.6, 0.4)
    lives.tick_params(length=0)
    lives.grid(visible=False)
    for side in lives.spines.values():
        side.set_visible(False)
    for i, (alone, killed) in enumerate(
        zip(kept["alone"], kept["killed"], strict=True)
    ):
        names = (
            ("left alone", "killed five times") if not i else (None,) * 2
        )
        wide = {"color": plots.ORANGE, "lw": 8, "alpha": 0.4}
        curves.plot(kept["steps"], alone, label=names[0], **wide)
        thin = {"color": plots.BLUE, "lw": 1, "label": names[1]}
        curves.plot(kept["steps"], killed, ".-", **thin)
    curves.set(xlabel="steps", ylabel="return of three seeds")
    curves.set(xlim=(2500, 6200), ylim=(-30, -5))
    curves.legend(loc="lower right")
    fig.savefig(BOOK / "_static/killed.svg", metadata={"Date": None})
