"""Episodes of chapter 10: in the marsh, and of the ant with weak legs.

`record` also makes the chapter's film of the ants, an MP4 beside its JSON.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import torch
from jaxtyping import Float, UInt8

from drawing import film
from offairl_lite import demonstrations, envs
from offairl_lite.analysis import films, plots
from offairl_lite.core.policies import Policy
from offairl_lite.core.rollouts import rollout
from offairl_lite.envs.models import GOAL
from offairl_lite.envs.tasks import in_marsh
from offairl_lite.runs import records

RECORDS = Path(__file__).parents[1] / "records"
FILM = RECORDS / "rollouts/10_where_rewards_fail.mp4"
HOME_TASK = "offairl/PointMarsh-v0"
WEST_TASK = "offairl/PointMarshWest-v0"
LEARNED = "decides-velocity-demo/CustomAnt-released-fixed-short"
TRANSFERRED = "decides-transfer-demo/velocity/scratch"
SECONDS = 0.05  # of a step
STEPS, EVERY = 360, 9

KNOWN = "decides-marsh-demo"
AGAIN = "marsh-transfer-demo"
AT_HOME = (
    f"{KNOWN}/released/implementation-4",
    f"{KNOWN}/released-16/implementation-4",
    f"{KNOWN}/released-50/implementation-4",
    f"{KNOWN}/light-16/implementation-4",
    f"{KNOWN}/released-50/again",
    "marsh-imitation-demo/dac",
    "marsh-imitation-long-demo/implementation-4",
    "marsh-airl-memory-demo/all",
    "marsh-airl-ppo-demo/state",
    f"{AGAIN}/implementation-4/again",
)
FROM_WEST = (
    f"{KNOWN}/released/west",
    f"{KNOWN}/released-16/west",
    f"{KNOWN}/released-50/west",
    f"{AGAIN}/dac/west",
    f"{AGAIN}/true/true-west",
    f"{AGAIN}/implementation-4/west",
)


def record() -> dict[str, Any]:
    """Return how far ants come, and what policies do in the marsh."""
    ants = filmed()
    FILM.write_bytes(films.mp4(ants_side_by_side(ants), fps=7))
    places = {
        **dict.fromkeys(AT_HOME, HOME_TASK),
        **dict.fromkeys(FROM_WEST, WEST_TASK),
    }
    return {
        "film": {name: way for name, (_, way, _) in ants.items()},
        "marsh": {run: in_the_marsh(run, places[run]) for run in places},
        "straight": [straight(HOME_TASK), straight(WEST_TASK)],
        "metres of the experts": metres(
            demonstrations.expert("offairl/DisabledAnt-v0"), (0, 1)
        ),
        "metres of the new policies": metres(
            records.read(RECORDS / TRANSFERRED).policy, range(5)
        ),
    }


# ---- The marsh ----


def in_the_marsh(run: str, task: str) -> dict[str, np.ndarray]:
    """Return of each seed, over ten episodes: the steps in the marsh.

    With them come how far from the goal it ends, and one path of seed 0.
    """
    read = records.read(RECORDS / run)
    obs = rollout(read.policy, task, read.seeds, 10).obs
    left = np.linalg.norm(obs[..., -1, :2] - GOAL, axis=-1)
    path = rollout(read.policy.member(0), task, (0,), 1).obs[0, 0, :, :2]
    return {
        "wet": in_marsh(obs).sum(-1).mean(1),
        "left": left.mean(1),
        "path": path,
    }


def straight(task: str) -> tuple[float, int]:
    """Return the return of a particle steered at the goal, and the steps
    that it takes in the marsh."""
    env = envs.make(task, 1, 0)
    obs, _ = env.reset()
    total, wet, before = 0.0, 0, obs
    for _ in range(100):
        wet += int(in_marsh(obs)[0])
        pull = 30 * (GOAL - obs[:, :2])
        brake = 60 * (obs - before)[:, :2]
        before = obs
        obs, reward, *_ = env.step(np.clip(pull - brake, -1, 1))
        total += float(reward[0])
    return total, wet


# ---- The ants ----

Frames = list[UInt8[np.ndarray, "H W 3"]]
Ants = dict[str, tuple[Frames, np.ndarray, str]]


def filmed() -> Ants:
    """Return frames, metres and the colour of three ants."""
    imitator = records.read(RECORDS / LEARNED).policy.member(0)
    walker = records.read(RECORDS / TRANSFERRED).policy.member(0)
    return {
        "four strong legs:\nan imitator": (
            *episode(imitator, "CustomAnt"),
            plots.BLUE,
        ),
        "two weak legs:\nthe same policy": (
            *episode(imitator, "DisabledAnt"),
            plots.RED,
        ),
        "a new policy for\nthe learned reward": (
            *episode(walker, "DisabledAnt"),
            plots.GREEN,
        ),
    }


def episode(policy: Policy, task: str) -> tuple[Frames, np.ndarray]:
    """Return frames, and how far the torso has come at each, in metres."""
    env = envs.make(f"offairl/{task}-v0", 1, 1, render_mode="rgb_array")
    obs, _ = env.reset()
    frames, way, x = [], [], 0.0
    for step in range(STEPS):
        if step % EVERY == 0:
            frames.append(env.render()[0])
            way.append(x)
        x += obs[0, 13] * SECONDS
        given = torch.tensor(obs, dtype=torch.float32).unsqueeze(1)
        obs, *_ = env.step(policy.act(given).squeeze(1).numpy())
    env.close()
    return frames, np.array(way)


def ants_side_by_side(ants: Ants) -> UInt8[np.ndarray, "T H W 3"]:
    """Return a film of the ants, with the metres that they have come."""
    with plots.style():
        fig = plt.figure(figsize=(7.2, 4.2), dpi=120, layout="constrained")
        above, below = fig.subfigures(2, 1, height_ratios=(3, 1.35))
        moving = [*_scene(above.subplots(1, 3), below.subplots(), ants)]

    def draw(k: int) -> None:
        for i, (image, line, dot, frames, way) in enumerate(moving):
            image.set_data(frames[k])
            line.set_data([0, way[k]], [i, i])
            dot.set_data([way[k]], [i])

    return film(fig, draw, STEPS // EVERY)


def _scene(axes: np.ndarray, lanes: plt.Axes, ants: Ants) -> Iterator:
    lanes.set(xlim=(-0.5, 32), ylim=(2.6, -0.6), yticks=[])
    lanes.set_xlabel("metres from the start")
    lanes.spines["left"].set_visible(False)
    for ax, (name, (frames, way, color)) in zip(
        axes, ants.items(), strict=True
    ):
        ax.set_title(name, color=color, weight="bold", fontsize=11)
        ax.axis("off")
        image = ax.imshow(frames[0])
        (line,) = lanes.plot([], [], color=color, lw=4)
        (dot,) = lanes.plot([], [], "o", color=color, ms=13, mec="white")
        yield image, line, dot, frames, way


def metres(policy: Policy, seeds: range | tuple) -> Float[np.ndarray, "S"]:
    """Return how far ahead each seed comes in an episode of DisabledAnt."""
    obs = rollout(policy, "offairl/DisabledAnt-v0", seeds, 2).obs
    return obs[..., 13].sum(-1).mean(1) * SECONDS
