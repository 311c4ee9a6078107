import hashlib
import json
import os
import platform
import shutil
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import gymnasium
import minari
import numpy as np
import pytest
import torch
from filelock import FileLock
from own_task import BOX, Arm
from safetensors.torch import load_file

from offairl_lite import demonstrations
from offairl_lite.core import absorbing
from offairl_lite.core.networks import Normaliser
from offairl_lite.core.policies import Policy, SquashedGaussian
from offairl_lite.core.replay import Batch
from offairl_lite.core.rng import Rng
from offairl_lite.core.rollouts import rollout
from offairl_lite.demonstrations import Demonstrations, load, short_name
from offairl_lite.envs.models import GOAL
from shipping import write_reference

MAZE = "offairl/PointMazeLeft-v0"


@pytest.fixture
def arm_policy():
    """Two random policies of the arm."""
    actor = SquashedGaussian(2, 2, (8,))
    return Policy("ownbot/Arm-v0", actor, actor.init(Rng((0, 1))), Normaliser.identity(2, 2))


def test_a_data_set_of_one_s_own_is_loaded_with_its_actions_rescaled(write_dataset):
    dataset = write_dataset("my/pendulum-v0")
    data = load("Pendulum-v1", 2, "my/pendulum-v0")
    assert (data.env_id, data.lengths, len(data)) == ("Pendulum-v1", (200, 200), 2)
    episodes = list(dataset.iterate_episodes())
    actions = np.concatenate([episode.actions for episode in episodes])
    assert np.abs(actions).max() > 1.9  # the task's bounds are ±2
    np.testing.assert_allclose(data.transitions.action, actions / 2, atol=1e-6)
    parts = {
        "obs": [episode.observations[:-1] for episode in episodes],
        "next_obs": [episode.observations[1:] for episode in episodes],
        "reward": [episode.rewards for episode in episodes],
    }
    for name, arrays in parts.items():
        wanted = np.concatenate(arrays)
        np.testing.assert_allclose(getattr(data.transitions, name), wanted, rtol=1e-6)
    # A time limit is no termination.
    assert (data.transitions.terminated == 0).all()
    returns = [sum(episode.rewards) for episode in episodes]
    np.testing.assert_allclose(data.returns, returns, rtol=1e-5)


def test_terminations_are_kept(write_dataset):
    write_dataset("my/hopper-v0", "Hopper-v5", episodes=3)
    data = load("Hopper-v5", 3, "my/hopper-v0")
    ends = np.cumsum(data.lengths) - 1
    assert data.transitions.terminated.nonzero().squeeze(1).tolist() == ends.tolist()


def test_the_first_trajectories_are_taken(write_dataset):
    write_dataset("my/pendulum-v0", episodes=3)
    few, many = (load("Pendulum-v1", n, "my/pendulum-v0") for n in (1, 3))
    assert torch.equal(few.transitions.obs, many.transitions.obs[:200])


def test_a_misspelt_task_with_a_data_set_is_answered_with_what_there_is(write_dataset):
    write_dataset("my/pendulum-v0", episodes=1)
    message = (
        r"'Pendulm-v1'; did you mean Pendulum-v1.* Known are .*PointMazeLeft.*my_module:Pendulm-v1"
    )
    with pytest.raises(ValueError, match=message):
        load("Pendulm-v1", 1, "my/pendulum-v0")


def test_too_few_trajectories_are_refused(write_dataset):
    write_dataset("my/pendulum-v0", episodes=2)
    with pytest.raises(ValueError, match="3 trajectories were asked for; it has 2"):
        load("Pendulum-v1", 3, "my/pendulum-v0")
    with pytest.raises(ValueError, match="trajectories is 0"):
        load("Pendulum-v1", 0, "my/pendulum-v0")


def test_an_unknown_data_set_is_refused_and_those_there_are_listed(write_dataset):
    with pytest.raises(FileNotFoundError, match=r"'my/other-v0'.*no data set at all"):
        load("Pendulum-v1", 1, "my/other-v0")
    write_dataset("my/pendulum-v0", episodes=1)
    with pytest.raises(FileNotFoundError, match=r"'my/other-v0'.*my/pendulum-v0"):
        load("Pendulum-v1", 1, "my/other-v0")


