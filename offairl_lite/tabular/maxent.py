"""Maximum causal entropy inverse reinforcement learning (Ziebart, Bagnell and Dey 2010)."""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float
from numpy import ndarray as Array

from offairl_lite.config.settings import NonNegative, Positive, checked
from offairl_lite.tabular.mdp import MDP
from offairl_lite.tabular.planning import occupancy, soft_value_iteration


def log_likelihood(
    mdp: MDP, reward: Array, demonstrated: Float[Array, "S A"], temperature: float = 1.0
) -> tuple[float, Float[Array, "S A"]]:
    """Return the log-likelihood of demonstrations under a reward, and its gradient in r(s, a).

    L = (⟨ρ_E, r⟩ - E[V(s_0)])/α,  ∂L/∂r = (ρ_E - ρ)/α

    with V and ρ of the soft optimum. L is concave. It is Σ_t γ^t log π(a_t | s_t) if ρ_E is the
    occupancy of some policy. For counts of sampled demonstrations that holds only on average where
    the dynamics or the first state are random, and L is then the dual of matching the counts.

    Args:
        mdp: the process.
        reward: r; if it is r(s), sum the gradient over the actions.
        demonstrated: ρ_E, from `planning.occupancy` or `sampling.empirical_occupancy`.
        temperature: α > 0.
    """
    reward = mdp.expected_reward(reward)
    demonstrated = _checked(mdp, demonstrated, temperature)
    return _likelihood(mdp, reward, demonstrated, temperature)[:2]


class Fit(NamedTuple):
    """The result of `maxent_irl`; the reward is (S,) or (S, A), as the features are.

    `history` has the weights before the first step and after each, with their log-likelihood
    without the penalty. `mismatch` is the largest difference between demonstrated and learned
    feature expectations.
    """

    reward: Array
    weights: Float[Array, "K"]
    history: Float[Array, "I K"]
    log_likelihood: Float[Array, "I"]
    mismatch: float


def maxent_irl(
    mdp: MDP,
    demonstrated: Float[Array, "S A"],
    features,
    temperature: float = 1.0,
    penalty: float = 0.0,
    iterations: int = 500,
) -> Fit:
    """Learn the reward of greatest likelihood, linear in features: r = features @ weights.

    L-BFGS maximises L - penalty/2 ‖weights‖², a concave function, from weights 0. Without a penalty
    the maximum matches the demonstrated feature expectations; it need not be finite, since the best
    reward of a pair that is never seen is -∞. One feature per state, `scipy.sparse.eye_array(S)`,
    learns any r(s); one per pair, `eye_array(S * A)`, any r(s, a).

    Args:
        mdp: the process.
        demonstrated: ρ_E, as in `log_likelihood`.
        features: dense or sparse, (S, K) for a reward of the state, (S·A, K) for one of the pair.
        temperature: α > 0, the unit of the reward; demonstrations determine only r/α.
        penalty: λ ≥ 0.
        iterations: the largest number of steps.
    """
    s, a = mdp.num_states, mdp.num_actions
    if features.ndim != 2 or features.shape[0] not in (s, s * a):
        raise ValueError(f"features must be ({s}, K) or ({s * a}, K), not {features.shape}")
    checked("penalty", penalty, NonNegative)
    demonstrated = _checked(mdp, demonstrated, temperature)
    of_state = features.shape[0] == s
    guess = np.zeros(s)

    def reward_of(weights):
        return (features @ weights).reshape((s,) if of_state else (s, a))

    def loss(weights):
        nonlocal guess
        reward = mdp.expected_reward(reward_of(weights))
        value, gradient, guess = _likelihood(mdp, reward, demonstrated, temperature, guess)
        gradient = features.T @ (gradient.sum(1) if of_state else gradient.ravel())
        return penalty / 2 * weights @ weights - value, penalty * weights - gradient

    start = np.zeros(features.shape[1])
    steps = [(start, -loss(start)[0])]

    def keep(intermediate_result):
        weights, value = intermediate_result.x.copy(), -intermediate_result.fun
        steps.append((weights, value + penalty / 2 * weights @ weights))

    tolerance = {"ftol": 0, "gtol": 1e-9 * demonstrated.sum() / temperature}
    options = {"maxiter": iterations, "maxfun": 2 * iterations, "maxcor": 20, **tolerance}
    optimum = scipy.optimize.minimize(
        loss, start, jac=True, method="L-BFGS-B", callback=keep, options=options
    )
    history, likelihood = (np.array(part) for part in zip(*steps, strict=True))
    mismatch = temperature * np.abs(optimum.jac - penalty * optimum.x).max()
    return Fit(reward_of(optimum.x), optimum.x, history, likelihood, mismatch)


def _likelihood(
    mdp: MDP,
    reward: Float[Array, "S A"],
    demonstrated: Float[Array, "S A"],
    temperature: float,
    guess: Float[Array, "S"] | None = None,
) -> tuple[float, Float[Array, "S A"], Float[Array, "S"]]:
    """Return L, its gradient and V at the first step; planning starts at a guess of that V."""
    solution = soft_value_iteration(mdp, reward, temperature, guess)
    first = solution.value if mdp.horizon is None else solution.value[0]
    value = ((demonstrated * reward).sum() - mdp.initial @ first) / temperature
    visits = occupancy(mdp, solution.policy)
    return float(value), (demonstrated - visits) / temperature, first


def _checked(mdp: MDP, demonstrated: Array, temperature: float) -> Float[Array, "S A"]:
    """Return the demonstrated visits if some policy of the process can have made them."""
    checked("temperature", temperature, Positive)
    demonstrated, shape = np.asarray(demonstrated, float), (mdp.num_states, mdp.num_actions)
    if demonstrated.shape != shape:
        raise ValueError(f"demonstrated must have shape {shape}, not {demonstrated.shape}")
    if not np.isclose(demonstrated.sum(), mdp.total_visits, rtol=1e-4):
        raise ValueError(
            f"demonstrated adds up to {demonstrated.sum():.6g}, every occupancy of the process to "
            f"{mdp.total_visits:.6g}: count whole episodes, with its discount and horizon"
        )
    reached = mdp.initial > 0
    for _ in range(mdp.num_states if mdp.horizon is None else mdp.horizon - 1):
        before, arrived = reached, mdp.push(np.broadcast_to(reached[:, None], shape)) > 0
        if ((reached := before | arrived) == before).all():
            break
    lost = np.flatnonzero((demonstrated > 0).any(1) & ~reached)
    if len(lost):
        raise ValueError(f"demonstrations visit states that no policy reaches: {lost.tolist()}")
    return demonstrated
