"""One reward from two mazes of a point mass, for chapter 12.

Experts demonstrate the maze with the barrier on the left; the same maze
with controls turned by 90 degrees, or with weak motors; and the maze with
the barrier on the right. A reward r(s, a) or r(s) is learned from one of
them or from two, and 50 demonstrations in all. Five new agents are paid by
it where nobody has demonstrated anything.

What is trained is kept in `runs/two_mazes`, and is not trained again:
remove the folder to start afresh.
"""

import json
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import mujoco
import numpy as np
import torch

from offairl_lite import demonstrations, envs, experiments, worlds
from offairl_lite.config import Config
from offairl_lite.core import loop
from offairl_lite.core.policies import Policy
from offairl_lite.core.results import Run
from offairl_lite.core.rewards import Reward
from offairl_lite.demonstrations import Demonstrations
from offairl_lite.envs import TASKS, models
from offairl_lite.tabular import apart

WORK = Path("runs/two_mazes")
LEFT, RIGHT = "offairl/PointMazeLeft-v0", "offairl/PointMazeRight-v0"
TURNED, WEAK, LOW = (
    f"offairl/PointMaze{name}-v0" for name in ("Turned", "Weak", "Low")
)
SEEDS = tuple(range(5))
SHOWN = 50
"""Demonstrations in all, of one maze or of two."""
STRENGTH = 0.4
"""Of the weak motors, in terms of the ordinary ones."""
WANDERED = 30_000
"""Steps of random actions from which distances are estimated."""
BELOW = 0.15
"""How much lower the barrier of the low maze is, in metres."""

LEARNED_FROM = {
    "Left": [LEFT],
    "Left and turned": [LEFT, TURNED],
    "Left and weak": [LEFT, WEAK],
    "Left and Right": [LEFT, RIGHT],
}
REWARDS = {"r(s, a)": "r-sa", "r(s)": "r-s"}


def record() -> dict[str, Any]:
    """Return how imitators and new agents end, by reward and mazes."""
    register()
    kept = {}
    for name, reward in REWARDS.items():
        for pair, mazes in LEARNED_FROM.items():
            learned = learn(mazes, reward)
            ends = {short(maze): learned["returns"][maze] for maze in mazes}
            for maze in (RIGHT, LOW):
                if maze not in mazes:
                    file = learned["file"]
                    ends[f"new: {short(maze)}"] = transfer(file, maze)
            kept[f"{name}, {pair}"] = ends
    return kept


# ---- The mazes ----


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


def _low() -> mujoco.MjModel:
    model = models.particle(models.START, "Right")
    is_wall = model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE
    barrier = np.flatnonzero(is_wall)[-1]  # the last, see `models.walls`
    model.geom_pos[barrier, 1] -= BELOW
    return model


def register() -> None:
    """Make these mazes known, as the others are."""
    for env_id, model in ((TURNED, _turned), (WEAK, _weak), (LOW, _low)):
        TASKS[env_id] = replace(TASKS[LEFT], model=model)
        gymnasium.register(
            env_id,
            entry_point="offairl_lite.envs:SingleEnv",
            vector_entry_point="offairl_lite.envs:BatchedEnv",
            max_episode_steps=TASKS[env_id].max_episode_steps,
            kwargs={"task": env_id},
        )


def short(env_id: str) -> str:
    """Return `Left` for `offairl/PointMazeLeft-v0`."""
    return demonstrations.short_name(env_id).removeprefix("PointMaze")


# ---- How far they are apart ----


class Steps(NamedTuple):
    """Recorded steps of a maze."""

    obs: np.ndarray
    action: np.ndarray
    next_obs: np.ndarray


