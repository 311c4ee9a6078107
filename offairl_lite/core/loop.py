"""Algorithm 1 of the paper: the one training loop, for a population of seeds.

Act for a block of steps, an episode for instance; update the discriminator once for each step; then
update the learner equally often, on the current reward. PPO learns from the latest block alone.
"""

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from tqdm.auto import tqdm

from offairl_lite import envs
from offairl_lite.config import Config, DiscriminatorConfig
from offairl_lite.config.settings import Natural, checked
from offairl_lite.core import absorbing
from offairl_lite.core.acceleration import Execution
from offairl_lite.core.collector import Collector, Members, part_of
from offairl_lite.core.discriminator import make_discriminator
from offairl_lite.core.experience import Experience, scaling_of
from offairl_lite.core.learner import adopt, log_density, make_learner
from offairl_lite.core.networks import Normaliser
from offairl_lite.core.policies import Policy
from offairl_lite.core.replay import Batch, LogDensity, Replay, replay_slots
from offairl_lite.core.requirements import Inputs, require_inputs, require_match
from offairl_lite.core.results import Row, Run, learned_returns
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rng import Rng
from offairl_lite.core.rollouts import rollout
from offairl_lite.core.shapes import Layout, Metrics, Vector
from offairl_lite.demonstrations import Demonstrations


class Stop(Exception):
    """Raised by a callback: the run ends here, with what is there."""


