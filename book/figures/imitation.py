"""The pictures, tables and the film of chapter 2."""

from pathlib import Path

import gymnasium
import matplotlib.pyplot as plt
import numpy as np
import torch
from matplotlib.colors import LinearSegmentedColormap
from torch import Generator, nn

import plots
from drawing import diagram, film, percent, table
from offairl_lite import envs
from offairl_lite.core.rollouts import rollout
from offairl_lite.envs.models import GOAL
from offairl_lite.plain import (
    HIDDEN,
    adam,
    cross_entropy,
    descend,
    gradient_penalty,
    mlp,
    run_episode,
    sticky_actions,
)
from offairl_lite.runs import records

MAZE, RECORDS = "offairl/PointMazeLeft-v0", Path("records")
LEFT, RIGHT = 0, 1


def _formula(name):
    # A no-break space keeps a formula on one line.
    return name.replace("-", "−").replace(" ", "\u00a0")


VERDICT = LinearSegmentedColormap.from_list(
    "verdict", [plots.ORANGE, "white", plots.EXPERT]
)


HOPPERS = {
    "GAIL, −log(1 − D)": ("hopper-gail-demo/survival", plots.BLUE),
    "GAIL, log D": ("hopper-gail-demo/termination", plots.RED),
    "GAIL, log D − log(1 − D)": ("hopper-gail-demo/log-odds", plots.GREEN),
    "DAC, absorbing states": (
        "what-decides-demo/Hopper-dac-fixed-short",
        plots.PURPLE,
    ),
}


def judged_pushes(demos):
    """Return a film of what the discriminator says of pushes."""
    dac_sac = records.read(RECORDS / "maze-dac-demo/sac")
    last_paths = {"sac": rollout(dac_sac.policy, MAZE, dac_sac.seeds, 1)}
    SHOWN = 3
    judge = dac_sac.reward.member(SHOWN)

    def chance(obs, action):
        "D of each (s, a)."
        x = (
            torch.as_tensor(v, dtype=torch.float32)[None]
            for v in (obs, action)
        )
        return torch.sigmoid(judge(*x))[0].numpy()

    def random_pushes(seed):
        generator = torch.Generator().manual_seed(seed)
        env = gymnasium.make(envs.spec(MAZE))
        env.reset(seed=seed)
        u = sticky_actions(2, generator)
        return run_episode(env, lambda _: next(u))

    random = random_pushes(5)
    actors = {
        "random pushes": (random.obs, random.pre_tanh.tanh()),
        "the expert": (demos.obs[:100], demos.pre_tanh[:100].tanh()),
        "the imitator": (
            last_paths["sac"].obs[SHOWN, 0],
            last_paths["sac"].action[SHOWN, 0],
        ),
    }
    actors = {k: [np.asarray(x) for x in v] for k, v in actors.items()}
    verdicts = {name: chance(*what) for name, what in actors.items()}

    push = np.linspace(-1, 1, 31)
    pushes = np.stack(np.meshgrid(push, push), -1).reshape(-1, 2)
    pushes = pushes.astype(np.float32)

    def all_pushes(obs):
        "D of every push in one state, as a picture."
        same = np.repeat(obs[None], len(pushes), 0)
        return chance(same, pushes).reshape(31, 31)

    # Few inches, so that a phone can show the text.
    with plots.style(), plt.rc_context({"font.size": 14}):
        fig = plt.figure(figsize=(7.2, 5.8), dpi=100, layout="none")

        def inches(x, y, width, height):
            return fig.add_axes(
                (x / 7.2, y / 5.8, width / 7.2, height / 5.8)
            )

        shades = {"cmap": VERDICT, "vmin": 0.1, "vmax": 0.9}
        artists = []
        for i, name in enumerate(actors):
            ax = inches(2.4 * i + 0.05, 3.1, 2.3, 2.3)
            square = inches(2.4 * i + 0.7, 1.4, 1.4, 1.4)
            plots.maze(ax, "Left")
            ax.axis("off")
            ax.set_title(name, fontsize=16)
            edge = {"edgecolors": "#444444", "linewidths": 0.6}
            trail = ax.scatter([], [], 45, [], zorder=5, **edge, **shades)
            (body,) = ax.plot(
                [], [], "o", color="black", ms=11, mec="white", zorder=7
            )
            frame = {"origin": "lower", "extent": (-1, 1) * 2}
            image = square.imshow(np.zeros((31, 31)), **frame, **shades)
            square.grid(False)
            square.set(xticks=[-1, 1], yticks=[-1, 1])
            square.set_xticklabels(["left", "right"])
            square.set_yticklabels(["down", "up"])
            (made,) = square.plot(
                [], [], "o", color="black", ms=9, mec="white", clip_on=False
            )
            artists.append((trail, body, image, made))
        below = {"orientation": "horizontal", "extend": "both"}
        bar = fig.colorbar(image, cax=inches(1.6, 0.7, 4, 0.15), **below)
        bar.set_ticks([0.1, 0.5, 0.9], labels=["0.1", "½", "0.9"])
        bar.set_label("D: would the expert push like this here?")

    shown = [24, *range(25), *[24] * 5]  # first what comes out

    def draw_step(frame):
        t = 2 * shown[frame]
        for name, (trail, body, image, made) in zip(
            actors, artists, strict=True
        ):
            obs, action = actors[name]
            trail.set_offsets(obs[: t + 1, :2])
            trail.set_array(verdicts[name][: t + 1])
            body.set_data(*obs[t : t + 1, :2].T)
            image.set_data(all_pushes(obs[t]))
            made.set_data(*action[t, :, None])

    frames = film(fig, draw_step, len(shown))
    return last_paths, SHOWN, actors, verdicts, all_pushes, frames


