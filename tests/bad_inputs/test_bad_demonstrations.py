"""Bad demonstrations: refused where they come in, with the number of the recording."""

import json
import logging
import sys
import threading
import time
from dataclasses import replace

import gymnasium
import h5py
import numpy as np
import pytest
import torch
from filelock import FileLock

from offairl_lite import demonstrations, envs
from offairl_lite.demonstrations import Demonstrations, Recording, load, require_demonstrations

MAZE, ARM = "offairl/PointMazeLeft-v0", "ownbot/Arm-v0"
WHOLE = "expected a whole number"
ACTION = np.full((4, 2), 0.5)
GOOD = Recording(np.zeros((5, 2)), ACTION, False, np.zeros(4))


@pytest.fixture
def arm(own, minari_folder):
    return own(ARM)


def at(part, index, value):
    """The good recording with one number changed."""
    array = getattr(GOOD, part).copy()
    array[index] = value
    return GOOD._replace(**{part: array})


@pytest.mark.parametrize(
    ("recording", "words"),
    [
        (at("obs", (2, 1), np.nan), "expected finite observations; found 1 ...[[2 1]]"),
        (at("obs", (4, 0), np.inf), "expected finite observations; found 1 ...[[4 0]]"),
        (at("obs", (0, 0), 1e300), "expected finite observations; found 1 ...[[0 0]]"),
        (at("action", (3, 1), np.nan), "expected finite actions; found 1 ...[[3 1]]: [nan]"),
        (at("action", (0, 0), -np.inf), "expected finite actions; found 1"),
        (at("reward", 1, np.nan), "expected finite rewards; found 1 ...[[1]]"),
        (at("reward", 1, 1e300), "expected finite rewards; found 1 ...[[1]]"),
        (at("obs", (0, 1), 1e30), "expected finite observations; found 1 not within ±1e+08"),
        (at("reward", 3, -1e9), "expected finite rewards; found 1 not within ±1e+08...[[3]]"),
        (at("obs", (2, 0), 9.1), "expected observations[0] in [-9, 9]; found 9.1 in step 2"),
        (at("obs", (4, 1), -50), "expected observations[1] in [-9, 9]; found -50 in step 4"),
        (at("action", (1, 0), 4.1), "expected actions[0] in [-2, 4]; found 4.1 in step 1"),
        (at("action", (1, 1), -0.1), "expected actions[1] in [0, 1]; found -0.1 in step 1"),
        (GOOD._replace(obs=GOOD.obs[:-1]), "expected observations of shape (5, 2); found (4, 2)"),
        (GOOD._replace(obs=GOOD.obs[:, :1]), "expected observations of shape (5, 2); found (5, 1)"),
        (GOOD._replace(obs=GOOD.obs.ravel()), "expected observations of shape (5, 2); found (10,)"),
        (
            GOOD._replace(obs=None),
            "expected observations of shape (5, 2); found ()",
        ),
        (
            GOOD._replace(obs=GOOD.obs + 0j),
            "expected observations that are numbers; found complex128",
        ),
        (
            GOOD._replace(obs=GOOD.obs.astype(str)),
            "expected observations that are numbers; found <U32",
        ),
        (GOOD._replace(obs=[[0, 0], [0]]), "cannot be read: ValueError: ...inhomogeneous"),
        (GOOD._replace(obs=torch.zeros(5, 2, requires_grad=True)), "cannot be read: RuntimeError"),
        (
            GOOD._replace(action=ACTION[:3]),
            "of shape (4, 2); found (5, 2); T actions go with T + 1",
        ),
        (GOOD._replace(action=ACTION[:, :1]), "expected actions of shape (4, 2); found (4, 1)"),
        (GOOD._replace(action=ACTION[:0]), "expected at least one step; found none"),
        (GOOD._replace(action=0.5), "expected observations of shape (2, 2); found (5, 2)"),
        (
            GOOD._replace(obs=GOOD.obs.astype(object)),
            "expected observations that are numbers; found obj",
        ),
        (GOOD._replace(action=None), "action is None; expected (T, A), such as zeros"),
        (GOOD._replace(action=ACTION * 1j), "expected actions that are numbers; found complex128"),
        (GOOD._replace(action="left"), "expected observations of shape (2, 2); found (5, 2)"),
        (GOOD._replace(reward=np.zeros(3)), "expected rewards of shape (4,); found (3,)"),
        (GOOD._replace(reward=np.zeros((4, 1))), "expected rewards of shape (4,); found (4, 1)"),
        (GOOD._replace(reward=1.0), "expected rewards of shape (4,); found ()"),
        (GOOD._replace(reward=["a"] * 4), "expected rewards that are numbers; found <U1"),
        (
            GOOD._replace(reward=np.zeros(4) * 1j),
            "expected rewards that are numbers; found complex128",
        ),
        (GOOD._replace(terminated=None), "terminated is None; expected True or False"),
        (GOOD._replace(terminated=1), "terminated is 1; expected True or False"),
        (GOOD._replace(terminated="no"), "terminated is 'no'; expected True or False"),
        (GOOD._replace(terminated=[False] * 4), "terminated is [False, False, False, False]; exp"),
        (GOOD[:2], "cannot be read: TypeError: it is a tuple; expected a Recording(obs, "),
        (GOOD._asdict(), "it is a dict; expected a Recording(obs, action, terminated=...)"),
        (None, "it is a NoneType; expected a Recording"),
    ],
)
def test_no_recording_is_written_with(refused, arm, minari_folder, recording, words):
    refused(
        lambda: demonstrations.write([GOOD, recording, GOOD], arm, "own/wrong-v0"),
        f"recording 1, for the task {ARM}...{words}",
    )
    assert not (minari_folder / "own").exists()


