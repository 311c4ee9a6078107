"""The pictures and tables of chapter 12."""

from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import HTML
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from numpy import ndarray as Array

import plots
from drawing import EDGE, table
from grid_worlds import CELLS, dense
from offairl_lite import tabular
from offairl_lite.tabular import MDP, soft_value_iteration

ALPHA = 0.05
WALL = "#f2545b"
WATER = "#a8dcff"
WORLDS = {"one world": plots.ORANGE, "two worlds": plots.BLUE}
"""Of what is learned from so many worlds, in all figures of the chapter."""
FINE = 40
"""Pixels along a square, which show the triangles in it."""
GOAL = divmod(int(tabular.maze(CELLS, "Left").reward.argmax()), CELLS)[::-1]


def _squares(ax: Axes, reward: Array) -> AxesImage:
    """Paint a reward of squares, or triangles of the moves from them."""
    shade = (reward - reward.min()) / np.ptp(reward)
    if shade.ndim == 1:
        pixels = shade.reshape(CELLS, CELLS)
    else:  # staying in the middle; right, up, left and down around it
        y, x = (np.indices((FINE, FINE)) + 0.5) / FINE - 0.5
        wide = np.where(x > 0, 1, 3), np.where(y > 0, 2, 4)
        move = np.where(abs(x) > abs(y), *wide)
        move[np.maximum(abs(x), abs(y)) < 0.2] = 0
        fine = shade.reshape(CELLS, CELLS, -1)[:, :, move]
        pixels = fine.swapaxes(1, 2).reshape(CELLS * FINE, CELLS * FINE)
    square = (-0.5, CELLS - 0.5)
    look = {"cmap": plots.REWARD_MAP, "interpolation": "none"}
    return ax.imshow(pixels, extent=square * 2, origin="lower", **look)


def draw_world(
    ax: Axes, mdp: MDP, reward: Array, color: str, policy: Array
) -> AxesImage:
    """Draw walls, a reward and the policy's likely way, as the toy does."""
    image = _squares(ax, reward)
    p = dense(mdp).max(1)  # the likeliest action that leads there
    for low in range(CELLS * (CELLS - 1)):
        if p[low, low + CELLS] == 0:
            row, column = divmod(low, CELLS)
            ends = [column - 0.5, column + 0.5]
            ax.plot(ends, [row + 0.5] * 2, color=WALL, lw=4)
    way = _way(mdp, policy)
    ax.plot(*way.T, color=color, lw=2.5, path_effects=EDGE, zorder=3)
    at = {"mec": "black", "zorder": 4, "ls": ""}
    ax.plot(*way[0], marker="o", color="white", ms=7, **at)
    ax.plot(*way[-1], marker="o", color=color, ms=8, **at)
    ax.plot(*GOAL, marker="*", color=plots.STAR, ms=14, **at)
    ax.set(xticks=[], yticks=[], aspect="equal")
    ax.set(xlim=(-0.5, CELLS - 0.5), ylim=(-0.5, CELLS - 0.5))
    ax.grid(False)
    return image


def _way(mdp: MDP, policy, steps=50) -> Array:
    state, way = int(mdp.initial.argmax()), []
    go = dense(mdp).argmax(-1)
    for _ in range(steps):
        way.append(divmod(state, CELLS)[::-1])
        state = go[state, policy[state].argmax()]
    return np.array(way)


def opening(
    shown: MDP, new: MDP, truth: Array, rewards: Mapping[str, Array]
) -> None:
    """Draw the expert's films, and what is planned on learned rewards."""
    wet = tabular.maze(CELLS, "Left", slip=0.3).mdp
    with plots.style(), plt.rc_context({"font.size": 12}):
        fig, axes = plt.subplots(2, 2, figsize=(5.4, 6.4))
    films = {"film 1: dry floor": shown, "film 2: wet floor": wet}
    for ax, (name, mdp) in zip(axes[0], films.items(), strict=True):
        expert = soft_value_iteration(mdp, truth, ALPHA).policy
        draw_world(ax, mdp, truth, plots.EXPERT, expert)
        ax.set_title(name)
    slipped = np.random.default_rng(0).random(CELLS**2) < 0.3
    drops = np.divmod(np.flatnonzero(slipped), CELLS)[::-1]
    drop = {"mec": "black", "mew": 0.5, "ms": 6, "ls": ""}
    axes[0, 1].plot(*drops, marker="o", color=WATER, **drop)
    for ax, (name, r), color in zip(
        axes[1], rewards.items(), WORLDS.values(), strict=True
    ):
        policy = soft_value_iteration(new, r, ALPHA).policy
        image = draw_world(ax, new, r, color, policy)
        ax.set_title(f"learned {name}")
    axes[0, 0].set_ylabel("the expert,\ntrue reward")
    axes[1, 0].set_ylabel("an agent, new maze,\nlearned reward")
    below = {"orientation": "horizontal", "shrink": 0.5, "pad": 0.03}
    bar = fig.colorbar(image, ax=axes, label="reward", aspect=25, **below)
    bar.set_ticks([0, 1], labels=["low", "high"])
    plt.show()