def gail_loop():
    """Draw the loop of GAIL."""
    _fig, _ = diagram(
        (4.3, 3.5),  # two columns, which a phone can show, too
        {
            "learner": (
                0.9,
                2.9,
                "learner\n$\\pi(a \\mid s)$",
                plots.COPY,
            ),
            "steps": (
                3.4,
                2.9,
                "the imitator's\nsteps $(s, a)$",
                plots.COPY,
            ),
            "D": (0.9, 0.6, "discriminator\n$D(s, a)$"),
            "demos": (3.4, 0.6, "demonstrations\n$(s, a)$", plots.EXPERT),
        },
        [
            ("learner", "steps", "acts"),
            ("steps", "D", "label 0"),
            ("demos", "D", "label 1"),
            ("D", "learner", "reward"),
        ],
    )
    plt.show()


def corridor():
    """Draw the corridor and its two experts."""
    with plots.style(), plt.rc_context({"font.size": 13}):
        _fig, ax = plt.subplots(figsize=(5.6, 2.5))
        ax.set(xlim=(-0.15, 8.55), ylim=(-1.35, 2.35), aspect="equal")
        ax.axis("off")
        for room in range(7):
            paint = "#ffe9bf" if room == 3 else "#f2f2f2"
            ax.add_patch(
                plt.Rectangle((room, 0), 1, 1, fc=paint, ec=plots.GREY)
            )
        ax.text(3.5, 0.5, "start", ha="center", va="center")
        ax.plot([0, 0], [-0.02, 1.02], color="black", lw=6)
        ax.plot([7, 7], [0, 1], color="white", lw=3)
        ax.plot([7, 7.45], [1, 1.3], color="black", lw=3)
        ax.text(7.3, 0.5, "door:\nthe end", va="center")
        arrow = {"arrowstyle": "-|>", "lw": 2, "mutation_scale": 14}
        for room in range(7):
            for y, right, color in (
                (1.35, True, plots.BLUE),
                (-0.4, room < 3, plots.PURPLE),
            ):
                ends = np.array([room + 0.2, room + 0.8])[
                    :: 1 if right else -1
                ]
                look = {**arrow, "color": color}
                ax.annotate("", (ends[1], y), (ends[0], y), arrowprops=look)
        for y, who, color in (
            (1.95, "expert A leaves", plots.BLUE),
            (-1.0, "expert B stays", plots.PURPLE),
        ):
            ax.text(3.5, y, who, color=color, ha="center", va="center")
        plt.show()


def advice(preference):
    """Return the table of what rewards advise without a verdict."""
    advice = ("never leave", "leave at once", "all the same")

    def signed(x):
        return "0" if abs(x) < 0.05 else f"{x:+.1f}".replace("-", "−")

    return table(
        [
            "reward, if D = ½",
            "Q(right) − Q(left), start",
            "last room",
            "advice",
        ],
        [
            (_formula(name), signed(x[3]), signed(x[6]), what)
            for (name, x), what in zip(
                preference.items(), advice, strict=True
            )
        ],
    )


