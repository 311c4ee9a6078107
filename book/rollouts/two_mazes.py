"""What networks make of one world and of two, for chapter 12.

The chapter's game, with exact averages, is played with a free number for
each square and action, and with networks that see positions and moves. For
the continuous maze: how far recordings of different mazes are apart, and
what rewards say that were learned from one of them, in chapter 6, or from
two. It takes about six minutes.
"""

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from typing import Any, NamedTuple

import gymnasium
import mujoco
import numpy as np
import torch
from torch import Generator, nn
from torch.nn.functional import softplus

from grid_worlds import MIRROR, QUARTER, Player, turned
from offairl_lite import (
    demonstrations,
    envs,
    experiments,
    tabular,
    worlds,
)
from offairl_lite.core.replay import Batch
from offairl_lite.core.results import Run, learned_returns
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rollouts import rollout
from offairl_lite.demonstrations import Demonstrations
from offairl_lite.envs import TASKS, models
from offairl_lite.envs.tasks import Task
from offairl_lite.plain import adam, descend, mlp
from offairl_lite.runs import records
from offairl_lite.tabular import apart, policy_return, soft_value_iteration
from rollouts import RECORDS

SEEDS = tuple(range(5))
LEFT, RIGHT, TURNED, WEAK = (
    f"offairl/PointMaze{name}-v0"
    for name in ("Left", "Right", "Turned", "Weak")
)
STRENGTH = 0.4
"""Of weak motors, in terms of the ordinary ones."""
RECORDED = {
    "r(s, a)": "maze-rewards-demo/implementation-3",
    "r(s)": "maze-imitation-demo",
}


def record() -> dict[str, Any]:
    """Return what the chapter says of networks."""
    register()
    return {
        "game": {
            f"{features}, {count}": [
                play(features, count, seed) for seed in SEEDS
            ]
            for features in ("table", "network")
            for count in (1, 2)
        },
        "distances": distances(),
        "recorded": {
            name: of_reward(records.read(RECORDS / folder).reward)
            for name, folder in RECORDED.items()
        },
        "both": of_both(),
    }


# ---- The game, with numbers or with networks ----

CELLS = 6
ROUNDS = UPDATES = 40


def play(features: str, count: int, seed: int) -> tuple[float, ...]:
    """Return correlation, share of the action and two scores of a reward.

    The scores are of plans in the maze with the wall on the other side,
    with the same controls and with mirrored ones.
    """
    small = tabular.maze(CELLS, "Left", discount=0.9)
    truth = small.reward / 0.3
    pair = [small.mdp, turned(small.mdp, QUARTER)]
    players = [Player(mdp, truth) for mdp in pair[:count]]
    of_state, of_pair, hidden, rate = inputs(features, small)
    rng = Generator().manual_seed(seed)
    reward = mlp([of_pair.shape[1], *hidden, 1], nn.Tanh, rng)
    sizes = [of_state.shape[1], *hidden, 1]
    values = nn.ModuleList(mlp(sizes, nn.Tanh, rng) for _ in players)
    optimizer = adam(nn.ModuleList([reward, values]).parameters(), lr=rate)
    for k in range(ROUNDS):
        optimizer.param_groups[0]["lr"] = rate * (1 - k / ROUNDS)
        for _ in range(UPDATES):
            descend(
                loss(players, reward, values, of_state, of_pair), optimizer
            )
        r = reward(of_pair).detach().double().numpy().reshape(-1, 5)
        for player in players:
            player.improve(r)
    return *likeness(r, truth), *scores(r, truth, small.mdp)


def inputs(features: str, small: tabular.Maze) -> tuple:
    """Return what V and r see, hidden layers and the learning rate."""
    s = small.mdp.num_states
    if features == "table":
        return torch.eye(s), torch.eye(5 * s), [], 0.1
    at = torch.tensor(small.positions / small.positions.std()).float()
    moves = torch.tensor(tabular.MOVES).float().repeat(s, 1)
    pairs = torch.cat([at.repeat_interleave(5, 0), moves], 1)
    return at, pairs, [64, 64], 0.005


def loss(players, reward, values, of_state, of_pair):
    """Return AIRL's cross-entropy, summed over the worlds."""
    r, total = reward(of_pair).squeeze(-1), 0.0
    for player, net in zip(players, values, strict=True):
        v = net(of_state).squeeze(-1)
        here, there = player.steps.obs @ v, player.steps.next_obs @ v
        logit = r + player.mdp.discount * there - here - player.log_pi
        total = total + player.seen @ softplus(-logit)
        total = total + player.visits @ softplus(logit)
    return total


def likeness(r, truth) -> tuple[float, float]:
    """Return the correlation of r(s, a), and the action's share of it."""
    pair = r.ravel(), np.repeat(truth, r.shape[1])
    by_action = (r - r.mean(1, keepdims=True)).var()
    return np.corrcoef(*pair)[0, 1], by_action / r.var()


def scores(r, truth, left) -> list[float]:
    """Return 0 for a copy of the expert on the left, 1 for an expert."""
    right = tabular.maze(CELLS, "Right", discount=0.9).mdp
    start = np.full(len(truth), 1 / len(truth))
    copy, found = soft_value_iteration(left, truth).policy, []
    for mdp in (right, turned(right, MIRROR)):
        new = replace(mdp, initial=start)
        plans = [
            soft_value_iteration(new, each, 0.1).policy
            for each in (truth, r)
        ]
        copied, best, learned = (
            policy_return(new, policy, truth) for policy in (copy, *plans)
        )
        found.append((learned - copied) / (best - copied))
    return found


