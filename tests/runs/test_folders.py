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
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from offairl_lite.core import networks
from offairl_lite.core.loop import Trainer
from offairl_lite.core.networks import Normaliser, StackedMLP, load_weights, save_weights
from offairl_lite.core.policies import Policy
from offairl_lite.core.replay import Batch
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rng import Streams
from offairl_lite.core.sac import SAC, stochastic_actor
from offairl_lite.demonstrations import Demonstrations, load
from offairl_lite.runs import disk, jobs, provenance, records
from offairl_lite.runs import folders as runs

MAZE, HOPPER = "offairl/PointMazeLeft-v0", "Hopper-v5"
SEEDS = (3, 7)

# A server that has imported everything forks the processes that are killed.
PROCESSES = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload(["offairl_lite.runs.folders"])


@pytest.fixture
def plain(tiny):
    """SAC on the true reward: the fastest run there is."""
    config = replace(tiny, reward="environment", update_every=20, eval_episodes=1)
    return replace(config, total_steps=100, warmup_steps=40, eval_every=50)


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "runs" / "one"


def run(folder, config, *, seeds=SEEDS, checkpoint_every=40, **given):
    """Make a run and take it to its end."""
    runs.create(folder, config, seeds, checkpoint_every=checkpoint_every, **given)
    runs.work(folder, demonstrations=given.get("demonstrations"), progress=False)
    return folder


def resume(folder):
    runs.work(folder, progress=False)


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
    runs.create(folder, plain, SEEDS, checkpoint_every=40)
    advance = Trainer.advance

    def stop(self):
        if self.steps == 90:
            raise Broken("a stop")
        return advance(self)

    with monkeypatch.context() as patch:
        patch.setattr(Trainer, "advance", stop)
        with pytest.raises(Broken):
            resume(folder)
    return folder


# Kills.


def worker(folder, given, moment, times):
    """Work on a run in a process of its own, which kills itself at some moment if one is named."""
    die_at(folder, moment, times)
    demonstrations = None
    if given is not None:
        path, env_id, lengths = given
        tensors = load_file(path)
        batch = Batch(*(tensors[name] for name in Batch._fields))
        demonstrations = Demonstrations(env_id, batch, lengths)
    runs.work(folder, demonstrations=demonstrations, progress=False)