SHAPE = "the action is ...; expected finite numbers in the task's own units, within Box(...[4. 1.]"


@pytest.mark.parametrize(
    ("returned", "words"),
    [
        (np.array([np.nan, 0.5]), "episode 1, step 2: the action is array([nan, 0.5])"),
        ([0.0, np.inf], "episode 1, step 2: the action is [0.0, inf]; expected finite numbers"),
        (np.array([4.1, 0.5]), "episode 1, step 2: the action is array([4.1, 0.5])...clip what"),
        ([0.0, -0.1], SHAPE),
        (np.zeros(3), SHAPE),
        (np.zeros((1, 2)), SHAPE),
        (0.5, SHAPE),
        (None, "the action is None; expected finite numbers"),
        ("left", "the action is 'left'; expected finite numbers"),
        (np.zeros(2) + 0j, SHAPE),
        ((np.zeros(2), None), SHAPE + "...of Stable-Baselines3: model.predict(obs)[0])"),
    ],
)
def test_no_controller_returns(refused, arm, minari_folder, returned, words):
    steps = iter(range(99))
    act = lambda obs: np.array([0, 0.5]) if next(steps) != 7 else returned  # noqa: E731
    make = demonstrations.generate
    refused(lambda: make(act, arm, 3, "own/wrong-v0"), words)
    assert not (minari_folder / "own").exists()


@pytest.mark.parametrize("policy", [None, 3, "runs/arm", np.zeros(2)])
def test_nobody_acts_who_is_no_function(refused, arm, policy):
    make = demonstrations.generate
    words = f"policy is {policy!r}; expected a Policy, or a function that acts"
    refused(lambda: make(policy, arm, 1, "own/wrong-v0"), words)


