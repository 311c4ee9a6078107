"""Bad inputs of environments: each one is refused with a message that names it."""

from contextlib import closing

import gymnasium
import numpy as np
import pytest
from own_task import BOX, Arm

from offairl_lite import envs
from offairl_lite.envs import BatchedEnv, make
from offairl_lite.learned_reward import LearnedReward

MAZE, PENDULUM = "offairl/PointMazeLeft-v0", "Pendulum-v1"  # A native and a serial task.
WHOLE = "expected a whole number of at least"

MAKE = [
    # argument, value, words
    ("population", 0, f"population is 0; {WHOLE} 1"),
    ("population", -2, f"population is -2; {WHOLE} 1"),
    ("population", 1.0, f"population is 1.0; {WHOLE} 1"),
    ("population", True, f"population is True; {WHOLE} 1"),
    ("population", "2", f"population is '2'; {WHOLE} 1"),
    ("population", None, f"population is None; {WHOLE} 1"),
    ("population", np.nan, f"population is nan; {WHOLE} 1"),
    ("seed", None, "seed is None; expected a number, or one for each of 1"),
    ("seed", [None], "seed is [None]; expected a number, or one for each of 1"),
    ("seed", True, f"seed is True; {WHOLE} 0"),
    ("seed", np.True_, f"seed is np.True_; {WHOLE} 0"),
    ("seed", -1, f"seed is -1; {WHOLE} 0"),
    ("seed", 1.5, f"seed is 1.5; {WHOLE} 0"),
    ("seed", np.float32(1), f"seed is np.float32(1.0); {WHOLE} 0"),
    ("seed", {3}, f"seed is {{3}}; {WHOLE} 0"),
    ("seed", "3", f"seed is '3'; {WHOLE} 0"),
    ("seed", [True], f"seed is True; {WHOLE} 0"),
    ("seed", [-1], f"seed is -1; {WHOLE} 0"),
    ("seed", [0.5], f"seed is 0.5; {WHOLE} 0"),
    ("seed", np.array([0.5]), f"seed is np.float64(0.5); {WHOLE} 0"),
    ("seed", [], "expected one seed for each of 1 members, got []"),
    ("seed", [1, 2], "expected one seed for each of 1 members, got [1, 2]"),
    ("num_threads", 0, f"num_threads is 0; {WHOLE} 1"),
    ("num_threads", 1.5, f"num_threads is 1.5; {WHOLE} 1"),
    ("num_threads", True, f"num_threads is True; {WHOLE} 1"),
    ("num_threads", "2", f"num_threads is '2'; {WHOLE} 1"),
]


@pytest.mark.parametrize("env_id", [MAZE, PENDULUM])
@pytest.mark.parametrize(("name", "value", "words"), MAKE)
def test_environments_are_not_made_of(refused, env_id, name, value, words):
    given = {"population": 1, "seed": 0} | {name: value}
    refused(lambda: make(env_id, **given), words)


@pytest.mark.parametrize(
    ("env_id", "words"),
    [
        (None, "env_id is None; expected a text"),
        (3, "env_id is 3; expected a text"),
        (b"Pendulum-v1", "env_id is b'Pendulum-v1'; expected a text"),
        ([MAZE], "env_id is ['offairl/PointMazeLeft-v0']; expected a text"),
        ("", "unknown environment ''. Known are offairl/PointMazeLeft-v0"),
        ("3", "unknown environment '3'. Known are"),
        ("Nowhere-v0", "unknown environment 'Nowhere-v0'...my_module:Nowhere-v0"),
        ("offairl/PointMazeLeft-v9", "unknown environment 'offairl/PointMazeLeft-v9'"),
    ],
)
@pytest.mark.parametrize("use", [envs.spec, lambda env_id: make(env_id, 1, 0)])
def test_there_is_no_task(refused, env_id, words, use):
    refused(lambda: use(env_id), words)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"task": "Maze"}, "unknown task 'Maze'; known are"),
        ({"num_envs": 0}, f"num_envs is 0; {WHOLE} 1"),
        ({"num_envs": 1.5}, f"num_envs is 1.5; {WHOLE} 1"),
        ({"num_threads": None}, f"num_threads is None; {WHOLE} 1"),
        ({"seeds": [1, 2]}, "expected one seed for each of 1 members"),
        ({"seeds": [-5]}, f"seed is -5; {WHOLE} 0, or None"),
        ({"render_mode": "human"}, "render_mode must be None or 'rgb_array', not 'human'"),
        ({"max_episode_steps": 0}, f"max_episode_steps is 0; {WHOLE} 1, or None"),
        ({"max_episode_steps": -1}, f"max_episode_steps is -1; {WHOLE} 1, or None"),
        ({"max_episode_steps": 2.5}, f"max_episode_steps is 2.5; {WHOLE} 1, or None"),
        ({"max_episode_steps": np.nan}, f"max_episode_steps is nan; {WHOLE} 1, or None"),
        ({"max_episode_steps": "9"}, f"max_episode_steps is '9'; {WHOLE} 1, or None"),
        ({"max_episode_steps": True}, f"max_episode_steps is True; {WHOLE} 1, or None"),
        ({"autoreset_mode": "off"}, "autoreset_mode must be NEXT_STEP or DISABLED, not off"),
    ],
)
def test_a_native_environment_is_not_made_of(refused, given, words):
    refused(lambda: BatchedEnv(**({"task": MAZE} | given)), words)