def pairs(rows: Mapping[str, Sequence]) -> HTML:
    """Return the table of second recordings."""
    head = ("second film", "open", "door", "lower wall")
    return table(
        head,
        [
            (
                name,
                str(free),
                *(f"{100 * x:z.0f}\xa0%".replace("-", "−") for x in scores),
            )
            for name, (free, _, *scores) in rows.items()
        ],
    )


def distances(
    slips: Sequence[float],
    far: Sequence[float],
    bounds: Sequence[float],
    errors: Float[Array, "K N"],
) -> None:
    """Draw errors of r below their bound, with σ of each wet floor."""
    two, dark = WORLDS["two worlds"], "0.35"
    with plots.style():
        fig, ax = plt.subplots(figsize=(4.7, 3.4))
    ax.plot(slips, bounds, "o-", color=dark, ms=4, label="the bound, 1/σ")
    for slip, sigma, bound in zip(slips, far, bounds, strict=True):
        at = {"textcoords": "offset points", "xytext": (5, 4)}
        ax.annotate(f"σ = {sigma:.2g}", (slip, bound), color=dark, **at)
    ax.plot(slips, errors, "o", color=two, ms=4, alpha=0.7)
    ax.set(xlabel="commands that go astray on the wet floor (%)")
    ax.set(yscale="log", ylabel="error of the reward ÷\nerror of the films")
    ax.set(xlim=(0, 1.2), xticks=[0.05, 0.2, 0.4, 0.7, 1], ylim=(0.4, 300))
    ax.set_xticklabels(["5", "20", "40", "70", "100"])
    ax.set_yticks([1, 10, 100], labels=["1×", "10×", "100×"])
    tried = Line2D([], [], color=two, label="five random errors", **DOTS)
    _key(fig, [*ax.get_lines()[:1], tried])
    plt.show()


def coverage(kept: Mapping[str, Array]) -> None:
    """Draw the score in the third maze by the steps seen, from all starts.

    A dot is a draw, moved a little aside for each floor.
    """
    with plots.style():
        fig, axes = plt.subplots(
            1, 2, figsize=(4.7, 3.3), sharex=True, sharey=True
        )
    names = {"dry": "one world: dry", "dry and wet": "two: dry and wet"}
    worlds = dict(zip(names, WORLDS.values(), strict=True))
    dots = {"ls": "", "marker": "o", "ms": 4, "alpha": 0.6, "mew": 0}
    for ax, reward in zip(axes, ("r(s, a)", "r(s)"), strict=True):
        for (name, color), aside in zip(
            worlds.items(), (0.87, 1.15), strict=True
        ):
            run = f"sloppy, everywhere, {name}, {reward}"
            values = 100 * kept[run][..., 0]
            steps = aside * np.array(kept["steps"], float)
            ax.plot(steps, np.median(values, 1), color=color)
            ax.plot(steps, values, color=color, **dots)
        ax.set_title(f"learned: ${reward}$", pad=8)
        ax.set(xscale="log", xlabel="steps seen")
        ax.set(ylim=(-75, 110), yticks=(-50, 0, 50, 100))
        ax.minorticks_off()
    axes[0].set_ylabel("score (%)")
    keys = [Line2D([], [], color=worlds[n], label=names[n]) for n in names]
    _key(fig, keys)
    plt.show()


def game(histories: Mapping[str, Sequence[float]]) -> None:
    """Draw how the adversarial game finds the reward."""
    with plots.style():
        fig, ax = plt.subplots(figsize=(4.7, 2.9))
    for name, values in histories.items():
        look = {"color": WORLDS[name], "label": name}
        ax.plot(range(1, len(values) + 1), values, **look)
    ax.set(xlabel="rounds", ylabel="correlation with\nthe true reward")
    ax.set_ylim(0, 1.03)
    _key(fig, ax.get_lines())
    plt.show()