def wander(env_id: str, seed: int, steps: int = WANDERED) -> Steps:
    """Record random actions, each held for ten steps on average."""
    rng, count = np.random.default_rng(seed), 10
    action, rows = rng.uniform(-1, 1, (count, 2)), []
    with closing(envs.make(env_id, count, seed * count)) as env:
        obs, _ = env.reset()
        for _ in range(steps // count):
            fresh = rng.random(count) < 0.1
            action = np.where(
                fresh[:, None], rng.uniform(-1, 1, (count, 2)), action
            )
            next_obs, _, _, done, _ = env.step(action.astype(np.float32))
            rows.append((obs, action, next_obs))
            obs = next_obs
            if done.any():
                obs, _ = env.reset(options={"reset_mask": done})
    return Steps(
        *(np.concatenate(part) for part in zip(*rows, strict=True))
    )


def distances() -> dict[str, list]:
    """Return how far mazes are from Left, and halves of one, by draw."""
    return {
        short(maze): [
            apart([wander(LEFT, 2 * i), wander(maze, 2 * i + 1)])
            for i in range(3)
        ]
        for maze in (LEFT, RIGHT, WEAK, TURNED)
    }


# ---- What is shown ----


def demonstrated(env_id: str, count: int) -> Demonstrations:
    """Return demonstrations; with two mazes these are different ones."""
    if env_id == WEAK:
        policy = kept("weak-expert", weak_expert, Policy.load)
        recordings = demonstrations.record(policy, WEAK, count)
        return demonstrations.of(recordings, WEAK)
    if env_id != TURNED:
        return demonstrations.load(env_id, count)
    # Whoever wants the same here makes the same moves by other commands.
    steps = sum(demonstrations.load(LEFT, SHOWN - count).lengths)
    shown = demonstrations.load(LEFT, SHOWN)
    x, y = shown.transitions.pre_tanh.unbind(-1)
    batch = shown.transitions._replace(pre_tanh=torch.stack([y, -x], -1))
    later = type(batch)(*(part[steps:] for part in batch))
    return Demonstrations(TURNED, later, shown.lengths[-count:])


def weak_expert() -> Policy:
    """Train experts with weak motors, from those with ordinary ones."""
    config = experiments.configure("maze-expert", "demo").change(
        env_id=WEAK,
        pretrained="policy",
        learning_starts=100,
        random_hold=1.0,
        total_steps=6_000,
    )
    policy = demonstrations.expert(LEFT)
    run = loop.train(
        config, SEEDS, pretrained_policy=policy, progress=False
    )
    assert run.policy is not None
    return run.policy


# ---- What is learned ----


def kept(name: str, make: Callable, load: Callable) -> Any:
    """Load what is there, or make it and keep it."""
    path = WORK / f"{name}.safetensors"
    if not path.is_file():
        make().save(path)
    return load(path)


def learn(mazes: list[str], reward: str) -> dict[str, Any]:
    """Return the file of a reward, and the imitators' returns."""
    name = "-".join([reward, *map(short, mazes)])
    file = WORK / f"{name}.safetensors"
    ends = file.with_suffix(".json")
    if not ends.is_file():
        shown = [demonstrated(m, SHOWN // len(mazes)) for m in mazes]
        config = experiments.configure("maze-imitation", "demo")
        config = config.change(reward=reward, env_id=LEFT)
        runs = imitate(config, shown)
        assert runs[0].reward is not None
        runs[0].reward.save(file)
        last = {run.config.env_id: run.returns.tolist() for run in runs}
        ends.write_text(json.dumps(last), "utf-8")
    return {"file": file, "returns": json.loads(ends.read_text("utf-8"))}


def imitate(config: Config, shown: list[Demonstrations]) -> list[Run]:
    """Learn one reward from the demonstrations of one maze or of two."""
    if len(shown) == 1:
        return [loop.train(config, SEEDS, shown[0], progress=False)]
    return worlds.train(config, SEEDS, shown, progress=False)


def transfer(file: Path, env_id: str) -> list[list[float]]:
    """Return the curves of new agents that a kept reward pays."""
    path = file.with_name(f"{file.stem}-to-{short(env_id)}.json")
    if not path.is_file():
        config = experiments.configure("maze-transfer", "demo")
        run = loop.train(
            config.change(env_id=env_id),
            SEEDS,
            frozen_reward=Reward.load(file),
            progress=False,
        )
        path.write_text(json.dumps(run.returns.tolist()), "utf-8")
    return json.loads(path.read_text("utf-8"))
