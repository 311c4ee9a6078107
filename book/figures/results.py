"""The pictures and tables of chapter 11."""

from pathlib import Path

import matplotlib.pyplot as plt
from IPython.display import HTML

import drawing
import plots
from offairl_lite.analysis.statistics import difference, success_rate
from offairl_lite.runs import records
from paper_claims import BAR
from paper_verdicts import (
    CONFIRMED,
    CONFOUNDED,
    COULD_NOT_FAIL,
    IN_PART,
    SEEDS,
    UNDECIDED,
    UNTESTED,
    seen,
)
from paper_words import needed

RECORDS = Path("records")

LOOKS = {
    "Hopper": (plots.BLUE, "o"),
    "Walker2d": (plots.ORANGE, "s"),
    "HalfCheetah": (plots.GREEN, "D"),
    "CustomAnt": (plots.PURPLE, "^"),
    "DisabledAnt": (plots.RED, "v"),
}


WAYS = {
    "from scratch": "scratch",
    "old policy": "policy",
    "gate and primitives, 4": "4-both",
    "gate and primitives, 8": "8-both",
    "gate alone, 4": "4-gate",
    "gate alone, 8": "8-gate",
}
HELP = {
    "no guide": ("", plots.BLUE, "o"),
    "guide: the imitator": ("-own-starts", plots.GREY, "s"),
    "guide: an expert of the new maze": (
        "-expert-starts",
        plots.ORANGE,
        "D",
    ),
}
HELD = "no guide, held warm-up"
COOL = "no guide, held warm-up, fixed temperature"


MARKS = {
    CONFIRMED: (plots.GREEN, "●"),
    COULD_NOT_FAIL: (plots.GREY, "◌"),
    IN_PART: (plots.GREEN, "◐"),
    UNDECIDED: (plots.ORANGE, "○"),
    CONFOUNDED: (plots.RED, "?"),
    UNTESTED: (plots.GREY, "–"),
}


NAMES = {
    1: "The best reward",
    2: "Beats DAC",
    3: "The ant",
    4: "The wall",
    5: "Primitives on robots",
    6: "The gate",
    7: "Eight primitives",
    8: "Random starts",
}
"""What the chapter calls the paper's claims."""

SAYS = {
    1: "of four that may pay the agent, <code>r(s)</code> is the best.",
    2: "off-policy AIRL does, on Hopper and Walker2d. On HalfCheetah and "
    "Ant it is comparable.",
    3: "the transfer to an ant with two weak legs fails.",
    4: "it moves, and the reward stays. Some old policies find the new "
    "way, some do not.",
    5: "mixing several skills, the primitives, improves imitation on "
    "HalfCheetah and Ant.",
    6: "it mixes the old skills, the primitives. Training it alone fails.",
    7: "with them the outcome varies less than with one policy (SAC).",
    8: "if a guide takes the first steps, the outcome is better, and "
    "varies less.",
}
"""What each claims."""

LIMITS = {
    (6, CONFIRMED): "confirmed for a short warm-up and few steps",
    (7, UNDECIDED): "undecided, for arrivals",
    (8, IN_PART): "confirmed in part, a hint",
}
"""How far a verdict reaches, where that is not everywhere."""


def _listed(names):
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


def _against_dac(pair):
    """The last step of two runs, and in words how they compare there."""
    step = max(set(pair[0].steps) & set(pair[1].steps))
    ends = [run.returns[:, run.steps == step].ravel() for run in pair]
    words = {
        "as claimed": "ahead",
        "the opposite": "behind",
        "unclear": "no clear difference",
    }
    return step, words[seen(*difference(*ends)[1:])]


def by_word(robots, size, by_recipe):
    """The last step, and how off-policy AIRL compares with DAC there."""
    compared = {}
    for robot in robots:
        step, word = _against_dac(by_recipe(robot, size))
        compared.setdefault(word, []).append(robot)
    return step, ", ".join(
        f"{word} on {_listed(robots)}"
        for word, robots in sorted(compared.items())
    )


