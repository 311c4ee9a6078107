"""What a reward from one body, or from two, is worth on a third.

CustomAnt has four strong legs, DisabledAnt two weak ones on its right. The
second body is DisabledAnt seen in a mirror, so its left legs are weak, and
DisabledAnt's expert demonstrates it, in the mirror. A reward of the whole
state is learned from both with the recipe, from 50 demonstrations in all.
DisabledAnt is trained from scratch on it.

It takes about forty minutes, with a compiler. What is trained is kept in
`runs/two_bodies`, and is not trained again: remove the folder to start
afresh.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch

from offairl_lite import demonstrations, experiments, worlds
from offairl_lite.core import loop
from offairl_lite.core.acceleration import Execution, compiler
from offairl_lite.core.replay import Batch
from offairl_lite.core.results import Run
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rollouts import Episodes, rollout
from offairl_lite.demonstrations import Demonstrations
from offairl_lite.envs import TASKS
from offairl_lite.runs import records
from rollouts import RECORDS
from rollouts.two_mazes import SEEDS, make_known

WORK = Path("runs/two_bodies")
ABLE, WEAK, MIRRORED = (
    f"offairl/{name}Ant-v0" for name in ("Custom", "Disabled", "Mirrored")
)
BODIES = (ABLE, MIRRORED)
"""They are demonstrated equally often."""
STEPS = 50_000
OF_ABLE = "locomotion-demo/CustomAnt-airl"
"""The reward from CustomAnt alone, of ten times as many steps."""
RECORDED = {
    "able": "state-recipe",
    "velocity, able": "velocity-recipe-raw",
    "true": "true",
}
"""New agents on DisabledAnt that others than these rewards pay."""


def record() -> dict[str, Any]:
    """Return how imitators and new agents end, and what rewards say."""
    register()
    WORK.mkdir(parents=True, exist_ok=True)
    result: dict[str, Any] = {"imitators": {}, "new": {}, "says": {}}
    for name, folder in RECORDED.items():
        place = RECORDS / f"decides-transfer-demo/{folder}/scratch"
        result["new"][name] = ends_of(records.read(place))
    of_able = records.read(RECORDS / OF_ABLE).reward
    walks = [
        rollout(demonstrations.expert(body).member(0), WEAK, (0,), 5)
        for body in (ABLE, WEAK)
    ]
    result["says"]["able"] = says(of_able, walks)
    reward, result["imitators"] = learned()
    result["says"]["both"] = says(reward, walks)
    result["new"]["both"] = retrained(reward)
    return result


# ---- The mirror ----

LEGS = (4, 1, 2, 3)
"""In the order of the actions, hip before ankle."""


def mirror() -> tuple[np.ndarray, np.ndarray]:
    """Return which number an observation has in the mirror, and its sign.

    Left and right, the y axis, are exchanged: legs 1 and 4, and 2 and 3.
    Velocities and forces change the sign of y, turns and torques those of x
    and z, and so do hips, which turn about z.
    """
    legs, hinge = np.array([4, 3, 2, 1]) - 1, np.array([-1, 1])
    joints = (2 * legs[:, None] + np.arange(2)).ravel()
    bodies = np.concatenate(
        [[0, 1], (2 + 3 * legs[:, None] + [0, 1, 2]).ravel()]
    )
    parts = [
        (np.arange(1), [1]),  # the height
        (np.arange(4), [1, -1, 1, -1]),  # the torso's quaternion
        (joints, np.tile(hinge, 4)),
        (np.arange(3), [1, -1, 1]),  # its velocity
        (np.arange(3), [-1, 1, -1]),  # and its turning
        (joints, np.tile(hinge, 4)),
        (
            (6 * bodies[:, None] + np.arange(6)).ravel(),
            np.tile([-1, 1, -1, 1, -1, 1], len(bodies)),
        ),
    ]
    starts = np.cumsum([0, *(len(order) for order, _ in parts)])
    order = [
        start + order
        for start, (order, _) in zip(starts, parts, strict=False)
    ]
    signs = [np.array(sign, float) for _, sign in parts]
    return np.concatenate(order), np.concatenate(signs)


def mirrored_actions() -> tuple[np.ndarray, np.ndarray]:
    """Return the same of actions."""
    legs = [LEGS.index(5 - leg) for leg in LEGS]
    order = (2 * np.array(legs)[:, None] + np.arange(2)).ravel()
    return order, np.tile([-1.0, 1.0], 4)


def in_the_mirror(env_id: str, new_id: str) -> None:
    """Make the mirror image of an ant known."""
    task, (order, sign) = TASKS[env_id], mirror()
    commands, change = mirrored_actions()

    def model() -> mujoco.MjModel:
        ant = task.model()
        ant.actuator_trnid[:] = ant.actuator_trnid[commands].copy()
        ant.actuator_gear[:] = ant.actuator_gear[commands].copy()
        ant.actuator_gear[:, 0] *= change
        return ant

    def observe(physics) -> np.ndarray:
        return task.observe(physics)[:, order] * sign

    make_known(new_id, replace(task, observe=observe), model)


def register() -> None:
    """Make the second body known."""
    in_the_mirror(WEAK, MIRRORED)


def shown_by(env_id: str, count: int) -> Demonstrations:
    """Return demonstrations, those of the mirror image in the mirror."""
    if env_id != MIRRORED:
        return demonstrations.load(env_id, count, experts=1)
    shown = demonstrations.load(WEAK, count, experts=1)
    order, sign = mirror()
    commands, change = mirrored_actions()
    steps = shown.transitions
    seen = torch.tensor(sign).float()
    batch = steps._replace(
        obs=steps.obs[:, order] * seen,
        next_obs=steps.next_obs[:, order] * seen,
        pre_tanh=steps.pre_tanh[:, commands] * torch.tensor(change).float(),
    )
    return Demonstrations(MIRRORED, Batch(*batch), shown.lengths)


# ---- What is learned, and what it is worth ----


def execution() -> Execution:
    """Compile, if there is a compiler."""
    return Execution(compile=compiler() is not None)


def learned() -> tuple[Reward, dict[str, list]]:
    """Return a reward, and the imitators' last returns on each body."""
    file = WORK / "r-s-both.safetensors"
    ends = file.with_suffix(".json")
    if not ends.is_file():
        config = experiments.configure("locomotion/CustomAnt-airl", "demo")
        config = config.change(
            total_steps=STEPS, eval_every=10_000, eval_episodes=2
        )
        shown = [shown_by(body, 25) for body in BODIES]
        runs = worlds.train(
            config, SEEDS, shown, execution=execution(), progress=False
        )
        assert runs[0].reward is not None
        runs[0].reward.save(file)
        curves = [run.returns.tolist() for run in runs]
        ends.write_text(json.dumps(curves), "utf-8")
    curves = json.loads(ends.read_text("utf-8"))
    last = [[row[-1] for row in body] for body in curves]
    names = map(demonstrations.short_name, BODIES)
    return Reward.load(file), dict(zip(names, last, strict=True))


