"""The film of chapter 4, and what its program learns in five seeds."""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import nbformat
import numpy as np
from jaxtyping import UInt8

import plots
from drawing import film
from offairl_lite import demonstrations, plain
from offairl_lite.analysis import films
from offairl_lite.core.rollouts import rollout
from offairl_lite.runs import records
from rollouts import KEPT

FILM = KEPT / "04_sac_and_the_experts.mp4"
PAGE = Path(__file__).parents[1] / "04_sac_and_the_experts.ipynb"
DEFINED = (
    "class Replay:",
    "def pendulum(",
    "def train(",
    "def act(",
    "def td3_target(",
    "class TD3(",
    "def explore(",
    "def returns(",
)
"""What the chapter's program has and `offairl_lite.plain` does not."""
KINDS = ("SAC", "TD3", "SAC, τ = 1")
SEEDS = range(5)
ROBOTS = {"HalfCheetah": 3, "Hopper": 4, "Walker2d": 4, "CustomAnt": 3}
"""How many steps a frame is."""
MAZES = ("PointMazeLeft", "PointMazeRight")


def record() -> dict[str, Any]:
    """Make the film; return each episode's return by learner and seed."""
    FILM.write_bytes(films.mp4(the_experts(), fps=8))
    chapter = program()
    return {
        "curves": {
            kind: [chapter["returns"](kind, seed) for seed in SEEDS]
            for kind in KINDS
        }
    }


def program() -> dict[str, Any]:
    """Return the names that the chapter's own cells make for it."""
    names: dict[str, Any] = {**vars(plain), "STEPS": 5_000}
    exec(IMPORTS, names)
    for cell in nbformat.read(PAGE, as_version=4).cells:
        if cell.cell_type == "code" and any(
            part in cell.source for part in DEFINED
        ):
            exec(cell.source, names)
    return names


IMPORTS = """
from copy import deepcopy
from functools import partial

import gymnasium
import numpy as np
import torch
from gymnasium.wrappers import RescaleAction, RescaleObservation
"""


def the_experts() -> UInt8[np.ndarray, "T H W 3"]:
    """Return a film of the best expert of six tasks."""
    robots, paths, titles = {}, {}, {}
    for task, every in ROBOTS.items():
        policy, env_id, titles[task] = best(task)
        robots[task] = films.frames(
            policy, env_id, max_steps=24 * every, every=every
        )
    for task in MAZES:
        policy, env_id, titles[task] = best(task)
        paths[task] = rollout(policy, env_id, [0], 1).obs.squeeze()
    with plots.style(), plt.rc_context({"font.size": 15}):
        fig, axes = plt.subplots(2, 3, figsize=(9.6, 7.0), dpi=100)
        images, trails = {}, {}
        for ax, task in zip(axes.flat, titles, strict=True):
            if task in robots:
                images[task] = ax.imshow(robots[task][0])
            else:
                plots.maze(ax, task.removeprefix("PointMaze"))
                (line,) = ax.plot([], [], color=plots.BLUE, linewidth=4)
                (dot,) = ax.plot(
                    [], [], "o", color=plots.BLUE, markersize=13
                )
                trails[task] = line, dot
            ax.axis("off")
            ax.set_title(f"{task}: {titles[task]}")

    def draw(i: int) -> None:
        for task, image in images.items():
            image.set_data(robots[task][min(i, len(robots[task]) - 1)])
        for task, (line, dot) in trails.items():
            path = paths[task][: 2 * i + 1, :2]
            line.set_data(*path.T)
            dot.set_data(*path[-1:].T)

    return film(fig, draw, 25)


def best(task: str):
    """Return a task's best expert, its id and its mean return as text."""
    ours = task.startswith(("Point", "Custom"))
    env_id = f"offairl/{task}-v0" if ours else f"{task}-v5"
    noted = records.read_json(demonstrations.EXPERTS / f"{task}.json")
    policy = demonstrations.expert(env_id)
    value = max(noted["returns"])
    digits = ",.0f" if value > 50 else ".1f"
    return (
        policy.member(int(np.argmax(noted["returns"]))),
        env_id,
        f"{value:{digits}}".replace("-", "−"),
    )
