"""How to ask for the book's checks, the order of the tests, and how fast the machine is.

Below them, what several modules' tests start from: tiny runs and random demonstrations.
"""

import json
import resource
import signal
import time
from pathlib import Path

import gymnasium
import minari
import numpy as np
import pytest
import torch
from minari.data_collector.episode_buffer import EpisodeBuffer

from offairl_lite import demonstrations as module
from offairl_lite import envs
from offairl_lite.config import CORRECTED
from offairl_lite.core.networks import Normaliser, StackedMLP
from offairl_lite.core.policies import Policy, SquashedGaussian, unsquash
from offairl_lite.core.replay import Batch
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rng import Rng
from offairl_lite.demonstrations import Demonstrations

# A shell starts in the background with Ctrl-C ignored, and the processes of tests would inherit it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser):
    parser.addoption(
        "--book",
        type=Path,
        metavar="DIR",
        help="render the executed chapters in DIR and check the result (`make test` does)",
    )


def pytest_collection_modifyitems(items):
    """Chapters first, since they take longest, and the book that is rendered from them last."""
    items.sort(
        key=lambda item: (
            2 * ("book" in getattr(item, "fixturenames", ())) - (item.path.suffix == ".ipynb")
        )
    )


def calibrate():
    """Return the processor seconds of a fixed piece of work; it is like that of the chapters, many
    small products and their gradients, but none of the package's."""
    x, weights = torch.randn((2, 5, 64, 64), generator=torch.Generator().manual_seed(0))
    weights.requires_grad_()
    start = time.process_time()
    for _ in range(2000):
        torch.autograd.grad((x @ weights).tanh().mean(), weights)
    return time.process_time() - start


def kernels():
    """Return the processor seconds of all kernels that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """Measure the work of a chapter, and before and after it how fast the machine is.

    Both are processor seconds, since other work may wait for the same processor, and are kept in
    the executed notebook, for the chapter's budget.
    """
    if item.path.suffix != ".ipynb" or not item.config.option.overwrite:
        return (yield)
    before, earlier = calibrate(), kernels()
    result = yield
    content = json.loads(item.path.read_text("utf-8"))
    content["metadata"]["processor_seconds"] = kernels() - earlier
    content["metadata"]["calibration"] = (before + calibrate()) / 2
    item.path.write_text(json.dumps(content, indent=1), "utf-8")
    return result


@pytest.fixture
def tiny():
    """A run on the maze that takes a second."""
    return CORRECTED.change(
        total_steps=200,
        learning_starts=100,
        batch_size=8,
        hidden=(16, 16),
        reward_hidden=(8, 8),
        shaping_hidden=(8, 8),
        eval_every=100,
        eval_episodes=2,
    )


@pytest.fixture
def random_demonstrations():
    """Make demonstrations by acting at random; no file is involved."""

    def make(env_id, episodes=2):
        env, rng = envs.make(env_id, 1, 0), np.random.default_rng(0)
        rows, lengths = [], []
        for _ in range(episodes):
            obs, done, length = env.reset()[0], False, 0
            while not done:
                action = rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)
                next_obs, reward, terminated, truncated, _ = env.step(action)
                rows.append((obs[0], action[0], next_obs[0], reward[0], terminated[0]))
                obs, done, length = next_obs, terminated[0] or truncated[0], length + 1
            lengths.append(length)
        columns = zip(*rows, strict=True)
        parts = [torch.as_tensor(np.stack(part), dtype=torch.float32) for part in columns]
        parts[1] = unsquash(parts[1])
        return Demonstrations(env_id, Batch(*parts), tuple(lengths))

    return make


@pytest.fixture
def minari_folder(tmp_path, monkeypatch):
    """Minari keeps its data sets here, and nowhere else."""
    folder = tmp_path / "minari"
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder))
    return folder


@pytest.fixture
def write_dataset(minari_folder):
    """Write a Minari data set of random episodes, after `change(episode)` has had its way."""

    def write(
        dataset_id, env_id="Pendulum-v1", episodes=2, change=lambda episode: None, **arguments
    ):
        env, buffers = gymnasium.make(env_id, **arguments), []
        env.action_space.seed(0)
        for i in range(episodes):
            obs, done = [env.reset(seed=i)[0]], False
            actions, rewards = [], []
            while not done:
                actions.append(env.action_space.sample())
                seen, reward, terminated, truncated, _ = env.step(actions[-1])
                obs.append(seen)
                rewards.append(float(reward))
                done = terminated or truncated
            before = [False] * (len(actions) - 1)
            episode = EpisodeBuffer(
                id=i,
                observations=np.stack(obs),
                actions=np.stack(actions),
                rewards=rewards,
                terminations=[*before, terminated],
                truncations=[*before, truncated],
            )
            change(episode)
            buffers.append(episode)
        env.close()
        return minari.create_dataset_from_buffers(
            dataset_id,
            buffers,
            env=env,
            eval_env=env,
            algorithm_name="random",
            author="tests",
            author_email="-",
            code_permalink="-",
            description="random actions",
        )

    return write


@pytest.fixture
def shipped_experts(tmp_path, monkeypatch):
    """Two random policies of the maze, in the place of the shipped experts."""
    actor = SquashedGaussian(3, 2, (8,))
    policy = Policy(
        "offairl/PointMazeLeft-v0", actor, actor.init(Rng((0, 1))), Normaliser.identity(2, 3)
    )
    policy.save(tmp_path / "experts" / "PointMazeLeft.safetensors")
    monkeypatch.setattr(module, "EXPERTS", tmp_path / "experts")
    return policy


@pytest.fixture
def frozen_reward():
    """Make a random reward; it sees the state alone where `action_dim` is 0."""

    def make(members, env_id="offairl/PointMazeLeft-v0", obs_dim=3, action_dim=0):
        net = StackedMLP((obs_dim + action_dim, 4, 1), "tanh")
        params = net.init(Rng(range(members)))
        return Reward(env_id, net, not action_dim, params, Normaliser.identity(members, obs_dim))

    return make


@pytest.fixture
def own():
    """Register tasks of one's own, until the test is over."""
    made = []

    def register(env_id, entry_point="own_task:Arm", **kwargs):
        made.append(env_id)
        gymnasium.register(env_id, entry_point=entry_point, max_episode_steps=5, kwargs=kwargs)
        return env_id

    yield register
    for env_id in made:
        del gymnasium.registry[env_id]
