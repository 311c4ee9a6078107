"""Algorithm 1 of the paper: the one training loop.

Act for a block of steps, an episode for instance; update the discriminator once for each step; then
update the learner equally often, on the current reward. With the task's own reward, or a frozen
one, the discriminator update is skipped. PPO uses the same loop, but learns from the latest block
instead of replay.
"""

import operator
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from tqdm.auto import tqdm

from offairl_lite import envs
from offairl_lite.config import Config, Schedule
from offairl_lite.core import absorbing
from offairl_lite.core.acceleration import Execution
from offairl_lite.core.collector import Collector, Members
from offairl_lite.core.evaluation import evaluate
from offairl_lite.core.fitting import fit_discriminator, fit_learner, fit_on_policy
from offairl_lite.core.models import Models, even_normaliser
from offairl_lite.core.networks import Normaliser
from offairl_lite.core.policies import Policy
from offairl_lite.core.ppo import PPO
from offairl_lite.core.replay import Batch, Replay
from offairl_lite.core.requirements import episode_length, require_fit, require_inputs
from offairl_lite.core.results import Row, Run
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rng import Rng
from offairl_lite.demonstrations import Demonstrations


class Trainer:
    """One run: `run` is Algorithm 1; at each yield, `state()` and the replay suffice to resume.

    Args:
        config: what to do.
        seeds: one for each member of the population.
        demonstrations: needed where a reward is learned.
        frozen_reward: needed where `config.reward` is `frozen`: as many members as seeds.
        pretrained_policy: needed where `pretrained` is not `nothing`: as many members as seeds.
        guide: needed where `start_steps` is not 0: as many members as seeds.
        execution: where and how it is computed.
        replay_file: where transitions are kept, if not in memory alone.
        memory: how many steps the replay file can be rewound, to a checkpoint.

    Raises:
        ValueError: an input that `config` needs is missing, or does not fit the task.
    """

    def __init__(
        self,
        config: Config,
        seeds: Sequence[int],
        demonstrations: Demonstrations | None = None,
        frozen_reward: Reward | None = None,
        *,
        pretrained_policy: Policy | None = None,
        guide: Policy | None = None,
        execution: Execution = Execution(),  # noqa: B008
        replay_file: Path | None = None,
        memory: int = 0,
    ) -> None:
        seeds = tuple(map(operator.index, seeds))  # Plain integers, also of an array.
        require_inputs(config, seeds, demonstrations, frozen_reward, pretrained_policy, guide)
        self.config, self.schedule, self.seeds = config, config.schedule, seeds
        self.execution, self.device = execution, torch.device(execution.device)
        torch.set_num_threads(execution.threads)
        self.rng, self.members = Rng(seeds, self.device), Members(seeds)
        env = envs.make(config.env_id, len(seeds), seeds, num_threads=execution.threads)
        self.dims = require_fit(config, env, frozen_reward, pretrained_policy, guide)
        self.horizon = episode_length(config, demonstrations)
        replay = Replay(
            len(seeds),
            self.schedule.replay_size,
            *self.dims,
            self.device,
            file=replay_file,
            slots=replay_slots(config.schedule, memory),
        )
        self.frozen_reward, self.pretrained_policy, guide = (
            given and given.to(self.device) for given in (frozen_reward, pretrained_policy, guide)
        )
        self.demonstrations = None
        if demonstrations is not None:
            known = self.schedule.absorbing != "none"
            batch = demonstrations.transitions
            batch = absorbing.with_absorbing_states(batch) if known else batch
            self.demonstrations = Batch(*(part.to(self.device) for part in batch))
        self.collector = Collector(config, env, replay, self.rng, self.members, guide)
        self.models: Models | None = None
        # Blocks of steps that are still to be trained on; those of the warm-up wait for its end.
        self.blocks_due: list[int] = []
        self.block_start, self.evaluated = 0, 0
        self.metrics: dict[str, Float[Tensor, "S"]] = {}

    def run(self) -> Iterator[list[Row]]:
        """Algorithm 1, from the current state to `total_steps`.

        Each pass first settles what the steps so far have made due, and then acts once: so a run
        that is resumed begins with what its checkpoint still owes.

        Yields:
            After each block of steps an empty list, and after each evaluation a row for each
            member. At these points the state can be kept, see `state`.

        Raises:
            FloatingPointError: every member has diverged.
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
                if self.evaluation_is_due(step):
                    self.evaluated = step
                    yield self.evaluate()
            if step == self.schedule.total_steps:
                return
            # Every member acts once, and replay keeps what happens.
            ended = self.collector.step(None if self.models is None else self.explore)
            if self.block_ends(ended):
                self.blocks_due.append(self.steps - self.block_start)
                self.block_start = self.steps
                if self.models is None:
                    yield []

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
        return at_end and not self.blocks_due and not self.evaluation_is_due(self.steps)

    @property
    def policy(self) -> Policy | None:
        """The policies as they are now; None during the warm-up."""
        return self.models and self.models.policy

    @property
    def reward(self) -> Reward | None:
        """The learned reward as it is now, or the frozen one; None with the task's own."""
        return self.frozen_reward if self.models is None else self.models.reward

    def evaluation_is_due(self, step: int) -> bool:
        """Whether the policies are to be evaluated now."""
        due = step % self.schedule.eval_every == 0 or step == self.schedule.total_steps
        return self.models is not None and due and self.evaluated < step

    def block_ends(self, ended: np.ndarray) -> bool:
        """Whether a block of steps is over; `ended` says which members' episodes just ended.

        Raises:
            ValueError: episodes do not end where a block should.
        """
        if self.horizon > 1 and (ended != (self.steps % self.horizon == 0)).any():
            raise ValueError(
                f"gan-gcl compares whole episodes of one length, {self.horizon} as demonstrated, "
                f"and {self.config.env_id} has ended one elsewhere or not there: choose another "
                "reward"
            )
        if self.schedule.update_every is not None:
            return self.steps - self.block_start == self.schedule.update_every
        if ended.any() and not ended.all():
            why = "members' episodes end at different times, so they have no common end to train at"
            raise ValueError(f"{why}: set update_every (1000, say)")
        return bool(ended.all())

    def explore(self, obs: Float[Tensor, "S O"]) -> Float[Tensor, "S A"]:
        """Return what the policies do when they explore, as `pre_tanh`, always finite."""
        pre_tanh = self.models.explore(obs)
        finite = pre_tanh.isfinite()
        if not finite.all():
            self.members.give_up(~finite.all(-1), self.steps, "actions", self.models.remedy)
            pre_tanh = pre_tanh.where(finite, 0)
        return pre_tanh

    def build(self, normaliser: Normaliser) -> None:
        """Make learner and discriminator."""
        given = self.frozen_reward, self.pretrained_policy
        execution, horizon = self.execution, self.horizon
        self.models = Models(
            self.config, self.dims, self.rng, normaliser, execution, horizon, *given
        )
        self.members.weights = self.models.weights
        if isinstance(self.models.learner, PPO):
            # It learns from its own actions alone.
            self.blocks_due.clear()
            self.block_start = self.steps

    def normaliser(self) -> Normaliser:
        """Return the scaling of observations; a pretrained policy brings its own."""
        if self.pretrained_policy is not None:
            return self.pretrained_policy.normaliser
        if not self.schedule.normalise:
            return Normaliser.identity(len(self.seeds), self.dims[0], self.device)
        seen = [self.collector.replay.held(member).obs for member in range(len(self.seeds))]
        shown = None if self.demonstrations is None else self.demonstrations.obs
        return even_normaliser(seen, shown, self.schedule.absorbing != "none")

    def fit(self, steps: int) -> None:
        """Train on a block: the discriminator as often as it has steps, then the learner.

        `discriminator_updates`, where it is set, is how often the discriminator is trained.
        """
        models, replay, rng = self.models, self.collector.replay, self.rng
        batch_size = self.schedule.batch_size
        log_density = models.log_density(self.steps)
        if models.discriminator is not None:
            updates = self.config.discriminator.updates or steps
            self.metrics |= fit_discriminator(
                models, self.demonstrations, replay, rng, updates, batch_size, log_density
            )
        reward = models.reward_of(log_density)
        if isinstance(models.learner, PPO):
            block = replay.last(steps)
            self.metrics |= fit_on_policy(models, block, rng, batch_size, reward)
        else:
            done = self.trained - steps
            self.metrics |= fit_learner(models, replay, rng, steps, batch_size, reward, done)
        for name, diverged in models.not_finite().items():
            # Members that were given up still receive updates, so they are zeroed again.
            lost = diverged | self.members.lost.to(self.device)
            self.members.give_up(lost, self.steps, name, models.remedy)

    def evaluate(self) -> list[Row]:
        """Run `eval_episodes` episodes with each member's mode, the same ones every time."""
        done = self.steps, self.collector.episodes.tolist(), self.metrics
        threads = self.execution.threads
        return evaluate(self.config, self.policy, self.reward, self.members, *done, threads)

    def state(self) -> dict[str, Tensor]:
        """Return all that the future depends on but the rows of the replay and `diverged`."""
        tensors = {
            "counts": torch.tensor([self.steps, self.block_start, self.evaluated]),
            "blocks_due": torch.tensor(self.blocks_due, dtype=torch.long),
            "rng": self.rng.state,
            **{f"collector.{name}": x for name, x in self.collector.state().items()},
            **{f"metrics.{name}": value for name, value in self.metrics.items()},
        }
        if self.models is not None:
            tensors |= {**self.models.normaliser._asdict(), **self.models.weights()}
        return tensors

    def restore(self, state: dict[str, Tensor]) -> None:
        """Restore a state of the same run; its replay file must be this trainer's.

        Raises:
            ValueError: the state is of something else.
        """
        try:
            if "mean" in state:
                self.build(Normaliser(*(state[x].to(self.device) for x in ("mean", "std"))))
                for name, tensor in self.models.weights().items():
                    tensor.copy_(state[name])
            steps, self.block_start, self.evaluated = state["counts"].tolist()
            self.blocks_due = state["blocks_due"].tolist()
            self.collector.restore(steps, _under("collector.", state))
            self.rng.state = state["rng"]
            metrics = _under("metrics.", state)
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


