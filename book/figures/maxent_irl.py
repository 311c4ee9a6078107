"""The pictures and tables of chapter 1."""

from dataclasses import replace

import matplotlib.patheffects as effects
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import PowerNorm
from scipy.sparse import eye_array

import drawing
import plots
from drawing import number, percent
from offairl_lite import tabular
from offairl_lite.tabular import (
    MDP,
    maxent_irl,
    occupancy,
    policy_return,
    soft_value_iteration,
)

OUTLINE = [effects.withStroke(linewidth=1.2, foreground="black")]


def likeliest_walk(maze, policy, steps=80):
    """Return the squares on the way of the most probable moves."""
    state, way = int(maze.mdp.initial.argmax()), []
    go = (
        maze.mdp.transition.toarray()
        .reshape(len(maze.positions), -1, len(maze.positions))
        .argmax(-1)
    )
    for _ in range(steps):
        way.append(maze.positions[state])
        state = go[state, policy[state].argmax()]
    return np.array(way)


@plots.style()
def learning(cells, alpha, num_frames=14):
    """Return a film of a reward while it is learned."""
    left, right = (tabular.maze(cells, side) for side in ("Left", "Right"))
    mdp, true_reward, S = left.mdp, left.reward, cells**2
    wide = replace(mdp, initial=np.full(S, 1 / S))
    shown = soft_value_iteration(mdp, true_reward, alpha).policy
    fit = maxent_irl(
        wide, occupancy(wide, shown), eye_array(S), alpha, iterations=80
    )
    last = len(fit.history) - 1
    steps = np.geomspace(2, last + 1, num_frames - 2).astype(int) - 1
    steps = [last, 0, *steps]  # first what comes out
    # Few inches, so that a phone can show the text.
    with plots.style(), plt.rc_context({"font.size": 15}):
        fig, axes = plt.subplots(1, 2, figsize=(6.6, 5.0), dpi=100)
        shades = plt.Normalize(-0.6, 0), plots.REWARD_MAP
        below = {"orientation": "horizontal", "shrink": 0.5, "pad": 0.03}
        bar = fig.colorbar(
            plt.cm.ScalarMappable(*shades),
            ax=axes,
            label="learned reward",
            **below,
        )
        bar.set_ticks([-0.6, -0.3, 0], labels=["−0.6", "−0.3", "0"])
    panels = []
    for ax, side, maze, place in zip(
        axes,
        ("Left", "Right"),
        (left, right),
        ("first maze", "wall moved"),
        strict=True,
    ):
        image = plots.grid(ax, np.zeros(S), side)
        image.set_clim(-0.6, 0)
        (edge,) = ax.plot([], [], color="white", linewidth=6)
        (line,) = ax.plot([], [], color=plots.AGENT, linewidth=3)
        line.set_path_effects(drawing.outline(3))
        ax.set_axis_off()
        panels.append((ax, maze, place, image, edge, line))

    def draw(i):
        reward = fit.history[steps[i]]
        for ax, maze, place, image, edge, line in panels:
            policy = soft_value_iteration(maze.mdp, reward, alpha).policy
            image.set_data((reward - reward.max()).reshape(cells, cells))
            value = policy_return(maze.mdp, policy, true_reward)
            title = f"{place}: {value:.1f}".replace("-", "−")
            ax.set_title(title, fontsize=16)
            way = likeliest_walk(maze, policy).T
            edge.set_data(*way)
            line.set_data(*way)
        plural = "" if steps[i] == 1 else "s"
        fig.suptitle(f"the reward after {steps[i]} step{plural}", size=16)

    pictures = drawing.film(fig, draw, num_frames)
    return np.concatenate([pictures, *[pictures[-1:]] * 5])


def experts(left, expert, right, expert_right, true_reward):
    """Draw the experts of both mazes over the true reward."""
    with plots.style(), plt.rc_context({"font.size": 15}):
        fig, axes = plt.subplots(1, 2, figsize=(7.0, 4.5))
        shown = (("Left", left, expert), ("Right", right, expert_right))
        for ax, (side, maze, solution) in zip(axes, shown, strict=True):
            image = plots.grid(ax, true_reward, side)
            plots.few_arrows(ax, solution.policy, maze.positions)
            ax.set_title(f"wall on the {side.lower()}")
            ax.set_axis_off()
        below = {"orientation": "horizontal", "shrink": 0.5, "pad": 0.03}
        fig.colorbar(image, ax=axes, label="true reward (m)", **below)
        plt.show()