def games(REWARDS, rooms, occupancy, gone, EXPERTS, played):
    """Draw where the experts and their imitators spend their time."""
    COLORS = dict(
        zip(REWARDS, (plots.BLUE, plots.RED, plots.GREEN), strict=True)
    )
    ABOUT = {"A": "expert A leaves", "B": "expert B stays"}
    WHEN = {"A": 4, "B": 50}

    def draw_game(ax, policy, teacher, color, steps):
        for p, paint, place in (
            (teacher, "black", rooms + 0.8),
            (policy, color, rooms + 1.2),
        ):
            share = occupancy(p)
            ax.bar(place, share[:, RIGHT], 0.4, color=paint)
            ax.bar(place, -share[:, LEFT], 0.4, color=paint)
        ax.axhline(0, color="black", lw=0.8)
        ended = [f"{100 * gone(p, steps):.0f} %" for p in (policy, teacher)]
        title = f"gone after {steps}:\n{{}} (expert {{}})"
        ax.set_title(title.format(*ended), fontsize=9)
        ax.grid(False)
        ax.set(ylim=(-0.5, 0.5), xticks=rooms + 1, yticks=[-0.4, 0, 0.4])
        ax.set_yticklabels(["left\n40 %", "0", "right\n40 %"])

    with plots.style():
        # Narrow, so that a phone can show its text.
        fig, axes = plt.subplots(
            3, 2, figsize=(4.8, 6.0), sharex=True, sharey=True
        )
        for row, name in zip(axes, REWARDS, strict=True):
            row[0].set_ylabel(_formula(name), color=COLORS[name])
            for ax, who in zip(row, EXPERTS, strict=True):
                policies = played[who, name], EXPERTS[who]
                draw_game(ax, *policies, COLORS[name], WHEN[who])
        above = {
            "xycoords": "axes fraction",
            "textcoords": "offset points",
            "ha": "center",
        }
        for ax, who in zip(axes[0], EXPERTS, strict=True):
            ax.annotate(ABOUT[who], (0.5, 1), (0, 36), size=12, **above)
        for ax in axes[-1]:
            ax.set_xlabel("room")
        fig.align_ylabels()
        plt.show()


def distances(far, moved, REWARDS):
    """Return the table of distances from the experts."""
    return table(
        [
            "distance",
            "A, from<br>random",
            "A, from<br>a copy",
            "B, from<br>random",
            "B, from<br>a copy",
        ],
        [
            (
                _formula(name),
                *(
                    f"{100 * x[who, name]:.0f}\u00a0%"
                    for who in "AB"
                    for x in (far, moved)
                ),
            )
            for name in REWARDS
        ],
    )


def fitted_clouds():
    """Return logits fitted to two clouds, with and without penalty."""

    def fit_clouds(weight, updates=400):
        "The logit along a line through two clouds of points in the plane."
        rng = Generator().manual_seed(0)
        ours, theirs = (
            torch.tensor([x, 0.0]) + 0.3 * torch.randn(64, 2, generator=rng)
            for x in (-2, 2)
        )
        net = mlp([2, *HIDDEN, 1], nn.Tanh, rng)
        optimizer = adam(net.parameters())

        def logit(x):
            return net(x).squeeze(-1)

        for _ in range(updates):
            between = torch.lerp(
                ours, theirs, torch.rand(64, 1, generator=rng)
            )
            loss = cross_entropy(logit(theirs), logit(ours))
            if weight:
                loss = loss + weight * gradient_penalty(logit, between)
            descend(loss, optimizer)
        x = torch.linspace(-3, 3, 121)
        line = torch.stack([x, 0 * x], -1)
        return ours, theirs, x.numpy(), logit(line).detach().numpy()

    fitted = {
        name: fit_clouds(weight)
        for name, weight in (("without penalty", 0), ("with penalty", 10))
    }
    return fitted


