r"""What experts in several worlds say about the one reward that they share.

A soft-optimal expert with the temperature α satisfies α log π_i = r + γ_i P_i V_i - V_i in world i.
Its behaviour hides every shaping of its own world, so the worlds together hide what is a shaping in
each of them (Cao, Cohen and Szpruch 2021; Rolland et al. 2022). Constants always are.
"""

from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.cluster.vq import kmeans2, vq

from offairl_lite.config.settings import Positive, checked
from offairl_lite.tabular.mdp import MDP
from offairl_lite.tabular.sampling import Trajectories

_ANGLE = 1e-6  #: A distance below this, the root of a difference of numbers near 1, is rounding.


def shapings(mdp: MDP) -> Float[Array, "S*A S"]:
    """Return the matrix γP - E, which makes the shaping γ E[Φ(s')] - Φ(s) of a potential Φ."""
    of_state = np.repeat(np.eye(mdp.num_states), mdp.num_actions, axis=0)
    return mdp.discount * mdp.transition.toarray() - of_state


class Separation(NamedTuple):
    """What worlds hide together, and how far apart they are.

    `free` counts the directions of r(s, a) in which no behaviour changes; with 1, only a constant
    is left. `distance`, from 0 to √W, is then the share of an error of r that the worlds show at
    least: ‖error‖ ≤ ‖error of all α log π‖ / distance for `shared_reward`, up to the constant. It
    is 0 if more is free.
    """

    free: int
    distance: float


def separation(worlds: Sequence[MDP], seen: Bool[Array, "S A"] | None = None) -> Separation:
    """Return how well W worlds with the same states and actions separate reward from shaping.

    Let Π_i project onto the shapings of world i. What world i shows of an error δ of the reward is
    (1 - Π_i) δ. `free` counts the singular values of all these projections, stacked, that are 0,
    and `distance` is the second smallest of all; the smallest belongs to the constant.

    Args:
        worlds: the processes, with their discounts.
        seen: the pairs (s, a) that count; by default all.
    """
    sines = _hiding(worlds, seen)[1]
    free = int((sines < _ANGLE).sum())
    return Separation(free, float(sines[1]) if free == 1 else 0.0)


def hidden(worlds: Sequence[MDP]) -> Float[Array, "S A free"]:
    """Return an orthonormal basis of what may be added to a reward unnoticed in all worlds."""
    directions, sines = _hiding(worlds)
    basis = directions[:, sines < _ANGLE]
    return basis.reshape(worlds[0].num_states, worlds[0].num_actions, -1)


def _hiding(worlds, seen=None) -> tuple[Float[Array, "N K"], Float[Array, "K"]]:
    """Return orthogonal directions of r(s, a) and what worlds show of each, the least first."""
    rows = slice(None) if seen is None else np.asarray(seen).ravel()
    if len(sizes := {(mdp.num_states, mdp.num_actions) for mdp in worlds}) != 1:
        raise ValueError(f"worlds must have the same states and actions, not (S, A) of {sizes}")
    bases = [scipy.linalg.orth(shapings(mdp)[rows]) for mdp in worlds]
    # With the bases beside each other in Q, the squares of the projections add up to W - QQᵀ.
    directions, cosines, _ = np.linalg.svd(np.hstack(bases), full_matrices=False)
    return directions, np.sqrt(np.clip(len(worlds) - cosines**2, 0, None))


