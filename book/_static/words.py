"""Draw how the glossary's main words belong together.

PYTHONPATH=book .venv/bin/python book/_static/words.py
"""

from pathlib import Path

import matplotlib.pyplot as plt

import plots
from drawing import diagram

plt.rcParams.update({"svg.hashsalt": "words", "font.size": 12})
fig, ax = diagram(
    (4.8, 5.2),  # two columns, which a phone can show, too
    {
        "expert": (1.0, 4.85, "expert", plots.EXPERT),
        "demos": (1.0, 4.0, "demonstrations", plots.EXPERT),
        "judge": (3.9, 3.55, "discriminator"),
        "replay": (1.0, 3.1, "replay buffer", plots.COPY),
        "agent": (1.0, 2.25, "agent", plots.COPY),
        "reward": (3.9, 2.25, "reward", plots.REWARD),
        "frozen": (3.9, 1.1, "frozen reward", plots.REWARD),
        "new": (1.0, 1.1, "new policy", plots.AGENT),
        "goal": (1.0, 0.3, "arrives", plots.AGENT),
    },
    [
        ("expert", "demos"),
        ("demos", "judge", "label 1"),
        ("agent", "replay"),
        ("replay", "judge", "label 0"),
        ("judge", "reward", "logit"),
        ("reward", "agent", "SAC"),
        ("reward", "frozen"),
        ("frozen", "new", "transfer"),
        ("new", "goal"),
    ],
)
ax.axhline(1.7, color=plots.GREY, lw=1, ls=":")
below = {"color": plots.GREY, "style": "italic", "ha": "left"}
ax.text(1.9, 1.73, "the old maze", va="bottom", **below)
ax.text(1.9, 1.65, "the wall has moved", va="top", **below)
here = Path(__file__).parent
fig.savefig(here / "words.svg", metadata={"Date": None})
