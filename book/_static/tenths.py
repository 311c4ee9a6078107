"""Draw a policy's density in two units, for `notes/units_of_actions.ipynb`.

PYTHONPATH=book .venv/bin/python book/_static/tenths.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import plots

BOOK = Path(__file__).parents[1]
MEAN, WIDTH = 0.3, 0.2
UNITS = {"as it was": (1, plots.BLUE), "in tenths": (10, plots.RED)}

with plots.style():
    plt.rcParams["svg.hashsalt"] = "tenths"
    fig, axes = plt.subplots(1, 2, figsize=(4.8, 2.4), sharey=True)
    for ax, (title, (unit, color)) in zip(axes, UNITS.items(), strict=True):
        x = np.linspace(-unit, unit, 401)
        bell = np.exp(-((x / unit - MEAN) ** 2) / (2 * WIDTH**2))
        density = bell / (bell.sum() * (x[1] - x[0]))
        ax.fill_between(x, density, color=color, alpha=0.3, lw=0)
        ax.plot(x, density, color=color)
        ax.set_title(title, color=color)
        ax.set(xlabel="action", xticks=(-unit, 0, unit), ylim=(0, 2.2))
        ax.grid(visible=False, axis="x")
    axes[0].set(ylabel="density π", yticks=(0, 0.2, 1, 2))
    fig.savefig(BOOK / "_static/tenths.svg", metadata={"Date": None})
