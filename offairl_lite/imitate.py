"""Algorithm 1 of the paper: the one training loop.

Collect an episode; train the discriminator once for each of its steps; then the generator as
often, on the reward as it now stands. With the task's own reward, or a frozen one, the
discriminator's part falls away and the rest is the same.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from tqdm.auto import tqdm

from offairl_lite import absorbing, envs
from offairl_lite.config import Config
from offairl_lite.demonstrations import Demonstrations
from offairl_lite.discriminators import Discriminator, Reward
from offairl_lite.evaluate import Episodes, rollout
from offairl_lite.networks import Normaliser
from offairl_lite.policies import Policy, unsquash
from offairl_lite.replay import Batch, Replay, unpack
from offairl_lite.rewards import IMPLEMENTATIONS
from offairl_lite.sac import SAC
from offairl_lite.streams import Streams
from offairl_lite.td3 import TD3

CHUNK = 50
"""Minibatches that are gathered, and given log π or rewards, in one pass."""


class Row(NamedTuple):
    """One evaluation of one member."""

    seed: int
    step: int
    episodes: int
    mean_return: float
    returns: tuple[float, ...]
    learned_return: float
    metrics: dict[str, float]


@dataclass
class Run:
    """What came of a run: its curve, and the policies and rewards at its end."""

    config: Config
    seeds: tuple[int, ...]
    rows: list[Row] = field(default_factory=list)
    policy: Policy | None = None
    reward: Reward | None = None

    @property
    def steps(self) -> np.ndarray:
        """Environment steps of the evaluations, `(K,)`."""
        return np.array([row.step for row in self.rows[:: len(self.seeds)]])

    @property
    def returns(self) -> np.ndarray:
        """Mean return of each member at each evaluation, `(S, K)`."""
        return np.array([row.mean_return for row in self.rows]).reshape(-1, len(self.seeds)).T


class Trainer:
    """The state of one run.

    Args:
        config: what to do.
        seeds: one for each member of the population.
        demonstrations: needed where a reward is learned.
        reward: needed where `config.reward` is `frozen`: as many members as seeds.
        device: where networks and replay live.
        num_threads: for the physics.

    Raises:
        ValueError: something that `config` needs is missing, or does not fit the task.
    """

    def __init__(
        self,
        config: Config,
        seeds: Sequence[int],
        demonstrations: Demonstrations | None = None,
        reward: Reward | None = None,
        *,
        device: str | torch.device = "cpu",
        num_threads: int = 1,
    ) -> None:
        self.config, self.seeds, self.num_threads = config, tuple(seeds), num_threads
        self.device, self.frozen_reward = torch.device(device), reward
        if not seeds:
            raise ValueError("no seeds: give one for each member of the population")
        if config.learns_reward and demonstrations is None:
            raise ValueError(f"reward={config.reward!r} is learned from demonstrations: give some")
        if (config.reward == "frozen") != (reward is not None):
            raise ValueError(f"reward={config.reward!r} and a frozen reward go together")
        if reward is not None and len(reward) != len(seeds):
            raise ValueError(f"{len(reward)} frozen rewards for {len(seeds)} seeds")
        if demonstrations is not None and demonstrations.env_id != config.env_id:
            raise ValueError(
                f"demonstrations of {demonstrations.env_id} for a run on {config.env_id}"
            )
        self.streams = Streams(self.seeds, self.device)
        self.env = envs.make(config.env_id, len(seeds), self.seeds, num_threads=num_threads)
        self.env_obs_dim = self.env.single_observation_space.shape[0]
        self.action_dim = self.env.single_action_space.shape[0]
        self.obs_dim = self.env_obs_dim + (config.absorbing != "none")
        if reward is not None and reward.normaliser.mean.shape[-1] != self.obs_dim:
            raise ValueError(
                f"the frozen reward sees {reward.normaliser.mean.shape[-1]} numbers; with "
                f"absorbing={config.absorbing!r}, {config.env_id} gives {self.obs_dim}"
            )
        # A terminated episode may add a row of the absorbing state.
        capacity = min(config.replay_size, 2 * config.total_steps)
        self.replay = Replay(len(seeds), capacity, self.obs_dim, self.action_dim, self.device)
        self.demonstrations = None
        if demonstrations is not None:
            self.demonstrations = self._rewritten(demonstrations.transitions)
        self.generator: SAC | TD3 | None = None
        self.discriminator: Discriminator | None = None
        self.steps, self.episodes = 0, np.zeros(len(seeds), int)
        # Blocks of steps that are still to be trained on; those of the warm-up wait for its end.
        self.owed: list[int] = []
        self.block_start = 0
        self.held = torch.zeros(len(seeds), self.action_dim, device=self.device)
        self.metrics: dict[str, Float[Tensor, "S"]] = {}

    def run(self) -> Iterator[list[Row]]:
        """Train to the end.

        Yields:
            At each evaluation, a row for each member; after each training block, an empty list, so
            that whoever listens can show how far it is.
        """
        config = self.config
        self.obs, _ = self.env.reset()
        while self.steps < config.total_steps:
            done = self._step()
            if self._block_ends(done):
                self.owed.append(self.steps - self.block_start)
                self.block_start = self.steps
            if self.steps == config.warmup_steps:
                self._build()
            if self.generator is not None:
                while self.owed:
                    self._train(self.owed.pop(0))
                    yield []
                if self.steps % config.eval_every == 0 or self.steps == config.total_steps:
                    yield self.evaluate()

    @property
    def trained(self) -> int:
        """Steps that have been trained on."""
        return self.block_start - sum(self.owed)

    def _block_ends(self, done: np.ndarray) -> bool:
        if self.config.update_every is not None:
            return self.steps - self.block_start == self.config.update_every
        if done.any() and not done.all():
            raise ValueError(
                "members' episodes end at different times, so a population has no common end of "
                "episode to train at: set update_every (1000, say)"
            )
        return bool(done.all())

    @torch.no_grad()
    def _step(self) -> np.ndarray:
        """Act once with every member; return whose episode ended."""
        obs = self._seen(self.obs)
        if self.steps < self.config.warmup_steps:
            fresh = 2 * self.streams.uniform(self.action_dim) - 1
            redraw = self.streams.uniform(1) < 1 / self.config.warmup_hold
            self.held = torch.where(redraw | (self.steps == 0), fresh, self.held)
            pre_tanh = unsquash(self.held)
        else:
            noise = self.streams.normal(1, self.action_dim)
            scaled = self.generator.normaliser(obs.unsqueeze(1))
            actor, params = self.generator.actor, self.generator.actor_params
            pre_tanh = actor.sample(params, scaled, noise)[0].squeeze(1)
        action = torch.tanh(pre_tanh).cpu().numpy()
        next_obs, reward, terminated, truncated, _ = self.env.step(action)
        self._store(
            Batch(
                torch.as_tensor(self.obs, dtype=torch.float32),
                pre_tanh.cpu(),
                torch.as_tensor(next_obs, dtype=torch.float32),
                torch.as_tensor(reward, dtype=torch.float32),
                torch.as_tensor(terminated, dtype=torch.float32),
            )
        )
        done = terminated | truncated
        self.obs = self.env.reset(options={"reset_mask": done})[0] if done.any() else next_obs
        self.steps += 1
        self.episodes += done
        return done

    def _seen(self, obs: np.ndarray) -> Float[Tensor, "S O"]:
        """Return observations as the networks see them, with the absorbing indicator if any."""
        seen = torch.as_tensor(obs, dtype=torch.float32, device=self.device)
        return seen if self.config.absorbing == "none" else absorbing.extend(seen)

    def _store(self, batch: Batch) -> None:
        if self.config.absorbing == "none":
            return self.replay.add(batch)
        batch = absorbing.rewrite(batch)
        self.replay.add(batch)
        ended = absorbing.is_absorbing(batch.next_obs).nonzero().squeeze(1)
        if len(ended):
            self.replay.add(absorbing.loops(batch), ended)
        return None

    def _rewritten(self, batch: Batch) -> Batch:
        """Return demonstrations, axes `N`, with their absorbing states."""
        if self.config.absorbing != "none":
            batch = absorbing.rewrite(batch)
            loops = absorbing.loops(batch)
            batch = Batch(*(torch.cat(parts) for parts in zip(batch, loops, strict=True)))
        return Batch(*(part.to(self.device) for part in batch))

    def _build(self) -> None:
        """Make the learners, once the statistics that scale their inputs are known."""
        config, population = self.config, len(self.seeds)
        if config.normalise:
            members = [self._statistics(i) for i in range(population)]
            normaliser = Normaliser(*map(torch.cat, zip(*members, strict=True)))
        else:
            normaliser = Normaliser.identity(population, self.obs_dim, self.device)
        learner = SAC if config.generator == "sac" else TD3
        self.generator = learner(config, self.obs_dim, self.action_dim, self.streams, normaliser)
        if config.learns_reward:
            self.discriminator = Discriminator(
                config, self.obs_dim, self.action_dim, self.streams, normaliser
            )

    def _statistics(self, member: int) -> Normaliser:
        """Return the scaling by what one member has seen and, half and half, what it was shown.

        That even mixture is what the discriminator will look at. The absorbing state, which is no
        place on the map, is left out.
        """
        rows = self.replay.rows[member, : self.replay.sizes[member]]
        sources = [unpack(rows, self.obs_dim).obs]
        if self.demonstrations is not None:
            sources.append(self.demonstrations.obs)
        if self.config.absorbing != "none":
            sources = [obs[~absorbing.is_absorbing(obs)] for obs in sources]
        return Normaliser.of(*(obs.unsqueeze(0) for obs in sources))

    def _train(self, updates: int) -> None:
        """Train the discriminator `updates` times, then the generator as often."""
        if self.discriminator is not None:
            for minibatches in _chunks(updates):
                self._train_discriminator(minibatches)
        # The reward stays as it is while the generator trains, log π within it too.
        actor_params = self.generator.actor_params.detach().clone()
        for minibatches in _chunks(updates):
            self._train_generator(minibatches, actor_params)
        self._check_finite()

    def _train_discriminator(self, minibatches: int) -> None:
        count = minibatches * self.config.batch_size
        rows = [len(self.demonstrations.obs)] * len(self.seeds)
        index = self.streams.integers(rows, count)
        expert = Batch(*(part[index] for part in self.demonstrations))
        policy = self.replay.sample(self.streams, count)
        coefficient = self.streams.uniform(count, 4)
        if self.discriminator.is_airl:
            log_probs = [self.generator.log_prob(side) for side in (expert, policy)]
            expert_log_prob, policy_log_prob = (
                x.split(self.config.batch_size, 1) for x in log_probs
            )
        else:
            expert_log_prob = policy_log_prob = [None] * minibatches
        for minibatch in zip(
            expert.split(self.config.batch_size),
            policy.split(self.config.batch_size),
            expert_log_prob,
            policy_log_prob,
            coefficient.split(self.config.batch_size, 1),
            strict=True,
        ):
            metrics = self.discriminator.update(*minibatch)
        self.metrics.update(metrics)

    def _train_generator(self, minibatches: int, actor_params: Float[Tensor, "S P"]) -> None:
        size = self.config.batch_size
        batch = self.replay.sample(self.streams, minibatches * size)
        reward = self._reward(batch, actor_params)
        absorbing_reward = self._absorbing_reward(batch, actor_params)
        noise = self.streams.normal(2, minibatches * size, self.action_dim).transpose(0, 1)
        for minibatch, r, eps in zip(
            batch.split(size), reward.split(size, 1), noise.split(size, 2), strict=True
        ):
            metrics = self.generator.update(minibatch, r, absorbing_reward, eps)
        self.metrics.update(metrics)

    def _reward(self, batch: Batch, actor_params: Float[Tensor, "S P"]) -> Float[Tensor, "S B"]:
        name = self.config.reward
        if name == "environment":
            reward = batch.reward
        elif name == "frozen":
            reward = self.frozen_reward(batch.obs, batch.action)
        elif name in IMPLEMENTATIONS and IMPLEMENTATIONS[name].reward_is_logit:
            reward = self.discriminator.reward(batch, self.generator.log_prob(batch, actor_params))
        else:
            reward = self.discriminator.reward(batch, None)
        return self.config.reward_scale * reward

    def _absorbing_reward(
        self, batch: Batch, actor_params: Float[Tensor, "S P"]
    ) -> Float[Tensor, "S 1"]:
        """Return r(s_a), or 0 where there is no such state."""
        if self.config.absorbing == "none":
            return torch.zeros(len(self.seeds), 1, device=self.device)
        first = Batch(*(part[:, :1] for part in batch))
        there = absorbing.absorbing_state(first.obs)
        still = torch.zeros_like(first.pre_tanh)
        return self._reward(first._replace(obs=there, pre_tanh=still, next_obs=there), actor_params)

    def evaluate(self) -> list[Row]:
        """Run `eval_episodes` episodes of each member's mode, the same ones every time."""
        episodes = rollout(
            self.generator.policy,
            self.config.env_id,
            self.seeds,
            self.config.eval_episodes,
            num_threads=self.num_threads,
        )
        learned = self._learned_returns(episodes)
        return [
            Row(
                seed,
                self.steps,
                int(self.episodes[i]),
                float(returns.mean()),
                tuple(float(r) for r in returns),
                float(learned[i].mean()),
                {name: float(value[i]) for name, value in self.metrics.items()},
            )
            for i, (seed, returns) in enumerate(zip(self.seeds, episodes.returns, strict=True))
        ]

    def _learned_returns(self, episodes: Episodes) -> np.ndarray:
        """Return the sum of r_ψ along each episode, `(S, E)`; NaN where no reward is learned."""
        reward = self.reward
        if reward is None:
            return np.full(episodes.returns.shape, np.nan)
        obs, action = (
            torch.as_tensor(x, dtype=torch.float32, device=self.device).flatten(1, 2)
            for x in (episodes.obs, episodes.action)
        )
        obs = obs if self.config.absorbing == "none" else absorbing.extend(obs)
        r = reward(obs, action).view(episodes.reward.shape).cpu().numpy()
        return (r * episodes.running).sum(-1)

    @property
    def reward(self) -> Reward | None:
        """The learned reward as it is now, or the frozen one; None with the task's own."""
        return self.frozen_reward if self.discriminator is None else self.discriminator.frozen

    def _check_finite(self) -> None:
        """Stop a run that has diverged.

        Raises:
            FloatingPointError: naming seed, step and tensor.
        """
        tensors = {"actor": self.generator.actor_params}
        tensors["critics"] = self.generator.critic_params.transpose(0, 1).flatten(1)
        if self.discriminator is not None:
            tensors["reward"] = self.discriminator.reward_params
            tensors["shaping"] = self.discriminator.value_params
        for name, tensor in tensors.items():
            finite = tensor.detach().isfinite().all(1)
            if not finite.all():
                seed = self.seeds[int((~finite).nonzero()[0])]
                raise FloatingPointError(
                    f"seed {seed} diverged by step {self.steps}: {name} weights are not finite; "
                    "lower learning_rate or reward_scale"
                )


