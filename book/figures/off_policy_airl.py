"""The pictures, tables and the film of chapter 5."""

import matplotlib.pyplot as plt
import numpy as np
import torch
from matplotlib.collections import LineCollection

import plots
from drawing import diagram, film, outline, percent, table
from offairl_lite import demonstrations
from offairl_lite.envs.models import GOAL, walls
from offairl_lite.runs import records

LARGE = {"font.size": 12.5}  # for phones, too


def number(value, digits=0):
    """Return a number as tables show it, with thousands marked."""
    return f"{value:,.{digits}f}".replace("-", "−")


def _reward_map(ax, side, airl, scale):
    inner = np.linspace(-0.08, 0.58, 81)
    x, y = np.meshgrid(inner, inner)
    obs = torch.tensor(np.stack([x, y, 0 * x], -1), dtype=torch.float32)
    value = airl.r(scale(obs)).detach().numpy()
    image = ax.imshow(
        value - value.max(),
        origin="lower",
        extent=(inner[0], inner[-1]) * 2,
        cmap=plots.REWARD_MAP,
        zorder=1,
    )
    plots.maze(ax, side)
    ax.axis("off")
    return image


def _draw_paths(ax, paths, color):
    for path in paths:
        edge = {"path_effects": outline(2.8), "zorder": 4}
        ax.plot(*path.T, color=color, lw=2.8, **edge)


def _levels(ax, demonstrated):
    # what the demonstrations return, and the trap, with the score as axis
    plots.level(ax, demonstrated, "demonstrations", plots.EXPERT)
    plots.level(ax, -26.5, "the trap", plots.GREY, ":")
    ticks = np.array([-26.5, -16.5, -6.5])
    ax.set_yticks(ticks, labels=[percent(value) for value in ticks])
    ax.set_ylim(-30, -4)


def _spread(ends):
    middle, low, high = map(number, np.percentile(ends, (50, 0, 100)))
    return f"{middle}\u00a0% [{low},\u00a0{high}]"


def moving_wall(imitation, demonstrated, kept):
    """Return a film of the chapter: a reward is learned, the wall moves."""
    COLORS = {"learned": plots.COPY, "old": plots.COPY, "new": plots.AGENT}
    STORY = {
        "shown": (12, "1  Fifty runs\n    of experts"),
        "reward": (6, "2  The reward\n    behind them"),
        "learned": (8, "3  The policy\n    learned with it"),
        "wall": (5, "4  The wall moves"),
        "old": (8, "5  The old policy\n    is stuck"),
        "new": (9, "6  A new policy for\n    the old reward"),
        "end": (5, None),
    }
    SCENES = [
        (name, (i + 1) / count)
        for name, (count, _) in STORY.items()
        for i in range(count)
    ]
    EDGE = outline(3.2)

    with plots.style():
        fig = plt.figure(figsize=(7.2, 4.8), dpi=100, layout="none")
        ax = fig.add_axes((0.005, 0.005, 0.625, 0.99))
        image = plots.reward_map(ax, imitation.reward, "Left")
        image.set_alpha(0)
        ax.axis("off")
        barrier = ax.collections[0]
        swarm = LineCollection([], colors=plots.EXPERT, lw=1.4, alpha=0.5)
        ax.add_collection(swarm)
        heads = ax.plot([], [], "o", color=plots.EXPERT, ms=5, mec="white")[
            0
        ]
        trails = {}
        for name, color in COLORS.items():
            line = ax.plot([], [], color=color, lw=3.2, path_effects=EDGE)[
                0
            ]
            dot = ax.plot([], [], "o", color=color, ms=15, mec="white")[0]
            line.set_zorder(4)
            dot.set(zorder=5, markeredgewidth=2)
            trails[name] = line, dot
        told = {
            name: fig.text(0.64, 0.95 - 0.16 * i, text, size=16, va="top")
            for i, (name, (_, text)) in enumerate(STORY.items())
            if text
        }

    def draw_scene(frame):
        scene, share = SCENES[frame]
        for name, text in told.items():
            now = name == scene or (name, scene) == ("new", "end")
            text.set_color("black" if now else "#b0b0b0")
            text.set_weight("bold" if now else "normal")
        if scene == "shown":
            part = demonstrated[:, : 2 + int(40 * share)]
            swarm.set_segments(part)
            heads.set_data(*part[:, -1].T)
        elif scene == "reward":
            image.set_alpha(share)
            swarm.set_alpha(0.5 * (1 - share))
            heads.set_alpha(1 - share)
        elif scene == "wall":
            for artist in trails["learned"]:
                artist.set_visible(False)
            now = (1 - share) * walls("Left") + share * walls("Right")
            barrier.set_segments(now)
        elif scene in COLORS:
            path = kept["paths"][scene][: 1 + int(45 * share)]
            line, dot = trails[scene]
            line.set_data(*path.T)
            dot.set_data(*path[-1:].T)

    frames = film(fig, draw_scene, len(SCENES))
    return frames


