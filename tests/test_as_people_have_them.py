"""Tasks and data as people have them: what goes wrong says why, and what to do."""

from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
import torch
from own_task import BOX, Arm, Noisy

from offairl_lite import AIRL, demonstrations, envs, minari_storage
from offairl_lite.cloning import clone
from offairl_lite.config import CORRECTED, Config
from offairl_lite.core.loop import Stop, Trainer, train
from offairl_lite.core.rollouts import LONGEST, rollout
from offairl_lite.demonstrations import Recording
from offairl_lite.envs import OneHotActions, TaskError
from offairl_lite.runs import cli, launch, messages, preflight, records

ARM = "ownbot/Arm-v0"
EPISODE = np.zeros((6, 2)), np.zeros((5, 2))


class Endless(gymnasium.Env):
    """A task whose episodes never end; it says how often it was stepped."""

    observation_space = action_space = BOX(-1, 1, (1,))
    steps = 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(1, np.float32), {}

    def step(self, action):
        Endless.steps += 1
        return np.zeros(1, np.float32), 0.0, False, False, {}


class Unpaid(Arm):
    def step(self, action):
        obs, _, *rest = super().step(action)
        return obs, None, *rest


class Clipping(Arm):
    """An arm that clips actions itself, as MuJoCo's robots do."""

    def step(self, action):
        return super().step(np.clip(action, self.action_space.low, self.action_space.high))


# Messages


def test_an_exception_without_words_tells_where_it_is_from_and_with_which_versions(
    own, monkeypatch
):
    class Old(Arm):
        def __init__(self):
            raise AssertionError  # As a package asserts what MuJoCo no longer does.

    own(ARM, Old)
    with pytest.raises(TaskError, match=r"AssertionError in .*, line \d+, `raise AssertionError"):
        envs.make(ARM, 1, 0)
    where = "offairl_lite.envs.serial.packages_distributions"
    monkeypatch.setattr(where, lambda: {__name__: ["pytest"]})
    message = rf"That is pytest {pytest.__version__}, with MuJoCo .*pip install 'mujoco<3.12'"
    with pytest.raises(TaskError, match=message):
        envs.make(ARM, 1, 0)


@pytest.mark.parametrize(
    ("spaces", "words"),
    [
        ({"actions": gymnasium.spaces.Discrete(2)}, "offairl_lite.envs.OneHotActions"),
        ({"actions": BOX(-np.inf, np.inf, (2,))}, "no bounds.*TransformAction"),
        ({"observations": BOX(-1, 1, (2, 2))}, "see gymnasium.wrappers.FlattenObservation"),
        ({"actions": gymnasium.spaces.MultiDiscrete([2, 3])}, "gymnasium.wrappers.TransformAction"),
        ({"actions": BOX(-1, 1, (2, 2))}, "gymnasium.wrappers.TransformAction"),
    ],
)
def test_a_space_that_will_not_do_names_the_wrapper(spaces, words, own):
    own(ARM, **spaces)
    with pytest.raises(ValueError, match=words):
        envs.make(ARM, 1, 0)


def test_a_reward_that_is_none_is_named(own):
    own(ARM, Unpaid)
    env = envs.make(ARM, 1, 0)
    env.reset()
    with (
        pytest.warns(UserWarning, match="reward"),
        pytest.raises(ValueError, match=r"returned None for a reward"),
    ):
        env.step(np.zeros((1, 2), np.float32))
    with (
        pytest.warns(UserWarning, match="reward"),
        pytest.raises(ValueError, match=r"returned None for a reward"),
    ):
        demonstrations.record(lambda obs: np.zeros(2), ARM, 1)


@pytest.mark.parametrize(
    ("marks", "words"),
    [((), "found no end: mark the last step as truncated"), ((1, 4), r"found ends at \[1, 4\]")],
)
def test_an_episode_without_an_end_says_what_to_mark(marks, words, own):
    own(ARM)
    episode = minari_storage._episode(0, Recording(*EPISODE), *envs.spaces(ARM))
    ends = np.isin(np.arange(5), marks)
    episode = minari_storage.replace(episode, truncations=ends)
    with pytest.raises(ValueError, match=words):
        minari_storage._check(episode, "here", *envs.spaces(ARM))


