r"""Absorbing states: what follows a termination (Kostrikov et al. 2019, section 4.1).

An imitator that is paid only while the episode lasts learns from the sign of its reward whether to
prolong or to end it. The cure is to let a terminated episode go on, in a state $s_a$ that never
changes, and to learn the reward there too. Observations get one more coordinate, 1 in $s_a$ and 0
elsewhere; all other coordinates of $s_a$ are 0.

The loop's return can be left to the critic (`bootstrap`), or written down, since it is a geometric
series (`analytic`, the paper's $R_T$):

$$R_T = r(s_T, a_T) + \gamma \, r(s_a) / (1 - \gamma).$$

Only a termination leads to $s_a$. A time limit never does.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from offairl_lite.core.replay import Batch


def extend(obs: Float[Tensor, "*batch O"]) -> Float[Tensor, "*batch O+1"]:
    """Append the indicator, 0, to ordinary observations."""
    return torch.nn.functional.pad(obs, (0, 1))


def is_absorbing(obs: Float[Tensor, "*batch O+1"]) -> Bool[Tensor, "*batch"]:
    """Tell which observations are the absorbing state.

    Scaled observations will do as well: no normaliser scales the indicator (`even_normaliser`).
    """
    return obs[..., -1] == 1


def fit(obs: Float[Tensor, "*batch O"], size: int, whose: str) -> Float[Tensor, "*batch O+1"]:
    """Return a task's observations as they are seen by what may know of an absorbing state.

    Args:
        obs: of the task, extended or not.
        size: the numbers that are seen: O or, of what knows of an absorbing state, O + 1.
        whose: they are seen by, for the message.

    Raises:
        ValueError: they are of another size.
    """
    there = obs.shape[-1]
    if size not in (there, there + 1):
        raise ValueError(f"{whose} sees {size} numbers, and the task gives {there}")
    return obs if there == size else extend(obs)


def absorbing_state(like: Float[Tensor, "*batch O+1"]) -> Float[Tensor, "*batch O+1"]:
    """Return the absorbing state, in the shape of extended observations."""
    return torch.nn.functional.one_hot(
        torch.full(like.shape[:-1], like.shape[-1] - 1, device=like.device), like.shape[-1]
    ).to(like)


def hold_still(obs: Float[Tensor, "*batch O+1"], *decided: Tensor) -> tuple[Tensor, ...]:
    """Return actions (as `pre_tanh`) and log π, with 0 for both in the absorbing state.

    There is nothing to decide there: the one thing to do is done with certainty, and no gradient
    comes back from it.
    """
    ended = is_absorbing(obs)
    return tuple(
        x.masked_fill(ended.unsqueeze(-1) if x.ndim > ended.ndim else ended, 0) for x in decided
    )


def rewrite(batch: Batch) -> Batch:
    """Extend transitions by the indicator and send terminations to the absorbing state.

    Nothing is terminated afterwards, so the critics' target bootstraps from the value of the
    absorbing state: this is the whole of `bootstrap`.
    """
    next_obs = extend(batch.next_obs)
    ended = batch.terminated.unsqueeze(-1) == 1
    return batch._replace(
        obs=extend(batch.obs),
        next_obs=torch.where(ended, absorbing_state(next_obs), next_obs),
        terminated=torch.zeros_like(batch.terminated),
    )


def loops(rewritten: Batch) -> Batch:
    """Return the absorbing state's own transition, once for each episode that reached it.

    Args:
        rewritten: transitions after `rewrite`, one leading axis.
    """
    ended = is_absorbing(rewritten.next_obs)
    there = rewritten.next_obs[ended]
    still = torch.zeros_like(rewritten.pre_tanh[ended])
    zero = torch.zeros_like(rewritten.reward[ended])
    return Batch(there, still, there, zero, zero)


def with_absorbing_states(batch: Batch) -> Batch:
    """Return demonstrations, one leading axis, rewritten and with their absorbing transitions."""
    batch = rewrite(batch)
    return Batch(*(torch.cat(parts) for parts in zip(batch, loops(batch), strict=True)))


def analytic_return(
    reward: Float[Tensor, "*batch"], absorbing_reward: Float[Tensor, "*batch"], discount: float
) -> Float[Tensor, "*batch"]:
    """Return R_T: the last reward, and the absorbing state's for ever after."""
    return reward + discount * absorbing_reward / (1 - discount)