def evidence(arrived, FOUND, recipe, step, larger):
    """Return what speaks for each claim, or against it."""
    (eight, sac), (guided, alone) = arrived(7), arrived(8, 2)
    gate, gate_alone = arrived(8, 4)
    early = records.read(RECORDS / "maze-retraining-full/policy")
    early = early.returns[:, early.steps <= 40_000][:, -1] > BAR
    four, gate_of_eight = (c.scale.split("× ")[1] for c in FOUND[6])
    EVIDENCE = {
        4: f"{early.sum()} of {SEEDS} old policies arrive within 40,000 "
        f"steps, {arrived(4)[0]} within 100,000; under our rule no number "
        "could have contradicted this claim",
        6: "at a fixed temperature no gate of ten arrives over four "
        f"primitives ({four} steps), and none over eight "
        f"({gate_of_eight}). After another warm-up? Bet in the section on "
        "the maze",
        7: f"{eight} of {SEEDS} arrive with eight primitives, {sac} with "
        "SAC; a difference in variance ten seeds can hardly show",
        8: "if an expert of the new maze takes the first steps, "
        f"{guided} of {SEEDS} arrive instead of {alone} with primitives, "
        f"and {gate} instead of {gate_alone} with a gate of eight; with "
        "SAC {} instead of {}, perhaps luck. That it varies less is not "
        "tested".format(*arrived(8)),
        1: "AIRL loss, CustomAnt: <code>r(s)</code> is better than the "
        "logits, but no ant walks. The recipe: <code>r(s)</code> and "
        "<code>r(s,a)</code> make it walk, the logits do not",
        2: f"the recipe, {step:,} steps: {recipe}. Paper-size networks, "
        f"three seeds: {larger}",
        3: "no seed walks on a reward of the whole state, used as in the "
        "paper or with the recipe; on one of the velocity all five, to "
        "about half of an expert's return",
        5: "no clear difference on HalfCheetah, nor on Ant",
    }
    return EVIDENCE


def verdicts(VERDICTS, EVIDENCE, MAZES, ON_ROBOTS):
    """Return the claims, each with its verdict folded below it."""

    def box(n):
        word = VERDICTS[n]
        color, sign = MARKS[word]
        verdict = f"{sign} {LIMITS.get((n, word), word)}"
        return (
            f"<details><summary><b>{n} · {NAMES[n]}:</b> {SAYS[n]}"
            f'</summary><p><b style="color: {color}">{verdict}:</b> '
            f"{EVIDENCE[n]}.</p></details>"
        )

    def group(title, claims):
        return f"<p><b>{title}</b></p>{''.join(map(box, claims))}"

    maze = group(
        "On the maze: the paper's networks, ten seeds, up to a plateau",
        MAZES,
    )
    robots = group("On robots, with shorter runs so far", ON_ROBOTS)
    return HTML(f'<div class="verdicts">{maze}{robots}</div>')