# ---- The continuous mazes ----


def _turned() -> mujoco.MjModel:
    """The first motor pushes along y, the second against x."""
    model = models.particle(models.START, "Left")
    model.actuator_trnid[:, 0] = model.actuator_trnid[::-1, 0].copy()
    model.actuator_gear[1, 0] *= -1
    return model


def _weak() -> mujoco.MjModel:
    model = models.particle(models.START, "Left")
    model.actuator_gear *= STRENGTH
    return model


def register() -> None:
    """Make these mazes known, as the others are."""
    make_known(TURNED, TASKS[LEFT], _turned)
    make_known(WEAK, TASKS[LEFT], _weak)


def make_known(env_id: str, like: Task, model: Callable) -> None:
    """Register a task that is like another one, but for its model."""
    TASKS[env_id] = replace(like, model=model)
    gymnasium.register(
        env_id,
        entry_point="offairl_lite.envs:SingleEnv",
        vector_entry_point="offairl_lite.envs:BatchedEnv",
        max_episode_steps=like.max_episode_steps,
        kwargs={"task": env_id},
    )


class Steps(NamedTuple):
    """Recorded steps of a maze."""

    obs: np.ndarray
    action: np.ndarray
    next_obs: np.ndarray


def wander(env_id: str, seed: int, steps: int = 30_000) -> Steps:
    """Record random actions, each held for ten steps on average."""
    rng, count, rows = np.random.default_rng(seed), 10, []
    with closing(envs.make(env_id, count, seed * count)) as env:
        shape = env.action_space.shape
        action, (obs, _) = rng.uniform(-1, 1, shape), env.reset()
        for _ in range(steps // count):
            other = rng.uniform(-1, 1, shape)
            action = np.where(rng.random((count, 1)) < 0.1, other, action)
            next_obs, _, _, done, _ = env.step(action.astype(np.float32))
            rows.append((obs, action, next_obs))
            obs = next_obs
            if done.any():
                obs, _ = env.reset(options={"reset_mask": done})
    return Steps(*(np.concatenate(x) for x in zip(*rows, strict=True)))


def distances() -> dict[str, list]:
    """Return distances from Left, and between halves, of three draws."""
    return {
        demonstrations.short_name(maze): [
            apart([wander(LEFT, 2 * i), wander(maze, 2 * i + 1)])
            for i in range(3)
        ]
        for maze in (LEFT, RIGHT, WEAK, TURNED)
    }


def shown_in_both() -> list[Demonstrations]:
    """Return 25 demonstrations of Left, and another 25, turned.

    Whoever wants the same with turned controls pushes in the same
    direction, by another command.
    """
    left, all_left = (demonstrations.load(LEFT, n) for n in (25, 50))
    x, y = all_left.transitions.pre_tanh.unbind(-1)
    commands = torch.stack([y, -x], -1)
    steps = all_left.transitions._replace(pre_tanh=commands)
    later = Batch(*(part[sum(left.lengths) :] for part in steps))
    return [left, Demonstrations(TURNED, later, all_left.lengths[25:])]


def learned_from_both() -> list[Run]:
    """Learn one r(s, a) from both, as chapter 6 does from Left."""
    config = experiments.configure("maze-imitation", "demo")
    config = config.change(reward="r-sa")
    return worlds.train(config, SEEDS, shown_in_both(), progress=False)


def of_both() -> dict[str, Any]:
    """Return what the reward from both says, and the imitators' returns."""
    runs = learned_from_both()
    assert runs[0].reward is not None
    returns = {run.config.env_id: run.returns[:, -1] for run in runs}
    return {**of_reward(runs[0].reward), "returns": returns}


def of_reward(rewards: Reward) -> dict[str, Any]:
    """Return what five rewards of PointMazeLeft say of PointMazeRight.

    Correlation and share of the action as above, with full pushes at 400
    places; and what they pay Left's experts, who are stuck there, and
    Right's.
    """
    paid = {}
    for name, maze_id in (("stuck", LEFT), ("expert", RIGHT)):
        policy = demonstrations.expert(maze_id)
        walks = rollout(policy, RIGHT, range(len(policy)), 3)
        paid[name] = [
            learned_returns(
                walks, rewards.member(*[i] * len(policy))
            ).mean()
            for i in range(len(rewards))
        ]
    return {"likeness": likenesses(rewards), **paid}


def likenesses(rewards: Reward) -> list[tuple[float, float]]:
    """Return each reward's correlation and the action's share, as above."""
    maze, count = tabular.maze(20, "Right"), len(rewards)
    places = np.repeat(maze.positions, 5, 0)
    obs = torch.zeros(count, len(places), 3)
    obs[..., :2] = torch.from_numpy(places)
    pushes = torch.from_numpy(np.tile(tabular.MOVES, (400, 1))).float()
    r = rewards(obs, pushes.expand(count, -1, -1)).double().numpy()
    return [likeness(each.reshape(-1, 5), maze.reward) for each in r]
