"""The batched stepper: seeds, clocks, resets, saved states, errors."""

import os

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from offairl_lite.envs import BatchedEnv

MAZE, ANT = "offairl/PointMazeLeft-v0", "offairl/CustomAnt-v0"
SAVED = [MAZE, "Hopper-v5", "Ant-v5", ANT]


def roll(env, actions):
    """Observations, rewards, terminated and truncated of a run, each (T, n, ...)."""
    return [np.stack(parts) for parts in zip(*(env.step(a)[:4] for a in actions), strict=True)]


def actions_for(env, steps, seed=0):
    shape = (steps, *env.action_space.shape)
    return np.random.default_rng(seed).uniform(-1, 1, shape).astype(np.float32)


@pytest.mark.parametrize("task", SAVED)
@pytest.mark.parametrize("same_object", [True, False])
def test_restored_state_continues_bit_for_bit(task, same_object):
    options = {"seeds": [0, 1, 2], "max_episode_steps": 60}
    env = BatchedEnv(task, 3, **options)
    env.reset()
    roll(env, actions_for(env, 37))
    state = env.get_state()
    assert all(isinstance(array, np.ndarray) for array in state.values())
    # 80 steps: past the time limit of every member, so that resets draw new noise.
    future = actions_for(env, 80, seed=1)
    expected = roll(env, future)
    assert (expected[2] | expected[3]).any(axis=0).all()
    if not same_object:
        env = BatchedEnv(task, 3, max_episode_steps=60)
    env.set_state(state)
    for got, wanted in zip(roll(env, future), expected, strict=True):
        np.testing.assert_array_equal(got, wanted)


@pytest.mark.parametrize("task", SAVED)
def test_restored_state_survives_a_partial_reset(task):
    env = BatchedEnv(task, 2, seeds=[0, 1])
    env.reset()
    roll(env, actions_for(env, 9))
    state = env.get_state()
    mask = {"reset_mask": np.array([True, False])}
    expected, _ = env.reset(options=mask)
    other = BatchedEnv(task, 2)
    other.set_state(state)
    np.testing.assert_array_equal(other.reset(options=mask)[0], expected)


def test_generators_continue_in_the_middle_of_a_draw():
    env = BatchedEnv(MAZE, 2, seeds=[0, 1])

    def draw():
        return [int(rng.integers(2**31, dtype=np.int32)) for rng in env.np_random]

    draw()  # Half of 64 random bits: the generator keeps the other half.
    state = env.get_state()
    expected = draw(), draw()
    env.set_state(state)
    assert (draw(), draw()) == expected


def test_get_state_is_a_copy():
    env = BatchedEnv(ANT, 2, seeds=[0, 1])
    env.reset()
    state = env.get_state()
    copies = {name: array.copy() for name, array in state.items()}
    roll(env, actions_for(env, 5))
    for name, array in state.items():
        np.testing.assert_array_equal(array, copies[name])
    env.set_state(state)
    roll(env, actions_for(env, 5))
    for name, array in state.items():
        np.testing.assert_array_equal(array, copies[name])


def test_state_of_another_shape_or_name_is_an_error_and_changes_nothing():
    env = BatchedEnv(MAZE, 2, seeds=[0, 1])
    env.reset()
    before = env.get_state()
    for wrong in (
        BatchedEnv(MAZE, 3).get_state(),
        BatchedEnv("Hopper-v5", 2).get_state(),
        {name: array for name, array in before.items() if name != "clock"},
        {**before, "extra": np.zeros(1)},
        {**before, "clock": before["clock"].astype(float)},
    ):
        with pytest.raises(ValueError, match="not a state of this environment"):
            env.set_state(wrong)
    for name, array in env.get_state().items():
        np.testing.assert_array_equal(array, before[name])


@pytest.mark.parametrize("task", [MAZE, "Hopper-v5", ANT])
def test_a_member_is_the_same_alone_and_among_ten(task):
    alone, among = BatchedEnv(task, 1, seeds=[7]), BatchedEnv(task, 10, seeds=list(range(10)))
    np.testing.assert_array_equal(alone.reset()[0][0], among.reset()[0][7])
    actions = actions_for(among, 130)
    one = roll(alone, actions[:, 7:8])
    for got, wanted in zip(one, roll(among, actions), strict=True):
        np.testing.assert_array_equal(got[:, 0], wanted[:, 7])
    # Another neighbour's seed is another neighbour, and nothing else.
    assert (one[0][:, 0] != roll(among, actions)[0][:, 6]).any()