def test_dictionaries_for_a_task_without_them_are_refused(own):
    own(ARM)
    episode = minari_storage._episode(0, Recording(*EPISODE), *envs.spaces(ARM))
    seen = {"goal": EPISODE[0][:, :1], "at": EPISODE[0][:, 1:]}
    episode = minari_storage.replace(episode, observations=seen)
    with pytest.raises(ValueError, match=r"shape \(6, 2\), as the task has; found a dictionary of"):
        minari_storage._check(episode, "here", *envs.spaces(ARM))


@pytest.mark.filterwarnings("ignore:.*The obs returned")
def test_a_faulty_number_names_its_seed(own):
    made = []

    class Broken(Arm):
        def __init__(self):
            super().__init__()
            made.append(self)

        def step(self, action):
            obs, *rest = super().step(action)
            return obs * (np.nan if self is made[-1] else 1), *rest

    own(ARM, Broken)
    config = CORRECTED.change(env_id=ARM, reward="environment", total_steps=20, learning_starts=10)
    with pytest.raises(
        ValueError, match=r"seed 7, is at fault in step 0: its observation\[0\] is nan"
    ):
        train(config, (3, 7), progress=False)


# Tasks


def test_a_task_without_an_end_is_told_before_the_first_step(own):
    gymnasium.register("ownbot/Endless-v0", Endless)
    try:
        Endless.steps = 0
        with pytest.raises(
            ValueError, match=r"has not ended after 20,000 steps: give the task a time.*TimeLimit\("
        ):
            preflight.try_out("ownbot/Endless-v0", 0)
        assert Endless.steps <= LONGEST + 2  # One episode, not ten of each seed.
    finally:
        del gymnasium.registry["ownbot/Endless-v0"]


def test_a_task_without_a_limit_that_ends_is_only_noted():
    gymnasium.register("ownbot/Free-v0", lambda: gymnasium.wrappers.TimeLimit(Arm(), 5))
    try:
        (note,) = preflight.try_out("ownbot/Free-v0", 0)
        assert "no time limit" in note
    finally:
        del gymnasium.registry["ownbot/Free-v0"]


def test_a_task_that_cannot_be_played_again_is_noted(own):
    own(ARM, Noisy)
    (note,) = preflight.try_out(ARM, 0)
    assert "cannot be resumed" in note


def test_inputs_that_are_refused_leave_nothing_open(own):
    opened, closed = [], []

    class Counted(Arm):
        def __init__(self, **kwargs):
            super().__init__(**kwargs)
            opened.append(self)

        def close(self):
            closed.append(self)

    own(ARM, Counted)
    with pytest.raises(ValueError, match="reward_sees"):
        Trainer(CORRECTED.change(env_id=ARM, reward_sees=(9,)), (0, 1), shown(ARM))
    own("ownbot/Odd-v0", Counted, actions=BOX(-np.inf, np.inf, (2,)))
    with pytest.raises(ValueError, match="no bounds"):
        envs.make("ownbot/Odd-v0", 2, 0)
    assert len(opened) == len(closed) > 0


def shown(env_id):
    return demonstrations.of([Recording(*EPISODE), Recording(*EPISODE)], env_id)


