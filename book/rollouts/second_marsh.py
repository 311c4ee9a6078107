"""Does a second film show the marsh, for chapter 12?

One r(s) is learned from chapter 10's marsh and from a second one, with 25
demonstrations each: from the start in the west, or in a wind that blows
east. How much hill and how much marsh is in it, compared with what one
marsh and 50 demonstrations gave chapter 10, with the same loss and steps?

It takes a quarter of an hour. What is trained is kept in
`runs/second_marsh`, and is not trained again: remove the folder to start
afresh.
"""

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch

from offairl_lite import demonstrations, experiments, worlds
from offairl_lite.core import loop
from offairl_lite.core.policies import Policy
from offairl_lite.core.rewards import Reward
from offairl_lite.demonstrations import Demonstrations
from offairl_lite.envs import TASKS, models
from offairl_lite.envs.tasks import in_marsh
from offairl_lite.runs import records
from rollouts import RECORDS, two_mazes
from rollouts.two_mazes import SEEDS

WORK = Path("runs/second_marsh")
MARSH, WEST, WINDY = (
    f"offairl/PointMarsh{name}-v0" for name in ("", "West", "Windy")
)
WIND = 0.3
"""In newtons, to the east; a motor pushes with 1 at most."""
ALONE = "decides-marsh-demo/released/implementation-4"
EXPERTS = "marsh-transfer-demo/true/true-west"


def record() -> dict[str, Any]:
    """Return hill and marsh in the rewards, and how imitators end."""
    two_mazes.make_known(WINDY, TASKS[MARSH], _windy)
    WORK.mkdir(parents=True, exist_ok=True)
    alone = records.read(RECORDS / ALONE)
    result = {"alone": {**fitted(alone.reward), "home": _ends(alone)}}
    for name, second in (("west", WEST), ("wind", WINDY)):
        reward, ends = learned(name, second)
        result[name] = {**fitted(reward), **ends}
    return result


def _windy() -> mujoco.MjModel:
    model = models.particle(models.START, None)
    model.opt.gravity[0] = WIND / model.body("particle").mass[0]
    return model


def learned(name: str, second: str) -> tuple[Reward, dict[str, list]]:
    """Return a reward from both marshes, and the imitators' returns."""
    file = WORK / f"{name}.safetensors"
    ends = file.with_suffix(".json")
    if not ends.is_file():
        config = records.read(RECORDS / ALONE).config
        shown = [demonstrations.load(MARSH, 25), shown_in(second)]
        runs = worlds.train(config, SEEDS, shown, progress=False)
        assert runs[0].reward is not None
        runs[0].reward.save(file)
        last = dict(zip(("home", "second"), map(_ends, runs), strict=True))
        ends.write_text(json.dumps(last), "utf-8")
    return Reward.load(file), json.loads(ends.read_text("utf-8"))


def _ends(run: Any) -> list[float]:
    return run.returns[:, -1].tolist()


def shown_in(second: str) -> Demonstrations:
    """Return 25 demonstrations of a second marsh."""
    if second == WEST:
        policy = records.read(RECORDS / EXPERTS).policy
    else:
        policy = windy_expert()
    episodes = demonstrations.record(policy, second, 25)
    return demonstrations.of(episodes, second)


def windy_expert() -> Policy:
    """Return five experts of the windy marsh."""
    file = WORK / "windy-expert.safetensors"
    if not file.is_file():
        config = experiments.configure("marsh-expert", "demo")
        config = config.change(env_id=WINDY)
        run = loop.train(config, SEEDS, progress=False)
        assert run.policy is not None
        run.policy.save(file)
    return Policy.load(file)


def fitted(reward: Reward) -> dict[str, list[float]]:
    """Return chapter 10's b, c and fit, scaled, of each member."""
    side = np.linspace(-0.08, 0.58, 45)
    x, y = np.meshgrid(side, side)
    places = np.stack([x, y, 0 * x], -1).reshape(-1, 3)
    distance = np.linalg.norm(places[:, :2] - models.GOAL, axis=1)
    parts = [np.ones_like(distance), -distance, -1.0 * in_marsh(places)]
    obs = torch.as_tensor(places, dtype=torch.float32)
    with torch.no_grad():
        r = reward(obs.expand(len(reward), -1, -1)).double().numpy()
    r = (r - r.mean(1, keepdims=True)) / r.std(1, keepdims=True)
    of_parts = np.linalg.lstsq(np.stack(parts, 1), r.T, rcond=None)[0]
    rest = r.T - np.stack(parts, 1) @ of_parts
    return {
        "b": of_parts[1].tolist(),
        "c": of_parts[2].tolist(),
        "fit": (1 - rest.var(0)).tolist(),
    }
