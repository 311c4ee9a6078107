"""The pictures, tables and the film of chapter 8."""

import matplotlib.pyplot as plt
import numpy as np
import scipy.stats
import torch
from matplotlib.colors import ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse

import drawing
import plots
from offairl_lite.analysis.statistics import difference, interquartile_mean
from offairl_lite.core.policies import MultiplicativeGaussian

SKILLS = {"walk": plots.PURPLE, "reach": plots.BLUE}
"""Two primitives, in the toy's colours. Their product is green."""


OFFERED = ListedColormap([plots.RED, plots.GREEN])
"""No primitive pushes left, and some primitive does."""


def film_of_the_gate(num_frames=32):
    """Return a film of two policies, added and multiplied."""
    x, y = np.meshgrid(*[np.linspace(-2.7, 2.7, 121)] * 2)
    mean = np.array([[0.9, 0.3], [-0.7, -0.9]])
    std = np.array([[0.2, 0.9], [0.9, 0.2]])
    each = [
        scipy.stats.norm.logpdf(x, m[0], s[0])
        + scipy.stats.norm.logpdf(y, m[1], s[1])
        for m, s in zip(mean, std, strict=True)
    ]
    looks = {"origin": "lower", "extent": (-2.7, 2.7) * 2, "vmin": 0}
    with plots.style():
        fig, axes = plt.subplots(1, 2, figsize=(7.2, 3.9), dpi=100)
        fig.get_layout_engine().set(h_pad=0.09)  # room below the title
        title = fig.suptitle(" ")
        images = []
        for ax, name in zip(axes, ("added", "multiplied"), strict=True):
            image = ax.imshow(0 * x, cmap="Greens", vmax=1, **looks)
            images.append(image)
            for m, s, color in zip(mean, std, SKILLS.values(), strict=True):
                edge = {"fill": False, "edgecolor": color, "linewidth": 2}
                ax.add_patch(Ellipse(m, *(4 * s), **edge))
            ax.set(title=name, xlabel="legs", xticks=[], yticks=[])
            ax.grid(False)
            for (skill, color), at in zip(
                SKILLS.items(), ((1.4, 1.4), (-2.3, -0.3)), strict=True
            ):
                ax.text(*at, skill, color=color, fontsize="large")
        axes[0].set(ylabel="arm")

    def draw(i):
        w = 0.5 + 0.45 * np.sin(2 * np.pi * i / num_frames)
        added = w * np.exp(each[0]) + (1 - w) * np.exp(each[1])
        product = np.exp(w * each[0] + (1 - w) * each[1])
        for image, density in zip(images, (added, product), strict=True):
            image.set_data(density / density.max())
        title.set_text(f"gate: {w:.2f} for walk, {1 - w:.2f} for reach")

    with plots.style():
        return drawing.film(fig, draw, num_frames)


GATES = {
    "plain": ("one\nGaussian", plots.GREY),
    "4-softmax": ("4\nsoftmax", plots.BLUE),
    "8-softmax": ("8\nsoftmax", plots.ORANGE),
    "4-sigmoid": ("4\nsigmoid", plots.BLUE),
    "8-sigmoid": ("8\nsigmoid", plots.ORANGE),
    "4-released": ("4\nreleased", plots.RED),
}


def mcp_graph():
    """Draw how the gate and primitives make an action."""
    _fig, _ax = drawing.diagram(
        (4.2, 4.0),
        {
            "s": (2.1, 3.6, "state $s$"),
            "g": (0.9, 2.6, "gate", plots.ORANGE),
            "t": (3.2, 2.6, "trunk and\n$K$ primitives", plots.BLUE),
            "p": (2.1, 1.3, "product\n$\\mu,\\ \\sigma$", plots.GREEN),
            "a": (2.1, 0.3, "action $\\tanh u$"),
        },
        [
            ("s", "g"),
            ("s", "t"),
            ("g", "p", "$w_k$"),
            ("t", "p", "$\\mu_k,\\ \\sigma_k$"),
            ("p", "a"),
        ],
    )
    plt.show()


