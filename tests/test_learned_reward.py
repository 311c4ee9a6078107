"""The wrappers pay what retraining maximises, and are environments as others expect them."""

from contextlib import closing
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import TransformReward

from offairl_lite.core.absorbing import is_absorbing, loop_of
from offairl_lite.core.experience import with_analytic_return
from offairl_lite.core.loop import Trainer
from offairl_lite.learned_reward import LearnedReward

MAZE, HOPPER, ARM = "offairl/PointMazeRight-v0", "Hopper-v5", "ownbot/Arm-v0"


@pytest.fixture
def reward_of(frozen_reward):
    """Make a reward of a task: of the state alone or not, and with an absorbing state or not."""

    def make(env_id, state_only=True, absorbing=False, members=1):
        with closing(gymnasium.make(env_id)) as env:
            obs_dim, action_dim = env.observation_space.shape[0], env.action_space.shape[0]
        dims = obs_dim + absorbing, 0 if state_only else action_dim
        made = frozen_reward(members, env_id, *dims)
        # So that scaling, and forgetting to scale, would be seen.
        params = torch.arange(made.params.numel()).view_as(made.params).sin()
        mean = made.normaliser.mean + torch.linspace(-0.5, 0.5, dims[0])
        if absorbing:
            mean[..., -1] = 0
        return replace(made, params=params, normaliser=made.normaliser._replace(mean=mean))

    return make


def played(env, actions, seed):
    """What a task pays, and how steps end, when a generator seeded once starts the episodes."""
    env.reset(seed=seed)
    for action in actions:
        _, paid, terminated, truncated, info = env.step(action)
        yield paid, info["task_reward"], terminated
        if terminated or truncated:
            env.reset()


