"""Run folders: killed at random moments, resumed, extended, damaged."""

import errno
import fcntl
import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import namedtuple
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from offairl_lite import networks, records, runs
from offairl_lite.demonstrations import Demonstrations
from offairl_lite.discriminators import Reward
from offairl_lite.imitate import Trainer
from offairl_lite.networks import Normaliser, StackedMLP
from offairl_lite.replay import Batch
from offairl_lite.sac import SAC
from offairl_lite.streams import Streams

MAZE, HOPPER = "offairl/PointMazeLeft-v0", "Hopper-v5"
SEEDS = (3, 7)

# A server that has imported everything forks the processes that are killed.
PROCESSES = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload(["offairl_lite.runs"])


@pytest.fixture
def plain(tiny):
    """SAC on the true reward: the fastest run there is."""
    return replace(tiny, reward="environment")


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "runs" / "one"


def run(folder, config, *, seeds=SEEDS, checkpoint_every=60, **given):
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
    """A run that was stopped after step 150, with a checkpoint at step 130 or so."""
    runs.create(folder, plain, SEEDS, checkpoint_every=60)
    advance = Trainer.advance

    def stop(self):
        if self.steps == 150 and self.trained == 100:
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


HOP = {"env_id": HOPPER, "update_every": 50, "replay_size": 150}
KILLED = {
    "sac": {"reward": "environment"},
    "td3 and dac": {"reward": "dac", "generator": "td3", "replay_size": 130},
    "airl and a learned temperature": {"reward": "implementation-4", "temperature": None},
    "no absorbing state": {**HOP, "reward": "dac", "generator": "td3"},
    "bootstrapped": {**HOP, "reward": "implementation-1", "absorbing": "bootstrap"},
    "analytic": {**HOP, "reward": "dac", "absorbing": "analytic", "temperature": None},
    "pendulum": {"env_id": "Pendulum-v1", "reward": "environment", "update_every": 50},
}


@pytest.mark.parametrize("case", KILLED)
def test_a_run_that_is_killed_at_random_moments_is_the_same_run(case, tiny, given, tmp_path):
    config = replace(tiny, total_steps=400, **KILLED[case])
    demonstrations, handed = given(config.env_id) if config.learns_reward else (None, None)
    rng = np.random.default_rng(list(KILLED).index(case))

    def make(name):
        folder = tmp_path / name
        runs.create(folder, config, SEEDS, demonstrations=demonstrations, checkpoint_every=60)
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
    config = replace(plain, eval_every=50)
    whole = run(tmp_path / "whole", config)
    folder = tmp_path / "killed"
    runs.create(folder, config, SEEDS, checkpoint_every=60)
    for times in (1, 2):
        process = start(folder, None, moment, times)
        process.join()
        assert process.exitcode == -signal.SIGKILL
        assert records.read(folder).seeds == SEEDS
    finish(folder, None)
    assert_same(folder, whole)
