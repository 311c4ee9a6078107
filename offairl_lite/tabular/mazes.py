"""The shifting maze as a grid."""

from typing import Annotated, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import csr_array

from offairl_lite.config.settings import Fraction, checked
from offairl_lite.envs.models import GOAL, START, Side, walls
from offairl_lite.tabular.mdp import MDP

MOVES = np.array([(0, 0), (1, 0), (0, 1), (-1, 0), (0, -1)])
"""The maze's actions as moves along x and y in cells, (5, 2): stay, right, up, left, down."""


class Maze(NamedTuple):
    """The shifting maze as a grid, with its true `reward`: minus the distance from the target.

    `positions` are the centres of the cells, rows of equal y one after another: `v.reshape(cells,
    cells)` of a state function has y along its first axis and x along its second.
    """

    mdp: MDP
    positions: Float[Array, "S 2"]
    reward: Float[Array, "S"]


def maze(
    cells: int, side: Side, slip: float = 0.0, discount: float = 0.97, horizon: int | None = None
) -> Maze:
    """Return the shifting maze of `envs`, cut into cells × cells squares.

    The particle is a point in the middle of a square, and moves to a neighbouring square or stays
    (`MOVES`). A move into a wall leaves it where it is. The mazes of both sides have the same
    states, so that a reward learned in one can be used in the other.

    Args:
        cells: number of squares, at least 3, along each side of the maze, which is 0.7 m long.
        side: the side on which the barrier is attached; `"Left"` leaves the gap on the right.
        slip: probability that the action is replaced by one of the five, drawn at random.
        discount: γ.
        horizon: number of actions in an episode, or None.
    """
    checked("cells", cells, Annotated[int, "of at least 3", lambda n: n >= 3])
    checked("slip", slip, Fraction)
    checked("side", side, Side)
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
    initial = np.eye(states)[np.linalg.norm(positions - START, axis=1).argmin()]
    mdp = MDP((1 - slip) * move + slip * drift[origin], initial, discount, horizon)
    return Maze(mdp, positions, -np.linalg.norm(positions - GOAL, axis=1))
