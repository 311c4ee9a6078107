"""What the pages draw: curves, levels, and maps of the maze."""

import math
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.image import AxesImage
from matplotlib.patheffects import withStroke
from matplotlib.quiver import Quiver

from offairl_lite.analysis.plots import (  # noqa: F401
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    RED,
    style,
)
from offairl_lite.analysis.statistics import (
    bootstrap_interval,
    interquartile_mean,
)
from offairl_lite.core.rewards import Reward
from offairl_lite.envs.models import (
    GOAL,
    LENGTH,
    START,
    WALL_RADIUS,
    Side,
    walls,
)
from offairl_lite.tabular import MOVES

EXPERT = "#5a1fd6"
"""Of experts and their demonstrations: violet, in figures and toys."""
COPY = "#2f7fd0"
"""Of a policy that imitates, and of the old one in a new world: blue."""
AGENT = "#ffc21a"
"""Of an agent that plans or trains on the learned reward: yellow."""
REWARD = "#009e73"
"""Of a reward that was learned: green."""
STAR = "#ff4d9d"
"""Of the goal: pink."""
INK = "#25213f"
"""Of the thin rim that sets them off."""
REWARD_MAP = LinearSegmentedColormap.from_list(
    "reward",
    ["#262340", "#22454f", "#1c6f6b", "#1d9c82", "#45cf9d", "#b6ffd9"],
)
"""Of maps of a reward or a value: green is high."""


def curve(
    ax: Axes,
    steps: Float[np.ndarray, "K"],
    returns: Float[np.ndarray, "S K"],
    label: str,
    color: str = BLUE,
    linestyle: str = "-",
) -> None:
    """Draw the curves of S seeds, and their interquartile mean.

    The band is its bootstrap interval of 95 % at each of K evaluations.
    """
    low, high = bootstrap_interval(returns)
    ax.fill_between(steps, low, high, color=color, alpha=0.2, linewidth=0)
    ax.plot(steps, returns.T, color=color, alpha=0.35, linewidth=0.7)
    mean = interquartile_mean(returns)
    rim = {
        "linewidth": 2.4,
        "path_effects": [withStroke(linewidth=3.2, foreground=INK)],
    }  # or yellow could not be seen on white
    ax.plot(
        steps,
        mean,
        color=color,
        linestyle=linestyle,
        label=label,
        **(rim if color == AGENT else {}),
    )


def level(
    ax: Axes,
    value: float,
    label: str,
    color: str = GREY,
    linestyle: str = "--",
    side: str = "right",
) -> None:
    """Draw a horizontal reference line with a label.

    The label stands above the line at its `right` or `left` end, or
    `outside`, right of the panel.
    """
    ax.axhline(value, color=color, linestyle=linestyle, linewidth=1.2)
    at: Any = {
        "xycoords": ("axes fraction", "data"),
        "textcoords": "offset points",
    }
    x, offset, ha, va = {
        "right": (1, (0, 3), "right", "baseline"),
        "left": (0, (4, 3), "left", "baseline"),
        "outside": (1, (4, 0), "left", "center"),
    }[side]
    ax.annotate(
        label,
        (x, value),
        offset,
        ha=ha,
        va=va,
        color=color,
        fontsize="small",
        **at,
    )


class _Walls(LineCollection):
    """Lines as wide as the walls."""

    def draw(self, renderer) -> None:
        # The width is in points, and the axes now have their final size.
        assert self.axes is not None
        ends = self.axes.transData.transform([(0, 0), (2 * WALL_RADIUS, 0)])
        self.set_linewidth(np.ptp(ends[:, 0]) * 72 / self.axes.figure.dpi)
        super().draw(renderer)


def maze(ax: Axes, side: Side | None) -> None:
    """Draw walls, start and goal; without a side there is no barrier."""
    ax.add_collection(
        _Walls(
            list(walls(side)), colors="black", capstyle="round", zorder=2
        )
    )
    ax.set(
        xlim=(-0.14, LENGTH + 0.04),
        ylim=(-0.14, LENGTH + 0.04),
        aspect="equal",
    )
    ax.set(
        xticks=[0, 0.3, 0.6],
        yticks=[0, 0.3, 0.6],
        xlabel="x (m)",
        ylabel="y (m)",
    )
    ax.grid(False)
    ax.plot(*START, "o", color="white", markeredgecolor="black", zorder=3)
    ax.plot(
        *GOAL,
        "*",
        color=STAR,
        markeredgecolor="black",
        markersize=13,
        zorder=3,
    )


def reward_map(
    ax: Axes,
    reward: Reward,
    side: Side,
    member: int = 0,
    resolution: int = 81,
) -> AxesImage:
    """Draw a seed's r(s) over the maze, shifted so that its best is 0."""
    inner = np.linspace(-0.08, LENGTH - 0.02, resolution)
    x, y = np.meshgrid(inner, inner)
    obs = torch.as_tensor(np.stack([x, y, 0 * x], -1), dtype=torch.float32)
    value = (
        reward.member(member)
        .to("cpu")(obs.view(1, -1, 3))
        .view(x.shape)
        .numpy()
    )
    half = (inner[1] - inner[0]) / 2  # a pixel is centred on its point
    return _image(
        ax, value - value.max(), side, inner[0] - half, inner[-1] + half
    )


def grid(ax: Axes, values: Float[np.ndarray, "S"], side: Side) -> AxesImage:
    """Draw a function of the state of `tabular.maze` over the maze."""
    cells = math.isqrt(len(values))
    return _image(
        ax,
        values.reshape(cells, cells),
        side,
        walls(side).min(),
        walls(side).max(),
    )


def _image(
    ax: Axes, values: np.ndarray, side: Side, low: float, high: float
) -> AxesImage:
    """Draw values, from `low` to `high` along x and y, under the maze."""
    extent = (low, high, low, high)
    image = ax.imshow(
        values, origin="lower", extent=extent, cmap=REWARD_MAP, zorder=1
    )
    maze(ax, side)
    return image


def arrows(
    ax: Axes,
    policy: Float[np.ndarray, "S A"],
    positions: Float[np.ndarray, "S 2"],
    color: str = "white",
) -> Quiver:
    """Draw a policy's mean move in each square of `tabular.maze`.

    Where the policy is undecided, its moves cancel and the arrow is short.
    """
    size = np.ptp(positions[:, 0]) / (math.isqrt(len(positions)) - 1)
    move = 0.9 * size * (policy @ MOVES)
    in_metres: Any = {
        "angles": "xy",
        "scale_units": "xy",
        "scale": 1,
        "pivot": "mid",
    }
    look: Any = {
        "width": 0.004,
        "headwidth": 4,
        "color": color,
        "zorder": 1.5,
    }
    return ax.quiver(*positions.T, *move.T, **in_metres, **look)


def few_arrows(
    ax: Axes,
    policy: Float[np.ndarray, "S A"],
    positions: Float[np.ndarray, "S 2"],
) -> None:
    """Draw outlined arrows in every other square of every other row."""
    squares = np.arange(len(policy)).reshape(-1, math.isqrt(len(policy)))
    chosen = squares[1:-1:2, 1:-1:2].ravel()
    heads = arrows(ax, policy[chosen], positions[chosen])
    outline = withStroke(linewidth=1.4, foreground="black")
    heads.set(path_effects=[outline])
    heads.width = 0.007
