"""The worlds of chapter 12: the maze of chapter 1, and what is done to it.

States are the squares of the grid, actions the moves of `tabular.MOVES`.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.special import log_softmax
from torch import Tensor

from offairl_lite import tabular
from offairl_lite.tabular import MDP, occupancy, soft_value_iteration

CELLS = 12
ROW, DOOR = 6, (1, 2)
"""The third maze has a wall above a row, with a door in two columns."""
UP, DOWN = 2, 4
QUARTER, MIRROR = (0, 2, 3, 4, 1), (0, 3, 2, 1, 4)
"""Controls turned by 90°, and with left and right exchanged."""


def dense(mdp: MDP) -> Float[Array, "S A S"]:
    """Return p(s' | s, a) as an array."""
    return mdp.transition.toarray().reshape(
        mdp.num_states, mdp.num_actions, -1
    )


def turned(mdp: MDP, order: tuple[int, ...]) -> MDP:
    """Return a world in which action a does what `order[a]` did."""
    return replace(mdp, transition=dense(mdp)[:, list(order)])


def wall(
    row: int = ROW, door: tuple[int, ...] = DOOR, cells: int = CELLS
) -> MDP:
    """Return the maze with a wall above a row, open in some columns."""
    mdp = tabular.maze(cells, "Left").mdp
    p = dense(mdp).copy()
    states = np.arange(cells * cells).reshape(cells, cells)
    for low, high in zip(
        states[:-1].ravel(), states[1:].ravel(), strict=True
    ):
        at, column = divmod(low, cells)
        is_shut = at == row and column not in door
        p[low, UP] = np.eye(cells**2)[low if is_shut else high]
        p[high, DOWN] = np.eye(cells**2)[high if is_shut else low]
    return replace(mdp, transition=p)


class Steps(NamedTuple):
    """States, pairs (s, a) and next states, all one-hot."""

    obs: Tensor
    pair: Tensor
    next_obs: Tensor


class Player:
    """A policy in a deterministic grid world, beside an expert.

    Both start anywhere. `steps` are those of all pairs, `seen` and `visits`
    how often expert and policy make them.
    """

    def __init__(self, mdp: MDP, reward):
        start = np.full(mdp.num_states, 1 / mdp.num_states)
        self.mdp = replace(mdp, initial=start)
        states, pairs = (torch.eye(n) for n in mdp.transition.shape[::-1])
        obs = states.repeat_interleave(mdp.num_actions, 0)
        to = torch.as_tensor(mdp.transition.toarray()).argmax(1)
        self.steps = Steps(obs, pairs, states[to])
        self.seen = self._often(
            soft_value_iteration(self.mdp, reward).policy
        )
        even = np.ones((mdp.num_states, mdp.num_actions))
        self._become(log_softmax(even, axis=1))

    def improve(self, reward, share: float = 0.3) -> None:
        """Move log π towards the soft optimum of a reward."""
        best = soft_value_iteration(self.mdp, reward).log_policy
        mixed = (1 - share) * self.log_policy + share * best
        self._become(log_softmax(mixed, axis=1))

    def _become(self, log_policy) -> None:
        self.log_policy = log_policy
        self.log_pi = torch.as_tensor(log_policy.ravel()).float()
        self.visits = self._often(np.exp(log_policy))

    def _often(self, policy) -> Tensor:
        visits = occupancy(self.mdp, policy).ravel()
        return torch.as_tensor(visits / visits.sum()).float()
