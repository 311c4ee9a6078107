"""Demonstrations on a tabular process: drawn from a policy, and counted."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from offairl_lite.tabular.mdp import MDP


class Trajectories(NamedTuple):
    """N demonstrations of equal length T, with the state after the last action."""

    states: Int[Array, "N T+1"]
    actions: Int[Array, "N T"]


def sample(
    mdp: MDP,
    policy: Float[Array, "*T S A"],
    episodes: int,
    rng: np.random.Generator,
    length: int | None = None,
) -> Trajectories:
    """Draw N trajectories of a policy, of `length` actions each; by default the horizon."""
    policy = mdp.checked_policy(policy)
    length = mdp.horizon if length is None else length
    if length is None or not 1 <= length <= (mdp.horizon or length):
        raise ValueError(f"length must be from 1 to the horizon, {mdp.horizon}, not {length}")
    steps = policy if policy.ndim == 3 else np.broadcast_to(policy, (length, *policy.shape))
    state = _draw(np.broadcast_to(mdp.initial, (episodes, mdp.num_states)), rng)
    states, actions = [state], []
    for pi in steps[:length]:
        action = _draw(pi[state], rng)
        state = _draw(mdp.transition[state * mdp.num_actions + action].toarray(), rng)
        actions.append(action)
        states.append(state)
    return Trajectories(np.stack(states, 1), np.stack(actions, 1))


def empirical_occupancy(mdp: MDP, trajectories: Trajectories) -> Float[Array, "S A"]:
    """Return the discounted counts of the demonstrated pairs (s, a), averaged over trajectories.

    The result estimates `planning.occupancy` and has the same sum: without a horizon the counts of
    T actions are divided by 1 - γ^T, as if everything later were like the recorded part.
    ValueError names a step that the process does not allow.
    """
    states, actions = (np.asarray(part) for part in trajectories)
    count, length = actions.shape
    if mdp.horizon not in (None, length):
        raise ValueError(f"trajectories have {length} actions, and the horizon is {mdp.horizon}")
    taken = states[:, :-1] * mdp.num_actions + actions
    chance = mdp.transition[taken.ravel(), states[:, 1:].ravel()].reshape(actions.shape)
    for n, t in np.argwhere((chance == 0) | (mdp.initial[states[:, :1]] == 0)):
        step = f"from state {states[n, t]} by action {actions[n, t]} to {states[n, t + 1]}"
        raise ValueError(f"demonstration {n}, step {t}: {step}, or the start, has probability 0")
    weight = mdp.discount ** np.arange(length)
    weight = np.tile(weight * mdp.total_visits / weight.sum() / count, count)
    counts = np.bincount(taken.ravel(), weight, mdp.transition.shape[0])
    return counts.reshape(mdp.num_states, mdp.num_actions)


def _draw(probabilities: Float[Array, "N K"], rng: np.random.Generator) -> Int[Array, "N"]:
    """Draw one index from each row."""
    total = probabilities.cumsum(1)
    return (total > rng.random((len(total), 1)) * total[:, -1:]).argmax(1)
