"""Observations, rewards and ends: against Gymnasium's environments, and by hand for our own."""

import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from offairl_lite.envs import TASKS, BatchedEnv, models
from offairl_lite.envs.tasks import Physics, in_marsh

STEPS = 400


def disabled_autoreset(task, seeds, **options):
    return BatchedEnv(
        task, len(seeds), seeds=seeds, autoreset_mode=AutoresetMode.DISABLED, **options
    )


@pytest.mark.parametrize("task", ["Hopper-v5", "Walker2d-v5", "Ant-v5"])
def test_an_episode_ends_where_gymnasium_s_does_wherever_the_body_is(task):
    env, rng, ends = gymnasium.make(task).unwrapped, np.random.default_rng(0), []
    joints, speeds = env.init_qpos.shape, env.init_qvel.shape
    for _ in range(500):
        far = rng.normal(size=joints) * rng.choice([0.1, 1, 50]) * (rng.random(joints) < 0.3)
        env.set_state(env.init_qpos + far, rng.normal(size=speeds) * rng.choice([1, 60]))
        physics = Physics(env.data.qpos[None].copy(), env.data.qvel[None].copy(), None, None)
        ends.append(not env.is_healthy)
        assert TASKS[task].terminated(physics)[0] == ends[-1]
    env.close()
    assert 0 < np.mean(ends) < 1


