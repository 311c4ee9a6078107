"""The networks of a run: learner and discriminator, and the reward between them."""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from offairl_lite.config import Config, LearnerConfig, SACConfig, TD3Config
from offairl_lite.core import absorbing
from offairl_lite.core.acceleration import Execution
from offairl_lite.core.discriminator import Discriminator, make_discriminator
from offairl_lite.core.networks import Normaliser
from offairl_lite.core.policies import Policy, defensive_log_density
from offairl_lite.core.ppo import PPO
from offairl_lite.core.replay import Batch
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rng import Rng
from offairl_lite.core.sac import SAC
from offairl_lite.core.td3 import TD3

OfBatch = Callable[[Batch], Float[Tensor, "S B"]]
"""A number for each transition of a batch."""


def make_learner(config: LearnerConfig, *given: Any, absorbing: str) -> SAC | TD3 | PPO:
    """Return the learner that its settings ask for."""
    if isinstance(config, SACConfig):
        return SAC(config, *given, absorbing)
    return TD3(config, *given, absorbing) if isinstance(config, TD3Config) else PPO(config, *given)


def even_normaliser(
    seen: Sequence[Float[Tensor, "N O"]], shown: Float[Tensor, "M O"] | None, extended: bool
) -> Normaliser:
    """Return the scaling by what each member has seen and, half and half, what it was shown.

    That even mixture is what the discriminator will look at. The absorbing state, which is no
    place on the map, is left out.

    Args:
        seen: observations of each member, of its warm-up.
        shown: observations of the demonstrations, if there are any.
        extended: whether the last dimension is the indicator of the absorbing state.
    """
    members = []
    for own in seen:
        sources = [own] if shown is None else [own, shown]
        if extended:
            sources = [obs[~absorbing.is_absorbing(obs)] for obs in sources]
        members.append(Normaliser.of(*(obs.unsqueeze(0) for obs in sources)))
    return Normaliser(*map(torch.cat, zip(*members, strict=True)))


class Models:
    """Learner and discriminator of all members.

    Args:
        config: of the run.
        dims: O and A, as networks see them.
        rng: for the initial weights.
        normaliser: scales what all networks see.
        execution: how updates are executed.
        horizon: steps that the discriminator judges together.
        frozen_reward: where the reward was learned before.
        pretrained_policy: where the actor starts from one.
    """

    def __init__(
        self,
        config: Config,
        dims: tuple[int, int],
        rng: Rng,
        normaliser: Normaliser,
        execution: Execution,
        horizon: int = 1,
        frozen_reward: Reward | None = None,
        pretrained_policy: Policy | None = None,
    ) -> None:
        self.config, self.rng, self.frozen_reward = config, rng, frozen_reward
        self.learner = make_learner(
            config.learner, *dims, rng, normaliser, absorbing=config.schedule.absorbing
        )
        if pretrained_policy is not None:
            self._start_from(pretrained_policy.params)
        self.discriminator: Discriminator | None = None
        if config.learns_reward:
            self.discriminator = make_discriminator(
                config.discriminator, *dims, rng, normaliser, horizon, config.env_id
            )
            self.update_discriminator = execution.accelerate(self.discriminator.update)
        self.update_learner = execution.accelerate(self.learner.update)

    def _start_from(self, params: Float[Tensor, "S P"]) -> None:
        """Put a policy's weights, or those of its primitives, into the actor."""
        own = self.learner.actor_params.detach()
        if self.config.pretrained == "primitives":
            gate = self.learner.actor.gate.num_params
            params = torch.cat([params[:, :-gate], own[:, -gate:]], 1)
        own.copy_(params)

    @property
    def normaliser(self) -> Normaliser:
        """What scales the observations that networks see."""
        return self.learner.normaliser

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

    def log_density(self, steps: int) -> OfBatch:
        """Return log π of a batch's actions, under the actor as it is now.

        With `loss="mixture"` it is that of π mixed with the warm-up's uniform actions.

        Args:
            steps: environment steps so far, which decide the warm-up's share of replay.
        """
        params = self.learner.actor_params.detach().clone()

        def density(batch: Batch) -> Float[Tensor, "S B"]:
            return self.learner.log_prob(params, batch.obs, batch.pre_tanh)

        if not self.config.learns_reward or self.config.discriminator.loss != "mixture":
            return density
        schedule = self.config.schedule
        # Steps are counted as rows. Absorbing states add some, so that once replay forgets, the
        # warm-up is gone a little earlier than this says.
        forgotten = max(steps - schedule.replay_size, 0)
        share = max(schedule.warmup_steps - forgotten, 0) / (steps - forgotten)

        def mixture(batch: Batch) -> Float[Tensor, "S B"]:
            own = density(batch)
            mixed = defensive_log_density(own, share, batch.pre_tanh.shape[-1])
            if schedule.absorbing == "none":
                return mixed
            return mixed.where(~absorbing.is_absorbing(batch.obs), own)

        return mixture

    def reward_of(self, log_density: OfBatch) -> OfBatch:
        """Return what the learner is to maximise, as a function of a batch."""
        scale = self.config.learner.reward_scale

        def reward(batch: Batch) -> Float[Tensor, "S B"]:
            if self.frozen_reward is not None:
                return scale * self.frozen_reward(batch.obs, batch.action)
            if self.discriminator is None:
                return scale * batch.reward
            log_prob = log_density(batch) if self.discriminator.reward_is_logit else None
            return scale * self.discriminator.reward(batch, log_prob)

        return reward

    def absorbing_reward_of(self, reward: OfBatch) -> OfBatch:
        """Return r(s_a), `(S, 1)`, as a function of a batch, or 0 where there is no such state."""
        if self.config.schedule.absorbing == "none":
            return lambda batch: torch.zeros_like(batch.reward[:, :1])

        def absorbing_reward(batch: Batch) -> Float[Tensor, "S 1"]:
            first = Batch(*(part[:, :1] for part in batch))
            there = absorbing.absorbing_state(first.obs)
            still = torch.zeros_like(first.pre_tanh)
            return reward(first._replace(obs=there, pre_tanh=still, next_obs=there))

        return absorbing_reward

    def weights(self) -> dict[str, Tensor]:
        """Return the tensors that training changes: themselves, not copies."""
        owners = {"learner": self.learner, "discriminator": self.discriminator}
        return {
            f"{kind}.{name}": tensor
            for kind, owner in owners.items()
            if owner is not None
            for name, tensor in owner.state.items()
        }

    def not_finite(self) -> dict[str, Bool[Tensor, "S"]]:
        """Return, by network, which members have weights that are not finite."""
        critics = self.learner.critic_params.detach()
        critics = critics.view(-1, *critics.shape[-2:])  # two of SAC and TD3, one of PPO
        nets = {"actor": self.learner.actor_params.detach(), "critic": critics.sum(0)}
        if self.discriminator is not None:
            nets["reward"] = self.discriminator.reward_params.detach()
            nets["shaping"] = self.discriminator.value_params.detach()
        return {name: ~params.isfinite().all(-1) for name, params in nets.items()}

    @property
    def remedy(self) -> str:
        """What to do about weights that are not finite."""
        remedy = "lower learning_rate or reward_scale"
        if isinstance(self.learner, SAC) and self.config.learner.temperature is None:
            remedy += ", or set temperature, if the learned one had risen without end (curve.csv)"
        return remedy