def test_what_rounding_does_is_no_fault(arm):
    demonstrations.write([at("action", (0, 0), 4 + 1e-7)], arm, "own/good-v0")
    assert load(arm, 1, "own/good-v0").lengths == (4,)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"recordings": []}, "recordings is []; expected a list of at least one Recording"),
        ({"recordings": None}, "recordings is None; expected a list of at least one Recording"),
        ({"recordings": 3}, "recordings is 3; expected a list of at least one Recording"),
        ({"recordings": GOOD}, "recording 0, for the task ownbot/Arm-v0"),
        ({"env_id": None}, "env_id is None; expected a text"),
        ({"env_id": "ownbot/Amr-v0"}, "unknown environment 'ownbot/Amr-v0'"),
        ({"env_id": MAZE}, f"recording 0, for the task {MAZE}: expected observations of shape"),
        ({"env_id": "CartPole-v1"}, "CartPole-v1: the action space Discrete(2) is not supported"),
        ({"dataset_id": "arm"}, "'arm' is not a valid name of a Minari data set; expected a name"),
        ({"dataset_id": "../arm-v0"}, "'../arm-v0' is not a valid name of a Minari data set"),
        ({"dataset_id": 3}, "3 is not a valid name of a Minari data set"),
        ({"dataset_id": None}, "None is not a valid name of a Minari data set"),
    ],
)
def test_nothing_is_written_of(refused, arm, given, words):
    good = {"recordings": [GOOD], "env_id": arm, "dataset_id": "own/wrong-v0"}
    refused(lambda: demonstrations.write(**(good | given)), words)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"env_id": None}, "env_id is None; expected a text"),
        ({"env_id": 3}, "env_id is 3; expected a text"),
        ({"env_id": "3"}, "unknown environment '3'"),
        ({"env_id": None, "dataset_id": None}, "env_id is None; expected a text"),
        ({"env_id": "3", "dataset_id": None}, "unknown environment '3'"),
        ({"trajectories": 0}, f"trajectories is 0; {WHOLE} of at least 1"),
        ({"trajectories": "3"}, f"trajectories is '3'; {WHOLE} of at least 1"),
        ({"trajectories": 1.0}, f"trajectories is 1.0; {WHOLE} of at least 1"),
        ({"trajectories": True}, f"trajectories is True; {WHOLE} of at least 1"),
        ({"trajectories": 3}, "own/good-v0: 3 trajectories were asked for; it has 2"),
        ({"subsample": 0}, f"subsample is 0; {WHOLE} of at least 1"),
        ({"subsample": 2.5}, f"subsample is 2.5; {WHOLE} of at least 1"),
        ({"subsample": True}, f"subsample is True; {WHOLE} of at least 1"),
        ({"experts": 0}, f"experts is 0; {WHOLE} of at least 1, or 'best', or None"),
        ({"experts": "1"}, f"experts is '1'; {WHOLE} of at least 1, or 'best', or None"),
        ({"experts": 9, "env_id": MAZE, "dataset_id": None}, f"experts is 9; {WHOLE} in [1, 2]"),
    ],
)
def test_nothing_is_loaded_of(refused, arm, shipped_experts, given, words):
    demonstrations.write([GOOD, GOOD], arm, "own/good-v0")
    good = {"env_id": arm, "trajectories": 1, "dataset_id": "own/good-v0"}
    refused(lambda: load(**(good | given)), words)


def test_whole_numbers_of_numpy_are_kept_as_plain_ones(arm):
    demonstrations.write([GOOD, GOOD], arm, "own/good-v0")
    data = load(arm, np.int64(2), "own/good-v0", subsample=np.int32(2))
    assert (len(data), json.dumps(data.source)) == (
        2,
        '{"dataset": "own/good-v0", "subsample": 2, "experts": null}',
    )


@pytest.mark.parametrize("find", [demonstrations.expert, demonstrations.short_name])
def test_no_expert_is_found_for(refused, find):
    refused(lambda: find(None), "env_id is None; expected a text")


DATA = Demonstrations(ARM, None, (2, 3))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"every": 0}, f"every is 0; {WHOLE} of at least 1"),
        ({"every": 1.5}, f"every is 1.5; {WHOLE} of at least 1"),
        ({"every": True}, f"every is True; {WHOLE} of at least 1"),
        ({"every": None}, f"every is None; {WHOLE} of at least 1"),
    ],
)
def test_no_demonstrations_are_thinned_by(refused, given, words):
    refused(lambda: DATA.subsample(**given), words)


def damaged(minari_folder, change):
    """Change the file of the data set `own/good-v0`."""
    with h5py.File(minari_folder / "own/good-v0/data/main_data.hdf5", "r+") as file:
        change(file)


def put(part, array):
    """A change to a part of the data set's second episode."""

    def change(file):
        del file[f"episode_1/{part}"]
        if array is not None:
            file[f"episode_1/{part}"] = array

    return change