def test_discrete_actions_are_imitated_through_a_wrapper(monkeypatch):
    cart = OneHotActions(gymnasium.make("CartPole-v1"))
    assert cart.action_space == BOX(-1, 1, (2,), np.float32)
    assert [int(cart.action(np.array(a))) for a in ([0.1, -0.9], [-1, 0.3])] == [0, 1]
    np.testing.assert_array_equal(cart.encode(np.array([0, 1])), [[1, -1], [-1, 1]])
    late = OneHotActions(gymnasium.make("CartPole-v1"))
    late._discrete = gymnasium.spaces.Discrete(2, start=5)
    assert late.action(late.encode(np.array([6]))[0]) == 6
    with pytest.raises(ValueError, match="expected gymnasium"):
        OneHotActions(Arm())

    def upright(obs):  # It pushes to where the pole leans.
        return int(obs[2] + 0.5 * obs[3] > 0)

    plain = gymnasium.make("CartPole-v1")
    obs, actions = [plain.reset(seed=0)[0]], []
    for _ in range(200):
        actions.append(upright(obs[-1]))
        obs.append(plain.step(actions[-1])[0])
    gymnasium.register(
        "BoxCartPole-v0",
        lambda: OneHotActions(gymnasium.make("CartPole-v1")),
        max_episode_steps=500,
    )
    try:
        recording = Recording(np.stack(obs), cart.encode(np.array(actions)))
        data = demonstrations.of([recording], "BoxCartPole-v0")

        policy = clone(data, (0,), hidden=(16,), steps=300, progress=False)
        assert rollout(policy, "BoxCartPole-v0", (0,), 2).returns.mean() > 100  # A random one: 22.
    finally:
        del gymnasium.registry["BoxCartPole-v0"]


# Demonstrations


FLAT_OBS = np.arange(14, dtype=np.float32).reshape(7, 2) / 10
FLAT = {"obs": FLAT_OBS, "actions": np.full((7, 2), 0.5), "rewards": np.arange(7.0)}
STARTS = np.array([1, 0, 0, 1, 0, 0, 0], bool)
ENDS = np.array([0, 0, 1, 0, 0, 0, 1], bool)
NEXT = np.where(ENDS[:, None], FLAT_OBS + 1, np.roll(FLAT_OBS, -1, 0))


@pytest.mark.parametrize(
    "marks",
    [{"episode_starts": STARTS}, {"dones": ENDS}, {"timeouts": ENDS, "terminals": ENDS & False}],
)
def test_flat_arrays_lose_the_last_action_of_each_episode(marks, caplog):
    first, second = demonstrations.from_flat({**FLAT, **marks})
    np.testing.assert_array_equal(first.obs, FLAT_OBS[:3])
    np.testing.assert_array_equal(second.obs, FLAT_OBS[3:])
    assert [len(r.action) for r in (first, second)] == [2, 3]
    np.testing.assert_array_equal(second.reward, [3, 4, 5])
    assert [r.terminated for r in (first, second)] == [False, False]
    assert caplog.messages == []


def test_flat_arrays_with_next_observations_lose_nothing():
    marks = {"terminals": np.array([0, 0, 1, 0, 0, 0, 0], bool), "timeouts": ENDS}
    first, second = demonstrations.from_flat({**FLAT, **marks, "next_observations": NEXT})
    np.testing.assert_array_equal(first.obs, [*FLAT_OBS[:3], FLAT_OBS[2] + 1])
    np.testing.assert_array_equal(second.obs[-1], FLAT_OBS[6] + 1)
    assert (first.terminated, second.terminated) == (True, False)


@pytest.mark.parametrize("marks", [{}, {"terminals": ENDS & False}, {"terminals": ENDS[:, None]}])
def test_an_episode_ends_where_the_next_row_begins_elsewhere(marks, caplog):
    """As in files of D4RL without `timeouts`: nothing leads from one episode into the next."""
    recordings = demonstrations.from_flat({**FLAT, **marks, "next_obs": NEXT})
    led = np.concatenate([recording.obs[1:] for recording in recordings])
    np.testing.assert_array_equal(led, NEXT)
    assert [len(recording.action) for recording in recordings] == [3, 4]
    assert ("1 rows do not begin where next_obs led" in caplog.text) == (
        not np.any(marks.get("terminals", False))
    )


def test_dones_with_next_observations_say_that_nothing_terminates(caplog):
    recordings = demonstrations.from_flat({**FLAT, "dones": ENDS, "next_obs": NEXT})
    assert not any(recording.terminated for recording in recordings)
    assert "dones may be time limits" in caplog.text


