"""Run folders: killed at random moments, resumed, extended, damaged."""

import errno
import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import time
from collections import namedtuple
from dataclasses import replace
from functools import cache
from itertools import count
from pathlib import Path
from typing import get_args

import minari
import numpy as np
import pytest
import torch
from run_folders import create
from safetensors.torch import load_file, save_file

from offairl_lite.config import (
    DiscriminatorConfig,
    LabelReward,
    LearnedReward,
    differences,
    used_settings,
)
from offairl_lite.config.settings import kinds
from offairl_lite.core import networks
from offairl_lite.core.collector import Collector
from offairl_lite.core.loop import Trainer
from offairl_lite.core.networks import Normaliser, StackedMLP, load_weights, save_weights
from offairl_lite.core.policies import Policy, make_actor
from offairl_lite.core.replay import Batch
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rng import Rng
from offairl_lite.core.sac import SAC
from offairl_lite.demonstrations import Demonstrations, load
from offairl_lite.runs import checkpoints, cli, folders, inputs, records

MAZE, HOPPER = "offairl/PointMazeLeft-v0", "Hopper-v5"
SEEDS = (3, 7)

# A server that has imported everything forks the processes that are killed.
PROCESSES = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload(["offairl_lite.runs.folders"])


@pytest.fixture
def plain(tiny):
    """SAC on the true reward: the fastest run there is."""
    config = tiny.change(reward="environment", train_every=20, eval_episodes=1)
    return config.change(total_steps=100, learning_starts=40, eval_every=50)


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "runs" / "one"


def run(folder, config, *, seeds=SEEDS, checkpoint_every=40, **given):
    """Make a run and take it to its end."""
    create(folder, config, seeds, checkpoint_every=checkpoint_every, **given)
    folders.work(folder, demonstrations=given.get("demonstrations"), progress=False)
    return folder


def resume(folder):
    folders.work(folder, progress=False)


def manifest(folder):
    return json.loads((folder / "run.json").read_text())


