"""Algorithm 1 of the paper: the one training loop.

Collect an episode; train the discriminator once for each of its steps; then the generator as
often, on the reward as it now stands. With the task's own reward, or a frozen one, the
discriminator's part falls away and the rest is the same. So it is with PPO, but that it learns from
the block of steps just taken, where the others learn from replay.
"""

import logging
import operator
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from tqdm.auto import tqdm

from offairl_lite import envs
from offairl_lite.config import Config
from offairl_lite.core import absorbing
from offairl_lite.core.acceleration import Execution
from offairl_lite.core.discriminator import Discriminator, Reward
from offairl_lite.core.networks import Normaliser
from offairl_lite.core.policies import Policy, defensive_log_density, unsquash
from offairl_lite.core.ppo import PPO
from offairl_lite.core.replay import Batch, Replay, choose
from offairl_lite.core.rng import Streams
from offairl_lite.core.rollouts import Episodes, NotFiniteError, rollout
from offairl_lite.core.sac import SAC, stochastic_actor
from offairl_lite.core.td3 import TD3
from offairl_lite.demonstrations import Demonstrations

log = logging.getLogger(__name__)

CHUNK = 50
"""Minibatches that are gathered, and given log π or rewards, in one pass."""


class Row(NamedTuple):
    """One evaluation of one member.

    Args:
        seed: of the member.
        step: environment steps until then.
        episodes: that it had ended until then.
        mean_return: of the evaluation's episodes, by the task's own reward, not discounted.
        returns: of each of them.
        learned_return: mean sum of the learned reward along them; NaN where none is learned.
        metrics: diagnostics of the last update, by name; `records.METRICS` has them all.
    """

    seed: int
    step: int
    episodes: int
    mean_return: float
    returns: tuple[float, ...]
    learned_return: float
    metrics: dict[str, float]


@dataclass
class Run:
    """What came of a run: its curve, and the policies and rewards at its end.

    `diverged` tells of members that had to be given up, by seed: they have no rows from there on,
    and their weights are zeros.
    """

    config: Config
    seeds: tuple[int, ...]
    rows: list[Row] = field(default_factory=list)
    policy: Policy | None = None
    reward: Reward | None = None
    diverged: dict[int, str] = field(default_factory=dict)

    @property
    def steps(self) -> np.ndarray:
        """Environment steps of the evaluations, `(K,)`."""
        return np.unique([row.step for row in self.rows])

    @property
    def returns(self) -> np.ndarray:
        """Mean return of each member at each evaluation, `(S, K)`; NaN where there was none."""
        table = np.full((len(self.seeds), len(self.steps)), np.nan)
        for row in self.rows:
            column = np.searchsorted(self.steps, row.step)
            table[self.seeds.index(row.seed), column] = row.mean_return
        return table


@cache
def _say_that_ends_matter(env_id: str) -> None:
    """Log, once, that what the end of an episode is worth has been left to chance."""
    log.warning(
        "An episode of %s has terminated, and absorbing is 'none': the constant of the learned "
        "reward, which nobody chose, then decides between a long life and a short one. Set "
        "absorbing='bootstrap', and temperature=1 for Implementations 3 and 4 (chapter 7).",
        env_id,
    )


