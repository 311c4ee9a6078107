"""Records of runs: the files of a run folder, and how they are read and written.

- `config.json`: what the run is (`RunSpec`);
- `curve.csv`: one row for each seed and evaluation;
- `run.json`: its state, the step of its last checkpoint, seeds that diverged, wall time, and what
  produced it: versions, machine, start;
- `frozen_reward.safetensors`, `pretrained_policy.safetensors`, `guide.safetensors`: what the run
  was given of other runs, if anything;
- `policy.safetensors` and `reward.safetensors`: the policies and learned rewards at the end;
- `checkpoint/`: what is needed to go on, and nowhere else (see `folders`).

The seeds of one run may be spread over several run folders, each trained by a process of its own:
`NAME/seeds-0-1-2`, `NAME/seeds-3-4` and so on. `read(NAME)` joins them.
"""

import csv
import hashlib
import io
import json
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any, Self

import torch

from offairl_lite import ablations  # noqa: F401  (registers their settings and actors)
from offairl_lite.config import Config, differences
from offairl_lite.core.loop import Row, Run
from offairl_lite.core.networks import Normaliser
from offairl_lite.core.policies import Policy
from offairl_lite.core.rewards import Reward

FORMAT = 3
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
"""Diagnostics of the last update before an evaluation. New ones are added at the end, so that older
curves can still be read."""

COLUMNS = ("seed", "step", "episodes", "mean_return", "returns", "learned_return", *METRICS)
HEADER = ",".join(COLUMNS) + "\n"


@dataclass(frozen=True)
class RunSpec:
    """What a run is: the contents of `config.json`.

    Args:
        config: the configuration of every seed.
        seeds: of the population, in the order of all files.
        execution: the fields of `Execution`.
        demonstrations: `trajectories` and `digest`; and `dataset` (None for the shipped experts'),
            `subsample` and `experts` if `demonstrations.load` made them. None where no reward is
            learned.
        checkpoint_every: steps and updates, together, between checkpoints.
        experiment: the experiment's name, if it has one.
        scale: the scale of the experiment, if it has one.
        inherited: what the run was given of other runs: `frozen_reward`, `pretrained_policy` and
            `guide`, each with the `files` that it was loaded from, its `digest` and, where it is
            a part of what the files hold, the `members`.
    """

    config: Config
    seeds: tuple[int, ...]
    execution: dict[str, Any]
    demonstrations: dict[str, Any] | None
    checkpoint_every: int
    experiment: str | None = None
    scale: str | None = None
    inherited: dict[str, dict[str, Any]] = field(default_factory=dict)

    def write(self, folder: Path) -> None:
        """Write `config.json`."""
        content = {**vars(self), "config": self.config.flat()}
        write_json(folder / "config.json", {"format": FORMAT, **content})

    @classmethod
    def read(cls, folder: str | PathLike) -> Self:
        """Read `config.json`.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: it is of another format, or damaged.
        """
        path = Path(folder) / "config.json"
        if not path.is_file():
            raise FileNotFoundError(
                f"there is no run in {path.parent.absolute()}: it has no config.json; `offairl run "
                f"NAME --out {folder}` starts one (chapters run in the folder `book`, beside "
                "`records`)"
            )
        content = read_json(path)
        require_format(path, content.pop("format", 1))
        try:
            config = Config.of(**content["config"])
            changed = {"config": config, "seeds": tuple(content["seeds"])}
            return cls(**{**content, **changed})
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path} does not describe a run: {error}") from error


def run_folders(folder: str | PathLike) -> list[Path]:
    """Return a run folder, if it is one, and the run folders below it, in the order of their seeds.

    Raises:
        FileNotFoundError: there are none.
        ValueError: one is of another format, or damaged.
    """
    folder = Path(folder)
    found = [path.parent for path in folder.rglob("config.json") if path.is_file()]
    # A name that begins with a dot is of a run that is being made.
    found = [path for path in found if not any(p[0] == "." for p in path.relative_to(folder).parts)]
    if not found:
        RunSpec.read(folder)  # It says what is missing.
    return sorted(found, key=lambda path: (RunSpec.read(path).seeds, path))