def files(folder):
    """Every file with its content."""
    return {p: p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def assert_same(one, other):
    """Two folders hold the same results, byte for byte."""
    names = sorted({*one.glob("*.csv"), *one.glob("*.safetensors")})
    assert len(names) >= 2
    for path in names:
        assert path.read_bytes() == (other / path.name).read_bytes(), path.name
    assert not [*one.rglob("*.part"), *other.rglob("*.part")]


class Broken(Exception):
    """Something that stops a process."""


@pytest.fixture
def interrupted(folder, plain, monkeypatch):
    """A run that was stopped at step 90, with a checkpoint at step 80."""
    create(folder, plain, SEEDS, checkpoint_every=40)
    step = Collector.step

    def stop(self, explore):
        if self.steps == 90:
            raise Broken("a stop")
        return step(self, explore)

    with monkeypatch.context() as patch:
        patch.setattr(Collector, "step", stop)
        with pytest.raises(Broken):
            resume(folder)
    return folder


# Kills.


def train(folder, given, moment, times):
    """Work on a run in a process of its own, which kills itself at some moment if one is named."""
    die_at(folder, moment, times)
    demonstrations = None
    if given is not None:
        path, env_id, lengths = given
        tensors = load_file(path)
        batch = Batch(*(tensors[name] for name in Batch._fields))
        demonstrations = Demonstrations(env_id, batch, lengths)
    folders.work(folder, demonstrations=demonstrations, progress=False)


def die_at(folder, moment, times):
    """Have the process kill itself the given time that a moment of its work comes."""
    calls = iter(range(1, 1000))

    def due():
        return next(calls) == times

    def die():
        os.kill(os.getpid(), signal.SIGKILL)

    save, swap, lines = checkpoints.save_weights, os.replace, records.lines

    def save_half(path, tensors, about):
        save(path, tensors, about)
        if due():
            os.truncate(path, path.stat().st_size // 2)
            die()

    def swap_or_die(part, path):
        dies = Path(path).name == "checkpoint.safetensors" and due()
        if dies and moment == "before the swap":
            die()
        swap(part, path)
        if dies:
            die()

    def half_lines(rows):
        if due():
            text = lines(rows)
            with open(folder / "curve.csv", "a") as file:
                file.write(text[: len(text) * 3 // 4])
            die()
        return lines(rows)

    if moment == "half a checkpoint":
        checkpoints.save_weights = save_half
    elif moment == "in a row":
        records.lines = half_lines
    elif moment is not None:
        os.replace = swap_or_die


def start(*args):
    process = PROCESSES.Process(target=train, args=args)
    process.start()
    return process


def status(process):
    """How a process has ended; one whose server is gone ends with 255, whatever it did."""
    process.join()
    assert process.exitcode != 255, "the server that forks these tests' processes was killed"
    return process.exitcode


def finish(*args):
    """Work on a run to its end in a process of its own; return the seconds it took."""
    before = time.monotonic()
    assert status(start(*args, None, 0)) == 0
    return time.monotonic() - before


@pytest.fixture
def given(tmp_path, random_demonstrations):
    """Make demonstrations of a task that can be handed to another process."""

    def make(env_id):
        demonstrations = random_demonstrations(env_id, episodes=5)
        path = tmp_path / "demonstrations.safetensors"
        save_file(demonstrations.transitions._asdict(), path)
        return demonstrations, (path, env_id, demonstrations.lengths)

    return make


HOP = {"env_id": HOPPER, "train_every": 50, "replay_size": 60}
KILLED = {
    "sac": {"reward": "environment"},
    "td3 and dac": {"reward": "dac", "learner": "td3", "replay_size": 60},
    "airl and a learned temperature": {"reward": "r-s", "temperature": None},
    "no absorbing state": {**HOP, "reward": "dac", "learner": "td3"},
    "bootstrapped": {**HOP, "reward": "logit-sa", "absorbing": "bootstrap"},
    "analytic": {**HOP, "reward": "dac", "absorbing": "analytic", "temperature": None},
    "pendulum": {"env_id": "Pendulum-v1", "reward": "environment", "train_every": 50},
    "all from other runs": {"reward": "frozen", "pretrained": "primitives", "guide_steps": 30}
    | {"primitives": 2, "trunk_hidden": (8,), "primitive_hidden": (), "gate_hidden": (8,)},
    "gail and ppo": {**HOP, "reward": "gail-survival", "learner": "ppo"},
    "sqil": {**HOP, "reward": "sqil", "absorbing": "bootstrap"},
    "iq-learn": {"reward": "iq-learn", "temperature": None},
}


@pytest.fixture
def kill_twice(given, tmp_path):
    """Kill a run at two random moments, and compare it with one that is not killed."""

    def kill_twice(config, rng, checkpoint_every):
        demonstrations, handed = given(config.env_id) if config.imitates else (None, None)

        def make(name):
            things = {"demonstrations": demonstrations, **inherited(config)}
            create(tmp_path / name, config, SEEDS, checkpoint_every=checkpoint_every, **things)
            return tmp_path / name

        compare_with_killed(make, handed, rng)

    return kill_twice


def compare_with_killed(make, handed, rng):
    whole = make("whole")
    seconds, kills = finish(whole, handed), 0
    for attempt in range(10):
        folder, kills = make(str(attempt)), 0
        while kills < 2:
            process = start(folder, handed, None, 0)
            time.sleep(rng.uniform(0.1, 0.5) * seconds)
            process.kill()
            if (ended := status(process)) == 0:
                break
            assert ended == -signal.SIGKILL
            kills += 1
        if kills == 2:
            break
        seconds /= 2  # The machine has become faster: the run was over before it was killed.
    assert kills == 2
    finish(folder, handed)
    assert manifest(folder)["state"] == manifest(whole)["state"]
    assert_same(folder, whole)


@pytest.mark.parametrize("case", KILLED)
def test_a_run_that_is_killed_at_random_moments_is_the_same_run(case, tiny, kill_twice):
    rng = np.random.default_rng(list(KILLED).index(case))
    kill_twice(tiny.change(total_steps=300, **KILLED[case]), rng, 60)


CHOICES = {
    "env_id": [MAZE, HOPPER, "Walker2d-v5", "Pendulum-v1"],
    "reward": ["environment", *get_args(LabelReward), *get_args(LearnedReward)],
    "learner": ["sac", "td3", "ppo", "sac-released"],
    "ablation": [None, None, *filter(None, kinds(DiscriminatorConfig))],
    "absorbing": ["none", "bootstrap", "analytic"],
    "loss": ["airl", "airl-mixture", "log-ratio"],
    "temperature": [None, 0.2, 1.0],
    "primitives": [None, None, 2],
    "train_every": [None, 20, 50, 63],
    "replay_size": [10**6, 63, 150],
    "learning_starts": [60, 100, 133],
    "random_hold": [1.0, 7.0],
    "eval_every": [30, 100],
    "total_steps": [200, 300, 431],
    "normalise": [True, False],
    "centre_reward": [True, False],
    "discriminator_updates": [None, 3],
}
SMALL = {"trunk_hidden": (8,), "primitive_hidden": (), "gate_hidden": (8,)}


def draw(tiny, rng, demonstrations):
    """A configuration that makes sense, at random; now and then one of those above."""
    while rng.random() > 0.1:
        flat = {name: some[rng.integers(len(some))] for name, some in CHOICES.items()} | SMALL
        used = used_settings(flat)
        if flat["train_every"] is None and flat["env_id"] in (HOPPER, "Walker2d-v5"):
            continue  # Their episodes have no common end.
        try:
            config = tiny.change(**{name: flat[name] for name in used & flat.keys()})
            shown = demonstrations(config.env_id) if config.imitates else None
            Trainer(config, SEEDS, shown).close()
        except ValueError:
            continue
        return config
    return tiny.change(total_steps=300, **list(KILLED.values())[rng.integers(len(KILLED))])


@pytest.mark.skipif("SOAK_MINUTES" not in os.environ, reason="it is long: make soak MINUTES=10")
@pytest.mark.filterwarnings("default")
def test_runs_of_any_kind_that_are_killed_are_the_same_runs(
    tiny, kill_twice, random_demonstrations, tmp_path
):
    demonstrations = cache(random_demonstrations)
    end = time.monotonic() + 60 * float(os.environ["SOAK_MINUTES"])
    for number in count(int(os.environ.get("SOAK_SEED", time.time()))):
        rng = np.random.default_rng(number)
        config = draw(tiny, rng, demonstrations)
        changed = {name: new for name, (_, new) in differences(tiny, config).items()}
        print(f"SOAK_SEED={number}", changed, flush=True)
        kill_twice(config, rng, int(rng.integers(20, 200)))
        for path in tmp_path.iterdir():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        if time.monotonic() > end:
            return


@pytest.mark.parametrize(
    "moment", ["half a checkpoint", "before the swap", "after the swap", "in a row"]
)
def test_a_run_that_is_killed_at_the_worst_moments_is_the_same_run(moment, plain, tmp_path):
    config = plain.change(eval_every=25)
    whole = run(tmp_path / "whole", config)
    folder = tmp_path / "killed"
    create(folder, config, SEEDS, checkpoint_every=40)
    for times in (1, 2):
        process = start(folder, None, moment, times)
        assert status(process) == -signal.SIGKILL
        assert records.read(folder).seeds == SEEDS
    finish(folder, None)
    assert_same(folder, whole)


def test_a_run_that_is_killed_before_it_exists_leaves_nothing(folder, plain, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", stop)
    with pytest.raises(KeyboardInterrupt):
        create(folder, plain, SEEDS)
    assert list(folder.parent.iterdir()) == []
    with pytest.raises(FileNotFoundError, match=r"no run in .*one: .*`offairl run NAME"):
        resume(folder)


def test_what_stops_a_run_is_noted_and_the_record_can_be_read(interrupted, folder, plain):
    assert manifest(folder)["state"] == "stopped: Broken('a stop')"
    assert manifest(folder)["step"] == 80
    run = records.read(folder)
    assert (run.config, run.seeds, run.steps.tolist()) == (plain, SEEDS, [50])
    assert (run.policy, run.reward) == (None, None)


def test_a_record_can_be_read_at_any_time(folder, plain, monkeypatch):
    train, seen = Trainer.run, set()

    def train_and_read(self):
        for rows in train(self):
            seen.add(len(records.read(folder).rows))
            yield rows

    monkeypatch.setattr(Trainer, "run", train_and_read)
    run(folder, plain)
    assert seen == {0, 2}


def test_the_manifest_says_what_made_the_run(interrupted, folder):
    first = manifest(folder)
    assert first["versions"]["torch"].split("+")[0] == torch.__version__.split("+")[0]
    assert set(first["versions"]) == set(records.PACKAGES)
    assert first["processor"]
    assert (first["threads"], first["cores"]) == (1, os.cpu_count())
    commit = subprocess.run(
        ["git", "-C", Path(folders.__file__).parent, "rev-parse", "HEAD"], capture_output=True
    ).stdout.decode()
    assert (first["commit"] or "")[:40] == commit.strip()
    resume(folder)
    last = manifest(folder)
    assert (last["state"], last["started"]) == ("finished", first["started"])
    # Time lost after the checkpoint does not count.
    assert last["wall_s"] > 0


# Extensions.


@pytest.mark.parametrize("replay_size", [1_000_000, 60])
def test_an_extended_run_is_the_longer_run(replay_size, plain, tmp_path):
    config = plain.change(replay_size=replay_size)
    whole = run(tmp_path / "whole", config.change(total_steps=200))
    folder = run(tmp_path / "extended", config)
    folders.extend(folder, 200)
    assert manifest(folder)["state"] == "waiting"
    resume(folder)
    assert records.read(folder).config.total_steps == 200
    assert_same(folder, whole)


@pytest.mark.parametrize("entry_point", ["own_task:Noisy", "own_task:scaled"])
def test_a_finished_run_that_cannot_go_on_stays_as_it_is(entry_point, plain, folder, own, capsys):
    config = plain.change(env_id=own("own/Noisy-v0", entry_point), total_steps=98)
    run(folder, config)
    before, was = files(folder), records.read(folder)
    with pytest.raises(ValueError, match=r"came out differently when the episodes were played"):
        folders.extend(folder, 200)
    with pytest.raises(SystemExit, match="played again, so a run on it cannot be resumed"):
        cli.main(["resume", str(folder), "--steps", "200"])
    assert files(folder) == before
    cli.main(["resume", str(folder), "--steps", "98"])
    assert f"recorded in {folder}" in capsys.readouterr().out
    assert files(folder) == before
    now = records.read(folder)
    assert now.config == was.config
    # As lines, since a learned return that is NaN is not equal to itself.
    assert records.lines(now.rows) == records.lines(was.rows)
    assert torch.equal(now.policy.params, was.policy.params)


def test_a_finished_run_keeps_its_policy_until_the_longer_one_has_its_own(tiny, folder, given):
    shown, _ = given(MAZE)
    run(folder, tiny, demonstrations=shown)
    before, was = files(folder), records.read(folder)
    with pytest.raises(
        SystemExit, match=r"began with demonstrations that `demonstrations\.load` d"
    ):
        cli.main(["resume", str(folder), "--steps", "300"])
    assert files(folder) == before
    folders.extend(folder, 300)
    replay = folder / "checkpoint" / "replay.f32"
    sound = replay.read_bytes()
    replay.write_bytes(b"damage" + sound[6:])
    with pytest.raises(ValueError, match=r"replay\.f32 is damaged"):
        folders.work(folder, demonstrations=shown, progress=False)
    now = records.read(folder)
    assert now.rows == was.rows
    assert torch.equal(now.policy.params, was.policy.params)
    assert torch.equal(now.reward.params, was.reward.params)
    folders.extend(folder, tiny.total_steps)
    assert folders.is_finished(folder)
    assert {path: path.read_bytes() for path in before if path != replay} == {
        path: content for path, content in before.items() if path != replay
    }
    replay.write_bytes(sound)
    folders.extend(folder, 300)
    folders.work(folder, demonstrations=shown, progress=False)
    assert not torch.equal(records.read(folder).policy.params, was.policy.params)


def test_policies_of_two_lengths_are_not_joined(plain, tmp_path):
    for seed in SEEDS:
        run(tmp_path / f"seeds-{seed}", plain, seeds=(seed,))
    folders.extend(tmp_path, 200)
    assert len(records.read(tmp_path).policy) == 2
    resume(tmp_path / "seeds-3")
    assert records.read(tmp_path).policy is None
    resume(tmp_path / "seeds-7")
    assert len(records.read(tmp_path).policy) == 2


def test_seeds_are_added_beside_those_there(plain, tmp_path):
    alone = run(tmp_path / "alone", plain, seeds=(5, 6))
    first = run(tmp_path / "first", plain)
    folder = shutil.copytree(first, tmp_path / "extended")
    before = files(folder)
    folders.extend(folder, seeds=(5, 6))
    assert records.read(folder).policy is None
    assert records.run_folders(folder) == [folder, folder / "seeds-5-6"]
    resume(folder / "seeds-5-6")
    assert {path: path.read_bytes() for path in before} == before
    assert_same(folder / "seeds-5-6", alone)
    both, parts = records.read(folder), [records.read(part) for part in (first, alone)]
    assert both.seeds == (3, 7, 5, 6)
    np.testing.assert_array_equal(both.returns, np.concatenate([part.returns for part in parts]))
    obs = Rng(both.seeds).normal(5, 3)
    acts = [part.policy.act(obs[i : i + 2]) for i, part in zip((0, 2), parts, strict=True)]
    assert torch.equal(both.policy.act(obs), torch.cat(acts))
    order = [(row.step, row.seed) for row in both.rows]
    assert order == [(step, seed) for step in (50, 100) for seed in both.seeds]
    # All of them are extended together, and further seeds stand beside the others.
    folders.extend(folder, 150, (9,))
    for path in records.run_folders(folder):
        resume(path)
    assert (records.read(folder).seeds, records.read(folder).steps[-1]) == ((3, 7, 5, 6, 9), 150)


def test_a_run_that_has_ended_is_left_as_it_is(plain, folder):
    run(folder, plain)
    before = files(folder)
    resume(folder)
    assert files(folder) == before


def test_an_extension_that_makes_no_sense_is_refused(interrupted, folder):
    before = files(folder)
    with pytest.raises(ValueError, match=r"reached step 80; it cannot end at 70: .*--steps N"):
        folders.extend(folder, 70)
    with pytest.raises(ValueError, match=r"seeds \[7\] are not all new: there are \[3, 7\]"):
        folders.extend(folder, seeds=(7,))
    with pytest.raises(ValueError, match=r"not all new"):
        folders.extend(folder, 200, (8, 8))  # Nor is it extended to 200 steps.
    with pytest.raises(
        ValueError, match=r"seeds is .*; expected a tuple, each part a whole number of at least 0"
    ):
        folders.extend(folder, seeds=(-1,))
    assert files(folder) == before


def frozen_reward(members):
    net = StackedMLP((3, 4, 1), "tanh")
    params = net.init(Rng(range(members)))
    return Reward(MAZE, net, True, params, Normaliser.identity(members, 3))


def policy(config):
    """A policy that has not learned anything, of two members."""
    actor = make_actor(config.learner, 3, 2)
    return Policy(MAZE, actor, actor.init(Rng((0, 1))), Normaliser.identity(2, 3))


def inherited(config):
    """What a run of two members has of other runs."""
    if config.reward != "frozen":
        return {}
    guide = policy(config.change(primitives=None, pretrained="nothing"))
    return {"frozen_reward": frozen_reward(2), "pretrained_policy": policy(config), "guide": guide}


def test_policies_of_other_runs_are_kept_and_must_stay(plain, tmp_path):
    config = plain.change(pretrained="policy", guide_steps=20)
    folder, given = tmp_path / "run", {"pretrained_policy": policy(plain), "guide": policy(plain)}
    create(folder, config, SEEDS, checkpoint_every=40, **given)
    resume(folder)
    assert records.read(folder).policy is not None
    with pytest.raises(ValueError, match="the pretrained policy and the guide, of 2 members"):
        folders.extend(folder, seeds=(8,))
    folders.extend(folder, 200)
    changed = replace(given["guide"], params=given["guide"].params + 1)
    changed.save(folder / "guide.safetensors")
    with pytest.raises(ValueError, match=r"guide\.safetensors is not the guide .* put that back"):
        resume(folder)


def test_a_run_from_before_a_field_existed_goes_on_with_its_default(plain, folder):
    run(folder, plain)
    path = folder / "checkpoint" / "checkpoint.safetensors"
    state, about = load_weights(path, "checkpoint")
    for name in ("pretrained", "guide_steps"):
        del about["identity"][name]
    del about["digest"]
    save_weights(path, state, {**about, "digest": inputs.digest(state, about)})
    folders.extend(folder, 200)
    resume(folder)
    assert records.read(folder).steps[-1] == 200


def test_a_frozen_reward_is_kept_and_must_stay(plain, tmp_path):
    config, reward = plain.change(reward="frozen"), frozen_reward(3)
    folder = tmp_path / "run"
    create(folder, config, (3, 7, 5), frozen_reward=reward, checkpoint_every=40)
    resume(folder)
    assert torch.equal(records.read(folder).reward.params, reward.params)
    with pytest.raises(ValueError, match="of another run the frozen reward, of 3 members"):
        folders.extend(folder, seeds=(8,))
    folders.extend(folder, 200)
    replace(reward, params=reward.params + 1).save(folder / "frozen_reward.safetensors")
    with pytest.raises(ValueError, match=r"frozen_reward\.safetensors is not .* put that"):
        resume(folder)


def test_guides_of_several_files_take_turns(plain, tmp_path):
    guides = policy(plain)
    for member in (0, 1):
        guides.member(member).save(tmp_path / str(member))
    config = plain.change(guide_steps=20)
    files = tmp_path / "1", tmp_path / "0"
    given = inputs.load(config, (3, 7, 5, 9, 2), guide=files)["guide"]
    assert torch.equal(given.params, guides.params[[1, 0, 1, 0, 1]])


def test_rewards_of_several_files_are_one_population(plain, tmp_path):
    config, reward = plain.change(reward="frozen"), frozen_reward(3)
    reward.member(0, 1).save(tmp_path / "two")
    reward.member(2).save(tmp_path / "one")
    files = tmp_path / "two", tmp_path / "one"
    given = inputs.load(config, (3, 7, 5), frozen_reward=files)["frozen_reward"]
    assert torch.equal(given.params, reward.params)
    assert torch.equal(given.normaliser.std, reward.normaliser.std)
    net = StackedMLP((5, 4, 1), "tanh")
    other = replace(reward, net=net, params=net.init(Rng((0, 1, 2))), state_only=False)
    other.save(tmp_path / "other")
    with pytest.raises(ValueError, match="members of one population must be of one kind"):
        inputs.load(config, SEEDS, frozen_reward=(tmp_path / "two", tmp_path / "other"))


# Damage.


def edit(path, **changes):
    """Change fields of a JSON file on purpose; `a__b` is field b of a."""
    content = records.read_json(path)
    for name, value in changes.items():
        *outer, last = name.split("__")
        place = content
        for key in outer:
            place = place[key]
        place[last] = value
    path.write_text(json.dumps(content))


def refused(folder, message, kind=ValueError):
    """A run is not resumed, says why, and nothing is changed."""
    before = files(folder)
    with pytest.raises(kind, match=message):
        resume(folder)
    assert files(folder) == before


def test_any_damaged_byte_of_a_checkpoint_is_noticed(interrupted, folder):
    path = folder / "checkpoint" / "checkpoint.safetensors"
    sound, rng = path.read_bytes(), np.random.default_rng(0)
    header = 8 + int.from_bytes(sound[:8], "little")
    places = [0, 3, 8, header - 1, header, len(sound) - 1]
    places += [*rng.integers(8, header, 20), *rng.integers(header, len(sound), 20)]
    for place in places:
        damaged = bytearray(sound)
        damaged[place] ^= 1 << rng.integers(7)
        if damaged[place] in b" \t\n\r" and sound[place] in b" \t\n\r":
            continue
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"checkpoint.safetensors (is damaged|has format)"):
            resume(folder)
    for length in (0, 5, header - 3, header + 3, len(sound) - 1):
        path.write_bytes(sound[:length])
        refused(folder, "checkpoint.safetensors is damaged: .*; bring all of")
    shutil.copy(folder / "curve.csv", path)
    refused(folder, "checkpoint.safetensors is damaged")
    path.write_bytes(sound)
    resume(folder)
    assert manifest(folder)["state"] == "finished"


def test_a_checkpoint_of_another_run_is_refused(interrupted, folder, plain, tmp_path):
    other = tmp_path / "other"
    for config, seeds, message in [
        (plain.change(discount=0.5), SEEDS, "of another run than .*: discount was 0.5, is 0.99;"),
        (plain, (4, 5), r"seeds was \[4, 5\], is \[3, 7\]; put back"),
        (plain.change(total_steps=200), SEEDS, "replay.f32 is damaged: it had"),
        (plain, SEEDS, "replay.f32 is damaged: 1 of its 1 blocks, .* byte 0 on, are not as they"),
    ]:
        run(other, config, seeds=seeds)
        for name in ("checkpoint/checkpoint.safetensors", "curve.csv"):
            shutil.copy(other / name, folder / name)
        refused(folder, message)
        shutil.rmtree(other)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"config__discount": 0.9}, "discount was 0.99, is 0.9; put back what was changed"),
        ({"config__hidden": [8]}, r"hidden was \[16, 16\], is \[8\]"),
        ({"config__total_steps": 70}, "reached step 80; it cannot end at 70: .*--steps N"),
        ({"config__discount": 2}, "config.json does not describe a run: discount is 2"),
        ({"config__momentum": 2}, "config.json does not describe a run: .*momentum"),
        ({"execution__threads": 2}, "threads was 1, is 2"),
        ({"checkpoint_every": 70}, "checkpoint_every was 40, is 70"),
        ({"seeds": [3, 8]}, r"seeds was \[3, 7\], is \[3, 8\]"),
        ({"format": 1}, "config.json has format 1, .* reads format 3: use the version"),
    ],
)
def test_a_changed_configuration_is_refused(interrupted, folder, change, message):
    edit(folder / "config.json", **change)
    refused(folder, message)


