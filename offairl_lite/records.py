"""Runs on disk: one folder a run, with its configuration, its curve and what produced it.

config.json         every field of `Config`, and the seeds
curve.csv           one row for each seed and evaluation
run.json            versions, machine, start, wall time, state
policy.safetensors  the policies at the end
reward.safetensors  the learned rewards at the end, if any
"""

import csv
import json
import os
import platform
import time
from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Self

import torch

from offairl_lite.config import Config
from offairl_lite.discriminators import Reward
from offairl_lite.imitate import Row, Run
from offairl_lite.policies import Policy

METRICS = (
    "cross_entropy",
    "penalty",
    "expert_logit",
    "policy_logit",
    "accuracy",
    "critic_loss",
    "q",
    "temperature",
)
COLUMNS = ("seed", "step", "episodes", "mean_return", "returns", "learned_return", *METRICS)
PACKAGES = ("offairl-lite", "torch", "numpy", "mujoco", "gymnasium", "minari")


class Recorder:
    """Writes a run to a folder as it goes, so that a run cut short leaves its curve behind.

    Used as a context manager, it also notes what stopped a run that did not finish.

    Args:
        folder: a new or empty folder.
        config: of the run.
        seeds: of the run.

    Raises:
        FileExistsError: the folder holds something already; nothing is overwritten.
    """

    def __init__(self, folder: Path, config: Config, seeds: Sequence[int]) -> None:
        if folder.exists() and any(folder.iterdir()):
            raise FileExistsError(f"{folder} is not empty: choose another --out, or remove it")
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self._start = folder, time.monotonic()
        _write_json(folder / "config.json", {"seeds": list(seeds), **asdict(config)})
        with open(folder / "curve.csv", "w", newline="") as file:
            csv.writer(file).writerow(COLUMNS)
        self._about = {
            "state": "running",
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
            "versions": {name: version(name) for name in PACKAGES},
            "machine": platform.machine(),
            "cores": os.cpu_count(),
            "threads": torch.get_num_threads(),
        }
        self._state("running")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        if kind is not None:
            self._state(f"stopped: {kind.__name__}: {error}")

    def add(self, rows: Sequence[Row]) -> None:
        """Append the rows of one evaluation."""
        with open(self.folder / "curve.csv", "a", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS)
            for row in rows:
                returns = " ".join(map(repr, row.returns))
                fixed = {**row._asdict(), "returns": returns, **row.metrics}
                writer.writerow({name: fixed.get(name, "") for name in COLUMNS})

    def finish(self, run: Run) -> None:
        """Write what came of the run and mark it finished."""
        run.policy.save(self.folder / "policy.safetensors", seeds=list(run.seeds))
        if run.reward is not None:
            run.reward.save(self.folder / "reward.safetensors")
        self._state("finished")

    def _state(self, state: str) -> None:
        wall = round(time.monotonic() - self._start, 1)
        _write_json(self.folder / "run.json", {**self._about, "state": state, "wall_s": wall})


def read(folder: Path) -> Run:
    """Return a recorded run; policy and reward are None where they were not kept.

    Raises:
        FileNotFoundError: the folder is no record; the message names the missing file.
        ValueError: the record's configuration or curve is not of this version.
    """
    for name in ("config.json", "curve.csv"):
        if not (folder / name).is_file():
            raise FileNotFoundError(f"{folder} is no record of a run: it has no {name}")
    fields = json.loads((folder / "config.json").read_text())
    seeds = tuple(fields.pop("seeds"))
    try:
        config = Config(**{k: tuple(v) if isinstance(v, list) else v for k, v in fields.items()})
    except TypeError as error:
        raise ValueError(f"{folder}/config.json is of another version: {error}") from error
    with open(folder / "curve.csv", newline="") as file:
        reader = csv.DictReader(file)
        if tuple(reader.fieldnames or ()) != COLUMNS:
            raise ValueError(
                f"{folder}/curve.csv has columns {reader.fieldnames}; expected {list(COLUMNS)}"
            )
        rows = [
            Row(
                int(line["seed"]),
                int(line["step"]),
                int(line["episodes"]),
                float(line["mean_return"]),
                tuple(map(float, line["returns"].split())),
                float(line["learned_return"]),
                {name: float(line[name]) for name in METRICS if line[name]},
            )
            for line in reader
        ]
    run = Run(config, seeds, rows)
    if (folder / "policy.safetensors").is_file():
        run.policy = Policy.load(folder / "policy.safetensors")
    if (folder / "reward.safetensors").is_file():
        run.reward = Reward.load(folder / "reward.safetensors")
    return run


def _write_json(path: Path, content: dict) -> None:
    """Write a file whole or not at all."""
    part = path.with_suffix(".part")
    part.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n")
    part.replace(path)
