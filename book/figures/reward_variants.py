"""The pictures, tables and the film of chapter 6."""

import matplotlib.pyplot as plt
import numpy as np
import torch
from matplotlib.ticker import NullLocator

import plots
from drawing import EDGE, bare, diagram, film, number, table
from offairl_lite import demonstrations
from offairl_lite.analysis import epic
from offairl_lite.runs import records

LEVELS = (0.5, 0.9, 0.99)


def _dots(ax, y, values, color, spread=0.24):
    # A dot for each seed, one below the other, and their median.
    rows = y + np.linspace(-spread, spread, len(values))
    ax.plot(np.sort(values), rows, "o", color=color, alpha=0.7)
    ax.plot(np.median(values), y, "|", color="black", ms=15, mew=2)


def learning(story_r, STORIES, hold=2):
    """Return a film of two rewards and policies while they learn."""
    look = {"font.size": 13, "axes.titlesize": 15}
    with plots.style(), plt.rc_context(look):
        fig, axes = plt.subplots(
            2,
            2,
            figsize=(7.2, 5.2),
            dpi=100,
            height_ratios=(3.4, 1),
            sharey="row",
        )
    depth = min(s["map"].min() for s in story_r)
    half = 0.33 / (len(story_r[0]["map"]) - 1)
    extent = (-0.08 - half, 0.58 + half) * 2
    last = story_r[-1]["updates"]
    artists = []
    for (top, low), (title, (story, color)) in zip(
        axes.T, STORIES.items(), strict=True
    ):
        image = top.imshow(
            story[0]["map"],
            origin="lower",
            extent=extent,
            interpolation="bilinear",
            cmap=plots.REWARD_MAP,
            zorder=1,
        )
        image.set_clim(depth, 0)
        plots.maze(top, "Left")
        bare(top)
        top.set_title(title)
        ghost = top.plot([], [], color="white", lw=1, alpha=0.6)[0]
        line = top.plot([], [], color=color, lw=2.8, path_effects=EDGE)[0]
        dot = top.plot([], [], "o", color=color, mec="white", ms=10)[0]
        dot.set_zorder(5)
        low.semilogy([s["updates"] for s in story], [np.nan] * len(story))
        low.set(xlim=(0, last), ylim=(0.3, 3e5), xlabel="updates")
        low.set_yticks([1, 100, 10_000])
        low.set_xticks([0, 1_000])
        low.yaxis.set_minor_locator(NullLocator())
        curve = low.plot([], [], color=color, lw=2.4)[0]
        artists.append((story, image, ghost, line, dot, curve))
    axes[1, 0].set_ylabel(r"|mean $Q$|")
    bar = fig.colorbar(image, ax=axes[0], shrink=0.8)
    bar.set_label(r"$r_\psi$ at this moment, best place 0")

    def draw(i):
        k, part = divmod(i, hold)
        if k >= len(story_r):
            k, part = len(story_r) - 1, hold - 1
        for story, image, ghost, line, dot, curve in artists:
            now = story[k]
            image.set_data(now["map"])
            if k:
                ghost.set_data(*story[k - 1]["path"].T)
            path = now["path"]
            path = path[: 1 + len(path) * (part + 1) // hold]
            line.set_data(*path.T)
            dot.set_data(*path[-1:].T)
            past = story[: k + 1]
            updates = [s["updates"] for s in past]
            curve.set_data(updates, [s["q"] for s in past])

    with plots.style(), plt.rc_context(look):
        return film(fig, draw, hold * len(story_r) + 6)


def _score(returns, shown):
    """Return the book's score: 0 is the trap, 100 the expert."""
    trap = -26.5
    return 100 * (np.asarray(returns) - trap) / (shown - trap)


def _score_axis(ax):
    # The trap and the expert are named at the lines themselves.
    ax.set(xlim=(-215, 125), xticks=(-200, -100, 0, 100))
    ax.set_xlabel("score at the end, %")
    for at, name, color in (
        (0, "trap", plots.GREY),
        (100, "expert", plots.EXPERT),
    ):
        ax.axvline(at, color=color, ls="--", lw=1.2, zorder=0)
        place = {"xycoords": ("data", "axes fraction")}
        ax.annotate(name, (at, 1.02), ha="center", color=color, **place)


def variants(NAMES, final, COLORS, correlation, shown):
    """Draw scores and correlations of the variants."""
    LABELS = [
        "logit, $r(s, a)$ in $f$",
        "logit, $r(s)$ in $f$",
        "$r(s, a)$",
        "$r(s)$",
        "DAC's logit",
    ]
    with plots.style():
        _fig, axes = plt.subplots(1, 2, figsize=(5.4, 3.3), sharey=True)
        right = {
            "xycoords": ("axes fraction", "data"),
            "textcoords": "offset points",
            "ha": "right",
        }
        for i, name in enumerate(NAMES):
            score, color = _score(final[name], shown), COLORS[name]
            _dots(axes[0], i, score, color)
            _dots(axes[1], i, correlation[name], color)
            median = f"{np.median(score):.0f}".replace("-", "−")
            look = {**right, "va": "center", "color": color}
            axes[0].annotate(median, (1, i), (46, 0), **look)
        right["xycoords"] = "axes fraction"
        axes[0].annotate("median", (1, 1.02), (54, 0), **right)
        _score_axis(axes[0])
        axes[1].axvline(0, color=plots.GREY, lw=1)
        axes[0].set(yticks=range(5), yticklabels=LABELS, ylim=(4.5, -0.5))
        for label, name in zip(
            axes[0].get_yticklabels(), NAMES, strict=True
        ):
            label.set_color(COLORS[name])
        axes[1].tick_params(left=False)  # or medians look like its own
        axes[1].set(xlim=(-1.08, 1.08), xticks=(-1, 0, 1))
        axes[1].set_xlabel("learned and true return:\ncorrelation")
        plt.show()


def feedback():
    """Draw how a whole logit as reward feeds back."""
    diagram(
        (4.3, 2.7),
        {
            "rare": (
                0.95,
                2.2,
                "policy $\\pi_k$:\n$a$ too rare",
                plots.BLUE,
            ),
            "high": (
                3.3,
                2.2,
                "reward $f - \\log\\ \\pi_k$:\n$a$ high",
                plots.RED,
            ),
            "often": (
                3.3,
                0.5,
                "policy $\\pi_{k+1}$:\n$a$ too frequent",
                plots.BLUE,
            ),
            "low": (
                0.95,
                0.5,
                "reward $f - \\log\\ \\pi_{k+1}$:\n$a$ low",
                plots.RED,
            ),
        },
        [
            ("rare", "high", ""),
            ("high", "often", "SAC, round $k$"),
            ("often", "low", ""),
            ("low", "rare", "SAC, round $k + 1$"),
        ],
    )
    plt.show()


def _named(ax, x, y, name, color, **more):
    # A name at the right end of a line, instead of a legend.
    place = {"xytext": (4, 0), "textcoords": "offset points"}
    ax.annotate(name, (x, y), color=color, va="center", **place, **more)


def fixed_points(gaps):
    """Return the table of how far SAC's answer is from π*."""
    return table(
        (
            "temperature α",
            "factor c",
            "α<sub>f</sub>",
            "largest gap",
        ),
        [
            (
                f"{alpha:g}",
                f"{c:g}",
                f"{1 + alpha / c:g}",
                "below 10<sup>−9</sup>" if gap < 1e-9 else f"{gap:.2g}",
            )
            for (alpha, c), gap in gaps.items()
        ],
    )


def slopes(measured):
    """Return the table of predicted and measured slopes at α = 0.2."""
    names = {1.0: "full answers", 0.3: "a share of 0.3"}
    return table(
        ("in each round", "predicted", "measured"),
        [
            (names[share], number(1 - share * 6), number(value))
            for share, value in measured.items()
        ],
    )


def alternation(full, part):
    """Draw how far rounds lead from the fixed point."""
    four = (plots.RED, plots.ORANGE, plots.GREEN, plots.BLUE)
    three = (plots.RED, plots.GREEN, plots.BLUE)
    with plots.style():
        _fig, axes = plt.subplots(1, 2, figsize=(4.8, 3.4), sharey=True)
        for ax, lines, colors, letter in (
            (axes[0], full, four, r"\alpha"),
            (axes[1], part, three, r"\eta"),
        ):
            for (x, errors), color in zip(
                lines.items(), colors, strict=True
            ):
                ax.semilogy(errors, color=color)
                name = f"${letter} = {x}$"
                _named(ax, len(errors) - 1, errors[-1], name, color)
            ax.set(xlabel="round", xlim=(0, 21), xticks=(0, 5, 10))
        axes[0].set(ylabel=r"largest $|\log\pi - \log\pi^*|$")
        axes[0].set_title("full answers")
        axes[1].set_title(r"a share $\eta$, $\alpha = 0.2$")
        plt.show()


def tails(STORIES):
    """Draw how surprising old actions become, and return it."""
    tails = {}
    with plots.style():
        _fig, axes = plt.subplots(1, 2, figsize=(4.8, 3.4), sharey=True)
        for ax, (title, (story, color)) in zip(
            axes, STORIES.items(), strict=True
        ):
            updates = [s["updates"] for s in story]
            tails[title] = np.array([s["surprise"] for s in story])
            for column, line, level in zip(
                tails[title].T, ("-", "--", ":"), LEVELS, strict=True
            ):
                ax.plot(updates, column, line, color=color)
                if ax is axes[0]:
                    name = f"{level:.0%}"
                    _named(ax, updates[-1], column[-1], name, color)
            ax.set(xlabel="updates", title=title, xticks=(0, 1000, 2000))
            ax.set_xlim(0, 2800 if ax is axes[0] else 2050)
            ax.set_yscale("symlog", linthresh=10)
        axes[0].set_ylabel(r"$-\log\ \pi$ of old actions")
        plt.show()
    return tails


def _called(WORDS, form):
    """Return what the chapter calls what is paid."""
    return "f alone" if form == "-learned" else WORDS[form]


def crossed(WORDS, counted):
    """Return the table of seeds that arrive, by loop and tail."""

    def cell(*forms):
        "How many of the seeds of both rewards in f arrive."
        return "<br>".join(map(split, forms))

    def split(form):
        both, total = arrived[form], f"{sum(arrived[form])}"
        parts = " ({} + {})".format(*both) if any(both) else ""
        return f"<i>{_called(WORDS, form)}</i>: {total}{parts}"

    arrived = {
        form: [int(count.removesuffix(" of 5")) for count in counts]
        for form, counts in counted.items()
    }
    return table(
        ("of ten seeds arrive", "tail", "no tail"),
        [
            (
                "<b>loop</b>",
                cell("", "-cold"),
                cell("-clipped", "-mixture"),
            ),
            (
                "<b>no loop</b>",
                cell("-another's"),
                cell("-soft", "-learned"),
            ),
        ],
    )


PARTS = (  # what is paid, and how many forms pay it
    ("loop\nand tail", 2),
    ("tail\nonly", 1),
    ("loop\nonly", 2),
    ("neither", 2),
)


def isolate(FORMS, COLORS, final, last_q, shown, WORDS, counted):
    """Draw scores and values of the variants, in groups of what is paid."""
    assert len(counted) == sum(size for _, size in PARTS)
    with plots.style():
        fig, axes = plt.subplots(2, 1, figsize=(4.8, 7.6), sharey=True)
        for row, form in enumerate(FORMS):
            for n, y in ((1, row - 0.2), (2, row + 0.2)):
                name = f"implementation-{n}{form}"
                color = COLORS[f"implementation-{n}"]
                _dots(axes[0], y, _score(final[name], shown), color, 0.12)
                _dots(axes[1], y, last_q(name), color, 0.12)
        _score_axis(axes[0])
        first = 0
        for part, size in PARTS:
            place = {"xycoords": ("axes fraction", "data"), "va": "center"}
            middle = first + (size - 1) / 2
            for ax in axes:
                ax.annotate(part, (1.03, middle), **place)
                if first:
                    ax.axhline(first - 0.5, color=plots.GREY, lw=1)
            first += size
        for ax in axes:
            names = [_called(WORDS, form) for form in FORMS]
            ax.set_yticks(range(len(FORMS)), names)
            ax.grid(False, axis="y")
        axes[0].set_ylim(len(FORMS) - 0.5, -0.5)
        key = [
            axes[0].plot([], [], "o", color=COLORS[name], label=label)[0]
            for name, label in (
                ("implementation-1", "$r(s, a)$ in $f$"),
                ("implementation-2", "$r(s)$ in $f$"),
            )
        ]
        place = {"loc": "outside upper center", "ncols": 2}
        fig.legend(handles=key, fontsize="medium", **place)
        axes[1].set(xscale="log", xlabel="|mean Q| at the end")
        axes[1].set_xticks([1, 1e3, 1e6])
        axes[1].xaxis.set_minor_locator(NullLocator())
        plt.show()


def transitions_of_the_maze(recorded_here, expert):
    """Return transitions, and as many in another order."""
    # Transitions of the maze: half of experts, half of the film's warm-up.
    draw, parts = np.random.default_rng(0), ("obs", "action", "next_obs")
    warm = recorded_here["warmup"]
    index = draw.choice(5_000, len(warm["obs"]), replace=False)
    transitions = epic.Transitions(
        *(
            torch.cat(
                [
                    getattr(expert.transitions, part)[index],
                    torch.tensor(warm[part], dtype=torch.float32),
                ]
            )
            for part in parts
        )
    )
    COUNT = len(transitions.obs)
    samples = epic.Transitions(
        *(part[draw.permutation(COUNT)] for part in transitions)
    )
    return transitions, samples


def distances_to_truth(COLORS, labels, far, owner, means):
    """Draw the EPIC distances to the true reward."""
    tints = {name[-1]: tint for name, tint in COLORS.items()}
    tints |= {"released": plots.GREY, "DAC": COLORS["dac"]}
    with plots.style():
        _fig, ax = plt.subplots(figsize=(5.2, 3.2))
        for i, name in enumerate(labels[1:], 1):
            _dots(ax, i, far[0, owner == i], tints[name])
            ax.plot(means[i, i], i, "D", mfc="none", mec="black", ms=7)
        words = ["logit, $r(s, a)$ in $f$", "logit, $r(s)$ in $f$"]
        words += ["$r(s, a)$", "$r(s)$", "$r(s)$, log-ratio"]
        words += ["DAC's logit"]
        ax.set(yticks=range(1, 7), yticklabels=words, ylim=(6.5, 0.5))
        for label, name in zip(
            ax.get_yticklabels(), labels[1:], strict=True
        ):
            label.set_color(tints[name])
        ax.set(xlim=(0, 0.2), xlabel="EPIC distance to the true reward")
        ax.set_xticks((0, 0.05, 0.1, 0.15, 0.2))
        plt.show()


def transfers(HOME):
    """Return arrivals where the wall moved, and robots in percent."""
    MOVED = HOME / "maze-transfer-rewards-demo"
    three = MOVED / "implementation-4-released-and-airl/policy"
    arrivals = {  # from scratch and from the old policy: folder, first seed
        "DAC": (
            (MOVED / "dac-and-state-action/scratch", 0),
            (MOVED / "dac-and-state-action/policy", 0),
        ),
        "4": ((HOME / "maze-transfer-demo", 0), (three, 0)),
        "released": ((MOVED / "released-and-airl/scratch", 0), (three, 5)),
    }
    arrived = {}
    for name, parts in arrivals.items():
        ends = [
            records.read(folder).returns[first : first + 5, -1]
            for folder, first in parts
        ]
        arrived[name] = int((np.concatenate(ends) > -14).sum())

    robot_runs, percent = {}, {}
    for robot in ("Hopper", "Walker2d", "HalfCheetah"):
        about = records.read_json(demonstrations.EXPERTS / f"{robot}.json")
        for name in ("dac", "released"):
            run = records.read(
                HOME / f"what-decides-demo/{robot}-{name}-fixed-short"
            )
            robot_runs[robot, name] = run
            share = 100 * run.returns[:, -1] / about["returns"][0]
            percent[robot, name] = np.median(share)
    return arrived, robot_runs, percent


def summary(compared, truth, arrived, titles):
    """Return the table of three rewards."""
    score = {
        name: np.median(_score(compared[name].returns[:, -1], -6.5))
        for name in titles
    }
    return table(
        (
            "reward",
            "median<br>score",
            "median<br>EPIC distance",
            "wall moved:<br>arrive",
        ),
        [
            (
                title,
                f"{score[name]:.0f}\u00a0%",
                f"{truth[name]:.2f}",
                f"{arrived[name]} of 10",
            )
            for name, title in titles.items()
        ],
    )
