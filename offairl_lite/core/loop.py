"""Algorithm 1 of the paper: the one training loop.

Act for a block of steps, an episode for instance; update the discriminator once for each step; then
update the learner equally often, on the current reward. With the task's own reward, or a frozen
one, the discriminator update is skipped. PPO uses the same loop, but learns from the latest block
instead of replay.
"""

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor
from tqdm.auto import tqdm

from offairl_lite import envs
from offairl_lite.config import Config, Schedule
from offairl_lite.config.settings import Natural, checked
from offairl_lite.core import absorbing
from offairl_lite.core.acceleration import Execution
from offairl_lite.core.collector import Collector, Members, part_of
from offairl_lite.core.evaluation import evaluate
from offairl_lite.core.fitting import fit_discriminator, fit_learner
from offairl_lite.core.models import Models, make_normaliser
from offairl_lite.core.networks import Normaliser
from offairl_lite.core.policies import Policy
from offairl_lite.core.ppo import PPO
from offairl_lite.core.replay import Batch, Replay
from offairl_lite.core.requirements import Inherited, episode_length, require_fit, require_inputs
from offairl_lite.core.results import Row, Run
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rng import Rng
from offairl_lite.core.shapes import Metrics
from offairl_lite.demonstrations import Demonstrations, require_demonstrations