ACTIONS = [
    (np.nan, "member 1: action[0] is nan; actions must be finite"),
    (np.inf, "member 1: action[0] is inf; actions must be finite"),
    (-np.inf, "member 1: action[0] is -inf; actions must be finite"),
]


@pytest.mark.parametrize("env_id", [MAZE, PENDULUM])
@pytest.mark.parametrize(("value", "words"), ACTIONS)
def test_both_kinds_of_environments_refuse_what_is_not_finite_and_go_on(
    refused, env_id, value, words
):
    env, same = make(env_id, 2, 0), make(env_id, 2, 0)
    zeros = np.zeros(env.action_space.shape, np.float32)
    bad = zeros.copy()
    bad[1, 0] = value
    env.reset(), same.reset()
    refused(lambda: env.step(bad), words)
    # Nothing has moved.
    np.testing.assert_array_equal(env.step(zeros)[0], same.step(zeros)[0])


@pytest.mark.parametrize("env_id", [MAZE, PENDULUM])
@pytest.mark.parametrize(
    ("actions", "words"),
    [
        (lambda zeros: zeros[0], "actions must be numbers of shape (2, "),
        (lambda zeros: zeros[:1], "actions must be numbers of shape (2, ...of shape (1, "),
        (lambda zeros: np.pad(zeros, ((0, 0), (0, 1))), "actions must be numbers of shape (2, "),
        (lambda zeros: zeros > 0, "actions must be numbers...not bool of shape (2, "),
        (lambda zeros: zeros * 1j, "actions must be numbers...not complex64 of shape (2, "),
        (lambda zeros: zeros.astype(str), "actions must be numbers...not <U32 of shape (2, "),
        (lambda zeros: None, "actions must be numbers...not object of shape ()"),
        (lambda zeros: 0.0, "actions must be numbers...not float64 of shape ()"),
    ],
)
def test_no_environment_takes_for_actions(refused, env_id, actions, words):
    env = make(env_id, 2, 0)
    env.reset()
    bad = actions(np.zeros(env.action_space.shape, np.float32))
    refused(lambda: env.step(bad), words)


@pytest.mark.parametrize("env_id", [MAZE, PENDULUM])
@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"seed": "7"}, "seed is '7'"),
        ({"seed": "71"}, "seed is '7'"),
        ({"seed": -1}, f"seed is -1; {WHOLE} 0"),
        ({"seed": 0.5}, f"seed is 0.5; {WHOLE} 0"),
        ({"seed": True}, f"seed is True; {WHOLE} 0"),
        ({"seed": [1, -2]}, f"seed is -2; {WHOLE} 0, or None"),
        ({"seed": [1, 2, 3]}, "expected one seed for each of 2 members, got [1, 2, 3]"),
        ({"options": {"reset_mask": [True, False]}}, "reset_mask must be a boolean array"),
        ({"options": {"reset_mask": np.zeros(2, bool)}}, "with a member to reset"),
        ({"options": {"reset_mask": np.ones(3, bool)}}, "of shape (2,)"),
    ],
)
def test_no_environment_is_reset_with(refused, env_id, given, words):
    env = make(env_id, 2, 0)
    if given.get("seed") == "7":  # A text is a sequence, here of another length.
        words = "expected one seed for each of 2 members, got 7"
    refused(lambda: env.reset(**given), words)


@pytest.mark.parametrize("env_id", [MAZE, PENDULUM])
@pytest.mark.parametrize(
    "change",
    [
        lambda state: None,
        lambda state: {},
        lambda state: state | {"mood": np.zeros(1)},
        lambda state: {name: x for name, x in state.items() if name != "clock"},
        lambda state: state | {"clock": state["clock"][:1]},
        lambda state: state | {"clock": state["clock"].astype(float)},
        lambda state: state | {"clock": None},
        lambda state: state | {"idle": 3},
        lambda state: state | {"generators": state["generators"].astype(str)},
    ],
)
def test_no_environment_goes_on_from(refused, env_id, change):
    env = make(env_id, 2, 0)
    env.reset()
    state = env.get_state()
    refused(lambda: env.set_state(change(state)), "not a state of this environment: expected")
    np.testing.assert_equal(env.get_state(), state)


@pytest.mark.parametrize("env_id", [MAZE, PENDULUM])
def test_whole_numbers_of_numpy_are_whole_numbers(env_id):
    one = make(env_id, np.int32(2), np.int64(3), num_threads=np.uint8(1)).reset()[0]
    other = make(env_id, 2, (np.int64(3), 4)).reset()[0]
    np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(one, make(env_id, 2, 3).reset()[0])