def loop():
    """Draw the loop of off-policy AIRL."""
    with plt.rc_context({"font.size": 11.5}):
        _fig, _ = diagram(
            (4.3, 4.4),  # two columns, which a phone can show, too
            {
                "policy": (
                    0.9,
                    3.9,
                    "policy\n" + r"$\pi(a \mid s)$",
                    plots.COPY,
                ),
                "maze": (3.4, 3.9, "maze"),
                "replay": (
                    3.4,
                    2.2,
                    "replay buffer\n" + r"$R$",
                    plots.ORANGE,
                ),
                "sac": (0.9, 2.2, "soft\nactor-critic", plots.COPY),
                "airl": (
                    0.9,
                    0.5,
                    "discriminator\n" + r"$r_\psi,\ V_\omega$",
                    plots.REWARD,
                ),
                "expert": (
                    3.4,
                    0.5,
                    "demonstrations\n" + r"$R_E$",
                    plots.EXPERT,
                ),
            },
            [
                ("policy", "maze", "acts"),
                ("maze", "replay", "stores"),
                ("replay", "sac", "old steps"),
                ("replay", "airl", "old steps"),
                ("expert", "airl", "steps"),
                ("airl", "sac", r"$r_\psi(s)$"),
                ("sac", "policy", "improves"),
            ],
        )
    plt.show()


def mazes(demonstrated):
    """Draw both mazes, and demonstrations in the first."""
    with plots.style(), plt.rc_context(LARGE):
        _fig, axes = plt.subplots(1, 2, figsize=(4.8, 2.8), sharey=True)
        for ax, side, when in zip(
            axes, ("Left", "Right"), ("first", "later"), strict=True
        ):
            plots.maze(ax, side)
            ax.set_title(f"{when}:\nPointMaze{side}")
        axes[1].set_ylabel("")
        axes[0].plot(
            *demonstrated[:10].T, color=plots.EXPERT, alpha=0.7, lw=1
        )
        plt.show()


def arrivals(past, ends, names):
    """Return the table of seeds that arrive."""
    return table(
        ["training with", "arrive", "median score"],
        [
            (name, f"{past[name]} of 5", percent(np.median(ends[name])))
            for name in list(names)[:3]
        ],
    )


def imitation_of_one_seed(curve, expert, airl, scale, paths):
    """Draw returns, the learned reward and last paths."""
    with plots.style(), plt.rc_context(LARGE):
        fig, axes = plt.subplots(
            2, 1, figsize=(4.8, 7.1), height_ratios=(3, 6)
        )
        steps, values = np.transpose(curve)
        axes[0].plot(steps / 1_000, values, "o-", color=plots.COPY, ms=3)
        _levels(axes[0], expert.returns.mean())
        axes[0].set(xlabel="thousand steps", ylabel="score")
        image = _reward_map(axes[1], "Left", airl, scale)
        _draw_paths(axes[1], paths, plots.COPY)
        below = {"location": "bottom", "shrink": 0.6, "aspect": 25}
        label = r"learned reward $r_\psi(s)$"
        fig.colorbar(image, ax=axes[1], label=label, **below)
        plt.show()


def wall_moved(old_return, stuck, new, airl, scale):
    """Draw the old and the new policy where the wall has moved."""
    with plots.style(), plt.rc_context(LARGE):
        fig, axes = plt.subplots(1, 2, figsize=(4.8, 3.2))
        shown = (
            (
                f"old policy: {percent(old_return)}",
                stuck,
                plots.COPY,
            ),
            (
                f"new policy: {percent(new['new_return'])}",
                new["new_paths"],
                plots.AGENT,
            ),
        )
        for ax, (title, walks, color) in zip(axes, shown, strict=True):
            image = _reward_map(ax, "Right", airl, scale)
            _draw_paths(ax, walks, color)
            ax.set_title(title)
        below = {"location": "bottom", "shrink": 0.6, "aspect": 25}
        label = r"learned reward $r_\psi(s)$"
        fig.colorbar(image, ax=axes, label=label, **below)
        plt.show()


def five_seeds(imitation, expert, transfer, target):
    """Draw the returns of five recorded seeds."""
    with plots.style(), plt.rc_context(LARGE):
        fig, axes = plt.subplots(2, 1, figsize=(4.8, 5.6), sharex=True)
        fig.get_layout_engine().set(h_pad=0.1)
        curves = (
            (
                imitation,
                plots.COPY,
                "imitation, in the first maze",
                expert.returns.mean(),
            ),
            (
                transfer,
                plots.AGENT,
                "transfer, with the wall moved",
                target,
            ),
        )
        for ax, (run, color, title, value) in zip(
            axes, curves, strict=True
        ):
            plots.curve(ax, run.steps / 1_000, run.returns, "", color)
            _levels(ax, value)
            ax.set_title(title, loc="left")
            ax.set_ylabel("score")
        axes[1].set(xlabel="thousand steps")
        plt.show()