def test_a_checkpoint_of_an_older_format_is_refused(interrupted, folder):
    path = folder / "checkpoint" / "checkpoint.safetensors"
    state, about = networks.load_weights(path, "checkpoint")
    networks.save_weights(path, state, {**about, "format": 1})
    refused(folder, "checkpoint.safetensors has format 1, .* reads format 4: use the version")


def test_a_missing_or_cut_file_is_noticed(interrupted, folder):
    for path in (folder / "checkpoint" / "replay.f32", folder / "curve.csv"):
        name, content = path.name, path.read_bytes()
        path.write_bytes(content[:100])
        refused(folder, f"{name} is damaged: it had .* bytes, and has 100; bring")
        path.unlink()
        refused(folder, f"{name} is damaged: .* has 0;")
        path.write_bytes(bytes(len(content)) if name == "replay.f32" else content)
        if name == "replay.f32":
            refused(folder, "replay.f32 is damaged: 1 of its 1 blocks, the first from byte 0")
            path.write_bytes(content)
    (folder / "checkpoint" / "checkpoint.safetensors").unlink()
    refused(folder, "checkpoint.safetensors is gone, and .* step 80", FileNotFoundError)
    # As it is where a record was copied without it.
    shutil.rmtree(folder / "checkpoint")
    refused(folder, "checkpoint.safetensors is gone", FileNotFoundError)
    with pytest.raises(FileNotFoundError, match="is gone"):
        folders.extend(folder, 200)
    assert not (folder / "checkpoint").exists()


