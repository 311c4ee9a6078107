"""The networks of a run: learner and discriminator, and the reward between them."""

import warnings
from functools import partial

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from offairl_lite.config import Config, DiscriminatorConfig, SACConfig, TD3Config
from offairl_lite.core import absorbing
from offairl_lite.core.acceleration import Execution
from offairl_lite.core.discriminator import Discriminator, LogDensity, make_discriminator
from offairl_lite.core.iq_learn import IQLearn
from offairl_lite.core.networks import Normaliser
from offairl_lite.core.policies import MultiplicativeGaussian, Policy, defensive_log_density
from offairl_lite.core.ppo import PPO
from offairl_lite.core.replay import Batch, Replay
from offairl_lite.core.requirements import Inherited
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rng import Rng
from offairl_lite.core.sac import SAC
from offairl_lite.core.shapes import Column, Params, Vector
from offairl_lite.core.td3 import TD3


def make_learner(
    config: Config, dims: tuple[int, int], rng: Rng, normaliser: Normaliser
) -> SAC | TD3 | PPO:
    """Return the learner that its settings ask for."""
    learner, absorbing = config.learner, config.schedule.absorbing
    if isinstance(learner, SACConfig):
        kind = IQLearn if config.reward == "iq-learn" else SAC
        return kind(learner, *dims, rng, normaliser, absorbing)
    if isinstance(learner, TD3Config):
        return TD3(learner, *dims, rng, normaliser, absorbing)
    return PPO(learner, *dims, rng, normaliser)


def make_normaliser(config: Config, replay: Replay, demonstrations: Batch | None) -> Normaliser:
    """Return the scaling by what each member has seen and, half and half, what it was shown.

    The absorbing state, which is no place on the map, is left out.
    """
    population = len(replay.added)
    if not config.schedule.normalise:
        return Normaliser.identity(population, replay.obs_dim, replay.device)
    members = []
    for i in range(population):
        sources = [batch.obs for batch in (replay.held(i), demonstrations) if batch is not None]
        if config.schedule.absorbing != "none":
            sources = [obs[~absorbing.is_absorbing(obs)] for obs in sources]
        _warn_of_outliers(sources[0], f"member {i} of {config.env_id}")
        members.append(Normaliser.of(*(obs.unsqueeze(0) for obs in sources)))
    return Normaliser(*map(torch.cat, zip(*members, strict=True)))


def _warn_of_outliers(obs: Float[Tensor, "N O"], whose: str) -> None:
    """Warn of a reading that scales all others of the warm-up to almost nothing."""
    far = (obs - obs.median(0).values).abs()
    # Beside 1, too: what hardly moves, such as a thing at rest, may well be pushed.
    for step, j in (far > 1e5 * far.median(0).values.clamp(min=1)).nonzero()[:1].tolist():
        found = f"observation[{j}] of {whose} is {obs[step, j]:.6g} in step {step} of the warm-up"
        why = "half of the others differ by less than a 100,000th of that, and would look alike"
        warnings.warn(f"{found}: {why}; mend the task", stacklevel=2)


