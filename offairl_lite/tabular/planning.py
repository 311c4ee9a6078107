"""Soft-optimal policies, their values and their occupancies."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import csr_array, eye_array
from scipy.sparse.linalg import spsolve
from scipy.special import entr

from offairl_lite.config.settings import NonNegative, checked
from offairl_lite.tabular.mdp import MDP

_ROUNDING = 1e-12  #: Values that differ by less than this, relative to the largest, count as equal.


class Solution(NamedTuple):
    """log π(a | s), -inf where π is 0, soft V(s) and soft Q(s, a); T is there with a horizon."""

    log_policy: Float[Array, "*T S A"]
    value: Float[Array, "*T S"]
    action_value: Float[Array, "*T S A"]

    @property
    def policy(self) -> Float[Array, "*T S A"]:
        """π(a | s)."""
        return np.exp(self.log_policy)


def soft_value_iteration(
    mdp: MDP, reward: Array, temperature: float = 1.0, guess: Float[Array, "S"] | None = None
) -> Solution:
    """Solve the soft Bellman equations for the policy of greatest return plus α times entropy.

    Q(s, a) = r(s, a) + γ E[V(s')],  V(s) = α log Σ_a exp(Q(s, a)/α),  log π = (Q - V)/α.

    With a horizon they are solved backwards from V_T = 0. Without one, value iteration is
    accelerated: each sweep is followed by the exact evaluation of its policy, a sparse linear
    system. That is Newton's method on V = α log Σ exp(Q/α), and soft policy iteration at the same
    time; it needs about ten sweeps where plain iteration needs of the order of 1/(1 - γ).

    At α = 0 the maximum takes the place of the log-sum-exp: the values are the limit of the soft
    values, and the policy chooses uniformly among the best actions. The limit of the soft policies
    is optimal as well, but where actions tie it prefers actions that keep more ways open.

    Args:
        mdp: the process.
        reward: r, of the state, of the pair, or of the pair and the next state.
        temperature: α ≥ 0, in units of the reward.
        guess: V from which value iteration starts; by default 0. Not used with a horizon.
    """
    reward = mdp.expected_reward(reward)
    checked("temperature", temperature, NonNegative)
    value = np.zeros(mdp.num_states) if guess is None or mdp.horizon else guess
    if mdp.horizon is not None:
        steps = []
        for _ in range(mdp.horizon):
            q = reward + mdp.discount * mdp.expect(value)
            log_policy, value = _soft_maximum(q, temperature)
            steps.append((log_policy, value, q))
        return Solution(*(np.stack(part[::-1]) for part in zip(*steps, strict=True)))
    for _ in range(1000):
        q = reward + mdp.discount * mdp.expect(value)
        log_policy, improved = _soft_maximum(q, temperature)
        size = max(np.abs(improved).max(), np.abs(q).max())
        if np.abs(improved - value).max() <= _ROUNDING * size:
            return Solution(log_policy, improved, q)
        value = soft_evaluation(mdp, np.exp(log_policy), reward, temperature).value
    raise ArithmeticError("soft value iteration has not converged in 1000 sweeps")


def soft_evaluation(
    mdp: MDP, policy: Float[Array, "*T S A"], reward: Array, temperature: float = 1.0
) -> Solution:
    """Return the soft values of a given policy: its return plus α times its entropy.

    V = Σ_a π (Q - α log π) with Q = r + γ E[V(s')]: without a horizon one sparse linear system. At
    α = 0 these are the ordinary values.
    """
    reward = mdp.expected_reward(reward)
    policy = mdp.checked_policy(policy)
    checked("temperature", temperature, NonNegative)
    with np.errstate(divide="ignore"):
        log_policy = np.log(policy)
    gain = (policy * reward + temperature * entr(policy)).sum(-1)
    if mdp.horizon is None:
        value = spsolve(_flow_matrix(mdp, policy), gain)
        return Solution(log_policy, value, reward + mdp.discount * mdp.expect(value))
    steps, value = [], np.zeros(mdp.num_states)
    for pi, g in zip(policy[::-1], gain[::-1], strict=True):
        expected = mdp.discount * mdp.expect(value)
        value = g + (pi * expected).sum(-1)
        steps.append((value, reward + expected))
    return Solution(log_policy, *(np.stack(part[::-1]) for part in zip(*steps, strict=True)))


def occupancy(mdp: MDP, policy: Float[Array, "*T S A"]) -> Float[Array, "S A"]:
    """Return the discounted state-action occupancy ρ(s, a) = Σ_t γ^t P(s_t = s, a_t = a)."""
    policy = mdp.checked_policy(policy)
    if mdp.horizon is None:
        states = spsolve(_flow_matrix(mdp, policy).T.tocsc(), mdp.initial)
        return states[:, None] * policy
    total, states = np.zeros(policy.shape[1:]), mdp.initial
    for pi in policy:
        flow = states[:, None] * pi
        total += flow
        states = mdp.discount * mdp.push(flow)
    return total


def policy_return(mdp: MDP, policy: Float[Array, "*T S A"], reward: Array) -> float:
    """Return the expected discounted return ⟨ρ_π, r⟩ of a policy, without entropy."""
    return float((occupancy(mdp, policy) * mdp.expected_reward(reward)).sum())


def shaping(mdp: MDP, potential: Float[Array, "S"]) -> Float[Array, "S A"]:
    """Return γ E[Φ(s')] - Φ(s), which changes no optimal policy where episodes have no end."""
    potential = np.asarray(potential, dtype=float)
    return mdp.discount * mdp.expect(potential) - potential[:, None]


def _soft_maximum(q: Float[Array, "S A"], temperature: float) -> tuple[Array, Array]:
    """Return log π (S, A) and V (S,) of the policy that maximises Q plus α times entropy."""
    best = q.max(1, keepdims=True)
    if temperature > 0:
        # Relative to the best, or the probabilities would inherit the rounding of Q / α.
        advantage = (q - best) / temperature
        log_total = np.log(np.exp(advantage).sum(1, keepdims=True))
        return advantage - log_total, (best + temperature * log_total)[:, 0]
    # Actions whose values differ by rounding alone are tied.
    ties = q >= best - _ROUNDING * np.abs(q).max()
    with np.errstate(divide="ignore"):
        return np.log(ties / ties.sum(1, keepdims=True)), best[:, 0]


def _flow_matrix(mdp: MDP, policy: Float[Array, "S A"]):
    """Return I - γ P_π, (S, S), compressed by columns."""
    rows = np.arange(mdp.num_states + 1) * mdp.num_actions
    mix = csr_array((policy.ravel(), np.arange(policy.size), rows))
    return (eye_array(mdp.num_states) - mdp.discount * (mix @ mdp.transition)).tocsc()
