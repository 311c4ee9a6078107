"""The maximum entropy distribution over whole paths.

Ziebart, Maas, Bagnell and Dey, "Maximum Entropy Inverse Reinforcement Learning" (2008).
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import csr_array

from offairl_lite.tabular.mdp import MDP
from offairl_lite.tabular.planning import Solution, backward_induction, require_temperature


def path_messages(mdp: MDP, reward: Array, temperature: float = 1.0) -> Solution:
    """Solve the backward recursion of Ziebart et al. (2008) for a distribution over whole paths.

    Given the first state, p(path) ∝ exp(Σ_t r(s_t, a_t)/α) Π_t p(s_t+1 | s_t, a_t). In logarithms:

    Q(s, a) = r(s, a) + α log E[exp(V(s')/α)],  V(s) = α log Σ_a exp(Q(s, a)/α),  V_T = 0.

    This is the causal solution with E[V] replaced by a soft maximum: where the dynamics are random,
    it counts on being lucky. With deterministic dynamics the two solutions are equal.

    The policy of the solution holds the conditionals p(a_t | s_t) of the path distribution. The
    process must have a horizon and discount 1, and α > 0.
    """
    _require_paths(mdp, temperature)

    def look_ahead(value):
        return temperature * _log_expectation(mdp, value / temperature)

    return backward_induction(mdp, mdp.expected_reward(reward), temperature, look_ahead)


def path_occupancy(mdp: MDP, messages: Solution, temperature: float = 1.0) -> Float[Array, "S A"]:
    """Return Σ_t p(s_t = s, a_t = a) under the distribution over paths of `path_messages`.

    This is not the occupancy of its policy: under the distribution over paths the dynamics are
    tilted as well, to p(s' | s, a) exp(V(s')/α) / E[exp(V/α)].
    """
    _require_paths(mdp, temperature)
    total, states = np.zeros(messages.policy.shape[1:]), mdp.initial
    p = mdp.transition
    row = np.repeat(np.arange(p.shape[0]), np.diff(p.indptr))
    for pi, value in zip(messages.policy, [*messages.value[1:], 0 * states], strict=True):
        flow = states[:, None] * pi
        total += flow
        exponent = value / temperature
        tilt = np.exp(exponent[p.indices] - _log_expectation(mdp, exponent).ravel()[row])
        states = csr_array((p.data * tilt, p.indices, p.indptr), p.shape).T @ flow.ravel()
    return total


def _log_expectation(mdp: MDP, exponent: Float[Array, "S"]) -> Float[Array, "S A"]:
    """Return log E[exp(exponent(s')) | s, a]."""
    p = mdp.transition
    terms, first = exponent[p.indices], p.indptr[:-1]
    best = np.maximum.reduceat(terms, first)
    sums = np.add.reduceat(p.data * np.exp(terms - np.repeat(best, np.diff(p.indptr))), first)
    return (best + np.log(sums)).reshape(mdp.num_states, mdp.num_actions)


def _require_paths(mdp: MDP, temperature: float) -> None:
    """Raise ValueError unless these arguments define a distribution over paths."""
    if mdp.horizon is None or mdp.discount != 1:
        raise ValueError(
            "a distribution over whole paths needs a horizon and discount 1, not horizon "
            f"{mdp.horizon} and discount {mdp.discount}; form='causal' takes any"
        )
    require_temperature(temperature, positive=True)