def die_at(folder, moment, times):
    """Have the process kill itself the given time that a moment of its work comes."""
    calls = iter(range(1, 1000))

    def due():
        return next(calls) == times

    def die():
        os.kill(os.getpid(), signal.SIGKILL)

    save, swap, lines = runs.save_weights, os.replace, runs.lines

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
            (curve,) = folder.glob("members/*/curve.csv")
            text = lines(rows)
            with open(curve, "a") as file:
                file.write(text[: len(text) * 3 // 4])
            die()
        return lines(rows)

    if moment == "half a checkpoint":
        runs.save_weights = save_half
    elif moment == "in a row":
        runs.lines = half_lines
    elif moment is not None:
        os.replace = swap_or_die


def start(*args):
    process = PROCESSES.Process(target=worker, args=args)
    process.start()
    return process


def finish(*args):
    """Work on a run to its end in a process of its own; return the seconds it took."""
    before = time.monotonic()
    process = start(*args, None, 0)
    process.join()
    assert process.exitcode == 0
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


HOP = {"env_id": HOPPER, "update_every": 50, "replay_size": 60}
KILLED = {
    "sac": {"reward": "environment"},
    "td3 and dac": {"reward": "dac", "generator": "td3", "replay_size": 60},
    "airl and a learned temperature": {"reward": "implementation-4", "temperature": None},
    "no absorbing state": {**HOP, "reward": "dac", "generator": "td3"},
    "bootstrapped": {**HOP, "reward": "implementation-1", "absorbing": "bootstrap"},
    "analytic": {**HOP, "reward": "dac", "absorbing": "analytic", "temperature": None},
    "pendulum": {"env_id": "Pendulum-v1", "reward": "environment", "update_every": 50},
    "all from other runs": {"reward": "frozen", "carry": "primitives", "start_steps": 30}
    | {"primitives": 2, "trunk_hidden": (8,), "primitive_hidden": (), "gate_hidden": (8,)},
    "gail and ppo": {**HOP, "reward": "gail-survival", "generator": "ppo"},
}


@pytest.mark.parametrize("case", KILLED)
def test_a_run_that_is_killed_at_random_moments_is_the_same_run(case, tiny, plain, given, tmp_path):
    config = replace(tiny, total_steps=300, **KILLED[case])
    demonstrations, handed = given(config.env_id) if config.learns_reward else (None, None)
    rng = np.random.default_rng(list(KILLED).index(case))

    def make(name):
        folder, given = tmp_path / name, {"demonstrations": demonstrations, **inherited(config)}
        runs.create(folder, config, SEEDS, checkpoint_every=60, **given)
        return folder

    whole = make("whole")
    seconds, kills = finish(whole, handed), 0
    for attempt in range(10):
        folder, kills = make(str(attempt)), 0
        while kills < 2:
            process = start(folder, handed, None, 0)
            time.sleep(rng.uniform(0.1, 0.5) * seconds)
            process.kill()
            process.join()
            if process.exitcode == 0:
                break
            assert process.exitcode == -signal.SIGKILL
            kills += 1
        if kills == 2:
            break
        seconds /= 2  # The machine has become faster: the run was over before it was killed.
    assert kills == 2
    finish(folder, handed)
    assert manifest(folder)["state"] == "finished"
    assert_same(folder, whole)


@pytest.mark.parametrize(
    "moment", ["half a checkpoint", "before the swap", "after the swap", "in a row"]
)
def test_a_run_that_is_killed_at_the_worst_moments_is_the_same_run(moment, plain, tmp_path):
    config = replace(plain, eval_every=25)
    whole = run(tmp_path / "whole", config)
    folder = tmp_path / "killed"
    runs.create(folder, config, SEEDS, checkpoint_every=40)
    for times in (1, 2):
        process = start(folder, None, moment, times)
        process.join()
        assert process.exitcode == -signal.SIGKILL
        assert records.read(folder).seeds == SEEDS
    finish(folder, None)
    assert_same(folder, whole)


def test_a_run_that_is_killed_before_it_exists_leaves_nothing(folder, plain, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", stop)
    with pytest.raises(KeyboardInterrupt):
        runs.create(folder, plain, SEEDS)
    assert list(folder.parent.iterdir()) == []
    with pytest.raises(FileNotFoundError, match=r"no run in .*one: .*`offairl run NAME"):
        resume(folder)


def test_what_stops_a_run_is_noted_and_the_record_can_be_read(interrupted, folder, plain):
    assert manifest(folder)["state"] == "stopped: Broken: a stop"
    assert manifest(folder)["shards"]["3-7"]["step"] == 80
    run = records.read(folder)
    assert (run.config, run.seeds, run.steps.tolist()) == (plain, SEEDS, [50])
    assert (run.policy, run.reward) == (None, None)


def test_a_record_can_be_read_at_any_time(folder, plain, monkeypatch):
    advance, seen = Trainer.advance, set()

    def advance_and_read(self):
        seen.add(len(records.read(folder).rows))
        return advance(self)

    monkeypatch.setattr(Trainer, "advance", advance_and_read)
    run(folder, plain)
    assert seen == {0, 2}


def test_the_manifest_says_what_made_the_run(interrupted, folder):
    first = manifest(folder)
    assert first["versions"]["torch"] == torch.__version__
    assert set(first["versions"]) == set(provenance.PACKAGES)
    assert first["processor"]
    assert (first["threads"], first["cores"]) == (1, os.cpu_count())
    commit = subprocess.run(
        ["git", "-C", Path(runs.__file__).parent, "rev-parse", "HEAD"], capture_output=True
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
    config = replace(plain, replay_size=replay_size)
    whole = run(tmp_path / "whole", replace(config, total_steps=200))
    folder = run(tmp_path / "extended", config)
    runs.extend(folder, 200)
    assert manifest(folder)["state"] == "waiting"
    resume(folder)
    assert records.read(folder).config.total_steps == 200
    assert_same(folder, whole)


def test_seeds_are_added_beside_those_there(plain, tmp_path):
    alone = run(tmp_path / "alone", plain, seeds=(5, 6))
    first = run(tmp_path / "first", plain)
    folder = shutil.copytree(first, tmp_path / "extended")
    before = files(folder / "members" / "3-7")
    runs.extend(folder, seeds=(5, 6))
    assert records.read(folder).policy is None
    resume(folder)
    assert {path: path.read_bytes() for path in before} == before
    split = run(tmp_path / "split", plain, seeds=(3, 7, 5, 6), shards=2)
    assert_same(folder, split)
    both, parts = records.read(folder), [records.read(part) for part in (first, alone)]
    assert both.seeds == (3, 7, 5, 6)
    np.testing.assert_array_equal(both.returns, np.concatenate([part.returns for part in parts]))
    obs = Streams(both.seeds).normal(5, 3)
    acts = [part.policy.act(obs[i : i + 2]) for i, part in zip((0, 2), parts, strict=True)]
    assert torch.equal(both.policy.act(obs), torch.cat(acts))
    order = [(row.step, row.seed) for row in both.rows]
    assert order == [(step, seed) for step in (50, 100) for seed in both.seeds]


def test_a_shard_can_be_worked_on_alone(plain, folder):
    runs.create(folder, plain, (3, 7, 5), shards=2)
    with pytest.raises(ValueError, match=r"no members \[7\] of their own; there are: 3 7, 5"):
        runs.work(folder, (7,))
    runs.work(folder, (5,), progress=False)
    assert manifest(folder)["state"] == "waiting"
    assert runs.unfinished(folder) == [(3, 7)]
    assert {row.seed for row in records.read(folder).rows} == {5}
    resume(folder)
    assert manifest(folder)["state"] == "finished"
    assert len(records.read(folder).policy) == 3


def test_a_run_that_has_ended_is_left_as_it_is(plain, folder):
    run(folder, plain)
    before = files(folder)
    resume(folder)
    assert files(folder) == before


def test_an_extension_that_makes_no_sense_is_refused(interrupted, folder):
    before = files(folder)
    with pytest.raises(ValueError, match="reached step 80; it cannot end at 70"):
        runs.extend(folder, 70)
    with pytest.raises(ValueError, match=r"seeds \[7\] are not all new: there are \[3, 7\]"):
        runs.extend(folder, seeds=(7,))
    with pytest.raises(ValueError, match=r"not all new"):
        runs.extend(folder, 200, (8, 8))  # Nor is it extended to 200 steps.
    with pytest.raises(ValueError, match="give it steps, or seeds"):
        runs.extend(folder)
    with pytest.raises(ValueError, match="expected none below 0"):
        runs.extend(folder, seeds=(-1,))
    assert files(folder) == before


def frozen_reward(members):
    net = StackedMLP((3, 4, 1), "tanh")
    params = net.init(Streams(range(members)))
    return Reward(MAZE, net, True, params, Normaliser.identity(members, 3))


def policy(config):
    """A policy that has not learned anything, of two members."""
    actor = stochastic_actor(config, 3, 2)
    return Policy(MAZE, actor, actor.init(Streams((0, 1))), Normaliser.identity(2, 3))


def inherited(config):
    """What a run of two members has of other runs."""
    if config.reward != "frozen":
        return {}
    guide = policy(replace(config, primitives=None, carry="nothing"))
    return {"reward": frozen_reward(2), "policy": policy(config), "guide": guide}


def test_policies_of_other_runs_are_kept_and_must_stay(plain, tmp_path):
    config = replace(plain, carry="policy", start_steps=20)
    folder, given = tmp_path / "run", {"policy": policy(plain), "guide": policy(plain)}
    runs.create(folder, config, SEEDS, shards=2, checkpoint_every=40, **given)
    resume(folder)
    assert records.read(folder).policy is not None
    with pytest.raises(ValueError, match="of another run the policy and the guide, of 2 members"):
        runs.extend(folder, seeds=(8,))
    runs.extend(folder, 200)
    changed = replace(given["guide"], params=given["guide"].params + 1)
    changed.save(folder / "guide.safetensors")
    with pytest.raises(ValueError, match=r"guide\.safetensors is not the guide .* put that back"):
        resume(folder)


def test_a_run_from_before_a_field_existed_goes_on_with_its_default(plain, folder):
    run(folder, plain)
    (shard,) = records.Plan.read(folder).shards
    path = runs.home(folder, shard) / "checkpoint.safetensors"
    state, about = load_weights(path, "checkpoint")
    for name in ("carry", "start_steps"):
        del about["identity"][name]
    del about["digest"], state["guided"]
    save_weights(path, state, {**about, "digest": runs._digest(state, about)})
    runs.extend(folder, 200)
    resume(folder)
    assert records.read(folder).steps[-1] == 200


def test_a_frozen_reward_is_kept_and_must_stay(plain, tmp_path):
    config, reward = replace(plain, reward="frozen"), frozen_reward(3)
    folder = tmp_path / "run"
    runs.create(folder, config, (3, 7, 5), reward=reward, shards=2, checkpoint_every=40)
    resume(folder)
    assert torch.equal(records.read(folder).reward.params, reward.params)
    with pytest.raises(ValueError, match="of another run the reward, of 3 members"):
        runs.extend(folder, seeds=(8,))
    runs.extend(folder, 200)
    replace(reward, params=reward.params + 1).save(folder / "frozen.safetensors")
    with pytest.raises(ValueError, match=r"frozen\.safetensors is not the reward .* put that"):
        resume(folder)


def test_guides_of_several_files_take_turns(plain, tmp_path):
    guides = policy(plain)
    for member in (0, 1):
        guides.member(member).save(tmp_path / str(member))
    config = replace(plain, start_steps=20)
    files = tmp_path / "1", tmp_path / "0"
    given = runs.inherit(config, (3, 7, 5, 9, 2), guide=files)["guide"]
    assert torch.equal(given.params, guides.params[[1, 0, 1, 0, 1]])


def test_rewards_of_several_files_are_one_population(plain, tmp_path):
    config, reward = replace(plain, reward="frozen"), frozen_reward(3)
    reward.member(0, 1).save(tmp_path / "two")
    reward.member(2).save(tmp_path / "one")
    given = runs.inherit(config, SEEDS, frozen=(tmp_path / "two", tmp_path / "one"))["reward"]
    assert torch.equal(given.params, reward.params)
    assert torch.equal(given.normaliser.std, reward.normaliser.std)
    replace(reward, state_only=False).save(tmp_path / "other")
    with pytest.raises(ValueError, match="members of one population must be of one kind"):
        runs.inherit(config, SEEDS, frozen=(tmp_path / "two", tmp_path / "other"))


# Damage.


def edit(path, **changes):
    """Change fields of a JSON file; `a__b` is field b of a."""
    content = json.loads(path.read_text())
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
    path = folder / "members" / "3-7" / "checkpoint.safetensors"
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
    shutil.copy(folder / "members" / "3-7" / "curve.csv", path)
    refused(folder, "checkpoint.safetensors is damaged")
    path.write_bytes(sound)
    resume(folder)
    assert manifest(folder)["state"] == "finished"


def test_a_checkpoint_of_another_run_is_refused(interrupted, folder, plain, tmp_path):
    other = tmp_path / "other"
    for config, seeds, message in [
        (replace(plain, discount=0.5), SEEDS, "of another run than .*: discount was 0.5, is 0.99;"),
        (plain, (4, 5), r"seeds was \[4, 5\], is \[3, 7\]; put back"),
        (replace(plain, total_steps=200), SEEDS, "replay.f32 is damaged: it had"),
        (plain, SEEDS, "replay.f32 is damaged: it is not as it was at the checkpoint"),
    ]:
        run(other, config, seeds=seeds)
        (home,) = (other / "members").glob("*-*")
        for name in ("checkpoint.safetensors", "curve.csv"):
            shutil.copy(home / name, folder / "members" / "3-7")
        refused(folder, message)
        shutil.rmtree(other)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"config__discount": 0.9}, "discount was 0.99, is 0.9; put back what was changed"),
        ({"config__hidden": [8]}, r"hidden was \[16, 16\], is \[8\]"),
        ({"config__total_steps": 70}, "reached step 80, and its total_steps is 70: .*--steps N"),
        ({"config__discount": 2}, "config.json does not describe a run: discount is 2"),
        ({"config__momentum": 2}, "config.json does not describe a run: .*momentum"),
        ({"execution__threads": 2}, "threads was 1, is 2"),
        ({"checkpoint_every": 70}, "checkpoint_every was 40, is 70"),
        ({"shards": [[3, 8]]}, r"has lost the shards \['3-7'\]"),
        ({"format": 1}, "config.json has format 1, .* reads format 2: use the version"),
    ],
)
def test_a_changed_configuration_is_refused(interrupted, folder, change, message):
    edit(folder / "config.json", **change)
    refused(folder, message)