def returns_of_experts(best_left, best_right, carried):
    """Return the table of what the policies of two experts return."""
    return drawing.table(
        ("policy", "true return", "score"),
        [
            ("expert of the first maze, at home", number(best_left), "–"),
            *(
                (name, number(value), percent(value, carried, best_right))
                for name, value in (
                    ("expert of the second maze, at home", best_right),
                    ("expert of the first maze, in the second", carried),
                )
            ),
        ],
    )


def ranges(true_reward, shaped):
    """Draw a reward without and with a shaping, and their policies."""
    left = tabular.maze(round(len(true_reward) ** 0.5), "Left")
    with plots.style(), plt.rc_context({"font.size": 15}):
        fig, axes = plt.subplots(1, 2, figsize=(7.0, 4.6))
        for ax, reward, name in zip(
            axes,
            (true_reward, shaped),
            ("the true reward", "shaped at random"),
            strict=True,
        ):
            shown = reward if reward.ndim == 1 else reward.mean(1)
            image = plots.grid(ax, shown, "Left")
            plan = soft_value_iteration(left.mdp, reward, 0.05)
            plots.few_arrows(ax, plan.policy, left.positions)
            ax.set_title(name)
            ax.set_axis_off()
            below = {"orientation": "horizontal", "shrink": 0.7}
            fig.colorbar(image, ax=ax, label="reward", pad=0.03, **below)
        plt.show()


def loop():
    """Draw the loop of maximum-entropy inverse RL."""
    with plt.rc_context({"font.size": 13}):
        _fig, _ax = drawing.diagram(
            (6.0, 2.2),
            {
                "r": (0.7, 1.65, "reward\n$r$", plots.REWARD),
                "pi": (2.5, 1.65, "policy\n$\\pi_r$", plots.BLUE),
                "v": (
                    4.7,
                    1.65,
                    "its visits\n$\\rho_{\\pi_r}$",
                    plots.BLUE,
                ),
                "d": (
                    2.5,
                    0.45,
                    "$\\rho_E - \\rho_{\\pi_r}$",
                    plots.ORANGE,
                ),
                "e": (
                    4.7,
                    0.45,
                    "the expert's visits\n$\\rho_E$",
                    plots.EXPERT,
                ),
            },
            [("r", "pi"), ("pi", "v"), ("v", "d"), ("e", "d"), ("d", "r")],
        )
    plt.show()


def slopes(measured, predicted):
    """Return the table of a measured and a predicted slope."""
    return drawing.table(
        ("slope of the log-likelihood", ""),
        [
            ("measured", number(measured, 3)),
            ("from the gradient", number(predicted, 3)),
        ],
    )


def weights(fit, value_of, found_right, right, best_right):
    """Return the table of learned and true weights."""
    return drawing.table(
        (
            "",
            "learned",
            "true",
        ),
        [
            *(
                (f"weight of {name}", number(w, 2), number(true, 2))
                for name, w, true in zip(
                    (*(f"corner {k}" for k in (1, 2, 3, 4)), "the star"),
                    fit.weights,
                    (0, 0, 0, 0, 1),
                    strict=True,
                )
            ),
            (
                "return in the second maze",
                number(value_of(found_right, right)),
                number(best_right),
            ),
        ],
    )


def moved_wall(moved, right, value_of):
    """Draw what four rewards lead to where the wall has moved."""
    with plots.style(), plt.rc_context({"font.size": 15}):
        fig, axes = plt.subplots(2, 2, figsize=(6.6, 7.6))
        worst, best = (
            value_of(moved[name], right)
            for name in ("α log π", "true r(s)")
        )
        for ax, (name, policy) in zip(
            axes.flat, moved.items(), strict=True
        ):
            visits = occupancy(right.mdp, policy).sum(1)
            image = plots.grid(ax, visits, "Right")
            image.set(cmap="Purples_r", norm=PowerNorm(0.5, 0, 4))
            look = {
                "lw": 3,
                "path_effects": drawing.outline(3),
                "zorder": 4,
            }
            way = likeliest_walk(right, policy).T
            ax.lines[-1].set_zorder(5)  # the star, above the way
            ax.plot(*way, color=plots.AGENT, **look)
            value = value_of(policy, right)
            ax.set_title(f"{name}: {percent(value, worst, best)}")
            ax.set_axis_off()
        below = {
            "orientation": "horizontal",
            "shrink": 0.5,
            "extend": "max",
        }
        bar = fig.colorbar(
            image, ax=axes, label="discounted visits", **below
        )
        bar.set_ticks([0, 1, 2, 4])
        bar.minorticks_off()
        plt.show()


