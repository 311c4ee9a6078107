import gymnasium
import numpy as np
import pytest
import torch

from offairl_lite.core import rollouts
from offairl_lite.core.networks import Normaliser
from offairl_lite.core.policies import Policy, SquashedGaussian
from offairl_lite.core.rng import Rng
from offairl_lite.core.rollouts import episode_seeds, rollout

TASKS = {"offairl/PointMazeLeft-v0": (3, 2), "Hopper-v5": (11, 3)}
SEEDS, EPISODES = (4, 9), 3


def random_policy(env_id, extra=0):
    obs_dim, action_dim = TASKS[env_id]
    actor = SquashedGaussian(obs_dim + extra, action_dim, (8,))
    params = actor.init(Rng(SEEDS))
    return Policy(env_id, actor, params, Normaliser.identity(2, obs_dim + extra))


def by_hand(policy, env_id, seed):
    """One episode of a one-member policy's mode in Gymnasium's own environment."""
    env = gymnasium.make(env_id)
    obs, _ = env.reset(seed=seed)
    steps, terminated, truncated = [], False, False
    while not (terminated or truncated):
        seen = torch.as_tensor(obs, dtype=torch.float32).view(1, 1, -1)
        action = policy.act(seen)[0, 0].numpy()
        next_obs, reward, terminated, truncated, _ = env.step(action)
        steps.append((obs, action, next_obs, reward))
        obs = next_obs
    env.close()
    return [np.array(part) for part in zip(*steps, strict=True)], terminated


@pytest.mark.parametrize("extra", [0, 1])
def test_an_action_is_in_the_units_of_the_task(extra):
    policy = random_policy("Hopper-v5", extra).member(1)
    low, high = np.array([-2, 0, -1], np.float32), np.array([2, 5, 1], np.float32)
    obs = np.random.default_rng(0).normal(size=11)
    given = rollouts.action(policy, obs, gymnasium.spaces.Box(low, high))
    x = torch.tensor([*obs, *[0] * extra], dtype=torch.float32)
    expected = np.interp(policy.act(x.view(1, 1, -1))[0, 0], [-1, 1], [0, 1]) * (high - low) + low
    np.testing.assert_allclose(given, expected, rtol=1e-6)
    assert given.dtype == np.float32


def test_rounding_leaves_an_action_within_its_bounds(monkeypatch):
    policy = random_policy("Hopper-v5").member(0)
    monkeypatch.setattr(type(policy), "act", lambda self, obs: torch.ones(1, 1, 3))
    for high in np.linspace(0.5, 3, 100):
        space = gymnasium.spaces.Box(-0.1, np.float32(high), (3,), np.float32)
        assert space.contains(rollouts.action(policy, np.zeros(11), space))


@pytest.mark.parametrize(
    ("members", "size", "actions", "message"),
    [
        ((0, 1), 11, 3, r"2 members for one action; choose one: policy.member\(0\)"),
        ((0,), 12, 3, "sees 11 numbers, .*given 12"),
        ((0,), 11, 2, r"gives 3 numbers, and actions have the shape \(2,\)"),
    ],
)
def test_an_action_of_something_else_is_refused(members, size, actions, message):
    policy = random_policy("Hopper-v5").member(*members)
    with pytest.raises(ValueError, match=message):
        rollouts.action(policy, np.zeros(size), gymnasium.spaces.Box(-1, 1, (actions,)))


class Endless(gymnasium.Env):
    """A task without a time limit; episodes have three steps at most, and end with `at_end`."""

    observation_space = gymnasium.spaces.Box(-1, 1, (3,))
    action_space = gymnasium.spaces.Box(-1, 1, (2,))

    def __init__(self, at_end):
        self.at_end = at_end

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.left = self.np_random.integers(1, 4)
        return np.zeros(3, np.float32), {}

    def step(self, action):
        self.left -= 1
        last = bool(self.left == 0)
        return np.full(3, self.at_end if last else 0, np.float32), 1.0, last, False, {}


@pytest.mark.parametrize(
    ("at_end", "longest", "message"),
    [
        (0.0, 3, None),
        (0.0, 2, r"Endless-v0 has not ended after 2 steps.*max_episode_steps"),
        (
            np.nan,
            3,
            r"Endless-v0, seed 4, is at fault in step . of an episode: its observation.0. is nan",
        ),
        (
            1e9,
            3,
            r"Endless-v0, seed 4, is at fault in step . of an episode: its observation.0. is 1e",
        ),
    ],
)
def test_what_a_task_may_not_do_is_named(at_end, longest, message, monkeypatch):
    given = {"kwargs": {"at_end": at_end}, "disable_env_checker": True}
    gymnasium.register("Endless-v0", entry_point=Endless, **given)
    monkeypatch.setattr(rollouts, "LONGEST", longest)
    policy = random_policy("offairl/PointMazeLeft-v0")
    try:
        if message is None:
            assert rollout(policy, "Endless-v0", SEEDS, 9).lengths.max() == longest
            return
        with pytest.raises(ValueError, match=message):
            rollout(policy, "Endless-v0", SEEDS, 9)
    finally:
        gymnasium.registry.pop("Endless-v0")


