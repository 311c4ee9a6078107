"""Data sets that fit a task and data sets that do not."""

import gc
import re
from contextlib import closing

import gymnasium
import minari
import numpy as np
import pytest
from minari.data_collector.episode_buffer import EpisodeBuffer
from minari.storage import get_dataset_path
from own_task import BOX

from offairl_lite import demonstrations
from offairl_lite.demonstrations import Recording, load, write

MAZE = "offairl/PointMazeLeft-v0"


def at(part, index, value):
    """A change to one entry of an episode's part."""

    def change(episode):
        getattr(episode, part)[index] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            at("observations", (3, 1), np.nan),
            r"expected finite observations; found 1 .*\[\[3 1\]\]",
        ),
        (at("actions", (0, 0), np.inf), "expected finite actions; found 1"),
        (at("rewards", 5, np.nan), r"expected finite rewards; found 1 .*\[\[5\]\]"),
        (at("truncations", 199, False), r"expected one end.*\(199\); found no end"),
        (at("terminations", 50, True), r"expected one end.*\(199\); found ends at \[50, 199\]"),
    ],
)
def test_wrong_data_are_refused_with_what_was_expected_and_what_was_found(
    write_dataset, change, message
):
    write_dataset("my/pendulum-v0", episodes=1, change=change)
    where = "data set my/pendulum-v0, episode 0, for the task Pendulum-v1: "
    with pytest.raises(ValueError, match=where + message):
        load("Pendulum-v1", 1, "my/pendulum-v0")


def test_a_data_set_that_cannot_be_written_whole_is_gone(own, minari_folder, monkeypatch):
    def full(*_, **__):
        get_dataset_path("own/part-v0").mkdir(parents=True)
        raise OSError("No space left on device")

    episode = Recording(np.zeros((3, 2)), np.full((2, 2), 0.5), True)
    with monkeypatch.context() as context:
        context.setattr(minari, "create_dataset_from_buffers", full)
        with pytest.raises(OSError, match="No space left"):
            write([episode], own("Arm-v0"), "own/part-v0")
    assert not get_dataset_path("own/part-v0").exists()
    write([episode], "Arm-v0", "own/part-v0")
    assert minari.load_dataset("own/part-v0").total_episodes == 1


def test_data_of_another_task_are_refused(write_dataset):
    write_dataset("my/pendulum-v0")
    message = (
        r"pendulum-v0, .* Hopper-v5: expected observations of shape \(201, 11\); found \(201, 3"
    )
    with pytest.raises(ValueError, match=message):
        load("Hopper-v5", 2, "my/pendulum-v0")
    # The maze's observations are three numbers as well; its actions are two.
    message = r"expected actions of shape \(200, 2\); found \(200, 1\)"
    with pytest.raises(ValueError, match=message):
        load(MAZE, 2, "my/pendulum-v0")


def test_data_of_another_task_that_fit_are_taken_and_the_log_says_so(own, write_dataset, caplog):
    light, heavy = own("ownbot/Arm-v0"), own("ownbot/ArmHeavy-v0", mass=3.0)
    write_dataset("own/light-v0", light)
    load(light, 2, "own/light-v0")
    assert not caplog.records
    data = load(heavy, 2, "own/light-v0")
    assert (data.env_id, data.lengths) == (heavy, (5, 5))
    (message,) = caplog.messages
    assert (
        f"own/light-v0 was made on {light}, and is taken for demonstrations of {heavy}" in message
    )
    assert "nothing else tells the two tasks apart" in message


@pytest.mark.filterwarnings("ignore:Implicitly cleaning up:ResourceWarning")
def test_a_public_data_set_is_taken_by_its_name(minari_folder, caplog):
    """One that is made as Minari's own are, by its collector, with pictures to be seen."""
    pytest.importorskip("jax", reason="Minari's collector needs it: pip install 'minari[create]'")
    name = "mujoco/hopper/expert-v0"
    task = gymnasium.make("Hopper-v5", render_mode="rgb_array")
    with closing(minari.DataCollector(task)) as env:
        for seed in (0, 1):
            env.reset(seed=seed)
            while not env.step(np.ones(3, np.float32))[2]:
                pass
        about = dict.fromkeys(("algorithm_name", "author", "author_email", "description"), "-")
        env.create_dataset(name, eval_env="Hopper-v5", code_permalink="-", **about)
    del env
    gc.collect()  # Minari leaves its temporary folders to be removed by this.
    data = load("Hopper-v5", 2, name)
    assert (len(data), data.transitions.obs.shape[1]) == (2, 11)
    assert data.transitions.terminated.sum() == 2
    assert not caplog.records


def test_a_data_set_that_is_not_here_yet_can_be_downloaded(minari_folder):
    with pytest.raises(FileNotFoundError, match="`minari download mujoco/hopper/medium-v0`"):
        load("Hopper-v5", 2, "mujoco/hopper/medium-v0")


@pytest.mark.filterwarnings("ignore:.*The environment Hopper-v4 is out of date")
def test_another_version_that_fits_is_taken_and_the_log_says_so(write_dataset, caplog):
    write_dataset("mujoco/hopper/old-v0", "Hopper-v4")
    assert load("Hopper-v5", 2, "mujoco/hopper/old-v0").env_id == "Hopper-v5"
    (message,) = caplog.messages
    assert "was made on Hopper-v4, another version of the task, and is taken" in message