def _chunks(updates: int) -> list[int]:
    return [min(CHUNK, updates - done) for done in range(0, updates, CHUNK)]


def complete(
    trainer: Trainer, progress: bool = True, on_rows: Callable[[list[Row]], None] | None = None
) -> Run:
    """Take a trainer to its end.

    Args:
        trainer: a new one.
        progress: whether to show a bar.
        on_rows: called with the rows of each evaluation as it is made.

    Raises:
        FloatingPointError: a member diverged.
    """
    run = Run(trainer.config, trainer.seeds)
    with tqdm(total=trainer.config.total_steps, unit="step", disable=not progress) as bar:
        for rows in trainer.run():
            bar.update(trainer.trained - bar.n)
            if rows:
                run.rows += rows
                bar.set_postfix_str("return " + " ".join(f"{row.mean_return:.4g}" for row in rows))
                if on_rows is not None:
                    on_rows(rows)
        bar.update(trainer.steps - bar.n)
    run.policy, run.reward = trainer.generator.policy, trainer.reward
    return run


def train(
    config: Config,
    seeds: Sequence[int],
    demonstrations: Demonstrations | None = None,
    reward: Reward | None = None,
    *,
    device: str | torch.device = "cpu",
    num_threads: int = 1,
    progress: bool = True,
) -> Run:
    """Train a population from beginning to end.

    Args:
        config: what to do.
        seeds: one for each member; the same seeds on the same machine give the same run.
        demonstrations: of the expert, where a reward is to be learned.
        reward: a frozen reward, where `config.reward` is `frozen`.
        device: where networks and replay live.
        num_threads: for the physics.
        progress: whether to show a bar.

    Raises:
        ValueError: something that `config` needs is missing, or does not fit the task.
        FloatingPointError: a member diverged.
    """
    given = config, seeds, demonstrations, reward
    return complete(Trainer(*given, device=device, num_threads=num_threads), progress)