def retrained(reward: Reward) -> dict[str, list]:
    """Return the last returns of new agents, true and learned."""
    kept = WORK / "r-s-both-new.json"
    if not kept.is_file():
        config = experiments.configure(
            "ant-transfer/scratch", "demo"
        ).change(learning_starts=1_000, temperature=0.2)
        run = loop.train(
            config,
            SEEDS,
            frozen_reward=reward,
            execution=execution(),
            progress=False,
        )
        kept.write_text(json.dumps(ends_of(run)), "utf-8")
    return json.loads(kept.read_text("utf-8"))


def ends_of(run: Run) -> dict[str, list]:
    """Return the last returns, by the task's reward and the learned one."""
    last = [row for row in run.rows if row.step == STEPS]
    return {
        "true": [row.mean_return for row in last],
        "learned": [
            row.learned_return
            for row in last
            if np.isfinite(row.learned_return)
        ],
    }


# ---- Why ----


def says(reward: Reward, walks: list[Episodes]) -> dict[str, list]:
    """Return what rewards pay on DisabledAnt, and how that correlates.

    The mean of a step of CustomAnt's expert, who is helpless there, and of
    its own, and the correlation with the true reward over both.
    """
    obs, action, true = (
        [getattr(walk, part) for walk in walks]
        for part in ("obs", "action", "reward")
    )
    paid = []
    for o, a in zip(obs, action, strict=True):
        x, u = (
            torch.as_tensor(part, dtype=torch.float32)
            .flatten(1, 2)
            .expand(len(reward), -1, -1)
            for part in (o, a)
        )
        paid.append(reward(x, u).double().numpy())
    truth = np.concatenate([part.ravel() for part in true])
    both = np.concatenate(paid, 1)
    return {
        "helpless": paid[0].mean(1).tolist(),
        "walk": paid[1].mean(1).tolist(),
        "correlation": [np.corrcoef(r, truth)[0, 1] for r in both],
    }