def behind_the_star(imitation, released, line, kept):
    """Draw rewards and log π on the line through the star."""
    with plots.style(), plt.rc_context(LARGE):
        fig, axes = plt.subplots(2, 1, figsize=(4.8, 5.8), sharex=True)
        fig.get_layout_engine().set(h_pad=0.1)
        for run, color in (
            (imitation, plots.BLUE),
            (released, plots.ORANGE),
        ):
            r = run.reward(line.expand(5, -1, -1)).numpy()
            r = (r - r.max(1, keepdims=True)).T
            axes[0].plot(line[:, 1], r, color=color, lw=1)
        sides = (
            (kept["log_pi"]["star"], plots.EXPERT),
            (kept["log_pi"]["wall"], plots.COPY),
        )
        for drawn, color in sides:
            y, value = drawn["y"].flatten(), drawn["log_pi"].flatten()
            axes[1].plot(y, value, ".", color=color, alpha=0.6)
        for ax in axes:
            ax.axvline(GOAL[1], color=plots.GREY, ls=":", lw=1.2)
            ax.set_xlim(0.4, 0.56)
            ax.set_xticks((0.4, 0.45, 0.5, 0.55))
        places = axes[0].secondary_xaxis("top")
        places.set_xticks((GOAL[1], 0.55), ("the star", "the wall"))
        places.tick_params(length=0)
        for ax, x, y, text, color in (
            (axes[0], 0.555, -0.92, "AIRL loss", plots.BLUE),
            (axes[0], 0.555, -0.79, "log-ratio loss", plots.ORANGE),
            (axes[1], 0.495, -30, "experts", plots.EXPERT),
            (axes[1], 0.558, -22, "own\nactions", plots.COPY),
        ):
            ax.text(x, y, text, color=color, ha="right")
        axes[0].set(ylabel=r"learned reward, peak at 0")
        axes[1].set(ylabel=r"the policy's $\log\ \pi$", ylim=(-75, 4))
        axes[1].set_xlabel("y on the line through star and wall (m)")
        plt.show()


def logs_by_round(loss, temperature, rounds=6, start=-3.0, best=-2.0):
    """Return log π of an old action in each round, by `eq-runaway`."""
    values = [start]
    for _ in range(rounds):
        f = best + (values[-1] if loss == "AIRL" else 0)
        values.append(f / temperature)
    return np.array(values)


def runaway():
    """Draw how log π of an old action moves with both losses."""
    with plots.style(), plt.rc_context(LARGE):
        _fig, ax = plt.subplots(figsize=(4.8, 3.5))
        for loss, alpha, color, text, y in (
            ("AIRL", 0.2, plots.RED, "AIRL loss, α = 0.2", 6_000),
            ("log-ratio", 0.2, plots.BLUE, "log-ratio loss, α = 0.2", 22),
            ("AIRL", 2.0, plots.GREY, "AIRL loss, α = 2", 0.8),
        ):
            values = logs_by_round(loss, alpha)
            ax.semilogy(-values, "o-", color=color, ms=4)
            x = 3.3 if values[-1] < -100 else 6
            ax.text(x, y, text, color=color, ha="right", va="center")
        ax.set(xlabel="round", ylabel=r"$-\log\ \pi$")
        ax.set(ylim=(0.4, 2e5))
        ax.set_yticks((1, 100, 10_000), labels=("1", "100", "10,000"))
        ax.minorticks_off()
        plt.show()


def robot_results():
    """Return recorded robots, their demonstrations, and rows of a table."""
    robot_runs, demonstrated_return, rows = {}, {}, []
    for robot in ("Hopper", "Walker2d", "HalfCheetah"):
        about = records.read_json(demonstrations.EXPERTS / f"{robot}.json")
        demonstrated_return[robot] = about["demonstrated"][0]
        noiseless = about["returns"][0]
        for loss in ("released", "exact"):
            robot_runs[robot, loss] = records.read(
                f"records/what-decides-demo/{robot}-{loss}-fixed-short"
            )
        recipe, exact = (
            _spread(
                100 * robot_runs[robot, loss].returns[:, -1] / noiseless
            )
            for loss in ("released", "exact")
        )
        shown = number(100 * demonstrated_return[robot] / noiseless)
        rows.append((robot, f"{shown}\u00a0%", recipe, exact))
    return robot_runs, demonstrated_return, rows


def robots(rows):
    """Return the table of returns on robots."""
    return table(
        [
            "median [worst, best seed]",
            "demonstrations",
            "recipe",
            "AIRL loss",
        ],
        rows,
    )