def ellipses(compose):
    """Draw two Gaussians and their product, for three gates."""
    mean = np.array([[0.8, 0.2], [-0.6, -0.7]])
    std = np.array([[0.15, 0.9], [0.8, 0.15]])

    def ellipse(ax, mean, std, **looks):
        patch = Ellipse(
            mean, *(4 * std), fill=False, linewidth=1.8, **looks
        )
        ax.add_patch(patch)
        ax.plot(*mean, ".", color=looks["edgecolor"])

    with plots.style():
        fig, axes = plt.subplots(
            1, 3, figsize=(4.8, 2.8), sharex=True, sharey=True
        )
        walk, reach = SKILLS.values()
        gates = ([0.5, 0.5], [0.9, 0.1], [0.1, 0.9])
        for ax, weight in zip(axes, gates, strict=True):
            ellipse(ax, mean[0], std[0], edgecolor=walk, linestyle=":")
            ellipse(ax, mean[1], std[1], edgecolor=reach, linestyle="--")
            both = compose(mean, std, np.array(weight))
            ellipse(ax, *both, edgecolor=plots.GREEN)
            ax.set(xlim=(-2.4, 2.4), ylim=(-2.4, 2.4), aspect="equal")
            ax.set(xlabel="legs", xticks=(-1, 1), yticks=(-1, 1))
            title = f"walk {weight[0]}\nreach {weight[1]}"
            ax.set_title(title, linespacing=1.3)
        axes[0].set_ylabel("arm")
        keys = [
            Line2D([], [], color=color, ls=line, label=name)
            for name, color, line in (
                ("walk", walk, ":"),
                ("reach", reach, "--"),
                ("their product", plots.GREEN, "-"),
            )
        ]
        look = {"frameon": False, "handlelength": 1.6}
        fig.legend(
            handles=keys, loc="outside lower center", ncols=3, **look
        )
        plt.show()


def two_skills(added, multiplied):
    """Draw robots whose skills are added, and multiplied."""
    with plots.style():
        _fig, axes = plt.subplots(
            1, 2, figsize=(5.2, 3.3), sharex=True, sharey=True
        )
        shown = (
            ("added", added, plots.GREY),
            ("multiplied", multiplied, plots.GREEN),
        )
        for ax, (name, moves, color) in zip(axes, shown, strict=True):
            paths = np.pad(moves.cumsum(1), ((0, 0), (1, 0), (0, 0)))
            ax.plot(*paths.T, color=color, alpha=0.35, lw=1)
            ax.plot(*paths[:, -1].T, "o", color=color, ms=4)
            ax.plot(1, 1, "*", color=plots.ORANGE, mec="black", ms=17)
            ax.set(title=name, xlabel="legs: metres", aspect="equal")
        axes[0].set_ylabel("arm: metres")
        plt.show()


def two_formulas(exact, released):
    """Return the table of two formulas for the product."""
    return drawing.table(
        ("formula", "μ", "σ"),
        [
            (name, f"{mu.item():.3f}", f"{sigma.item():.3f}")
            for name, (mu, sigma) in (
                ("product of the primitives", exact),
                ("released code", released),
            )
        ],
    )


def starts():
    """Return the standard deviations at the start."""
    start = {}
    for gating in ("softmax", "sigmoid", "softplus"):
        for k in (1, 4, 8):
            actor = MultiplicativeGaussian(
                1, 1, (1,), (-5.0, 5.0), k, (), (), gating
            )
            log_std = actor.distribution(
                torch.zeros(1, actor.num_params), torch.zeros(1, 1, 1)
            )[1]
            start[gating, k] = log_std.exp().item()
    return start


def widths(start):
    """Return the table of standard deviations at the start."""
    return drawing.table(
        ("gate", "K = 1", "K = 4", "K = 8"),
        [
            (gating, *(f"{start[gating, k]:.2f}" for k in (1, 4, 8)))
            for gating in ("softmax", "sigmoid", "softplus")
        ],
    )


def gates(five, run, expert, ends):
    """Draw the returns of actors with several gates."""
    with plots.style():
        _fig, axes = plt.subplots(
            2, 1, figsize=(4.9, 5.2), height_ratios=(2, 3)
        )
        plots.curve(axes[0], five.steps, five.returns, "4 primitives")
        here = {"color": plots.PURPLE, "label": "trained here"}
        axes[0].plot(run.steps, run.returns[0], "o", **here)
        shown = expert.returns.mean()
        for ax in axes:
            plots.level(ax, shown, "demonstrations", plots.EXPERT)
        axes[0].set(xlabel="steps", ylabel="score", ylim=(-32, -4))
        for ax, ticks in (
            (axes[0], (-26.5, -16.5, -6.5)),
            (axes[1], (-12.5, -10.5, -8.5, -6.5)),
        ):
            ax.set_yticks(ticks, [drawing.percent(x) for x in ticks])
        for i, (name, (_, color)) in enumerate(GATES.items()):
            end = np.sort(ends[name])
            spread = i + np.linspace(-0.2, 0.2, len(end))
            axes[1].plot(spread, end, "o", color=color)
            axes[1].plot(
                i, np.median(end), "_", color="black", markersize=26
            )
        labels = [label for label, _ in GATES.values()]
        axes[1].set_xticks(range(len(GATES)), labels)
        axes[1].set(ylabel="score at the end", ylim=(-13, -5.5))
        plt.show()