@pytest.mark.parametrize("absorbing", ["none", "bootstrap", "analytic"])
@pytest.mark.parametrize("state_only", [True, False])
@pytest.mark.parametrize("env_id", [MAZE, HOPPER, ARM])
def test_the_reward_is_what_retraining_maximises(
    tiny, own, reward_of, env_id, state_only, absorbing
):
    """The same transitions, with the trainer's own targets where an episode terminates."""
    own(ARM)
    reward = reward_of(env_id, state_only, absorbing != "none")
    common = {"env_id": env_id, "reward": "frozen", "absorbing": absorbing, "train_every": 10}
    config = tiny.change(**common, discount=0.9, normalise=False, learning_starts=150)
    with closing(Trainer(config, (3,), frozen_reward=reward)) as trainer:
        for _ in range(150):
            trainer.collector.step(explore=None)
        trainer.start()
        batch = trainer.collector.replay.held(0)
    batch = type(batch)(*(part.unsqueeze(0) for part in batch))
    wanted = reward(batch.obs, batch.action)
    if absorbing != "none":
        ended, loop = is_absorbing(batch.next_obs), loop_of(batch)
        there = reward(loop.obs, loop.action)
        # The absorbing state's value, of which bootstrapping is a slow way to learn.
        wanted = wanted + ended * 0.9 * there / (1 - 0.9)
        if absorbing == "analytic":
            paid = with_analytic_return(
                batch._replace(reward=reward(batch.obs, batch.action)), there, 0.9
            )
            target = trainer.learner.target(paid, torch.zeros_like(batch.pre_tanh))
            torch.testing.assert_close(wanted[ended], target[ended])
        own_steps = ~is_absorbing(batch.obs)
        batch = type(batch)(*(part[own_steps].unsqueeze(0) for part in batch))
        wanted = wanted[own_steps].unsqueeze(0)
    assert wanted.shape == (1, 150)

    with closing(gymnasium.make(env_id)) as env:
        low, high = env.action_space.low, env.action_space.high
        actions = low + (batch.action[0].numpy() + 1) / 2 * (high - low)
        wrapped = LearnedReward(env, reward, discount=0.9)
        paid, task_reward, terminated = map(
            np.array, zip(*played(wrapped, actions, 3), strict=True)
        )
    assert (terminated.sum() > 2) == (env_id == HOPPER)
    np.testing.assert_allclose(task_reward, batch.reward[0], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(paid, wanted[0], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize("env_id", [MAZE, HOPPER])
def test_a_vector_of_wrapped_tasks_pays_what_single_ones_pay(reward_of, env_id, mode):
    """As the recipe says to wrap a vector."""
    reward = reward_of(env_id, state_only=False, absorbing=True)

    def wrap(env):
        return LearnedReward(env, reward)

    how = {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": mode}}
    vector = gymnasium.make_vec(env_id, 3, **how, wrappers=[wrap], max_episode_steps=20)
    singles = [wrap(gymnasium.make(env_id, max_episode_steps=20)) for _ in range(3)]
    rng, ends = np.random.default_rng(0), []
    vector.reset(seed=5)
    for i, env in enumerate(singles):
        env.reset(seed=5 + i)
    over = np.zeros(3, bool)
    for _ in range(150):
        actions = rng.uniform(-1, 1, vector.action_space.shape).astype(np.float32)
        _, paid, terminated, truncated, info = vector.step(actions)
        for i, env in enumerate(singles):
            if over[i] and mode == AutoresetMode.NEXT_STEP:
                env.reset()
                assert paid[i] == 0
                continue
            _, alone, *_, about = env.step(actions[i])
            np.testing.assert_allclose(paid[i], alone, rtol=1e-6, atol=1e-6)
            ended = (terminated | truncated)[i]
            own = info["final_info"] if ended and mode == AutoresetMode.SAME_STEP else info
            assert own["_task_reward"][i]
            assert own["task_reward"][i] == pytest.approx(about["task_reward"])
            if ended and mode != AutoresetMode.NEXT_STEP:
                env.reset()
        over = terminated | truncated
        ends += [*terminated[over]]
        if over.any() and mode == AutoresetMode.DISABLED:
            vector.reset(options={"reset_mask": over})
    assert set(ends) == ({True, False} if env_id == HOPPER else {False})
    vector.close()


def test_an_episode_that_is_cut_off_is_paid_nothing_more(reward_of):
    reward = reward_of(MAZE, absorbing=True)
    env = LearnedReward(gymnasium.make(MAZE, max_episode_steps=1), reward)
    obs, _ = env.reset(seed=0)
    _, paid, terminated, truncated, _ = env.step(np.zeros(2, np.float32))
    assert (terminated, truncated) == (False, True)
    want = reward(torch.tensor(obs, dtype=torch.float32).view(1, 1, -1)).item()
    assert paid == pytest.approx(want, rel=1e-6)


def test_a_reward_comes_from_a_file_or_a_folder_as_well(reward_of, tmp_path):
    reward = reward_of(MAZE)
    reward.save(tmp_path / "reward.safetensors")
    pays = set()
    for given in (reward, tmp_path, str(tmp_path / "reward.safetensors")):
        env = LearnedReward(gymnasium.make(MAZE), given)
        env.reset(seed=0)
        pays.add(env.step(np.ones(2, np.float32))[1])
    assert len(pays) == 1


def test_the_chosen_member_pays(reward_of):
    reward = reward_of(MAZE, members=3)
    envs = [LearnedReward(gymnasium.make(MAZE), reward, member=i) for i in range(3)]
    for i, env in enumerate(envs):
        obs, _ = env.reset(seed=0)
        want = reward.member(i)(torch.tensor(obs, dtype=torch.float32).view(1, 1, -1)).item()
        assert env.step(np.ones(2, np.float32))[1] == pytest.approx(want, rel=1e-6)


def test_what_is_paid_does_not_depend_on_who_writes_into_observations(own, reward_of):
    own(ARM)
    reward = reward_of(ARM)
    env = LearnedReward(gymnasium.make(ARM), reward)
    obs, _ = env.reset(seed=0)
    want = reward(torch.tensor(obs).view(1, 1, -1)).item()
    obs += 1
    assert env.step(np.ones(2, np.float32))[1] == pytest.approx(want, rel=1e-6)


@pytest.mark.filterwarnings("ignore:.*(different from the unwrapped version|infinity|symmetric)")
@pytest.mark.parametrize("env_id", [MAZE, HOPPER])
def test_gymnasium_s_checker_is_content(reward_of, tmp_path, env_id):
    reward_of(env_id, absorbing=True).save(tmp_path / "reward.safetensors")
    env = LearnedReward(gymnasium.make(env_id), tmp_path)
    check_env(env, skip_render_check=env_id == HOPPER)  # It would open a window.
    again, action = env.spec.make(), env.action_space.sample()
    pays = [(made.reset(seed=1), made.step(action))[1][1] for made in (env, again)]
    assert pays[0] == pays[1]


@pytest.mark.parametrize("env_id", [MAZE, HOPPER])
def test_the_checker_of_stable_baselines_is_content(reward_of, env_id):
    """The trainer itself is tried in tests/book/test_recipe.py."""
    checker = pytest.importorskip(
        "stable_baselines3.common.env_checker",
        reason="stable-baselines3 is not installed: pip install -e '.[sb3]'",
    )
    env = TransformReward(LearnedReward(gymnasium.make(env_id), reward_of(env_id)), lambda r: r - 3)
    checker.check_env(env)