def test_demonstrations_must_be_those_it_began_with(tiny, folder, random_demonstrations):
    create(folder, tiny, SEEDS, demonstrations=random_demonstrations(MAZE))
    with pytest.raises(ValueError, match="3 trajectories from elsewhere are not those"):
        folders.work(folder, demonstrations=random_demonstrations(MAZE, 3))
    with pytest.raises(ValueError, match=r"did not make: give the same to `folders.work` again"):
        folders.work(folder)


def test_an_extension_without_its_data_set_changes_nothing(tiny, folder, write_dataset):
    name = write_dataset("my/pendulum-v0").spec.dataset_id
    config = tiny.change(env_id="Pendulum-v1")
    run(folder, config, demonstrations=load(config.env_id, 2, name))
    before = files(folder)
    minari.delete_dataset(name)
    with pytest.raises(FileNotFoundError, match="no local data set 'my/pendulum-v0'"):
        folders.extend(folder, config.total_steps + 100)
    assert files(folder) == before


def test_a_run_on_demonstrations_given_by_hand_can_be_extended(tiny, folder, random_demonstrations):
    shown = random_demonstrations(MAZE)
    run(folder, tiny, demonstrations=shown)
    folders.extend(folder, tiny.total_steps + 100)
    folders.work(folder, demonstrations=shown, progress=False)
    assert records.read(folder).steps[-1] == tiny.total_steps + 100


