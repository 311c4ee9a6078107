"""The pictures, tables and the film of chapter 7."""

from contextlib import closing

import matplotlib.pyplot as plt
from matplotlib.colors import ListedColormap

import plots
from drawing import diagram, film, table
from offairl_lite import envs

PAIR = ("with", "without")
LOOKS = ((plots.BLUE, "-"), (plots.RED, "--"))
"""Imitators with and without an absorbing state, and their lines."""


def hoppers(kept, FRAMES):
    """Return a film of an expert and of two imitators."""
    told = {
        "expert": "the expert",
        "with": "imitator,\nabsorbing state",
        "without": "imitator,\nno absorbing state",
    }

    def pictures_of(poses):
        env = envs.make("Hopper-v5", 1, 0, render_mode="rgb_array")
        with closing(env):
            state = env.get_state()
            for pose in poses:
                env.set_state({**state, "physics": pose[None]})
                yield env.render()[0]

    watched = {
        name: list(pictures_of(kept["film"][name]["pose"][:FRAMES]))
        for name in told
    }
    look = {"font.size": 13, "axes.titlesize": 14, "axes.labelsize": 13}
    with plots.style(), plt.rc_context(look):
        fig, axes = plt.subplots(1, 3, figsize=(7.2, 3.6), dpi=100)
    for ax in axes:
        ax.set(xticks=[], yticks=[])
        ax.grid(False)
        for spine in ax.spines.values():
            spine.set_visible(False)
    screens = [
        ax.imshow(pictures[0])
        for ax, pictures in zip(axes, watched.values(), strict=True)
    ]

    def draw(i):
        for ax, screen, name in zip(axes, screens, watched, strict=True):
            screen.set_data(watched[name][i])
            ax.set_title(told[name])
            falls = kept["film"][name]["falls"][i]
            times = "once" if falls == 1 else f"{falls} times"
            fell = f", fell {times}" if falls else ""
            ax.set_xlabel(
                f"{kept['film'][name]['farthest'][i]:.1f} m{fell}"
            )

    frames = film(fig, draw, FRAMES)
    return frames


def cliff():
    """Draw the cliff, the goal and the states between."""
    diagram(
        (5.0, 0.9),
        {
            "cliff": (0.35, 0.45, "cliff", plots.RED),
            "0": (1.45, 0.45, "start"),
            "1": (2.5, 0.45, "middle"),
            "2": (3.55, 0.45, "last"),
            "goal": (4.62, 0.45, "goal", plots.GREEN),
        },
        [
            ("0", "cliff", "−1"),
            ("0", "1", "", -0.3),
            ("1", "0", "", -0.3),
            ("1", "2", "", -0.3),
            ("2", "1", "", -0.3),
            ("2", "goal", "+1"),
        ],
    )
    plt.show()


def fates(gammas, shifts, nothing, never, fall):
    """Draw what the best policy does, by discount and constant."""
    colors = ListedColormap([plots.RED, "#a5e5cb", plots.BLUE])
    with plots.style():
        _fig, ax = plt.subplots(figsize=(5.4, 3.5))
        image = ax.pcolormesh(
            gammas, shifts, nothing, cmap=colors, vmin=0, vmax=2
        )
        image.set_rasterized(True)
        ax.plot(gammas, never, "k--", gammas, fall, "k--")
        ax.text(0.74, 0.9, "never ends", ha="center", color="white")
        dark = "#111111"
        ax.text(0.74, -0.4, "walks to the goal", ha="center", color=dark)
        ax.text(0.74, -2, "falls at once", ha="center", color="white")
        ax.set(xlabel=r"discount $\gamma$", ylabel="constant $c$ added")
        ax.set(ylim=(-2.5, 1.5))
        ax.grid(False)
        plt.show()