def test_a_checkpoint_of_an_older_format_is_refused(interrupted, folder):
    path = folder / "members" / "3-7" / "checkpoint.safetensors"
    state, about = networks.load_weights(path, "checkpoint")
    networks.save_weights(path, state, {**about, "format": 1})
    refused(folder, "checkpoint.safetensors has format 1, .* reads format 2: use the version")


def test_a_missing_or_cut_file_is_noticed(interrupted, folder):
    home = folder / "members" / "3-7"
    for name in ("replay.f32", "curve.csv"):
        content = (home / name).read_bytes()
        (home / name).write_bytes(content[:100])
        refused(folder, f"{name} is damaged: it had .* bytes, and has 100; bring")
        (home / name).unlink()
        refused(folder, f"{name} is damaged: .* has 0;")
        (home / name).write_bytes(bytes(len(content)) if name == "replay.f32" else content)
        if name == "replay.f32":
            refused(folder, "replay.f32 is damaged: it is not as it was")
            (home / name).write_bytes(content)
    (home / "checkpoint.safetensors").unlink()
    refused(folder, "checkpoint.safetensors is gone, and .* step 80", FileNotFoundError)
    # As it is where a record was copied without it.
    shutil.rmtree(folder / "members")
    refused(folder, "checkpoint.safetensors is gone", FileNotFoundError)
    with pytest.raises(FileNotFoundError, match="is gone"):
        runs.extend(folder, 200)
    assert not (folder / "members").exists()


