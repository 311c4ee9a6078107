"""Tabular Markov decision processes, solved exactly: soft optimality and maximum entropy IRL.

In this module S and A are the numbers of states and of actions, T is the horizon; S is not the
population, as it is elsewhere in the package. All is NumPy and SciPy in double precision, for any
MDP given as arrays. Occupancies are sums, not averages: they add up to 1 + γ + γ² + ..., so that
the return of a reward is its sum weighted by the occupancy.

Maximum causal entropy is that of Ziebart, Bagnell and Dey, "Modeling Interaction via the Principle
of Maximum Causal Entropy" (2010); the distribution over paths that of Ziebart, Maas, Bagnell and
Dey, "Maximum Entropy Inverse Reinforcement Learning" (2008).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import csr_array, eye_array, issparse
from scipy.sparse.linalg import spsolve
from scipy.special import entr, logsumexp

from offairl_lite.envs.models import GOAL, START, Side, walls

MOVES = np.array([(0, 0), (1, 0), (0, 1), (-1, 0), (0, -1)])
"""What the maze's actions do, (5, 2): stay, right, up, left, down, in cells along x and y."""
_ROUNDING = 1e-12
"""Values this close, relative to the largest, are the same."""


@dataclass(frozen=True, eq=False)
class MDP:
    """A Markov decision process without its reward.

    Args:
        transition: probabilities p(s' | s, a): an array (S, A, S), or a sparse matrix (S·A, S)
            whose row s·A + a is the distribution of s'. Kept as such a matrix, in CSR form.
        initial: distribution of the first state, (S,).
        discount: γ, from 0 to 1.
        horizon: number of actions T of an episode, or None if it has no end; then γ < 1.

    Raises:
        ValueError: a shape does not fit; a probability is negative or not finite, or a distribution
            does not sum to one; the discount is not in its range; or the horizon is below 1.
    """

    transition: csr_array
    initial: Float[Array, "S"]
    discount: float
    horizon: int | None = None

    def __post_init__(self):
        transition = self.transition
        if not issparse(transition):
            transition = np.asarray(transition, dtype=float)
            if transition.ndim != 3 or transition.shape[0] != transition.shape[2]:
                raise ValueError(
                    f"transition must be an array (S, A, S) or a sparse matrix (S·A, S), not an "
                    f"array {transition.shape}"
                )
            transition = transition.reshape(-1, transition.shape[2])
        transition = csr_array(transition, dtype=float)
        rows, states = transition.shape
        if states == 0 or rows == 0 or rows % states:
            raise ValueError(
                f"a sparse transition must have S·A rows and S columns, not {transition.shape}"
            )
        transition.sum_duplicates()
        transition.eliminate_zeros()
        actions = rows // states
        wrong = np.flatnonzero(~_are_distributions(transition))
        if len(wrong):
            s, a = divmod(int(wrong[0]), actions)
            row = transition[[wrong[0]]].toarray()
            raise ValueError(
                f"transition: the probabilities p(· | s={s}, a={a}) must be at least 0 and sum to "
                f"1, but the least is {row.min():.6g} and the sum {row.sum():.6g} ({len(wrong)} of "
                f"{rows} rows are wrong)"
            )
        initial = np.asarray(self.initial, dtype=float)
        if initial.shape != (states,):
            raise ValueError(f"initial must have shape ({states},), not {initial.shape}")
        if not _are_distributions(initial[None]).all():
            raise ValueError(
                f"initial must be at least 0 and sum to 1; its least is {initial.min():.6g} and "
                f"its sum {initial.sum():.6g}"
            )
        if self.horizon is not None and (self.horizon != int(self.horizon) or self.horizon < 1):
            raise ValueError(
                f"horizon must be a whole number of steps, at least 1, or None for episodes "
                f"without end, not {self.horizon}"
            )
        if not 0 <= self.discount <= 1:
            raise ValueError(f"discount must be from 0 to 1, not {self.discount}")
        if self.horizon is None and self.discount == 1:
            raise ValueError(
                "without a horizon the discount must be below 1, or returns are infinite; choose "
                "a horizon or a discount such as 0.99"
            )
        object.__setattr__(self, "transition", transition)
        object.__setattr__(self, "initial", initial)

    @property
    def num_states(self) -> int:
        """S."""
        return self.transition.shape[1]

    @property
    def num_actions(self) -> int:
        """A."""
        return self.transition.shape[0] // self.num_states

    def expect(self, value: Float[Array, "S"]) -> Float[Array, "S A"]:
        """Return E[value(s') | s, a]."""
        return (self.transition @ value).reshape(self.num_states, self.num_actions)

    def push(self, flow: Float[Array, "S A"]) -> Float[Array, "S"]:
        """Return the flow that arrives in each state s': Σ flow(s, a) p(s' | s, a)."""
        return self.transition.T @ flow.ravel()

    def expected_reward(self, reward: Array) -> Float[Array, "S A"]:
        """Return r(s, a) for a reward r(s), r(s, a) or r(s, a, s'): the mean over s'.

        Args:
            reward: (S,), (S, A) or (S, A, S).

        Raises:
            ValueError: the reward has another shape, or is not finite.
        """
        reward = np.asarray(reward, dtype=float)
        s, a = self.num_states, self.num_actions
        if reward.shape not in ((s,), (s, a), (s, a, s)):
            raise ValueError(
                f"reward must have shape {(s,)}, {(s, a)} or {(s, a, s)}, not {reward.shape}"
            )
        if not np.isfinite(reward).all():
            raise ValueError("reward must be finite; to forbid an action, make it cost much")
        if reward.ndim == 3:
            reward = self.transition.multiply(reward.reshape(s * a, s)).sum(axis=1).reshape(s, a)
        return np.broadcast_to(reward.T, (a, s)).T if reward.ndim == 1 else reward