def test_demonstrations_of_one_expert_are_so_again_on_resume(tiny, folder, shipped_experts):
    shown = load(MAZE, 2, experts=1)
    create(folder, tiny, SEEDS, demonstrations=shown)
    resume(folder)
    assert records.read(folder).steps[-1] == tiny.total_steps


def test_demonstrations_are_thinned_again_on_resume(tiny, folder, write_dataset):
    name = write_dataset("my/pendulum-v0").spec.dataset_id
    config = tiny.change(env_id="Pendulum-v1")
    thin = load(config.env_id, 2, name, subsample=20, experts=1)
    create(folder, config, SEEDS, demonstrations=thin)
    assert records.RunSpec.read(folder).demonstrations["experts"] is None
    resume(folder)
    assert records.read(folder).steps[-1] == config.total_steps


def test_a_run_from_before_subsampling_is_one_without(tiny, folder, write_dataset):
    name = write_dataset("my/pendulum-v0").spec.dataset_id
    config = tiny.change(env_id="Pendulum-v1")
    whole = load(config.env_id, 2, name)
    create(folder, config, SEEDS, demonstrations=whole)
    about = records.read_json(folder / "config.json")
    assert about["demonstrations"].pop("subsample") == 1
    records.write_json(folder / "config.json", about)
    resume(folder)
    assert records.read(folder).steps[-1] == config.total_steps