def test_other_arguments_that_fit_are_taken_and_the_log_says_so(write_dataset, caplog):
    write_dataset("mujoco/hopper/long-v0", "Hopper-v5", healthy_reward=3.0)
    load("Hopper-v5", 2, "mujoco/hopper/long-v0")
    (message,) = caplog.messages
    assert "was made on Hopper-v5 with {'healthy_reward': 3.0}, and is taken" in message


@pytest.mark.filterwarnings("ignore:.*The environment Ant-v4 is out of date")
@pytest.mark.parametrize(
    ("env_id", "arguments", "made_on"),
    [
        ("Ant-v4", {}, "Ant-v4, another version of the task"),
        (
            "Ant-v5",
            {"include_cfrc_ext_in_observation": False},
            r"Ant-v5 with \{'include_cfrc_ext_in_observation': False\}",
        ),
        ("Hopper-v5", {}, "Hopper-v5"),
    ],
)
def test_another_version_that_does_not_fit_is_named(
    write_dataset, env_id, arguments, made_on, caplog
):
    write_dataset("mujoco/ant/expert-v0", env_id, **arguments)
    message = (
        r"expert-v0, episode 0, for the task Ant-v5: expected observations of shape \(\d+, 105\); "
        r"found \(\d+, (27|11)\)"
    )
    with pytest.raises(ValueError, match=message):
        load("Ant-v5", 2, "mujoco/ant/expert-v0")
    assert re.search(f"was made on {made_on}, and is taken for .* of Ant-v5", caplog.text)


@pytest.mark.filterwarnings("ignore:.* is (set to )?None")
def test_a_data_set_that_names_no_task_is_taken_in_silence(own, minari_folder, caplog):
    env = gymnasium.make(own("ownbot/Arm-v0"))
    arrays = {"observations": np.zeros((6, 2), np.float32), "actions": np.zeros((5, 2), np.float32)}
    ends = {"terminations": [False] * 5, "truncations": [False] * 4 + [True]}
    minari.create_dataset_from_buffers(
        "own/buffers-v0",
        [EpisodeBuffer(id=0, rewards=[0.0] * 5, **arrays, **ends)],
        observation_space=env.observation_space,
        action_space=env.action_space,
    )
    assert load("ownbot/Arm-v0", 1, "own/buffers-v0").lengths == (5,)
    assert not caplog.records


def test_recordings_become_a_data_set(own, minari_folder):
    arm = own("ownbot/Arm-v0")
    rng = np.random.default_rng(0)
    low, high = (gymnasium.make(arm).action_space.low, gymnasium.make(arm).action_space.high)
    cut, fallen = (
        demonstrations.Recording(rng.normal(size=(n + 1, 2)), rng.uniform(low, high, (n, 2)), ends)
        for n, ends in ((5, False), (3, True))
    )
    paid = fallen._replace(reward=np.arange(3.0))
    demonstrations.write([cut, paid], arm, "own/recorded-v0")
    data = load(arm, 2, "own/recorded-v0")
    assert data.lengths == (5, 3)
    assert data.returns.tolist() == [0, 3]
    assert data.transitions.terminated.tolist() == [0] * 7 + [1]
    np.testing.assert_allclose(data.transitions.obs[5:], fallen.obs[:-1], rtol=1e-6)
    scaled = 2 * (cut.action - low) / (high - low) - 1
    np.testing.assert_allclose(data.transitions.action[:5], scaled, atol=1e-5)
    for wrong, message in (
        (cut._replace(obs=cut.obs[:-1]), r"recording 0, .*expected observations of shape \(6, 2\)"),
        (cut._replace(action=cut.action + 9), r"recording 0, .*expected actions\[0\] in"),
    ):
        with pytest.raises(ValueError, match=message):
            demonstrations.write([wrong], arm, "own/wrong-v0")
    with pytest.raises(ValueError, match=r"recordings is .*; expected a list of at least one"):
        demonstrations.write([], arm, "own/wrong-v0")
    with pytest.raises(FileExistsError, match="own/recorded-v0 exists already"):
        demonstrations.write([cut], arm, "own/recorded-v0")
    assert not (minari_folder / "own/wrong-v0").exists()


@pytest.mark.parametrize(
    ("spaces", "message"),
    [
        ({"observations": gymnasium.spaces.Discrete(2)}, "the observation space Discrete"),
        ({"actions": gymnasium.spaces.Discrete(2)}, "the action space Discrete"),
        ({"actions": BOX(-np.inf, np.inf, (2,))}, "has no bounds, .*: give it some that no"),
        ({"actions": BOX(-2, 4, (2,), np.int64)}, "int64. must be a Box of floats: round in the"),
        ({"actions": BOX(1, 1, (2,))}, "must have low < high: leave out"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*maximum and minimum values are equal")
def test_a_task_with_other_spaces_than_boxes_is_refused(own, write_dataset, spaces, message):
    write_dataset("own/arm-v0", own("ownbot/Arm-v0"), episodes=1)
    odd = own("ownbot/Odd-v0", **spaces)
    with pytest.raises(ValueError, match=f"{odd}: .*{message}"):
        load(odd, 1, "own/arm-v0")


def test_storage_that_is_no_folder_is_refused_with_the_way_out(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "file"))
    with pytest.raises(OSError, match=r"cannot be used: .*file.*; set MINARI_DATASETS_PATH"):
        load(MAZE)
