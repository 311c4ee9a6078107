"""Two short trainings, on the reward inside the discriminator and on its
whole logit: the film of the chapter. And where recorded policies end up.
"""

from contextlib import closing
from pathlib import Path

import numpy as np
import torch

from offairl_lite import demonstrations, experiments
from offairl_lite.core.loop import Trainer
from offairl_lite.core.rollouts import rollout
from offairl_lite.runs import records
from paper_figures import record as folder_of
from rollouts import RECORDS

STEPS, WARMUP, SEED, LEVELS = 2_000, 1_600, 2, (0.5, 0.9, 0.99)
INNER = np.linspace(-0.08, 0.58, 23)
"""Along each side of the maze, the places of its map of the reward."""
SOME = 100
"""Transitions of the warm-up that are kept."""

demo = experiments.find("maze-rewards").configs["demo"]


def record():
    """Return the film's two stories, warm-up steps, and final places."""
    expert = demonstrations.load(demo.env_id, trajectories=50)
    logit, _ = _watched("implementation-2", expert)
    inside, held = _watched("implementation-4", expert)
    index = np.random.default_rng(0).choice(WARMUP, SOME, replace=False)
    return {
        "r": inside,
        "logit": logit,
        "warmup": {
            "obs": held.obs[index],
            "action": held.action[index],
            "next_obs": held.next_obs[index],
        },
        "ends": {
            name: _ends(name)
            for name in (
                "implementation-1",
                "implementation-2",
                "implementation-2-soft",
            )
        },
    }


def _watched(reward, expert):
    """Train for a while; return what there is to see after each block."""
    x, y = np.meshgrid(INNER, INNER)
    places = np.stack([x, y, 0 * x], -1).reshape(1, -1, 3)
    places = torch.tensor(places, dtype=torch.float32)
    config = demo.change(
        reward=reward, total_steps=STEPS, learning_starts=WARMUP
    )
    story = []
    with closing(Trainer(config, [SEED], expert)) as trainer:
        for evaluation in trainer.run():
            if not trainer.started or evaluation:
                continue
            policy = trainer.policy
            held = trainer.collector.replay.held(0)
            obs = policy.normaliser(held.obs[None, :WARMUP])
            u = held.pre_tanh[None, :WARMUP]
            with torch.no_grad():
                surprise = -policy.actor.log_prob(policy.params, obs, u)
            episode = rollout(policy, demo.env_id, [SEED], 1)
            level = trainer.reward(places)[0].view(x.shape).numpy()
            story.append(
                {
                    "updates": trainer.trained,
                    "path": episode.obs[0, 0, ::2, :2]
                    .astype(float)
                    .round(3),
                    "end": episode.obs[0, 0, -1, :2],
                    "return": episode.returns[0, 0],
                    "map": (level - level.max()).astype(float).round(2),
                    "surprise": np.quantile(surprise.numpy(), LEVELS),
                    "q": abs(trainer.metrics["q"].item()),
                }
            )
        return story, held


def _ends(name):
    """Return where an episode of each seed of a recorded run ends."""
    run = records.read(
        RECORDS / Path(folder_of(f"maze-rewards/{name}", "demo"))
    )
    return rollout(run.policy, demo.env_id, run.seeds, 1).obs[:, 0, -1, :2]