class Models:
    """Learner and discriminator of all members.

    `dims` are O and A, as networks see them; `normaliser` scales what all of them see. `rng` is for
    weights and training. `horizon` is how many steps the discriminator judges together.
    """

    def __init__(
        self,
        config: Config,
        dims: tuple[int, int],
        rng: Rng,
        normaliser: Normaliser,
        execution: Execution,
        horizon: int = 1,
        inherited: Inherited = Inherited(),  # noqa: B008
    ) -> None:
        self.config, self.rng, self.normaliser = config, rng, normaliser
        self.frozen_reward, policy, _ = inherited
        self.learner = make_learner(config, dims, rng, normaliser)
        if policy is not None:
            self._start_from(policy.params)
        self.discriminator: Discriminator | None = None
        if isinstance(config.discriminator, DiscriminatorConfig):
            self.discriminator = make_discriminator(
                config.discriminator, *dims, rng, normaliser, horizon, config.env_id
            )
            self.update_discriminator = execution.accelerate(self.discriminator.update)
        self.update_learner = execution.accelerate(self.learner.update)

    def _start_from(self, params: Params) -> None:
        """Put a policy's weights, or those of its primitives, into the actor."""
        actor, own = self.learner.actor, self.learner.actor_params.detach()
        if self.config.pretrained == "primitives" and isinstance(actor, MultiplicativeGaussian):
            gate = actor.gate.num_params
            params = torch.cat([params[:, :-gate], own[:, -gate:]], 1)
        own.copy_(params)

    @property
    def policy(self) -> Policy:
        """The policies as they are now; later updates do not change them."""
        params = self.learner.actor_params.detach().clone()
        return Policy(self.config.env_id, self.learner.actor, params, self.normaliser)

    @property
    def reward(self) -> Reward | None:
        """The learned reward as it is now, or the frozen one; None with the task's own."""
        return self.frozen_reward if self.discriminator is None else self.discriminator.frozen

    @torch.no_grad()
    def explore(self, obs: Float[Tensor, "S O"]) -> Float[Tensor, "S A"]:
        """Return what the policies do when they explore, as `pre_tanh`."""
        noise = self.rng.normal(1, self.learner.actor.action_dim)
        scaled = self.normaliser(obs.unsqueeze(1))
        return self.learner.actor.explore(self.learner.actor_params, scaled, noise).squeeze(1)

    def log_density(self, steps: int) -> LogDensity:
        """Return log π under the actor as it is now, after so many environment steps.

        With `loss="mixture"`, π is mixed with the warm-up's uniform actions, as replay has them.
        """
        discriminator, schedule, share = self.config.discriminator, self.config.schedule, None
        if isinstance(discriminator, DiscriminatorConfig) and discriminator.loss == "mixture":
            # Rows of absorbing states, which push the warm-up out earlier, are not counted.
            forgotten = max(steps - schedule.replay_size, 0)
            share = max(schedule.warmup_steps - forgotten, 0) / (steps - forgotten)
        return partial(self._log_density, self.learner.actor_params.detach().clone(), share)

    def _log_density(self, params: Params, uniform_share: float | None, batch: Batch) -> Vector:
        if isinstance(self.learner, TD3):
            raise TypeError("td3's policy is deterministic and has no log π")
        own = self.learner.log_prob(params, batch.obs, batch.pre_tanh)
        if uniform_share is None:
            return own
        mixed = defensive_log_density(own, uniform_share, batch.pre_tanh.shape[-1])
        if self.config.schedule.absorbing == "none":
            return mixed
        return mixed.where(~absorbing.is_absorbing(batch.obs), own)

    def reward_of(self, batch: Batch, log_density: LogDensity) -> Vector:
        """Return what the learner is to maximise."""
        scale = self.config.learner.reward_scale
        if self.frozen_reward is not None:
            return scale * self.frozen_reward(batch.obs, batch.action)
        if self.discriminator is None:
            return scale * batch.reward
        return scale * self.discriminator.reward(batch, log_density)

    def absorbing_reward_of(self, batch: Batch, log_density: LogDensity) -> Column:
        """Return r(s_a), or 0 where there is no such state."""
        if self.config.schedule.absorbing == "none":
            return torch.zeros_like(batch.reward[:, :1])
        first = Batch(*(part[:, :1] for part in batch))
        there = absorbing.absorbing_state(first.obs)
        still = torch.zeros_like(first.pre_tanh)
        loop = first._replace(obs=there, pre_tanh=still, next_obs=there)
        return self.reward_of(loop, log_density)

    def weights(self) -> dict[str, Tensor]:
        """Return the tensors that training changes: themselves, not copies."""
        parts = {"learner": self.learner.state}
        if self.discriminator is not None:
            parts["discriminator"] = self.discriminator.state
        return {f"{part}.{name}": x for part, own in parts.items() for name, x in own.items()}

    def not_finite(self) -> dict[str, Bool[Tensor, "S"]]:
        """Return, by network, which members have weights that are not finite."""
        nets = {"actor": self.learner.actor_params, "critic": self.learner.critic_params}
        if self.discriminator is not None:
            nets["reward"] = self.discriminator.reward_params
            nets["shaping"] = self.discriminator.value_params
        broken = {name: ~params.isfinite().all(-1) for name, params in nets.items()}
        # Two critics of SAC and TD3, one of PPO.
        return broken | {"critic": broken["critic"].view(-1, len(self.rng)).any(0)}