class Trainer:
    """One run: `run` is Algorithm 1; at each yield, `state()` and the replay suffice to resume.

    Transitions are kept in `replay_file`, if any, and can be rewound by `memory` steps. For all
    other arguments see `train`. ValueError: something is missing, or does not fit the task.
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
        pretrained_reward: Reward | None = None,
        replay_file: Path | None = None,
        memory: int = 0,
    ) -> None:
        self.seeds: tuple[int, ...] = checked(
            "seeds", tuple(np.atleast_1d(seeds).tolist()), tuple[Natural, ...]
        )
        inputs = Inputs(demonstrations, frozen_reward, pretrained_policy, pretrained_reward, guide)
        require_inputs(config, self.seeds, inputs)
        self.config, self.schedule, self.execution = config, config.schedule, execution
        self.device, population = torch.device(execution.device), len(self.seeds)
        torch.set_num_threads(execution.threads)
        env = envs.make(config.env_id, population, self.seeds, num_threads=execution.threads)
        with ExitStack() as undo:
            undo.callback(env.close)
            self.dims = require_match(config, env, inputs)
            undo.pop_all()
        self.frozen_reward = frozen_reward and frozen_reward.to(self.device)
        self.pretrained_policy = pretrained_policy and pretrained_policy.to(self.device)
        self.demonstrations: Batch | None = None
        if demonstrations is not None:
            batch = demonstrations.transitions
            if self.schedule.absorbing != "none":
                batch = absorbing.with_absorbing_states(batch)
            self.demonstrations = Batch(*(part.to(self.device) for part in batch))
        self.rng = Rng(self.seeds, self.device)
        self.normaliser = Normaliser.identity(population, self.dims[0], self.device)
        # Weights are zeros until the end of the warm-up, when `start` draws them.
        layout = Layout(population, *self.dims, self.device, self.schedule.absorbing != "none")
        self.learner = make_learner(config, layout)
        self.update_learner = execution.accelerate(self.learner.update, config.learner.hidden)
        self.discriminator = None
        if isinstance(config.discriminator, DiscriminatorConfig):
            self.discriminator = make_discriminator(config.discriminator, layout)
            self.update_discriminator = execution.accelerate(
                self.discriminator.update,
                config.discriminator.reward_hidden + config.discriminator.shaping_hidden,
            )
        self.members = Members(self.seeds, self.weights())
        size, slots = self.schedule.replay_size, replay_slots(self.schedule, memory)
        replay = Replay(population, size, *self.dims, self.device, file=replay_file, slots=slots)
        guide = guide and guide.to(self.device)
        self.collector = Collector(config, env, replay, self.rng, self.members, guide)
        self.kept_reward, self.started = pretrained_reward, False
        # Lengths of the blocks of steps not yet trained on. Those of the warm-up wait for its end.
        self.blocks_due: list[int] = []
        self.block_start, self.evaluated = 0, 0
        self.metrics: Metrics = {}

    def run(self) -> Iterator[list[Row]]:
        """Run Algorithm 1 to `total_steps`; a resumed run begins with what its checkpoint owes.

        Yields:
            An empty list after each block of steps; after each evaluation a row for each member.

        Raises:
            FloatingPointError: all members have diverged.
        """
        while True:
            if self.steps == self.schedule.learning_starts and not self.started:
                self.start()
            while self.started and self.blocks_due:
                self.train_on_block(self.blocks_due.pop(0))
                yield []
            if self.evaluation_is_due:
                self.evaluated = self.steps
                yield self.evaluate()
            if self.steps == self.schedule.total_steps:
                return
            ended = self.collector.step(self.explore if self.started else None)
            if self.block_ends(ended):
                self.blocks_due.append(self.steps - self.block_start)
                self.block_start = self.steps
                if not self.started:
                    yield []

    def train_on_block(self, steps: int) -> None:
        """Update the discriminator, and then the learner, once for each step of a block."""
        experience = self.experience()
        for expert, policy, mixing in experience.discriminator_minibatches(steps):
            self.metrics |= self.update_discriminator(expert, policy, mixing)
        for minibatch in self.learner.minibatches(experience, steps, self.trained - steps):
            self.metrics |= self.update_learner(*minibatch)
        self.members.give_up_not_finite(self.steps)

    def experience(self) -> Experience:
        """Return what a block of steps is trained on."""
        log_pi = log_density(self.config, self.learner, self.steps)
        reward = partial(self.paid, log_pi)
        replay, shown, rng = self.collector.replay, self.demonstrations, self.rng
        return Experience(
            self.config, replay, shown, self.normaliser, rng, self.discriminator, log_pi, reward
        )

    def paid(self, log_pi: LogDensity, batch: Batch, scaled: Batch) -> Vector:
        """Return the pay for transitions, given as in replay and as networks see them."""
        if self.discriminator is not None:
            return self.discriminator.reward(scaled, log_pi)
        if self.frozen_reward is not None:  # It has a scaling of its own.
            return self.frozen_reward(batch.obs, batch.action)
        return batch.reward

    def start(self) -> None:
        """End the warm-up: fix the scaling of observations and draw all weights, in place."""
        policy, replay, shown = self.pretrained_policy, self.collector.replay, self.demonstrations
        earlier = policy or self.kept_reward  # It keeps its own scaling.
        scaling = earlier.normaliser if earlier else scaling_of(self.config, replay, shown)
        for part, fixed in zip(self.normaliser, scaling, strict=True):
            part.copy_(fixed)
        self.learner.init(self.rng)
        if policy is not None:
            adopt(self.learner, policy, self.config.pretrained == "primitives")
        if self.discriminator is not None:
            self.discriminator.init(self.rng, self.kept_reward)
        if self.config.learner.on_policy:
            # It learns from its own actions alone.
            self.blocks_due.clear()
            self.block_start = self.steps
        self.started = True

    @torch.no_grad()
    def explore(self, obs: Float[Tensor, "S O"]) -> Float[Tensor, "S A"]:
        """Return what the policies do when they explore, as `pre_tanh`."""
        noise = self.rng.normal(1, self.dims[1])
        scaled = self.normaliser(obs.unsqueeze(1))
        return self.learner.actor.explore(self.learner.actor_params, scaled, noise).squeeze(1)

    def evaluate(self) -> list[Row]:
        """Run `eval_episodes` episodes with each member's mode, the same ones every time."""
        policy, reward, left = self.policy, self.reward, self.members.left
        assert policy is not None  # The warm-up is over.
        seeds, threads = [self.seeds[i] for i in left], self.execution.threads
        episodes, env_id = self.schedule.eval_episodes, self.config.env_id
        played = rollout(policy.member(*left), env_id, seeds, episodes, num_threads=threads)
        learned = learned_returns(played, reward and reward.member(*left))
        return [
            Row(
                self.seeds[i],
                self.steps,
                int(self.collector.episodes[i]),
                float(returns.mean()),
                tuple(map(float, returns)),
                float(paid.mean()),
                {name: float(value[i]) for name, value in self.metrics.items()},
            )
            for i, returns, paid in zip(left, played.returns, learned, strict=True)
        ]

    @property
    def evaluation_is_due(self) -> bool:
        """Whether the policies are to be evaluated now."""
        at_end = self.steps == self.schedule.total_steps
        due = at_end or self.steps % self.schedule.eval_every == 0
        return self.started and due and self.evaluated < self.steps

    def block_ends(self, ended: Bool[np.ndarray, "S"]) -> bool:
        """Return whether a block of steps is over; `ended`: whose episodes just ended."""
        if self.schedule.train_every is not None:
            return self.steps - self.block_start == self.schedule.train_every
        if ended.any() and not ended.all():
            raise ValueError("members' episodes end at different times: set train_every=1000, say")
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
        """The policies as they are now, which later updates do not change; None in the warm-up."""
        if not self.started:
            return None
        params = self.learner.actor_params.detach().clone()
        return Policy(self.config.env_id, self.learner.actor, params, self.normaliser)

    @property
    def reward(self) -> Reward | None:
        """The learned reward as it is now, or the frozen one; None with the task's own."""
        if self.discriminator is None or not self.started:
            return self.frozen_reward
        return self.discriminator.snapshot(self.config.env_id, self.normaliser)

    def weights(self) -> dict[str, Tensor]:
        """Return the tensors that training changes: themselves, not copies."""
        parts = {"learner": self.learner.state}
        if self.discriminator is not None:
            parts["discriminator"] = self.discriminator.state
        return {f"{part}.{name}": x for part, state in parts.items() for name, x in state.items()}

    def state(self) -> dict[str, Tensor]:
        """Return all that the future depends on but the rows of the replay and `diverged`."""
        counts = self.steps, self.block_start, self.evaluated, self.started
        return {
            "counts": torch.tensor(counts, dtype=torch.long),
            "blocks_due": torch.tensor(self.blocks_due, dtype=torch.long),
            "rng": self.rng.state,
            **{f"collector.{name}": x for name, x in self.collector.state().items()},
            **{f"metrics.{name}": x for name, x in self.metrics.items()},
            **{f"normaliser.{name}": x for name, x in self.normaliser._asdict().items()},
            **self.weights(),
        }

    def restore(self, state: dict[str, Tensor]) -> None:
        """Restore a state, to which the replay file belongs; ValueError if it is of another run."""
        try:
            for name, part in self.normaliser._asdict().items():
                part.copy_(state[f"normaliser.{name}"])
            for name, tensor in self.weights().items():
                tensor.copy_(state[name])
            steps, self.block_start, self.evaluated, started = state["counts"].tolist()
            self.started = bool(started)
            self.blocks_due = state["blocks_due"].tolist()
            self.collector.restore(steps, part_of(state, "collector"))
            self.rng.state = state["rng"]
            self.metrics = {n: x.to(self.device) for n, x in part_of(state, "metrics").items()}
        except (KeyError, RuntimeError, ValueError) as error:
            raise ValueError(f"not a state of this run: {error}") from error

    def close(self) -> None:
        """Close the environments; the trainer cannot be used afterwards."""
        self.collector.env.close()


