"""Maps of the maze: every square and every arrow in its place."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

import drawing
from offairl_lite import tabular


@pytest.fixture
def ax():
    plt.switch_backend("agg")
    figure, axes = plt.subplots()
    yield axes
    plt.close(figure)


def test_a_grid_shows_every_square_in_its_place(ax):
    maze = tabular.maze(5, "Right")
    image = drawing.grid(ax, maze.positions[:, 0], "Right")
    np.testing.assert_allclose(image.get_extent(), [-0.1, 0.6, -0.1, 0.6])
    # Row and column are y and x, from the bottom left.
    assert image.origin == "lower"
    np.testing.assert_allclose(np.asarray(image.get_array())[3], maze.positions[15:20, 0])


def test_arrows_are_the_mean_moves(ax):
    maze = tabular.maze(5, "Left")
    policy = np.full((25, 5), 0.2)
    policy[7] = [0, 0.5, 0.5, 0, 0]
    quiver = drawing.arrows(ax, policy, maze.positions)
    moves = np.stack([quiver.U, quiver.V], 1)
    np.testing.assert_allclose(moves[7], 0.9 * 0.14 * np.array([0.5, 0.5]))
    np.testing.assert_allclose(np.delete(moves, 7, 0), 0, atol=1e-15)
    np.testing.assert_allclose(quiver.get_offsets(), maze.positions)
