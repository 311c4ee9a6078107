"""Files that are not as they were written, tasks that fail, and commands that get in each other's
way: every one is named, and nothing is lost."""

import errno
import json
import os
import re
import time

import numpy as np
import pytest
import torch
from own_task import Arm
from run_folders import create

from offairl_lite.core.networks import load_weights, save_weights
from offairl_lite.core.replay import Batch, Replay
from offairl_lite.envs.serial import TaskError
from offairl_lite.runs import checkpoints, cli, folders, inputs, launch, records

SEEDS = (3, 7)


class Troubled(Arm):
    """A task that gets into trouble at one step of all, until it is mended."""

    trouble, clock, at = None, 0, 150

    def step(self, action):
        Troubled.clock += 1
        obs, reward, *rest = super().step(action)
        if Troubled.trouble is not None and Troubled.clock == Troubled.at:
            what, number = Troubled.trouble
            if what == "raises":
                raise ZeroDivisionError("a bug of my own")
            if what == "reward":
                reward = number
            else:
                obs[1] = number
        return obs, reward, *rest


@pytest.fixture
def plain(tiny):
    config = tiny.change(reward="environment", train_every=20, eval_episodes=1)
    return config.change(total_steps=100, learning_starts=40, eval_every=25)


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "runs" / "one"


@pytest.fixture
def ended(folder, plain):
    """A run at its end."""
    create(folder, plain, SEEDS, checkpoint_every=40)
    folders.work(folder, progress=False)
    return folder