ENDS = np.array([False, False, False, True])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (put("observations", None), "cannot be read: KeyError"),
        (put("rewards", None), "cannot be read: KeyError"),
        (put("observations", at("obs", (1, 1), np.nan).obs), "expected finite observations; found"),
        (put("observations", at("obs", (1, 1), 1e300).obs), "expected finite observations; found"),
        (put("observations", at("obs", (1, 1), 20).obs), "expected observations[1] in [-9, 9]"),
        (put("observations", GOOD.obs[1:]), "expected observations of shape (5, 2); found (4, 2)"),
        (put("observations", GOOD.obs + 1j), "expected observations that are numbers; found comp"),
        (put("observations", GOOD.obs.astype("S8")), "expected observations that are numbers"),
        (put("observations", 0.0), "expected observations of shape (5, 2); found"),
        (put("actions", ACTION[1:]), "expected actions of shape (4, 2); found (3, 2)"),
        (put("actions", ACTION + 9), "expected actions[0] in [-2, 4]; found 9.5 in step 0"),
        (put("rewards", np.zeros(3)), "expected rewards of shape (4,); found (3,)"),
        (put("rewards", 0.0), "cannot be read: ValueError"),
        (put("terminations", ENDS[1:]), "expected observations of shape (4, 2); found (5, 2)"),
        (put("truncations", ENDS[1:]), "expected truncations of shape (4,); found (3,)"),
        (put("truncations", np.zeros(4, bool)), "expected one end...found no end"),
        (put("truncations", ENDS[::-1]), "expected one end...found ends at [0]"),
        (put("terminations", ~ENDS), "expected one end...found ends at [0, 1, 2, 3]"),
        (put("terminations", ENDS.astype("S5")), "expected terminations that are numbers"),
        (lambda file: file.pop("episode_1"), "cannot be read: KeyError"),
    ],
)
def test_no_data_set_is_loaded_with(refused, arm, minari_folder, change, words):
    demonstrations.write([GOOD, GOOD], arm, "own/good-v0")
    damaged(minari_folder, change)
    where = f"data set own/good-v0, episode 1, for the task {ARM}"
    refused(lambda: load(arm, 2, "own/good-v0"), f"{where}...{words}")
    assert len(load(arm, 1, "own/good-v0")) == 1


@pytest.mark.parametrize("kept", [0, 100, 0.5, 0.9])
def test_a_file_that_was_cut_off_is_named(refused, arm, minari_folder, kept):
    demonstrations.write([GOOD] * 50, arm, "own/good-v0")
    path = minari_folder / "own/good-v0/data/main_data.hdf5"
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content)) if isinstance(kept, float) else kept])
    refused(lambda: load(arm, 50, "own/good-v0"), "data set own/good-v0, episode ...cannot be read")


def changed_metadata(minari_folder, **changes):
    path = minari_folder / "own/good-v0/data/metadata.json"
    content = json.loads(path.read_text()) | changes
    path.write_text(json.dumps({name: x for name, x in content.items() if x is not None}))


@pytest.mark.parametrize(
    ("changes", "trajectories", "words"),
    [
        ({"total_episodes": "many"}, 2, "data set own/good-v0, cannot be read"),
        ({"data_format": "pickle"}, 2, "data set own/good-v0, cannot be read"),
        ({"minari_version": "99"}, 2, "data set own/good-v0, cannot be read: ValueError: ...99"),
        ({"observation_space": "{nope"}, 2, "data set own/good-v0, cannot be read"),
        ({"env_spec": "{nope"}, 2, "data set own/good-v0, cannot be read"),
        ({"total_episodes": 3}, 3, "data set own/good-v0, episode 2...cannot be read: KeyError"),
    ],
)
def test_no_data_set_says_of_itself(refused, arm, minari_folder, changes, trajectories, words):
    demonstrations.write([GOOD, GOOD], arm, "own/good-v0")
    changed_metadata(minari_folder, **changes)
    refused(lambda: load(arm, trajectories, "own/good-v0"), words)


@pytest.mark.parametrize("space", ["observation_space", "action_space"])
def test_a_data_set_does_not_have_its_task_imported(
    refused, arm, minari_folder, tmp_path, monkeypatch, space
):
    (tmp_path / "evil.py").write_text("from own_task import Arm as Evil\n")
    monkeypatch.syspath_prepend(tmp_path)
    demonstrations.write([GOOD, GOOD], arm, "own/good-v0")
    spec = gymnasium.envs.registration.EnvSpec("Evil-v0", entry_point="evil:Evil")
    changed_metadata(minari_folder, env_spec=spec.to_json(), **{space: None})
    words = "data set own/good-v0: expected both spaces among its metadata"
    refused(lambda: load(arm, 2, "own/good-v0"), words)
    assert "evil" not in sys.modules


def test_waiting_for_another_process_is_told(minari_folder, shipped_experts, caplog):
    minari_folder.mkdir()
    locked = threading.Event()

    def other():
        with FileLock(minari_folder / ".offairl.lock"):
            locked.set()
            time.sleep(1.5)

    thread = threading.Thread(target=other)
    thread.start()
    locked.wait()
    with caplog.at_level(logging.WARNING):
        assert len(load(MAZE, 1)) == 1
    thread.join()
    assert "waiting for another process" in caplog.messages[0]
    assert ".offairl.lock" in caplog.messages[0]


@pytest.fixture(scope="module")
def maze():
    env = envs.make(MAZE, 2, 0)
    yield env
    env.close()


@pytest.fixture
def shown(random_demonstrations):
    return random_demonstrations(MAZE)