def read(folder: str | PathLike) -> Run:
    """Return a recorded run, finished or not.

    The run may be spread over several run folders. Policies and rewards are None until all of them
    have theirs.

    Raises:
        FileNotFoundError: there is no run; the message names the missing file.
        ValueError: a configuration or curve is not of this version, or there are runs of several
            configurations.
    """
    parts = [(path, _read_one(path)) for path in run_folders(folder)]
    (first, run), *others = parts
    for path, part in others:
        if changed := differences(run.config, part.config):
            raise ValueError(
                f"{folder} holds runs of several configurations: {' and '.join(changed)} differ "
                f"between {first} and {path}; read one of them"
            )
    if not others:
        return run
    runs = [part for _, part in parts]
    seeds = tuple(seed for part in runs for seed in part.seeds)
    if len(set(seeds)) < len(seeds):
        raise ValueError(f"{folder} holds several runs of the same seeds: read one of them")
    rows = [row for part in runs for row in part.rows]
    rows.sort(key=lambda row: (row.step, seeds.index(row.seed)))
    policies, rewards = [part.policy for part in runs], [part.reward for part in runs]
    return Run(
        run.config,
        seeds,
        rows,
        None if None in policies else join(policies),
        None if None in rewards else join(rewards),
        {seed: why for part in runs for seed, why in part.diverged.items()},
    )


def _read_one(folder: Path) -> Run:
    spec, path = RunSpec.read(folder), folder / "curve.csv"
    if not path.is_file():
        raise FileNotFoundError(f"{folder} is no record of a run: it has no curve.csv")
    run = Run(spec.config, spec.seeds, _rows(path))
    if (folder / "run.json").is_file():
        diverged = read_json(folder / "run.json").get("diverged", {})
        run.diverged = {int(seed): why for seed, why in diverged.items()}
    if (folder / "policy.safetensors").is_file():
        run.policy = Policy.load(folder / "policy.safetensors")
    if (folder / "reward.safetensors").is_file():
        run.reward = Reward.load(folder / "reward.safetensors")
    return run


def _rows(path: Path) -> list[Row]:
    """Return the rows of a curve, which its process may be writing at this moment."""
    text = path.read_text("utf-8")
    whole = text[: text.rfind("\n") + 1] or HEADER  # Its first line, too, may be half written.
    reader = csv.DictReader(io.StringIO(whole))
    known = len(COLUMNS) - len(METRICS)
    names = tuple(reader.fieldnames or ())
    if len(names) < known or names != COLUMNS[: len(names)]:
        raise ValueError(f"{path} has columns {reader.fieldnames}; expected {list(COLUMNS)}")
    return [
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


def lines(rows: Iterable[Row]) -> str:
    """Return the lines of a curve's file for some rows."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    for row in rows:
        fixed = {**row._asdict(), "returns": " ".join(map(repr, row.returns)), **row.metrics}
        writer.writerow({name: fixed.get(name, "") for name in COLUMNS})
    return text.getvalue()


def join(parts: Sequence[Policy] | Sequence[Reward]) -> Any:
    """Return one population of several policies, or of several rewards.

    Raises:
        ValueError: they are not of one task and architecture.
    """
    kinds = {replace(part, params=None, normaliser=None) for part in parts}
    if len(kinds) > 1:
        raise ValueError(f"members of one population must be of one kind, not {kinds}")
    pairs = zip(*(part.normaliser for part in parts), strict=True)
    params = torch.cat([part.params for part in parts])
    return replace(parts[0], params=params, normaliser=Normaliser(*map(torch.cat, pairs)))


def seeds_name(seeds: Sequence[int]) -> str:
    """Return the name of a run folder that holds some of a run's seeds.

    The name of many seeds has the first, the last and a digest, since file systems limit names.
    """
    name = "-".join(map(str, seeds))
    if len(name) > 100:
        name = f"{seeds[0]}-to-{seeds[-1]}-{hashlib.sha256(name.encode()).hexdigest()[:8]}"
    return f"seeds-{name}"


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
    """Write a file aside and put it in its place, so that it is always the old one or the new."""
    part = path.with_name(f"{path.name}.part")
    write(part)
    _sync(part)
    os.replace(part, path)
    _sync(path.parent)


def _sync(path: Path) -> None:
    """Force a file, or the names in a folder, to the disk."""
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
