"""A film of the best and the worst of ten clones of four recordings."""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import torch
from jaxtyping import UInt8

from drawing import film
from offairl_lite import cloning
from offairl_lite.analysis import films, plots
from offairl_lite.core.policies import Policy
from offairl_lite.core.rollouts import rollout
from rollouts import KEPT
from rollouts.benchmark import EPISODES, SEEDS, shown

FILM = KEPT / "clones_film.mp4"
EVERY = {"HalfCheetah": 3, "Walker2d": 6}
"""How many steps a frame is."""
PICTURES = 40


def record() -> dict[str, Any]:
    """Make the film; return what the ten clones of each robot return."""
    torch.set_num_threads(1)
    panes, returns = {}, {}
    for robot, every in EVERY.items():
        given = shown("4", robot)
        policy = cloning.clone(given, SEEDS, progress=False)
        played = rollout(policy, given.env_id, SEEDS, EPISODES)
        returns[robot] = played.returns.mean(1).tolist()
        *_, best = order = np.argsort(returns[robot])
        for name, seed in (("best", best), ("worst", order[0])):
            ends = f"{returns[robot][seed]:,.0f}"
            panes[f"{robot}, the {name} of ten: {ends}"] = again(
                policy.member(int(seed)), given.env_id, every
            )
    FILM.write_bytes(films.mp4(side_by_side(panes), fps=12))
    return {"returns": returns}


def again(
    policy: Policy, env_id: str, every: int
) -> UInt8[np.ndarray, "T H W 3"]:
    """Return frames of one episode after the other."""
    frames, length = [], every * (PICTURES - 1)
    while sum(map(len, frames)) < PICTURES:
        frames.append(
            films.frames(policy, env_id, len(frames), length, every)
        )
    return np.concatenate(frames)[:PICTURES]


def side_by_side(
    panes: dict[str, np.ndarray],
) -> UInt8[np.ndarray, "T H W 3"]:
    """Return a film of a row of two panes for each robot."""
    with plots.style(), plt.rc_context({"axes.titlesize": 13}):
        fig, axes = plt.subplots(2, 2, figsize=(7.2, 7.6), dpi=100)
        images = {}
        for ax, (title, pane) in zip(axes.flat, panes.items(), strict=True):
            ax.set_title(title.replace(", ", ",\n"))
            ax.axis("off")
            images[title] = ax.imshow(pane[0])

    def draw(k: int) -> None:
        for title, image in images.items():
            image.set_data(panes[title][k])

    return film(fig, draw, PICTURES)
