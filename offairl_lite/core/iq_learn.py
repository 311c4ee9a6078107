"""IQ-Learn: critics that contain the reward (Garg et al. 2021), for a population.

Every soft Q-function is optimal for one reward, r = Q(s, a) - γ V(s'). So nothing else has to be
learned: the critics make the expert's steps pay and the policy's cost. Actor and temperature are
SAC's. There is no r(s) or r(s, a) to use again, since this one depends on s' as well.
"""

import torch

from offairl_lite.core.replay import Batch
from offairl_lite.core.sac import SAC
from offairl_lite.core.shapes import Action, Obs, Scalar, TwinQ, Vector

REGULARISER = 0.5  #: 1/(4α) before E r², for α = 0.5 (released code).


def iq_loss(q: TwinQ, value: TwinQ, next_value: Vector) -> Scalar:
    """Return -E_expert r + E[V(s) - γ V(s')] + E r²/(4α), r = Q(s, a) - γ V(s'), of both critics.

    The first half of a minibatch is the expert's; E is over both. `next_value` is γ (1 -
    terminated) V(s') by the targets. E[V(s) - γ V(s')] is (1 - γ) E V(s₀), telescoped (Garg et al.
    2021, algorithm 1, with χ²; "value" in their code).
    """
    reward = q - next_value
    expert, _ = reward.chunk(2, -1)
    loss = (value - next_value).mean(-1) - expert.mean(-1)
    return (loss + REGULARISER * reward.square().mean(-1)).sum()


class IQLearn(SAC):
    """SAC whose critics descend `iq_loss`, on minibatches of two halves, and see no reward.

    Each critic has its own V(s). With the smaller of both, as in the released code, the gradient of
    V goes to one critic alone, and on Hopper E r² kept growing. E r² is over the actions that were
    taken, not over the policy's own. The `critic_loss` that is reported is E r².
    """

    draws = 3  # One more, for V(s).

    def target(self, batch: Batch, noise: Action) -> Vector:
        """Return γ (1 - terminated) V(s'), the part of Q that is not the reward."""
        return super().target(batch._replace(reward=torch.zeros_like(batch.reward)), noise)

    def critic_loss(self, q: TwinQ, target: Vector, obs: Obs, noise: Action) -> Scalar:
        """Return IQ-Learn's loss, with V(s) at actions that `noise` draws from π."""
        with torch.no_grad():
            sampled = self.actor.sample(self.actor_params, obs, noise)
            pre_tanh, log_prob = self.mask_absorbing(obs, *sampled)
        q_of_policy = self.critic(self.critic_params, obs, torch.tanh(pre_tanh))
        return iq_loss(q, q_of_policy - self.log_alpha.detach().exp() * log_prob, target)