def test_an_episode_may_have_names_of_other_libraries(own):
    """A list of rllab's paths, say, with or without the last observation."""
    own(ARM)
    obs, actions = np.arange(12.0).reshape(6, 2) / 20, np.full((5, 2), 0.5)
    whole = {"observations": obs, "actions": actions, "rewards": np.ones(5), "infos": None}
    row = {**whole, "observations": obs[:-1], "terminals": np.arange(5) == 4}
    led = {**row, "next_observations": obs[1:]}
    data = demonstrations.of([whole, row, led], ARM)
    assert data.lengths == (5, 4, 5)
    np.testing.assert_allclose(data.transitions.next_obs[-1], obs[-1], rtol=1e-6)
    assert data.transitions.terminated.nonzero().flatten().tolist() == [13]
    with pytest.raises(ValueError, match=r"has \['acts', 'states'\]; expected obs and actions"):
        demonstrations.of([{"states": obs, "acts": actions}], ARM)


def test_imitation_s_terminal_at_the_time_limit_is_no_end(own):
    own(ARM)  # Its limit is five steps.
    paths = [
        SimpleNamespace(obs=np.zeros((n + 1, 2)), acts=np.zeros((n, 2)), terminal=True)
        for n in (5, 4)
    ]
    ends = demonstrations.of(paths, ARM).transitions.terminated
    assert ends.nonzero().flatten().tolist() == [8]


def test_episodes_that_were_joined_are_noticed(own, caplog):
    own(ARM)
    demonstrations.of([Recording(np.zeros((8, 2)), np.zeros((7, 2)))], ARM)
    assert "an episode has 7 steps, and the task's time limit is 5" in caplog.text


def test_a_lacking_last_observation_says_what_to_leave_out(own):
    own(ARM)
    with pytest.raises(ValueError, match="leave out the last action"):
        demonstrations.of([Recording(np.zeros((5, 2)), np.zeros((5, 2)))], ARM)


@pytest.mark.filterwarnings("ignore:.*The obs returned")
def test_a_faulty_observation_is_not_blamed_on_whoever_acts(own):
    class Broken(Arm):
        def step(self, action):
            obs, *rest = super().step(action)
            return obs * np.nan, *rest

    own(ARM, Broken)
    with pytest.raises(ValueError, match=r"at fault in episode 0, step 1: its observation\[0\]"):
        demonstrations.record(lambda obs: obs * 0, ARM, 1)


def test_an_end_that_flat_arrays_cannot_show_is_told(caplog):
    recordings = demonstrations.from_flat({**FLAT, "terminals": ENDS})
    assert not any(recording.terminated for recording in recordings)
    assert "2 of 2 episodes terminated" in caplog.text


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, "expected episode_starts or dones"),
        ({"dones": ENDS[:3]}, r"3\} rows, and 7 actions"),
        ({"dones": ENDS | True}, "no episode has two observations"),
    ],
)
def test_flat_arrays_that_cannot_be_cut_are_refused(change, words):
    with pytest.raises(ValueError, match=words):
        demonstrations.from_flat({**FLAT, **change})


def test_actions_out_of_bounds_are_clipped_where_the_task_clips_them(own, caplog):
    own(ARM, Clipping)
    obs, actions = EPISODE[0], np.array([[4.5, 0.5]] * 5)
    data = demonstrations.of([Recording(obs, actions)], ARM)
    np.testing.assert_allclose(data.transitions.action[:, 0], 1, atol=1e-6)
    assert (
        "actions in 5 of 5 steps, of 1 of 1 episodes, are out of bounds, by up to 0.5. The task "
        "clips them" in caplog.text
    )
    own("ownbot/Plain-v0")
    with pytest.raises(
        ValueError, match=r"np.clip it if the robot did; this task, .* does not clip"
    ):
        demonstrations.of([Recording(obs, actions)], "ownbot/Plain-v0")


def test_a_stray_folder_hides_no_data_set(write_dataset, minari_folder, caplog):
    write_dataset("own/pendulum-v0")
    stray = minari_folder / "x" / "own-v0" / "data"
    stray.mkdir(parents=True)
    (stray / "metadata.json").write_text("{}")
    (minari_folder / "own" / "half-v0" / "data").mkdir(parents=True)
    assert list(minari_storage.local_datasets()) == ["own/pendulum-v0"]
    assert str(stray.parent) in caplog.text
    assert len(demonstrations.load("Pendulum-v1", 2, "own/pendulum-v0")) == 2