def with_the_recipe(
    PAIRS, LABELS, percent, hundred="demonstrations", clones=None
):
    """Draw the returns on some robots, off-policy AIRL and DAC.

    `percent` gives one percent of the return of a robot's `hundred`.
    `clones` has for each robot what clones return, in percent.
    """
    colors = (plots.BLUE, plots.ORANGE)
    names = [*zip(LABELS, colors, strict=True), (hundred, plots.EXPERT)]
    names += [("a clone", plots.GREEN)] if clones else []
    rows = -(-len(PAIRS) // 2)
    with plots.style():
        _fig, axes = plt.subplots(
            rows,
            2,
            figsize=(5.4, 0.3 + 2.15 * rows),
            sharex=True,
            sharey=True,
            squeeze=False,
        )
        for ax, (robot, pair) in zip(axes.flat, PAIRS.items(), strict=True):
            for run, label, color in zip(pair, LABELS, colors, strict=True):
                returns = run.returns / percent(robot)
                plots.curve(ax, run.steps / 1_000, returns, label, color)
            plots.level(ax, 100, "", plots.EXPERT)
            if clones:
                plots.level(ax, clones[robot], "", plots.GREEN)
            ax.set(title=robot)
        for ax in axes[-1]:
            ax.set(xlabel="thousand steps")
        for ax in axes[:, 0]:
            ax.set(ylabel=f"% of {hundred}")
        # In HalfCheetah's panel there is room for the key.
        free = axes.flat[[*PAIRS].index("HalfCheetah")]
        for i, (label, color) in enumerate(reversed(names)):
            free.text(
                0.97,
                0.05 + 0.12 * i,
                label,
                color=color,
                ha="right",
                transform=free.transAxes,
            )
        plt.show()


def choices(ROBOTS, PAIRS):
    """Return pairs of runs that differ in one choice."""

    def one_choice(kept, other):
        """Pairs of runs that differ in one setting, 100,000 steps each."""
        folder = "what-decides-demo/{}-{}"
        pairs = {
            robot: (folder.format(robot, kept), folder.format(robot, other))
            for robot in ROBOTS
        }
        return {
            robot: pair
            for robot, pair in pairs.items()
            if all((RECORDS / run).is_dir() for run in pair)
        }

    KEPT = "released-fixed-short"
    WARMER = "decides-1.2-demo"
    VELOCITY = "decides-transfer-demo/velocity/scratch"
    CHOICES = {
        "the log-ratio loss,\nnot the AIRL loss": one_choice(
            KEPT, "exact-fixed-short"
        ),
        "the same choice at\na temperature of 1": one_choice(
            "released-one-short", "exact-one-short"
        ),
        "a temperature of 0.2,\nnot 1": one_choice(
            KEPT, "released-one-short"
        ),
        "with the AIRL loss a\ntemperature of 1.2, not 0.2": {
            robot: (f"{WARMER}/{run}", f"what-decides-demo/{run}")
            for robot in ROBOTS
            for run in [f"{robot}-exact-fixed-short"]
        },
        "1,000 random steps,\nnot 10,000": one_choice(
            KEPT, "released-fixed-long"
        ),
        "a temperature of 0.2,\nnot a learned one": one_choice(
            KEPT, "released-learned-short"
        ),
        "an absorbing state,\nnot none": {
            "Hopper": (
                f"what-decides-demo/Hopper-{KEPT}",
                "hopper-none-demo/Hopper-released-fixed-short",
            )
        },
        "networks of 256-256,\nnot 64-64": {
            robot: (f"decides-wide-demo/{run}", f"what-decides-demo/{run}")
            for robot in ROBOTS
            for run in [f"{robot}-{KEPT}"]
        },
        "off-policy AIRL,\nnot DAC": PAIRS,
        "DAC with SAC,\nnot with TD3": {
            robot: (f"{run}-dac", f"{run}-dac-td3")
            for robot in ROBOTS
            for run in [f"locomotion-demo/{robot}"]
        },
        "eight primitives,\nnot one Gaussian": {
            "HalfCheetah": (
                "locomotion-demo/HalfCheetah-mcp-8",
                "locomotion-demo/HalfCheetah-airl",
            ),
            "CustomAnt": (
                "ant-rewards-mcp-8-demo/implementation-4-mixture",
                "ant-rewards-centred-demo/implementation-4-mixture",
            ),
        },
        "a reward of the velocity,\nnot of the whole state": {
            "DisabledAnt": (VELOCITY, "decides-transfer-demo/whole/scratch")
        },
        "a centred reward,\nnot a raw one": {
            "DisabledAnt": (
                VELOCITY,
                "decides-transfer-demo/velocity-raw/scratch",
            )
        },
    }
    return CHOICES


HEADINGS = {
    "the log-ratio loss,\nnot the AIRL loss": (
        "at temperature 0.2: log-ratio loss, not AIRL loss"
    ),
    "the same choice at\na temperature of 1": (
        "at temperature 1: log-ratio loss, not AIRL loss"
    ),
    "a temperature of 0.2,\nnot 1": (
        "with the log-ratio loss: temperature 0.2, not 1"
    ),
    "with the AIRL loss a\ntemperature of 1.2, not 0.2": (
        "with the AIRL loss: temperature 1.2, not 0.2"
    ),
    "1,000 random steps,\nnot 10,000": "random steps: 1,000, not 10,000",
    "an absorbing state,\nnot none": (
        "end of an episode: absorbing state, not none"
    ),
    "a reward of the velocity,\nnot of the whole state": (
        "what a reward sees: velocity, not the whole state"
    ),
}


def _decides(gains):
    """Whether a choice is clearly worth more than half on some robot."""
    return any(low > 0 and middle > 50 for middle, low, _ in gains.values())


def what_choices_add(at_the_end, CHOICES, GAINS, *, deciding):
    """Draw what choices add, those that decide or the rest.

    There is a heading for each choice, and a row below it for each robot.
    """
    shown = [c for c in GAINS if _decides(GAINS[c]) == deciding]
    rows = len(shown) + sum(len(GAINS[choice]) for choice in shown)
    with plots.style():
        fig, ax = plt.subplots(
            figsize=(4.8, 0.7 + 0.24 * rows + 0.12 * len(shown))
        )
        y, names = 0.0, {}
        for choice in shown:
            heading = HEADINGS.get(choice, choice.replace("\n", " "))
            _line(ax, y, heading, weight="bold")
            steps = {at_the_end(p)[0]: 0 for p in CHOICES[choice].values()}
            if [*steps] != [100_000]:
                text = " / ".join(f"{k // 1000}k" for k in steps)
                _line(ax, y, text, 1, ha="right", color=plots.GREY)
            for robot, gain in GAINS[choice].items():
                y += 1
                names[y] = robot
                _gain(ax, y, robot, gain)
            y += 1.5
        ax.set(xlim=(-50, 225), xticks=[0, 50, 100, 150])
        ax.set_ylim(y - 0.8, -0.7)
        ax.set_yticks([*names], names.values())
        for label, robot in zip(
            ax.get_yticklabels(), names.values(), strict=True
        ):
            label.set_color(LOOKS[robot][0])
        ax.tick_params(length=0)
        ax.grid(visible=False)
        ax.spines[:].set_visible(False)
        text = "what it adds, % of the demonstrations' return"
        fig.supxlabel(text, fontsize=10)
        plt.show()


def _line(ax, y, text, at=-0.26, color="black", **look):
    """Write a heading over the rows of a choice, or at its end."""
    ax.text(
        at,
        y,
        text,
        color=color,
        va="center",
        in_layout=False,
        transform=ax.get_yaxis_transform(),
        **look,
    )


def _gain(ax, y, robot, gain):
    """Draw a difference with its interval; hollow if it may be nothing.

    A clear one of less than 5 % is pale. The number stands at the right.
    """
    middle, low, high = gain
    color, marker = LOOKS[robot]
    clear, pale = low > 0 or high < 0, abs(middle) < 5
    text = f"{round(middle) + 0:+}".replace("-", "−").replace("+0", "0")
    ink = color if clear and not pale else plots.GREY
    strip = y - 0.42, y + 0.42
    ax.axhspan(*strip, color="#f2f2f2", zorder=0)
    ax.plot([0, 0], strip, color=plots.GREY, lw=0.8, zorder=1)
    ax.text(222, y, text, color=ink, ha="right", va="center")
    faint = 0.35 if pale and clear else 1
    line = {"alpha": 0.5 if clear and not pale else 0.3, "lw": 2}
    ax.plot([low, high], [y, y], color=color, **line)
    fill = {"ms": 9, "mec": "white"} if clear else {"ms": 7, "mfc": "white"}
    look = {"mew": 1.2, "zorder": 3, "alpha": faint}
    ax.plot(middle, y, marker, color=color, **look, **fill)


def arrivals(maze):
    """Draw which seeds arrive: a panel a guide, a row a way of learning.

    Of the primitives only eight are drawn.
    """
    titles = (
        "no guide",
        "the imitator guides",
        "an expert of the new maze guides",
    )
    panels = {
        helped: {
            way.removesuffix(", 8"): maze[way, helped]
            for way in WAYS
            if (way, helped) in maze and not way.endswith(", 4")
        }
        for helped in HELP
    }
    first = next(iter(panels))
    held = "gate alone, held,\nfixed temperature"
    panels[first]["gate alone, held"] = maze["gate alone, 8", HELD]
    panels[first][held] = maze["gate alone, 8", COOL]
    rows = [len(panel) for panel in panels.values()]
    with plots.style():
        _fig, axes = plt.subplots(
            len(HELP),
            1,
            figsize=(4.2, 1.5 + 0.27 * sum(rows)),
            height_ratios=rows,
            sharex=True,
        )
        for ax, title, (helped, panel) in zip(
            axes, titles, panels.items(), strict=True
        ):
            color = HELP[helped][1]
            ax.set_title(title, color=color, fontsize=10, loc="left")
            ax.set(xlim=(-0.3, 12.3), xticks=[])
            ax.grid(visible=False)
            ax.spines[:].set_visible(False)
            ax.tick_params(length=0)
            for i, (way, seeds) in enumerate(panel.items()):
                purple = plots.PURPLE if way == held else color
                _seeds(ax, i, seeds, purple)
            names = [
                f"{way}, held" if way == "from scratch" else way
                for way in panel
            ]
            ax.set_yticks(range(len(panel)), names)
            ax.set_ylim(len(panel) - 0.4, -0.6)
        axes[0].get_yticklabels()[-1].set_color(plots.PURPLE)
        plt.show()


def _seeds(ax, y, seeds, color):
    """Draw a dot for each seed, filled if it arrives, and how many do."""
    _, low, high = success_rate(seeds)
    n, count = len(seeds), int(seeds.sum())
    ax.plot(
        [n * low, n * high],
        [y, y],
        color=color,
        alpha=0.2,
        lw=9,
        solid_capstyle="butt",
    )
    for i in range(n):
        fill = color if i < count else "white"
        ax.plot(i + 0.5, y, "o", ms=6, mfc=fill, mec=color, mew=0.8)
    ax.text(n + 2.2, y, str(count), color=color, ha="right", va="center")


def open_questions(FOUND, extra, open_claims):
    """Return the table of what would settle the open claims."""
    return drawing.table(
        ("open claim", "what would settle it"),
        [
            (
                NAMES[n],
                needed(n, FOUND[n]) + extra.get(n, ""),
            )
            for n in open_claims
        ],
    )