@pytest.mark.parametrize("task", [MAZE, ANT])
def test_threads_do_not_change_the_numbers(task):
    runs = []
    for threads in (1, 2):
        env = BatchedEnv(task, 5, seeds=[0, 1, 2, 3, 4], num_threads=threads)
        env.reset()
        runs.append(roll(env, actions_for(env, 40)))
    for one, two in zip(*runs, strict=True):
        np.testing.assert_array_equal(one, two)


def test_reset_seeds_as_gymnasium_does():
    env = BatchedEnv("Hopper-v5", 3, seeds=[4, 5, 6])
    first, _ = env.reset()
    second, _ = env.reset()
    assert (first != second).any(axis=1).all()
    np.testing.assert_array_equal(env.reset(seed=4)[0], first)
    np.testing.assert_array_equal(env.reset()[0], second)
    np.testing.assert_array_equal(env.reset(seed=[4, 5, 6])[0], first)
    mixed, _ = env.reset(seed=[4, None, 4])
    np.testing.assert_array_equal(mixed[[0, 2]], first[[0, 0]])
    np.testing.assert_array_equal(mixed[1], second[1])
    with pytest.raises(ValueError, match="one seed for each of 3 members"):
        env.reset(seed=[1, 2])


def test_masked_reset_touches_only_the_marked_members():
    env = BatchedEnv(ANT, 3, seeds=[0, 1, 2], autoreset_mode=AutoresetMode.DISABLED)
    env.reset()
    actions = actions_for(env, 20)
    observations = roll(env, actions)[0][-1]
    mask = np.array([False, True, False])
    after, _ = env.reset(seed=[9, 9, 9], options={"reset_mask": mask})
    np.testing.assert_array_equal(after[~mask], observations[~mask])
    np.testing.assert_array_equal(after[1], BatchedEnv(ANT, 1, seeds=[9]).reset()[0][0])
    np.testing.assert_array_equal(env.get_state()["clock"], [20, 0, 20])
    untouched = BatchedEnv(ANT, 1, seeds=[0])
    untouched.reset()
    roll(untouched, actions[:, :1])
    np.testing.assert_array_equal(env.step(actions[0])[0][0], untouched.step(actions[0, :1])[0][0])


@pytest.mark.parametrize(
    "mask", [[True, False], np.array([1, 0]), np.array([True]), np.array([False, False])]
)
def test_bad_masks_are_errors(mask):
    with pytest.raises(ValueError, match="reset_mask must be"):
        BatchedEnv(MAZE, 2).reset(options={"reset_mask": mask})


def test_disabled_mode_refuses_to_step_a_finished_member():
    env = BatchedEnv(
        "Hopper-v5", 2, seeds=[0, 1], autoreset_mode=AutoresetMode.DISABLED, max_episode_steps=4
    )
    assert env.metadata["autoreset_mode"] is AutoresetMode.DISABLED
    actions = actions_for(env, 4)
    with pytest.raises(RuntimeError, match=r"members \[0, 1\] have no episode"):
        env.step(actions[0])
    env.reset()
    env.step(actions[0])
    env.reset(options={"reset_mask": np.array([True, False])})
    *_, terminated, truncated = roll(env, actions[:3])
    assert not terminated.any()
    np.testing.assert_array_equal(truncated[-1], [False, True])
    with pytest.raises(RuntimeError, match=r"members \[1\] have no episode"):
        env.step(actions[3])
    env.reset(options={"reset_mask": np.array([False, True])})
    env.step(actions[3])


