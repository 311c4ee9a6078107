"""Why the exact logit fails on two robots: remove one cause at a time.

All runs are the benchmark's recipe on fifty demonstrations of the strongest
expert, with five seeds and 50,000 steps, but for the discriminator's logit.
`log-ratio` is the recipe, `exact` is AIRL's f - log π, and each other run
is `exact` with one change. A run takes five to fifteen minutes of a core.
What is done is kept in a temporary folder, so that an interrupted recording
goes on where it was. With EXACT_LOGIT="Walker2d/exact;Walker2d/clip -10"
only these are trained, and the others are left as they are recorded.
"""

import json
import math
import os
import tempfile
from collections.abc import Callable
from contextlib import closing
from copy import copy
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from offairl_lite import demonstrations, experiments
from offairl_lite.config import Config
from offairl_lite.core.acceleration import Execution
from offairl_lite.core.experience import Experience
from offairl_lite.core.loop import Trainer, complete
from offairl_lite.core.policies import defensive_log_density
from offairl_lite.core.replay import Batch
from offairl_lite.runs.records import read_json, write_json
from rollouts import KEPT

ROBOTS = ("HalfCheetah", "Walker2d")
SEEDS = tuple(range(5))
ACTOR_EVERY = 2_000
"""Steps between the actors whose mean is the density of the replay."""

Change = Callable[["Changed", Experience], Experience]


class Changed(Trainer):
    """A run whose discriminator sees other data, or another log π."""

    change: Change

    def train_on_block(self, steps: int) -> None:
        """Update the discriminator, and then the learner."""
        experience = self.experience()
        changed = self.change(self, experience)
        for minibatch in changed.discriminator_minibatches(steps):
            self.metrics |= self.update_discriminator(*minibatch)
        done = self.trained - steps
        for minibatch in self.learner.minibatches(experience, steps, done):
            self.metrics |= self.update_learner(*minibatch)
        self.members.give_up_not_finite(self.steps)


def nothing(run: Changed, experience: Experience) -> Experience:
    """Change nothing."""
    return experience


def clip(least: float, run: Changed, experience: Experience) -> Experience:
    """Cut off the tail: log π is never below `least`."""
    log_pi = experience.log_density
    return replace(
        experience, log_density=lambda batch: log_pi(batch).clamp(min=least)
    )


def last(steps: int, run: Changed, experience: Experience) -> Experience:
    """Draw the discriminator's negatives from the last steps alone."""
    recent = copy(experience.replay)
    recent.capacity = min(recent.capacity, steps)
    return replace(experience, replay=recent)


def density(
    actors: list[Tensor], run: Changed, experience: Experience
) -> Experience:
    """Put in place of log π what the replay's actions were drawn from.

    That is the mean of the actors until now, and of the warm-up's uniform
    actions.
    """
    if run.steps >= ACTOR_EVERY * len(actors):
        actors.append(run.learner.actor_params.detach().clone())
    uniform = run.schedule.learning_starts / run.steps

    def log_mu(batch: Batch) -> Tensor:
        of_each = [
            run.learner.log_prob(params, batch.obs, batch.pre_tanh)
            for params in actors
        ]
        mean = torch.stack(of_each).logsumexp(0) - math.log(len(actors))
        return defensive_log_density(mean, uniform, run.dims[1])

    return replace(experience, log_density=log_mu)


def cases(robot: str) -> dict[str, tuple[Config, Change]]:
    """Return a robot's runs, by the name under which they are kept."""
    recipe = experiments.configure(f"benchmark/{robot}-airl", "demo")
    recipe = recipe.change(total_steps=50_000)
    exact = recipe.change(loss="airl")
    return {
        "log-ratio": (recipe, nothing),
        "exact": (exact, nothing),
        **{
            f"penalty {weight:g}": (
                exact.change(gradient_penalty=weight),
                nothing,
            )
            for weight in (1, 0.1, 0)
        },
        **{
            f"clip {least}": (exact, partial(clip, least))
            for least in (-10, -20)
        },
        **{
            f"last {steps:,}": (exact, partial(last, steps))
            for steps in (1_000, 10_000)
        },
        "density of the replay": (exact, partial(density, [])),
        "temperature 1.2": (exact.change(temperature=1.2), nothing),
        **{
            f"temperature 1.2, penalty {weight:g}": (
                exact.change(temperature=1.2, gradient_penalty=weight),
                nothing,
            )
            for weight in (0.1, 0)
        },
    }


def run(robot: str, name: str) -> dict[str, Any]:
    """Train one population; return its curve and how it ended.

    `spread` is the standard deviation of r over the replay, and `tail` the
    log π below which one in a hundred of the replay's actions lies.
    """
    config, change = cases(robot)[name]
    shown = demonstrations.load(config.env_id, 50, experts="best")
    execution = Execution(compile=config.total_steps >= 50_000)
    trainer = Changed(config, SEEDS, shown, execution=execution)
    trainer.change = change
    with closing(trainer):
        result = complete(trainer, progress=False)
        experience = trainer.experience()
        batch = experience.replay.sample(trainer.rng, 5_000)
        log_pi = experience.log_density(experience.scaled(batch))
        spread = experience.paid(batch).reward.std(1)
    return {
        "steps": result.steps.tolist(),
        "returns": result.returns.tolist(),
        "spread": spread.tolist(),
        "tail": log_pi.quantile(0.01, dim=1).tolist(),
        "accuracy": trainer.metrics["accuracy"].tolist(),
    }


def record() -> dict[str, Any]:
    """Return what became of every run."""
    torch.set_num_threads(1)
    folder = Path(tempfile.gettempdir()) / "offairl-exact-logit"
    folder.mkdir(exist_ok=True)
    wanted = os.environ.get("EXACT_LOGIT", "").split(";")
    there = json.loads((KEPT / "exact_logit.json").read_text("utf-8"))
    found: dict[str, Any] = {}
    for robot in ROBOTS:
        found[robot] = {}
        for name in cases(robot):
            place = f"{robot}/{name}"
            path = folder / f"{place.replace('/', ', ')}.json"
            if wanted == [""] or place in wanted:
                if not path.is_file():
                    write_json(path, run(robot, name))
                    print(f"{place}: done", flush=True)
                found[robot][name] = read_json(path)
            elif name in there[robot]:
                found[robot][name] = there[robot][name]
    return found
