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
from typing import Literal, NamedTuple, get_args

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.optimize import minimize
from scipy.sparse import csr_array, eye_array, issparse
from scipy.sparse.linalg import spsolve
from scipy.special import entr

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
    return _accelerated(mdp, reward, temperature, np.zeros(mdp.num_states))


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


class Trajectories(NamedTuple):
    """N demonstrations of equal length T."""

    states: Int[Array, "N T+1"]
    """The states visited, the one after the last action among them."""
    actions: Int[Array, "N T"]


def sample(
    mdp: MDP,
    policy: Float[Array, "*T S A"],
    episodes: int,
    rng: np.random.Generator,
    length: int | None = None,
) -> Trajectories:
    """Let a policy act.

    Args:
        mdp: the process.
        policy: (S, A), or with a horizon also (T, S, A).
        episodes: number of trajectories, N.
        rng: the source of all randomness.
        length: actions in each; the horizon where there is one and nothing else is said.

    Raises:
        ValueError: the policy is none; or the length is below 1, beyond the horizon, or missing
            where there is no horizon.
    """
    policy = _checked_policy(mdp, policy)
    length = mdp.horizon if length is None else length
    if length is None or not 1 <= length <= (mdp.horizon or length):
        raise ValueError(
            f"length must be at least 1 and at most the horizon, {mdp.horizon}, not {length}; "
            "where there is no horizon it must be given"
        )
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

    It estimates `occupancy`, and adds up to the same: without a horizon the counts of T actions are
    divided by 1 - γ^T, as if all that comes later were like what was seen.

    Args:
        mdp: the process in which they were recorded.
        trajectories: N of them.

    Raises:
        ValueError: the shapes do not fit, or not the horizon; a state or an action is not one of
            the process; or a trajectory starts or goes where the process cannot: which one, and at
            which step.
    """
    states, actions = (np.asarray(part) for part in trajectories)
    if (
        states.ndim != 2
        or 0 in actions.shape
        or (len(states), states.shape[1] - 1) != actions.shape
    ):
        raise ValueError(
            f"expected states (N, T + 1) and actions (N, T), got {states.shape} and {actions.shape}"
        )
    length = actions.shape[1]
    if mdp.horizon not in (None, length):
        raise ValueError(
            f"trajectories of {length} actions cannot be compared with occupancies over the "
            f"horizon {mdp.horizon}; make the two equal"
        )
    for name, index, bound in (
        ("state", states, mdp.num_states),
        ("action", actions, mdp.num_actions),
    ):
        if index.min() < 0 or index.max() >= bound:
            raise ValueError(
                f"a {name} must be from 0 to {bound - 1}, but they are from {index.min()} to "
                f"{index.max()}"
            )
    rows = states[:, :-1] * mdp.num_actions + actions
    for t in range(length):
        chance = mdp.transition[rows[:, t]].toarray()[np.arange(len(rows)), states[:, t + 1]]
        if (chance == 0).any():
            n = int(np.flatnonzero(chance == 0)[0])
            raise ValueError(
                f"demonstration {n} goes at step {t} from state {states[n, t]} by action "
                f"{actions[n, t]} to state {states[n, t + 1]}, which has probability 0; is the "
                "process the one it was recorded in?"
            )
    if (mdp.initial[states[:, 0]] == 0).any():
        n = int(np.flatnonzero(mdp.initial[states[:, 0]] == 0)[0])
        raise ValueError(
            f"demonstration {n} starts in state {states[n, 0]}, whose initial probability is 0"
        )
    weight = mdp.discount ** np.arange(length)
    weight = np.tile(weight * _mass(mdp) / weight.sum() / len(rows), len(rows))
    counts = np.bincount(rows.ravel(), weight, mdp.transition.shape[0])
    return counts.reshape(mdp.num_states, mdp.num_actions)


def path_messages(mdp: MDP, reward: Array, temperature: float = 1.0) -> Solution:
    """Solve the backward recursion of Ziebart et al. (2008) for a distribution over whole paths.

    Given the first state, p(path) ∝ exp(Σ_t r(s_t, a_t)/α) Π_t p(s_t+1 | s_t, a_t). In logarithms:

    Q(s, a) = r(s, a) + α log E[exp(V(s')/α)],  V(s) = α log Σ_a exp(Q(s, a)/α),  V_T = 0.

    This is the causal solution with E[V] replaced by a maximum in soft form: where the dynamics are
    random, it counts on being lucky. Where they are not, the two are the same.

    Args:
        mdp: the process, with a horizon and discount 1.
        reward: (S,), (S, A) or (S, A, S).
        temperature: α > 0.

    Returns:
        The conditionals p(a_t | s_t) of the path distribution, with V and Q.

    Raises:
        ValueError: no horizon, a discount below 1, a temperature that is not above 0, or a reward
            that does not fit.
    """
    _check_paths(mdp, temperature)

    def look_ahead(value):
        return temperature * _log_expectation(mdp, value / temperature)

    return _backward(mdp, mdp.expected_reward(reward), temperature, look_ahead)


def path_occupancy(mdp: MDP, messages: Solution, temperature: float = 1.0) -> Float[Array, "S A"]:
    """Return Σ_t p(s_t = s, a_t = a) under the distribution over paths of `path_messages`.

    Not the occupancy of its policy: under the distribution over paths the dynamics are tilted as
    well, p(s' | s, a) exp(V(s')/α) / E[exp(V/α)].

    Args:
        mdp: the process, with a horizon and discount 1.
        messages: the result of `path_messages`.
        temperature: the same α.

    Raises:
        ValueError: no horizon, a discount below 1, or a temperature that is not above 0.
    """
    _check_paths(mdp, temperature)
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


Form = Literal["causal", "paths"]


def log_likelihood(
    mdp: MDP,
    reward: Array,
    demonstrated: Float[Array, "S A"],
    temperature: float = 1.0,
    form: Form = "causal",
) -> tuple[float, Float[Array, "S A"]]:
    """Return the log-likelihood of demonstrations under a reward, and its gradient in r(s, a).

    L = (⟨ρ_E, r⟩ - E[V(s_0)])/α,  ∂L/∂r = (ρ_E - ρ)/α

    with V and ρ of the soft optimum (`"causal"`) or of the distribution over paths (`"paths"`). It
    is concave. In the causal form it is Σ_t γ^t log π(a_t | s_t) if ρ_E is the occupancy of some
    policy; counts of sampled demonstrations are that only on average where the dynamics or the
    first state are random, and L is then the dual of matching them. In the form of paths a constant
    is left out, the logarithm of the demonstrated Π p(s' | s, a).

    Args:
        mdp: the process; for `"paths"` with a horizon and discount 1.
        reward: (S,), (S, A) or (S, A, S).
        demonstrated: ρ_E, from `occupancy` or `empirical_occupancy`.
        temperature: α > 0.
        form: `"causal"` or `"paths"`.

    Returns:
        L, and its gradient (S, A). For a reward r(s), sum it over the actions.

    Raises:
        ValueError: the form is unknown; what `soft_value_iteration` or `path_messages` refuse; a
            temperature that is not above 0; or `demonstrated` has another shape, is negative, adds
            up to something else than occupancies do, or visits what cannot be reached.
    """
    reward = mdp.expected_reward(reward)
    _check_positive(temperature)
    demonstrated = np.asarray(demonstrated, dtype=float)
    _check_demonstrated(mdp, demonstrated)
    guess = np.zeros(mdp.num_states)
    return _likelihood(mdp, reward, demonstrated, temperature, form, guess)[:2]


class Fit(NamedTuple):
    """What `maxent_irl` has found."""

    reward: Array
    """(S,) or (S, A), as the features are."""
    weights: Float[Array, "K"]
    history: Float[Array, "I K"]
    """The weights before the first step and after each."""
    log_likelihood: Float[Array, "I"]
    """At these weights, without the penalty."""
    mismatch: float
    """Largest difference between demonstrated and learned feature expectations."""


def maxent_irl(
    mdp: MDP,
    demonstrated: Float[Array, "S A"],
    features,
    temperature: float = 1.0,
    form: Form = "causal",
    penalty: float = 0.0,
    iterations: int = 500,
) -> Fit:
    """Learn the reward of greatest likelihood, linear in features: r = features @ weights.

    Maximises L - penalty/2 ‖weights‖², a concave function, with L-BFGS from weights 0. Without a
    penalty its maximum matches the demonstrated feature expectations; it need not be finite, since
    what is never seen is best valued at -∞. One feature per state, `scipy.sparse.eye_array(S)`,
    learns any r(s); one per pair, `eye_array(S * A)`, any r(s, a).

    Args:
        mdp: the process.
        demonstrated: ρ_E (S, A), from `occupancy` or `empirical_occupancy`.
        features: dense or sparse, (S, K) for a reward of the state, (S·A, K) for one of the pair.
        temperature: α > 0, the unit of the reward; the data know only r/α.
        form: `"causal"` or `"paths"`, see `log_likelihood`.
        penalty: λ ≥ 0.
        iterations: at most.

    Raises:
        ValueError: features of another shape, a negative penalty, or what `log_likelihood` refuses.
    """
    s, a = mdp.num_states, mdp.num_actions
    if features.ndim != 2 or features.shape[0] not in (s, s * a):
        raise ValueError(f"features must be ({s}, K) or ({s * a}, K), not {features.shape}")
    if not penalty >= 0:
        raise ValueError(f"penalty must be at least 0, not {penalty}")
    _check_positive(temperature)
    demonstrated = np.asarray(demonstrated, dtype=float)
    _check_demonstrated(mdp, demonstrated)
    guess = np.zeros(s)
    of_state = features.shape[0] == s

    def reward_of(weights):
        return (features @ weights).reshape((s,) if of_state else (s, a))

    def loss(weights):
        nonlocal guess
        value, gradient, guess = _likelihood(
            mdp, mdp.expected_reward(reward_of(weights)), demonstrated, temperature, form, guess
        )
        gradient = features.T @ (gradient.sum(1) if of_state else gradient.ravel())
        return penalty / 2 * weights @ weights - value, penalty * weights - gradient

    start = np.zeros(features.shape[1])
    steps = [(start, -loss(start)[0])]

    def keep(intermediate_result):
        weights, value = intermediate_result.x.copy(), -intermediate_result.fun
        steps.append((weights, value + penalty / 2 * weights @ weights))

    found = minimize(
        loss,
        start,
        jac=True,
        method="L-BFGS-B",
        callback=keep,
        options={
            "maxiter": iterations,
            "maxfun": 2 * iterations,
            "maxcor": 20,
            "ftol": 0,
            "gtol": 1e-9 * demonstrated.sum() / temperature,
        },
    )
    history, likelihood = (np.array(part) for part in zip(*steps, strict=True))
    mismatch = temperature * np.abs(found.jac - penalty * found.x).max()
    return Fit(reward_of(found.x), found.x, history, likelihood, mismatch)


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
    if side not in get_args(Side):
        raise ValueError(f"side must be 'Left' or 'Right', not {side!r}")
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
        log_total = np.log(np.exp(advantage).sum(1, keepdims=True))
        return advantage - log_total, (best + temperature * log_total)[:, 0]
    # What rounding alone has parted is a tie.
    ties = q >= best - _ROUNDING * np.abs(q).max()
    with np.errstate(divide="ignore"):
        return np.log(ties / ties.sum(1, keepdims=True)), best[:, 0]


def _accelerated(
    mdp: MDP, reward: Float[Array, "S A"], temperature: float, value: Float[Array, "S"]
) -> Solution:
    """Value iteration from a first guess, each sweep followed by the evaluation of its policy."""
    for _ in range(1000):
        q = reward + mdp.discount * mdp.expect(value)
        log_policy, improved = _soft_maximum(q, temperature)
        size = max(np.abs(improved).max(), np.abs(q).max())
        if np.abs(improved - value).max() <= _ROUNDING * size:
            return Solution(log_policy, improved, q)
        value = soft_evaluation(mdp, np.exp(log_policy), reward, temperature).value
    raise ArithmeticError("soft value iteration has not converged in 1000 sweeps")


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


def _likelihood(
    mdp: MDP,
    reward: Float[Array, "S A"],
    demonstrated: Float[Array, "S A"],
    temperature: float,
    form: Form,
    guess: Float[Array, "S"],
) -> tuple[float, Float[Array, "S A"], Float[Array, "S"]]:
    """`log_likelihood`, begun at a guess of V; and V, to be the next guess."""
    if form == "paths":
        solution = path_messages(mdp, reward, temperature)
        visits = path_occupancy(mdp, solution, temperature)
    elif form == "causal":
        if mdp.horizon is None:
            solution = _accelerated(mdp, reward, temperature, guess)
        else:
            solution = soft_value_iteration(mdp, reward, temperature)
        visits = occupancy(mdp, solution.policy)
    else:
        raise ValueError(f"form must be 'causal' or 'paths', not {form!r}")
    first = solution.value if mdp.horizon is None else solution.value[0]
    value = ((demonstrated * reward).sum() - mdp.initial @ first) / temperature
    return float(value), (demonstrated - visits) / temperature, first


def _log_expectation(mdp: MDP, exponent: Float[Array, "S"]) -> Float[Array, "S A"]:
    """log E[exp(exponent(s')) | s, a]."""
    p = mdp.transition
    terms, first = exponent[p.indices], p.indptr[:-1]
    best = np.maximum.reduceat(terms, first)
    sums = np.add.reduceat(p.data * np.exp(terms - np.repeat(best, np.diff(p.indptr))), first)
    return (best + np.log(sums)).reshape(mdp.num_states, mdp.num_actions)


def _draw(probabilities: Float[Array, "N K"], rng: np.random.Generator) -> Int[Array, "N"]:
    """One index from each row."""
    total = probabilities.cumsum(1)
    return (total > rng.random((len(total), 1)) * total[:, -1:]).argmax(1)


def _check_paths(mdp: MDP, temperature: float) -> None:
    if mdp.horizon is None or mdp.discount != 1:
        raise ValueError(
            "a distribution over whole paths needs a horizon and discount 1, not horizon "
            f"{mdp.horizon} and discount {mdp.discount}; form='causal' takes any"
        )
    _check_positive(temperature)


def _check_positive(temperature: float) -> None:
    if not 0 < temperature < np.inf:
        raise ValueError(f"temperature must be above 0 and finite, not {temperature}")


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


def _mass(mdp: MDP) -> float:
    """1 + γ + γ² + ..., what every occupancy adds up to."""
    if mdp.horizon is None:
        return 1 / (1 - mdp.discount)
    return float((mdp.discount ** np.arange(mdp.horizon)).sum())


def _check_demonstrated(mdp: MDP, demonstrated: Float[Array, "S A"]) -> None:
    """Refuse what no policy of the process can have done."""
    shape = (mdp.num_states, mdp.num_actions)
    if demonstrated.shape != shape:
        raise ValueError(f"demonstrated must have shape {shape}, not {demonstrated.shape}")
    if not ((demonstrated >= 0) & (demonstrated < np.inf)).all():
        raise ValueError("demonstrated must hold visits, which are at least 0 and finite")
    if not np.isclose(demonstrated.sum(), _mass(mdp), rtol=1e-4):
        raise ValueError(
            f"demonstrated adds up to {demonstrated.sum():.6g}, but every occupancy of the process "
            f"to {_mass(mdp):.6g}; count with the same discount and horizon, over whole episodes, "
            "or every reward is too high or too low"
        )
    reached = mdp.initial > 0
    for _ in range(mdp.num_states if mdp.horizon is None else mdp.horizon - 1):
        grown = reached | (mdp.push(np.broadcast_to(reached[:, None], shape)) > 0)
        if (grown == reached).all():
            break
        reached = grown
    lost = np.flatnonzero((demonstrated > 0).any(1) & ~reached)
    if len(lost):
        raise ValueError(
            f"demonstrations visit {len(lost)} states that no policy reaches from the initial "
            f"distribution, the first of them {lost[0]}"
        )
