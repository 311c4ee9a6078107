"""What Algorithm 1 asks of a learner, and which there are."""

from collections.abc import Callable, Iterator
from typing import Protocol, runtime_checkable

from torch import Tensor

from offairl_lite.config import Config, SACConfig, TD3Config
from offairl_lite.core.absorbing import is_absorbing
from offairl_lite.core.experience import Experience
from offairl_lite.core.iq_learn import IQLearn
from offairl_lite.core.policies import Actor, MultiplicativeGaussian, Policy, defensive_log_density
from offairl_lite.core.ppo import PPO
from offairl_lite.core.replay import Batch, LogDensity
from offairl_lite.core.rng import Rng
from offairl_lite.core.sac import SAC
from offairl_lite.core.shapes import Action, Layout, Metrics, Obs, Params, Vector
from offairl_lite.core.td3 import TD3


@runtime_checkable
class Learner(Protocol):
    """Actor and critics of `S` members, whose observations come scaled."""

    actor: Actor
    actor_params: Params
    state: dict[str, Tensor]  #: The tensors that updates change: themselves, not copies.

    @property
    def update(self) -> Callable[..., Metrics]:
        """Make one update, of what `minibatches` yields."""

    def init(self, rng: Rng) -> None:
        """Draw the initial weights, in place."""

    def log_prob(self, actor_params: Params, obs: Obs, pre_tanh: Action) -> Vector:
        """Return log π(a|s) of the actions tanh(`pre_tanh`), under any weights of the actor."""

    def minibatches(self, experience: Experience, steps: int, done: int) -> Iterator[tuple]:
        """Yield the arguments of the updates for a block of steps, after `done` updates before."""


def make_learner(config: Config, layout: Layout) -> Learner:
    """Return the learner that its settings ask for."""
    if isinstance(config.learner, SACConfig):
        kind = IQLearn if config.reward == "iq-learn" else SAC
        return kind(config.learner, layout)
    if isinstance(config.learner, TD3Config):
        return TD3(config.learner, layout)
    return PPO(config.learner, layout)


def adopt(learner: Learner, policy: Policy, new_gate: bool) -> None:
    """Put a policy's weights into the actor; with a `new_gate`, all but those of its gate."""
    params, kept = learner.actor_params.detach(), policy.actor.num_params
    if new_gate and isinstance(policy.actor, MultiplicativeGaussian):
        kept -= policy.actor.gate.num_params  # They come last.
    params[:, :kept] = policy.params[:, :kept]


def log_density(config: Config, learner: Learner, steps: int) -> LogDensity:
    """Return log π of scaled transitions, as it is now; `airl-mixture` mixes in uniform actions."""
    params, schedule = learner.actor_params.detach().clone(), config.schedule
    if getattr(config.discriminator, "loss", None) != "airl-mixture":
        return lambda batch: learner.log_prob(params, batch.obs, batch.pre_tanh)
    # Rows of absorbing states, which push the warm-up out earlier, are not counted.
    forgotten = max(steps - schedule.replay_size, 0)
    uniform_share = max(schedule.learning_starts - forgotten, 0) / (steps - forgotten)

    def mixed_log_density(batch: Batch) -> Vector:
        log_prob = learner.log_prob(params, batch.obs, batch.pre_tanh)
        mixed = defensive_log_density(log_prob, uniform_share, batch.pre_tanh.shape[-1])
        if schedule.absorbing == "none":
            return mixed
        return mixed.where(~is_absorbing(batch.obs), log_prob)

    return mixed_log_density