class Solution(NamedTuple):
    """A policy and its soft values; with a horizon they have a leading axis, the time T."""

    log_policy: Float[Array, "*T S A"]
    """log π(a | s); -inf where π is 0."""
    value: Float[Array, "*T S"]
    """Soft V(s)."""
    action_value: Float[Array, "*T S A"]
    """Soft Q(s, a)."""

    @property
    def policy(self) -> Float[Array, "*T S A"]:
        """π(a | s)."""
        return np.exp(self.log_policy)


def soft_value_iteration(mdp: MDP, reward: Array, temperature: float = 1.0) -> Solution:
    """Solve the soft Bellman equations for the policy of greatest return plus α times entropy.

    Q(s, a) = r(s, a) + γ E[V(s')],  V(s) = α log Σ_a exp(Q(s, a)/α),  log π = (Q - V)/α.

    With a horizon they are solved backwards from V_T = 0. Without one, value iteration is
    accelerated: each sweep is followed by the exact evaluation of its policy, a sparse linear
    system. That is Newton's method on V = α log Σ exp(Q/α), and soft policy iteration at the same
    time; it needs some ten sweeps where plain iteration needs of the order of 1/(1 - γ).

    At α = 0 the maximum takes the place of the log-sum-exp: the values are the limit of the soft
    ones, and the policy chooses uniformly among the best actions. (The limit of the soft policies
    is optimal, too, but where actions tie it prefers those that keep more ways open.)

    Args:
        mdp: the process.
        reward: (S,), (S, A) or (S, A, S).
        temperature: α ≥ 0, in units of the reward.

    Raises:
        ValueError: the reward has another shape or is not finite, or the temperature is negative.
        ArithmeticError: no convergence.
    """
    reward = mdp.expected_reward(reward)
    _check_temperature(temperature)
    if mdp.horizon is not None:
        return _backward(mdp, reward, temperature, mdp.expect)
    value = np.zeros(mdp.num_states)
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

    V = Σ_a π (Q - α log π) with Q = r + γ E[V(s')]: without a horizon one sparse linear system. The
    first entropy counted is that of the state itself, as in V of `soft_value_iteration`.

    Args:
        mdp: the process.
        policy: (S, A), or with a horizon also (T, S, A).
        reward: (S,), (S, A) or (S, A, S).
        temperature: α ≥ 0; with 0 these are the ordinary values.

    Raises:
        ValueError: the policy is none, the reward has another shape or is not finite, or the
            temperature is negative.
    """
    reward = mdp.expected_reward(reward)
    policy = _checked_policy(mdp, policy)
    _check_temperature(temperature)
    with np.errstate(divide="ignore"):
        log_policy = np.log(policy)
    gain = (policy * reward + temperature * entr(policy)).sum(-1)
    if mdp.horizon is None:
        value = spsolve(_flow_matrix(mdp, policy), gain)
        return Solution(log_policy, value, reward + mdp.discount * mdp.expect(value))
    values, qs, next_value = [], [], np.zeros(mdp.num_states)
    for pi, g in zip(policy[::-1], gain[::-1], strict=True):
        expected = mdp.discount * mdp.expect(next_value)
        next_value = g + (pi * expected).sum(-1)
        values.append(next_value)
        qs.append(reward + expected)
    return Solution(log_policy, np.stack(values[::-1]), np.stack(qs[::-1]))


def occupancy(mdp: MDP, policy: Float[Array, "*T S A"]) -> Float[Array, "S A"]:
    """Return the discounted state-action occupancy ρ(s, a) = Σ_t γ^t P(s_t = s, a_t = a).

    Args:
        mdp: the process.
        policy: (S, A), or with a horizon also (T, S, A).

    Raises:
        ValueError: the policy has another shape, or is no distribution over actions.
    """
    policy = _checked_policy(mdp, policy)
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


class Maze(NamedTuple):
    """The shifting maze as a grid, with what is needed to draw and to pay it."""

    mdp: MDP
    positions: Float[Array, "S 2"]
    """Centres of the cells in metres, rows of equal y one after another: `v.reshape(cells, cells)`
    of a state function has y along its first axis and x along its second."""
    reward: Float[Array, "S"]
    """The true reward: minus the distance from the target, in metres."""


def maze(
    cells: int,
    side: Side,
    slip: float = 0.0,
    discount: float = 0.97,
    horizon: int | None = None,
) -> Maze:
    """The shifting maze of `envs`, cut into cells × cells squares.

    The particle is a point that sits in the middle of a square, and moves to the next or stays
    (`MOVES`). A move into a wall leaves it where it is. Both sides have the same states, so that a
    reward can be carried from one to the other.

    Args:
        cells: squares along each side of the maze; its 0.7 m are divided evenly.
        side: the side on which the barrier is attached; `"Left"` leaves the gap on the right.
        slip: probability that the action is replaced by one of the five, drawn at random.
        discount: γ.
        horizon: actions in an episode, or None.

    Raises:
        ValueError: fewer than 3 cells, between which the barrier would find no place; an
            unknown side; a slip outside [0, 1]; or a discount or horizon that `MDP` refuses.
    """
    if cells < 3:
        raise ValueError(f"the maze needs at least 3 cells a side, not {cells}")
    if not 0 <= slip <= 1:
        raise ValueError(f"slip is a probability, not {slip}")
    segments = walls(side)
    low, high = segments[:4].min(), segments[:4].max()
    centres = low + (high - low) * (np.arange(cells) + 0.5) / cells
    states, actions = cells**2, len(MOVES)
    row, column = np.divmod(np.arange(states), cells)
    positions = np.stack([centres[column], centres[row]], 1)

    to_column = np.clip(column[:, None] + MOVES[:, 0], 0, cells - 1)
    to_row = np.clip(row[:, None] + MOVES[:, 1], 0, cells - 1)
    (left, height), (right, _) = segments[4]
    below, x = centres < height, centres[column]
    crosses = (below[row][:, None] != below[to_row]) & ((left < x) & (x < right))[:, None]
    arrival = np.where(crosses, np.arange(states)[:, None], to_row * cells + to_column)

    move = csr_array((np.ones(arrival.size), (np.arange(arrival.size), arrival.ravel())))
    origin = np.repeat(np.arange(states), actions)
    drift = csr_array((np.full(arrival.size, 1 / actions), (origin, arrival.ravel())))
    start = np.linalg.norm(positions - START, axis=1).argmin()
    initial = np.eye(states)[start]
    mdp = MDP((1 - slip) * move + slip * drift[origin], initial, discount, horizon)
    return Maze(mdp, positions, -np.linalg.norm(positions - GOAL, axis=1))


def _soft_maximum(q: Float[Array, "S A"], temperature: float) -> tuple[Array, Array]:
    """log π (S, A) and V (S,) of the policy that is best for Q plus entropy."""
    best = q.max(1, keepdims=True)
    if temperature > 0:
        # Relative to the best, or the probabilities would inherit the rounding of Q / α.
        advantage = (q - best) / temperature
        log_total = logsumexp(advantage, axis=1, keepdims=True)
        return advantage - log_total, (best + temperature * log_total)[:, 0]
    # What rounding alone has parted is a tie.
    ties = q >= best - _ROUNDING * np.abs(q).max()
    with np.errstate(divide="ignore"):
        return np.log(ties / ties.sum(1, keepdims=True)), best[:, 0]


def _backward(mdp: MDP, reward: Float[Array, "S A"], temperature: float, look_ahead) -> Solution:
    """Backward induction from V_T = 0; `look_ahead` makes (S, A) of the next value."""
    steps, value = [], np.zeros(mdp.num_states)
    for _ in range(mdp.horizon):
        q = reward + mdp.discount * look_ahead(value)
        log_policy, value = _soft_maximum(q, temperature)
        steps.append((log_policy, value, q))
    return Solution(*(np.stack(part[::-1]) for part in zip(*steps, strict=True)))


def _flow_matrix(mdp: MDP, policy: Float[Array, "S A"]):
    """I - γ P_π, (S, S), compressed by columns."""
    rows = np.arange(mdp.num_states + 1) * mdp.num_actions
    mix = csr_array((policy.ravel(), np.arange(policy.size), rows))
    return (eye_array(mdp.num_states) - mdp.discount * (mix @ mdp.transition)).tocsc()


def _are_distributions(rows) -> Array:
    """Whether each row, dense or sparse, is at least 0 and sums to one, (N,)."""
    return (abs(rows.sum(axis=1) - 1) < 1e-6) & (abs(rows).sum(axis=1) - rows.sum(axis=1) == 0)


def _check_temperature(temperature: float) -> None:
    if not 0 <= temperature < np.inf:
        raise ValueError(f"temperature must be at least 0 and finite, not {temperature}")


def _checked_policy(mdp: MDP, policy: Array) -> Float[Array, "*T S A"]:
    policy = np.asarray(policy, dtype=float)
    shape = (mdp.num_states, mdp.num_actions)
    timed = shape if mdp.horizon is None else (mdp.horizon, *shape)
    if policy.shape not in (shape, timed):
        allowed = f"{shape}" if mdp.horizon is None else f"{shape} or {timed}"
        raise ValueError(f"policy must have shape {allowed}, not {policy.shape}")
    if not _are_distributions(policy.reshape(-1, shape[1])).all():
        raise ValueError(
            "policy must be at least 0 and sum to 1 over the actions of every state; the sums are "
            f"from {policy.sum(-1).min():.6g} to {policy.sum(-1).max():.6g} (pass probabilities, "
            "not their logarithms)"
        )
    return np.broadcast_to(policy, timed)
