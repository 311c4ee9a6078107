import matplotlib.pyplot as plt
import numpy as np
import pytest
import torch
from matplotlib.colors import to_hex

import plots
from offairl_lite import tabular
from offairl_lite.analysis.statistics import bootstrap_interval, interquartile_mean
from offairl_lite.core.networks import Normaliser, StackedMLP
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rng import Rng
from offairl_lite.envs.models import GOAL, START


@pytest.fixture
def ax():
    plt.switch_backend("agg")
    with plots.style():
        figure, axes = plt.subplots()
        yield axes
        plt.close(figure)


@pytest.mark.parametrize("members", [1, 5])
def test_a_curve_is_the_interquartile_mean_its_band_and_every_member(ax, members):
    steps = np.array([100, 200, 300])
    returns = np.random.default_rng(0).normal(size=(members, 3))
    plots.curve(ax, steps, returns, "imitation", plots.ORANGE, "--")
    *each, mean = ax.lines
    np.testing.assert_array_equal(
        mean.get_xydata(), np.stack([steps, interquartile_mean(returns)], 1)
    )
    assert (mean.get_label(), to_hex(mean.get_color())) == ("imitation", plots.ORANGE.lower())
    assert mean.get_linestyle() == "--"
    np.testing.assert_array_equal([line.get_ydata() for line in each], returns)
    # Only the mean has an entry in the legend.
    assert ax.get_legend_handles_labels()[1] == ["imitation"]
    x, y = ax.collections[0].get_paths()[0].vertices.T
    for step, *ends in zip(steps, *bootstrap_interval(returns), strict=True):
        assert [y[x == step].min(), y[x == step].max()] == ends


def test_a_level_is_drawn_where_it_is_and_named(ax):
    plots.level(ax, -7.4, "expert")
    assert set(ax.lines[0].get_ydata()) == {-7.4}
    assert ax.texts[0].get_text() == "expert"


@pytest.mark.parametrize("member", [0, 1])
def test_a_reward_map_is_the_reward_shifted_so_that_its_best_is_0(ax, member):
    net = StackedMLP((3, 8, 1), "tanh")
    params = net.init(Rng((0, 1)))
    reward = Reward("offairl/PointMazeLeft-v0", net, True, params, Normaliser.identity(2, 3))
    image = plots.reward_map(ax, reward, "Left", member, resolution=5)
    values = np.asarray(image.get_array())
    assert values.max() == 0
    assert values.min() < -1e-3
    # The first pixel lies around -0.08, the last around 0.58.
    np.testing.assert_allclose(image.get_extent(), [-0.1625, 0.6625] * 2)
    # Row and column are y and x.
    places = np.linspace(-0.08, 0.58, 5)
    obs = np.array([[[places[3], places[1], 0.0]], [[places[0], places[4], 0.0]]], np.float32)
    pair = reward.member(member, member)(torch.as_tensor(obs))[:, 0]
    np.testing.assert_allclose(values[1, 3] - values[4, 0], pair[0] - pair[1], atol=1e-6)


@pytest.mark.parametrize("side", ["Left", "Right"])
def test_a_maze_has_its_walls_its_start_and_its_goal(ax, side):
    plots.maze(ax, side)
    walls = ax.collections[0].get_segments()
    assert len(walls) == 5
    # The barrier leaves its gap on the other side: Left's on the right.
    barrier = next(w for w in walls if np.allclose(w[:, 1], 0.3))
    np.testing.assert_allclose(sorted(barrier[:, 0]), [-0.1, 0.4] if side == "Left" else [0.2, 0.6])
    for marker, place in zip(ax.lines, (START, GOAL), strict=True):
        np.testing.assert_allclose(marker.get_xydata()[0], place[:2])


@pytest.mark.parametrize("colorbar", [False, True])
def test_walls_are_as_wide_as_they_are_whatever_is_drawn_beside_them(ax, colorbar):
    plots.maze(ax, "Left")
    if colorbar:  # takes room from the axes after the walls are there
        ax.figure.colorbar(plt.cm.ScalarMappable(), ax=ax)
    ax.figure.canvas.draw()
    wide = ax.collections[0].get_linewidth()[0] / 72  # inches
    box = ax.get_window_extent().width / ax.figure.dpi
    assert wide / box == pytest.approx(0.04 / np.ptp(ax.get_xlim()))


def test_a_grid_shows_every_square_in_its_place(ax):
    maze = tabular.maze(5, "Right")
    image = plots.grid(ax, maze.positions[:, 0], "Right")
    np.testing.assert_allclose(image.get_extent(), [-0.1, 0.6, -0.1, 0.6])
    # Row and column are y and x, from the bottom left.
    assert image.origin == "lower"
    np.testing.assert_allclose(np.asarray(image.get_array())[3], maze.positions[15:20, 0])


def test_arrows_are_the_mean_moves(ax):
    maze = tabular.maze(5, "Left")
    policy = np.full((25, 5), 0.2)
    policy[7] = [0, 0.5, 0.5, 0, 0]
    quiver = plots.arrows(ax, policy, maze.positions)
    moves = np.stack([quiver.U, quiver.V], 1)
    np.testing.assert_allclose(moves[7], 0.9 * 0.14 * np.array([0.5, 0.5]))
    np.testing.assert_allclose(np.delete(moves, 7, 0), 0, atol=1e-15)
    np.testing.assert_allclose(quiver.get_offsets(), maze.positions)