def penalty(fitted):
    """Draw the logit between two clouds."""
    with plots.style(), plt.rc_context({"font.size": 15}):
        _fig, ax = plt.subplots(figsize=(6.4, 4.0))
        for name, color in zip(
            fitted, (plots.RED, plots.GREEN), strict=True
        ):
            *clouds, x, logit = fitted[name]
            ax.plot(x, logit, color=color, lw=2.5)
            x, y = (-0.1, 7) if color == plots.RED else (2.9, -2)
            ax.text(x, y, name, color=color, ha="right")
        for cloud, color, label in zip(
            clouds,
            (plots.COPY, plots.EXPERT),
            ("imitator", "expert"),
            strict=True,
        ):
            ax.plot(
                cloud[:, 0], 0 * cloud[:, 0] - 14, "|", color=color, ms=9
            )
            middle = cloud[:, 0].mean()
            ax.text(middle, -12.9, label, color=color, ha="center")
        ax.set(
            xlabel="x", ylabel="logit", xlim=(-3, 3), xticks=range(-3, 4)
        )
        plt.show()


def dac_training(NUM_ROUNDS, history, extent):
    """Draw paths and verdicts during the training."""
    shown = [0, 4, 9, NUM_ROUNDS - 1]
    with plots.style(), plt.rc_context({"font.size": 15}):
        fig, axes = plt.subplots(2, 2, figsize=(6.2, 7.4))
        for ax, k in zip(axes.flat, shown, strict=True):
            path, verdict = history[k]
            look = {"cmap": VERDICT, "vmin": 0, "vmax": 1, "zorder": 1}
            image = ax.imshow(
                verdict, origin="lower", extent=extent, **look
            )
            plots.maze(ax, "Left")
            xy = torch.cat([path.obs, path.next_obs[-1:]])[:, :2].T
            ax.plot(*xy, color="white", lw=4, zorder=4)
            ax.plot(*xy, color="black", lw=1.8, zorder=5)
            ax.axis("off")
            reached = percent(path.reward.sum().item())
            ax.set_title(f"{100 * (k + 1):,} updates: {reached}")
        below = {"location": "bottom", "shrink": 0.6, "aspect": 25}
        label = "D: would the expert do this there?"
        bar = fig.colorbar(image, ax=axes, label=label, **below)
        bar.set_ticks([0, 0.5, 1], labels=["0", "½", "1"])
        plt.show()


def efficiency(RUNS, escape, median, paths):
    """Draw the steps that each run needs, and last paths."""
    # The colours of the rewards are those of the corridor.
    paint = (plots.PURPLE, plots.ORANGE, plots.GREEN, plots.RED, plots.BLUE)
    LOOK = dict(zip(RUNS, paint, strict=True))
    with plots.style(), plt.rc_context({"font.size": 14}):
        fig = plt.figure(figsize=(6.0, 6.4))
        above, below = fig.subfigures(2, 1, height_ratios=(1.3, 1))
        ax = above.subplots()
        for row, (name, steps) in enumerate(escape.items()):
            ax.barh(row, median[name], 0.6, color=LOOK[name], alpha=0.55)
            spread = row + np.linspace(-0.2, 0.2, len(steps))
            ax.plot(steps, spread, "o", color=LOOK[name], ms=5, mec="white")
            ax.text(32_000, row, f"{median[name]:,.0f}", va="center")
        ax.text(32_000, -0.9, "median", va="center")
        labels = [name.replace(", ", ",\n") for name in RUNS]
        ax.set_yticks(range(len(RUNS)), labels=labels)
        ax.invert_yaxis()
        ax.grid(False, axis="y")
        ax.set(xlim=(0, 42_000), xlabel="steps to escape")
        ax.set_xticks([0, 15_000, 30_000])
        ax.xaxis.set_major_formatter("{x:,.0f}")
        mazes = below.subplots(1, 3)
        for ax, (name, obs) in zip(mazes, paths.items(), strict=True):
            plots.maze(ax, "Left")
            for path in obs:
                ax.plot(*path[:, :2].T, color="white", lw=3.4, zorder=4)
                ax.plot(*path[:, :2].T, color=LOOK[name], lw=1.6, zorder=5)
            star = {
                "color": plots.STAR,
                "mec": "black",
                "ms": 13,
                "zorder": 6,
            }
            ax.plot(*GOAL, "*", **star)
            ax.axis("off")
            name = name.replace(", ", ",\n").replace(" with", "\nwith")
            ax.set_title(name)
        plt.show()


