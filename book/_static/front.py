"""Draw the README's picture. It takes some minutes.

The reward is the one recorded at the paper's size; the policy for the moved
wall is trained here.

PYTHONPATH=book .venv/bin/python book/_static/front.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import plots
from drawing import EDGE
from offairl_lite import demonstrations, experiments
from offairl_lite.core.loop import train
from offairl_lite.core.rollouts import rollout
from offairl_lite.runs import records

BOOK = Path(__file__).parents[1]

imitation = records.read(BOOK / "records/maze-imitation-full")
reward = imitation.reward.member(*range(5))
config = experiments.find("maze-transfer").configs["demo"]
config = config.change(total_steps=25_000)
transfer = train(config, range(5), frozen_reward=reward)
best = int(np.argmax(transfer.returns[:, -1]))
expert = demonstrations.load(imitation.config.env_id, trajectories=50)
shown = expert.transitions.obs.view(50, 100, 3)[:12].numpy()
moved = rollout(transfer.policy, config.env_id, transfer.seeds, 1).obs[best]
print("returns:", transfer.returns[:, -1].round(1))

with plots.style():
    fig, axes = plt.subplots(1, 3, figsize=(9, 3.3), sharey=True)
    plots.maze(axes[0], "Left")
    axes[0].plot(*shown[..., :2].T, color=plots.EXPERT, alpha=0.7, lw=1)
    plots.reward_map(axes[1], reward, "Left", best)
    plots.reward_map(axes[2], reward, "Right", best)
    path = moved[0, :, :2].T
    axes[2].plot(*path, color=plots.AGENT, lw=2.5, path_effects=EDGE)
    titles = (
        "demonstrations",
        "the reward learned from them",
        "the wall has moved",
    )
    for ax, title in zip(axes, titles, strict=True):
        ax.set_title(title)
        ax.set_axis_off()
    fig.savefig(BOOK / "_static/front.png", dpi=150)
