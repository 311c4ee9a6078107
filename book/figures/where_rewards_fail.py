"""The pictures and tables of chapter 10."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Rectangle

import plots
from drawing import diagram, outline, table
from offairl_lite.envs.models import GOAL, MARSH, WEST
from offairl_lite.envs.tasks import MARSH_COST, in_marsh
from offairl_lite.runs import records

RECORDS = Path("records")

EDGE = outline(2.4)


FIRST, KNOWN = "marsh-{}-demo", "decides-marsh-demo"
OURS = "off-policy AIRL, imitation"
HOME, WESTERN = "new policy on AIRL's reward", "new policy, west"
ROUTES = {
    OURS: ("old", f"{KNOWN}/released-50/implementation-4"),
    HOME: ("old", f"{KNOWN}/released-50/again"),
    WESTERN: ("west", f"{KNOWN}/released-50/west"),
    "DAC, imitation": ("old", FIRST.format("imitation") + "/dac"),
    "new policy on DAC's reward": (
        "west",
        FIRST.format("transfer") + "/dac/west",
    ),
    "SAC on the true reward": (
        "west",
        FIRST.format("transfer") + "/true/true-west",
    ),
}


def number(value, digits=1):
    """Return a number as tables show it, with a true minus sign."""
    return f"{value:.{digits}f}".replace("-", "−")


def span(values, digits=1):
    """Return the range of some numbers, or the one that they all are."""
    low, high = (number(v, digits) for v in (min(values), max(values)))
    joined = f"{low} to\u00a0{high}"
    return low if low == high else joined


PANELS = {
    "released": "6,000 steps",
    "released-16": "16,000 steps",
    "released-50": "50,000 steps",
}


# Drawn in squares of 1 cm, whose sides are those of the marsh.
FACES = (-0.08, 0.58)  # of the walls
middles = np.arange(66) / 100 - 0.075


SUSPECTS = {
    "log-ratio loss, 6,000 steps": f"{KNOWN}/released",
    "log-ratio loss, 16,000 steps": f"{KNOWN}/released-16",
    "log-ratio loss, 50,000 steps": f"{KNOWN}/released-50",
    "light penalty, 16,000 steps": f"{KNOWN}/light-16",
    "AIRL loss, 16,000 steps": "marsh-imitation-long-demo",
    "DAC, 6,000 steps": FIRST.format("imitation") + "/dac",
    "PPO, all steps": "marsh-airl-memory-demo/all",
    "PPO, last 2,000 steps": "marsh-airl-ppo-demo/state",
}


MOVES = {
    "velocity, centred,\nfrom scratch": "velocity/scratch",
    "velocity, centred,\nfrom the old policy": "velocity/policy",
    "velocity, not centred,\nfrom scratch": "velocity-raw/scratch",
    "whole state, centred, from\nscratch, 100,000 steps": "whole/scratch",
    "whole state, centred, from\nscratch, 500,000 steps": "state/scratch",
    "DAC's, centred,\nfrom scratch": "dac/scratch",
    "true reward,\nfrom scratch": "true/scratch",
}


def _draw_marsh(ax, value, title):
    scaled = ((value - value.min()) / np.ptp(value)).reshape(66, 66)
    image = ax.imshow(
        scaled, origin="lower", extent=FACES * 2, cmap=plots.REWARD_MAP
    )
    looks = {"colors": "white", "linewidths": 0.6, "alpha": 0.6}
    ax.contour(middles, middles, scaled, 12, **looks)
    plots.maze(ax, None)
    for mark in ax.lines:  # start and goal, above the paths
        mark.set_zorder(5)
    looks = {"facecolor": "none", "edgecolor": "white", "hatch": "//"}
    low = np.maximum(MARSH[0], FACES[0])  # what the wall leaves of it
    ax.add_patch(Rectangle(low, *(MARSH[1] - low), zorder=1.5, **looks))
    ax.plot(*WEST, "s", color="white", markeredgecolor="black", zorder=5)
    ax.axis("off")
    ax.set_title(title)
    return image


def _draw_path(ax, path, color):
    ax.plot(
        *path[:, :2].T, color=color, lw=2.4, path_effects=EDGE, zorder=4
    )


GROUPS = {  # what is shown, and the routes below it
    "The true reward": ("SAC on the true reward",),
    "Off-policy AIRL, 50,000 steps": (OURS, HOME, WESTERN),
    "DAC, 6,000 steps": ("DAC, imitation", "new policy on DAC's reward"),
}


def routes(marsh, last, expert, wet, arrived):
    """Return the table of ways to the star."""
    shown = (
        "demonstrations",
        "old",
        "0.0",
        f"{(last < 0.15).sum()} of 50",
        number(np.median(expert.returns)),
    )
    rows = []
    for group, names in GROUPS.items():
        rows.append((group,))
        if not rows[1:]:
            rows.append(shown)
        for name in names:
            start, _ = ROUTES[name]
            does = "imitation" if "imitation" in name else "new policy"
            rows.append(
                (
                    does,
                    start,
                    span(wet[name]),
                    f"{arrived[name].sum()} of 5",
                    number(np.median(marsh[name].returns[:, -1])),
                )
            )
    heads = "start", "steps in<br>the marsh", "arrive", "median<br>return"
    return table(["policy", *heads], rows)


def maps(kept, values):
    """Return true and learned rewards, each with the path to it."""
    across = np.stack(
        [*np.meshgrid(middles, middles), np.zeros((66, 66))], -1
    )
    flat = across.reshape(-1, 3)
    true_map = -np.linalg.norm(flat[:, :2] - GOAL, axis=1)
    true_map = true_map - MARSH_COST * in_marsh(flat)
    known_route = kept["marsh"][
        FIRST.format("transfer") + "/true/true-west"
    ]
    drawn = {"true reward": (true_map, known_route["path"])}
    for name, title in PANELS.items():
        folder = f"{KNOWN}/{name}"
        reward = records.read(RECORDS / folder / "implementation-4").reward
        route = kept["marsh"][f"{folder}/west"]["path"]
        drawn[title] = values(reward, flat)[0], route
    return drawn


def marshes(drawn, paths):
    """Draw true and learned rewards, and paths."""
    with plots.style():
        fig, axes = plt.subplots(2, 2, figsize=(5.4, 5.0))
        panels = zip(axes.flat, drawn.items(), strict=True)
        for ax, (title, (value, walk)) in panels:
            image = _draw_marsh(ax, value, title)
            for path in paths[:5, :25]:
                _draw_path(ax, path, plots.EXPERT)
            _draw_path(ax, walk, plots.AGENT)
        bar = fig.colorbar(image, ax=axes, shrink=0.7, ticks=[0, 1])
        bar.ax.set_yticklabels(["lowest", "highest"])
        plt.show()


def hills_and_marshes(values, hill_and_marsh, explained, kept):
    """Return slopes, depths, fits, wet steps and rows of the figure."""
    steep, sunk, fit = {}, {}, {}  # b and c, scaled, and what they explain
    dry = {}  # steps in the marsh, of the imitators
    unscaled = {}
    rows = []
    for name, folder in SUSPECTS.items():
        if (RECORDS / folder / "implementation-4").exists():
            folder = f"{folder}/implementation-4"
        each = values(records.read(RECORDS / folder).reward)
        _, b, c = np.array([hill_and_marsh(reward) for reward in each]).T
        unscaled[name] = np.stack([b, c], 1)
        steep[name], sunk[name] = b / each.std(1), c / each.std(1)
        fit[name] = np.array([explained(reward) for reward in each])
        dry[name] = kept["marsh"][folder]["wet"]
        depth = c / b if b.min() > 0 else None
        rows.append((sunk[name], steep[name], depth, dry[name]))
    return steep, sunk, fit, dry, unscaled, rows


def suspects(truth, rows):
    """Draw marsh, hill and depth of every reward."""
    titles = "marsh, c", "hill, b", "depth, c / b (m)"
    of_truth = MARSH_COST / truth.std(), 1 / truth.std(), MARSH_COST
    drawn = [*zip(*rows, strict=True)][: len(titles)]
    losses = [name.split()[0] for name in SUSPECTS]
    with plots.style():
        _fig, axes = plt.subplots(1, 3, figsize=(4.9, 4.6), sharey=True)
        for ax, title, values, true in zip(
            axes, titles, drawn, of_truth, strict=True
        ):
            for y, (loss, each) in enumerate(
                zip(losses, values, strict=True)
            ):
                color = SHADES[loss]
                if y and color != SHADES[losses[y - 1]]:
                    ax.axhline(y - 0.5, color=plots.GREY, lw=0.6)
                if each is None:
                    text = "one seed\nhas no hill"
                    ax.text(0.1, y, text, color=color, va="center")
                    continue
                spread = y + np.linspace(-0.2, 0.2, len(each))
                ax.plot(each, spread, "o", color=color, ms=5, alpha=0.8)
            ax.axvline(true, color=plots.GREEN, ls="--", lw=1.6)
            ax.set_title(title, fontsize=10)
            ax.set_yticks(range(len(rows)), map(_short, SUSPECTS))
            ax.set_ylim(len(rows) - 0.5, -0.5)
            ax.set_xlim(min(0, ax.get_xlim()[0]))
            ax.grid(axis="y", visible=False)
        plt.show()


SHADES = {
    "log-ratio": plots.BLUE,
    "light": plots.BLUE,
    "AIRL": plots.ORANGE,
    "DAC,": plots.RED,
    "PPO,": plots.PURPLE,
}


def _short(name):
    """Return a row's name in two lines."""
    return name.replace(", ", ",\n")


