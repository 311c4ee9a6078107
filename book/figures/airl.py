"""The pictures, tables and the film of chapter 3."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import torch
from scipy.special import log_softmax

import plots
from drawing import EDGE, bare, diagram, film, number, percent, table
from figures.maxent_irl import likeliest_walk
from offairl_lite import demonstrations, tabular
from offairl_lite.core.rollouts import rollout
from offairl_lite.envs.models import GOAL, START
from offairl_lite.tabular import occupancy, soft_value_iteration


def old_and_new(cells):
    """Return a film of the game, and its walks where the wall moved."""
    STEPS = 3 * cells  # of a walk

    def walk(process, policy, rng):
        # From the maze's start, moved sideways onto the start's circle.
        path = tabular.sample(process.mdp, policy, 1, rng, STEPS).states[0]
        path = process.positions[path]
        return path + np.array([START[0] - path[0, 0], 0])

    def filmed_game(rounds):
        # The policies of the game, and the rewards learned from them.
        mazes = [
            tabular.maze(cells, side, discount=0.95)
            for side in ("Left", "Right")
        ]
        S, A = mazes[0].mdp.num_states, mazes[0].mdp.num_actions
        mdp = replace(mazes[0].mdp, initial=np.full(S, 1 / S))
        truth = mazes[0].reward / 0.1
        seen = occupancy(mdp, soft_value_iteration(mdp, truth).policy)
        log_pi, story = np.full((S, A), -np.log(A)), []
        for _ in range(rounds):
            visits = occupancy(mdp, np.exp(log_pi))
            best = truth + np.log(seen.sum(1) / visits.sum(1))
            story.append((np.exp(log_pi), best))
            f = log_pi + np.log(seen / visits)
            answer = soft_value_iteration(mdp, f).log_policy
            log_pi = log_softmax(0.9 * log_pi + 0.1 * answer, axis=1)
        return mazes, story

    def show_film(rounds=14, still=2):
        (old, new), story = filmed_game(rounds)
        policies = [soft_value_iteration(new.mdp, story[-1][1]).policy]
        walks = [walk(old, p, np.random.default_rng(3)) for p, _ in story]
        carried = walk(new, story[-1][0], np.random.default_rng(3))
        planned = walk(new, policies[0], np.random.default_rng(3))
        # Few inches, so that a phone can show the text.
        with plots.style():
            fig, axes = plt.subplots(1, 2, figsize=(6.4, 4.0), dpi=100)
        image = plots.grid(axes[1], np.zeros(cells**2), "Left")
        image.set_clim(-14, 0)
        plots.maze(axes[0], "Left")
        bare(axes)
        lines, heads = [], []
        for ax, color in zip(axes, (plots.COPY, plots.AGENT), strict=True):
            lines += ax.plot([], [], color=color, lw=2.6, path_effects=EDGE)
            style = {"mec": "white", "ms": 9, "zorder": 4}
            heads += ax.plot([], [], "o", color=color, **style)

        def titles(*texts):
            for ax, text in zip(axes, texts, strict=True):
                ax.set_title(text, fontsize=16)

        def trail(i, path, t):
            lines[i].set_data(*path[: t + 1].T)
            heads[i].set_data(*path[t : t + 1].T)

        def draw(i):
            k, t = min(i // still, rounds - 1), 2 * (i - still * rounds)
            reward = story[k][1]
            image.set_data((reward - reward.max()).reshape(cells, cells))
            if t < 0:
                plural = "" if k == 1 else "s"
                titles(
                    f"the policy\nafter {k} round{plural}",
                    "the reward in\nthe discriminator",
                )
                trail(0, walks[k], STEPS)
                return
            if t == 0:
                for ax in axes:
                    ax.collections[0].remove()
                    plots.maze(ax, "Right")
                bare(axes)
                titles(
                    "the wall moves:\nthe old policy",
                    "a new policy for\nthe frozen reward",
                )
            trail(0, carried, min(t, STEPS))
            trail(1, planned, min(t, STEPS))

        frames = film(fig, draw, still * rounds + STEPS // 2 + 6)
        return frames, (carried, planned)

    frames, filmed_walks = show_film()
    return frames, filmed_walks


def airl_graph():
    """Draw how r, V and the policy make the logit."""
    with plt.rc_context({"font.size": 13}):
        diagram(
            (4.6, 4.9),
            {
                "s": (0.9, 4.5, "$s$"),
                "next": (2.7, 4.5, "$s'$"),
                "r": (0.9, 3.5, r"$r_\psi(s)$", plots.REWARD),
                "V": (
                    2.7,
                    3.5,
                    r"$V_\omega(s),\ V_\omega(s')$",
                    plots.PURPLE,
                ),
                "f": (1.5, 2.4, "$f$"),
                "pi": (
                    3.4,
                    2.4,
                    r"policy: $\log\ \pi(a\,|\,s)$",
                    plots.COPY,
                ),
                "logit": (2.3, 1.4, r"$\ell = f - \log\ \pi$"),
                "D": (2.3, 0.4, r"$D = \sigma(\ell)$"),
            },
            [
                ("s", "r"),
                ("s", "V"),
                ("next", "V"),
                ("r", "f"),
                ("V", "f"),
                ("f", "logit"),
                ("pi", "logit"),
                ("logit", "D"),
            ],
        )
    plt.show()


def against_predictions(learned, true_reward, expert):
    """Return the table of fitted and predicted functions."""

    def tiny(x):
        return "< 10⁻⁸" if np.ptp(x) < 1e-8 else f"{np.ptp(x):.0e}"

    rows = []
    for name, (r, V, ratio) in learned.items():
        off = np.ptp(r - true_reward)
        off = f"{off:.1f}" if off > 1e-6 else "0"
        fits = tiny(V - expert.value), tiny(r - true_reward - ratio)
        rows.append((name, *fits, off))
    return table(
        [
            "the policy …",
            "V: fit −<br>prediction",
            "r: fit −<br>prediction",
            "r:\u00a0fit\u00a0−<br>truth",
        ],
        rows,
    )


def best_rewards(learned, opponents, _mdp, _maze):
    """Draw true rewards, plus errors, equals the rewards learned."""
    *names, expert = opponents
    truth = learned[expert][0]
    widest = np.abs(learned[names[0]][2]).max()
    lowest = np.ptp(learned[names[0]][0])
    with plots.style(), plt.rc_context({"font.size": 14}):
        fig, axes = plt.subplots(2, 3, figsize=(5.4, 4.3))
        for row, name in zip(axes, names, strict=True):
            r, _, error = learned[name]
            for ax, values in zip(row, (truth, error, r), strict=True):
                image = plots.grid(ax, values - values.max(), "Left")
                image.set_clim(-lowest, 0)
                green = image
            image = row[1].images[0]
            image.set(data=error.reshape(image.get_array().shape))
            image.set(cmap="PuOr", clim=(-widest, widest))
        bare(axes)
        titles = ("true reward", "+  error", "=  learned")
        for ax, title in zip(axes[0], titles, strict=True):
            ax.set_title(title)
        for ax, name in zip(axes[:, 0], ("random", "better"), strict=True):
            ax.set_ylabel(f"{name} policy")
        below = {"location": "bottom", "pad": 0.03, "aspect": 12}
        for column, shown in enumerate((green, image, green)):
            ticks = (-2, 0, 2) if shown is image else (-10, -5, 0)
            fig.colorbar(shown, ax=axes[:, column], ticks=ticks, **below)
        plt.show()


def game(games):
    """Draw how the game converges for each step size."""
    colors = (plots.RED, plots.ORANGE, plots.BLUE, plots.GREEN)
    ticks = (1, 0.01, 0.0001)
    with plots.style(), plt.rc_context({"font.size": 14}):
        _fig, axes = plt.subplots(1, 2, figsize=(5.4, 3.9), sharey=True)
        for (history, _), color in zip(games.values(), colors, strict=True):
            for ax, column in zip(axes, history.T, strict=True):
                ax.plot(column, color=color, lw=2.5)
                ax.set(xlabel="round", yscale="log", ylim=(1e-5, 30))
                ax.set_yticks(ticks, labels=[f"{y:g}" for y in ticks])
                ax.set_xticks((0, 30, 60))
                ax.minorticks_off()
        axes[0].set_title("distance of visits")
        axes[1].set_title("error of the reward")
        for x, y, text, color in (
            (27, 1.3, "η = 1", colors[0]),
            (27, 0.045, "η = 0.5", colors[1]),
            (1, 4e-5, "η = 0.2", colors[2]),
            (33, 3e-3, "η = 0.1", colors[3]),
        ):
            axes[0].text(x, y, text, color=color)
        plt.show()


def after_the_move(score):
    """Return the table of returns where the wall has moved."""
    best, *_, worst = score.values()
    return table(
        ["planned on, after the wall has moved", "true return", "score"],
        [
            (name, number(value, 2), percent(value, worst, best))
            for name, value in score.items()
        ],
    )


def entangled(rewards, new_policies, moved):
    """Draw rewards and what they lead to where the wall has moved."""
    with plots.style(), plt.rc_context({"font.size": 14}):
        _fig, axes = plt.subplots(2, 2, figsize=(5.4, 5.8))
        for ax, (name, value) in zip(
            axes.flat, rewards.items(), strict=True
        ):
            value = value if value.ndim == 1 else value.max(1)
            plots.grid(ax, value - value.max(), "Right")
            way = likeliest_walk(moved, new_policies[name]).T
            look = {"lw": 3, "path_effects": EDGE, "zorder": 4}
            ax.plot(*way, color=plots.AGENT, **look)
            ax.set_title(name)
        bare(axes)
        plt.show()


def transfers(recorded, RIGHT, ends):
    """Return recorded runs, and returns before and after the move."""
    gail = recorded("maze-gail-demo/log-odds")
    source = recorded("maze-airl-ppo-demo/state")
    trained = recorded("maze-transfer-airl-ppo-demo/state")
    carried_over = rollout(gail.policy, RIGHT, gail.seeds, episodes=10)
    true_sac = recorded("maze-transfer-rewards-demo/true/true-scratch")
    results = {  # on the old maze and on the new
        "GAIL, log odds, policy carried over": (
            ends(gail),
            carried_over.returns.mean(1),
        ),
        "AIRL, r(s, a)": (
            ends(recorded("maze-airl-ppo-demo/state-action")),
            ends(recorded("maze-transfer-airl-ppo-demo/state-action")),
        ),
        "AIRL, r(s)": (ends(source), ends(trained)),
        "off-policy AIRL, r(s)": (
            ends(recorded("maze-imitation-demo")),
            ends(recorded("maze-transfer-demo")),
        ),
        "the true reward": (None, ends(true_sac)),
    }
    return gail, source, trained, true_sac, results


def spreads(results):
    """Return names, medians and ranges as rows of a table."""

    def spread_of(values):
        if values is None:
            return "–"
        middle, low, high = (
            percent(x).removesuffix("\u00a0%")
            for x in (np.median(values), values.min(), values.max())
        )
        return f"{middle}\u00a0% [{low},\u00a0{high}]"

    rows = [
        (name, spread_of(old), spread_of(new))
        for name, (old, new) in results.items()
    ]
    return rows


def seed_by_seed(source, trained, new_walks, RIGHT):
    """Return the table of what fails in which seed, with PPO and r(s)."""
    theirs = rollout(
        demonstrations.expert(RIGHT).member(*[0] * 5), RIGHT, range(5), 5
    )

    def collected(walks):
        # Of the learned reward, a seed and an episode.
        obs, action = (
            torch.as_tensor(x, dtype=torch.float32).flatten(1, 2)
            for x in (walks.obs, walks.action)
        )
        r = source.reward(obs, action).view(walks.reward.shape)
        return r.sum(-1).mean(1).numpy()

    def place(seed, arrives):
        # Where the new agent ends: the start is 0.5 away from the star.
        end = new_walks.next_obs[seed, :, -20:, :2]
        if arrives:
            return "star"
        far = np.linalg.norm(end - GOAL, axis=-1).mean()
        return "corner" if far > 0.5 else "short of it"

    rows = []
    for seed, (agent, expert) in enumerate(
        zip(collected(new_walks), collected(theirs), strict=True)
    ):
        arrives = trained.returns[seed, -1] > -14
        fault = "reward" if agent > expert else "learner"
        score = percent(trained.returns[seed, -1])
        rows.append(
            (
                f"{seed}",
                f"{score},\u00a0{place(seed, arrives)}",
                number(agent, 0),
                number(expert, 0),
                "–" if arrives else fault,
            )
        )
    return table(
        (
            "seed",
            "new agent:<br>score, place",
            "it<br>collects",
            "expert<br>collects",
            "at<br>fault",
        ),
        rows,
    )


def blind(columns, LEFT, RIGHT):
    """Draw rewards and paths in both mazes."""
    with plots.style(), plt.rc_context({"font.size": 14}):
        _fig, axes = plt.subplots(2, 3, figsize=(5.6, 4.6))
        for pair, (name, (*runs, seed)) in zip(
            axes.T, columns.items(), strict=True
        ):
            for ax, run, side, env_id, color in zip(
                pair,
                runs,
                ("Left", "Right"),
                (LEFT, RIGHT),
                (plots.COPY, plots.AGENT),
                strict=True,
            ):
                plots.reward_map(ax, runs[0].reward, side, seed)
                path = rollout(run.policy, env_id, range(5), 1).obs[seed, 0]
                look = {"lw": 2.4, "path_effects": EDGE, "zorder": 4}
                ax.plot(*path[:, :2].T, color=color, **look)
            pair[0].set_title(name)
            pair[1].set_title(percent(runs[1].returns[seed, -1]))
        bare(axes)
        for ax, place in zip(axes[:, 0], ("old", "new"), strict=True):
            ax.set_ylabel(f"{place} maze")
        plt.show()