@pytest.mark.parametrize(
    ("spaces", "words"),
    [
        ({"observations": BOX(0, 1, (0,))}, "the observation space...with one axis, not empty"),
        ({"actions": BOX(0, 1, (0,))}, "the action space...with one axis, not empty"),
        ({"observations": BOX(0, 1, (2, 2))}, "the observation space...with one axis"),
        ({"observations": gymnasium.spaces.MultiBinary(3)}, "the observation space MultiBinary"),
    ],
)
@pytest.mark.filterwarnings("ignore")
def test_no_task_has(refused, own, spaces, words):
    odd = own("ownbot/Odd-v0", **spaces)
    refused(lambda: make(odd, 1, 0), f"{odd}: {words}")


@pytest.mark.parametrize(
    ("env_id", "reward", "given", "words"),
    [
        ("Pendulum-v1", {"members": 5}, {}, "has 5 members...choose it, member=0 to 4"),
        ("Pendulum-v1", {"members": 5}, {"member": 5}, "member is 5; expected a whole number in"),
        ("Pendulum-v1", {}, {"member": 0.0}, "member is 0.0; expected a whole number in [0, 0]"),
        (
            "Hopper-v5",
            {},
            {},
            f"the reward of {MAZE} sees 3 numbers of an observation...and none of an action; "
            f"Hopper-v5 has 11 and 3: wrap a task like {MAZE}",
        ),
        ("Pendulum-v1", {"obs_dim": 5}, {}, "sees 5 numbers...Pendulum-v1 has 3 and 1"),
        ("Pendulum-v1", {"obs_dim": 2}, {}, "sees 2 numbers...Pendulum-v1 has 3 and 1"),
        ("Pendulum-v1", {"action_dim": 2}, {}, "and 2 of an action; Pendulum-v1 has 3 and 1"),
        ("CartPole-v1", {"obs_dim": 4}, {}, "CartPole-v1: the action space Discrete(2) is not"),
        ("Pendulum-v1", {"obs_dim": 4}, {"discount": 1}, "discount is 1; expected a number in [0"),
        ("Pendulum-v1", {}, {"discount": None}, "discount is None; expected a number in [0, 1)"),
    ],
)
def test_no_learned_reward_is_paid_by(refused, frozen_reward, env_id, reward, given, words):
    with closing(gymnasium.make(env_id)) as env:
        learned = frozen_reward(**({"members": 1} | reward))
        refused(lambda: LearnedReward(env, learned, **given), words)


def test_a_learned_reward_that_is_not_there_is_named(tmp_path):
    with closing(gymnasium.make(MAZE)) as env, pytest.raises(FileNotFoundError, match="no reward"):
        LearnedReward(env, tmp_path / "reward.safetensors")


class Broken(Arm):
    """A task whose steps are not those of Gymnasium."""

    result = None

    def step(self, action):
        return self.result


OBS = np.zeros(2, np.float32)


@pytest.mark.parametrize(
    ("result", "message"),
    [
        (None, "has failed in its step"),
        ((OBS, 0.0, False, {}), "has failed in its step"),
        ((OBS, None, False, False, {}), "has returned None for a reward; expected a number"),
        ((OBS, "a", False, False, {}), "has returned 'a' for a reward; expected a number"),
    ],
)
@pytest.mark.filterwarnings("ignore")
def test_a_step_of_another_form_is_the_task_s_own_failure(own, monkeypatch, result, message):
    monkeypatch.setattr(Broken, "result", result)
    gymnasium.register("ownbot/Broken-v0", entry_point=Broken, disable_env_checker=True)
    try:
        env = make("ownbot/Broken-v0", 1, 0)
        env.reset()
        with pytest.raises((envs.TaskError, ValueError), match=message):
            env.step(np.zeros((1, 2), np.float32))
    finally:
        del gymnasium.registry["ownbot/Broken-v0"]


@pytest.mark.filterwarnings("ignore")  # Gymnasium's, which say less.
def test_an_observation_of_another_shape_than_the_space_is_named(own, monkeypatch):
    wrong = np.zeros(1, np.float32), {}
    monkeypatch.setattr(Arm, "reset", lambda self, seed=None, options=None: wrong)
    env = make(own("Arm-v0"), 1, 0)
    with pytest.raises(envs.TaskError, match=r"its reset, .* shape \(1,\); expected \(2,\)"):
        env.reset()


def test_a_library_that_a_module_lacks_is_named(tmp_path, monkeypatch):
    (tmp_path / "lacking_robot.py").write_text("import no_such_library\n")
    monkeypatch.syspath_prepend(tmp_path)
    message = "No module named 'no_such_library'; lacking_robot imports it; install it"
    with pytest.raises(ModuleNotFoundError, match=message):
        envs.spec("lacking_robot:Arm-v0")


def test_a_module_that_fails_is_named(tmp_path, monkeypatch):
    (tmp_path / "broken_robot.py").write_text("1 / 0\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(envs.TaskError, match=r"broken_robot:Arm-v0 has failed .* ZeroDivision"):
        envs.spec("broken_robot:Arm-v0")