@pytest.fixture
def stopped(ended, plain):
    """A run that is to be gone on with, from step 100."""
    folders.extend(ended, 150)
    replay = ended / "checkpoint" / "replay.f32"
    os.truncate(replay, replay.stat().st_size * 3 // 2)  # As going on will lengthen it.
    return ended


def flip(path, place, bit):
    """Flip a bit of a file; return what puts it back."""
    content = bytearray(path.read_bytes())
    content[place] ^= 1 << bit
    sound = path.read_bytes()
    path.write_bytes(content)
    return lambda: path.write_bytes(sound)


def refused(folder, *words):
    """A run is not gone on with, nor changed; the message has the words, and no jargon."""
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    with pytest.raises(ValueError, match="bring all of") as found:
        folders.work(folder, progress=False)
    for word in words:
        assert word in str(found.value)
    assert not re.search("Errno|KeyError|TypeError|Traceback|diverged by", str(found.value))
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


# At rest.


def test_a_flipped_bit_anywhere_in_the_replay_is_found(stopped, monkeypatch):
    path, rng = stopped / "checkpoint" / "replay.f32", np.random.default_rng(0)
    width = path.stat().st_size // 150
    for place in [0, 100 * width - 1, *rng.integers(0, 100 * width, 20)]:
        back = flip(path, place, rng.integers(8))
        refused(stopped, "replay.f32 is damaged: 1 of its 1 blocks, the first from byte 0 on")
        back()
    folders.work(stopped, progress=False)
    assert records.read(stopped).steps[-1] == 150


@pytest.mark.parametrize("slots", [64, 70])
def test_checksums_follow_what_is_held(slots, monkeypatch):
    monkeypatch.setattr(checkpoints, "BLOCK", 8)
    rng, replay = np.random.default_rng(0), Replay(2, 40, 1, 1, slots=slots)
    kept, before = checkpoints.Checksums(replay), None
    for _ in range(60):
        for _ in range(rng.integers(0, 12)):
            # Members fill at their own pace.
            members = torch.tensor([[0], [1], [0, 1]][rng.integers(3)])
            parts = [torch.randn(len(members), n) for n in (1, 1, 1)]
            replay.add(Batch(*parts, *torch.randn(2, len(members))), members)
        fresh = checkpoints.Checksums(replay)
        assert kept.update() == fresh.update()
        assert kept.update() != before or before is None or not sum(replay.sizes)
    member, back = 1, int(rng.integers(40))
    place = int(replay.added[member] - 1 - back) % slots
    replay.rows[place, member, 2] += 1e-6
    wrong = np.flatnonzero(np.array(checkpoints.Checksums(replay).update()) != kept.blocks)
    assert wrong.tolist() == [place // 8]
    # What is no longer held may be overwritten.
    replay.rows[place, member, 2] = 0
    sums = checkpoints.Checksums(replay).update()
    replay.rows[int(replay.added[0]) % slots, 0] = 7
    assert checkpoints.Checksums(replay).update() == sums


def test_a_run_from_before_there_were_checksums_goes_on(stopped):
    path = stopped / "checkpoint" / "checkpoint.safetensors"
    state, about = load_weights(path, "checkpoint")
    for name in ("blocks", "curve", "digest"):
        del about[name]
    save_weights(path, state, {**about, "digest": inputs.digest(state, about)})
    for name in ("run.json", "config.json"):
        content = records.read_json(stopped / name)
        content.pop("curve.csv", None)
        (stopped / name).write_text(json.dumps(content))
    folders.work(stopped, progress=False)
    assert records.read(stopped).steps[-1] == 150


@pytest.mark.parametrize("run", ["stopped", "ended"])
def test_a_changed_digit_of_a_curve_is_found(run, request, folder, monkeypatch):
    request.getfixturevalue(run)
    path = folder / "curve.csv"
    places = [m.start() for m in re.finditer(rb"\d", path.read_bytes())]
    for place in places[:: len(places) // 10]:
        back = flip(path, place, 0)
        if run == "stopped":
            refused(folder, "curve.csv is damaged")
        with pytest.raises(SystemExit, match=r"^offairl: .*curve.csv is damaged: .*; bring all of"):
            cli.main(["resume", str(folder)])
        back()
    cli.main(["resume", str(folder)])


@pytest.mark.parametrize("name", ["run.json", "config.json"])
def test_a_changed_letter_of_a_description_is_found(name, stopped):
    path = stopped / name
    places = [m.start() for m in re.finditer(rb"\w(?!\w*\":)", path.read_bytes())]
    for place in places[:: len(places) // 40]:
        back = flip(path, place, 0)
        with pytest.raises(ValueError, match=rf"{name} (is damaged|does not|has format)") as found:
            folders.work(stopped, progress=False)
        assert "KeyError" not in str(found.value)
        back()
    folders.work(stopped, progress=False)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("run.json", None, "it is gone"),
        ("run.json", b"", "Expecting value"),
        ("run.json", b"{}", "state is 'missing'; expected str"),
        ("run.json", b"[]", "content is []; expected dict"),
        ("run.json", b'{"state": 3, "step": 0}', "state is 3; expected str"),
        ("run.json", b'{"state": "waiting", "step": "x"}', "step is 'x'; expected int"),
        ("run.json", b'{"state": "", "step": 0, "diverged": 1}', "diverged is 1; expected dict"),
        ("run.json", b"\xff", "'utf-8' codec can't decode byte 0xff"),
        ("config.json", b"[1, 2]", "content is [1, 2]; expected dict"),
        ("config.json", b"{", "Expecting property name"),
        ("config.json", b"[" * 100_000, "maximum recursion"),
        ("curve.csv", None, "it had"),
        ("curve.csv", b"\xff", "it had"),
    ],
)
def test_what_is_damaged_is_named(name, content, words, stopped):
    path = stopped / name
    path.unlink() if content is None else path.write_bytes(content)
    refused(stopped, f"{path} is damaged", words)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"config": [1]}, "config is [1]; expected dict"),
        ({"seeds": "01"}, "seeds is '01'; expected a tuple"),
        ({"seeds": [0, -1]}, "seeds is [0, -1]; expected"),
        ({"seeds": ["a"]}, "seeds is ['a']; expected"),
        ({"execution": None}, "execution is None; expected dict"),
        ({"execution": {"threads": "x"}}, "threads is 'x'; expected a whole number"),
        ({"execution": {"nap": 1}}, "nap"),
        ({"checkpoint_every": "x"}, "checkpoint_every is 'x'; expected int"),
        ({"demonstrations": 5}, "demonstrations is 5; expected dict"),
        ({"inherited": 5}, "inherited is 5; expected dict"),
        ({"mood": 1}, "mood"),
        ({"config": {"discount": "x"}}, "discount is 'x'; expected a number"),
        ({"config": {"hidden": 64}}, "hidden is 64; expected a tuple"),
        ({"config": {"normalise": "no"}}, "normalise is 'no'; expected True or False"),
    ],
)
def test_a_field_of_a_wrong_type_is_named(change, words, stopped):
    content = records.read_json(stopped / "config.json")
    records.write_json(stopped / "config.json", content | change)
    with pytest.raises(ValueError, match=r"config.json does not describe a run: ") as found:
        folders.work(stopped, progress=False)
    assert words in str(found.value)


