"""State-only DAC: its logit is any function g(s, s'), and sees no action.

It has no form r + γ V(s') - V(s) either. Torabi et al. (2018) learn like this on-policy.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from offairl_lite.config import DiscriminatorConfig
from offairl_lite.core.discriminator import Discriminator, Transitions, make_discriminator
from offairl_lite.core.networks import Normaliser
from offairl_lite.core.replay import Batch
from offairl_lite.core.rewards import OF_LOGIT
from offairl_lite.core.shapes import Layout, Vector


@dataclass(frozen=True)
class StatePairsConfig(DiscriminatorConfig):
    """State-only DAC."""

    kind, selects = "state-pairs", False

    def conflicts(self) -> Iterator[str]:
        """Yield what does not fit together, and what to do about it."""
        yield from super().conflicts()
        if self.reward not in OF_LOGIT:
            yield f"reward {self.reward!r} has a form of its own: use reward='dac', or gail's"


class StatePairs(Discriminator):
    """Judges g(s, s'): the next state stands where the action does in DAC."""

    def __init__(self, config: DiscriminatorConfig, layout: Layout) -> None:
        super().__init__(config, layout._replace(action_dim=layout.obs_dim))

    def transitions(self, batch: Batch, log_prob: Vector) -> Transitions:
        """Return transitions as the discriminator looks at them: without their actions."""
        return Transitions(batch.obs, batch.next_obs, batch.next_obs, log_prob)

    def snapshot(self, env_id: str, normaliser: Normaliser) -> None:
        """There is no r(s) or r(s, a) to use again: g judges steps."""
        return None


make_discriminator.register(StatePairsConfig, StatePairs)