class Trainer:
    """One run: `run` is Algorithm 1; at each yield, `state()` and the replay suffice to resume.

    The same seeds, one for each member, give the same run on the same machine. A `frozen_reward`
    goes with `config.reward`, a `pretrained_policy` with `config.pretrained`, and a `guide`, which
    acts at the starts of episodes, with `start_steps`. Transitions are kept in `replay_file`, if
    not in memory alone, which can be rewound by `memory` steps, to a checkpoint. It is a ValueError
    if something that `config` needs is missing, or does not fit the task.
    """

    def __init__(
        self,
        config: Config,
        seeds: Sequence[int],
        demonstrations: Demonstrations | None = None,
        frozen_reward: Reward | None = None,
        pretrained_policy: Policy | None = None,
        guide: Policy | None = None,
        execution: Execution = Execution(),  # noqa: B008
        *,
        replay_file: Path | None = None,
        memory: int = 0,
    ) -> None:
        self.seeds: tuple[int, ...] = checked(
            "seeds", tuple(np.atleast_1d(seeds).tolist()), tuple[Natural, ...]
        )
        inherited = Inherited(frozen_reward, pretrained_policy, guide)
        require_inputs(config, self.seeds, demonstrations, inherited)
        self.config, self.schedule = config, config.schedule
        self.execution, self.device = execution, torch.device(execution.device)
        torch.set_num_threads(execution.threads)
        env = envs.make(config.env_id, len(self.seeds), self.seeds, num_threads=execution.threads)
        self.dims = require_fit(config, env, inherited)
        if demonstrations is not None:
            require_demonstrations(demonstrations, env)
        self.horizon = episode_length(config, demonstrations)
        self.inherited = inherited.to(self.device)
        self.demonstrations: Batch | None = None
        if demonstrations is not None:
            shown = demonstrations.transitions
            if self.schedule.absorbing != "none":
                shown = absorbing.with_absorbing_states(shown)
            self.demonstrations = Batch(*(part.to(self.device) for part in shown))
        self.rng, self.members = Rng(self.seeds, self.device), Members(self.seeds)
        size, slots = self.schedule.replay_size, replay_slots(self.schedule, memory)
        replay = Replay(
            len(self.seeds), size, *self.dims, self.device, file=replay_file, slots=slots
        )
        guide = self.inherited.guide
        self.collector = Collector(config, env, replay, self.rng, self.members, guide)
        self.models: Models | None = None
        # Blocks of steps that are still to be trained on; those of the warm-up wait for its end.
        self.blocks_due: list[int] = []
        self.block_start, self.evaluated = 0, 0
        self.metrics: Metrics = {}

    def run(self) -> Iterator[list[Row]]:
        """Algorithm 1, from the current state to `total_steps`.

        Each pass first settles what the steps so far have made due, and then acts once: so a run
        that is resumed begins with what its checkpoint still owes. After each block of steps an
        empty list is yielded, and after each evaluation a row for each member: the state can then
        be kept. It is a FloatingPointError if every member has diverged.
        """
        for step in range(self.steps, self.schedule.total_steps + 1):
            # The warm-up's observations fix their scaling.
            if step == self.schedule.warmup_steps and self.models is None:
                self.build(self.normaliser())
            if self.models is not None:
                # As many updates of the discriminator, then of the learner, as the block had steps.
                while self.blocks_due:
                    self.fit(self.blocks_due.pop(0))
                    yield []
                if self.evaluation_is_due:
                    self.evaluated = step
                    yield self.evaluate()
            if step == self.schedule.total_steps:
                return
            # Every member acts once, and replay keeps what happens.
            ended = self.collector.step(self.models.explore if self.models else None)
            if self.block_ends(ended):
                self.blocks_due.append(self.steps - self.block_start)
                self.block_start = self.steps
                if self.models is None:
                    yield []

    def fit(self, steps: int) -> None:
        """Train on a block of so many steps: the discriminator, then the learner on its reward."""
        models, replay = self.models, self.collector.replay
        assert models is not None  # The warm-up is over.
        # For both of them π is what it was before the block.
        log_density = models.log_density(self.steps)
        self.metrics |= fit_discriminator(models, self.demonstrations, replay, steps, log_density)
        given = log_density, self.trained - steps, self.demonstrations
        self.metrics |= fit_learner(models, replay, steps, *given)
        for name, lost in models.not_finite().items():
            self.members.give_up(lost, self.steps, f"{name} is not finite")

    def evaluate(self) -> list[Row]:
        """Run `eval_episodes` episodes with each member's mode, the same ones every time."""
        models, threads = self.models, self.execution.threads
        assert models is not None  # The warm-up is over.
        return evaluate(models.policy, models.reward, self.collector, self.metrics, threads)

    @property
    def evaluation_is_due(self) -> bool:
        """Whether the policies are to be evaluated now."""
        at_end = self.steps == self.schedule.total_steps
        due = at_end or self.steps % self.schedule.eval_every == 0
        return self.models is not None and due and self.evaluated < self.steps

    def block_ends(self, ended: Bool[np.ndarray, "S"]) -> bool:
        """Whether a block of steps is over; `ended` says which members' episodes just ended."""
        if self.horizon > 1 and (ended != (self.steps % self.horizon == 0)).any():
            raise ValueError(
                f"gan-gcl compares whole episodes of one length, {self.horizon} as demonstrated, "
                f"and {self.config.env_id} has ended one elsewhere: choose another reward"
            )
        if self.schedule.update_every is not None:
            return self.steps - self.block_start == self.schedule.update_every
        if ended.any() and not ended.all():
            raise ValueError("members' episodes end at different times: set update_every=1000, say")
        return bool(ended.all())

    @property
    def steps(self) -> int:
        """Environment steps that have been taken."""
        return self.collector.steps

    @property
    def trained(self) -> int:
        """Steps that have been trained on, or are just being trained on."""
        return self.block_start - sum(self.blocks_due)

    @property
    def finished(self) -> bool:
        """Whether all steps, updates and evaluations are done."""
        at_end = self.steps >= self.schedule.total_steps
        return at_end and not self.blocks_due and not self.evaluation_is_due

    @property
    def policy(self) -> Policy | None:
        """The policies as they are now; None during the warm-up."""
        return self.models.policy if self.models else None

    @property
    def reward(self) -> Reward | None:
        """The learned reward as it is now, or the frozen one; None with the task's own."""
        return self.models.reward if self.models else self.inherited.frozen_reward

    def build(self, normaliser: Normaliser) -> None:
        """Make learner and discriminator."""
        given = self.config, self.dims, self.rng, normaliser, self.execution, self.horizon
        self.models = Models(*given, self.inherited)
        self.members.weights = self.models.weights()
        if isinstance(self.models.learner, PPO):
            # It learns from its own actions alone.
            self.blocks_due.clear()
            self.block_start = self.steps

    def normaliser(self) -> Normaliser:
        """Return the scaling of observations; a pretrained policy brings its own."""
        if self.inherited.pretrained_policy is not None:
            return self.inherited.pretrained_policy.normaliser
        return make_normaliser(self.config, self.collector.replay, self.demonstrations)

    def state(self) -> dict[str, Tensor]:
        """Return all that the future depends on but the rows of the replay and `diverged`."""
        tensors = {
            "counts": torch.tensor([self.steps, self.block_start, self.evaluated]),
            "blocks_due": torch.tensor(self.blocks_due, dtype=torch.long),
            "rng": self.rng.state,
            **{f"collector.{name}": x for name, x in self.collector.state().items()},
            **{f"metrics.{name}": x for name, x in self.metrics.items()},
        }
        if self.models is not None:
            tensors |= {**self.models.normaliser._asdict(), **self.models.weights()}
        return tensors

    def restore(self, state: dict[str, Tensor]) -> None:
        """Restore a state of the same run, to which the replay file belongs; else ValueError."""
        try:
            if "mean" in state:
                self.build(Normaliser(*(state[part].to(self.device) for part in ("mean", "std"))))
                for name, tensor in self.members.weights.items():
                    tensor.copy_(state[name])
            steps, self.block_start, self.evaluated = state["counts"].tolist()
            self.blocks_due = state["blocks_due"].tolist()
            self.collector.restore(steps, part_of(state, "collector"))
            self.rng.state = state["rng"]
            metrics = part_of(state, "metrics")
            self.metrics = {name: x.to(self.device) for name, x in metrics.items()}
        except (KeyError, RuntimeError) as error:
            raise ValueError(f"not a state of this run: {error}") from error

    def close(self) -> None:
        """Close the environments; the trainer cannot be used afterwards."""
        self.collector.env.close()


