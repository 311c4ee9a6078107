"""What a reward from one maze, or from two, is worth in a third.

Experts demonstrate the maze with the barrier on the left, or that and a
second one: the same maze with turned controls or weak motors, or with the
barrier on the right. There are 50 demonstrations in all. New agents are
paid by the reward in mazes that nobody has demonstrated. Rewards from one
maze and from two pay one population, of which five agents belong to each.

It takes half an hour. What is trained is kept in `runs/third_maze`,
and is not trained again: remove the folder to start afresh.
"""

import json
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import mujoco
import torch

from offairl_lite import demonstrations, experiments, worlds
from offairl_lite.core import loop
from offairl_lite.core.networks import Normaliser
from offairl_lite.core.policies import Policy
from offairl_lite.core.results import Run
from offairl_lite.core.rewards import Reward
from offairl_lite.envs import TASKS, models
from offairl_lite.runs import records
from rollouts import RECORDS, two_mazes
from rollouts.two_mazes import LEFT, RECORDED, RIGHT, SEEDS, WEAK

WORK = Path("runs/third_maze")
MIRRORED, LOW = (
    f"offairl/PointMaze{name}-v0" for name in ("Mirrored", "Low")
)
FORMS = {"r(s, a)": "r-sa", "r(s)": "r-s"}
NEW = {"moved": RIGHT, "mirrored": MIRRORED, "low": LOW}
"""The third mazes: the barrier on the right, with two kinds of controls,
and a lower barrier. For a reward from both sides the first is no third.
"""
TRUE = "maze-transfer-rewards-demo/true/true-scratch"


def record() -> dict[str, Any]:
    """Return the last returns of new agents."""
    register()
    WORK.mkdir(parents=True, exist_ok=True)
    true = records.read(RECORDS / TRUE).returns[:, -1]
    result: dict[str, Any] = {"new": {}, "true": true}
    for form in FORMS:
        one = records.read(RECORDS / RECORDED[form]).reward
        groups = [{"none": one, "turned": learned(form, "turned")}]
        if form == "r(s, a)":
            groups.append({"weak": learned(form, "weak")})
        for rewards, place in product(groups, ("moved", "mirrored")):
            for name, last in retrained(form, place, rewards).items():
                result["new"][f"{form}, {name}, {place}"] = last
    result["sides"] = of_both_sides()
    return result


def of_both_sides() -> dict[str, Any]:
    """Return the same, of rewards that both sides have shown."""
    result: dict[str, Any] = {}
    for form in FORMS:
        one = records.read(RECORDS / RECORDED[form]).reward
        sides = learned(form, "sides")
        for place, rewards in (
            ("mirrored", {"sides": sides}),
            ("low", {"none": one, "sides": sides}),
        ):
            for name, last in retrained(form, place, rewards).items():
                result[f"{form}, {name}, {place}"] = last
    return {**result, "true, low": on_the_true_reward()}


def _mirrored() -> mujoco.MjModel:
    model = models.particle(models.START, "Right")
    model.actuator_gear[0] *= -1
    return model


def _low() -> mujoco.MjModel:
    """The barrier of Left, moved to the right, and halfway to the start."""
    model = models.particle(models.START, "Left")
    barrier = len(models.walls("Left")) - 1
    model.geom_pos[barrier, :2] = 0.35, 0.15
    # What speeds up the search for contacts expects the barrier elsewhere.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE
    return model


def register() -> None:
    """Make all mazes known."""
    two_mazes.register()
    two_mazes.make_known(LOW, TASKS[LEFT], _low)
    two_mazes.make_known(MIRRORED, TASKS[LEFT], _mirrored)


def learned(form: str, second: str) -> Reward:
    """Return a reward from Left and a second maze."""
    file = WORK / f"{FORMS[form]}-{second}.safetensors"
    if not file.is_file():
        shown = two_mazes.shown_in_both()
        if second == "sides":
            shown[1] = demonstrations.load(RIGHT, 25)
        if second == "weak":
            episodes = demonstrations.record(weak_expert(), WEAK, 25)
            shown[1] = demonstrations.of(episodes, WEAK)
        config = experiments.configure("maze-imitation", "demo")
        config = config.change(reward=FORMS[form])
        runs = worlds.train(config, SEEDS, shown, progress=False)
        assert runs[0].reward is not None
        runs[0].reward.save(file)
    return Reward.load(file)


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
        run = loop.train(
            config,
            range(len(policy)),
            pretrained_policy=policy,
            progress=False,
        )
        assert run.policy is not None
        run.policy.save(file)
    return Policy.load(file)


def retrained(
    form: str, place: str, rewards: dict[str, Reward]
) -> dict[str, list]:
    """Return the last returns of new agents, by what their reward is of."""
    names = "-".join(rewards)
    kept = WORK / f"{FORMS[form]}-{names}-to-{place}.json"
    if not kept.is_file():
        run = paid(NEW[place], beside([*rewards.values()]))
        last = run.returns[:, -1].reshape(len(rewards), -1).tolist()
        ends = dict(zip(rewards, last, strict=True))
        kept.write_text(json.dumps(ends), "utf-8")
    return json.loads(kept.read_text("utf-8"))


def beside(rewards: Sequence[Reward]) -> Reward:
    """Return one population of all members of several."""
    scalings = zip(*(each.normaliser for each in rewards), strict=True)
    return replace(
        rewards[0],
        params=torch.cat([each.params for each in rewards]),
        normaliser=Normaliser(*(torch.cat(part) for part in scalings)),
    )


def paid(env_id: str, reward: Reward) -> Run:
    """Train new agents, paid by a reward, as chapter 9 does."""
    config = experiments.configure("maze-transfer", "demo")
    return loop.train(
        config.change(env_id=env_id),
        range(len(reward)),
        frozen_reward=reward,
        progress=False,
    )


def on_the_true_reward() -> list[float]:
    """Return the last returns in the maze with the low barrier."""
    kept = WORK / "true-to-low.json"
    if not kept.is_file():
        config = experiments.configure("maze-transfer", "demo")
        config = config.change(env_id=LOW, reward="environment")
        run = loop.train(config, SEEDS, progress=False)
        kept.write_text(json.dumps(run.returns[:, -1].tolist()), "utf-8")
    return json.loads(kept.read_text("utf-8"))