def full_size(at_full_size, plain):
    """Return the table of runs with networks of full size."""
    rows = []
    for name, end in at_full_size.items():
        points = [5 * x for x in difference(end, plain)]  # 20 are 100 %
        between = "{:+.1f} [{:+.1f},\xa0{:+.1f}]".format(*points)
        mean = drawing.percent(interquartile_mean(end))
        between = between.replace("-", "−") if end is not plain else ""
        rows.append((name, mean, between))
    score = "score<br>(interquartile mean)"
    head = ("actor", score, "difference [95\xa0%]")
    return drawing.table(head, rows)


def leads(seeds, parts, five, places):
    """Return the largest and least shares of states that one leads in."""
    most, least = [], []
    for member in range(len(seeds)):
        _, weights = parts(five.policy.member(member), places)
        leads = np.bincount(weights.argmax(1), minlength=4) / len(weights)
        most.append(leads.max())
        least.append(leads.min())
    return most, least


def gate_and_primitives(parts, policy, weight, x, y):
    """Draw the weights of primitives, and their actions."""
    # Arrows at free places: not on the barrier, from the left wall to 0.4.
    spots = np.stack(np.meshgrid(*[np.linspace(-0.03, 0.53, 7)] * 2), -1)
    spots = spots.reshape(-1, 2)
    barrier = (np.abs(spots[:, 1] - 0.3) < 0.06) & (spots[:, 0] < 0.45)
    spots = spots[~barrier]
    x_spots = torch.tensor(np.pad(spots, ((0, 0), (0, 1)))).float()
    push_there, _ = parts(policy, x_spots)
    with torch.no_grad():
        seen = policy.normaliser(x_spots.view(1, -1, 3))
        product, _ = policy.actor.distribution(policy.params, seen)

    def arrows(ax, push, color):
        looks = {"fc": color, "ec": "black", "linewidth": 0.5}
        way = {"scale": 13, "width": 0.013, "zorder": 2.5, "pivot": "mid"}
        ax.quiver(*spots.T, *push.T, **looks, **way)
        plots.maze(ax, "Left")
        ax.set_axis_off()

    with plots.style():
        # The product in the middle of the right side.
        places = "01.;01p;23p;23."
        fig, axes = plt.subplot_mosaic(places, figsize=(5.4, 4.6))
        maps = [axes[name] for name in "0123"]
        for k, ax in enumerate(maps):
            shares = weight[:, k].reshape(x.shape)
            image = ax.pcolormesh(
                x, y, shares, vmin=0, vmax=0.6, cmap="magma"
            )
            image.set_rasterized(True)
            arrows(ax, push_there[:, k], "white")
            ax.set_title(f"primitive {k + 1}")
        arrows(axes["p"], torch.tanh(product[0]).numpy(), plots.BLUE)
        axes["p"].set_title("their product")
        below = {
            "location": "bottom",
            "shrink": 0.6,
            "extend": "max",
            "aspect": 30,
        }
        fig.colorbar(
            image,
            ax=[*axes.values()],
            label="weight of primitives 1 to 4",
            **below,
        )
        plt.show()


def offers(seeds, pushed, shares, x, y):
    """Draw where some primitive pushes left, below the moved wall."""
    with plots.style():
        _fig, axes = plt.subplots(2, 3, figsize=(5.4, 3.9))
        cells = zip(axes.flat, seeds, pushed, shares, strict=False)
        for ax, seed, push, share in cells:
            there = np.where(y < 0.25, push.reshape(x.shape), np.nan)
            image = ax.pcolormesh(x, y, there, vmin=0, vmax=1, cmap=OFFERED)
            image.set_rasterized(True)
            plots.maze(ax, "Right")
            ax.set_title(f"seed {seed}: {100 * share:.0f} %")
        key = axes[1, 2]
        for height, color, text in (
            (0.6, plots.GREEN, "a primitive\npushes left"),
            (0.25, plots.RED, "none does"),
        ):
            key.plot(0.1, height, "s", color=color, ms=10)
            key.text(0.2, height, text, va="center")
        key.set(xlim=(0, 1), ylim=(0, 1))
        for ax in axes.flat:
            ax.set_axis_off()
        plt.show()


def weights(along):
    """Draw the weights along an episode."""
    with plots.style():
        _fig, ax = plt.subplots(figsize=(4.9, 2.6))
        styles = zip(
            (plots.BLUE, plots.ORANGE, plots.GREEN, plots.PURPLE),
            ("-", "--", "-.", ":"),
            strict=True,
        )
        for k, (color, line) in enumerate(styles):
            ax.plot(
                along[:, k], color=color, linestyle=line, label=f"{k + 1}"
            )
        ax.set(xlabel="step of the episode", ylabel="weight", ylim=(0, 1))
        ax.legend(title="primitive", ncols=4, loc="upper right")
        plt.show()