def test_a_run_may_be_made_where_one_stands_and_behind_a_link(plain, tmp_path, monkeypatch):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    create(tmp_path / "link", plain, SEEDS)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    create(".", plain, SEEDS)
    resume(".")
    for folder in (tmp_path / "elsewhere", tmp_path / "here"):
        assert records.RunSpec.read(folder).config == plain
    assert manifest(tmp_path / "here")["state"] == "finished"
    assert {path.name for path in tmp_path.iterdir()} == {"elsewhere", "link", "here"}


def test_nothing_is_overwritten(interrupted, folder, plain):
    before = files(folder)
    with pytest.raises(FileExistsError, match=r"not empty: `offairl resume .*one` goes on"):
        create(folder, plain, (0,))
    assert files(folder) == before


def test_two_processes_do_not_share_a_run_folder(folder, plain):
    create(folder, plain.change(total_steps=100_000), SEEDS)
    process = start(folder, None, None, 0)
    while manifest(folder)["state"] != "running":
        time.sleep(0.01)
        assert process.is_alive()
    who = f"process {process.pid}" if Path("/proc/locks").exists() else "another process"
    for attempt in (
        lambda: resume(folder),
        lambda: folders.extend(folder, 200),
        lambda: folders.extend(folder, seeds=(8,)),
    ):
        with pytest.raises(OSError, match=rf"{who} is at work on .*one: let it f"):
            attempt()
    process.kill()
    process.join()
    folders.extend(folder, 200)
    resume(folder)
    assert records.read(folder).steps[-1] == 200


@pytest.mark.parametrize("steps", [100, 150])
def test_a_stop_before_the_end_is_noted_loses_nothing(steps, folder, plain, tmp_path):
    whole = run(tmp_path / "whole", plain)
    run(folder, plain)
    if steps > 100:  # The policy of before the run was extended is there still.
        for one in (whole, folder):
            folders.extend(one, steps)
        resume(whole)
    before = folders._Worker.note

    def note(self, state):
        if state == "finished":
            raise Broken("a stop")
        before(self, state)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(folders._Worker, "note", note)
        if steps == 100:
            shutil.rmtree(folder)
            create(folder, plain, SEEDS, checkpoint_every=40)
        with pytest.raises(Broken):
            resume(folder)
    assert not folders.is_finished(folder)
    resume(folder)
    assert manifest(folder)["state"] == "finished"
    assert folders.is_finished(folder)
    assert_same(folder, whole)