def test_demonstrations_must_be_those_it_began_with(tiny, folder, random_demonstrations):
    runs.create(folder, tiny, SEEDS, demonstrations=random_demonstrations(MAZE))
    with pytest.raises(ValueError, match="3 trajectories from elsewhere are not those"):
        runs.work(folder, demonstrations=random_demonstrations(MAZE, 3))
    with pytest.raises(ValueError, match=r"has not made: give the same to `runs.work` again"):
        runs.work(folder)


def test_demonstrations_of_one_expert_are_so_again_on_resume(tiny, folder, shipped_experts):
    shown = load(MAZE, 2, experts=1)
    runs.create(folder, tiny, SEEDS, demonstrations=shown)
    resume(folder)
    assert records.read(folder).steps[-1] == tiny.total_steps


def test_demonstrations_are_thinned_again_on_resume(tiny, folder, write_dataset):
    name = write_dataset("my/pendulum-v0").spec.dataset_id
    config = replace(tiny, env_id="Pendulum-v1")
    thin = load(config.env_id, 2, name, subsample=20, experts=1)
    runs.create(folder, config, SEEDS, demonstrations=thin)
    assert records.Plan.read(folder).demonstrations["experts"] is None  # They are by none of ours.
    resume(folder)
    assert records.read(folder).steps[-1] == config.total_steps