def test_read_only_storage_can_be_read_and_is_refused_before_any_work(
    minari_folder, shipped_experts, monkeypatch
):
    def refuse(dir):
        raise PermissionError(13, "Permission denied", str(dir))

    load(MAZE, trajectories=2)
    monkeypatch.setattr("tempfile.TemporaryFile", refuse)  # the superuser may write anywhere
    load(MAZE, trajectories=2)
    monkeypatch.setattr("offairl_lite.demonstrations.rollout", None)
    with pytest.raises(OSError, match=r"Permission denied.*; set MINARI_DATASETS_PATH"):
        load(MAZE, trajectories=3)


def test_what_another_process_is_making_is_waited_for(minari_folder, shipped_experts, monkeypatch):
    made = load(MAZE, trajectories=2)
    (dataset_id,) = minari.list_local_datasets()
    shutil.rmtree(minari_folder / dataset_id)
    locked, generate = threading.Event(), demonstrations.generate

    def other():
        with FileLock(minari_folder / ".offairl.lock"):
            locked.set()
            time.sleep(0.5)  # time enough to find that nothing is there
            generate(shipped_experts, MAZE, 2, dataset_id)

    monkeypatch.setattr(demonstrations, "generate", None)
    with ThreadPoolExecutor() as pool:
        done = pool.submit(other)
        locked.wait()
        again = load(MAZE, trajectories=2)
        done.result()
    assert torch.equal(again.transitions.obs, made.transitions.obs)


def test_what_was_given_up_half_way_is_made_anew(minari_folder, shipped_experts):
    made = load(MAZE, trajectories=2)
    (dataset_id,) = minari.list_local_datasets()
    data = minari.load_dataset(dataset_id)
    data.storage.update_metadata({"total_episodes": 1})
    again = load(MAZE, trajectories=2)
    assert torch.equal(again.transitions.obs, made.transitions.obs)
    assert minari.list_local_datasets()[dataset_id]["total_episodes"] == 2


def test_a_task_without_experts_lists_those_that_have_some(minari_folder, shipped_experts):
    with pytest.raises(FileNotFoundError, match=rf"Pendulum-v1 \(there are: {MAZE}\)"):
        load("Pendulum-v1")


def test_a_task_of_one_s_own_with_the_name_of_a_shipped_one_is_another(
    own, minari_folder, shipped_experts
):
    shipped, there = load(MAZE, 2), minari.list_local_datasets()
    mine = own("ownbot/PointMazeLeft-v0", observations=BOX(-9, 9, (3,)))
    message = rf"no expert is shipped for {mine} \(there are: {MAZE}\); give .* of a Minari"
    for look in (load, demonstrations.expert, write_reference):
        with pytest.raises(FileNotFoundError, match=message):
            look(mine)
    assert minari.list_local_datasets() == there
    assert torch.equal(load(MAZE, 2).transitions.obs, shipped.transitions.obs)
    demonstrations.generate(shipped_experts, MAZE, 2, "own/maze-v0")
    assert torch.equal(load(MAZE, 2, "own/maze-v0").transitions.obs, shipped.transitions.obs)


