"""The pictures, tables and the film of chapter 4."""

from contextlib import contextmanager

import matplotlib.pyplot as plt
import numpy as np
import torch

import plots
from drawing import bare, diagram, film, table
from offairl_lite import tabular
from offairl_lite.runs import records
from paper_figures import PAPER


@contextmanager
def _large_text():
    """Style figures that are drawn larger than they are shown."""
    with plots.style(), plt.rc_context({"font.size": 13}):
        yield


def _shown(x):
    return f"{x:,.0f}".replace("-", "−") if abs(x) > 50 else f"−{-x:.1f}"


def sac_loop():
    """Draw the loop of SAC."""
    boxes = {
        "actor": (0.75, 4.1, "actor $\\pi$", plots.BLUE),
        "env": (3.6, 4.1, "environment"),
        "slow": (0.75, 0.6, "slow copies\n$\\bar{Q}_1, \\bar{Q}_2$"),
        "critic": (3.6, 0.6, "critics\n$Q_1, Q_2$", plots.BLUE),
        "replay": (3.6, 2.6, "replay\nbuffer"),
    }
    arrows = [
        ("actor", "env", "action $a$"),
        ("env", "replay", "$s, a, r, s'$"),
        ("replay", "critic", "minibatch"),
        ("critic", "actor", "which actions\nare better"),
        ("critic", "slow", "followed at\nthe rate $\\tau$", -0.35),
        ("slow", "critic", "give the\ntarget $y$", -0.35),
        ("actor", "slow", "next action $a'$"),
    ]
    _fig, _ax = diagram((4.4, 4.5), boxes, arrows)
    plt.show()


def soft_iteration(grid, values, iterates, errors):
    """Draw the value of a policy that improves."""
    every = np.arange(14 * 14).reshape(14, 14)[::2, ::2].ravel()
    with _large_text():
        # Two columns, so that a phone can show the arrows.
        fig, axes = plt.subplots(2, 2, figsize=(6.0, 7.4))
        for k, ax in zip((0, 1, 2, 5), axes.flat, strict=True):
            image = plots.grid(ax, values[k], "Left")
            image.set_clim(-15, values.max())
            move = iterates[k].policy[every], grid.positions[every]
            plots.arrows(ax, *move).width = 0.011
            error = f"{errors[k]:.2g}" if k < 5 else "below $10^{-9}$"
            title = (
                f"{k} improvement{'s' * (k != 1)}\nlargest error {error}"
            )
            ax.set_title(title)
        bare(axes)
        below = {"location": "bottom", "shrink": 0.7, "aspect": 25}
        bar = fig.colorbar(
            image, ax=axes, label="soft value", extend="min", **below
        )
        bar.set_ticks([-15, -10, -5], labels=["−15", "−10", "−5"])
        plt.show()


def temperatures(solutions, grid):
    """Draw where policies of several temperatures go."""
    with _large_text():
        fig, axes = plt.subplots(2, 2, figsize=(6.0, 6.9))
        for ax, alpha in zip(axes.flat, solutions, strict=True):
            visits = tabular.occupancy(grid.mdp, solutions[alpha].policy)
            share = visits.sum(1) / visits.sum()
            image = plots.grid(ax, np.log10(share), "Left")
            image.set_clim(-4, -1)
            ax.set_title(f"α = {alpha}")
        bare(axes)
        below = {"location": "bottom", "shrink": 0.7, "aspect": 25}
        bar = fig.colorbar(image, ax=axes, label="share of time", **below)
        bar.set_ticks(
            [-4, -3, -2, -1], labels=["0.01 %", "0.1 %", "1 %", "10 %"]
        )
        plt.show()


def squashed(CASES, normal, density_of, a):
    """Draw samples of squashed Gaussians and their density."""
    with _large_text():
        both = {"sharex": True, "sharey": True}
        _fig, axes = plt.subplots(2, 2, figsize=(6.0, 5.0), **both)
        for ax, (mean, std) in zip(axes.flat, CASES, strict=True):
            x, density = (
                torch.tanh(mean + std * normal),
                density_of(mean, std),
            )
            bars = {"color": "#f3c98b", "ec": "white", "lw": 0.8}
            ax.hist(x, 24, density=True, **bars)
            ax.plot(a[::400], density[::400], color=plots.BLUE)
            ax.set_title(f"μ = {mean:g}, σ = {std}")
            ax.set(ylim=(0, 2.6), xticks=[-1, 0, 1])
            ax.grid(False)
        for ax in axes[:, 0]:
            ax.set_ylabel("density")
        for ax in axes[1]:
            ax.set_xlabel("action")
        plt.show()


def pendulum_curves(entropy, temperature, total, step, STEPS):
    """Draw return, entropy and temperature of the training."""
    with _large_text():
        # The return above the other two, so that a phone can show them.
        fig, axes = plt.subplot_mosaic("aa;bc", figsize=(6.0, 6.0))
        fig.get_layout_engine().set(h_pad=0.1)
        axes = axes.values()
        names = ("return", "entropy (nats)", "temperature α")
        columns = (total, entropy, temperature)
        for ax, name, column in zip(axes, names, columns, strict=True):
            ax.axvspan(0, 1, color="0.92", linewidth=0)
            after = slice(0 if name == "return" else 4, None)
            ax.plot(step[after] / 1000, column[after], "o-", ms=3.5)
            ax.set_title(name)
            ax.set_xlim(0, 1.03 * STEPS / 1000)
        above, middle, last = axes
        above.set_ylim(-1900, 50)
        middle.axhline(-1, color=plots.GREY, linestyle="--")
        last.set_ylim(0, 0.25)
        fig.supxlabel("thousand steps", fontsize="medium")
        plt.show()