def replay_slots(schedule: Schedule, memory: int) -> int:
    """Return the rows to allocate for a member: `replay_size` and room to rewind."""
    # A terminated episode may add a row of the absorbing state.
    rows = 1 if schedule.absorbing == "none" else 2
    return min(schedule.replay_size + rows * memory, rows * schedule.total_steps)


def complete(
    trainer: Trainer,
    progress: bool = True,
    on_advance: Callable[[list[Row]], None] = lambda rows: None,
) -> Run:
    """Take a trainer, a new one or one that was restored, to its end.

    `on_advance` is called after each block and each evaluation, with the rows of an evaluation if
    it was one; a StopIteration of its own ends the run there.
    """
    run = Run(trainer.config, trainer.seeds, diverged=trainer.members.diverged)
    total, first = trainer.config.total_steps, trainer.trained
    with tqdm(total=total, initial=first, unit="step", disable=not progress) as bar:
        for rows in trainer.run():
            bar.update(trainer.trained - bar.n)
            if rows:
                run.rows += rows
                bar.set_postfix_str("return " + " ".join(f"{row.mean_return:.4g}" for row in rows))
            try:
                on_advance(rows)
            except StopIteration:
                break
        bar.update(trainer.steps - bar.n)
    if trainer.finished and not trainer.trained:
        start, end = trainer.schedule.warmup_steps, trainer.steps
        when = f"between step {start}, the end of the warm-up, and step {end}"
        why = f"nothing was trained: no episode was over {when}; raise total_steps"
        warnings.warn(why, stacklevel=2)
    run.policy, run.reward = trainer.policy, trainer.reward
    return run


def train(
    config: Config,
    seeds: Sequence[int],
    demonstrations: Demonstrations | None = None,
    frozen_reward: Reward | None = None,
    *,
    pretrained_policy: Policy | None = None,
    guide: Policy | None = None,
    execution: Execution = Execution(),  # noqa: B008
    progress: bool = True,
    on_evaluation: Callable[[list[Row]], None] | None = None,
) -> Run:
    """Train a population from beginning to end, in memory. For most arguments see `Trainer`.

    `on_evaluation` is called after each evaluation with a row for each member, for logging; to end
    early with what is there, it raises StopIteration. `progress` shows a bar.
    """

    def on_advance(rows: list[Row]) -> None:
        if rows and on_evaluation is not None:
            on_evaluation(rows)

    given = frozen_reward, pretrained_policy, guide, execution
    with closing(Trainer(config, seeds, demonstrations, *given)) as trainer:
        return complete(trainer, progress, on_advance)
