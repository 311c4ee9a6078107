"""State-only DAC: a discriminator that judges steps from state to state, and sees no action.

Its logit is any function g(s, s'), without AIRL's form r + γ V(s') - V(s): two things that
off-policy AIRL with r(s) changes at once are told apart (Torabi et al. 2018 learn on-policy so).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch

from offairl_lite.config import DiscriminatorConfig
from offairl_lite.core.discriminator import (
    Discriminator,
    LogDensity,
    Transitions,
    make_discriminator,
)
from offairl_lite.core.replay import Batch
from offairl_lite.core.rewards import OF_LOGIT
from offairl_lite.core.shapes import Vector


@dataclass(frozen=True)
class StatePairsConfig(DiscriminatorConfig):
    """State-only DAC."""

    kind = "state-pairs"

    def conflicts(self) -> Iterator[str]:
        """Yield what does not fit together, and what to do about it."""
        yield from super().conflicts()
        if self.reward not in OF_LOGIT:
            yield f"reward {self.reward!r} has a form of its own: use reward='dac', or gail's"
        if self.reward_sees is not None:
            yield f"reward_sees is {self.reward_sees}, and g sees both states whole: set it to None"


class StatePairs(Discriminator):
    """Judges g(s, s'): the next state stands where the action does in DAC."""

    def __init__(
        self, config: DiscriminatorConfig, obs_dim: int, action_dim: int, *rest: Any
    ) -> None:
        super().__init__(config, obs_dim, obs_dim, *rest)

    def seen(self, batch: Batch) -> Transitions:
        """Return transitions as the discriminator sees them: without their actions."""
        transitions = super().seen(batch)
        return transitions._replace(action=transitions.next_obs)

    @property
    def frozen(self) -> None:  # type: ignore[override]
        """There is no r(s) or r(s, a) to use again: g judges steps."""
        return None

    @torch.no_grad()
    def reward(self, batch: Batch, log_density: LogDensity) -> Vector:
        """Return the learner's reward, a function of g(s, s')."""
        return OF_LOGIT[self.config.reward](self.f(self.seen(batch)))


make_discriminator.register(StatePairsConfig, StatePairs)
