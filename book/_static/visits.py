"""Draw where an expert goes from one start, and from everywhere.

It is the expert of `notes/unvisited_states.ipynb`.

PYTHONPATH=book .venv/bin/python book/_static/visits.py
"""

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import plots
from offairl_lite import tabular

BOOK = Path(__file__).parents[1]
world = tabular.maze(20, "Left")
expert = tabular.soft_value_iteration(world.mdp, world.reward, 0.05)
states = world.mdp.num_states
everywhere = replace(world.mdp, initial=np.full(states, 1 / states))

with plots.style():
    plt.rcParams["svg.hashsalt"] = "visits"
    fig, axes = plt.subplots(1, 2, figsize=(5.2, 3.1))
    for ax, title, process in zip(
        axes,
        ("from the bottom", "from everywhere"),
        (world.mdp, everywhere),
        strict=True,
    ):
        visits = tabular.occupancy(process, expert.policy).sum(1)
        seen = np.log10(np.maximum(visits, 1e-10))
        image = plots.grid(ax, seen, "Left")
        image.set_clim(-10, 1)
        ax.axis("off")
        ax.set_title(title)
    bar = fig.colorbar(image, ax=axes, shrink=0.75, label="visits")
    bar.set_ticks([-10, -5, 0], labels=["$10^{-10}$", "$10^{-5}$", "1"])
    fig.savefig(BOOK / "_static/visits.svg", metadata={"Date": None})
