"""What a reward from one maze, or from two, is worth in a third.

Experts demonstrate the maze with the barrier on the left and a second one:
with the barrier on the right, turned controls or weak motors. New agents
are paid by the reward in mazes that nobody has demonstrated. The rewards of
all pairs pay one population, of which five agents belong to each.

It takes half an hour. What is trained is kept in `runs/third_maze`, and is
not trained again: remove the folder to start afresh.
"""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch

from offairl_lite import demonstrations, experiments, worlds
from offairl_lite.config import Config
from offairl_lite.core import loop
from offairl_lite.core.networks import Normaliser
from offairl_lite.core.policies import Policy
from offairl_lite.core.results import Run
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rollouts import rollout
from offairl_lite.demonstrations import Demonstrations
from offairl_lite.envs import TASKS, models
from offairl_lite.runs import records
from rollouts import RECORDS, two_mazes
from rollouts.two_mazes import LEFT, RECORDED, RIGHT, SEEDS, TURNED, WEAK

WORK = Path("runs/third_maze")
LOW, MIRRORED = (
    f"offairl/PointMaze{name}-v0" for name in ("Low", "Mirrored")
)
BELOW = 0.15
"""How much lower the barrier of the low maze is, in metres."""
SECOND = {"turned": TURNED, "weak": WEAK, "moved": RIGHT}
FORMS = {"r(s, a)": "r-sa", "r(s)": "r-s"}
NEW = {"moved": RIGHT, "mirrored": MIRRORED, "low": LOW}
"""The third mazes: the barrier on the right, twice, and a lower one."""


def record() -> dict[str, Any]:
    """Return the ends of imitators and of new agents."""
    register()
    WORK.mkdir(parents=True, exist_ok=True)
    result: dict[str, Any] = {"imitators": {}, "likeness": {}, "new": {}}
    for form in FORMS:
        rewards = {"none": records.read(RECORDS / RECORDED[form]).reward}
        for name, second in SECOND.items():
            rewards[name], ends = learned(form, name, second)
            result["imitators"][f"{form}, {name}"] = ends
        for name, reward in rewards.items():
            said = two_mazes.likenesses(reward)
            result["likeness"][f"{form}, {name}"] = said
        for place, env_id in NEW.items():
            ends = retrained(form, place, env_id, rewards)
            for name, last in ends.items():
                result["new"][f"{form}, {name}, {place}"] = last
    return result | {"levels": levels()}


# ---- The mazes ----


def _mirrored() -> mujoco.MjModel:
    model = models.particle(models.START, "Right")
    model.actuator_gear[0] *= -1
    return model


def _low() -> mujoco.MjModel:
    model = models.particle(models.START, "Right")
    is_wall = model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE
    barrier = np.flatnonzero(is_wall)[-1]  # the last, see `models.walls`
    model.geom_pos[barrier, 1] -= BELOW
    return model


def register() -> None:
    """Make all mazes known."""
    two_mazes.register()
    for env_id, model in ((LOW, _low), (MIRRORED, _mirrored)):
        two_mazes.make_known(env_id, TASKS[LEFT], model)


# ---- What is learned ----


def learned(form: str, name: str, second: str) -> tuple[Reward, dict]:
    """Return a reward from Left and a second maze, and imitators' ends."""
    file = WORK / f"{FORMS[form]}-{name}.safetensors"
    ends = file.with_suffix(".json")
    if not ends.is_file():
        config = experiments.configure("maze-imitation", "demo")
        config = config.change(reward=FORMS[form])
        shown = shown_in(second)
        runs = worlds.train(config, SEEDS, shown, progress=False)
        assert runs[0].reward is not None
        runs[0].reward.save(file)
        last = [run.returns[:, -1].tolist() for run in runs]
        ends.write_text(json.dumps(last), "utf-8")
        say(form, name, last)
    return Reward.load(file), json.loads(ends.read_text("utf-8"))


def shown_in(second: str) -> list[Demonstrations]:
    """Return 25 demonstrations of Left, and 25 of a second maze."""
    if second == TURNED:
        return two_mazes.shown_in_both()
    left = demonstrations.load(LEFT, 25)
    if second == RIGHT:
        return [left, demonstrations.load(RIGHT, 25)]
    episodes = demonstrations.record(weak_expert(), WEAK, 25)
    return [left, demonstrations.of(episodes, WEAK)]


def weak_expert() -> Policy:
    """Return experts with weak motors, trained from the strong ones'."""
    file = WORK / "weak-expert.safetensors"
    if not file.is_file():
        config = experiments.configure("maze-expert", "demo").change(
            env_id=WEAK,
            pretrained="policy",
            learning_starts=100,
            random_hold=1.0,
            total_steps=6_000,
        )
        policy = demonstrations.expert(LEFT)
        seeds = range(len(policy))
        run = loop.train(
            config, seeds, pretrained_policy=policy, progress=False
        )
        assert run.policy is not None
        say("weak expert", run.returns[:, -1])
        run.policy.save(file)
    return Policy.load(file)


# ---- What it is worth ----


def retrained(
    form: str, place: str, env_id: str, rewards: dict[str, Reward]
) -> dict[str, list]:
    """Return the last returns of new agents, by what their reward is of."""
    kept = WORK / f"{FORMS[form]}-to-{place}.json"
    if not kept.is_file():
        names = [name for name in rewards if SECOND.get(name) != env_id]
        run = paid(env_id, beside([rewards[name] for name in names]))
        last = run.returns[:, -1].reshape(len(names), -1).tolist()
        ends = dict(zip(names, last, strict=True))
        kept.write_text(json.dumps(ends), "utf-8")
        say(form, place, ends)
    return json.loads(kept.read_text("utf-8"))


def beside(rewards: Sequence[Reward]) -> Reward:
    """Return one population of all members of several."""
    first = rewards[0]
    scalings = zip(*(each.normaliser for each in rewards), strict=True)
    return replace(
        first,
        params=torch.cat([each.params for each in rewards]),
        normaliser=Normaliser(*(torch.cat(part) for part in scalings)),
    )


def paid(env_id: str, reward: Reward | None) -> Run:
    """Train new agents, paid by a reward; with None by the task's own."""
    config: Config = experiments.configure("maze-transfer", "demo")
    config = config.change(env_id=env_id)
    if reward is None:
        config = config.change(reward="environment", reward_scale=100.0)
    seeds = SEEDS if reward is None else range(len(reward))
    return loop.train(config, seeds, frozen_reward=reward, progress=False)


def levels() -> dict[str, Any]:
    """Return what copies and experts get, and SAC on the task's reward.

    Left's experts are the copies, and Right's the experts. With mirrored
    controls these would do the mirrored actions, and get the same.
    """
    kept = WORK / "levels.json"
    if not kept.is_file():
        found = {}
        for place, env_id in NEW.items():
            ends = {"true": paid(env_id, None).returns[:, -1].tolist()}
            at_home = RIGHT if env_id == MIRRORED else env_id
            for name, home, maze in (
                ("copy", LEFT, env_id),
                ("expert", RIGHT, at_home),
            ):
                policy = demonstrations.expert(home)
                walks = rollout(policy, maze, range(len(policy)), 10)
                ends[name] = walks.returns.mean(1).tolist()
            found[place] = ends
            say(place, ends)
        kept.write_text(json.dumps(found), "utf-8")
    return json.loads(kept.read_text("utf-8"))


def say(*words: Any) -> None:
    """Tell at once what has been found."""
    print(*words, flush=True)