def test_whoever_acts_worse_than_is_known_is_refused(own, minari_folder):
    own(ARM)
    with pytest.raises(
        ValueError, match=r"return .* on average, and at_least is 100: .*VecNormalize"
    ):
        demonstrations.generate(lambda obs: np.zeros(2), ARM, 2, "own/arm-v0", at_least=100)
    assert minari_storage.local_datasets() == {}
    demonstrations.generate(lambda obs: np.zeros(2), ARM, 2, "own/arm-v0", at_least=0)


@pytest.mark.parametrize(
    ("options", "noted"),
    [
        ({"reward": "dac"}, True),
        ({"reward": "dac", "ablation": "state-pairs"}, False),
        ({"loss": "log-ratio"}, False),
        ({"loss": "airl"}, True),
        ({"reward": "r-sa", "loss": "log-ratio"}, True),
        ({"reward": "sqil"}, True),
    ],
)
def test_actions_that_say_nothing_are_noted_where_they_are_looked_at(options, noted, own):
    own(ARM)
    notes = preflight.check(CORRECTED.change(env_id=ARM, **options), (0,), shown(ARM), {})
    assert any("are the same" in note for note in notes) == noted


# Training and runs


def test_a_callback_s_mistake_does_not_end_a_run(tiny):
    def callback(rows):
        next(iter(()))

    config = tiny.change(reward="environment")
    with pytest.raises(StopIteration):
        train(config, (0,), progress=False, on_evaluation=callback)

    def stop(rows):
        raise Stop

    assert train(config, (0,), progress=False, on_evaluation=stop).steps.tolist() == [100]


def test_training_leaves_the_threads_as_they_were(tiny):
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        train(tiny.change(reward="environment"), (0,), progress=False)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


def test_the_shaping_has_the_learner_s_discount():
    def pair(config):
        return config.learner.discount, config.discriminator.discount

    assert pair(Config.of(discount=0.9)) == pair(CORRECTED.change(discount=0.9)) == (0.9, 0.9)
    assert pair(CORRECTED.change(discount=0.9, discriminator_discount=0.8)) == (0.9, 0.8)
    apart = CORRECTED.change(discriminator_discount=0.8)
    assert pair(apart.change(discount=0.9)) == (0.9, 0.8)


@pytest.mark.parametrize(
    ("error", "memory"),
    [
        (MemoryError(), True),
        (OSError(12, "Cannot allocate memory"), True),
        (RuntimeError("[enforce fail] DefaultCPUAllocator: can't allocate memory"), True),
        (ValueError("allocate_torque is no setting"), False),
    ],
)
def test_memory_is_blamed_for_a_lack_of_memory_alone(error, memory):
    with pytest.raises(SystemExit) as stop, messages.one_line():
        raise error
    assert ("not enough memory" in str(stop.value)) == memory


def test_a_programming_error_keeps_its_traceback():
    with pytest.raises(AttributeError), messages.one_line():
        raise AttributeError("no attribute 'allocate_torque'")


