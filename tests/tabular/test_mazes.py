"""The grid against the simulator's maze."""

import numpy as np
import pytest
from processes import dense

from offairl_lite import envs
from offairl_lite.envs.models import GOAL, START, walls
from offairl_lite.tabular import (
    MOVES,
    maze,
    occupancy,
    soft_value_iteration,
)


@pytest.mark.parametrize("side", ["Left", "Right"])
@pytest.mark.parametrize("cells", [3, 4, 7, 10, 21, 30])
def test_moves_stop_at_walls_and_nowhere_else(cells, side):
    grid = maze(cells, side)
    size, barrier = 0.7 / cells, walls(side)[4]
    goes_to = dense(grid.mdp).argmax(-1)
    assert set(np.unique(grid.mdp.transition.data)) == {1.0}
    for s, x in enumerate(grid.positions):
        for a, move in enumerate(MOVES):
            y = x + size * move
            inside = ((y > -0.1) & (y < 0.6)).all()
            crossing = (x[1] - 0.3) * (y[1] - 0.3) < 0
            blocked = crossing and barrier[0, 0] < x[0] < barrier[1, 0]
            arrival = x if blocked or not inside else y
            np.testing.assert_allclose(grid.positions[goes_to[s, a]], arrival, atol=1e-12)


@pytest.mark.parametrize("side", ["Left", "Right"])
def test_the_grid_is_the_maze_of_the_simulator(side):
    """Start, target and reward are those of the environment, and the best way is by the gap."""
    grid = maze(30, side)
    start = grid.mdp.initial.argmax()
    np.testing.assert_allclose(grid.positions[start], START, atol=0.012)
    env = envs.make(f"offairl/PointMaze{side}-v0", 1, 0)
    env.reset()
    reward = env.step(np.zeros((1, 2)))[1][0]
    assert grid.reward[start] == pytest.approx(reward, abs=0.02)
    np.testing.assert_allclose(grid.positions[grid.reward.argmax()], GOAL, atol=0.012)

    best = occupancy(grid.mdp, soft_value_iteration(grid.mdp, grid.reward, 0).policy)
    assert best.sum(1).argmax() == grid.reward.argmax()
    under = np.abs(grid.positions[:, 1] - 0.29) < 0.011
    gap = grid.positions[under & (best[:, 2] > 0), 0]
    assert len(gap)
    assert (gap > 0.4).all() if side == "Left" else (gap < 0.2).all()


def test_the_barrier_is_all_that_differs_between_the_sides():
    left, right = maze(20, "Left"), maze(20, "Right")
    np.testing.assert_array_equal(left.positions, right.positions)
    np.testing.assert_array_equal(left.reward, right.reward)
    changed = np.flatnonzero((dense(left.mdp) != dense(right.mdp)).any((1, 2)))
    assert len(changed)
    assert (np.abs(left.positions[changed, 1] - 0.3) < 0.035).all()


def test_slipping_replaces_the_action_by_any():
    sure, slippery = dense(maze(6, "Left").mdp), dense(maze(6, "Left", slip=0.4).mdp)
    expected = 0.6 * sure + 0.4 * sure.mean(1, keepdims=True)
    np.testing.assert_allclose(slippery, expected, atol=1e-15)


def test_mazes_that_cannot_be_are_refused():
    with pytest.raises(ValueError, match="cells is 2; expected a whole number of at least 3"):
        maze(2, "Left")
    with pytest.raises(ValueError, match=r"slip is 1\.5; expected a number in \[0, 1\]"):
        maze(10, "Left", slip=1.5)
    for side in ("Up", None):
        with pytest.raises(ValueError, match=f"side is {side!r}; expected one of"):
            maze(10, side)


def test_a_maze_has_the_discount_and_the_horizon_that_it_is_given():
    mdp = maze(5, "Left", discount=0.9, horizon=7).mdp
    assert (mdp.discount, mdp.horizon) == (0.9, 7)