def test_demonstrations_that_are_right_pass(shown, maze):
    require_demonstrations(shown, maze)
    require_demonstrations(shown.subsample(7), maze)
    ended = shown.transitions.terminated.clone()
    ended[99] = 1  # the end of the first episode
    fallen = replace(shown, transitions=shown.transitions._replace(terminated=ended))
    require_demonstrations(fallen, maze)
    require_demonstrations(fallen.subsample(7), maze)


def one(part, index, value):
    """Demonstrations with one number changed."""

    def change(shown):
        tensor = getattr(shown.transitions, part).clone()
        tensor[index] = value
        return replace(shown, transitions=shown.transitions._replace(**{part: tensor}))

    return change


def whole(part, change):
    """Demonstrations with one part changed."""

    def changed(shown):
        tensor = change(getattr(shown.transitions, part))
        return replace(shown, transitions=shown.transitions._replace(**{part: tensor}))

    return changed


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (one("obs", (3, 1), np.nan), "demonstrations, episode 0: expected finite numbers"),
        (one("obs", (100, 0), np.inf), "demonstrations, episode 1: expected finite numbers"),
        (one("next_obs", (99, 0), np.nan), "demonstrations, episode 0: expected finite numbers"),
        (one("pre_tanh", (199, 1), np.inf), "demonstrations, episode 1: expected finite numbers"),
        (one("reward", 5, np.nan), "demonstrations, episode 0: expected finite numbers"),
        (one("terminated", 5, np.nan), "demonstrations, episode 0: expected finite numbers"),
        (one("obs", (150, 2), 1e30), "demonstrations, episode 1: ...observations in Box("),
        (one("next_obs", (5, 2), -1e30), "demonstrations, episode 0: ...observations in Box("),
        (one("terminated", 50, 1), "demonstrations, episode 0: ...terminated 0, or 1 at the end"),
        (one("terminated", 99, 0.5), "demonstrations, episode 0: ...terminated 0, or 1 at the end"),
        (one("terminated", 199, -1), "demonstrations, episode 1: ...terminated 0, or 1 at the end"),
        (whole("obs", torch.Tensor.double), "obs is torch.float64 of shape (200, 3); expected"),
        (whole("obs", torch.Tensor.long), "obs is torch.int64 of shape (200, 3); expected torch.f"),
        (whole("obs", torch.Tensor.numpy), "obs is float32 of shape (200, 3); expected torch.floa"),
        (whole("obs", torch.Tensor.tolist), "obs is <class 'list'> of shape (); expected torch"),
        (
            whole("obs", lambda x: x[:, :2]),
            "obs is torch.float32 of shape (200, 2); expected torch",
        ),
        (whole("obs", lambda x: x[:50]), "obs is torch.float32 of shape (50, 3); expected torch"),
        (whole("pre_tanh", lambda x: x[:, :1]), "pre_tanh is torch.float32 of shape (200, 1)"),
        (whole("next_obs", lambda x: x[None]), "next_obs is torch.float32 of shape (1, 200, 3)"),
        (whole("reward", lambda x: x[:, None]), "reward is torch.float32 of shape (200, 1); exp"),
        (whole("terminated", torch.Tensor.bool), "terminated is torch.bool of shape (200,); exp"),
        (lambda shown: replace(shown, lengths=(100, 99)), "obs is ...expected ...shape (199, 3)"),
        (lambda shown: replace(shown, lengths=(200, 0)), "lengths is (200, 0); expected a tuple"),
        (lambda shown: replace(shown, lengths=(100.0, 100.0)), "lengths is (100.0, 100.0); exp"),
        (lambda shown: replace(shown, lengths=()), "demonstrations is Demonstrations(...expected"),
        (lambda shown: shown.transitions, "demonstrations is Batch(...expected some of"),
        (lambda shown: "offairl/PointMazeLeft-v0", "demonstrations is 'offairl/PointMazeLeft-v0'"),
        (lambda shown: [shown], "demonstrations is [Demonstrations(...expected some of"),
    ],
)
def test_no_run_learns_from(refused, shown, maze, change, words):
    refused(lambda: require_demonstrations(change(shown), maze), words)


def test_no_run_learns_from_demonstrations_of_another_size(refused, shown):
    env = envs.make("Hopper-v5", 1, 0)
    words = "obs is torch.float32 of shape (200, 3); expected torch.float32 of shape (200, 11)"
    refused(lambda: require_demonstrations(shown, env), words)