def goes_on():
    """Draw an episode that ends, and one that goes on."""
    left, right = 1.0, 3.0
    places = (3.3, 2.5, 1.45, 0.4)
    texts = (r"$\cdots$", "$s_{T-1}$", "$s_T$")
    boxes = {}
    for column, x, *end in (
        ("a", left, "end, worth 0", plots.RED),
        ("b", right, "$s_a$", plots.GREEN),
    ):
        for i, (y, text) in enumerate(zip(places, texts, strict=False)):
            boxes[f"{column}{i}"] = (x, y, text)
        boxes[f"{column}3"] = (x, places[3], *end)
    labels = ("", "$r(s_{T-1})$", "$r(s_T)$")
    _fig, ax = diagram(
        (4.2, 3.7),
        boxes,
        [
            (f"{column}{i}", f"{column}{i + 1}", label)
            for column in "ab"
            for i, label in enumerate(labels)
        ],
    )
    looks = {"arrowstyle": "-|>", "color": "#444444", "lw": 1.6}
    bow = {"connectionstyle": "arc3,rad=-2.2", "shrinkA": 0, "shrinkB": 0}
    x, y = right + 0.16, places[3]  # the right side of its box
    ax.annotate("", (x, y - 0.1), (x, y + 0.1), arrowprops=looks | bow)
    ax.text(x + 0.37, y, "$r(s_a)$", va="center")
    plt.show()


def two_targets(k, learned, predicted, R_T):
    """Draw the value of the last step while critics learn."""
    with plots.style():
        _fig, ax = plt.subplots(figsize=(4.8, 3.2))
        ax.plot(k, learned["bootstrap"], color=plots.BLUE)
        ax.plot(k, learned["analytic"], "-.", color=plots.ORANGE)
        ax.plot(k, predicted, "k:")
        ax.text(420, -4, "bootstrap", color=plots.BLUE)
        ax.text(420, -5, "dotted: predicted")
        ax.text(110, -8.3, "analytic", color=plots.ORANGE)
        plots.level(ax, R_T, "$R_T$")
        ax.set(
            xlabel="updates", ylabel="Q of the last step", ylim=(-10.5, 0.5)
        )
        plt.show()


def hoppers_learn(kept, long, falling, run, mode):
    """Draw the returns with and without an absorbing state."""

    def curves(ax, steps, returns, color, line):
        steps = steps / 1_000
        ax.plot(steps, returns.T, line, color=color, alpha=0.4, lw=0.9)
        ax.plot(steps, returns.mean(0), line, color=color, lw=2.2)

    with plots.style():
        fig, axes = plt.subplots(2, 1, figsize=(4.8, 6.6))
        fig.get_layout_engine().set(h_pad=0.1)
        short = [kept["short"][name].values() for name in PAIR]
        whole = [(run.steps, run.returns) for run in (long, falling)]
        for ax, pair in zip(axes, (short, whole), strict=True):
            for (steps, returns), look in zip(pair, LOOKS, strict=True):
                curves(ax, steps, returns, *look)
            ax.set_title(f"{steps[-1]:,} steps", loc="left")
        mine = {"color": "black", "lw": 1.4, "marker": "."}
        steps, returns = run.steps / 1_000, run.returns.mean(0)
        axes[0].plot(steps, returns, **mine)
        axes[0].text(5.1, 120, "yours")
        axes[0].text(4.9, 700, "absorbing state", color=plots.BLUE)
        axes[0].text(5.3, 25, "no absorbing state", color=plots.RED)
        axes[1].text(4, 3_200, "absorbing state", color=plots.BLUE)
        axes[1].text(40, 560, "no absorbing state", color=plots.RED)
        for ax in axes:
            plots.level(ax, 1_000, "")
            ax.set(ylabel="return", ylim=(-100, 3_500))
        plots.level(axes[1], mode, "the expert", plots.EXPERT)
        axes[0].set_ylim(-40, 1_150)
        axes[1].set(xlabel="thousand environment steps")
        words = {"color": plots.GREY, "fontsize": "small"}
        axes[0].text(0.2, 1_025, "standing still", **words)
        axes[0].set(xlim=(0, 8.3))
        plt.show()


def pays(said):
    """Return the table of what a step of life pays."""
    return table(
        ("the imitator has", "a demonstrated step", "a step of its own"),
        [
            (
                name,
                *(
                    f"{x.mean():+.1f}".replace("-", "−")
                    for x in both.values()
                ),
            )
            for name, both in said.items()
        ],
    )


def stored_cuts(stored, leaves):
    """Return the table of what a stored cut does."""
    return table(
        ("the cut is stored", "V at the goal", "the best policy"),
        [
            (
                name.replace("s_a", "s<sub>a</sub>").replace("-3", "−3"),
                f"{s.value[2]:.1f}".replace("-", "−"),
                "leaves the goal" if leaf else "stays at the goal",
            )
            for (name, s), leaf in zip(stored.items(), leaves, strict=True)
        ],
    )
