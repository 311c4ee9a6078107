"""The film of chapter 11: four robots, each the median of five seeds."""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import UInt8

from drawing import film
from offairl_lite.analysis import films, plots
from paper_verdicts import recorded

FILM = Path(__file__).parents[1] / "records/rollouts/11_results.mp4"
EVERY = {"Hopper": 12, "Walker2d": 12, "HalfCheetah": 2, "CustomAnt": 2}
PICTURES = 33


def record() -> dict[str, Any]:
    """Make the film; return who is in it, and how many frames each has."""
    panes, seeds = {}, {}
    for robot, every in EVERY.items():
        run = recorded(f"locomotion/{robot}-airl", "demo")
        order = np.argsort(run.returns[:, -1])
        seeds[robot] = int(order[len(order) // 2])
        panes[robot] = films.frames(
            run.policy.member(seeds[robot]),
            run.config.env_id,
            max_steps=every * (PICTURES - 1),
            every=every,
        )
    FILM.write_bytes(films.mp4(robots_side_by_side(panes), fps=12))
    frames = {robot: len(pictures) for robot, pictures in panes.items()}
    return {"seeds": seeds, "frames": frames}


def robots_side_by_side(
    panes: dict[str, np.ndarray],
) -> UInt8[np.ndarray, "T H W 3"]:
    """Return a film of some robots; one that falls early stays down."""
    with plots.style():
        fig, axes = plt.subplots(
            1, 4, figsize=(8.4, 2.4), dpi=100, layout="constrained"
        )
        images = {}
        for ax, (robot, pictures) in zip(axes, panes.items(), strict=True):
            ax.set_title(robot)
            ax.axis("off")
            images[robot] = ax.imshow(pictures[0])

    def draw(k: int) -> None:
        for robot, image in images.items():
            image.set_data(panes[robot][min(k, len(panes[robot]) - 1)])

    return film(fig, draw, PICTURES)