def complete(
    trainer: Trainer,
    progress: bool = True,
    on_advance: Callable[[list[Row]], None] = lambda rows: None,
) -> Run:
    """Take a trainer to its end. `on_advance` gets each block's rows; it may raise `Stop`."""
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
            except Stop:
                break
        bar.update(trainer.steps - bar.n)
    if trainer.finished and not trainer.trained:
        start, end = trainer.schedule.learning_starts, trainer.steps
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
    pretrained_reward: Reward | None = None,
    guide: Policy | None = None,
    execution: Execution = Execution(),  # noqa: B008
    progress: bool = True,
    on_evaluation: Callable[[list[Row]], None] | None = None,
) -> Run:
    """Train a population from beginning to end, in memory.

    The same seeds give the same run on the same machine. PyTorch's threads are those of `execution`
    until the end.

    Args:
        config: what the run is.
        seeds: one for each member.
        demonstrations: of its task, where a reward is learned.
        frozen_reward: what pays, where `config.reward` is frozen.
        pretrained_policy: what actors begin with, where `config.pretrained` says so.
        pretrained_reward: what the learned reward begins with, if that is an earlier one.
        guide: who acts at the start of episodes, where there are `guide_steps`.
        execution: where, and how, it is computed.
        progress: whether a bar is shown.
        on_evaluation: is called after each evaluation with a row for each member, for logging; to
            end early with what is there, it raises `Stop`.
    """

    def on_advance(rows: list[Row]) -> None:
        if rows and on_evaluation is not None:
            on_evaluation(rows)

    with ExitStack() as afterwards:
        afterwards.callback(torch.set_num_threads, torch.get_num_threads())
        trainer = Trainer(
            config,
            seeds,
            demonstrations,
            frozen_reward,
            pretrained_policy,
            guide,
            execution,
            pretrained_reward=pretrained_reward,
        )
        afterwards.callback(trainer.close)
        return complete(trainer, progress, on_advance)