def test_next_step_mode_resets_one_step_later():
    env = BatchedEnv(MAZE, 2, seeds=[0, 1])
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    env.reset()
    actions = actions_for(env, 202)
    observations, rewards, terminated, truncated = roll(env, actions)
    assert not terminated.any()
    np.testing.assert_array_equal(np.flatnonzero(truncated[:, 0]), [99, 200])
    # The last observation of an episode is its own; the next is the new episode's first.
    assert (observations[99, :, :2] != [0.3, 0]).all()
    np.testing.assert_array_equal(observations[100], np.tile([0.3, 0, 0], (2, 1)))
    np.testing.assert_array_equal(rewards[100], 0)
    assert (rewards[[99, 101]] < 0).all()


def test_next_step_mode_is_gymnasiums():
    reference = gymnasium.make_vec("Hopper-v5", num_envs=3, vectorization_mode="sync")
    env = BatchedEnv("Hopper-v5", 3)
    np.testing.assert_array_equal(env.reset(seed=2)[0], reference.reset(seed=2)[0])
    actions = actions_for(env, 120)
    runs = roll(env, actions), roll(reference, actions)
    for got, wanted in zip(*runs, strict=True):
        np.testing.assert_array_equal(got, wanted)
    assert (runs[0][2].sum(axis=0) >= 2).all()
    reference.close()


def test_termination_is_not_truncation():
    env = BatchedEnv("Hopper-v5", 4, seeds=[0, 1, 2, 3])
    env.reset()
    *_, terminated, truncated = roll(env, np.ones((100, 4, 3)))
    assert terminated.any(axis=0).all()
    assert not truncated.any()
    unlimited = BatchedEnv(MAZE, 1, seeds=[0], max_episode_steps=10**9)
    unlimited.reset()
    assert not np.any(roll(unlimited, np.ones((150, 1, 2)))[2:])


def test_returned_arrays_are_copies():
    env = BatchedEnv(MAZE, 2, seeds=[0, 1])
    first, _ = env.reset()
    second = env.step(np.ones((2, 2)))[0]
    kept = second.copy()
    first[:], second[:] = 7, 7
    third = env.reset(options={"reset_mask": np.array([True, False])})[0]
    np.testing.assert_array_equal(third[1], kept[1])


def test_actions_beyond_the_bounds_are_clamped_but_paid_for():
    envs = [BatchedEnv("HalfCheetah-v5", 1, seeds=[0]) for _ in range(2)]
    for env in envs:
        env.reset()
    (inside, reward, *_), (outside, paid, *_) = (
        env.step(np.full((1, 6), size)) for env, size in zip(envs, (1.0, 3.0), strict=True)
    )
    np.testing.assert_array_equal(inside, outside)
    np.testing.assert_allclose(reward - paid, 0.1 * 6 * (9 - 1))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_actions_that_are_not_finite_name_the_member(value):
    env = BatchedEnv(MAZE, 3, seeds=[0, 1, 2])
    env.reset()
    state = env.get_state()
    actions = np.zeros((3, 2))
    actions[2, 1] = value
    with pytest.raises(ValueError, match=rf"member 2: action\[1\] is {value}; actions must be fin"):
        env.step(actions)
    for name, array in env.get_state().items():
        np.testing.assert_array_equal(array, state[name])


@pytest.mark.parametrize("actions", [np.zeros((3, 3)), np.zeros(2), np.full((3, 2), "a")])
def test_actions_of_another_shape_or_kind_are_errors(actions):
    env = BatchedEnv(MAZE, 3)
    with pytest.raises(ValueError, match=r"numbers of shape \(3, 2\)"):
        env.step(actions)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"task": "Humanoid-v5"}, "unknown task 'Humanoid-v5'; known are offairl/PointMazeLeft"),
        ({"num_envs": 0}, "at least 1"),
        ({"num_threads": 0}, "at least 1"),
        ({"autoreset_mode": AutoresetMode.SAME_STEP}, "NEXT_STEP or DISABLED"),
        ({"render_mode": "human"}, "'rgb_array'"),
        ({"seeds": [1, 2]}, "one seed for each of 1 members"),
    ],
)
def test_bad_arguments_are_errors(arguments, message):
    with pytest.raises(ValueError, match=message):
        BatchedEnv(**{"task": MAZE, **arguments})


def test_no_log_file_is_left(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    BatchedEnv("HalfCheetah-v5").reset()
    assert os.listdir(tmp_path) == []
    assert capfd.readouterr() == ("", "")