class Trainer:
    """The state of one run, which `advance` takes forward piece by piece.

    Args:
        config: what to do.
        seeds: one for each member of the population.
        demonstrations: needed where a reward is learned.
        frozen_reward: needed where `config.reward` is `frozen`: as many members as seeds.
        pretrained_policy: needed where `config.carry` is not `nothing`: as many members as seeds.
        guide: needed where `config.start_steps` is not 0: as many members as seeds.
        execution: where and how it is computed.
        replay_file: where transitions are kept, if not in memory alone.
        memory: steps by which the replay file can be taken back, see `replay.Replay`.

    Raises:
        ValueError: something that `config` needs is missing, or does not fit the task.
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
        # Plain integers, also of an array, to be written and looked up.
        seeds = tuple(map(operator.index, seeds))
        self.config, self.seeds, self.execution = config, seeds, execution
        self.device = torch.device(execution.device)
        torch.set_num_threads(execution.threads)
        self.frozen_reward = None if frozen_reward is None else frozen_reward.to(self.device)
        if not seeds:
            raise ValueError("no seeds: give one for each member of the population")
        if len(set(seeds)) < len(seeds):
            raise ValueError(f"seeds are {self.seeds}: two members with one seed are the same")
        if config.learns_reward and demonstrations is None:
            raise ValueError(f"reward={config.reward!r} is learned from demonstrations: give some")
        if (config.reward == "frozen") != (frozen_reward is not None):
            raise ValueError(f"reward={config.reward!r} and a frozen reward go together")
        if (config.carry != "nothing") != (pretrained_policy is not None):
            raise ValueError(f"carry={config.carry!r} and a pretrained policy go together")
        if (config.start_steps > 0) != (guide is not None):
            raise ValueError(f"start_steps={config.start_steps} and a guide go together")
        for what, given in (
            ("frozen rewards", frozen_reward),
            ("pretrained policies", pretrained_policy),
            ("guides", guide),
        ):
            if given is not None and len(given) != len(seeds):
                numbers = " ".join(map(str, range(len(given))))
                raise ValueError(
                    f"{len(given)} {what} for {len(seeds)} seeds: give as many seeds, for instance "
                    f"--seeds {numbers}"
                )
        if demonstrations is not None and demonstrations.env_id != config.env_id:
            raise ValueError(
                f"demonstrations of {demonstrations.env_id} for a run on {config.env_id}"
            )
        self.streams = Streams(self.seeds, self.device)
        self.env = envs.make(config.env_id, len(seeds), self.seeds, num_threads=execution.threads)
        self.env_obs_dim = self.env.single_observation_space.shape[0]
        self.action_dim = self.env.single_action_space.shape[0]
        self.obs_dim = self.env_obs_dim + (config.absorbing != "none")
        if config.reward_sees is not None and max(config.reward_sees) >= self.obs_dim:
            raise ValueError(
                f"reward_sees is {config.reward_sees}; observations of {config.env_id} have "
                f"{self.obs_dim} numbers, so expected are indices from 0 to {self.obs_dim - 1}"
            )
        if frozen_reward is not None:
            self._require_fit(frozen_reward)
        self.replay = Replay(
            len(seeds),
            config.replay_size,
            self.obs_dim,
            self.action_dim,
            self.device,
            file=replay_file,
            slots=replay_slots(config, memory),
        )
        self.demonstrations = None
        if demonstrations is not None:
            self.demonstrations = self._rewritten(demonstrations.transitions)
        self.horizon = self._horizon(demonstrations)
        self.generator: SAC | TD3 | PPO | None = None
        self.discriminator: Discriminator | None = None
        self.steps, self.episodes = 0, torch.zeros(len(seeds), dtype=torch.long)
        # Blocks of steps that are still to be trained on; those of the warm-up wait for its end.
        self.owed: list[int] = []
        self.block_start, self.evaluated = 0, 0
        self.held = torch.zeros(len(seeds), self.action_dim, device=self.device)
        actor = stochastic_actor(config, self.obs_dim, self.action_dim)
        if pretrained_policy is not None and pretrained_policy.actor != actor:
            raise ValueError(
                f"the pretrained policy is a {pretrained_policy.actor}, and the actor of this run "
                f"a {actor}: make the configurations the same"
            )
        dims = self.obs_dim, self.action_dim
        if guide is not None and (guide.actor.obs_dim, guide.actor.action_dim) != dims:
            raise ValueError(
                f"the guide, of {guide.env_id}, sees {guide.actor.obs_dim} numbers and gives "
                f"{guide.actor.action_dim}; this run has {dims[0]} and {dims[1]}"
            )
        self.pretrained_policy = (
            None if pretrained_policy is None else pretrained_policy.to(self.device)
        )
        self.guide = None if guide is None else guide.to(self.device)
        # For how many more steps the guide acts.
        self.guided = torch.zeros(len(seeds), dtype=torch.long)
        self._start(np.ones(len(seeds), bool))
        self.metrics: dict[str, Float[Tensor, "S"]] = {}
        self.diverged: dict[int, str] = {}
        (self.obs,) = self._sound(self.env.reset()[0])

    @property
    def finished(self) -> bool:
        """Whether all is done."""
        return self.steps >= self.config.total_steps and not self._due

    @property
    def trained(self) -> int:
        """Steps that have been trained on."""
        return self.block_start - sum(self.owed)

    @property
    def _due(self) -> Literal["training", "evaluation"] | None:
        """What must be done before the next step."""
        if self.generator is None or self.steps == 0:
            return None
        if self.owed:
            return "training"
        at_end = self.steps == self.config.total_steps
        due = self.steps % self.config.eval_every == 0 or at_end
        return "evaluation" if due and self.evaluated < self.steps else None

    def advance(self) -> list[Row]:
        """Do the next piece of work: a block of training, an evaluation, or a step.

        Returns:
            After an evaluation, a row for each member; otherwise nothing.

        Raises:
            FloatingPointError: every member has diverged.
        """
        match self._due:
            case "training":
                self.train(self.owed.pop(0))
            case "evaluation":
                self.evaluated = self.steps
                return self.evaluate()
            case None:
                done = self._step()
                if self._block_ends(done):
                    self.owed.append(self.steps - self.block_start)
                    self.block_start = self.steps
                if self.steps == self.config.warmup_steps:
                    self._build(self._normaliser())
                    if self.config.generator == "ppo":
                        self.owed.clear()
                        self.block_start = self.steps
        return []

    def run(self) -> Iterator[list[Row]]:
        """Train to the end. Give way after each block of steps, its training and each evaluation.

        Yields:
            After an evaluation, a row for each member; otherwise nothing.

        Raises:
            FloatingPointError: every member has diverged.
        """
        while not self.finished:
            at_step, start = self._due is None, self.block_start
            rows = self.advance()
            if not at_step or self.block_start != start:
                yield rows

    def _require_fit(self, reward: Reward) -> None:
        """Raise ValueError if a frozen reward sees other numbers than this run has."""
        kind, env_id = self.config.absorbing, self.config.env_id
        sees = reward.normaliser.mean.shape[-1]
        if sees != self.obs_dim:
            # The absorbing state's indicator is one number.
            other = f"it was learned on {reward.env_id}"
            cure = f"{other}; give the reward of a task like {env_id}"
            if kind == "none" and sees == self.obs_dim + 1:
                cure = f"{other}; if that had an absorbing state, set absorbing='bootstrap'"
            elif kind != "none" and sees == self.env_obs_dim:
                cure = f"{other}; if that had no absorbing state, set absorbing='none'"
            raise ValueError(
                f"the frozen reward sees {sees} numbers; with absorbing={kind!r}, {env_id} "
                f"gives {self.obs_dim}: {cure}"
            )
        if reward.state_only:
            return
        sees = reward.net.sizes[0] - self.obs_dim
        if sees != self.action_dim:
            raise ValueError(
                f"the frozen reward is an r(s, a) of {reward.env_id}, with {sees} actions, and "
                f"{env_id} has {self.action_dim}: give one of the state alone, for instance "
                "Implementation 4's"
            )

    def _horizon(self, demonstrations: Demonstrations | None) -> int:
        """Return how many steps the discriminator judges together."""
        if self.config.reward != "gan-gcl":
            return 1
        lengths, config = set(demonstrations.lengths), self.config
        multiples = config.warmup_steps, config.update_every, config.replay_size
        if len(lengths) > 1 or any(n % min(lengths) for n in multiples):
            raise ValueError(
                "gan-gcl compares whole episodes of one length: the demonstrations have "
                f"{min(lengths)} to {max(lengths)} steps, and warmup_steps, update_every and "
                f"replay_size, {multiples}, must be multiples of that"
            )
        return lengths.pop()

    def _block_ends(self, done: np.ndarray) -> bool:
        if self.horizon > 1 and (done != (self.steps % self.horizon == 0)).any():
            raise ValueError(
                f"gan-gcl compares whole episodes of one length, {self.horizon} as demonstrated, "
                f"and {self.config.env_id} has ended one elsewhere or not there: choose another "
                "reward"
            )
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
            pre_tanh = actor.explore(params, scaled, noise).squeeze(1)
            finite = pre_tanh.isfinite()
            if not finite.all():
                self._give_up("actions", ~finite.all(-1), self._remedy)
                pre_tanh = pre_tanh.where(finite, 0)
        action = torch.tanh(pre_tanh)
        if self.guided.any():
            guided = (self.guided > 0).to(self.device).unsqueeze(1)
            action = torch.where(guided, self.guide.act(obs.unsqueeze(1)).squeeze(1), action)
        next_obs, reward, terminated, truncated, _ = self.env.step(action.cpu().numpy())
        next_obs, reward = self._sound(next_obs, reward)
        batch = Batch(
            _float(self.obs),
            pre_tanh.cpu(),
            _float(next_obs),
            _float(reward),
            _float(terminated),
        )
        own = (self.guided == 0).nonzero().squeeze(1)
        self._store(Batch(*(part[own] for part in batch)), own)
        self.guided = (self.guided - 1).clamp(min=0)
        done = terminated | truncated
        self._start(done)
        self.obs = next_obs
        if done.any():
            (self.obs,) = self._sound(self.env.reset(options={"reset_mask": done})[0])
        self.steps += 1
        self.episodes += torch.from_numpy(done)
        return done

    def _sound(self, *given: np.ndarray) -> Sequence[np.ndarray]:
        """Return what the task gives, without NaN; whoever has any is given up."""
        finite = np.all([np.isfinite(x).reshape(len(x), -1).all(1) for x in given], axis=0)
        if finite.all():
            return given
        cure = f"mend {self.config.env_id}"
        self._give_up("observation or reward", torch.from_numpy(~finite), cure)
        return [np.nan_to_num(x) for x in given]

    def _seen(self, obs: np.ndarray) -> Float[Tensor, "S O"]:
        """Return observations as the networks see them, with the absorbing indicator if any."""
        seen = _float(obs).to(self.device)
        return seen if self.config.absorbing == "none" else absorbing.extend(seen)

    def _start(self, begins: Bool[np.ndarray, "S"]) -> None:
        """Draw for how long the guide acts in episodes that begin."""
        if self.config.start_steps:
            for i in np.flatnonzero(begins):
                self.guided[i] = self.streams.integer(i, self.config.start_steps + 1)

    def _store(self, batch: Batch, members: Int[Tensor, "M"]) -> None:
        if self.config.absorbing == "none":
            off_policy = self.config.generator != "ppo"
            if off_policy and self.config.learns_reward and batch.terminated.any():
                _say_that_ends_matter(self.config.env_id)
            return self.replay.add(batch, members)
        batch = absorbing.rewrite(batch)
        self.replay.add(batch, members)
        ended = absorbing.is_absorbing(batch.next_obs).nonzero().squeeze(1)
        if len(ended):
            self.replay.add(absorbing.loops(batch), members[ended])
        return None

    def _rewritten(self, batch: Batch) -> Batch:
        """Return demonstrations, axes `N`, with their absorbing states."""
        if self.config.absorbing != "none":
            batch = absorbing.rewrite(batch)
            loops = absorbing.loops(batch)
            batch = Batch(*(torch.cat(parts) for parts in zip(batch, loops, strict=True)))
        return Batch(*(part.to(self.device) for part in batch))

    def _build(self, normaliser: Normaliser) -> None:
        """Make the learners, once it is known how to scale their inputs."""
        config = self.config
        dims = self.obs_dim, self.action_dim
        learners = {"sac": SAC, "td3": TD3, "ppo": PPO}
        self.generator = learners[config.generator](config, *dims, self.streams, normaliser)
        if config.carry != "nothing":
            self._carry_over()
        self.generator.step = self.execution.accelerate(self.generator.step)
        if config.learns_reward:
            self.discriminator = Discriminator(
                config, *dims, self.streams, normaliser, self.horizon
            )
            self.discriminator.step = self.execution.accelerate(self.discriminator.step)

    def _carry_over(self) -> None:
        """Put the pretrained policy's weights into the actor."""
        params, own = self.pretrained_policy.params, self.generator.actor_params.detach()
        if self.config.carry == "primitives":
            gate = self.generator.actor.gate.num_params
            params = torch.cat([params[:, :-gate], own[:, -gate:]], 1)
        own.copy_(params)

    def _normaliser(self) -> Normaliser:
        """Return the scaling by what each member has seen and, half and half, what it was shown.

        That even mixture is what the discriminator will look at. The absorbing state, which is no
        place on the map, is left out. A policy that is carried over brings its own scaling.
        """
        if self.pretrained_policy is not None:
            return self.pretrained_policy.normaliser
        if not self.config.normalise:
            return Normaliser.identity(len(self.seeds), self.obs_dim, self.device)
        members = []
        for member in range(len(self.seeds)):
            sources = [self.replay.held(member).obs]
            if self.demonstrations is not None:
                sources.append(self.demonstrations.obs)
            if self.config.absorbing != "none":
                sources = [obs[~absorbing.is_absorbing(obs)] for obs in sources]
            members.append(Normaliser.of(*(obs.unsqueeze(0) for obs in sources)))
        return Normaliser(*map(torch.cat, zip(*members, strict=True)))

    def train(self, updates: int) -> None:
        """Train the discriminator `updates` times, then the generator as often, from replay.

        `config.discriminator_updates`, where it is set, is how often the discriminator is trained.
        PPO goes through the last `updates` steps instead.
        """
        if self.discriminator is not None:
            for minibatches in _chunks(self.config.discriminator_updates or updates):
                self._train_discriminator(minibatches)
        # The reward stays as it is while the generator trains, log π within it too.
        actor_params = self.generator.actor_params.detach().clone()
        if self.config.generator == "ppo":
            self._train_on_policy(self.replay.last(updates), actor_params)
        else:
            for minibatches in _chunks(updates):
                self._train_generator(minibatches, actor_params)
        # Those that were given up have been trained along, so they are zeroed again.
        lost = torch.tensor([seed in self.diverged for seed in self.seeds], device=self.device)
        for name, weights in self._learned().items():
            self._give_up(name, lost | ~weights.isfinite().all(-1), self._remedy)

    def _train_discriminator(self, minibatches: int) -> None:
        size = max(self.config.batch_size // self.horizon, 1) * self.horizon
        count = minibatches * size
        rows = [len(self.demonstrations.obs)] * len(self.seeds)
        index = choose(self.streams, rows, count, self.horizon)
        expert = Batch(*(part[index] for part in self.demonstrations))
        policy = self.replay.sample(self.streams, count, self.horizon)
        coefficient = self.streams.uniform(count, 4)
        if self.discriminator.sees_policy:
            log_probs = [self._log_density(side) for side in (expert, policy)]
            expert_log_prob, policy_log_prob = (x.split(size, 1) for x in log_probs)
        else:
            expert_log_prob = policy_log_prob = [None] * minibatches
        for minibatch in zip(
            expert.split(size),
            policy.split(size),
            expert_log_prob,
            policy_log_prob,
            coefficient.split(size, 1),
            strict=True,
        ):
            metrics = self.discriminator.update(*minibatch)
        self.metrics.update(metrics)

    def _log_density(
        self, batch: Batch, actor_params: Float[Tensor, "S P"] | None = None
    ) -> Float[Tensor, "S B"]:
        """Return the log density of a batch's actions that the discriminator compares f with."""
        log_prob = self.generator.log_prob(batch, actor_params)
        if self.config.replay_density == "policy":
            return log_prob
        mixed = defensive_log_density(log_prob, self._uniform_share, self.action_dim)
        if self.config.absorbing == "none":
            return mixed
        return mixed.where(~absorbing.is_absorbing(batch.obs), log_prob)

    @property
    def _uniform_share(self) -> float:
        """Share of the warm-up among the steps that replay holds.

        Steps are counted as rows. Absorbing states add some, so that once replay forgets, the
        warm-up is gone a little earlier than this says.
        """
        forgotten = max(self.steps - self.config.replay_size, 0)
        warmup = max(self.config.warmup_steps - forgotten, 0)
        return warmup / (self.steps - forgotten)

    def _train_generator(self, minibatches: int, actor_params: Float[Tensor, "S P"]) -> None:
        size = self.config.batch_size
        batch = self.replay.sample(self.streams, minibatches * size)
        reward = self._reward(batch, actor_params)
        absorbing_reward = self._absorbing_reward(batch, actor_params)
        if self.config.centre_reward:
            mean = reward.mean(1, keepdim=True)
            reward, absorbing_reward = reward - mean, absorbing_reward - mean
        noise = self.streams.normal(2, minibatches * size, self.action_dim).transpose(0, 1)
        for minibatch, r, eps in zip(
            batch.split(size), reward.split(size, 1), noise.split(size, 2), strict=True
        ):
            metrics = self.generator.update(minibatch, r, absorbing_reward, eps)
        self.metrics.update(metrics)

    def _train_on_policy(self, block: Batch, actor_params: Float[Tensor, "S P"]) -> None:
        rollout = self.generator.rollout(block, self._reward(block, actor_params))
        steps, size = rollout.advantage.shape[1], self.config.batch_size
        for _ in range(self.config.epochs):
            order = self.streams.uniform(steps).argsort(1)
            noise = self.streams.normal(steps, self.action_dim)
            for index, eps in zip(order.split(size, 1), noise.split(size, 1), strict=True):
                metrics = self.generator.update(rollout.rows(index), eps)
        self.metrics.update(metrics)

    def _reward(self, batch: Batch, actor_params: Float[Tensor, "S P"]) -> Float[Tensor, "S B"]:
        name = self.config.reward
        if name == "environment":
            reward = batch.reward
        elif name == "frozen":
            reward = self.frozen_reward(batch.obs, batch.action)
        elif self.discriminator.reward_is_logit:
            reward = self.discriminator.reward(batch, self._log_density(batch, actor_params))
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
        while True:
            left = [i for i, seed in enumerate(self.seeds) if seed not in self.diverged]
            try:
                episodes = rollout(
                    self.generator.policy.member(*left),
                    self.config.env_id,
                    [self.seeds[i] for i in left],
                    self.config.eval_episodes,
                    num_threads=self.execution.threads,
                )
                break
            except NotFiniteError as error:
                lost = torch.zeros(len(self.seeds), dtype=torch.bool)
                lost[[left[i] for i in error.members]] = True
                self._give_up("observation or reward", lost, f"mend {self.config.env_id}")
        learned = self._learned_returns(episodes, left)
        return [
            Row(
                self.seeds[i],
                self.steps,
                int(self.episodes[i]),
                float(returns.mean()),
                tuple(float(r) for r in returns),
                float(paid.mean()),
                {name: float(value[i]) for name, value in self.metrics.items()},
            )
            for i, returns, paid in zip(left, episodes.returns, learned, strict=True)
        ]

    def _learned_returns(self, episodes: Episodes, members: list[int]) -> np.ndarray:
        """Return the sum of r_ψ along each episode, `(S, E)`; NaN where no reward is learned."""
        reward = self.reward and self.reward.member(*members)
        if reward is None:
            return np.full(episodes.returns.shape, np.nan)
        obs, action = (
            torch.as_tensor(x, dtype=torch.float32, device=self.device).flatten(1, 2)
            for x in (episodes.obs, episodes.action)
        )
        r = reward(obs, action).view(episodes.reward.shape).cpu().numpy()
        return (r * episodes.running).sum(-1)

    @property
    def policy(self) -> Policy | None:
        """The policies as they are now; None while the warm-up lasts."""
        return None if self.generator is None else self.generator.policy

    @property
    def reward(self) -> Reward | None:
        """The learned reward as it is now, or the frozen one; None with the task's own."""
        return self.frozen_reward if self.discriminator is None else self.discriminator.frozen

    def _learned(self) -> dict[str, Float[Tensor, "S P"]]:
        """Return all weights that are trained, a row for each member."""
        critics = self.generator.critic_params.detach()
        critics = critics.view(-1, *critics.shape[-2:])  # two of SAC and TD3, one of PPO
        tensors = {"actor": self.generator.actor_params.detach(), "critic": critics.sum(0)}
        if self.discriminator is not None:
            tensors["reward"] = self.discriminator.reward_params.detach()
            tensors["shaping"] = self.discriminator.value_params.detach()
        return tensors

    @property
    def _remedy(self) -> str:
        """What to do about weights that are not finite."""
        remedy = "lower learning_rate or reward_scale"
        if self.config.generator == "sac" and self.config.temperature is None:
            remedy += ", or set temperature, if the learned one had risen without end (curve.csv)"
        return remedy

    def _give_up(self, name: str, diverged: Bool[Tensor, "S"], cure: str) -> None:
        """Go on without some members: with weights of zero they do no harm.

        Raises:
            FloatingPointError: nobody is left.
        """
        for member in diverged.nonzero().flatten().tolist():
            for tensor in self._weights().values():
                if tensor.ndim > 1:
                    tensor[..., member, :] = 0
            seed = self.seeds[member]
            if seed not in self.diverged:
                self.diverged[seed] = (
                    f"seed {seed} diverged by step {self.steps}: its {name} is not finite; {cure}"
                )
                warnings.warn(self.diverged[seed], stacklevel=4)
        if len(self.diverged) == len(self.seeds):
            raise FloatingPointError("; ".join(self.diverged.values()))

    def _weights(self) -> dict[str, Tensor]:
        """Return the tensors that training changes: themselves, not copies."""
        learners = {"generator": self.generator, "discriminator": self.discriminator}
        return {
            f"{kind}.{name}": tensor
            for kind, learner in learners.items()
            if learner is not None
            for name, tensor in learner.state.items()
        }

    def state(self) -> dict[str, Tensor]:
        """Return what the future depends on, but the rows of the replay and `diverged`."""
        tensors = {
            "counts": torch.tensor([self.steps, self.block_start, self.evaluated]),
            "owed": torch.tensor(self.owed, dtype=torch.long),
            "episodes": self.episodes,
            "held": self.held,
            "guided": self.guided,
            "obs": torch.as_tensor(self.obs),
            "streams": self.streams.state,
            "added": self.replay.added,
            **{f"env.{name}": torch.as_tensor(x) for name, x in self.env.get_state().items()},
            **{f"metrics.{name}": value for name, value in self.metrics.items()},
        }
        if self.generator is not None:
            tensors |= {"mean": self.generator.normaliser.mean, **self._weights()}
            tensors["std"] = self.generator.normaliser.std
        return tensors

    def close(self) -> None:
        """Close the environments; a trainer steps no more."""
        self.env.close()

    def restore(self, state: dict[str, Tensor]) -> None:
        """Go on from a state of a trainer with this configuration and these seeds, exactly.

        The replay's file must be the one that trainer had.

        Raises:
            ValueError: the state is of something else.
        """
        try:
            self.steps, self.block_start, self.evaluated = state["counts"].tolist()
            self.owed, self.obs = state["owed"].tolist(), state["obs"].numpy()
            if "mean" in state:
                self._build(Normaliser(*(state[x].to(self.device) for x in ("mean", "std"))))
                if not isinstance(self.generator, PPO):
                    self.generator.updates = self.trained
                for name, tensor in self._weights().items():
                    tensor.copy_(state[name])
            for name in ("episodes", "held"):
                getattr(self, name).copy_(state[name])
            if "guided" in state:  # Older checkpoints know of no guide.
                self.guided.copy_(state["guided"])
            self.replay.added.copy_(state["added"])
            self.streams.state = state["streams"]
            self.env.set_state(_under("env.", state, Tensor.numpy))
            self.metrics = _under("metrics.", state, lambda x: x.to(self.device))
        except (KeyError, RuntimeError) as error:
            raise ValueError(f"not a state of this run: {error}") from error


def _float(array: np.ndarray) -> Tensor:
    return torch.from_numpy(array.astype(np.float32))


def replay_slots(config: Config, memory: int) -> int:
    """Return the places that a member's replay needs: `memory` steps more than it looks back on."""
    # A terminated episode may add a row of the absorbing state.
    rows = 1 if config.absorbing == "none" else 2
    return min(config.replay_size + rows * memory, rows * config.total_steps)


def _under(prefix: str, state: dict[str, Tensor], convert: Callable) -> dict:
    """Return the part of a state whose names begin with `prefix`."""
    n = len(prefix)
    return {name[n:]: convert(x) for name, x in state.items() if name.startswith(prefix)}


def _chunks(updates: int) -> list[int]:
    return [min(CHUNK, updates - done) for done in range(0, updates, CHUNK)]


def complete(
    trainer: Trainer,
    progress: bool = True,
    on_advance: Callable[[list[Row]], None] | None = None,
) -> Run:
    """Take a trainer to its end.

    Args:
        trainer: a new one, or one that was restored.
        progress: whether to show a bar.
        on_advance: called after each piece of work, with the rows of an evaluation if it was one;
            a StopIteration of its own ends the run there.

    Raises:
        FloatingPointError: every member has diverged.
    """
    run = Run(trainer.config, trainer.seeds, diverged=trainer.diverged)
    with tqdm(
        total=trainer.config.total_steps, initial=trainer.trained, unit="step", disable=not progress
    ) as bar:
        while not trainer.finished:
            rows = trainer.advance()
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
            f"nothing was trained: no episode was over between step {trainer.config.warmup_steps}, "
            f"the end of the warm-up, and step {trainer.steps}; raise total_steps",
            stacklevel=2,
        )
    run.policy, run.reward = trainer.generator.policy, trainer.reward
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
        frozen_reward: what pays, where `config.reward` is `frozen`.
        pretrained_policy: what the actor begins with, where `config.carry` says so.
        guide: one that acts at the starts of episodes, where there are `config.start_steps`.
        execution: where and how it is computed.
        progress: whether to show a bar.
        on_evaluation: called after each evaluation with a row for each member, for logging
            (`logs.TensorBoard` is one such); to end early with what is there, it raises
            StopIteration.

    Raises:
        ValueError: something that `config` needs is missing, or does not fit the task.
        FloatingPointError: every member has diverged.
    """

    def advanced(rows: list[Row]) -> None:
        if rows and on_evaluation is not None:
            on_evaluation(rows)

    given = {
        "frozen_reward": frozen_reward,
        "pretrained_policy": pretrained_policy,
        "guide": guide,
        "execution": execution,
    }
    with closing(Trainer(config, seeds, demonstrations, **given)) as trainer:
        return complete(trainer, progress, advanced)