def _under(prefix: str, state: dict[str, Tensor]) -> dict[str, Tensor]:
    """Return the part of a state whose names begin with `prefix`."""
    return {name.removeprefix(prefix): x for name, x in state.items() if name.startswith(prefix)}


def complete(
    trainer: Trainer,
    progress: bool = True,
    on_advance: Callable[[list[Row]], None] | None = None,
) -> Run:
    """Run a trainer to completion.

    Args:
        trainer: a new one, or one that was restored.
        progress: whether to show a bar.
        on_advance: called after each piece of work, with the rows of an evaluation if it was one;
            a StopIteration of its own ends the run there.

    Raises:
        FloatingPointError: every member has diverged.
    """
    run = Run(trainer.config, trainer.seeds, diverged=trainer.members.diverged)
    with tqdm(
        total=trainer.config.total_steps, initial=trainer.trained, unit="step", disable=not progress
    ) as bar:
        for rows in trainer.run():
            bar.update(trainer.trained - bar.n)
            if rows:
                run.rows += rows
                bar.set_postfix_str("return " + " ".join(f"{row.mean_return:.4g}" for row in rows))
            if on_advance is not None:
                try:
                    on_advance(rows)
                except StopIteration:
                    break
        bar.update(trainer.steps - bar.n)
    if trainer.finished and not trainer.trained:
        warnings.warn(
            "nothing was trained: no episode was over between step "
            f"{trainer.schedule.warmup_steps}, the end of the warm-up, and step {trainer.steps}; "
            "raise total_steps",
            stacklevel=2,
        )
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
    """Train a population from beginning to end, in memory.

    Args:
        config: what to do.
        seeds: one for each member; the same seeds on the same machine give the same run.
        demonstrations: of the expert, where a reward is to be learned.
        frozen_reward: where `config.reward` is `frozen`.
        pretrained_policy: to start from, where `config.pretrained` says so.
        guide: one that acts at the starts of episodes, where there are `config.start_steps`.
        execution: where and how it is computed.
        progress: whether to show a bar.
        on_evaluation: called after each evaluation with a row for each member, for logging
            (`runs.tensorboard.TensorBoard` is one such); to end early with what is there, it raises
            StopIteration.

    Raises:
        ValueError: something that `config` needs is missing, or does not fit the task.
        FloatingPointError: every member has diverged.
    """

    def advanced(rows: list[Row]) -> None:
        if rows and on_evaluation is not None:
            on_evaluation(rows)

    given = {"pretrained_policy": pretrained_policy, "guide": guide, "execution": execution}
    with closing(Trainer(config, seeds, demonstrations, frozen_reward, **given)) as trainer:
        return complete(trainer, progress, advanced)