def along_the_way(best_left, best_right, curves, carried):
    """Draw the returns of rewards that the optimiser passes."""
    with plots.style(), plt.rc_context({"font.size": 15}):
        _fig, axes = plt.subplots(1, 2, figsize=(7.0, 4.4), sharey=True)
        levels = {"first": best_left, "second": best_right}
        for ax, (place, level) in zip(axes, levels.items(), strict=True):
            for name, color, line in (
                ("r(s)", plots.REWARD, "-"),
                ("r(s, a)", plots.ORANGE, "--"),
            ):
                ax.plot(*curves[name, place], line, color=color)
            plots.level(ax, level, "expert", plots.EXPERT)
            ax.set(xlabel="steps of L-BFGS", title=f"{place} maze")
        plots.level(axes[1], carried, "old policy", plots.COPY)
        axes[0].set(ylabel="true return", ylim=(-14, -3))
        axes[1].text(205, -5.9, "r(s)", color=plots.REWARD, ha="right")
        axes[1].text(118, -7.6, "r(s, a)", color=plots.ORANGE)
        plt.show()


def two_colours(n):
    """Return two worlds and two rewards that differ by a chess board."""
    row, column = np.divmod(np.arange(n**2), n)
    moves = ((1, 0), (0, 1), (-1, 0), (0, -1))
    goes_to = np.stack(
        [(row + dy) % n * n + (column + dx) % n for dx, dy in moves], 1
    )
    torus = MDP(np.eye(n**2)[goes_to], np.full(n**2, n**-2), discount=0.9)
    with_rest = MDP(
        np.eye(n**2)[np.column_stack([goes_to, np.arange(n**2)])],
        torus.initial,
        discount=0.9,
    )
    home = -np.hypot(row - 5, column - 5) / n
    chess = home - (-1.0) ** (row + column)
    return torus, with_rest, home, chess


def chess_board(home, chess, moving, rested):
    """Draw policies with and without a chess board, and with rest."""
    with plots.style(), plt.rc_context({"font.size": 14}):
        fig, axes = plt.subplots(2, 2, figsize=(6.6, 7.8))
        n, moves = 10, ((1, 0), (0, 1), (-1, 0), (0, -1))
        row, column = np.divmod(np.arange(n**2), n)
        rest = np.zeros((n**2, 1))
        before = [np.hstack([s.policy, rest]) for s in moving]
        policies = [*before, *(s.policy for s in rested)]
        names = ("a reward", "plus a chess board", "", "")
        axes[0, 0].set_ylabel("no resting")
        axes[1, 0].set_ylabel("resting allowed")
        for ax, reward, policy, name in zip(
            axes.flat, (home, chess) * 2, policies, names, strict=True
        ):
            image = ax.imshow(
                reward.reshape(n, n), origin="lower", cmap=plots.REWARD_MAP
            )
            u, v = 0.9 * (policy[:, :4] @ np.array(moves)).T
            scale_ = {"angles": "xy", "scale_units": "xy", "scale": 1}
            scale_ |= {"pivot": "mid", "path_effects": OUTLINE}
            clear = np.hypot(u, v) > 0.2  # a shorter one would be a speck
            ways = (x[clear] for x in (column, row, u, v))
            ax.quiver(*ways, color="white", **scale_)
            resting = policy[:, 4] > 0.5
            dots = {"color": "white", "markeredgecolor": "black"}
            ax.plot(column[resting], row[resting], "o", **dots)
            ax.set(title=name, xticks=[], yticks=[])
            ax.grid(False)
            if ax in axes[1]:
                below = {"orientation": "horizontal", "shrink": 0.7}
                fig.colorbar(image, ax=ax, label="reward", **below)
        plt.show()