def ends_of_runs(runs, ends):
    """Return the table of returns at the end."""
    return table(
        ["five seeds", "steps", "median score at the end", "worst"],
        [
            (
                name.replace(" ", "\u00a0"),
                f"{runs[name].steps[-1]:,}",
                *(percent(x) for x in (np.median(e), e.min())),
            )
            for name, e in ends.items()
        ],
    )


def hopping():
    """Return how long episodes last, by run and steps."""

    def episode_lengths(run, until=100_000):
        "Steps, and the mean length of training episodes up to each of"
        "them."
        count = np.reshape(
            [r.episodes for r in run.rows], (-1, len(run.seeds))
        )
        steps = run.steps[run.steps <= until]
        ended = np.maximum(np.diff(count[: len(steps)], axis=0), 1)
        return steps[1:], (np.diff(steps)[:, None] / ended).T

    hopping = {
        name: episode_lengths(records.read(RECORDS / path))
        for name, (path, _) in HOPPERS.items()
    }
    return hopping


def hopper_signs(hopping, expert_length):
    """Draw how long episodes of hoppers last."""
    PLACES = dict(zip(HOPPERS, (240, 6.0, 11.5, 1150), strict=True))
    with plots.style(), plt.rc_context({"font.size": 14}):
        _fig, ax = plt.subplots(figsize=(6.0, 4.6))
        for name, (steps, lasted) in hopping.items():
            color = HOPPERS[name][1]
            ax.plot(steps, lasted.T, color=color, alpha=0.3, lw=0.7)
            ax.plot(steps, np.median(lasted, 0), color=color)
            look = {"color": color, "va": "center", "ha": "right"}
            ax.text(99_000, PLACES[name], name, **look)
        ax.plot([10_000, 100_000], [expert_length] * 2, "k--", lw=1)
        ax.text(11_000, 760, "demonstrations", va="center")
        ax.set(yscale="log", ylim=(5, 1600), xlim=(10_000, 100_000))
        ax.set(xlabel="environment steps", ylabel="steps an episode lasts")
        ax.set_xticks([20_000, 60_000, 100_000])
        ax.set_yticks([10, 100, 1_000], labels=["10", "100", "1,000"])
        ax.xaxis.set_major_formatter("{x:,.0f}")
        plt.show()


def chances(occupancy, ends_at):
    """Return how often policies go right, by share of old steps."""

    def goes_right(policy, where):
        "The share of the time in these rooms in which it goes right."
        share = occupancy(policy)[where]
        return share[:, RIGHT].sum() / share.sum()

    chances = {
        who: np.array(
            [
                [goes_right(p, slice(0, 6)), goes_right(p, slice(6, 7))]
                for p in policies
            ]
        ).T
        for who, policies in ends_at.items()
    }
    return chances


def replay(drift, shares, chances):
    """Draw what old steps in the replay do."""
    with plots.style(), plt.rc_context({"font.size": 14}):
        _fig, axes = plt.subplots(1, 2, figsize=(6.2, 4.4))
        for who, color in zip(
            drift, (plots.BLUE, plots.ORANGE), strict=True
        ):
            axes[0].plot(100 * shares, drift[who], "o-", color=color, ms=4)
            for y, line in zip(chances[who], ("-", "--"), strict=True):
                axes[1].plot(100 * shares, y, line, color=color)
        for ax, x, y, text, color in (
            (axes[0], 40, 0.02, "95 % expert", plots.BLUE),
            (axes[0], 15, 0.26, "60 % expert", plots.ORANGE),
            (axes[1], 8, 1.02, "95 %: rooms 1–6", plots.BLUE),
            (axes[1], 8, 0.87, "95 %: last room", plots.BLUE),
            (axes[1], 8, 0.7, "60 %: rooms 1–6", plots.ORANGE),
            (axes[1], 8, 0.4, "60 %: last room", plots.ORANGE),
        ):
            ax.text(x, y, text, color=color)
        axes[0].set(ylabel="distance from the expert", ylim=(0, 0.52))
        axes[1].set(ylabel="share of right moves", ylim=(0, 1.1))
        for ax in axes:
            ax.set(xlabel="random steps (%)", xlim=(0, 91))
            ax.set(xticks=range(0, 100, 20))
        plt.show()
