"""Draw how the glossary's main words belong together.

PYTHONPATH=book .venv/bin/python book/_static/words.py
"""

from pathlib import Path

import matplotlib.pyplot as plt

import plots
from drawing import diagram

plt.rcParams.update({"svg.hashsalt": "words", "font.size": 12})
fig, ax = diagram(
    (6.4, 4.0),
    {
        "expert": (0.6, 3.5, "expert", plots.EXPERT),
        "demos": (2.4, 3.5, "demonstrations", plots.EXPERT),
        "judge": (5.3, 2.85, "discriminator"),
        "agent": (0.6, 2.2, "agent", plots.COPY),
        "replay": (2.4, 2.2, "replay buffer", plots.COPY),
        "reward": (5.3, 1.5, "reward", plots.REWARD),
        "frozen": (5.3, 0.35, "frozen reward", plots.REWARD),
        "new": (2.4, 0.35, "new policy", plots.AGENT),
        "goal": (0.6, 0.35, "arrives", plots.AGENT),
    },
    [
        ("expert", "demos"),
        ("demos", "judge", "label 1"),
        ("agent", "replay"),
        ("replay", "judge", "label 0"),
        ("judge", "reward", "logit"),
        ("reward", "agent", "SAC", -0.12),
        ("reward", "frozen"),
        ("frozen", "new", "transfer"),
        ("new", "goal"),
    ],
)
ax.axhline(0.95, color=plots.GREY, lw=1, ls=":")
below = {"color": plots.GREY, "style": "italic", "ha": "left"}
ax.text(0.05, 1.05, "the old maze", va="bottom", **below)
ax.text(0.05, 0.87, "the wall has moved", va="top", **below)
here = Path(__file__).parent
fig.savefig(here / "words.svg", metadata={"Date": None})