@pytest.mark.parametrize("task", ["HalfCheetah-v5", "Hopper-v5", "Walker2d-v5", "Ant-v5"])
def test_equal_to_gymnasium_to_the_last_bit(task, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log there when Gymnasium loads its cheetah.
    # A limit of 150 steps makes the cheetah, which never terminates, restart as well.
    seeds, limit = [5, 6], 150
    references = [gymnasium.make(task, max_episode_steps=limit) for _ in seeds]
    ours = disabled_autoreset(task, seeds, max_episode_steps=limit)
    assert ours.single_action_space == references[0].action_space
    assert ours.single_observation_space.shape == references[0].observation_space.shape

    expected = np.stack([env.reset(seed=s)[0] for env, s in zip(references, seeds, strict=True)])
    observations, _ = ours.reset()
    np.testing.assert_array_equal(observations, expected)
    rng = np.random.default_rng(0)
    ends = {"terminated": 0, "truncated": 0}
    for _ in range(STEPS):
        # Some actions lie beyond the bounds: clamped by MuJoCo, charged in full.
        actions = rng.uniform(-1.2, 1.2, ours.action_space.shape).astype(np.float32)
        steps = [env.step(action) for env, action in zip(references, actions, strict=True)]
        for got, wanted in zip(ours.step(actions)[:4], zip(*steps, strict=True), strict=False):
            np.testing.assert_array_equal(got, np.array(wanted[: len(seeds)]))
        ends["terminated"] += sum(step[2] for step in steps)
        ends["truncated"] += sum(step[3] for step in steps)
        finished = np.array([step[2] or step[3] for step in steps])
        if finished.any():
            observations, _ = ours.reset(options={"reset_mask": finished})
            for member in np.flatnonzero(finished):
                expected = references[member].reset()[0]
                np.testing.assert_array_equal(observations[member], expected)
    assert ends["truncated" if task == "HalfCheetah-v5" else "terminated"] >= 2
    for env in references:
        env.close()


def test_initial_state_of_our_ant_draws_as_gymnasium_does():
    env = disabled_autoreset("offairl/CustomAnt-v0", [3])
    observation = env.reset()[0][0]
    rng, _ = gymnasium.utils.seeding.np_random(3)
    model = models.ant(False, (4, 1, 2, 3))
    qpos = model.qpos0 + rng.uniform(-0.1, 0.1, 15)
    qvel = 0.1 * rng.standard_normal(14)
    np.testing.assert_array_equal(observation[:27], np.concatenate([qpos[2:], qvel]))
    np.testing.assert_array_equal(observation[27:], 0)


def test_maze_reset_start_exact_and_slow():
    env = disabled_autoreset("offairl/PointMazeLeft-v0", list(range(50)))
    np.testing.assert_array_equal(env.reset()[0], np.tile([0.3, 0, 0], (50, 1)))
    velocity = env.get_state()["physics"][:, 3:5]
    assert 0.005 < np.abs(velocity).max() <= 0.01
    assert len(np.unique(velocity)) == 100


def test_maze_reward_by_hand():
    env = disabled_autoreset("offairl/PointMazeRight-v0", [0, 1])
    before, _ = env.reset()
    rng = np.random.default_rng(1)
    for _ in range(60):
        actions = rng.uniform(-1, 1, (2, 2))
        after, rewards, terminated, _, _ = env.step(actions)
        distance = np.sqrt((before[:, 0] - 0.3) ** 2 + (before[:, 1] - 0.5) ** 2)
        np.testing.assert_allclose(rewards, -distance - 0.001 * (actions**2).sum(1), rtol=1e-12)
        assert not terminated.any()
        assert (after[:, 2] == 0).all()
        before = after


@pytest.mark.parametrize("task", ["offairl/CustomAnt-v0", "offairl/DisabledAnt-v0"])
def test_ant_reward_by_hand(task):
    env = disabled_autoreset(task, [0, 1])
    before, _ = env.reset()
    assert before.shape == (2, 111)
    # Member 1 starts below the floor, which pushes it out: low enough to be charged for one step.
    state = env.get_state()
    state["physics"][1, 1 + 2] = -3.0
    env.set_state(state)
    before = np.concatenate([state["physics"][:, 3:16], before[:, 13:]], axis=1)
    rng = np.random.default_rng(1)
    contact_seen = flipped_seen = False
    for _ in range(40):
        actions = rng.uniform(-1, 1, (2, 8))
        after, rewards, terminated, _, _ = env.step(actions)
        contact, flipped = after[:, 27:], after[:, 0] < 0.2
        assert np.abs(contact).max() <= 1
        expected = before[:, 13] - 0.01 * (actions**2).sum(1)
        expected = expected - 5e-4 * (contact**2).sum(1) - flipped
        np.testing.assert_allclose(rewards, expected, rtol=1e-10)
        assert not terminated.any()
        contact_seen |= (contact**2).sum() > 0.5
        flipped_seen |= flipped.any()
        before = after
    assert contact_seen
    assert flipped_seen


def test_barrier_stops_a_straight_push_on_both_sides():
    for side in ("Left", "Right"):
        env = disabled_autoreset(f"offairl/PointMaze{side}-v0", [0])
        env.reset()
        for _ in range(100):
            observations, _, _, truncated, _ = env.step(np.array([[0.0, 1.0]]))
        assert truncated.all()
        # Barrier's axis at 0.3; radii 0.02 and 0.03, 0.01 above the particle's plane, some give.
        assert 0.24 < observations[0, 1] < 0.27


def scripted_return(task, *path):
    env, path = disabled_autoreset(task, [0]), [*map(np.array, path), models.GOAL]
    observations, _ = env.reset()
    total, previous = 0.0, observations[0, :2]
    for _ in range(100):
        position = observations[0, :2]
        if len(path) > 1 and np.linalg.norm(path[0] - position) < 0.06:
            path.pop(0)
        velocity, previous = (position - previous) / 0.05, position
        action = np.clip(30 * (path[0] - position) - 3 * velocity, -1, 1)
        observations, rewards, *_ = env.step(action[None])
        total += rewards[0]
    return total, np.linalg.norm(observations[0, :2] - models.GOAL)


@pytest.mark.parametrize("side", ["Left", "Right"])
def test_a_path_through_the_gap_reaches_the_goal(side):
    gap = 0.5 if side == "Left" else 0.1
    task = f"offairl/PointMaze{side}-v0"
    total, distance = scripted_return(task, (gap, 0.22), (gap, 0.37))
    assert distance < 0.02
    assert -5.5 < total < -4.3


@pytest.mark.parametrize("task", ["offairl/PointMarsh-v0", "offairl/PointMarshWest-v0"])
def test_the_marsh_is_best_gone_round(task):
    across, straight = scripted_return(task)
    around, detour = scripted_return(task, (0.45, 0.06), (0.45, 0.3))
    assert straight < 0.02
    assert detour < 0.02
    assert across < around - 4


def test_marsh_reward_by_hand():
    env = disabled_autoreset("offairl/PointMarshWest-v0", [0, 1])
    before, _ = env.reset()
    np.testing.assert_array_equal(before, np.tile([0.05, 0, 0], (2, 1)))
    rng, wet = np.random.default_rng(1), []
    for _ in range(60):
        actions = rng.uniform(-0.6, 1, (2, 2))
        after, rewards, terminated, _, _ = env.step(actions)
        x, y, _ = before.T
        wet.append((x < 0.4) & (y > 0.1) & (y < 0.3))
        distance = np.sqrt((x - 0.3) ** 2 + (y - 0.5) ** 2)
        expected = -distance - 0.001 * (actions**2).sum(1) - 2 * wet[-1]
        np.testing.assert_allclose(rewards, expected, rtol=1e-12)
        assert not terminated.any()
        before = after
    assert 0 < np.mean(wet) < 1
    places = np.array([[[0.3, 0.2], [0.41, 0.2]], [[0.3, 0.31], [-0.05, 0.11]]])
    np.testing.assert_array_equal(in_marsh(places), [[True, False], [False, True]])


def test_released_ant_drives_other_joints_with_the_same_action():
    action = np.zeros((1, 8))
    action[0, 2] = 1.0
    moved = {}
    for task in ("CustomAnt", "DisabledAnt", "DisabledAntReleased"):
        model = TASKS[f"offairl/{task}-v0"].model()
        data = mujoco.MjData(model)
        data.ctrl[:] = action[0]
        mujoco.mj_forward(model, data)
        joint = model.actuator_trnid[np.flatnonzero(data.actuator_force)[0], 0]
        moved[task] = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, joint)
    assert moved == {"CustomAnt": "hip_1", "DisabledAnt": "hip_1", "DisabledAntReleased": "hip_2"}

    # Put the action where the released order wants it: the same motion, to the last bit.
    ours = disabled_autoreset("offairl/DisabledAnt-v0", [0])
    released = disabled_autoreset("offairl/DisabledAntReleased-v0", [0])
    np.testing.assert_array_equal(ours.reset()[0], released.reset()[0])
    rng = np.random.default_rng(0)
    for _ in range(10):
        action = rng.uniform(-1, 1, (1, 8))
        permuted = np.roll(action, -2, axis=1)
        np.testing.assert_array_equal(ours.step(action)[0], released.step(permuted)[0])
    assert (ours.step(action)[0] != released.step(action)[0]).any()


def test_observation_and_action_sizes_and_limits():
    sizes = {
        "offairl/PointMazeLeft-v0": (3, 2, 100),
        "offairl/PointMazeRight-v0": (3, 2, 100),
        "offairl/CustomAnt-v0": (111, 8, 1000),
        "offairl/DisabledAnt-v0": (111, 8, 1000),
        "offairl/DisabledAntReleased-v0": (111, 8, 1000),
        "offairl/PointMarsh-v0": (3, 2, 100),
        "offairl/PointMarshWest-v0": (3, 2, 100),
        "HalfCheetah-v5": (17, 6, 1000),
        "Hopper-v5": (11, 3, 1000),
        "Walker2d-v5": (17, 6, 1000),
        "Ant-v5": (105, 8, 1000),
    }
    assert list(TASKS) == list(sizes)
    for task, (observation, action, limit) in sizes.items():
        env = BatchedEnv(task)
        assert env.single_observation_space.shape == (observation,)
        assert env.single_action_space == gymnasium.spaces.Box(-1, 1, (action,), np.float32)
        assert env.max_episode_steps == limit
