r"""Absorbing states: what follows a termination (Kostrikov et al. 2019, section 4.1).

An imitator that is paid only while the episode lasts learns from the sign of its reward whether to
end it. The cure is to let a terminated episode go on, in a state $s_a$ that never changes, and to
learn the reward there too. Observations get one more coordinate, 1 in $s_a$, where all others are
0, and 0 elsewhere. A time limit never leads to $s_a$. The loop's return is left to the critic
(`bootstrap`), or written down (`analytic`): $R_T = r(s_T, a_T) + \gamma \, r(s_a) / (1 - \gamma)$.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from offairl_lite.core.replay import Batch

Extended = Float[Tensor, "*batch E"]  # with the indicator


def extend(obs: Float[Tensor, "*batch O"]) -> Float[Tensor, "*batch O+1"]:
    """Append the indicator, 0, to ordinary observations."""
    return torch.nn.functional.pad(obs, (0, 1))


def is_absorbing(obs: Extended) -> Bool[Tensor, "*batch"]:
    """Tell which observations are the absorbing state; no normaliser scales the indicator."""
    return obs[..., -1] == 1


def fit(obs: Float[Tensor, "*batch O"], size: int, whose: str) -> Tensor:
    """Return a task's observations in the `size` that `whose` name sees, O or O + 1."""
    width = obs.shape[-1]
    if size not in (width, width + 1):
        sees = f"{size} numbers, or {size - 1} if the last tells of an absorbing state"
        raise ValueError(f"{whose} sees {sees}; it was given {width}")
    return obs if width == size else extend(obs)


def absorbing_state(like: Extended) -> Extended:
    """Return the absorbing state, in the shape and type of extended observations."""
    state = torch.zeros_like(like)
    state[..., -1] = 1
    return state


def rewrite(batch: Batch) -> Batch:
    """Extend transitions by the indicator and send terminations to the absorbing state.

    Then nothing is terminated, and critics bootstrap from its value: that is all of `bootstrap`.
    """
    next_obs, ended = extend(batch.next_obs), batch.terminated.unsqueeze(-1) == 1
    return batch._replace(
        obs=extend(batch.obs),
        next_obs=torch.where(ended, absorbing_state(next_obs), next_obs),
        terminated=torch.zeros_like(batch.terminated),
    )


def loops(rewritten: Batch) -> Batch:
    """Return the absorbing state's own transition, for each episode that reached it, axes `N`."""
    reached = Batch(*(part[is_absorbing(rewritten.next_obs)] for part in rewritten))
    still, zero = torch.zeros_like(reached.pre_tanh), torch.zeros_like(reached.reward)
    return Batch(reached.next_obs, still, reached.next_obs, zero, zero)


def with_absorbing_states(batch: Batch) -> Batch:
    """Return demonstrations, axes `N`, rewritten and with their absorbing transitions."""
    batch = rewrite(batch)
    return Batch(*(torch.cat(parts) for parts in zip(batch, loops(batch), strict=True)))


def loop_of(batch: Batch) -> Batch:
    """Return the absorbing state's own transition, one for each member of a batch `S B`."""
    first = Batch(*(part[:, :1] for part in batch))
    state, still = absorbing_state(first.obs), torch.zeros_like(first.pre_tanh)
    return first._replace(obs=state, pre_tanh=still, next_obs=state)
