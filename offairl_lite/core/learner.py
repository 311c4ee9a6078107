"""What Algorithm 1 asks of a learner, and which there are."""

from collections.abc import Callable, Iterator
from typing import Protocol, runtime_checkable

from torch import Tensor

from offairl_lite.config import Config, SACConfig, TD3Config
from offairl_lite.core.experience import Experience
from offairl_lite.core.iq_learn import IQLearn
from offairl_lite.core.policies import Actor
from offairl_lite.core.ppo import PPO
from offairl_lite.core.rng import Rng
from offairl_lite.core.sac import SAC
from offairl_lite.core.shapes import Action, Layout, Metrics, Obs, Params, Vector
from offairl_lite.core.td3 import TD3


@runtime_checkable
class Learner(Protocol):
    """Actor and critics of `S` members, whose observations come scaled."""

    actor: Actor
    actor_params: Params
    state: dict[str, Tensor]
    """The tensors that updates change: themselves, not copies."""

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
