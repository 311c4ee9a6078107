"""The pictures and tables of chapter 11."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import HTML

import drawing
from offairl_lite.analysis import plots
from offairl_lite.analysis.statistics import difference, success_rate
from paper_claims import CLAIMS
from paper_verdicts import (
    CONFIRMED,
    CONFOUNDED,
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
COOL = "no guide, held warm-up, fixed temperature"


MARKS = {
    CONFIRMED: (plots.GREEN, "●"),
    IN_PART: (plots.GREEN, "◐"),
    UNDECIDED: (plots.ORANGE, "○"),
    CONFOUNDED: (plots.RED, "?"),
    UNTESTED: (plots.GREY, "–"),
}


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
    EVIDENCE = {
        4: f"From the old policy {arrived(4)[0]} of {SEEDS} seeds "
        "arrive after 100,000 steps; the others stay in the trap.",
        6: "After a short warm-up no seed arrives, with four "
        "primitives within "
        "{} steps or with eight within {}, at a fixed temperature. At a "
        "learned one ".format(*(c.scale.split("× ")[1] for c in FOUND[6]))
        + "none does either, but with four primitives it ran away in "
        "half of "
        "the seeds.",
        7: "Ten seeds cannot test a variance, so we ask instead "
        "whether more "
        f"arrive: {eight} of {SEEDS}, with SAC {sac}, after 40,000 steps. "
        "The difference may be luck.",
        8: "With random starts, where an expert of the new maze acts "
        "first, "
        f"{guided} of {SEEDS} arrive with primitives instead of {alone}: "
        "a clear difference by itself, though not after a correction "
        "for five "
        "tests, and with such an expert you need no transfer. "
        f"With a gate of eight alone {gate} arrive instead of "
        f"{gate_alone}, "
        "but there the temperature differs, too. "
        "With SAC {} instead of {}: perhaps luck.".format(*arrived(8)),
        1: "So far, on CustomAnt with the AIRL loss, 4 is better "
        "than 1 and "
        "2 and not clearly better than 3, but no ant walks.",
        2: f"So far, with the recipe and small networks and {step:,} "
        f"steps: "
        f"{recipe}. "
        f"With paper-size networks and three seeds: {larger}.",
        3: "So far no seed walks on a reward of the whole state, used "
        "as in "
        "the paper.",
        5: "So far, with the recipe, no clear difference on "
        "HalfCheetah, nor "
        "on Ant.",
    }
    return EVIDENCE


def verdicts(VERDICTS, EVIDENCE, MAZES, ON_ROBOTS):
    """Return the table of claims, each with its verdict."""

    def row(n):
        word = VERDICTS[n]
        color, sign = MARKS[word]
        mark = f'<b style="color: {color}">{sign}</b>'
        verdict = f'<td style="white-space: nowrap">{mark} {word}</td>'
        text = f"<b>{n}. {CLAIMS[n].text}</b><br>{EVIDENCE[n]}"
        return f"<tr>{verdict}<td>{text}</td></tr>"

    def heading(text):
        return f'<tr><th colspan="2">{text}</th></tr>'

    parts = [
        heading("On the maze: paper-size networks, ten seeds"),
        *map(row, MAZES),
        heading("On robots: short runs, three to five seeds"),
        *map(row, ON_ROBOTS),
    ]
    return HTML(f'<table class="table">{"".join(parts)}</table>')


def with_the_recipe(PAIRS, LABELS, of_demonstrations):
    """Draw the returns of four robots, off-policy AIRL and DAC."""
    with plots.style():
        _fig, axes = plt.subplots(
            2, 2, figsize=(7.2, 5), sharex=True, sharey=True
        )
        for ax, (robot, pair) in zip(axes.flat, PAIRS.items(), strict=True):
            for run, label, color in zip(
                pair, LABELS, (plots.BLUE, plots.ORANGE), strict=True
            ):
                percent = run.returns / of_demonstrations(robot)
                plots.curve(ax, run.steps / 1_000, percent, label, color)
            label = "demonstrations" if robot == "Walker2d" else ""
            plots.level(ax, 100, label, plots.GREEN)
            ax.set(title=robot)
        for ax in axes[1]:
            ax.set(xlabel="thousand steps")
        for ax in axes[:, 0]:
            ax.set(ylabel="% of the demonstrations")
        axes[0, 1].legend(loc="lower right")
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
        "1,000 random steps,\nnot 10,000": one_choice(
            KEPT, "released-fixed-long"
        ),
        "a temperature of 0.2,\nnot a learned one": one_choice(
            KEPT, "released-learned-short"
        ),
        "a temperature of 0.2,\nnot 1": one_choice(
            KEPT, "released-one-short"
        ),
        "with the AIRL loss a\ntemperature of 1.2, not 0.2": {
            robot: (f"{WARMER}/{run}", f"what-decides-demo/{run}")
            for robot in ROBOTS
            for run in [f"{robot}-exact-fixed-short"]
        },
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
            "DisabledAnt": (VELOCITY, "decides-transfer-demo/state/scratch")
        },
        "a centred reward,\nnot a raw one": {
            "DisabledAnt": (
                VELOCITY,
                "decides-transfer-demo/velocity-raw/scratch",
            )
        },
    }
    return CHOICES


def what_choices_add(at_the_end, CHOICES, GAINS):
    """Draw what each choice adds."""
    THOUSANDS = [
        " / ".join(
            f"{step // 1000}"
            for step in dict.fromkeys(
                at_the_end(pair)[0] for pair in pairs.values()
            )
        )
        for pairs in CHOICES.values()
    ]
    with plots.style():
        fig, ax = plt.subplots(figsize=(7.4, 7))
        ax.axvline(0, color="black", linewidth=0.8)
        named = {}
        for i, gains in enumerate(GAINS.values()):
            shifts = 0.22 * (np.arange(len(gains)) - (len(gains) - 1) / 2)
            for (robot, (middle, low, high)), shift in zip(
                gains.items(), shifts, strict=True
            ):
                color, marker = LOOKS[robot]
                ax.plot(
                    [low, high], [i + shift] * 2, color=color, alpha=0.5
                )
                (named[robot],) = ax.plot(
                    middle,
                    i + shift,
                    marker,
                    color=color,
                    ms=7,
                    mec="white",
                )
        labels = [
            f"{choice} ({steps}k)"
            for choice, steps in zip(GAINS, THOUSANDS, strict=True)
        ]
        ax.set_yticks(range(len(GAINS)), labels)
        ax.set(ylim=(len(GAINS) - 0.5, -0.5))
        ax.set_xlabel("what it adds, % of the demonstrations' return")
        fig.legend(
            [named[robot] for robot in LOOKS],
            LOOKS,
            loc="outside lower center",
            ncols=5,
        )
        plt.show()


def arrivals(maze):
    """Draw how many seeds arrive."""
    looks = {helped: look for helped, (_, *look) in HELP.items()}
    looks[COOL] = (plots.PURPLE, "v")
    with plots.style():
        fig, ax = plt.subplots(figsize=(7.4, 4.3))
        named = {}
        for i, way in enumerate(WAYS):
            helps = [helped for helped in looks if (way, helped) in maze]
            shifts = 0.18 * (np.arange(len(helps)) - (len(helps) - 1) / 2)
            for helped, shift in zip(helps, shifts, strict=True):
                rate, low, high = 100 * np.array(
                    success_rate(maze[way, helped])
                )
                color, marker = looks[helped]
                ax.plot(
                    [low, high], [i + shift] * 2, color=color, alpha=0.4
                )
                (named[helped],) = ax.plot(
                    rate,
                    i + shift,
                    marker,
                    color=color,
                    ms=7,
                    mec="white",
                    clip_on=False,
                )
        ax.set_yticks(range(len(WAYS)), WAYS)
        ax.set(xlim=(0, 100), ylim=(len(WAYS) - 0.5, -0.5))
        ax.set_xlabel("seeds that arrive (%)")
        fig.legend(
            [named[helped] for helped in looks],
            looks,
            loc="outside lower center",
            ncols=2,
        )
        plt.show()


def open_questions(FOUND, extra, open_claims):
    """Return the table of what would settle the open claims."""
    return drawing.table(
        ("open claim", "what would settle it"),
        [
            (
                f"{n}. {CLAIMS[n].text}",
                needed(n, FOUND[n]) + extra.get(n, ""),
            )
            for n in open_claims
        ],
    )