def test_a_run_from_before_subsampling_is_one_without(tiny, folder, write_dataset):
    name = write_dataset("my/pendulum-v0").spec.dataset_id
    config = replace(tiny, env_id="Pendulum-v1")
    whole = load(config.env_id, 2, name)
    runs.create(folder, config, SEEDS, demonstrations=whole)
    about = json.loads((folder / "config.json").read_text())
    assert about["demonstrations"].pop("subsample") == 1
    (folder / "config.json").write_text(json.dumps(about))
    resume(folder)
    assert records.read(folder).steps[-1] == config.total_steps


def test_a_run_may_be_made_where_one_stands_and_behind_a_link(plain, tmp_path, monkeypatch):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    runs.create(tmp_path / "link", plain, SEEDS)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    runs.create(".", plain, SEEDS)
    resume(".")
    for folder in (tmp_path / "elsewhere", tmp_path / "here"):
        assert records.Plan.read(folder).config == plain
    assert manifest(tmp_path / "here")["state"] == "finished"
    assert {path.name for path in tmp_path.iterdir()} == {"elsewhere", "link", "here"}


def test_nothing_is_overwritten(interrupted, folder, plain):
    before = files(folder)
    with pytest.raises(FileExistsError, match=r"not empty: `offairl resume .*one` goes on"):
        runs.create(folder, plain, (0,))
    assert files(folder) == before


