"""A Markov decision process given as arrays."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import csr_array, issparse

from offairl_lite.config.settings import Count, Fraction, checked


@dataclass(frozen=True, eq=False)
class MDP:
    """A Markov decision process without its reward."""

    transition: csr_array
    """Probabilities p(s' | s, a): an array (S, A, S), or a sparse matrix (S·A, S) whose row s·A + a
    is the distribution of s'. It is stored as such a matrix, in CSR form."""
    initial: Float[Array, "S"]  #: Distribution of the first state.
    discount: float  #: γ, from 0 to 1.
    horizon: int | None = None  #: Actions of an episode; None if episodes have no end; then γ < 1.

    def __post_init__(self):
        transition = _as_matrix(self.transition)
        rows, states = transition.shape
        for wrong in np.flatnonzero(~are_distributions(transition)).tolist():
            s, a = divmod(wrong, rows // states)
            raise ValueError(f"p(· | s={s}, a={a}) must be at least 0 and sum to 1")
        initial = np.asarray(self.initial, dtype=float)
        if initial.shape != (states,) or not are_distributions(initial[None]).all():
            raise ValueError(f"initial must be ({states},), at least 0 and sum to 1, not {initial}")
        checked("horizon", self.horizon, Count | None)
        checked("discount", self.discount, Fraction)
        if self.horizon is None and self.discount == 1:
            raise ValueError("without a horizon the discount must be below 1, such as 0.99")
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

    @property
    def total_visits(self) -> float:
        """1 + γ + γ² + ..., the sum of every occupancy."""
        if self.horizon is None:
            return 1 / (1 - self.discount)
        return float((self.discount ** np.arange(self.horizon)).sum())

    def expect(self, value: Float[Array, "S"]) -> Float[Array, "S A"]:
        """Return E[value(s') | s, a]."""
        return (self.transition @ value).reshape(self.num_states, self.num_actions)

    def push(self, flow: Float[Array, "S A"]) -> Float[Array, "S"]:
        """Return the flow that arrives in each state s': Σ flow(s, a) p(s' | s, a)."""
        return self.transition.T @ flow.ravel()

    def expected_reward(self, reward: Array) -> Float[Array, "S A"]:
        """Return r(s, a) for a reward r(s), r(s, a) or r(s, a, s'): the mean over s'."""
        reward = np.asarray(reward, dtype=float)
        s, a = self.num_states, self.num_actions
        if reward.shape not in ((s,), (s, a), (s, a, s)):
            raise ValueError(f"reward must be {(s,)}, {(s, a)} or {(s, a, s)}, not {reward.shape}")
        if not np.isfinite(reward).all():
            raise ValueError("reward must be finite; to forbid an action, give it a large cost")
        if reward.ndim == 3:
            reward = self.transition.multiply(reward.reshape(s * a, s)).sum(axis=1).reshape(s, a)
        return np.broadcast_to(reward.T, (a, s)).T if reward.ndim == 1 else reward

    def checked_policy(self, policy: Array) -> Float[Array, "*T S A"]:
        """Return a policy, with a time axis if there is a horizon."""
        policy = np.asarray(policy, dtype=float)
        shape = (self.num_states, self.num_actions)
        timed = shape if self.horizon is None else (self.horizon, *shape)
        if policy.shape not in (shape, timed):
            shapes = sorted({shape, timed}, key=len)
            raise ValueError(f"policy is {policy.shape}; expected one of {shapes}")
        if not are_distributions(policy.reshape(-1, shape[1])).all():
            raise ValueError("policy must be probabilities of the actions, not their logarithms")
        return np.broadcast_to(policy, timed)


def are_distributions(rows) -> Array:
    """Return whether each row, dense or sparse, is at least 0 and sums to one, (N,)."""
    return (abs(rows.sum(axis=1) - 1) < 1e-6) & (abs(rows).sum(axis=1) - rows.sum(axis=1) == 0)


def _as_matrix(transition) -> csr_array:
    """Return transition probabilities as a sparse matrix (S·A, S) without explicit zeros."""
    array = transition if issparse(transition) else np.asarray(transition, dtype=float)
    rows, states = np.prod(array.shape[:-1], dtype=int), array.shape[-1]
    fits = issparse(array) or (array.ndim == 3 and array.shape[0] == states)
    if not fits or states == 0 or rows == 0 or rows % states:
        raise ValueError(f"transition must be (S, A, S), or sparse (S·A, S), not {array.shape}")
    matrix = csr_array(array.reshape(rows, states), dtype=float)
    matrix.sum_duplicates()
    matrix.eliminate_zeros()
    return matrix
