"""Twin delayed deterministic policy gradient (Fujimoto et al. 2018), for a population.

It differs from SAC in the clipped noise on the next action, and in having no entropy.
"""

import torch

from offairl_lite.config import TD3Config
from offairl_lite.core.networks import descend
from offairl_lite.core.rng import Rng
from offairl_lite.core.sac import OffPolicy
from offairl_lite.core.shapes import Action, Layout, Obs, Params, Vector

SMOOTHING_STD = 0.2
SMOOTHING_CLIP = 0.5


def smoothed_action(action: Action, noise: Action) -> Action:
    """Return clip(a + clip(ε, ±0.5), ±1) with ε of standard deviation 0.2 (their equation 14)."""
    noise = (SMOOTHING_STD * noise).clamp(-SMOOTHING_CLIP, SMOOTHING_CLIP)
    return (action + noise).clamp(-1, 1)


class TD3(OffPolicy):
    """Actor, twin critics and all their targets, for `S` members; see `OffPolicy`."""

    def __init__(self, config: TD3Config, layout: Layout) -> None:
        super().__init__(config, layout)
        self.target_actor_params = self.actor_params.detach().clone()
        self.state["target_actor"] = self.target_actor_params

    @torch.no_grad()
    def init(self, rng: Rng) -> None:
        """Draw the initial weights, in place."""
        super().init(rng)
        self.target_actor_params.copy_(self.actor_params)

    def log_prob(self, actor_params: Params, obs: Obs, pre_tanh: Action) -> Vector:
        """Raise TypeError: there is no density."""
        raise TypeError("td3's policy is deterministic and has no log π")

    def update_actor(self, obs: Obs, noise: Action) -> None:
        """Take one step up the first critic; the actor's target follows."""
        (action,) = self.mask_absorbing(obs, self.actor.mode(self.actor_params, obs))
        # Detached, so that no gradient of the critics' weights is computed.
        q = self.critic(self.critic_params.detach(), obs, action)[0]
        descend(-q.mean(-1).sum(), self.actor_optimizer)
        with torch.no_grad():
            self.target_actor_params.lerp_(self.actor_params, self.config.target_rate)

    def value(self, obs: Obs, noise: Action) -> Vector:
        """Return V(s) by the target critics, at the target actor's action, smoothed."""
        mode = self.actor.mode(self.target_actor_params, obs)
        (action,) = self.mask_absorbing(obs, smoothed_action(mode, noise))
        return self.critic(self.target_params, obs, action).amin(0)
