"""The pictures, tables and the film of chapter 9."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
from IPython.display import HTML

import plots
from drawing import diagram, film, outline, percent, table
from offairl_lite.core.rollouts import rollout
from offairl_lite.envs.models import GOAL, START, WALL_RADIUS, walls
from offairl_lite.runs import records

RECORDS = Path("records")
LEFT, RIGHT = "offairl/PointMazeLeft-v0", "offairl/PointMazeRight-v0"
TWO_KINDS = "maze-transfer-rewards-demo/released-and-airl"


EDGE = outline(2.6)


def walk(policy, task):
    """Return places (S, T, 2) of one episode of each seed."""
    seeds = range(len(policy))
    return rollout(policy, task, seeds, 1).obs[:, 0, :, :2]


THREE_KINDS = (
    "maze-transfer-rewards-demo/implementation-4-released-and-airl"
)
SMALL, LARGE = "maze-retraining-demo", "maze-retraining-full"
ARMS = ("scratch", "policy", "8-both", "8-gate")
HELPS = {
    "": "short fresh",
    "-own-starts": "short fresh, guide: imitator",
    "-expert-starts": "short fresh, guide: expert",
    "-fresh": "long fresh",
    "-helped": "long held",
    "-cool": "long held, temperature 0.02",
}
# Most runs are named after start and help; these are elsewhere.
ELSEWHERE = {
    (SMALL, "scratch", "-fresh"): f"{THREE_KINDS}/scratch-alone",
    (SMALL, "scratch", "-helped"): "maze-transfer-demo",
    (SMALL, "policy", "-helped"): f"{THREE_KINDS}/policy",
    (LARGE, "scratch", "-helped"): f"{LARGE}/scratch",
    (LARGE, "8-gate", "-cool"): "maze-retraining-cool-full/8-gate-helped",
}
BAR = -14


DAC_AND_PPO = "maze-transfer-rewards-demo/dac-and-state-action"
BEGINS = ("scratch", "policy", "scratch-alone", "policy-alone")


def _all_in(folder, first=0):
    return {begin: (f"{folder}/{begin}", first) for begin in BEGINS}


# Where the runs are, and the first of the five seeds: rewards of one form
# were TRIED together.
TRIED = {
    "exact logit": {
        "scratch": ("maze-transfer-demo", 0),
        "policy": (f"{THREE_KINDS}/policy", 0),
        "scratch-alone": (f"{THREE_KINDS}/scratch-alone", 0),
        "policy-alone": ("maze-retraining-demo/policy", 0),
    },
    "density of the replay": _all_in("maze-transfer-rewards-demo/mixture"),
    "released loss": {
        "scratch": (f"{TWO_KINDS}/scratch", 0),
        "policy": (f"{THREE_KINDS}/policy", 5),
        "scratch-alone": (f"{THREE_KINDS}/scratch-alone", 5),
        "policy-alone": (f"{TWO_KINDS}/policy-alone", 0),
    },
    "DAC": _all_in(DAC_AND_PPO),
    "PPO, r(s)": {
        "scratch": (f"{TWO_KINDS}/scratch", 5),
        "policy": (f"{THREE_KINDS}/policy", 10),
        "scratch-alone": (f"{THREE_KINDS}/scratch-alone", 10),
        "policy-alone": (f"{TWO_KINDS}/policy-alone", 5),
    },
    "PPO, r(s, a)": _all_in(DAC_AND_PPO, 5),
    "true reward": {
        begin: (f"maze-transfer-rewards-demo/true/true-{begin}", 0)
        for begin in BEGINS
    },
}


SOURCES = {
    "exact logit": "maze-imitation-demo",
    "density of the replay": "maze-rewards-demo/implementation-4-mixture",
    "released loss": "maze-imitation-released-loss-demo",
    "DAC": "maze-dac-demo/sac",
    "PPO, r(s)": "maze-airl-ppo-demo/state",
    "PPO, r(s, a)": "maze-airl-ppo-demo/state-action",
}


NAMED = {
    "exact logit": "AIRL loss, r(s)",
    "density of the replay": "density of the replay, r(s)",
    "released loss": "log-ratio loss, r(s)",
    "DAC": "DAC, r(s, a)",
}


def old_and_new(source, again, on_ppo, ppo):
    """Return a film of old and new policies, and what moves in it."""
    scenes = (
        ("the old policies", source.policy, source.reward, plots.COPY),
        (
            "new policies,\noff-policy reward",
            again.policy,
            source.reward,
            plots.AGENT,
        ),
        (
            "new policies,\non-policy reward",
            on_ppo.policy.member(*range(5, 10)),
            ppo.reward,
            plots.AGENT,
        ),
    )
    with plots.style():
        fig, axes = plt.subplots(1, 3, figsize=(7.2, 2.8), dpi=130)
        moving = []
        for ax, (title, policy, reward, color) in zip(
            axes, scenes, strict=True
        ):
            plots.reward_map(ax, reward, "Right", 0)
            ax.axis("off")
            ax.set_title(title, fontsize=12)
            for path in walk(policy, RIGHT):
                (line,) = ax.plot([], [], color=color, lw=2.6, zorder=4)
                line.set_path_effects(EDGE)
                (dot,) = ax.plot([], [], "o", color=color, ms=9, zorder=5)
                dot.set(markeredgecolor="white", markeredgewidth=1.5)
                moving.append((path, line, dot))

    def draw_step(frame):
        for path, line, dot in moving:
            line.set_data(*path[: frame + 1].T)
            dot.set_data(*path[frame : frame + 1].T)

    frames = film(fig, lambda i: draw_step(min(2 * i, 54)), 33)
    return moving, frames


def frozen():
    """Draw how a frozen reward trains a new policy."""
    diagram(
        (4.6, 4.2),
        {
            "demos": (
                1.0,
                3.7,
                "demonstrations\nof the old maze",
                plots.EXPERT,
            ),
            "airl": (3.6, 3.7, "off-policy\nAIRL"),
            "r": (
                1.0,
                2.1,
                "reward " + r"$r_\psi(s)$" + "\nfrozen",
                plots.REWARD,
            ),
            "pi": (3.6, 2.1, "old policy " + r"$\pi$", plots.COPY),
            "help": (3.6, 0.5, "warm-up,\nguide"),
            "sac": (1.0, 0.5, "SAC in the\nnew maze", plots.AGENT),
        },
        [
            ("demos", "airl"),
            ("airl", "r"),
            ("airl", "pi"),
            ("r", "sac", "reward"),
            ("pi", "sac", "start?"),
            ("help", "sac", "exploration"),
        ],
    )
    plt.show()


def three_forms(errors):
    """Return the table of what three changes of the reward do."""
    forms = ("constant", "shaping that sees s′", "shaping folded into s, a")
    return table(
        ["the reward plus", "error in the old world", "in the new world"],
        [
            (form, *(f"{errors[world][i]:.2f}" for world in errors))
            for i, form in enumerate(forms)
        ],
    )


def way_back(moved, shown, carried, there):
    """Draw the returns of new policies, and their paths, side by side."""
    with plots.style():
        fig, (curve, world) = plt.subplots(
            1, 2, figsize=(5.0, 2.35), layout="compressed"
        )
        plots.curve(
            curve, moved.steps / 1_000, moved.returns, "", plots.AGENT
        )
        plots.level(curve, shown, "demonstrations", plots.EXPERT)
        plots.level(curve, carried.mean(), "old policies", plots.COPY)
        curve.set(xlabel="thousand steps", ylabel="score")
        ticks = (-26.5, -16.5, -6.5)
        curve.set_yticks(ticks, [percent(value) for value in ticks])
        curve.set(ylim=(-34, -4), box_aspect=1)
        curve.locator_params(axis="x", integer=True)
        image = plots.reward_map(world, there.reward, "Left")
        for path in walk(moved.policy, LEFT):
            world.plot(
                *path.T,
                color=plots.AGENT,
                lw=2.6,
                path_effects=EDGE,
                zorder=4,
            )
        low, high = walls("Left").min(), walls("Left").max()
        ends = low - WALL_RADIUS, high + WALL_RADIUS
        world.set(xlim=ends, ylim=ends)
        world.axis("off")
        fig.colorbar(image, ax=world, label=r"$r_\psi(s)$")
        plt.show()


def warm_ups(fresh, held):
    """Draw the places that fresh and held actions lead to."""
    with plots.style():
        _fig, axes = plt.subplots(1, 2, figsize=(4.8, 2.6))
        for ax, found, title, color in (
            (axes[0], fresh, "fresh actions", plots.ORANGE),
            (axes[1], held, "held actions", plots.BLUE),
        ):
            ax.plot(*found.T, ".", color=color, ms=3, alpha=0.5, zorder=1)
            plots.maze(ax, "Right")
            ax.axis("off")
            ax.set_title(title)
        plt.show()


def retrainings():
    """Return the recorded runs, by size, start and help."""
    runs = {}
    for size_of in (SMALL, LARGE):
        for arm in ARMS:
            for end_of in HELPS:
                key = size_of, arm, end_of
                named = arm != "scratch" and f"{size_of}/{arm}{end_of}"
                place = ELSEWHERE.get(key, named)
                if place and (RECORDS / place).exists():
                    runs[key] = records.read(RECORDS / place)
    return runs


def count(arrives, runs):
    """Return how many seeds arrive, as words, by size and help."""
    counts = {
        size_of: {
            end_of: [
                str(arrives((size_of, arm, end_of)).sum())
                if (size_of, arm, end_of) in runs
                else ""
                for arm in ARMS
            ]
            for end_of in HELPS
        }
        for size_of in (SMALL, LARGE)
    }
    return counts


def _seeds(count, of):
    """Return dots in rows of five, filled for runs that arrive."""
    full = '<span style="color: var(--pst-color-primary)">●</span>'
    dots = [full] * count + ["○"] * (of - count)
    rows = "<br>".join("".join(dots[i : i + 5]) for i in range(0, of, 5))
    return (
        f'<span role="img" aria-label="{count} of {of}" '
        f'style="white-space: nowrap; line-height: 1.1">{rows}</span>'
    )


def _tables(*parts, folded=False):
    """Return tables, each below the sentence that it shows, and its runs.

    If `folded`, a reader opens the last one with a click on its sentence.
    """
    texts = [
        f'<p style="margin: 1.5rem 0 0.5rem"><b>{message}</b><br>'
        f"{about}</p>{shown.data}"
        for message, about, shown in parts
    ]
    if folded:
        message, about, shown = parts[-1]
        texts[-1] = (
            f"<details><summary><b>{message}</b></summary>"
            f"<p>{about}</p>{shown.data}</details>"
        )
    return HTML("".join(texts))


def _dots(counts, size_of, end_of, arm):
    of = {SMALL: 5, LARGE: 10}[size_of]
    return _seeds(int(counts[size_of][end_of][arm]), of)


def starts(counts):
    """Return the table of how many seeds arrive, by start and warm-up."""
    names = "scratch", "old policy", "gate and primitives", "gate alone"
    warm_ups = [(few, "-helped") for few in ("-fresh", "", "", "")]
    rows = [
        (name, *(_dots(counts, SMALL, end, arm) for end in ends))
        for arm, (name, ends) in enumerate(
            zip(names, warm_ups, strict=True)
        )
    ]
    return _tables(
        (
            "After held steps all arrive but the gate alone.",
            "Small networks, five seeds, 8,000 steps, no guide. Fresh: "
            "3,000 steps from scratch, 100 otherwise. Held: 3,000.",
            table(("start", "after fresh steps", "after held steps"), rows),
        )
    )


def guides(counts):
    """Return the table of how many seeds arrive, by guide and start."""
    rows = [
        (name, *(_dots(counts, LARGE, end_of, arm) for arm in (1, 2, 3)))
        for name, end_of in (
            ("no guide", ""),
            ("the imitator", "-own-starts"),
            ("an expert of<br>the new maze", "-expert-starts"),
        )
    ]
    heads = ("old<br>policy", "gate and<br>primitives", "gate<br>alone")
    return _tables(
        (
            "An expert of the new maze is the best guide.",
            "The paper's networks, ten seeds, 40,000 steps, the first 100 "
            "fresh.",
            table(["guide", *heads], rows),
        )
    )


def when_a_gate(offered, arrived, gated):
    """Draw which seeds arrive, by the pushes that they can make."""
    with plots.style():
        _fig, ax = plt.subplots(figsize=(4.8, 2.9))
        order = offered.argsort()
        for i, succeeds in enumerate(arrived.values()):
            for place, there_it_is in enumerate(succeeds[order]):
                color = plots.BLUE if there_it_is else plots.GREY
                fill = color if there_it_is else "w"
                ax.plot(place, i, "s", color=color, mfc=fill, ms=10)
        ax.axvline(
            (offered < 0.9).sum() - 0.5, color=plots.GREY, lw=1, ls="--"
        )
        ax.set_yticks(range(len(gated)), gated)
        ax.set(ylim=(3.6, -0.6), xlim=(-0.6, 9.6))
        ax.set_xticks(range(10), [f"{100 * x:.0f}" for x in offered[order]])
        ax.set_ylabel("warm-up")
        ax.set_xlabel("% of places where a primitive pushes left")
        ax.grid(False)
        plt.show()


KINDS = {
    "Rewards of the state, learned off-policy": (
        "exact logit",
        "density of the replay",
        "released loss",
    ),
    "Rewards of state and action": ("DAC", "PPO, r(s, a)"),
    "A reward of the state, learned on-policy": ("PPO, r(s)",),
    "Control": ("true reward",),
}


CAUGHT = "failures<br>that the test<br>catches"


def where_rewards_lead(found, blamed, backwards):
    """Return two tables of arrivals: after held and after fresh steps."""
    reached = dict(found)
    reached["back"] = [
        int((backwards[each] > BAR).sum()) for each in BEGINS
    ]
    names = NAMED | {"back": "the same, right to left"}
    held, fresh, none = [], [], 0
    for kind, members in KINDS.items():
        held.append((kind,))
        for name in members:
            with_way_back = name == "exact logit"
            for each in (name, "back") if with_way_back else (name,):
                counts = reached[each]
                failed = 10 - sum(counts[:2])
                bad = "no failures"
                if failed:
                    bad = f"{sum(blamed[each][:2])} of {failed}"
                dots = [_seeds(count, 5) for count in counts]
                title = names.get(each, each)
                # The line above its group says what it sees.
                brief = title.partition(", r(")[0]
                held.append((brief, *dots[:2], bad))
                if any(counts[2:]):
                    fresh.append((title, *dots[2:]))
                none += not any(counts[2:])
    fresh.append((f"each of the {none} others", *[_seeds(0, 5)] * 2))
    heads = ["reward", "from<br>scratch", "old<br>policy"]
    return _tables(
        (
            "After held steps: the reward decides.",
            "Small networks, five rewards of each kind, 8,000 steps, no "
            "guide.",
            table([*heads, CAUGHT], held),
        ),
        (
            "After fresh steps hardly any arrive, even on the true reward.",
            "3,000 fresh steps from scratch, 100 from the old policy.",
            table(heads, fresh),
        ),
        folded=True,
    )


def preferred_actions(rewards):
    """Return which rewards see actions, spots, and their favourites."""
    AXIS = np.linspace(-1, 1, 9)
    actions = np.stack(np.meshgrid(AXIS, AXIS), -1).reshape(-1, 2)
    coarse = np.linspace(-0.03, 0.53, 8)
    spots = np.stack(np.meshgrid(coarse, coarse), -1).reshape(-1, 2)
    across, up = spots.T
    barrier = (abs(up - 0.3) < 0.05) & (across > 0.1)
    covered = np.linalg.norm(spots[:, None] - (START, GOAL), axis=2) < 0.06
    spots = spots[~barrier & ~covered.any(1)]

    def preferred(reward):
        # The action with the highest reward at each spot, (S, N, 2).
        obs = np.concatenate([spots, np.zeros((len(spots), 1))], 1)
        obs = torch.tensor(obs, dtype=torch.float32)
        obs = obs.expand(len(reward), -1, -1)
        each = [
            reward(
                obs, torch.tensor(action).float().expand(*obs.shape[:2], 2)
            )
            for action in actions
        ]
        return actions[torch.stack(each).argmax(0).numpy()]

    SEES = ("DAC", "PPO, r(s, a)")
    asked = {name: preferred(rewards[name]) for name in SEES}
    return SEES, spots, asked


def rewards_in_the_new_maze(side, values, rewards, x, SEES, spots, asked):
    """Draw four learned rewards, and the actions that they prefer."""
    DRAWN = ("exact logit", "DAC", "PPO, r(s)", "PPO, r(s, a)")
    with plots.style():
        fig, axes = plt.subplots(2, 2, figsize=(4.8, 5.4))
        half = (side[1] - side[0]) / 2  # a pixel lies around its place
        extent = (side[0] - half, side[-1] + half) * 2
        for ax, name in zip(axes.flat, DRAWN, strict=True):
            value = values(rewards[name])[0].reshape(x.shape)
            image = ax.imshow(
                (value - value.min()) / np.ptp(value),
                origin="lower",
                extent=extent,
                cmap=plots.REWARD_MAP,
            )
            plots.maze(ax, "Right")
            ax.axis("off")
            ax.set_title(NAMED.get(name, name))
            if name in SEES:
                looks = {"fc": "white", "ec": "black", "linewidth": 0.6}
                looks |= {"headwidth": 4.5, "headlength": 4}
                looks |= {"headaxislength": 4, "minlength": 0}
                way = {"zorder": 4, "width": 0.012, "scale": 14}
                ax.quiver(*spots.T, *asked[name][0].T, **looks, **way)
        below = {"location": "bottom", "shrink": 0.6, "aspect": 30}
        bar = fig.colorbar(image, ax=axes, ticks=[0, 1], **below)
        bar.ax.set_xticklabels(["lowest reward", "highest"])
        plt.show()
