"""Draw the front page's and the README's picture from recorded demo runs.

.venv/bin/python book/_static/front.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from offairl_lite import demonstrations
from offairl_lite.analysis import plots
from offairl_lite.core.rollouts import rollout
from offairl_lite.runs import records

BOOK = Path(__file__).parents[1]

imitation = records.read(BOOK / "records/maze-imitation-demo")
transfer = records.read(BOOK / "records/maze-transfer-demo")
best = int(np.argmax(transfer.returns[:, -1]))
expert = demonstrations.load(imitation.config.env_id, trajectories=50)
shown = expert.transitions.obs.view(50, 100, 3)[:12].numpy()
moved = rollout(
    transfer.policy, transfer.config.env_id, transfer.seeds, 6, sample=True
).obs[best]

with plots.style():
    fig, axes = plt.subplots(1, 3, figsize=(9, 3.3), sharey=True)
    plots.maze(axes[0], "Left")
    plots.trajectories(axes[0], shown)
    plots.reward_map(axes[1], imitation.reward, "Left", best)
    plots.reward_map(axes[2], imitation.reward, "Right", best)
    plots.trajectories(axes[2], moved, plots.ORANGE)
    titles = (
        "demonstrations",
        "the reward learned from them",
        "the wall has moved",
    )
    for ax, title in zip(axes, titles, strict=True):
        ax.set_title(title)
        ax.set_axis_off()
    fig.savefig(BOOK / "_static/front.png", dpi=150)
