"""How long a run would take on this machine."""

import time
from collections.abc import Iterator
from contextlib import closing

import torch

from offairl_lite import envs
from offairl_lite.config import Config
from offairl_lite.core.loop import Trainer
from offairl_lite.core.replay import Batch
from offairl_lite.core.rng import Rng
from offairl_lite.demonstrations import Demonstrations


def random_demonstrations(env_id: str, rows: int = 1000) -> Demonstrations:
    """Return one trajectory of random numbers, of the same sizes as the task's."""
    env, rng = envs.make(env_id, 1, 0), Rng([0])
    obs_dim, action_dim = env.single_observation_space.shape[0], env.single_action_space.shape[0]
    parts = (rng.normal(rows, width)[0] for width in (obs_dim, action_dim, obs_dim))
    zero = torch.zeros(rows)
    return Demonstrations(env_id, Batch(*parts, reward=zero, terminated=zero), (rows,))


def trained_blocks(trainer: Trainer) -> Iterator[None]:
    """Run a trainer and yield each time that it has trained on a block of steps."""
    trained = trainer.trained
    for _ in trainer.run():
        if trainer.trained > trained:
            trained = trainer.trained
            yield


def estimate(config: Config, members: int) -> float:
    """Return roughly how many seconds a run takes here, in one process on one core, not compiled.

    We time one block of training and one episode of evaluation, on random demonstrations where a
    reward is learned. A policy that survives longer than the untrained one takes longer to
    evaluate.
    """
    schedule = config.schedule
    every = schedule.update_every if config.learner.kind == "ppo" else 20
    changes = {
        "start_steps": 0,
        "warmup_steps": every,
        "update_every": every,
        "total_steps": 10**9,
        "eval_every": 10**9,
        "eval_episodes": 1,
        "replay_size": max(10_000, every),
    }
    if config.reward == "frozen":
        changes |= {"reward": "environment", "absorbing": "none"}
    if config.pretrained != "nothing":
        changes["pretrained"] = "nothing"
    short = config.change(**changes)
    with closing(Trainer(short, range(members), random_demonstrations(config.env_id))) as trainer:
        blocks = trained_blocks(trainer)
        next(blocks)  # the warm-up's
        start = time.perf_counter()
        next(blocks)
        trained = time.perf_counter()
        trainer.evaluate()
        evaluated = time.perf_counter()
    evaluation = (evaluated - trained) * schedule.eval_episodes
    per_step = (trained - start) / every + evaluation / schedule.eval_every
    return schedule.total_steps * per_step
