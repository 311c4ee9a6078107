"""The book's figures, in one style for all pages and readers: colours of Okabe and Ito (2008)."""

from functools import partial
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import torch
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.image import AxesImage

from offairl_lite.analysis.statistics import bootstrap_interval, interquartile_mean
from offairl_lite.core.rewards import Reward
from offairl_lite.envs.models import GOAL, LENGTH, START, WALL_RADIUS, Side, walls

BLUE, ORANGE, GREEN, RED, PURPLE = "#0072B2", "#E69F00", "#009E73", "#CC3311", "#AA3399"
GREY = "#7f7f7f"

STYLE: Any = {
    "figure.figsize": (6.4, 3.4),
    "figure.dpi": 110,
    # A white background is legible on a light and on a dark page.
    "figure.facecolor": "white",
    "figure.constrained_layout.use": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.titlesize": "medium",
    "grid.alpha": 0.3,
    "legend.frameon": False,
    "legend.fontsize": "small",
    "lines.linewidth": 1.8,
}

style = partial(plt.rc_context, STYLE)  #: A context whose figures have the book's style.


def curve(
    ax: Axes,
    steps: Float[np.ndarray, "K"],
    returns: Float[np.ndarray, "S K"],
    label: str,
    color: str = BLUE,
    linestyle: str = "-",
) -> None:
    """Draw the learning curve of S seeds: each one, their interquartile mean and its 95 % interval.

    The band is the bootstrap interval of the mean at the environment steps of K evaluations.
    """
    low, high = bootstrap_interval(returns)
    ax.fill_between(steps, low, high, color=color, alpha=0.2, linewidth=0)
    ax.plot(steps, returns.T, color=color, alpha=0.35, linewidth=0.7)
    mean = interquartile_mean(returns)
    ax.plot(steps, mean, color=color, linestyle=linestyle, label=label)


def level(ax: Axes, value: float, label: str, color: str = GREY, linestyle: str = "--") -> None:
    """Draw a horizontal reference line with a label at its right end."""
    ax.axhline(value, color=color, linestyle=linestyle, linewidth=1.2)
    at: Any = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points"}
    ax.annotate(label, (1, value), (0, 3), ha="right", color=color, fontsize="small", **at)


class _Walls(LineCollection):
    """Lines as wide as the walls."""

    def draw(self, renderer) -> None:
        # The width is in points, so it can be computed only when the axes have their final size.
        assert self.axes is not None
        ends = self.axes.transData.transform([(0, 0), (2 * WALL_RADIUS, 0)])
        self.set_linewidth(np.ptp(ends[:, 0]) * 72 / self.axes.figure.dpi)
        super().draw(renderer)


def maze(ax: Axes, side: Side | None) -> None:
    """Draw the walls, start and goal of the maze with this side; with None, without a barrier."""
    ax.add_collection(_Walls(list(walls(side)), colors="black", capstyle="round", zorder=2))
    ax.set(xlim=(-0.14, LENGTH + 0.04), ylim=(-0.14, LENGTH + 0.04), aspect="equal")
    ax.set(xticks=[0, 0.3, 0.6], yticks=[0, 0.3, 0.6], xlabel="x (m)", ylabel="y (m)")
    ax.grid(False)
    ax.plot(*START, "o", color="white", markeredgecolor="black", zorder=3)
    ax.plot(*GOAL, "*", color=GREEN, markeredgecolor="black", markersize=13, zorder=3)


def reward_map(
    ax: Axes, reward: Reward, side: Side, member: int = 0, resolution: int = 81
) -> AxesImage:
    """Draw a seed's learned reward r(s) over the maze, shifted so that its largest value is 0."""
    inner = np.linspace(-0.08, LENGTH - 0.02, resolution)
    x, y = np.meshgrid(inner, inner)
    obs = torch.as_tensor(np.stack([x, y, 0 * x], -1), dtype=torch.float32)
    value = reward.member(member).to("cpu")(obs.view(1, -1, 3)).view(x.shape).numpy()
    half = (inner[1] - inner[0]) / 2  # a pixel is centred on its point
    edges = (inner[0] - half, inner[-1] + half)
    look: Any = {"origin": "lower", "extent": 2 * edges, "cmap": "cividis", "zorder": 1}
    image = ax.imshow(value - value.max(), **look)
    maze(ax, side)
    return image
