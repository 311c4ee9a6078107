"""Of the note on penalties: what rewards learned under each bound are like.

Slopes and EPIC distances are measured on 200 transitions, half of experts'
and half of a random warm-up; shapes are measured on a grid of places.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor

import other_bounds
from offairl_lite import demonstrations
from offairl_lite.analysis import epic
from offairl_lite.config import Config
from offairl_lite.core.loop import Run, Trainer
from offairl_lite.core.rollouts import rollout
from offairl_lite.envs.models import GOAL
from offairl_lite.runs import records
from paper_figures import record as folder
from rollouts import RECORDS

NAMES = (
    "none",
    "logit",
    "one-sided",
    "probability",
    "spectral",
    "bottleneck",
)
COUNT, WARMUP = 200, 2_000
GRID = 41


def record() -> dict[str, Any]:
    """Return for each bound what its five rewards are like."""
    demo = other_bounds.configure("logit", "demo")
    expert = demonstrations.load(demo.env_id, trajectories=50)
    runs = {
        name: records.read(
            RECORDS / folder(f"maze-penalties/{name}", "demo")
        )
        for name in NAMES
    }
    transitions, samples = draw(demo, expert)
    result: dict[str, Any] = {
        "slope": {},
        "steepest": {},
        "EPIC": {},
        "plane": {},
        "path": {},
    }
    for name, run in runs.items():
        slopes = slopes_of(run, transitions.obs)
        result["slope"][name] = slopes.mean(1)
        result["steepest"][name] = slopes.max()
        functions = [true_reward, *(learned(run, n) for n in range(5))]
        far = epic.distances(
            functions, transitions, samples, demo.learner.discount
        )
        result["EPIC"][name] = far[0, 1:]
        result["plane"][name], result["path"][name] = shapes(
            run, expert.transitions.obs[:, :2].numpy()
        )
    walks = rollout(runs["spectral"].policy, demo.env_id, range(5), 1)
    ends = walks.obs[:, 0, -1, :2]
    result["spectral in the corner"] = (ends > 0.53).all(1)
    return result


def draw(
    demo: Config, expert: demonstrations.Demonstrations
) -> tuple[epic.Transitions, epic.Transitions]:
    """Return transitions, and their parts shuffled for EPIC's means."""
    trainer = Trainer(demo, (0,), expert)
    for _ in range(WARMUP):
        trainer.collector.step(None)
    held, sides = trainer.collector.replay.held(0), []
    rng = np.random.default_rng(0)
    for rows, total in ((expert.transitions, 5_000), (held, WARMUP)):
        index = rng.choice(total, COUNT // 2, replace=False)
        sides.append(
            [rows.obs[index], rows.action[index], rows.next_obs[index]]
        )
    trainer.close()
    transitions = epic.Transitions(
        *(torch.cat(part) for part in zip(*sides, strict=True))
    )
    return transitions, epic.Transitions(
        *(part[rng.permutation(COUNT)] for part in transitions)
    )


def true_reward(obs: Tensor, action: Tensor, next_obs: Tensor) -> Tensor:
    """Return the maze's reward."""
    distance = (obs[:, :2] - torch.tensor(GOAL).float()).norm(dim=-1)
    return -distance - 0.001 * action.square().sum(-1)


def learned(run: Run, seed: int) -> Callable[..., Tensor]:
    """Return the reward that a seed has learned."""
    r = run.reward.member(seed)
    return lambda obs, action, next_obs: r(obs[None], action[None])[0]


def slopes_of(run: Run, obs: Tensor) -> Tensor:
    """Return the slope of each seed's r in the scaled coordinates."""
    r = run.reward
    points = r.normaliser(obs.expand(5, -1, -1))
    _, by_x = r.net.value_and_input_gradient(r.params, points)
    return by_x.norm(dim=-1)


def shapes(run: Run, shown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what a plane explains of r, and how high the experts' way is.

    The height is what the way has more than other places beside a plane
    and a hill around the goal, in standard deviations.
    """
    inner = np.linspace(-0.08, 0.58, GRID)
    x, y = np.meshgrid(inner, inner)
    places = np.stack([x, y, 0 * x], -1).reshape(-1, 3)
    obs = torch.as_tensor(places, dtype=torch.float32).expand(5, -1, -1)
    values = run.reward(obs).numpy().T
    plane = np.column_stack([places[:, :2], np.ones(len(places))])
    rest = values - plane @ np.linalg.lstsq(plane, values)[0]
    explained = 1 - rest.var(0) / values.var(0)

    goal = np.array(GOAL)
    far = np.linalg.norm(places[:, :2] - goal, axis=1)
    shown = shown[np.linalg.norm(shown - goal, axis=1) > 0.15]
    gap = torch.cdist(
        torch.tensor(places[:, :2]), torch.tensor(shown).double()
    )
    way = (gap.amin(1).numpy() < 0.03)[far > 0.15]
    hill = np.column_stack([plane, far])
    values = values / values.std(0)
    rest = values - hill @ np.linalg.lstsq(hill, values)[0]
    rest = rest[far > 0.15]
    return explained, rest[way].mean(0) - rest[~way].mean(0)