def swing_up(sac, pendulum, act):
    """Return states of an episode and a film of it on the map of Q."""

    def swing(sac, steps=120):
        # one episode from hanging still, without noise
        env, states = pendulum(), []
        env.reset(seed=0)
        env.unwrapped.state = np.array([np.pi, 0.0])
        obs = env.step(np.zeros(1, dtype=np.float32))[0]
        for _ in range(steps):
            states.append(env.unwrapped.state.copy())
            obs = env.step(act(sac, torch.tensor(obs), 0.0).tanh().numpy())[
                0
            ]
        return np.array(states)

    states = swing(sac)
    from_below, speed = np.degrees(states[:, 0] - np.pi), states[:, 1]

    edge = 225
    x, y = np.meshgrid(
        np.linspace(-edge, edge, 161), np.linspace(-8, 8, 121)
    )
    theta = np.radians(x) + np.pi
    points = np.stack([np.cos(theta), np.sin(theta), y / 8], -1)
    points = torch.tensor(points, dtype=torch.float32)
    with torch.no_grad():
        worth = sac.critic(points, sac.actor(points)[0]).amin(0).numpy()
    # Gymnasium's pendulum comes to rest at the top if ω² = 30 (1 - cos θ).
    enough = np.sqrt(30 * (1 + np.cos(np.radians(x[0]))))

    with plots.style(), plt.rc_context({"font.size": 14}):
        # Few inches, so that a phone can show the text.
        size = {"figsize": (6.0, 4.0), "dpi": 120, "width_ratios": (1, 2)}
        fig, (left, right) = plt.subplots(1, 2, **size)
        left.set(xlim=(-1.3, 1.3), ylim=(-1.3, 1.3), aspect="equal")
        left.set_title("the pendulum")
        left.axis("off")
        image = right.imshow(
            worth,
            origin="lower",
            extent=(-edge, edge, -8, 8),
            aspect="auto",
            cmap=plots.REWARD_MAP,
        )
        fig.colorbar(image, ax=right, label="Q without noise")
        right.set(xlabel="angle", ylabel="speed (rad/s)")
        right.set_title("value of each state")
        right.plot(x[0], enough, "--", color="white", linewidth=1.5)
        right.plot(x[0], -enough, "--", color="white", linewidth=1.5)
        right.set_xlim(-edge, edge)
        places = ("upright", "hanging", "upright")
        right.set_xticks((-180, 0, 180), places)
        right.grid(False)
        tip = np.stack([-np.sin(states[:, 0]), np.cos(states[:, 0])], -1)
        line = {"color": plots.ORANGE, "linewidth": 3}
        (trail,) = left.plot([], [], alpha=0.5, **line)
        (rod,) = left.plot([], [], color="#333333", linewidth=9)
        left.plot(0, 0, "o", color="#333333", markersize=13)
        (path,) = right.plot([], [], **line)
        (dot,) = right.plot([], [], "o", color=plots.ORANGE, markersize=12)
        for drawn in (dot, rod):
            drawn.set_markeredgecolor("white")

    def draw(i):
        now = 4 * i
        rod.set_data(*np.stack([0 * tip[now], tip[now]]).T)
        trail.set_data(*tip[max(0, now - 15) : now + 1].T)
        path.set_data(from_below[: now + 1], speed[: now + 1])
        dot.set_data(from_below[now : now + 1], speed[now : now + 1])

    frames = film(fig, draw, 25)
    return states, x, y, worth, enough, frames


def learners(curves):
    """Draw the returns of three learners."""
    colors = (plots.BLUE, plots.ORANGE, plots.RED)
    with _large_text():
        both = {"sharex": True, "sharey": True}
        fig, axes = plt.subplots(3, 1, figsize=(6.0, 7.0), **both)
        for ax, color, name in zip(axes, colors, curves, strict=True):
            totals = curves[name]
            step = 0.2 * np.arange(1, totals.shape[1] + 1)
            ax.axvspan(0, 1, color="0.92", linewidth=0)
            ax.plot(step, totals.T, color=color, alpha=0.35, lw=0.8)
            ax.plot(step, np.median(totals, 0), "o-", ms=3.5, color=color)
            ax.set_title(name, loc="left", color=color)
            ax.set_xlim(0, 5.15)
        axes[-1].set_xlabel("thousand steps")
        fig.supylabel("return", fontsize="medium")
        plt.show()


def experts(trained_by, RECORDS, shipped):
    """Return the table of the experts that were trained."""
    rows = []
    for task, folder in trained_by.items():
        run = records.read(RECORDS / folder)
        fixed = run.config.learner.temperature
        alpha = "learned" if fixed is None else fixed
        row = (
            f"{task}<br>α: {alpha}, {run.steps[-1]:,} steps",
            _shown(max(shipped[task]["returns"])),
            _shown(shipped[task]["demonstrated"][-1]),
            _shown(PAPER[task][0]),
        )
        rows.append(row)
    head = ("task", "best expert", "demonstrations", "paper")
    return table(head, rows)