def test_two_processes_do_not_share_a_shard(folder, plain):
    runs.create(folder, replace(plain, total_steps=100_000), SEEDS)
    process = start(folder, None, None, 0)
    while manifest(folder)["state"] != "running":
        time.sleep(0.01)
        assert process.is_alive()
    for attempt in (
        lambda: resume(folder),
        lambda: runs.extend(folder, 200),
        lambda: runs.extend(folder, seeds=(8,)),
    ):
        with pytest.raises(OSError, match=r"another process is at work on .*3-7: let it finish"):
            attempt()
    process.kill()
    process.join()
    runs.extend(folder, 200)
    resume(folder)
    assert records.read(folder).steps[-1] == 200


@pytest.mark.parametrize("steps", [100, 150])
def test_a_stop_before_the_end_is_published_loses_nothing(steps, folder, plain, tmp_path):
    whole = run(tmp_path / "whole", plain)
    run(folder, plain)
    if steps > 100:  # The policy of before the run was extended is there still.
        for one in (whole, folder):
            runs.extend(one, steps)
        resume(whole)
    before = runs._publish

    def publish(folder, shard=None, status=None):
        if status and status["state"] == "finished":
            raise Broken("a stop")
        before(folder, shard, status)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runs, "_publish", publish)
        if steps == 100:
            shutil.rmtree(folder)
            runs.create(folder, plain, SEEDS, checkpoint_every=40)
        with pytest.raises(Broken):
            resume(folder)
    assert runs.unfinished(folder) == [SEEDS]
    resume(folder)
    assert manifest(folder)["state"] == "finished"
    assert runs.unfinished(folder) == []
    assert_same(folder, whole)


def test_what_goes_on_elsewhere_says_so(interrupted, folder, monkeypatch, caplog):
    began = manifest(folder)
    monkeypatch.setattr(provenance, "processor", lambda: "an abacus")
    runs.extend(folder, 150)
    resume(folder)
    ended = manifest(folder)
    (later,) = ended["continued"]
    assert (later["step"], later["processor"]) == (80, "an abacus")
    assert "wall_s" not in later  # that of the whole run is in one place
    assert ended["processor"] == began["processor"]
    assert "goes on from step 80 with other processor: an abacus, before" in caplog.text
    # The same once more is no news.
    runs.extend(folder, 200)
    resume(folder)
    assert manifest(folder)["continued"] == [later]


def test_a_run_that_ends_within_its_warm_up_says_why(folder, plain, monkeypatch):
    monkeypatch.setattr(
        Trainer, "_step", lambda self: self._give_up("eye", torch.ones(2) > 0, "look")
    )
    runs.create(folder, plain, SEEDS)
    with pytest.warns(UserWarning, match="seed . diverged by step 0: its eye is not finite"):
        resume(folder)
    assert manifest(folder)["state"] == "stopped: every member has diverged"
    assert list(records.read(str(folder)).diverged) == list(SEEDS)


@pytest.mark.filterwarnings("ignore:seed . diverged")
def test_who_diverges_before_there_is_a_policy_has_one_of_zeros(folder, plain, monkeypatch):
    step = Trainer._step

    def first_is_lost(self):
        if 3 in self.seeds:
            self._give_up("eye", torch.ones(1) > 0, "look")
        return step(self)

    monkeypatch.setattr(Trainer, "_step", first_is_lost)
    runs.create(folder, plain, SEEDS, shards=2)
    resume(folder)
    kept = records.read(folder).policy
    assert len(kept) == 2
    assert (kept.params[0] == 0).all()
    assert not (kept.params[1] == 0).all()


def test_many_seeds_make_a_name_that_a_disk_takes(folder, plain):
    seeds = tuple(range(10**9, 10**9 + 30))
    assert runs.home(folder, SEEDS).name == "3-7"
    name = runs.home(folder, seeds).name
    assert len(name) < 40
    assert name != runs.home(folder, (seeds[0], *seeds[1:-1][::-1], seeds[-1])).name
    runs.create(folder, plain, seeds)
    (job,) = jobs.of(folder)
    assert job.shard == runs.home(folder, seeds)