def what_each_sees():
    """Draw what the networks of the ant see."""
    diagram(
        (4.7, 3.9),
        {
            "obs": (2.35, 3.4, "CustomAnt\n111 numbers", plots.GREEN),
            "pi": (0.8, 1.9, "policy " + r"$\pi$", plots.COPY),
            "r": (2.35, 1.9, "reward " + r"$r_\psi$", plots.REWARD),
            "v": (3.9, 1.9, "shaping " + r"$V_\omega$", plots.RED),
            "sac": (2.35, 0.5, "new policy\non DisabledAnt", plots.AGENT),
        },
        [
            ("obs", "pi", "all"),
            ("obs", "r", "velocity"),
            ("obs", "v", "all"),
            ("r", "sac", "frozen"),
        ],
    )
    plt.show()


def ants(ends, of_experts):
    """Draw the returns of ants with two weak legs."""
    with plots.style():
        _fig, ax = plt.subplots(figsize=(5.0, 4.4))
        for i, (name, end) in enumerate(ends.items()):
            color = plots.BLUE if "velocity" in name else plots.RED
            color = plots.GREY if "true" in name else color
            rows = i + np.linspace(-0.2, 0.2, len(end))
            ax.plot(end, rows, "o", color=color, ms=9, mec="white")
        ax.axvline(0, color="black", lw=0.8)
        for value in of_experts:
            ax.axvline(value, color=plots.EXPERT, lw=1.2, ls="--")
        ax.annotate(
            "experts",
            (np.mean(of_experts), 1.02),
            xycoords=("data", "axes fraction"),
            ha="center",
            color=plots.EXPERT,
        )
        names = [name.replace(", centred", "") for name in ends]
        ax.set_yticks(range(len(ends)), names)
        ax.set(
            xlabel="true return on DisabledAnt",
            ylim=(len(ends) - 0.5, -0.5),
        )
        plt.show()