@pytest.mark.parametrize(
    "row", [b"3,100\n", b"a,b,c,d,e,f\n", b"\xff\n", b'3,100,1,1.0,"1.0,2\n', b"3,1,1,1,x y,1\n"]
)
def test_a_row_that_is_none_is_named(row, ended):
    curve = ended / "curve.csv"
    curve.write_bytes(curve.read_bytes() + row)
    with pytest.raises(ValueError, match=r"curve\.csv is damaged: .*; bring all of"):
        records.read(ended)


def test_of_two_runs_the_one_that_is_whole_goes_on(tmp_path, plain, capfd):
    place = tmp_path / "both"
    for seed in SEEDS:
        create(place / f"seeds-{seed}", plain, (seed,), checkpoint_every=40)
        folders.work(place / f"seeds-{seed}", progress=False)
    folders.extend(place, 150)
    back = flip(place / "seeds-3" / "checkpoint" / "replay.f32", 100, 3)
    with pytest.raises(SystemExit, match=r"1 of 2 jobs failed, twice: see above; `offairl resume"):
        cli.main(["resume", str(place)])
    assert "replay.f32 is damaged" in capfd.readouterr().err
    assert [records.read(path).steps[-1] for path in records.run_folders(place)] == [100, 150]
    back()
    cli.main(["resume", str(place)])
    assert records.read(place).returns.shape == (2, 5)


# Tasks that fail.


@pytest.fixture
def troubled(own, plain, folder, tmp_path, monkeypatch):
    """A run of a task that will get into trouble, and the same without."""
    config = plain.change(env_id=own("ownbot/Troubled-v0", Troubled), total_steps=150)
    whole = tmp_path / "whole"
    for path in (whole, folder):
        monkeypatch.setattr(Troubled, "trouble", None)
        create(path, config, SEEDS, checkpoint_every=40)
    folders.work(whole, progress=False)
    monkeypatch.setattr(Troubled, "clock", 0)
    return whole


@pytest.mark.parametrize(
    ("trouble", "kind", "words"),
    [
        (("reward", np.nan), ValueError, "its reward is nan, not within ±1e+08; mend it"),
        (("reward", np.inf), ValueError, "its reward is inf, not within ±1e+08; mend it"),
        (("reward", -1e9), ValueError, "its reward is -1e+09, not within ±1e+08; mend it"),
        (("obs", np.nan), ValueError, r"its observation\[1\] is nan, not within ±1e+08; mend it"),
        (("obs", 1e30), ValueError, r"its observation\[1\] is 1e\+30, not within ±1e+08; mend it"),
        (("obs", -3e8), ValueError, r"its observation\[1\] is -3e\+08, not within ±1e+08; mend it"),
        (("raises", 0), TaskError, "has failed in its step, ZeroDivisionError: a bug of my own"),
    ],
)
@pytest.mark.parametrize(("at", "step"), [(30, 14), (150, 69)])  # In the warm-up, and after it.
def test_nothing_is_lost_once_the_task_is_mended(
    trouble, kind, words, at, step, troubled, folder, monkeypatch
):
    words = words.replace("e+08", r"e\+08").replace("e+09", r"e\+09")
    if kind is not TaskError:
        words = rf"Troubled-v0, seed \d+, is at fault in step {step}: {words}"
    monkeypatch.setattr(Troubled, "at", at)
    monkeypatch.setattr(Troubled, "trouble", trouble)
    with pytest.raises(kind, match=words) as found:
        folders.work(folder, progress=False)
    assert found.value.__notes__[0].startswith(f"`offairl resume {folder}` goes on from step ")
    assert not folders.is_finished(folder)
    assert records.read_state(folder)["state"].startswith("stopped: ")
    monkeypatch.setattr(Troubled, "trouble", None)
    folders.work(folder, progress=False)
    for name in ("curve.csv", "policy.safetensors"):
        assert (folder / name).read_bytes() == (troubled / name).read_bytes()
    assert records.read(folder).diverged == {}


