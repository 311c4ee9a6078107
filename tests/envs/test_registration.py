"""Gymnasium's checkers, `gymnasium.make`, `gymnasium.make_vec` and `envs.make`."""

import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from offairl_lite import envs

OURS = [task for task in envs.TASKS if task.startswith("offairl/")]


class Doubler(gymnasium.Env):
    """Two-dimensional actions from -2 to 4; the observation is the action it was given."""

    def __init__(self, actions=None, observations=None):
        self.action_space = actions or gymnasium.spaces.Box(-2, 4, (2,), np.float32)
        self.observation_space = observations or gymnasium.spaces.Box(-9, 9, (2,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.np_random.uniform(-1, 1, 2).astype(np.float32), {}

    def step(self, action):
        return np.asarray(action, np.float32), 0.0, True, False, {}


@pytest.fixture
def doubler():
    gymnasium.register("Doubler-v0", entry_point=Doubler)
    yield "Doubler-v0"
    del gymnasium.registry["Doubler-v0"]


@pytest.mark.parametrize("high", [1.3, 0.7, 3.3, 9.1])
def test_rounding_leaves_actions_within_their_bounds(high):
    space = gymnasium.spaces.Box(-0.1, np.float32(high), (2,), np.float32)
    gymnasium.register("Tight-v0", entry_point=Doubler, kwargs={"actions": space})
    env = envs.make("Tight-v0", 1, 0)
    del gymnasium.registry["Tight-v0"]
    env.reset()
    for unit in (-1, 1):
        obs, *_ = env.step(np.full((1, 2), unit, np.float32))  # What the task was given.
        assert space.contains(obs[0])
        assert obs[0, 0] == pytest.approx(space.high[0] if unit > 0 else -0.1, abs=1e-6)
        env.reset()


@pytest.mark.parametrize("task", OURS)
def test_gymnasium_checker(task):
    env = gymnasium.make(task)
    check_env(env.unwrapped)
    env.close()


@pytest.mark.parametrize("task", OURS)
def test_make_vec(task):
    env = gymnasium.make_vec(task, num_envs=3)
    assert isinstance(env, envs.BatchedEnv)
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    observations, _ = env.reset(seed=0)
    assert observations in env.observation_space
    single = gymnasium.make(task)
    np.testing.assert_array_equal(single.reset(seed=1)[0], observations[1])
    env.action_space.seed(0)
    for _ in range(5):
        actions = env.action_space.sample()
        batch, alone = env.step(actions), single.step(actions[1])
        np.testing.assert_array_equal(alone[0], batch[0][1])
        assert alone[1:4] == (batch[1][1], batch[2][1], batch[3][1])
    assert gymnasium.make_vec(task, num_envs=2, max_episode_steps=7).max_episode_steps == 7


@pytest.mark.parametrize("limit", [None, 30, 130])
def test_single_environment_has_one_clock(limit):
    env = gymnasium.make("offairl/PointMazeLeft-v0", max_episode_steps=limit)
    for _ in range(2):
        env.reset(seed=0)
        for step in range(1, (limit or 100) + 1):
            *_, terminated, truncated, _ = env.step(np.ones(2, np.float32))
            assert not terminated
            assert truncated == (step == (limit or 100))


def test_make_gives_a_task_of_ours_in_batches():
    env = envs.make("Hopper-v5", 3, 5, num_threads=2)
    assert isinstance(env, envs.BatchedEnv)
    assert env.metadata["autoreset_mode"] is AutoresetMode.DISABLED
    expected = envs.BatchedEnv("Hopper-v5", 3, seeds=[5, 6, 7]).reset()[0]
    np.testing.assert_array_equal(env.reset()[0], expected)
    scattered = envs.make("Hopper-v5", 2, [7, 5]).reset()[0]
    np.testing.assert_array_equal(scattered, expected[[2, 0]])


def test_make_gives_any_other_task_one_by_one(doubler):
    env = envs.make(doubler, 3, 5)
    assert env.metadata["autoreset_mode"] is AutoresetMode.DISABLED
    assert env.single_action_space == gymnasium.spaces.Box(-1, 1, (2,), np.float32)
    first = env.reset()[0]
    for member, seed in enumerate((5, 6, 7)):
        np.testing.assert_array_equal(first[member], Doubler().reset(seed=seed)[0])
    # Only the first reset is seeded.
    assert (env.reset()[0] != first).any(axis=1).all()
    # Actions from -1 to 1 reach the environment as -2 to 4.
    np.testing.assert_allclose(
        env.step(np.array([[-1, 1], [0, 0.5], [1, -1]]))[0], [[-2, 4], [1, 2.5], [4, -2]]
    )


def test_make_leaves_actions_between_minus_one_and_one_alone():
    env = envs.make("Swimmer-v5", 1, 0)
    assert env.single_action_space == gymnasium.spaces.Box(-1, 1, (2,), np.float32)
    assert isinstance(env.unwrapped, gymnasium.vector.SyncVectorEnv)
    assert "RescaleAction" not in str(env)
    env.close()


@pytest.mark.parametrize("unknown", ["Nonsense-v0", "offairl/CustomAnt-v9", "nobody/Nothing-v0"])
def test_unknown_id_lists_the_known_ones(unknown):
    for look in (envs.spec, lambda unknown: envs.make(unknown, 1, 0)):
        with pytest.raises(
            ValueError, match=r"(?s)unknown.*offairl/PointMazeLeft-v0.*env_id name its module"
        ):
            look(unknown)


def test_a_module_that_registers_a_task_is_imported(tmp_path, monkeypatch):
    (tmp_path / "modular.py").write_text(
        "import gymnasium\ngymnasium.register('Modular-v0', entry_point='nowhere:Env')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    try:
        assert envs.spec("modular:Modular-v0").id == "Modular-v0"
        near = "unknown .*modular.py does not register 'Modluar-v0'; did you mean Modular-v0"
        with pytest.raises(ValueError, match=near):
            envs.spec("modular:Modluar-v0")
        with pytest.raises(ValueError, match=r"modular\.py does not register 'Qx-v0'$"):
            envs.spec("modular:Qx-v0")
    finally:
        gymnasium.registry.pop("Modular-v0", None)
        sys.modules.pop("modular", None)
    with pytest.raises(ModuleNotFoundError, match=r"no_such:Modular-v0: .*folder to PYTHON"):
        envs.spec("no_such:Modular-v0")
    with pytest.raises(ValueError, match="unknown environment 'sys:Modular-v0'"):
        envs.spec("sys:Modular-v0")


@pytest.mark.parametrize(
    ("spaces", "message"),
    [
        ({"actions": gymnasium.spaces.Discrete(2)}, "the action space Discrete.*not supported"),
        ({"observations": gymnasium.spaces.Discrete(2)}, "the observation space .*not supported"),
        (
            {"observations": gymnasium.spaces.Box(0, 1, (2, 2))},
            "the observation space .*not supported",
        ),
        (
            {"actions": gymnasium.spaces.Box(-np.inf, np.inf, (2,))},
            r"the action space Box\(-inf.* has no bounds.*TransformAction",
        ),
        (
            {"actions": gymnasium.spaces.Box(-2, 2, (2,), np.int32)},
            r"int32\) must be a Box of floats: round in the task's own step",
        ),
        (
            {"actions": gymnasium.spaces.Box(np.float32([0, 1]), np.float32([1, 1]))},
            r"must have low < high: leave out what cannot be chosen",
        ),
        (
            {
                "observations": gymnasium.spaces.Dict(
                    x=gymnasium.spaces.Sequence(gymnasium.spaces.Discrete(2))
                )
            },
            "the observation space Dict.*not supported",
        ),
    ],
)
@pytest.mark.filterwarnings("ignore:.*maximum and minimum values are equal")
def test_unsupported_spaces_are_errors(spaces, message):
    gymnasium.register("Odd-v0", entry_point=Doubler, kwargs=spaces)
    try:
        with pytest.raises(ValueError, match=message):
            envs.make("Odd-v0", 1, 0)
    finally:
        del gymnasium.registry["Odd-v0"]


def test_flat_boxes_of_numbers_are_supported():
    whole = gymnasium.spaces.Box(0, 255, (3,), np.uint8)
    for dtype in (np.float32, np.float64):
        envs.require_boxes("Own-v0", whole, gymnasium.spaces.Box(-2, 3, (2,), dtype))


@pytest.mark.parametrize(("population", "seed"), [(2, [1]), (1, [1, 2])])
def test_population_and_seeds_must_agree(population, seed):
    with pytest.raises(ValueError, match="expected one seed for each"):
        envs.make("Hopper-v5", population, seed)
