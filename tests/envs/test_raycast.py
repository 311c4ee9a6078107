"""Frames: deterministic, of the right shape, and showing what they should."""

import gymnasium
import mujoco
import numpy as np
import pytest

from offairl_lite.envs import TASKS, BatchedEnv
from offairl_lite.envs.batched import FRAME_SIZE
from offairl_lite.envs.raycast import render


def frame_of(task, width=120, height=80, qpos=None):
    definition = TASKS[task]
    model = definition.model()
    data = mujoco.MjData(model)
    if qpos is not None:
        data.qpos[:2] = qpos
    mujoco.mj_kinematics(model, data)
    return render(model, data, width, height, definition.camera)


def centre_of(frame, colour):
    """Mean row and column of the pixels in which this channel dominates."""
    others = np.delete(frame, colour, axis=2).astype(int).max(axis=2)
    rows, columns = np.nonzero(frame[..., colour] > others + 60)
    assert len(rows) > 5
    return rows.mean(), columns.mean()


@pytest.mark.parametrize("task", TASKS)
def test_frames_are_deterministic_and_not_empty(task):
    frame = frame_of(task)
    assert frame.shape == (80, 120, 3)
    assert frame.dtype == np.uint8
    np.testing.assert_array_equal(frame, frame_of(task))
    assert len(np.unique(frame.reshape(-1, 3), axis=0)) > 100


def test_maze_shows_particle_target_and_barrier():
    red, green, blue = 0, 1, 2
    left = frame_of("offairl/PointMazeLeft-v0", 240, 240)
    right = frame_of("offairl/PointMazeRight-v0", 240, 240)
    particle, target = centre_of(left, blue), centre_of(left, green)
    assert particle[0] > target[0] + 50
    assert abs(particle[1] - target[1]) < 10
    assert target[0] < centre_of(left, red)[0] < particle[0]
    assert centre_of(left, red)[1] + 30 < centre_of(right, red)[1]
    # The particle is drawn where it is: right and up in the frame are +x and +y.
    moved = centre_of(frame_of("offairl/PointMazeLeft-v0", 240, 240, (0.1, 0.1)), blue)
    assert moved[0] < particle[0] - 20
    assert moved[1] > particle[1] + 20


def test_camera_follows_the_torso_over_a_floor_that_stays():
    here, there = frame_of("offairl/CustomAnt-v0"), frame_of("offairl/CustomAnt-v0", qpos=(2, 0))
    np.testing.assert_array_equal(here, there)  # The tiles repeat after 2 metres.
    between = frame_of("offairl/CustomAnt-v0", qpos=(0.5, 0))
    assert (between != here).any(axis=2).mean() > 0.05
    middle = np.s_[30:45, 55:65]  # The torso.
    assert (between[middle] != here[middle]).any(axis=2).mean() < 0.05


def test_something_above_the_floor_casts_a_shadow():
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(9, 9, 1), rgba=(1, 1, 1, 1))
    body = spec.worldbody.add_body(pos=(0, 0, 0.6))
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.2, 0, 0), rgba=(1, 0, 0, 1))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    camera = TASKS["offairl/PointMazeLeft-v0"].camera
    frame = render(model, data, 60, 60, camera).astype(int)
    floor = frame[..., 1] > 0.9 * frame[..., 0]
    bright, dark = frame[floor].max(), frame[floor].min()
    assert dark < 0.6 * bright


def test_environments_render_every_member():
    env = BatchedEnv("offairl/PointMazeLeft-v0", 2, seeds=[0, 1], render_mode="rgb_array")
    env.reset()
    before = env.get_state()
    env.step(np.array([[1.0, 0.0], [-1.0, 0.0]]))
    frames = env.render()
    assert len(frames) == 2
    assert frames[0].shape == (FRAME_SIZE, FRAME_SIZE, 3)
    assert (frames[0] != frames[1]).any()
    # Looking changes nothing.
    after = env.step(np.zeros((2, 2)))[0]
    env.set_state(before)
    env.step(np.array([[1.0, 0.0], [-1.0, 0.0]]))
    np.testing.assert_array_equal(env.step(np.zeros((2, 2)))[0], after)
    single = gymnasium.make("offairl/CustomAnt-v0", render_mode="rgb_array")
    single.reset(seed=0)
    assert single.render().shape == (FRAME_SIZE, FRAME_SIZE, 3)
    with pytest.raises(RuntimeError, match="render_mode='rgb_array'"):
        BatchedEnv("Hopper-v5").render()