@pytest.mark.parametrize("env_id", TASKS)
def test_episodes_are_those_of_a_plain_loop_padded_at_their_end(env_id):
    policy = random_policy(env_id)
    episodes = rollout(policy, env_id, SEEDS, EPISODES)
    seeds = np.reshape(episode_seeds(SEEDS, EPISODES), (2, EPISODES))
    for s in range(2):
        for e in range(EPISODES):
            parts, terminated = by_hand(policy.member(s), env_id, int(seeds[s, e]))
            length = len(parts[3])
            assert episodes.lengths[s, e] == length
            assert episodes.terminated[s, e] == terminated
            assert episodes.running[s, e].tolist() == [True] * length + [False] * (
                episodes.running.shape[2] - length
            )
            for got, wanted in zip(episodes[:4], parts, strict=True):
                np.testing.assert_allclose(got[s, e, :length], wanted, rtol=1e-4, atol=1e-4)
                assert (got[s, e, length:] == 0).all()
            assert episodes.returns[s, e] == pytest.approx(parts[3].sum(), rel=1e-5)
    early = env_id == "Hopper-v5"
    assert episodes.terminated.all() == early
    assert (len(np.unique(episodes.lengths)) > 1) == early


def test_same_seeds_same_episodes():
    policy = random_policy("offairl/PointMazeLeft-v0")
    one, other = (rollout(policy, policy.env_id, SEEDS, 2, sample=True) for _ in range(2))
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b)
    apart = rollout(policy, policy.env_id, SEEDS, 2, sample=True, purpose=1)
    # The start has a velocity that is not seen; the noise is seen at once.
    assert (one.next_obs[:, :, 0] != apart.next_obs[:, :, 0]).any(-1).all()
    assert (np.abs(one.action - apart.action).max((2, 3)) > 0.1).all()


@pytest.mark.parametrize("sample", [False, True])
def test_an_episode_does_not_depend_on_how_many_others_there_are(sample):
    policy = random_policy("offairl/PointMazeLeft-v0")
    many = rollout(policy, policy.env_id, SEEDS, 20, sample=sample)
    few = rollout(policy.member(1), policy.env_id, SEEDS[1:], 2, sample=sample)
    np.testing.assert_allclose(many.action[1:, :2], few.action, atol=1e-4)
    np.testing.assert_allclose(many.obs[1:, :2], few.obs, atol=1e-4)


def test_episodes_do_not_depend_on_how_many_threads_pytorch_has():
    """Large enough for it to use two; what is rounded otherwise, a contact magnifies."""
    actor = SquashedGaussian(11, 3, (400, 300))
    policy = Policy("Hopper-v5", actor, actor.init(Rng((0,))), Normaliser.identity(1, 11))
    before, made = torch.get_num_threads(), []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            made.append(rollout(policy, "Hopper-v5", (0,), 10, sample=True).obs)
            assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)
    np.testing.assert_array_equal(*made)


def test_samples_are_not_the_mode():
    policy = random_policy("offairl/PointMazeLeft-v0")
    mode, sample = (rollout(policy, policy.env_id, SEEDS, 1, sample=s) for s in (False, True))
    assert np.abs(mode.action - sample.action).max() > 0.1


def test_episodes_can_begin_with_a_later_one():
    policy = random_policy("offairl/PointMazeLeft-v0")
    whole, later = (rollout(policy, policy.env_id, SEEDS, 3, first=first) for first in (0, 2))
    np.testing.assert_array_equal(later.obs[:, 0, 0], whole.obs[:, 2, 0])


def test_episode_seeds_depend_on_member_purpose_and_episode():
    seeds = episode_seeds((0, 1, 2), 4)
    assert len(set(seeds) | set(episode_seeds((0, 1, 2), 4, purpose=1))) == 24
    assert episode_seeds((1,), 4) == seeds[4:8]
    assert episode_seeds((1,), 2) == seeds[4:6]
    assert episode_seeds((1,), 2, first=2) == seeds[6:8]


def test_a_policy_with_an_absorbing_indicator_acts_on_the_plain_task():
    env_id = "offairl/PointMazeLeft-v0"
    extended = random_policy(env_id, extra=1)
    weight = extended.params[:, 8 : 8 + 4 * 8].view(2, 4, 8)
    weight[:, 3] = 1e3  # what the indicator, 0 outside the absorbing state, is weighted with
    episodes = rollout(extended, env_id, SEEDS, 1)
    weight[:, 3] = 0
    np.testing.assert_array_equal(rollout(extended, env_id, SEEDS, 1).obs, episodes.obs)


def test_misfits_are_refused():
    policy = random_policy("offairl/PointMazeLeft-v0")
    with pytest.raises(ValueError, match="3 seeds for a policy of 2 members"):
        rollout(policy, policy.env_id, (0, 1, 2), 1)
    with pytest.raises(ValueError, match=r"sees 3 numbers, .*given 11"):
        rollout(policy, "Hopper-v5", SEEDS, 1)


def test_another_number_of_actions_is_refused():
    actor = SquashedGaussian(3, 1, (8,))
    policy = Policy("Lever-v0", actor, actor.init(Rng(SEEDS)), Normaliser.identity(2, 3))
    with pytest.raises(
        ValueError, match=r"Lever-v0 gives 1 numbers, .* \(2,\): choose a task with"
    ):
        rollout(policy, "offairl/PointMazeLeft-v0", SEEDS, 1)
