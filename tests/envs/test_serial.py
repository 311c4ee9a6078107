"""Any Gymnasium task: seeds, resets, states saved and restored, errors."""

import io
import traceback

import gymnasium
import numpy as np
import pytest
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import RescaleAction

from offairl_lite import envs

CAR = "MountainCarContinuous-v0"


class Walk(gymnasium.Env):
    """A random walk that may end at any step, and draws halves of the generator's 64 bits."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float32)
    action_space = gymnasium.spaces.Box(-1, 1, (2,), np.float32)

    def __init__(self, bits=None, shared=None):
        self.bits, self.shared = bits, shared

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        if self.bits is not None and seed is not None:
            self.np_random = np.random.Generator(self.bits(seed))
        self.place = (self.shared or self.np_random).normal(size=2)
        return self.place.astype(np.float32), {}

    def step(self, action):
        action += self.np_random.normal(size=2)  # It may do so with its own action.
        self.place = self.place + action
        reward = float(self.np_random.integers(1000, dtype=np.int32))
        terminated = bool(self.np_random.random() < 0.1)
        return self.place.astype(np.float32), reward, terminated, False, {}


@pytest.fixture(autouse=True)
def walk():
    gymnasium.register("Walk-v0", entry_point=Walk, max_episode_steps=15)
    yield
    del gymnasium.registry["Walk-v0"]


@pytest.fixture
def odd_walk():
    def register(**kwargs):
        gymnasium.register("OddWalk-v0", entry_point=Walk, kwargs=kwargs)
        return "OddWalk-v0"

    yield register
    del gymnasium.registry["OddWalk-v0"]


def act(env_id, observations, noise):
    # The car reaches its goal when it is pushed to where it moves, some cars sooner than others.
    return np.copysign(noise, observations[:, 1:]) if env_id == CAR else noise


def roll(env, noise, observations=None):
    """Actions, the last observations, and all that was returned; whoever has finished is reset."""
    given, rows = [], []
    if observations is None:
        observations, _ = env.reset()
        rows.append(observations)
    for now in noise:
        given.append(act(env.unwrapped.spec and env.unwrapped.spec.id, observations, now))
        observations, rewards, terminated, truncated, _ = env.step(given[-1])
        rows += [observations, rewards, terminated, truncated]
        if (terminated | truncated).any():
            observations, _ = env.reset(options={"reset_mask": terminated | truncated})
            rows.append(observations)
    return given, observations, rows


def replay(env, given, begun):
    """What `roll` recorded, from the actions that it gave."""
    rows = [] if begun else [env.reset()[0]]
    for actions in given:
        rows += env.step(actions)[:4]
        if (rows[-1] | rows[-2]).any():
            rows.append(env.reset(options={"reset_mask": rows[-1] | rows[-2]})[0])
    return rows


def through_a_file(state):
    file = io.BytesIO()
    np.savez(file, **state)
    file.seek(0)
    return dict(np.load(file, allow_pickle=False))


def equal(got, wanted):
    assert len(got) == len(wanted)
    for one, other in zip(got, wanted, strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)


def noise_for(env, steps, seed=0):
    shape = (steps, *env.action_space.shape)
    return np.random.default_rng(seed).uniform(-1, 1, shape).astype(np.float32)


@pytest.mark.parametrize("used", [False, True])
@pytest.mark.parametrize("steps", [None, 0, 1, 13, 110, 200, 233])
@pytest.mark.parametrize("env_id", ["Pendulum-v1", CAR, "Walk-v0", "Hopper-v5"])
def test_restored_state_continues_bit_for_bit(env_id, steps, used):
    env, begun = envs.make(env_id, 3, 5), steps is not None
    observations = None
    if begun:
        half, quarter = steps // 2, steps // 4
        _, observations, _ = roll(env, noise_for(env, half))
        # From here on members are at different steps; one has had a seed of its own.
        observations, _ = env.reset(options={"reset_mask": np.array([False, True, False])})
        _, observations, _ = roll(env, noise_for(env, quarter, seed=1), observations)
        mask = np.array([False, False, True])
        observations, _ = env.reset(seed=70, options={"reset_mask": mask})
        _, observations, _ = roll(env, noise_for(env, steps - half - quarter, seed=2), observations)
    state = env.get_state()
    assert len(set(state["clock"])) > 1 or not steps or steps < 13
    copies = {name: array.copy() for name, array in state.items()}
    given, _, expected = roll(env, noise_for(env, 230, seed=3), observations)
    assert any(row.dtype == bool and row.any() for row in expected)

    other = envs.make(env_id, 3, 80)
    if used:
        roll(other, noise_for(other, 31, seed=4))
    other.set_state(through_a_file(state))
    equal(other.get_state().values(), state.values())
    equal(replay(other, given, begun), expected)
    # The same object goes back, too, and shares nothing with the state's arrays.
    env.set_state(state)
    equal(replay(env, given, begun), expected)
    equal(state.values(), copies.values())


def test_members_are_gymnasiums():
    env = envs.make("Pendulum-v1", 3, [7, 5, 9])
    reference = RescaleAction(
        gymnasium.make_vec(
            "Pendulum-v1", num_envs=3, vector_kwargs={"autoreset_mode": AutoresetMode.DISABLED}
        ),
        np.full(1, -1, np.float32),
        np.full(1, 1, np.float32),
    )
    equal([env.reset()[0]], [reference.reset(seed=[7, 5, 9])[0]])
    for actions in noise_for(env, 200):
        got = env.step(actions)[:4]
        equal(got, reference.step(actions)[:4])
    mask = {"reset_mask": got[3]}
    equal([env.reset(options=mask)[0]], [reference.reset(options=dict(mask))[0]])


@pytest.mark.parametrize("env_id", ["Pendulum-v1", CAR, "Walk-v0"])
def test_a_seed_is_its_generator(env_id):
    seeded, set_by_hand = gymnasium.make(env_id), gymnasium.make(env_id)
    set_by_hand.unwrapped.np_random = seeding.np_random(3)[0]
    equal([seeded.reset(seed=3)[0]], [set_by_hand.reset()[0]])


@pytest.mark.parametrize("env_id", ["Pendulum-v1", "offairl/PointMazeLeft-v0"])
def test_a_finished_member_is_restored_as_one(env_id):
    env, other = envs.make(env_id, 2, 0), envs.make(env_id, 2, 9)
    actions = noise_for(env, 200)
    env.reset()
    for row in actions:
        *_, truncated, _ = env.step(row)
        if truncated.any():
            break
    else:
        pytest.fail("nobody has finished")
    other.set_state(env.get_state())
    for one in (env, other):
        with pytest.raises(RuntimeError, match=r"members \[0, 1\] have no episode in progress"):
            one.step(row)
    options = {"reset_mask": np.array([True, False])}
    equal([env.reset(options=options)[0]], [other.reset(options=options)[0]])
    with pytest.raises(RuntimeError, match=r"members \[1\] have no episode in progress"):
        other.step(row)


@pytest.mark.parametrize("env_id", ["Walk-v0", "Hopper-v5"])
def test_resets_take_what_both_kinds_take(env_id):
    env = envs.make(env_id, 3, [4, 5, 6])
    with pytest.raises(RuntimeError, match=r"members \[0, 1, 2\] have no episode"):
        env.step(noise_for(env, 1)[0])
    first, _ = env.reset()
    second, _ = env.reset()
    equal([env.reset(seed=np.int64(4))[0], env.reset()[0]], [first, second])
    mixed, _ = env.reset(seed=[4, None, 4])
    equal([mixed[[0, 2]]], [first[[0, 0]]])
    env.reset(seed=[4, 5, 6])
    options = {"reset_mask": np.array([False, True, False])}
    masked, _ = env.reset(seed=[9, 4, 9], options=options)
    equal([masked], [first[[0, 0, 2]]])
    assert list(options) == ["reset_mask"]
    with pytest.raises(ValueError, match="one seed for each of 3 members"):
        env.reset(seed=[1, 2])
    with pytest.raises(ValueError, match="reset_mask must be"):
        env.reset(options={"reset_mask": np.zeros(3, bool)})


def test_actions_are_given_as_the_type_of_their_space():
    env, other = envs.make(CAR, 2, 0), envs.make(CAR, 2, 0)
    env.reset(), other.reset()
    actions = noise_for(env, 1)[0]
    equal(env.step(actions.astype(np.float64))[:4], other.step(actions)[:4])


def test_only_the_episodes_in_progress_are_kept():
    env = envs.make("Walk-v0", 2, 0)
    roll(env, noise_for(env, 100))
    state = env.get_state()
    assert len(state["actions"]) == state["clock"].max() < 15


def test_state_of_another_shape_or_name_is_an_error_and_changes_nothing():
    env = envs.make("Walk-v0", 2, 0)
    roll(env, noise_for(env, 30))
    before = env.get_state()
    for wrong in (
        envs.make("Walk-v0", 3, 0).get_state(),
        envs.make("Pendulum-v1", 2, 0).get_state(),
        envs.make("Hopper-v5", 2, 0).get_state(),
        {name: array for name, array in before.items() if name != "actions"},
        {**before, "extra": np.zeros(1)},
        {**before, "clock": before["clock"].astype(float)},
        {**before, "actions": before["actions"][:, :1]},
        {**before, "actions": np.float32(0)},
    ):
        with pytest.raises(ValueError, match=r"not a state of this environment: expected .*clock"):
            env.set_state(wrong)
    equal(env.get_state().values(), before.values())


def test_task_with_randomness_of_its_own_is_an_error(odd_walk):
    env_id = odd_walk(shared=np.random.default_rng(0))
    env = envs.make(env_id, 2, 0)
    env.reset()
    with pytest.raises(ValueError, match=r"OddWalk-v0.*: observations came out differently"):
        env.set_state(env.get_state())


def test_a_task_that_is_made_by_chance_cannot_be_restored_elsewhere(monkeypatch):
    chance = np.random.default_rng(0)

    def made_by_chance(self):
        self.bits, self.shared, size = None, None, chance.normal()
        self.step = lambda action: Walk.step(self, size * action)

    monkeypatch.setattr(Walk, "__init__", made_by_chance)
    first, second = (envs.make("Walk-v0", 1, 0) for _ in range(2))
    first.reset()
    first.step(np.ones((1, 2)))
    with pytest.raises(ValueError, match=r"Walk-v0.*: observations came out differently"):
        second.set_state(first.get_state())


@pytest.mark.parametrize("bits", [np.random.MT19937, np.random.PCG64DXSM])
def test_generator_of_another_kind_runs_but_is_not_saved(odd_walk, bits):
    env = envs.make(odd_walk(bits=bits), 2, 0)
    saved = env.get_state()
    roll(env, noise_for(env, 30))
    message = r"OddWalk-v0.*: expected .* PCG64, .* got Generator\((MT19937|PCG64DXSM)\)"
    with pytest.raises(ValueError, match=message):
        env.get_state()
    with pytest.raises(ValueError, match=message):
        env.set_state(saved)


@pytest.mark.parametrize("where", ["making", "reset", "step"])
def test_an_error_of_the_task_itself_says_so_and_where(walk, monkeypatch, where):
    def broken(self, *given, seed=None, options=None):
        raise ValueError("shapes (2,) and (3,)")

    monkeypatch.setattr(Walk, {"making": "__init__"}.get(where, where), broken)

    def use():
        env = envs.make("Walk-v0", 2, 0)
        env.reset()
        env.step(np.zeros((2, 2), np.float32))

    with pytest.raises(envs.TaskError, match=rf"Walk-v0.* {where}, ValueError: shapes") as caught:
        use()
    assert isinstance(caught.value.__cause__, ValueError)
    frames = traceback.extract_tb(caught.value.__cause__.__traceback__)
    assert frames[-1].name == "broken"