@pytest.mark.parametrize("what", ["frozen", "carried", "guide"])
def test_what_would_not_be_used_is_refused(what, plain, tmp_path):
    files = {what: (tmp_path / "policy.safetensors",)}
    with pytest.raises(ValueError, match=rf"--{what} .*policy.safetensors would not be used: add "):
        runs.require_use([plain], **files)
    uses = replace(plain, reward="frozen", carry="policy", start_steps=20)
    runs.require_use([plain, uses], **files)
    runs.require_use([plain], **{what: ()})


def test_a_run_s_folder_stands_for_what_it_has(plain, tmp_path):
    frozen_reward(2).save(tmp_path / "reward.safetensors")
    policy(plain).save(tmp_path / "policy.safetensors")
    config = replace(plain, reward="frozen", carry="policy")
    found = runs.inherit(config, SEEDS, frozen=[tmp_path], carried=[tmp_path])
    assert torch.equal(found["reward"].params, frozen_reward(2).params)
    assert torch.equal(found["policy"].params, policy(plain).params)


def test_a_full_disk_is_foreseen(folder, plain, monkeypatch):
    usage = namedtuple("Usage", "total used free")(10**9, 10**9 - 10**5, 10**5)
    with monkeypatch.context() as patch:
        patch.setattr(shutil, "disk_usage", lambda _: usage)
        with pytest.raises(OSError, match=r"needs .* MB of disk.* has 0.1 MB left: lower replay_s"):
            runs.create(folder, plain, SEEDS)
    assert not folder.parent.exists()
    run(folder, plain)
    with monkeypatch.context() as patch:
        patch.setattr(shutil, "disk_usage", lambda _: usage)
        with pytest.raises(OSError, match=r"needs .* MB of disk"):
            runs.extend(folder, 100_000)
        with pytest.raises(OSError, match=r"needs .* MB of disk"):
            runs.extend(folder, seeds=tuple(range(10, 40)))
    assert records.read(folder).config == plain


@pytest.mark.parametrize("name", ["save_weights", "lines", "merged"])
def test_a_full_disk_loses_nothing(name, folder, plain, tmp_path, monkeypatch):
    whole = run(tmp_path / "whole", plain)
    runs.create(folder, plain, SEEDS, checkpoint_every=40)
    original, calls = getattr(runs, name), iter(range(100))

    def write(*args):
        if next(calls) == 1:
            raise OSError(errno.ENOSPC, "No space left on device")
        return original(*args)

    with monkeypatch.context() as patch:
        patch.setattr(runs, name, write)
        message = r"the disk of .*one is full: free .* MB, and `offairl resume .*one` goes on"
        with pytest.raises(OSError, match=message):
            resume(folder)
    resume(folder)
    assert_same(folder, whole)


@pytest.mark.parametrize("case", KILLED)
def test_the_disk_a_run_takes_is_known(case, tiny, folder, given):
    config = replace(tiny, **KILLED[case])
    demonstrations = given(config.env_id)[0] if config.learns_reward else None
    run(folder, config, demonstrations=demonstrations, **inherited(config))
    home = folder / "members" / "3-7"
    replay, checkpoint = (
        (home / f).stat().st_size for f in ("replay.f32", "checkpoint.safetensors")
    )
    # While it is written, a second checkpoint is there.
    used, foreseen = replay + 2 * checkpoint, disk.use(records.Plan.read(folder))
    assert 0.4 * foreseen < used < foreseen


# Divergence.


def diverging(*members):
    """SAC whose critics of some members turn infinite at update 70."""
    original = SAC.update

    def update(self, *batch):
        if self.updates == 70:
            for member in members:
                self.critic_params.data[:, member] = torch.inf
        return original(self, *batch)

    return update


def test_a_member_that_diverges_is_given_up_alone(folder, plain, monkeypatch):
    monkeypatch.setattr(SAC, "update", diverging(1))
    runs.create(folder, replace(plain, total_steps=150), SEEDS, checkpoint_every=40)
    with pytest.warns(UserWarning, match="seed 7 diverged by step 80"):
        resume(folder)
    run = records.read(folder)
    assert [(row.seed, row.step) for row in run.rows] == [(3, 50), (7, 50), (3, 100), (3, 150)]
    assert list(run.diverged) == [7]
    assert run.diverged[7].startswith("seed 7 diverged by step 80: its ")
    assert manifest(folder)["state"] == "finished"
    # It is remembered.
    runs.extend(folder, 200)
    resume(folder)
    assert list(records.read(folder).diverged) == [7]
    assert len(records.read(folder).rows) == 5


