"""Behavioural cloning in every cell of the benchmark.

Ten seeds are cloned in each cell, one to five minutes of a core. What is
done is kept in a temporary folder, so that an interrupted recording goes on
where it was, unless cloning has changed. With BENCHMARK_MINUTES=10 no cell
is begun after ten minutes, and those that are not there are left out.
"""

import hashlib
import inspect
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import torch

from benchmark_runs import BETWEEN, PLAN, env_id_of
from offairl_lite import cloning, demonstrations
from offairl_lite.core.rollouts import rollout
from offairl_lite.runs.records import read_json, write_json

SEEDS = tuple(range(10))
EPISODES = 10
FIRST = ("4/Hopper", "4/HalfCheetah")
"""Cells that are recorded before the others."""
SMALL = (64, 64)
"""The layers of all other methods; clones have larger ones."""


def settings() -> dict[str, Any]:
    """Return cloning's defaults, with which all cells are made."""
    arguments = inspect.signature(cloning.clone).parameters
    names = ("hidden", "steps", "patience", "batch_size", "learning_rate")
    return {name: arguments[name].default for name in names}


def _cache() -> Path:
    """Return the folder of the cells that this version of cloning made."""
    source = inspect.getsource(cloning).encode()
    version = hashlib.sha256(source).hexdigest()[:8]
    return Path(tempfile.gettempdir()) / f"offairl-benchmark-{version}"


def shown(block: str, robot: str) -> demonstrations.Demonstrations:
    """Return the demonstrations of a cell, by the strongest expert."""
    count, _, kind = block.partition("-")
    return demonstrations.load(
        env_id_of(robot),
        int(count),
        subsample=20 if kind == "thinned" else 1,
        experts="best",
    )


def cell(block: str, robot: str) -> dict[str, Any]:
    """Clone ten seeds, and return what each returns without noise."""
    small = block.endswith("-small")
    hidden = SMALL if small else settings()["hidden"]
    given, start = shown(block, robot), time.process_time()
    policy = cloning.clone(given, SEEDS, hidden=hidden, progress=False)
    seconds = time.process_time() - start
    played = rollout(policy, given.env_id, SEEDS, EPISODES)
    return {
        "returns": played.returns.mean(1).tolist(),
        "demonstrations": float(given.returns.mean()),
        "seconds": seconds,
    }


def record() -> dict[str, Any]:
    """Return the cells of each number of demonstrations, by robot."""
    torch.set_num_threads(1)
    minutes = float(os.environ.get("BENCHMARK_MINUTES", "inf"))
    until, folder = time.monotonic() + 60 * minutes, _cache()
    folder.mkdir(exist_ok=True)
    places = [
        f"{block}/{robot}"
        for block, methods in PLAN.items()
        for robot in methods.get("clone", ())
    ]
    places += [
        f"{block}/{robot}"
        for block in ("1-small", "4-small", *BETWEEN)
        for robot in PLAN["4"]["clone"]
    ]
    found: dict[str, Any] = {"settings": settings()}
    found |= {place.split("/")[0]: {} for place in places}
    for place in sorted(places, key=lambda place: place not in FIRST):
        block, robot = place.split("/")
        path = folder / f"{block}-{robot}.json"
        if not path.is_file():
            if time.monotonic() > until:
                continue
            write_json(path, cell(block, robot))
            print(f"{place}: done", flush=True)
        found[block][robot] = read_json(path)
    return found