def test_what_goes_on_elsewhere_says_so(interrupted, folder, monkeypatch, caplog):
    began = manifest(folder)
    monkeypatch.setattr(records, "processor", lambda: "an abacus")
    folders.extend(folder, 150)
    resume(folder)
    ended = manifest(folder)
    (later,) = ended["continued"]
    assert (later["step"], later["processor"]) == (80, "an abacus")
    assert "wall_s" not in later  # that of the whole run is in one place
    assert ended["processor"] == began["processor"]
    assert "goes on from step 80 with other processor: an abacus, before" in caplog.text
    # The same once more is no news.
    folders.extend(folder, 200)
    resume(folder)
    assert manifest(folder)["continued"] == [later]


def test_a_run_that_ends_within_its_warm_up_says_why(folder, plain, monkeypatch):
    monkeypatch.setattr(
        Collector,
        "step",
        lambda self, _: self.members.give_up(torch.ones(2) > 0, self.steps, "eye is red"),
    )
    create(folder, plain, SEEDS)
    with pytest.warns(UserWarning, match="seed . diverged by step 0: its eye is red"):
        resume(folder)
    assert manifest(folder)["state"] == "stopped: every member has diverged"
    assert list(records.read(str(folder)).diverged) == list(SEEDS)


def test_a_run_s_folder_stands_for_what_it_has(plain, tmp_path):
    frozen_reward(2).save(tmp_path / "reward.safetensors")
    policy(plain).save(tmp_path / "policy.safetensors")
    config = plain.change(reward="frozen", pretrained="policy")
    found = inputs.load(config, SEEDS, frozen_reward=[tmp_path], pretrained_policy=[tmp_path])
    assert torch.equal(found["frozen_reward"].params, frozen_reward(2).params)
    assert torch.equal(found["pretrained_policy"].params, policy(plain).params)


def test_a_full_disk_is_foreseen(folder, plain, monkeypatch):
    usage = namedtuple("Usage", "total used free")(10**9, 10**9 - 10**5, 10**5)
    with monkeypatch.context() as patch:
        patch.setattr(shutil, "disk_usage", lambda _: usage)
        with pytest.raises(OSError, match=r"MB of disk are .* has 0.1 MB left: lower replay_size"):
            checkpoints.require_room(folder, 10**7)
    run(folder, plain)
    with monkeypatch.context() as patch:
        patch.setattr(shutil, "disk_usage", lambda _: usage)
        with pytest.raises(OSError, match=r"MB of disk are needed"):
            folders.extend(folder, 100_000)
        with pytest.raises(OSError, match=r"MB of disk are needed"):
            folders.extend(folder, seeds=tuple(range(10, 40)))
    assert records.read(folder).config == plain


@pytest.mark.parametrize(
    ("module", "name"), [(checkpoints, "save_weights"), (records, "lines"), (folders, "write_json")]
)
def test_a_full_disk_loses_nothing(module, name, folder, plain, tmp_path, monkeypatch):
    whole = run(tmp_path / "whole", plain)
    create(folder, plain, SEEDS, checkpoint_every=40)
    original, calls = getattr(module, name), iter(range(100))

    def write(*args):
        if next(calls) == 1:
            raise OSError(errno.ENOSPC, "No space left on device")
        return original(*args)

    with monkeypatch.context() as patch:
        patch.setattr(module, name, write)
        with pytest.raises(
            SystemExit, match=r"the disk is full: free .*; `offairl resume .*one` g"
        ):
            cli.main(["resume", str(folder)])
    resume(folder)
    assert_same(folder, whole)


@pytest.mark.parametrize("case", KILLED)
def test_the_disk_a_run_takes_is_known(case, tiny, folder, given):
    config = tiny.change(**KILLED[case])
    demonstrations = given(config.env_id)[0] if config.imitates else None
    run(folder, config, demonstrations=demonstrations, **inherited(config))
    used = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    # While it is written, a second checkpoint is there.
    used += (folder / "checkpoint" / "checkpoint.safetensors").stat().st_size
    foreseen = checkpoints.disk_space(spec := records.RunSpec.read(folder))
    replay = (folder / "checkpoint" / "replay.f32").stat().st_size
    margin = len(SEEDS) * checkpoints.MARGIN
    # The policy and the reward of every evaluation are there, and no more than was foreseen.
    kept = sum(path.stat().st_size for path in (folder / "evaluations").iterdir())
    evaluated = len({row.step for row in records.read(folder).rows})
    assert len(list((folder / "evaluations").glob("policy-*"))) == evaluated
    foretold = foreseen - replay - margin
    assert kept - 2048 * 2 * evaluated < foretold < 3 * kept
    assert used < foreseen
    assert evaluated <= spec.config.total_steps // spec.config.schedule.eval_every + 1


# Divergence.


def diverging(*members):
    """SAC whose critics of some members turn infinite at update 70."""
    original, updates = SAC.update, count()

    def update(self, *batch):
        if next(updates) == 70:
            for member in members:
                self.critic_params.data[:, member] = torch.inf
        return original(self, *batch)

    return update


