"""Draw what a good and a failed run look like from inside.

The runs are those of the table of `recipe_working.md`, and in `gap.svg` all
25 seeds of the recipe on Walker2d after 100,000 steps.

.venv/bin/python book/_static/working.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from offairl_lite import demonstrations
from offairl_lite.analysis import plots
from offairl_lite.runs import records

BOOK = Path(__file__).parents[1]
RUNS = {
    "Hopper": (
        ("locomotion-first-demo/Hopper-airl", plots.GREY),
        ("hopper-none-demo/Hopper-released-fixed-short", plots.RED),
        ("what-decides-demo/Hopper-released-fixed-short", plots.BLUE),
    ),
    "Walker2d": (
        ("locomotion-first-demo/Walker2d-airl", plots.GREY),
        ("what-decides-demo/Walker2d-released-fixed-long", plots.RED),
        ("what-decides-demo/Walker2d-released-fixed-short", plots.BLUE),
    ),
}
"""With another loss; with one setting changed; with the recipe."""
WALKERS = (
    "what-decides-demo/Walker2d-released-fixed-short",
    "what-decides-more-demo/Walker2d-released-fixed-short",
    "locomotion-demo/Walker2d-airl",
    "locomotion-again-demo/Walker2d-airl",
)
"""All that were trained by the recipe: 25 seeds."""


def numbers(run, value):
    """Return a diagnostic of all seeds (K, S) at K evaluations."""
    found = [value(row.metrics) for row in run.rows]
    return np.reshape(found, (len(run.steps), len(run.seeds)))


with plots.style():
    plt.rcParams["svg.hashsalt"] = "working"
    fig, axes = plt.subplots(
        2, 2, figsize=(6.2, 4.6), sharex=True, sharey="row"
    )
    for (top, low), robot in zip(axes.T, RUNS, strict=True):
        for name, color in RUNS[robot]:
            run = records.read(BOOK / "records" / name)
            early = run.steps <= 100_000
            steps = run.steps[early] / 1_000
            gap = numbers(
                run, lambda m: m["expert_logit"] - m["policy_logit"]
            )
            entropy = numbers(run, lambda m: m["entropy"])
            top.semilogy(steps, gap[early], color=color, lw=1.3, alpha=0.8)
            low.plot(steps, entropy[early], color=color, lw=1.3, alpha=0.8)
        top.set_title(robot)
        low.axhline(np.log(2), color=plots.GREY, ls="--", lw=1.2)
        low.set(xlabel="thousand steps", ylim=(0, 0.75), xlim=(0, 102))
    axes[0, 0].set(ylabel="logit gap")
    axes[1, 0].set(ylabel="entropy of the verdict")
    axes[0, 1].text(100, 1.4, "works", color=plots.BLUE, ha="right")
    axes[0, 1].text(
        100, 8, "one setting changed", color=plots.RED, ha="right"
    )
    axes[0, 1].text(98, 30, "AIRL loss", color=plots.GREY, ha="right")
    axes[1, 1].text(
        100, 0.63, "cannot tell them apart", color=plots.GREY, ha="right"
    )
    fig.savefig(BOOK / "_static/working.svg", metadata={"Date": None})

expert = records.read_json(demonstrations.EXPERTS / "Walker2d.json")
rows = [
    row
    for name in WALKERS
    for row in records.read(BOOK / "records" / name).rows
    if row.step == 100_000
]
with plots.style():
    plt.rcParams["svg.hashsalt"] = "gap"
    fig, ax = plt.subplots(figsize=(4.6, 3))
    ax.plot(
        [
            r.metrics["expert_logit"] - r.metrics["policy_logit"]
            for r in rows
        ],
        [100 * row.mean_return / expert["returns"][0] for row in rows],
        "o",
        color=plots.BLUE,
        alpha=0.7,
    )
    ax.set(
        xlabel="logit gap", ylabel="percent of the expert", ylim=(0, 100)
    )
    fig.savefig(BOOK / "_static/gap.svg", metadata={"Date": None})