def shared_reward(
    worlds: Sequence[MDP],
    log_policies: Sequence[Float[Array, "S A"]],
    temperature: float = 1.0,
    weights: Sequence[Float[Array, "S A"]] | None = None,
    ridge: float = 1e-12,
    of_state: bool = False,
) -> Float[Array, "S A"]:
    """Return the reward that explains the experts of all worlds best.

    It minimises Σ_i Σ w_i (r + γ_i P_i V_i - V_i - α log π_i)² + ridge ‖r‖² over r and all V_i. The
    default ridge only decides between rewards that explain them equally well: for the smallest.

    Args:
        worlds: the processes.
        log_policies: log π_i, finite, of each world's expert.
        temperature: α > 0 of all experts.
        weights: w_i ≥ 0; by default 1. The variance of α log π̂ is about α² divided by the count.
        ridge: above 0.
        of_state: whether r may depend on the state alone.
    """
    checked("ridge", ridge, Positive)
    count, (s, a) = len(worlds), np.shape(log_policies[0])
    shown = temperature * np.stack(log_policies).reshape(count, s * a, 1)
    w = np.ones_like(shown) if weights is None else np.stack(weights).reshape(shown.shape)

    def mean(x: Float[Array, "W S*A K"]) -> Float[Array, "S*A K"]:
        """The best r for given V_i: of all α log π_i - shaping of V_i, their weighted mean."""
        total, weight = ((w * part).sum(0).reshape(s, a, -1) for part in (x, np.ones_like(shown)))
        if of_state:
            total, weight = (part.mean(1, keepdims=True) for part in (total, weight))
        return np.broadcast_to(total / (weight + ridge), (s, a, x.shape[2])).reshape(s * a, -1)

    of_values = np.zeros((count, s * a, count, s))
    for i, mdp in enumerate(worlds):
        of_values[i, :, i] = shapings(mdp)
    of_values = of_values.reshape(count, s * a, count * s)
    rows, target = (
        np.vstack([*np.sqrt(w) * (part - mean(part)), np.sqrt(ridge) * mean(part)])
        for part in (of_values, shown)
    )
    values = np.linalg.lstsq(rows, target)[0]
    return mean(shown - of_values @ values).reshape(s, a)


def counted(
    trajectories: Trajectories, num_states: int, num_actions: int, discount: float
) -> tuple[MDP, Float[Array, "S A"]]:
    """Return the process of observed frequencies, and counts; give pairs never taken no weight."""
    pairs = trajectories.states[:, :-1] * num_actions + trajectories.actions
    arrivals = np.zeros((num_states * num_actions, num_states))
    np.add.at(arrivals, (pairs.ravel(), trajectories.states[:, 1:].ravel()), 1)
    taken = arrivals.sum(1, keepdims=True)
    stays = np.repeat(np.eye(num_states), num_actions, axis=0)
    transition = np.where(taken > 0, arrivals / np.maximum(taken, 1), stays)
    initial = np.bincount(trajectories.states[:, 0], minlength=num_states) / len(pairs)
    shape = (num_states, num_actions)
    mdp = MDP(transition.reshape(*shape, num_states), initial, discount)
    return mdp, taken.reshape(shape)


class Apart(NamedTuple):
    """How far worlds are apart, by their `worlds`' recordings, and how far `halves` of one are."""

    worlds: float
    halves: float


def apart(
    recordings: Sequence[Any],
    num_states: int = 40,
    num_actions: int = 5,
    discount: float = 0.99,
) -> Apart:
    """Estimate the distance of worlds from recordings with continuous observations and actions.

    Observations, and actions, are put into clusters, and steps between them are counted. Halves of
    one world are apart by chance alone, so the worlds themselves, in halves, must be much farther.
    A distance is 0 if pairs of clusters that all have seen do not tell the worlds apart at all.

    Args:
        recordings: `obs` (N, O), `action` (N, A) and `next_obs` of each world, such as
            `Demonstrations.transitions`: at least ten steps for each pair of clusters. Random
            actions tell more than an expert, who shows few of them.
        num_states: clusters of observations, which are scaled to unit variance.
        num_actions: clusters of actions.
        discount: γ of all worlds.
    """
    checked("recordings", len(recordings), Annotated[int, "of at least 2", lambda n: n > 1])
    rng, worlds = np.random.default_rng(0), range(len(recordings))
    obs, action, to = (
        [np.asarray(getattr(each, part), float) for each in recordings]
        for part in ("obs", "action", "next_obs")
    )
    scale = np.concatenate(obs).std(0)
    scale[scale < 1e-8] = 1
    places = kmeans2(np.concatenate(obs) / scale, num_states, minit="++", seed=rng)[0]
    commands = kmeans2(np.concatenate(action), num_actions, minit="++", seed=rng)[0]
    halves = []
    for i in worlds:
        states = np.stack([vq(x / scale, places)[0] for x in (obs[i], to[i])], 1)
        taken = vq(action[i], commands)[0][:, None]
        middle = len(taken) // 2
        for part in (slice(middle), slice(middle, None)):
            steps = Trajectories(states[part], taken[part])
            halves.append(counted(steps, num_states, num_actions, discount))

    def distance(*chosen: int) -> float:
        mdps, counts = zip(*(halves[i] for i in chosen), strict=True)
        return separation(mdps, np.all(np.stack(counts) > 0, 0)).distance

    by_chance = max(distance(2 * i, 2 * i + 1) for i in worlds)
    return Apart(distance(*(2 * i for i in worlds)), by_chance)