@pytest.mark.parametrize("name", ["ant-transfer", "marsh-transfer", "maze-transfer-rewards"])
def test_the_run_that_is_advised_exists(name, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    own = launch.find(name)
    other, _, variant = own.reward_from.partition("/")
    assert (variant in launch.find(other).variants) == bool(launch.find(other).variants)
    only = f" --only {variant}" if variant else ""
    folder = f"runs/{other}-demo/{variant}".rstrip("/")
    command = launch.run_command(name, "demo")
    with pytest.raises(ValueError, match=f"`offairl run {other}{only} --scale demo`.*{folder}"):
        command(name, schedule={}, learner={}, discriminator={})


def test_what_a_killed_start_left_behind_is_no_run(tmp_path):
    left = tmp_path / ".seeds-0.x" / "run"
    left.mkdir(parents=True)
    (left / "config.json").write_text("{}")
    assert records.folders_in(tmp_path) == []


def test_tensorboard_removes_only_what_it_wrote(tmp_path):
    pytest.importorskip("tensorboard", reason="TensorBoard is not installed")
    from offairl_lite.runs import tensorboard

    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(FileExistsError, match=r"notes\.txt"):
        tensorboard.export(tmp_path, tmp_path, anew=True)
    assert (tmp_path / "notes.txt").read_text() == "mine"


# What else can be begun with


def test_a_learned_reward_begins_with_an_earlier_one(tiny, random_demonstrations):
    data = random_demonstrations(tiny.env_id)
    first = train(tiny, (0, 1), data, progress=False)
    new = {"pretrained_reward": first.reward}
    trainer = Trainer(tiny, (0, 1), data, **new)
    for _ in range(tiny.schedule.learning_starts):
        trainer.collector.step(explore=None)
    trainer.start()
    assert torch.equal(trainer.reward.params, first.reward.params)
    assert torch.equal(trainer.normaliser.mean, first.reward.normaliser.mean)
    trainer.close()
    assert not torch.equal(
        train(tiny, (0, 1), data, progress=False, **new).reward.params, first.reward.params
    )
    for change, words in (
        ({"reward_hidden": (9,)}, r"sees \(3, 0\), by .*sizes=\(3, 9, 1\)"),
        ({"reward": "r-sa"}, r"run's sees \(3, 2\)"),
        ({"absorbing": "bootstrap"}, r"run's sees \(4, 0\)"),
    ):
        with pytest.raises(ValueError, match=words):
            Trainer(tiny.change(**change), (0, 1), data, **new)
    with pytest.raises(ValueError, match="2 members for 1 seeds"):
        Trainer(tiny, (0,), data, **new)
    other = train(tiny, (2, 3), data, progress=False).policy
    with pytest.raises(ValueError, match="scale observations differently"):
        Trainer(tiny.change(pretrained="policy"), (0, 1), data, pretrained_policy=other, **new)


def test_what_a_reward_sees_goes_with_an_absorbing_state(tiny, random_demonstrations):
    data = random_demonstrations(tiny.env_id)
    config = tiny.change(reward_sees=(1,), absorbing="bootstrap")
    reward = train(config, (0,), data, progress=False).reward
    obs = torch.zeros(1, 5, 4)
    obs[0, 1, 0], obs[0, 2, 1], obs[0, 3, 2], obs[0, 4, 3] = 1, 1, 1, 1
    base, x, y, z, absorbing = reward(obs)[0].tolist()
    assert base == x == z
    assert len({base, y, absorbing}) == 3
    with pytest.raises(ValueError, match="indices from 0 to 2"):
        Trainer(tiny.change(reward_sees=(3,), absorbing="bootstrap"), (0,), data)


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("sweep maze-imitation", "write run NAME --grid SETTING=VALUE,VALUE"),
        ("run imitate --generator td3", "write --learner"),
        ("run imitate --carry=policy", "write --pretrained"),
        ("run imitate --no-policy-in-logit", "write --loss log-ratio"),
        ("run imitate --replay-density mixture", "write --loss airl-mixture"),
    ],
)
def test_what_is_no_more_says_what_to_write_instead(command, words):
    with pytest.raises(SystemExit, match=words):
        cli.main(command.split())


def test_earlier_names_say_what_they_are_called_now(capsys, own):
    own(ARM)
    with pytest.raises(SystemExit):
        cli.main(["run", "imitate", "--env-id", "none/such-v0", "--warmup_steps=5"])
    assert "--learning-starts" in capsys.readouterr().err
    with pytest.warns(FutureWarning, match="update_every is called train_every"):
        assert AIRL(ARM, [EPISODE], update_every=7).config.schedule.train_every == 7


def test_a_clone_for_an_absorbing_state_says_how_to_make_it(own):
    own(ARM)
    data = shown(ARM)
    policy = clone(data, (0,), hidden=(8,), steps=1, progress=False)
    config = CORRECTED.change(
        env_id=ARM, hidden=(8,), pretrained="policy", absorbing="bootstrap", total_steps=20_000
    )
    with pytest.raises(ValueError, match="clone with absorbing_state=True"):
        preflight.check(config, (0,), data, {"pretrained_policy": policy})
