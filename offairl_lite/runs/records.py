"""Records of runs: the files of a run's folder, and how they are read and written.

- `config.json`: what the run is: every field of `Config`, seeds, execution, demonstrations, and
  what it has of other runs;
- `curve.csv`: one row for each seed and evaluation;
- `run.json`: what produced it: versions, machine, start, wall time, state;
- `frozen.safetensors`, `carried.safetensors`, `guide.safetensors`: the reward and the policies of
  other runs that were given, if any were;
- `policy.safetensors`: the policies at the end;
- `reward.safetensors`: the learned rewards at the end, if any;
- `members/`: what it takes to go on (see `runs`).
"""

import csv
import io
import json
import os
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any, Self

from offairl_lite.config import Config
from offairl_lite.core.loop import Row, Run
from offairl_lite.core.policies import Policy
from offairl_lite.core.rewards import Reward

FORMAT = 2
"""Of run folders and checkpoints; it changes when older ones can no longer be read."""

METRICS = (
    "cross_entropy",
    "penalty",
    "expert_logit",
    "policy_logit",
    "accuracy",
    "critic_loss",
    "q",
    "temperature",
    "entropy",
    "excess",
    "multiplier",
)
"""Diagnostics of the last update before an evaluation. New ones are added at the end, so that
curves of before can be read."""

COLUMNS = ("seed", "step", "episodes", "mean_return", "returns", "learned_return", *METRICS)
HEADER = ",".join(COLUMNS) + "\n"


@dataclass(frozen=True)
class Plan:
    """What a run is: the contents of `config.json`.

    Args:
        config: of every member.
        shards: the seeds, in the order of all files, in groups that are trained together.
        execution: the fields of `Execution`.
        demonstrations: `trajectories` and `digest`; `dataset` (None: the shipped experts'),
            `subsample` and `experts` if `demonstrations.load` made them. None where no reward is
            learned.
        checkpoint_every: steps and updates, together, between checkpoints.
        experiment: the name under which it was run, if any.
        scale: the scale at which it was run, if any.
        inherited: what it has of other runs: `frozen`, `carried` and `guide`, each with the `files`
            that it was loaded from and its `digest`.
    """

    config: Config
    shards: tuple[tuple[int, ...], ...]
    execution: dict[str, Any]
    demonstrations: dict[str, Any] | None
    checkpoint_every: int
    experiment: str | None = None
    scale: str | None = None
    inherited: dict[str, dict[str, Any]] = field(default_factory=dict)

    @property
    def seeds(self) -> tuple[int, ...]:
        """Of all members."""
        return tuple(seed for shard in self.shards for seed in shard)

    def write(self, folder: Path) -> None:
        """Write `config.json`."""
        write_json(folder / "config.json", {"format": FORMAT, **asdict(self)})

    @classmethod
    def read(cls, folder: str | PathLike) -> Self:
        """Read `config.json`.

        Raises:
            FileNotFoundError: there is none.
            ValueError: it is of another format, or damaged.
        """
        path = Path(folder) / "config.json"
        if not path.is_file():
            raise FileNotFoundError(
                f"there is no run in {path.parent.absolute()}: it has no config.json; `offairl run "
                f"NAME --out {folder}` starts one (chapters run in the folder `book`, beside "
                "`records`)"
            )
        fields = read_json(path)
        require_format(path, fields.pop("format", 1))
        try:
            given = {k: tuple(v) if isinstance(v, list) else v for k, v in fields["config"].items()}
            shards = tuple(tuple(shard) for shard in fields["shards"])
            return cls(**{**fields, "config": Config(**given), "shards": shards})
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path} does not describe a run: {error}") from error


def read(folder: str | PathLike) -> Run:
    """Return a recorded run, finished or not; policy and reward are None where there are none yet.

    Raises:
        FileNotFoundError: the folder is no record; the message names the missing file.
        ValueError: the record's configuration or curve is not of this version.
    """
    folder = Path(folder)
    plan, path = Plan.read(folder), folder / "curve.csv"
    if not path.is_file():
        raise FileNotFoundError(f"{folder} is no record of a run: it has no curve.csv")
    with open(path, newline="") as file:
        reader = csv.DictReader(file)
        known = len(COLUMNS) - len(METRICS)
        names = tuple(reader.fieldnames or ())
        if len(names) < known or names != COLUMNS[: len(names)]:
            raise ValueError(f"{path} has columns {reader.fieldnames}; expected {list(COLUMNS)}")
        rows = [
            Row(
                int(line["seed"]),
                int(line["step"]),
                int(line["episodes"]),
                float(line["mean_return"]),
                tuple(map(float, line["returns"].split())),
                float(line["learned_return"]),
                {name: float(line[name]) for name in METRICS if line.get(name)},
            )
            for line in reader
        ]
    run = Run(plan.config, plan.seeds, rows)
    if (folder / "run.json").is_file():
        shards = read_json(folder / "run.json").get("shards", {}).values()
        run.diverged = {int(seed): why for s in shards for seed, why in s["diverged"].items()}
    if (folder / "policy.safetensors").is_file():
        run.policy = Policy.load(folder / "policy.safetensors")
    if (folder / "reward.safetensors").is_file():
        run.reward = Reward.load(folder / "reward.safetensors")
    return run


def lines(rows: Iterable[Row]) -> str:
    """Return the lines of a curve's file for some rows."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    for row in rows:
        fixed = {**row._asdict(), "returns": " ".join(map(repr, row.returns)), **row.metrics}
        writer.writerow({name: fixed.get(name, "") for name in COLUMNS})
    return text.getvalue()


def merged(curves: Iterable[str], seeds: tuple[int, ...]) -> str:
    """Return one curve of several: by step, then in the order of `seeds`."""
    # A line is complete with its end: its process may be writing it, or have been killed.
    parts = [line for curve in curves for line in curve.splitlines(True)[1:] if line[-1] == "\n"]
    place = {str(seed): i for i, seed in enumerate(seeds)}

    def order(line: str) -> tuple[int, int]:
        seed, step, _ = line.split(",", 2)
        return int(step), place[seed]

    return HEADER + "".join(sorted(parts, key=order))


def read_json(path: Path) -> dict:
    """Read a JSON file.

    Raises:
        ValueError: it is damaged.
    """
    try:
        return json.loads(path.read_bytes())
    except ValueError as error:
        raise ValueError(f"{path} is damaged: {error}") from error


def write_json(path: Path, content: dict) -> None:
    """Write a JSON file, whole or not at all."""
    text = json.dumps(content, indent=2, ensure_ascii=False) + "\n"
    write_whole(path, lambda part: part.write_text(text, "utf-8"))


def write_whole(path: Path, write: Callable[[Path], Any]) -> None:
    """Have a file written aside and put in its place: it is always the old one or the new."""
    part = path.with_name(f"{path.name}.part")
    write(part)
    _sync(part)
    os.replace(part, path)
    _sync(path.parent)


def _sync(path: Path) -> None:
    """Have a file, or the names in a folder, reach the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def require_format(path: Path, found: int) -> None:
    """Raise ValueError unless a file is of this version's format."""
    if found != FORMAT:
        raise ValueError(
            f"{path} has format {found}, and this version of the package reads format {FORMAT}: "
            "use the version that wrote it (run.json names it), or start a new run"
        )