@pytest.mark.parametrize("entry_point", ["own_task:Arm", Arm])
def test_a_policy_of_one_s_own_makes_a_data_set(
    own, arm_policy, minari_folder, caplog, entry_point
):
    arm = own("ownbot/Arm-v0", entry_point)
    demonstrations.generate(arm_policy, arm, 3, "own/trained-v0")
    made = demonstrations.first_episodes(arm_policy, arm)
    dataset = minari.load_dataset("own/trained-v0")
    assert dataset.spec.env_spec.id == arm
    episodes = list(dataset.iterate_episodes())
    for i, episode in enumerate(episodes):
        # The task tells what it was given, in its own units.
        np.testing.assert_allclose(episode.actions, episode.observations[1:], atol=1e-6)
        assert all(action in dataset.action_space for action in episode.actions)
        np.testing.assert_array_equal(episode.observations[:-1], made.obs[i % 2, i // 2])
    assert max(np.abs(episode.actions).max() for episode in episodes) > 1
    data = load(arm, 3, "own/trained-v0")
    given = np.concatenate([made.action[i % 2, i // 2] for i in range(3)])
    np.testing.assert_allclose(data.transitions.action, given, atol=1e-6)
    assert not caplog.records


def test_a_controller_of_one_s_own_makes_a_data_set(own, minari_folder, caplog):
    """It sees what the task gives, and its actions are in the task's units and types."""
    arm, seen = own("ownbot/Arm-v0"), []

    def controller(obs):
        seen.append(obs.copy())
        obs[:] = 7  # What it does to its observation is its own business.
        return [3.5, abs(np.sin(len(seen)))]

    demonstrations.generate(controller, arm, 3, "own/scripted-v0")
    data = load(arm, 3, "own/scripted-v0")
    assert data.lengths == (5, 5, 5)
    np.testing.assert_array_equal(data.transitions.obs, seen)
    action = minari.load_dataset("own/scripted-v0")[0].actions
    assert action.dtype == np.float32
    np.testing.assert_allclose(action[:, 0], 3.5)
    np.testing.assert_allclose(data.transitions.action[:, 0], 2 * (3.5 + 2) / 6 - 1, atol=1e-6)
    # Other episodes begin elsewhere, and the same ones again come out the same.
    assert len({row[0] for row in seen[::5]}) == 3
    demonstrations.generate(controller, arm, 2, "own/again-v0")
    again = load(arm, 2, "own/again-v0").transitions.obs
    np.testing.assert_array_equal(again[::5], np.stack(seen[:10:5]))
    assert not caplog.records


def test_a_controller_can_fall(minari_folder):
    demonstrations.generate(lambda obs: np.ones(3), "Hopper-v5", 2, "own/falls-v0")
    data = load("Hopper-v5", 2, "own/falls-v0")
    ends = np.cumsum(data.lengths) - 1
    assert (ends < 500).all()
    assert data.transitions.terminated.nonzero().flatten().tolist() == ends.tolist()
    assert (data.returns > 0).all()


def test_a_model_of_stable_baselines_makes_a_data_set(minari_folder):
    sb3 = pytest.importorskip(
        "stable_baselines3",
        reason="stable-baselines3 is not installed: pip install -e '.[sb3]'",
    )
    model = sb3.PPO("MlpPolicy", "Pendulum-v1", n_steps=16, batch_size=16, seed=0, device="cpu")
    model.learn(16)
    act = lambda obs: model.predict(obs, deterministic=True)[0]  # noqa: E731 (as people write it)
    demonstrations.generate(act, "Pendulum-v1", 2, "own/sb3-v0")
    data = load("Pendulum-v1", 2, "own/sb3-v0")
    assert data.lengths == (200, 200)
    want = model.predict(data.transitions.obs.numpy(), deterministic=True)[0] / 2
    np.testing.assert_allclose(data.transitions.action, want, atol=1e-5)


def test_a_task_is_named_with_its_module(arm_policy, tmp_path, minari_folder, monkeypatch, caplog):
    (tmp_path / "bots.py").write_text(
        "import gymnasium\nfrom own_task import Arm\n"
        "gymnasium.register('Bot-v0', entry_point=Arm, max_episode_steps=5)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    try:
        demonstrations.generate(arm_policy, "bots:Bot-v0", 2, "own/bot-v0")
        for env_id in ("bots:Bot-v0", "Bot-v0"):
            assert load(env_id, 2, "own/bot-v0").env_id == env_id
        assert not caplog.records
    finally:
        gymnasium.registry.pop("Bot-v0", None)
        sys.modules.pop("bots", None)


def test_a_data_set_that_is_there_is_not_overwritten(own, arm_policy, write_dataset):
    arm = own("ownbot/Arm-v0")
    write_dataset("own/arm-v0", arm)
    before = load(arm, 2, "own/arm-v0")
    message = "the data set own/arm-v0 exists already, and is not overwritten: choose another"
    with pytest.raises(FileExistsError, match=message):
        demonstrations.generate(arm_policy, arm, 3, "own/arm-v0")
    assert torch.equal(load(arm, 2, "own/arm-v0").transitions.obs, before.transitions.obs)


@pytest.mark.parametrize(
    ("env_id", "trajectories", "name", "message"),
    [
        (
            "ownbot/Arm-v0",
            0,
            "own/arm-v0",
            "trajectories is 0; expected a whole number of",
        ),
        ("ownbot/Arm-v0", 1, "arm", "'arm' is not a valid name of a Minari data set; expected"),
        ("ownbot/Arm-v0", 1, "../arm-v0", "is not a valid name of a Minari data set"),
        ("ownbot/Amr-v0", 1, "own/arm-v0", "unknown environment 'ownbot/Amr-v0'"),
        ("Pendulum-v1", 1, "own/arm-v0", r"Arm-v0 gives 2 numbers.* have the shape \(1,\)"),
    ],
)
def test_what_cannot_be_made_is_refused_before_any_work(
    own, arm_policy, minari_folder, monkeypatch, env_id, trajectories, name, message
):
    own("ownbot/Arm-v0")
    monkeypatch.setattr(demonstrations, "rollout", None)
    with pytest.raises(ValueError, match=message):
        demonstrations.generate(arm_policy, env_id, trajectories, name)
    assert not minari.list_local_datasets()


@pytest.mark.parametrize(
    ("env_id", "name"), [(MAZE, "PointMazeLeft"), ("Hopper-v5", "Hopper"), ("a/b-c-v12", "b-c")]
)
def test_short_names(env_id, name):
    assert short_name(env_id) == name


def test_experts_make_fifty_trajectories_the_first_time_and_the_same_ones_again(
    minari_folder, shipped_experts, monkeypatch
):
    data = load(MAZE)
    assert data.lengths == (100,) * 50
    assert len(minari.list_local_datasets()) == 1
    assert (data.transitions.terminated == 0).all()

    monkeypatch.setattr(demonstrations, "generate", None)  # it is not made a second time
    again = load(MAZE)
    assert all(map(torch.equal, data.transitions, again.transitions))


def test_other_experts_are_not_mistaken_for_the_data_of_earlier_ones(
    minari_folder, shipped_experts
):
    before = load(MAZE, 2)
    shipped_experts.member(1, 0).save(demonstrations.EXPERTS / "PointMazeLeft.safetensors")
    after = load(MAZE, 2)
    assert not torch.equal(before.transitions.pre_tanh, after.transitions.pre_tanh)


def test_two_folders_get_the_same_data(tmp_path, shipped_experts, monkeypatch):
    made = []
    for name in ("one", "other"):
        monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / name))
        made.append(load(MAZE, 6))
    assert all(map(torch.equal, made[0].transitions, made[1].transitions))


def test_a_trajectory_is_the_same_whether_few_are_asked_for_or_many(minari_folder, shipped_experts):
    few, many = load(MAZE, 3), load(MAZE, 25)  # of two experts: more than one block
    assert (few.lengths, many.lengths) == ((100,) * 3, (100,) * 25)
    for some, all_ in zip(few.transitions, many.transitions, strict=True):
        assert torch.equal(some, all_[:300])
    assert len(np.unique(many.returns)) == 25


def test_trajectories_are_shared_out_over_the_experts(minari_folder, shipped_experts):
    load(MAZE, 5)
    (dataset_id,) = minari.list_local_datasets()
    dataset = minari.load_dataset(dataset_id)
    episodes = list(dataset.iterate_episodes())
    given = {"sample": True, "purpose": demonstrations.PURPOSE}
    made = rollout(shipped_experts, MAZE, range(2), demonstrations.BLOCK, **given)
    for i, episode in enumerate(episodes):
        np.testing.assert_array_equal(episode.observations[:-1], made.obs[i % 2, i // 2])
        np.testing.assert_array_equal(episode.actions, made.action[i % 2, i // 2])
    # Whose policy it was can be seen: the noise of 100 steps averages out.
    obs = torch.as_tensor(np.stack([e.observations[:-1] for e in episodes]), dtype=torch.float32)
    actions = np.stack([e.actions for e in episodes])
    means = [shipped_experts.member(m).act(obs.flatten(0, 1)[None]).view(5, 100, 2) for m in (0, 1)]
    distance = [np.square(actions.mean(1) - m.numpy().mean(1)).sum(-1) for m in means]
    assert (np.argmin(distance, 0) == np.arange(5) % 2).all()


def test_the_first_expert_shows_what_it_shows_among_others(minari_folder, shipped_experts):
    one, both = load(MAZE, 3, experts=1), load(MAZE, 6)
    assert all(map(torch.equal, load(MAZE, 6, experts=2).transitions, both.transitions))
    for alone, together in zip(one.transitions, both.transitions, strict=True):
        assert torch.equal(alone, together.view(6, 100, -1)[::2].reshape(alone.shape))
    # A file of the first alone makes the same: records of an earlier one hold.
    shipped_experts.member(0).save(demonstrations.EXPERTS / "PointMazeLeft.safetensors")
    assert all(map(torch.equal, load(MAZE, 3).transitions, one.transitions))


@pytest.mark.parametrize("experts", [0, 3])
def test_more_experts_than_are_shipped_are_refused(minari_folder, shipped_experts, experts):
    with pytest.raises(ValueError, match=f"experts is {experts}; expected a whole number"):
        load(MAZE, 3, experts=experts)


# MuJoCo rounds otherwise on other kinds of processor, and the experts act anew there.
on_x86 = pytest.mark.skipif(
    platform.machine().lower() not in ("x86_64", "amd64"),
    reason="the shipped demonstrations are the same on x86 alone",
)


@on_x86
@pytest.mark.parametrize("path", sorted(demonstrations.EXPERTS.glob("*.safetensors")))
def test_the_shipped_demonstrations_are_the_same_on_this_machine(path, minari_folder, monkeypatch):
    """`write_reference` has been called since the experts last changed."""
    monkeypatch.setattr(demonstrations, "_say_that_they_differ", None)
    policy = Policy.load(path)
    wanted = json.loads(path.with_suffix(".json").read_text())
    assert wanted["experts"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert [len(of_one) for of_one in wanted["demonstrations"]] == [5] * len(policy)
    assert len(wanted["demonstrated"]) == len(wanted["mean_returns"]) == len(policy)
    returns = load(policy.env_id, len(policy) * demonstrations.BLOCK).returns
    standard_error = returns.std() / np.sqrt(len(returns))
    assert abs(returns.mean() - np.mean(wanted["mean_returns"])) < 5 * standard_error


@on_x86
def test_what_experts_demonstrate_is_noted_for_so_many_of_them(minari_folder):
    wanted = json.loads(demonstrations.expert_file(MAZE).with_suffix(".json").read_text())
    for n, mean in enumerate(wanted["demonstrated"], 1):
        np.testing.assert_allclose(load(MAZE, experts=n).returns.mean(), mean, atol=1e-4)


@on_x86
@pytest.mark.parametrize("instructions", ["default", "avx2"])
def test_demonstrations_do_not_depend_on_how_networks_are_rounded(
    instructions, minari_folder, tmp_path
):
    """Nor do their actions, but u = artanh a is PyTorch's, whose last digit depends on it."""
    here = load("Hopper-v5", 2, experts=1).transitions
    script = (
        "import sys\n"
        "from safetensors.torch import save_file\n"
        "from offairl_lite import demonstrations\n"
        "shown = demonstrations.load('Hopper-v5', 2, experts=1)\n"
        "save_file(shown.transitions._asdict(), sys.argv[1])\n"
    )
    how = {"ATEN_CPU_CAPABILITY": instructions, "MKL_ENABLE_INSTRUCTIONS": "AVX2"}
    how |= {"MINARI_DATASETS_PATH": str(tmp_path / "other")}
    command = [sys.executable, "-c", script, tmp_path / "there"]
    done = subprocess.run(
        command, env=os.environ | how, stderr=subprocess.PIPE, text=True, check=True
    )
    assert "differ from the book's" not in done.stderr
    there = load_file(tmp_path / "there")
    for name in ("obs", "next_obs", "reward", "terminated"):
        assert torch.equal(there[name], getattr(here, name))
    torch.testing.assert_close(there["pre_tanh"], here.pre_tanh)


@pytest.fixture
def elsewhere(monkeypatch):
    """A machine on which the shipped actions lead to other episodes."""
    demonstrations._say_that_they_differ.cache_clear()
    monkeypatch.setattr(demonstrations, "digests", lambda made: ["other"] * len(made.obs))


def test_where_shipped_actions_lead_elsewhere_the_experts_act_anew(
    elsewhere, minari_folder, caplog
):
    data = load(MAZE, 22, experts=2)
    sampled = demonstrations.first_episodes(demonstrations.expert(MAZE), MAZE)
    obs = data.transitions.obs.view(22, 100, -1)
    for i in range(20):
        np.testing.assert_array_equal(obs[i], sampled.obs[i % 2, i // 2].astype(np.float32))
    (message,) = caplog.messages
    assert f"Demonstrations of {MAZE} are sampled on this machine, and differ" in message


@on_x86
def test_more_demonstrations_than_are_shipped_are_sampled(minari_folder, caplog):
    demonstrations._say_that_they_differ.cache_clear()
    fifty = load(MAZE, 50, experts=1)
    assert not caplog.messages
    more = load(MAZE, 51, experts=1)
    assert more.lengths == (100,) * 51
    assert torch.equal(more.transitions.obs[:5000], fifty.transitions.obs)
    assert "the shipped ones (50 of each expert) are too few" in caplog.text


def test_the_best_expert_can_show_alone(minari_folder, tmp_path, monkeypatch):
    folder = shutil.copytree(demonstrations.EXPERTS, tmp_path / "experts")
    monkeypatch.setattr(demonstrations, "EXPERTS", folder)
    note = folder / "PointMazeLeft.json"
    note.write_text(json.dumps(json.loads(note.read_text()) | {"returns": [-6, -6, -5, -6, -6]}))
    best, all_five = load(MAZE, 2, experts="best"), load(MAZE, 10)
    assert best.source["experts"] == "best"
    for alone, together in zip(best.transitions, all_five.transitions, strict=True):
        assert torch.equal(alone, together.view(10, 100, -1)[[2, 7]].reshape(alone.shape))
    with pytest.raises(
        ValueError, match=r"experts is 'worst'; expected .* of at least 1, or 'best'"
    ):
        load(MAZE, 2, experts="worst")


def numbered(lengths, terminated):
    """Episodes whose every number tells the transition's place, and which end as is said."""
    place = torch.arange(sum(lengths), dtype=torch.float32)
    ended = torch.zeros(sum(lengths))
    ended[np.cumsum(lengths) - 1] = torch.tensor(terminated, dtype=torch.float32)
    obs = place[:, None]
    return Demonstrations("Hopper-v5", Batch(obs, obs, obs + 1, place, ended), tuple(lengths))


def test_every_kth_transition_is_kept_from_a_random_one_on():
    data = numbered([100] * 30, [False] * 30)
    thin = data.subsample(20)
    assert thin.lengths == (100,) * 30
    places = thin.transitions.reward.view(30, 5, 20)
    assert (places == places[..., :1]).all()  # each as often as it stands for others
    places = places[..., 0]
    steps = places - 100 * torch.arange(30)[:, None]
    assert (places.diff() == 20).all()
    assert ((steps[:, 0] >= 0) & (steps[:, 0] < 20)).all()
    assert len(steps[:, 0].unique()) > 10  # an offset for each trajectory
    for part, whole in zip(thin.transitions, data.transitions, strict=True):
        assert torch.equal(part, whole[thin.transitions.reward.long()])
    assert torch.equal(data.subsample(20).transitions.reward, thin.transitions.reward)


@pytest.mark.parametrize("length", [1, 2, 7, 20, 33])
@pytest.mark.parametrize("ended", [True, False])
def test_thinning_changes_no_frequency_on_average(length, ended):
    """Every step is there once on average over the offsets, and a termination once exactly."""
    n = 4000
    thin = numbered([length] * n, [ended] * n).subsample(20)
    counts = (thin.transitions.reward.long() % length).bincount(minlength=length) / n
    error = 5 * np.sqrt(20 / n)  # of a step that is there 20 times with a probability of 1/20
    np.testing.assert_allclose(counts, 1, atol=error)
    if ended:
        assert counts[-1] == 1
        assert thin.transitions.terminated.sum() == n


def test_thinned_demonstrations_have_the_returns_of_the_whole_trajectories():
    data = numbered([50, 70, 90], [False, True, False])
    assert np.array_equal(data.subsample(20).returns, data.returns)
    assert np.array_equal(data.subsample(7).subsample(3).returns, data.returns)


def test_terminations_are_never_thinned_out():
    """As many absorbing states as there were; a time limit's last step is like any other."""
    lengths, ends = [7, 33, 100, 101, 3], [True, True, True, False, False]
    data = numbered(lengths, ends)
    thin = data.subsample(20)
    assert thin.transitions.terminated.sum() == 3
    parts = thin.transitions.reward.split(thin.lengths)
    last = [part[-1].item() for part in parts]
    assert last[:3] == (np.cumsum(lengths)[:3] - 1).tolist()
    assert [len(part.unique()) for part in parts] == [2, 3, 5, 5, 1]
    assert len(absorbing.loops(absorbing.rewrite(thin.transitions)).obs) == 3
    every = data.subsample(1)
    assert every.lengths == data.lengths
    assert all(map(torch.equal, every.transitions, data.transitions))


@pytest.mark.parametrize("every", [0, -20])
def test_less_than_every_transition_cannot_be_taken(every):
    with pytest.raises(ValueError, match=f"every is {every}; expected a whole number of"):
        numbered([5], [True]).subsample(every)
    with pytest.raises(ValueError, match=f"subsample is {every}; expected a whole"):
        load("Pendulum-v1", 2, "my/pendulum-v0", subsample=every)


def test_demonstrations_are_thinned_on_load(write_dataset):
    write_dataset("my/pendulum-v0")
    thin, whole = (load("Pendulum-v1", 2, "my/pendulum-v0", every) for every in (20, 1))
    assert thin.lengths == (200, 200)
    wanted = whole.subsample(20)
    assert all(map(torch.equal, thin.transitions, wanted.transitions))
    np.testing.assert_array_equal(thin.returns, whole.returns)


@pytest.mark.parametrize("side", ["Left", "Right"])
def test_the_shipped_experts_of_the_maze_are_experts(side):
    policy = demonstrations.expert(f"offairl/PointMaze{side}-v0")
    episodes = rollout(policy, policy.env_id, range(5), 10)
    rest = np.linalg.norm(episodes.next_obs[..., -20:, :2] - GOAL, axis=-1).mean((1, 2))
    assert len(policy) == 5
    assert (episodes.returns.mean(1) > -7).all()
    assert (rest < 0.02).all()  # at the goal; the wall behind it would stop them at 0.05


@pytest.mark.parametrize("path", sorted(demonstrations.EXPERTS.glob("*.safetensors")))
def test_shipped_experts_return_what_is_noted_of_them(path):
    """Within 5 %, or 0.5 on the maze, or four standard errors where only some episodes fall.

    Another machine's rounding grows over an episode.
    """
    policy = Policy.load(path)
    wanted = np.array(json.loads(path.with_suffix(".json").read_text())["returns"])
    assert wanted.shape == (len(policy),)
    returns = rollout(policy, policy.env_id, range(len(policy)), 10).returns
    off, error = np.abs(returns.mean(1) - wanted), returns.std(1, ddof=1) / np.sqrt(10)
    assert (off <= np.maximum(0.05 * np.abs(wanted) + 0.5, 4 * error)).all()


def test_all_shipped_experts_together_are_small():
    assert sum(path.stat().st_size for path in demonstrations.EXPERTS.iterdir()) < 30e6