def networks(kept: Mapping[str, Mapping]) -> None:
    """Draw the game with networks, and how far mazes are apart."""
    with plots.style():
        fig, axes = plt.subplots(2, 1, figsize=(4.7, 5.2))
    fig.get_layout_engine().set(hspace=0.08)
    one, two = WORLDS.values()
    for x, form in enumerate(("table", "network")):
        for count, color in ((1, one), (2, two)):
            likes = kept["game"][f"{form}, {count}"][:, 0]
            aside = x + 0.2 * count - 0.3
            axes[0].plot([aside] * 5, likes, color=color, **DOTS)
    axes[0].set(xlim=(-0.5, 1.5), ylim=(0, 1.05), xticks=(0, 1))
    axes[0].set_xticklabels(("free numbers", "a network"))
    axes[0].set_ylabel("correlation with\nthe true reward")
    names = "same\nagain", "wall\nmoved", "weak\nmotors", "turned\ncontrols"
    for x, pairs in enumerate(kept["distances"].values()):
        for part, color in ((1, one), (0, two)):
            at = [x + 0.1 - 0.2 * part] * 3
            axes[1].plot(at, pairs[:, part], color=color, **DOTS)
    axes[1].set(xlim=(-0.5, 3.5), ylim=(0, 0.25), xticks=range(4))
    axes[1].set_xticklabels(names)
    axes[1].set_ylabel("estimated distance σ")
    titles = "How good is the reward?", "How far apart are two samples?"
    for ax, title in zip(axes, titles, strict=True):
        ax.set_title(title, loc="left", fontweight="bold", pad=8)
    _key(fig, [_dot(color, name) for name, color in WORLDS.items()])
    plt.show()


def third(
    mazes: Mapping[str, Mapping], bodies: Mapping[str, Mapping]
) -> None:
    """Draw what new agents reach in third mazes, and with a third body.

    Colours tell the worlds of a reward everywhere.
    """
    with plots.style():
        fig, axes = plt.subplots(
            3, 1, figsize=(4.9, 8.6), height_ratios=(6, 4, 4)
        )
    fig.get_layout_engine().set(hspace=0.08)
    titles = "The wall moves", "The wall is lower", "The body is new"
    for ax, title in zip(axes, titles, strict=True):
        ax.set_title(title, loc="left", fontweight="bold", pad=8)
    one, two, true = *WORLDS.values(), "0.35"
    rows = {
        "r(s), none": ("r(s), Left alone", one),
        "r(s), turned": ("r(s), + turned controls", two),
        "r(s, a), none": ("r(s, a), Left alone", one),
        "r(s, a), turned": ("r(s, a), + turned controls", two),
        "r(s, a), weak": ("r(s, a), + weak motors", two),
    }
    for y, (row, (_, color)) in enumerate(rows.items()):
        _strip(axes[0], mazes["new"][f"{row}, moved"], y - 0.15, color)
        mirrored = mazes["new"][f"{row}, mirrored"]
        _strip(axes[0], mirrored, y + 0.15, color, mfc="none")
    _strip(axes[0], mazes["true"], len(rows), true)
    names = [*(name for name, _ in rows.values()), "true reward"]
    _name_strips(axes[0], names, "return in PointMazeRight")
    axes[0].set_xticks((-25, -20, -15, -10))
    lower = {
        f"{form}, {name}": (f"{form}, {worlds}, low", color)
        for name, worlds, color in (
            ("Left alone", "none", one),
            ("Left and Right", "sides", two),
        )
        for form in ("r(s)", "r(s, a)")
    }
    for y, (row, color) in enumerate(lower.values()):
        _strip(axes[1], mazes["sides"][row], y, color)
    _name_strips(axes[1], [*lower], "return in the lower-wall maze")
    ants = {
        "whole state, one body": ("able", one),
        "whole state, two bodies": ("both", two),
        "velocity, one body": ("velocity, able", one),
        "true reward": ("true", true),
    }
    for y, (name, color) in enumerate(ants.values()):
        _strip(axes[2], bodies["new"][name]["true"], y, color)
    _name_strips(axes[2], [*ants], "return of DisabledAnt")
    line = {"color": "0.35", "ls": "--", "lw": 1, "zorder": 0}
    for ax, bar in zip(axes, ARRIVES, strict=False):
        ax.axvline(bar, **line)
    keys = [
        *(_dot(color, name) for name, color in WORLDS.items()),
        _dot(true, "true reward"),
        _dot(true, "mirrored controls", mfc="none"),
        Line2D([], [], label="right of it: arrives", **line),
    ]
    _key(fig, keys, ncols=2)
    plt.show()


def _key(fig, handles, ncols=2) -> None:
    """Explain the colours, once, above all panels."""
    look = {"handlelength": 1.4, "columnspacing": 1.6, "frameon": False}
    place = {"loc": "outside upper center", "ncols": ncols}
    fig.legend(handles=handles, **place, **look)


def _dot(color: str, name: str, **look) -> Line2D:
    return Line2D([], [], color=color, label=name, **DOTS, **look)


ARRIVES = (-14, -16)
"""Above these returns an agent is past the moved and the lower wall."""
DOTS = {"ls": "", "marker": "o", "ms": 5, "alpha": 0.7}


def _strip(ax: Axes, values: Array, y: float, color: str, **look) -> None:
    ax.plot(values, [y] * len(values), color=color, **DOTS, **look)


def _name_strips(ax, names, xlabel) -> None:
    ax.set(xlabel=xlabel, yticks=range(len(names)))
    ax.set_yticklabels(names)
    ax.set_ylim(len(names) - 0.5, -0.5)
