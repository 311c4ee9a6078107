"""Which part of log π spoils the maze: its tail, or the loop it closes?

The agent is paid f - log π, as in chapter 6, with one fault removed.
`clipped` cuts the tail and keeps the loop: an improbable action is paid at
most `MOST`. `another's` opens the loop and keeps the tail: log π is that of
another agent with the same seed, which is paid f alone and does not hear of
this one. At last, whether the reward of state-only DAC leads new agents to
the goal when the wall has moved.
"""

from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import replace
from functools import partial
from typing import Any

import torch
from torch import Tensor

from offairl_lite import demonstrations, experiments
from offairl_lite.config import Config
from offairl_lite.core.experience import Experience
from offairl_lite.core.loop import Trainer, complete
from offairl_lite.core.replay import Batch, LogDensity

SEEDS = tuple(range(5))
MOST = 5.0
"""In nats. Uniform actions of two motors are paid 1.4."""

Change = Callable[["Paid", LogDensity], LogDensity]


class Paid(Trainer):
    """A run whose learner may be paid with another log π than its own."""

    change: Change

    def experience(self) -> Experience:
        """Return what a block is trained on; the logit keeps its log π."""
        experience = super().experience()
        self.paid_log_pi = self.change(self, experience.log_density)
        reward = partial(self.paid, self.paid_log_pi)
        return replace(experience, reward=reward)


def own(run: Paid, log_pi: LogDensity) -> LogDensity:
    """Change nothing."""
    return log_pi


def clipped(run: Paid, log_pi: LogDensity) -> LogDensity:
    """Cut off the tail."""
    return lambda batch: log_pi(batch).clamp(min=-MOST)


def anothers(
    actors: Mapping[int, Tensor], run: Paid, log_pi: LogDensity
) -> LogDensity:
    """Open the loop: take the actor of a run that has gone as far."""
    params = actors[max(step for step in actors if step <= run.trained)]

    def log_prob(batch: Batch) -> Tensor:
        return run.learner.log_prob(params, batch.obs, batch.pre_tanh)

    return log_prob


def train(config: Config, change: Change) -> tuple[dict[str, Any], Any]:
    """Train a population; return what became of it, and its actors.

    `tail` is the paid log π below which one in a hundred of the replay's
    actions lies, and `q` the size of the critics at the last update.
    """
    shown = demonstrations.load(config.env_id, trajectories=50)
    trainer, actors = Paid(config, SEEDS, shown), {}
    trainer.change = change

    def keep(rows: list[Any]) -> None:
        actors[trainer.trained] = trainer.learner.actor_params.clone()

    with closing(trainer):
        run = complete(trainer, progress=False, on_advance=keep)
        experience = trainer.experience()
        batch = experience.replay.sample(trainer.rng, 5_000)
        log_pi = trainer.paid_log_pi(experience.scaled(batch))
    kept = {
        "returns": run.returns,
        "q": trainer.metrics["q"].abs(),
        "tail": log_pi.quantile(0.01, dim=1),
    }
    return kept, actors


class Frozen(Trainer):
    """A run that is paid by an earlier run's discriminator."""

    earlier: Trainer

    def start(self) -> None:
        """End the warm-up, and take over what observations mean to it."""
        super().start()
        assert self.discriminator is not None
        for name, tensor in self.earlier.discriminator.state.items():
            self.discriminator.state[name].copy_(tensor)
        pairs = zip(self.normaliser, self.earlier.normaliser, strict=True)
        for part, fixed in pairs:
            part.copy_(fixed)

    def train_on_block(self, steps: int) -> None:
        """Update the learner alone."""
        experience, done = self.experience(), self.trained - steps
        for minibatch in self.learner.minibatches(experience, steps, done):
            self.metrics |= self.update_learner(*minibatch)


def state_only_dac() -> dict[str, Any]:
    """Imitate on PointMazeLeft, and train anew on PointMazeRight."""
    here = experiments.configure("maze-rewards/dac", "demo")
    here = here.change(ablation="state-pairs")
    there = experiments.configure("maze-transfer", "demo")
    moved = here.change(
        env_id=there.env_id, total_steps=there.schedule.total_steps
    )
    shown = demonstrations.load(here.env_id, trajectories=50)
    # Its settings ask for demonstrations, which it does not learn from.
    elsewhere = demonstrations.load(moved.env_id, trajectories=50)
    with (
        closing(Trainer(here, SEEDS, shown)) as earlier,
        closing(Frozen(moved, SEEDS, elsewhere)) as later,
    ):
        imitation = complete(earlier, progress=False)
        later.earlier = earlier
        transfer = complete(later, progress=False)
    return {"imitation": imitation.returns, "transfer": transfer.returns}


def record() -> dict[str, Any]:
    """Return what became of all runs, five seeds each."""
    torch.set_num_threads(1)
    alone = {}
    for n in (1, 2):
        name = f"implementation-{n}"
        logit, inside = (
            experiments.configure(f"maze-rewards/{name}{form}", "demo")
            for form in ("", "-learned")
        )
        _, actors = train(inside, own)
        alone[f"{name}-clipped"], _ = train(logit, clipped)
        alone[f"{name}-another's"], _ = train(
            logit, partial(anothers, actors)
        )
    return {"alone": alone, "state-only DAC": state_only_dac()}