@pytest.mark.filterwarnings("ignore:seed . diverged")
def test_a_shard_that_diverges_leaves_the_others_alone(folder, plain, monkeypatch):
    monkeypatch.setattr(SAC, "update", diverging(0))
    runs.create(folder, plain, SEEDS, shards=2, checkpoint_every=40)
    resume(folder)
    assert manifest(folder)["state"] == "stopped: every member has diverged"
    assert list(records.read(folder).diverged) == [3, 7]
    monkeypatch.undo()
    runs.extend(folder, seeds=(5,))
    resume(folder)
    assert manifest(folder)["state"] == "finished"
    assert [(r.seed, r.step) for r in records.read(folder).rows[2:]] == [(5, 50), (5, 100)]
    assert len(records.read(folder).policy) == 3


def test_a_record_is_verified_without_its_checkpoints(plain, folder):
    run(folder, replace(plain, total_steps=150))
    shutil.rmtree(folder / "members")
    recorded = records.read(folder).rows
    for evaluations in (1, 3):
        olds, news = zip(*runs.verify(folder, evaluations, progress=False), strict=True)
        # As lines, since a learned return that is NaN is not equal to itself.
        assert records.lines(olds) == records.lines(recorded[: 2 * evaluations])
        assert records.lines(news) == records.lines(olds)
    with pytest.raises(ValueError, match=r"evaluations is 4; .* has 3 to do again"):
        runs.verify(folder, 4)


@pytest.mark.filterwarnings("ignore:seed . diverged")
def test_a_member_that_diverges_here_alone_is_not_verified(plain, folder, monkeypatch):
    run(folder, plain)
    monkeypatch.setattr(SAC, "update", diverging(1))
    pairs = runs.verify(folder, 2, progress=False)
    assert [(old.seed, old.step, new is None) for old, new in pairs] == [
        (3, 50, False),
        (7, 50, False),
        (3, 100, False),
        (7, 100, True),
    ]


@pytest.mark.filterwarnings("ignore:seed . diverged")
def test_where_every_member_diverges_here_nothing_is_verified(plain, folder, monkeypatch):
    run(folder, plain)
    monkeypatch.setattr(SAC, "update", diverging(0, 1))
    pairs = runs.verify(folder, 2, progress=False)
    assert [(old.step, new is None) for old, new in pairs] == [
        (50, False),
        (50, False),
        (100, True),
        (100, True),
    ]


def test_only_the_first_shard_is_verified(plain, folder):
    run(folder, plain, shards=2)
    assert [new.seed for _, new in runs.verify(folder, progress=False)] == [3]


def test_verifying_needs_what_the_run_had(plain, tiny, folder, random_demonstrations):
    with pytest.raises(FileNotFoundError, match="there is no run in"):
        runs.verify(folder)
    policy = Trainer(plain, SEEDS)
    while policy.generator is None:
        policy.advance()
    run(folder, replace(plain, carry="policy"), policy=policy.generator.policy)
    assert len(runs.verify(folder, progress=False)) == 2
    (folder / "carried.safetensors").unlink()
    with pytest.raises(FileNotFoundError, match=r"carried\.safetensors"):
        runs.verify(folder)


def test_a_record_finds_what_it_had_of_other_runs_where_it_was(plain, folder, tmp_path):
    config = replace(plain, reward="frozen", carry="policy", start_steps=20)
    sources = {name: (tmp_path / name,) for name in ("frozen", "carried", "guide")}
    frozen_reward(2).save(*sources["frozen"])
    policy(plain).save(*sources["carried"])
    policy(plain).member(1).save(*sources["guide"])  # One for both.
    run(folder, config, **runs.inherit(config, SEEDS, **sources), sources=sources)
    expected = runs.verify(folder, progress=False)
    for name in sources:
        (folder / f"{name}.safetensors").unlink()
    assert repr(runs.verify(folder, progress=False)) == repr(expected)
    frozen_reward(3).member(1, 2).save(*sources["frozen"])
    with pytest.raises(ValueError, match=r"frozen is not the reward that .* began with"):
        runs.verify(folder)
    sources["frozen"][0].unlink()
    with pytest.raises(FileNotFoundError, match="frozen"):
        runs.verify(folder)
