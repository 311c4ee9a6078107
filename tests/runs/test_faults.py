"""A file operation may fail at any moment, and nothing that was there is lost."""

import builtins
import itertools
import os
import shutil
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch
from run_folders import create

from offairl_lite import AIRL
from offairl_lite.analysis import films
from offairl_lite.core.results import Run
from offairl_lite.runs import checkpoints, cli, export, folders, pictures, records, tensorboard

PLACES = [
    *((os, name) for name in ("replace", "rename", "unlink", "rmdir", "truncate", "mkdir")),
    *((Path, name) for name in ("write_text", "write_bytes", "unlink", "mkdir", "rename")),
    *((shutil, name) for name in ("move", "rmtree", "copytree", "copyfile")),
    (builtins, "open"),
]
"""What changes files; whoever removes or writes one calls one of them."""


@dataclass
class Faults:
    """Lets the operations on files below a folder pass, but for one, which fails."""

    below: Path
    at: int = -1
    seen: int = 0

    def guard(self, real, name):
        def operate(*args, **how):
            writes = name != "open" or set(str((*args[1:2], how.get("mode", "")))) & set("wa+x")
            own = args and isinstance(args[0], str | Path) and str(self.below) in str(args[0])
            if writes and own:
                self.seen += 1
                if self.seen - 1 == self.at:
                    raise OSError(5, f"{name} has failed, {args[:1]}")
            return real(*args, **how)

        return operate


@pytest.fixture
def faults(tmp_path, monkeypatch):
    """Run something with operation k failing; returns whether it came to that operation."""

    def run(k, do):
        state = Faults(tmp_path, k)
        with monkeypatch.context() as patch:
            for owner, name in PLACES:
                patch.setattr(owner, name, state.guard(getattr(owner, name), name))
            with suppress(OSError):
                do()
        return state.seen > k

    return run


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(records, "_commit", lambda: None)
    monkeypatch.setattr(pictures, "draw", lambda folder: None)


@pytest.fixture
def config(tiny):
    return tiny.change(
        reward="environment",
        total_steps=40,
        learning_starts=20,
        train_every=20,
        eval_every=20,
        hidden=(4,),
        eval_episodes=1,
    )


@pytest.fixture
def finished(config, tmp_path):
    """A finished run, and what is in it."""
    create(tmp_path / "run", config, (0,), checkpoint_every=10)
    folders.work(tmp_path / "run", progress=False)
    return tmp_path / "run"


def state(folder) -> Run:
    return records.read(folder)


def same(one, other):
    assert records.lines(one.rows) == records.lines(other.rows)  # NaN is not NaN.
    assert torch.equal(one.policy.params, other.policy.params)


def copies(folder, tmp_path):
    """Copies of a run, one for each operation that may fail."""
    for k in itertools.count():
        here = tmp_path / f"try-{k}"
        shutil.copytree(folder, here)
        yield k, here


def test_an_extension_that_fails_anywhere_keeps_the_finished_run_and_can_be_repeated(
    finished, tmp_path, faults
):
    before = state(finished)
    shutil.copytree(finished, whole := tmp_path / "whole")
    folders.extend(whole, 60)
    folders.work(whole, progress=False)
    longer = state(whole)
    for k, here in copies(finished, tmp_path):

        def go_on(here=here):
            folders.extend(here, 60)
            folders.work(here, progress=False)

        failed = faults(k, go_on)
        found = state(here)
        assert found.policy is not None, f"the policy is gone after operation {k}"
        kept = found.rows[: len(before.rows)]
        assert records.lines(kept) == records.lines(before.rows)
        assert torch.equal(records.read(here, step=40).policy.params, before.policy.params)
        go_on()
        same(state(here), longer)
        shutil.rmtree(here)
        if not failed:
            break
    assert k > 10


def test_a_new_run_that_fails_anywhere_is_whole_or_not_there(config, finished, tmp_path, faults):
    whole = state(finished)
    for k in itertools.count():
        here = tmp_path / f"new-{k}"

        def start(here=here):
            create(here, config, (0,), checkpoint_every=10)

        failed = faults(k, start)
        if not (here / "config.json").exists():
            start()
        folders.work(here, progress=False)
        same(state(here), whole)
        if not failed:
            break
    assert k > 3


def test_seeds_that_cannot_be_added_take_nothing_away(finished, tmp_path, faults):
    before = state(finished)
    for k, here in copies(finished, tmp_path):
        failed = faults(k, lambda here=here: folders.extend(here, seeds=(1,)))
        first = records.RunSpec.read(here)
        assert first.seeds == (0,)
        one = here if not (here / "seeds-1").exists() else None
        if one is not None:
            same(state(one), before)
            folders.extend(here, seeds=(1,))
        assert torch.equal(
            records.Policy.load(here / "policy.safetensors").params, before.policy.params
        )
        assert records.RunSpec.read(here / "seeds-1").seeds == (1,)
        shutil.rmtree(here)
        if not failed:
            break
    assert k > 3


def test_a_copy_that_fails_anywhere_leaves_the_old_one_or_is_the_new_one(
    finished, tmp_path, faults
):
    before = state(finished)
    shutil.copytree(finished, longer := tmp_path / "longer")
    folders.extend(longer, 60)
    folders.work(longer, progress=False)
    after = state(longer)
    for k, here in copies(finished, tmp_path):
        failed = faults(k, lambda here=here: checkpoints.copy(longer, here))
        found = state(here)
        same(found, after if found.rows[-1].step == 60 else before)
        same(state(longer), after)
        checkpoints.copy(longer, here)
        same(state(here), after)
        shutil.rmtree(here)
        if not failed:
            break
    assert k > 3


@pytest.mark.parametrize("command", ["watch", "clone"])
def test_a_file_that_is_replaced_is_the_old_one_or_the_new_one(
    command, finished, tmp_path, faults, monkeypatch
):
    monkeypatch.setattr(films, "mp4", lambda pictures, fps: b"a film")
    out = tmp_path / ("film.mp4" if command == "watch" else "clone.safetensors")
    do = {
        "watch": lambda: cli.watch(str(finished), max_steps=1, out=out),
        "clone": lambda: cli.clone(
            "offairl/PointMazeLeft-v0", out=out, hidden=(4,), steps=10, eval_episodes=0
        ),
    }[command]
    do()
    new = out.read_bytes()
    for k in itertools.count():
        out.write_bytes(b"old")
        failed = faults(k, do)
        assert out.read_bytes() in (b"old", new)
        if not failed:
            break
    assert k > 1
    assert out.read_bytes() == new


@pytest.mark.parametrize("command", ["export", "tensorboard", "load", "verify"])
def test_what_only_reads_a_run_changes_nothing_in_it(command, finished, tmp_path, faults):
    """Even if it fails; given again, it does its work."""
    if command == "tensorboard":
        pytest.importorskip("tensorboard", reason="TensorBoard is not installed")
    before = {p: p.read_bytes() for p in finished.rglob("*") if p.is_file()}
    do = {
        "export": lambda out: export.export(finished, out),
        "tensorboard": lambda out: tensorboard.export(finished, out, anew=True),
        "load": lambda out: AIRL.load(finished, folder=out),
        "verify": lambda out: cli.verify(finished),
    }[command]
    for k in itertools.count():
        out = tmp_path / f"out-{k}"
        failed = faults(k, lambda out=out: do(out))
        for path, content in before.items():
            assert path.read_bytes() == content, path
        if k % 5 == 0:
            do(out if command != "load" else tmp_path / f"again-{k}")
        if not failed or k > 30:
            break