@pytest.mark.parametrize("trouble", [("obs", 1e30), ("reward", np.nan)])
def test_an_evaluation_notices_trouble_too(trouble, troubled, folder, monkeypatch):
    monkeypatch.setattr(Troubled, "at", 105)
    monkeypatch.setattr(Troubled, "trouble", trouble)
    with pytest.raises(
        ValueError, match=r"Troubled-v0, seed \d+, is at fault in step . of an episode: its"
    ):
        folders.work(folder, progress=False)
    monkeypatch.setattr(Troubled, "trouble", None)
    folders.work(folder, progress=False)
    assert (folder / "curve.csv").read_bytes() == (troubled / "curve.csv").read_bytes()


def test_the_command_says_so_too(troubled, folder, monkeypatch):
    monkeypatch.setattr(Troubled, "trouble", ("reward", np.nan))
    with pytest.raises(
        SystemExit,
        match=r"ownbot/.* is at fault .*; mend it; `offairl resume .* goes on from step ",
    ):
        cli.main(["resume", str(folder)])


# Commands in each other's way.


def test_a_run_is_made_in_a_mount(folder, plain, monkeypatch):
    replace = os.replace

    def busy(part, path):
        if path == folder:
            raise OSError(errno.EBUSY, "Device or resource busy")
        replace(part, path)

    monkeypatch.setattr(os, "replace", busy)
    folder.mkdir(parents=True)
    create(folder, plain, SEEDS)
    assert records.RunSpec.read(folder).config == plain
    assert [path.name for path in folder.parent.iterdir()] == [folder.name]


@pytest.mark.parametrize("empty", [True, False])
def test_of_two_commands_at_once_one_wins_and_the_other_says_why(empty, folder, plain, monkeypatch):
    write, first = records.RunSpec.write, []

    def write_second(self, made):
        if not first:  # Another command is a moment quicker.
            first.append(made)
            create(folder, plain, (1, 2))
        write(self, made)

    if empty:
        folder.mkdir(parents=True)
    monkeypatch.setattr(records.RunSpec, "write", write_second)
    with pytest.raises(FileExistsError, match=r"one is not empty: `offairl resume .*one` goes on"):
        create(folder, plain, SEEDS)
    assert records.RunSpec.read(folder).seeds == (1, 2)
    folders.work(folder, progress=False)
    assert [path.name for path in folder.parent.iterdir()] == [folder.name]


def test_what_a_killed_command_has_left_is_removed_by_the_next(folder, plain):
    left, fresh = (folder.parent / f".one.{name}" for name in ("abcdefgh", "xxxxxxxx"))
    for path in (left, fresh):
        (path / "run").mkdir(parents=True)
    os.utime(left, (time.time() - 60,) * 2)
    create(folder, plain, SEEDS)
    assert sorted(path.name for path in folder.parent.iterdir()) == [fresh.name, "one"]


@pytest.mark.parametrize("name", ["file", "file/below", "file/below/deeper"])
def test_a_file_is_no_place_for_a_run(name, tmp_path, plain):
    (tmp_path / "file").touch()
    with pytest.raises(NotADirectoryError, match=r"file is no folder: choose another"):
        create(tmp_path / name, plain, SEEDS)


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        MemoryError("Unable to allocate 3 GiB"),
        RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to allocate 9 bytes"),
        OSError(errno.ENOMEM, "Cannot allocate memory"),
    ],
)
def test_too_little_memory_is_told(error, monkeypatch, tmp_path):
    def run(*_, **__):
        raise error

    monkeypatch.setattr(launch, "_create", run)
    with pytest.raises(SystemExit, match=r"there is not enough memory: lower --batch-size"):
        cli.main(["run", "maze-expert", "--out", str(tmp_path / "one")])


def test_an_unknown_error_keeps_its_traceback(monkeypatch, tmp_path):
    def run(*_, **__):
        raise RuntimeError("a bug")

    monkeypatch.setattr(launch, "_create", run)
    with pytest.raises(RuntimeError, match="a bug"):
        cli.main(["run", "maze-expert", "--out", str(tmp_path / "one")])