def test_a_member_that_diverges_is_given_up_alone(folder, plain, monkeypatch):
    monkeypatch.setattr(SAC, "update", diverging(1))
    create(folder, plain.change(total_steps=150), SEEDS, checkpoint_every=40)
    with pytest.warns(UserWarning, match="seed 7 diverged by step 80"):
        resume(folder)
    run = records.read(folder)
    assert [(row.seed, row.step) for row in run.rows] == [(3, 50), (7, 50), (3, 100), (3, 150)]
    assert list(run.diverged) == [7]
    assert run.diverged[7].startswith("seed 7 diverged by step 80: its ")
    assert manifest(folder)["state"] == "finished"
    # It is remembered.
    folders.extend(folder, 200)
    resume(folder)
    assert list(records.read(folder).diverged) == [7]
    assert len(records.read(folder).rows) == 5


@pytest.mark.filterwarnings("ignore:seed . diverged")
def test_a_run_folder_that_diverges_leaves_others_alone(folder, plain, monkeypatch, caplog):
    monkeypatch.setattr(SAC, "update", diverging(0, 1))
    create(folder, plain, SEEDS, checkpoint_every=40)
    resume(folder)
    assert manifest(folder)["state"] == "stopped: every member has diverged"
    assert list(records.read(folder).diverged) == [3, 7]
    assert folders.is_finished(folder)
    monkeypatch.undo()
    folders.extend(folder, seeds=(5,))
    resume(folder / "seeds-5")
    found = records.read(folder)
    assert [(r.seed, r.step) for r in found.rows if r.seed == 5] == [(5, 50), (5, 100)]
    assert list(found.diverged) == [3, 7]
    assert len(found.policy) == 3
    assert len(inputs.load_one(folder, Policy)) == 3
    assert "seeds that diverged" in caplog.text
    shutil.rmtree(folder / "seeds-5")
    with pytest.raises(ValueError, match=r"diverged, .*: there is nothing to use"):
        inputs.load_one(folder, Policy)


def test_a_record_is_verified_without_its_checkpoints(plain, folder):
    run(folder, plain.change(total_steps=150))
    shutil.rmtree(folder / "checkpoint")
    recorded = records.read(folder).rows
    olds, news = zip(*folders.verify(folder, progress=False).values(), strict=True)
    # As lines, since a learned return that is NaN is not equal to itself.
    assert records.lines(olds) == records.lines(recorded[:2])
    assert records.lines(news) == records.lines(olds)


def test_a_record_without_an_evaluation_is_not_verified(plain, folder):
    create(folder, plain, SEEDS)
    with pytest.raises(ValueError, match=r"has no evaluation to do again: `offairl resume .*` go"):
        folders.verify(folder)


@pytest.mark.filterwarnings("ignore:seed . diverged")
def test_a_member_that_diverges_here_alone_is_not_verified(plain, folder, monkeypatch):
    run(folder, plain.change(eval_every=100))
    monkeypatch.setattr(SAC, "update", diverging(1))
    pairs = folders.verify(folder, progress=False)
    assert [(*key, new is None) for key, (_, new) in pairs.items()] == [
        (3, 100, False),
        (7, 100, True),
    ]


@pytest.mark.filterwarnings("ignore:seed . diverged")
def test_where_every_member_diverges_here_nothing_is_verified(plain, folder, monkeypatch):
    run(folder, plain.change(eval_every=100))
    monkeypatch.setattr(SAC, "update", diverging(0, 1))
    pairs = folders.verify(folder, progress=False)
    assert [(step, new is None) for (_, step), (_, new) in pairs.items()] == [
        (100, True),
        (100, True),
    ]


def test_of_several_run_folders_the_first_is_verified(plain, folder):
    for seed in (7, 3):
        run(folder / f"seeds-{seed}", plain, seeds=(seed,))
    assert [seed for seed, _ in folders.verify(folder, progress=False)] == [3]


def test_verifying_needs_what_the_run_had(plain, tiny, folder, random_demonstrations):
    with pytest.raises(FileNotFoundError, match="there is no run in"):
        folders.verify(folder)
    policy = Trainer(plain, SEEDS)
    next(rows for rows in policy.run() if policy.policy is not None)
    run(folder, plain.change(pretrained="policy"), pretrained_policy=policy.policy)
    assert len(folders.verify(folder, progress=False)) == 2
    (folder / "pretrained_policy.safetensors").unlink()
    with pytest.raises(FileNotFoundError, match=r"pretrained_policy\.safetensors"):
        folders.verify(folder)


def test_a_record_finds_what_it_had_of_other_runs_where_it_was(plain, folder, tmp_path):
    config = plain.change(reward="frozen", pretrained="policy", guide_steps=20)
    names = "frozen_reward", "pretrained_policy", "guide"
    sources = {name: (tmp_path / name,) for name in names}
    frozen_reward(2).save(*sources["frozen_reward"])
    policy(plain).save(*sources["pretrained_policy"])
    policy(plain).member(1).save(*sources["guide"])  # One for both.
    run(folder, config, **inputs.load(config, SEEDS, **sources), sources=sources)
    expected = folders.verify(folder, progress=False)
    for name in sources:
        (folder / f"{name}.safetensors").unlink()
    assert repr(folders.verify(folder, progress=False)) == repr(expected)
    frozen_reward(3).member(1, 2).save(*sources["frozen_reward"])
    with pytest.raises(ValueError, match=r"is not the frozen reward that .* began with"):
        folders.verify(folder)
    sources["frozen_reward"][0].unlink()
    with pytest.raises(FileNotFoundError, match="frozen"):
        folders.verify(folder)
