"""Records of runs: the files of a run folder, and how they are read and written.

- `config.json`: what the run is (`RunSpec`);
- `curve.csv`: one row for each seed and evaluation, and `curve.png`, a picture of it;
- `run.json`: its state, the step of its last checkpoint, seeds that diverged, and its `origin`;
- `frozen_reward.safetensors`, `pretrained_policy.safetensors`, `guide.safetensors`: of other runs;
- `policy.safetensors` and `reward.safetensors`: the policies and learned rewards at the last end;
- `evaluations/`: the same of each evaluation, `policy-10000.safetensors`;
- `demonstrations.safetensors`: a copy, where they were given as arrays;
- `checkpoint/`: what is needed to go on, and nowhere else (see `checkpoints`).

The seeds of one run may be spread over several run folders, `NAME/seeds-0-1-2`, `NAME/seeds-3-4`
and so on, each trained by a process of its own. `read(NAME)` joins them.
"""

import csv
import hashlib
import io
import json
import os
import platform
import subprocess
import zlib
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from importlib.metadata import version
from os import PathLike
from pathlib import Path
from typing import Any, get_type_hints

import torch

from offairl_lite import ablations  # noqa: F401  (registers their settings and actors)
from offairl_lite.config import Config, differences
from offairl_lite.config.settings import Natural, checked
from offairl_lite.core.acceleration import Execution
from offairl_lite.core.networks import Normaliser
from offairl_lite.core.policies import Policy
from offairl_lite.core.results import Row, Run
from offairl_lite.core.rewards import Reward

FORMAT = 3  #: Of run folders; it changes when older ones can no longer be read.
METRICS = (
    *("cross_entropy", "penalty", "expert_logit", "policy_logit", "accuracy", "critic_loss", "q"),
    *("temperature", "entropy", "excess", "multiplier"),
)
"""Diagnostics of the update before an evaluation; new ones come last, for older curves' sake."""
COLUMNS = ("seed", "step", "episodes", "mean_return", "returns", "learned_return", *METRICS)
HEADER = ",".join(COLUMNS) + "\n"
FINISHED, DIVERGED = "finished", "stopped: every member has diverged"
PICTURE = "curve.png"
PACKAGES = ("offairl-lite", "torch", "numpy", "mujoco", "gymnasium", "minari")


@dataclass(frozen=True)
class RunSpec:
    """What a run is: the contents of `config.json`.

    `seeds` are in the order of all files; `execution` has the fields of `Execution`;
    `demonstrations` is what `inputs.describe` says; `checkpoint_every` counts steps and updates
    together. `inherited` has, by the names in `inputs.CURES`, the `files` of what comes from other
    runs, its `digest` and, if it is a part of theirs, the `members`.
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
    def read(cls, folder: str | PathLike) -> "RunSpec":
        """Read `config.json`; ValueError if it is of another format, or damaged."""
        path = Path(folder) / "config.json"
        if path.parent.is_file():
            raise ValueError(
                f"{folder} is a file, and not the folder of a run. If it is a policy's, `offairl "
                "watch` and `offairl export` take it, pretrained_policy begins with it, and "
                "`core.rollouts.action(Policy.load(FILE), obs, env.action_space)` acts"
            )
        if not path.is_file():
            raise FileNotFoundError(
                f"there is no run in {path.parent.absolute()}: it has no config.json; `offairl run "
                f"NAME --out {folder}` starts one (chapters run in the folder `book`, beside "
                "`records`)"
            )
        content = read_json(path)
        require_format(path, content.pop("format", 1))
        try:
            _require_types(content, config=dict, execution=dict, checkpoint_every=int)
            _require_types({"inherited": {}, **content}, inherited=dict, demonstrations=dict | None)
            seeds = checked("seeds", content.pop("seeds"), tuple[Natural, ...])
            for name, value in content["execution"].items():
                checked(name, value, get_type_hints(Execution)[name])
            return cls(Config.of(**content.pop("config")), seeds, **content)
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path} does not describe a run: {error}") from error


def run_folders(folder: str | PathLike) -> list[Path]:
    """Return a run folder, if it is one, and those below it, in the order of their seeds."""
    if not (folders := folders_in(Path(folder))):
        RunSpec.read(folder)  # It says what is missing.
    return folders


def folders_in(folder: Path) -> list[Path]:
    """Return what `run_folders` does; nothing if there is none."""
    # A name that begins with a dot is of a run that is being made, or of one that was not.
    seeds = {
        path.parent: RunSpec.read(path.parent).seeds
        for path in folder.rglob("config.json")
        if not any(part.startswith(".") for part in path.relative_to(folder).parts)
    }
    return sorted(seeds, key=lambda path: (seeds[path], path))


def read(folder: str | PathLike, step: int | None = None) -> Run:
    """Return a recorded run, finished or not, with the policies and rewards of its end.

    They are None until all run folders have theirs, of one length.

    Args:
        folder: of the run, or the folder of its run folders.
        step: of the evaluation as which the run is returned; by default its end.

    Raises:
        FileNotFoundError: something is missing.
        ValueError: it is of another version, or of several configurations, or has no such step.
    """
    specs = {path: RunSpec.read(path) for path in run_folders(folder)}
    first, spec = next(iter(specs.items()))
    for path, other in specs.items():
        if changed := differences(spec.config, other.config):
            raise ValueError(
                f"{folder} holds runs of several configurations: {' and '.join(changed)} differ "
                f"between {first} and {path}; read one of them"
            )
    seeds = [seed for one in specs.values() for seed in one.seeds]
    if len(set(seeds)) < len(seeds):
        raise ValueError(f"{folder} holds several runs of the same seeds: read one of them")
    diverged: dict[int, str] = {}
    rows: list[Row] = []
    ends = set[bool]()
    for path in specs:
        status = read_state(path) if (path / "run.json").is_file() else {"diverged": {}}
        ends.add(status.get("state", FINISHED) in (FINISHED, DIVERGED))
        diverged |= {int(seed): why for seed, why in status["diverged"].items()}
        rows += _rows(path / "curve.csv", status.get("curve.csv"))
    rows.sort(key=lambda row: (row.step, seeds.index(row.seed)))
    results = _results(Policy, specs), _results(Reward, specs)
    if step is not None:
        if step not in (steps := sorted({row.step for row in rows})):
            raise ValueError(f"{folder} has no evaluation at step {step}; there are: {steps}")
        rows = [row for row in rows if row.step <= step]
        results = _results(Policy, specs, step), results[1]
        if any((path / file_name(Reward, step)).is_file() for path in specs):
            results = results[0], _results(Reward, specs, step)
        if results[0] is None:
            missing = [path / file_name(Policy, step) for path in specs]
            raise FileNotFoundError(f"{' and '.join(map(str, missing))}: not there, or not all")
    elif len(ends) > 1:  # Some folders of an extended run have what they had before.
        results = None, None
    config = spec.config.change(env_id=spec.config.env_id.rpartition(":")[2])  # see `Population`
    name = Path(folder).absolute().name
    return Run(config, tuple(seeds), rows, *results, diverged, name)


def _results(kind: Any, folders: Iterable[Path], step: int | None = None) -> Any:
    """Return the policies, or the rewards, of all run folders; None until each has its own."""
    files = [folder / file_name(kind, step) for folder in folders]
    return join([kind.load(file) for file in files]) if all(map(Path.is_file, files)) else None


def _rows(path: Path, checksum: int | None) -> list[Row]:
    """Return the rows of a curve, which its process may be writing at this moment."""
    if not path.is_file():
        raise FileNotFoundError(f"{path.parent} is no record of a run: it has no curve.csv")
    require_checksum(path, checksum)
    try:
        text = path.read_text("utf-8")
        whole = text[: text.rfind("\n") + 1] or HEADER  # Its first line, too, may be half written.
        reader = csv.DictReader(io.StringIO(whole))
        names, known = tuple(reader.fieldnames or ()), len(COLUMNS) - len(METRICS)
        if len(names) < known or names != COLUMNS[: len(names)]:
            raise ValueError(f"it has columns {reader.fieldnames}; expected {list(COLUMNS)}")
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
    except (ValueError, TypeError, AttributeError, csv.Error) as error:
        raise damaged(path.parent, path, error) from error


def lines(rows: Iterable[Row]) -> str:
    """Return the lines of a curve's file for some rows."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, restval="", extrasaction="ignore", lineterminator="\n")
    for row in rows:
        returns = " ".join(map(repr, row.returns))
        writer.writerow({**row._asdict(), "returns": returns, **row.metrics})
    return text.getvalue()


def join(parts: Sequence[Any]) -> Any:
    """Return one population of several policies, or of several rewards, if all are of one kind."""
    weights = "params", "normaliser"
    kinds = {tuple(x for name, x in vars(p).items() if name not in weights) for p in parts}
    if len(kinds) > 1:
        raise ValueError(f"members of one population must be of one kind, not {kinds}")
    pairs = zip(*(part.normaliser for part in parts), strict=True)
    params = torch.cat([part.params for part in parts])
    return replace(parts[0], params=params, normaliser=Normaliser(*map(torch.cat, pairs)))


def file_name(kind: Any, step: int | None = None) -> str:
    """Return where a run folder has its policies, or its rewards, at its end or at a step."""
    name = kind.__name__.lower()
    return f"{name}.safetensors" if step is None else f"evaluations/{name}-{step}.safetensors"


def seeds_name(seeds: Sequence[int]) -> str:
    """Return the name of a run folder with some of a run's seeds; file systems limit its length."""
    name = "-".join(map(str, seeds))
    if len(name) > 100:
        name = f"{seeds[0]}-to-{seeds[-1]}-{hashlib.sha256(name.encode()).hexdigest()[:8]}"
    return f"seeds-{name}"


def again(folder: Path, spec: RunSpec, command: str = "resume") -> str:
    """Return what to type to go on with a run; it names a task that is in a module."""
    task = spec.config.env_id
    return f"`offairl {command} {folder}{f' --env-id {task}' * (':' in task)}`"


def read_state(folder: Path) -> dict[str, Any]:
    """Read `run.json`; ValueError if it is gone or damaged."""
    status = {"diverged": {}, **read_json(folder / "run.json")}
    try:
        _require_types(status, state=str, step=int, diverged=dict)
    except TypeError as error:
        raise damaged(folder, folder / "run.json", error) from error
    return status


def _require_types(fields: dict[str, Any], **types: Any) -> None:
    """Raise TypeError unless there are fields of these types."""
    for name, wanted in types.items():
        if not isinstance(fields.get(name), wanted):
            value, wanted = fields.get(name, "missing"), getattr(wanted, "__name__", wanted)
            raise TypeError(f"{name} is {value!r}; expected {wanted}")


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON file; ValueError if it is damaged, or not as `write_json` left it."""
    try:
        content = json.loads(path.read_bytes())
        _require_types({"content": content}, content=dict)
        if content.pop("checksum", None) not in (None, _checksum_of(content)):
            why = "its checksum is not that of its contents"
            raise ValueError(f"{why} (take it out where they were changed on purpose)")
    except FileNotFoundError:
        raise damaged(path.parent, path, "it is gone") from None
    except (ValueError, TypeError, RecursionError) as error:
        raise damaged(path.parent, path, error) from error
    return content


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write a JSON file, whole or not at all, with the checksum of what it says."""
    content = content | {"checksum": _checksum_of(content)}
    text = json.dumps(content, indent=2, ensure_ascii=False) + "\n"
    write_whole(path, lambda part: part.write_text(text, "utf-8"))


def _checksum_of(content: dict[str, Any]) -> int:
    return zlib.crc32(json.dumps(content).encode())


def require_checksum(path: Path, expected: int | None, size: int | None = None) -> None:
    """Raise ValueError if a file, or its beginning, has another CRC-32; older runs have none."""
    if expected not in (None, zlib.crc32(path.read_bytes()[:size])):
        raise damaged(path.parent, path, "its contents are not those that were written")


def damaged(folder: Path, path: Path, why: object) -> ValueError:
    """Return an error that says which file of a run folder is damaged, and what to do."""
    return ValueError(f"{path} is damaged: {why}; bring all of {folder} back, or start a new run")


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


def beginning(folder: Path) -> Path:
    """Return what there is of a folder's path; NotADirectoryError if it is a file."""
    existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not existing.is_dir():
        raise NotADirectoryError(f"{existing} is no folder: choose another")
    return existing


def require_format(path: Path, format: int, readable: int = FORMAT) -> None:
    """Raise ValueError unless a file is of this version's format."""
    if format != readable:
        raise ValueError(
            f"{path} has format {format}, and this version of the package reads format {readable}: "
            "use the version that wrote it (run.json names it), or start a new run"
        )


def origin(execution: Execution) -> dict[str, Any]:
    """Return what produces a run, and when it was begun."""
    return {
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {name: version(name) for name in PACKAGES},
        "machine": platform.machine(),
        "processor": processor(),
        "vectors": torch.backends.cpu.get_cpu_capability(),
        "cores": os.cpu_count(),
        "threads": execution.threads,
        "commit": _commit(),
    }


def changed(then: dict[str, Any], now: dict[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Return what two origins have otherwise of all that may change a number: before and after."""
    keys = ("versions", "processor", "vectors", "commit")
    return {key: (then.get(key), now[key]) for key in keys if then.get(key) != now[key]}


def processor() -> str:
    """Return the processor's name, which only Linux keeps in a file."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _commit() -> str | None:
    """Return the commit of the package, if it runs from a checkout."""
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return None
    command = ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    with suppress(OSError):
        done = subprocess.run(command, cwd=root, capture_output=True, text=True)
        return done.stdout.strip() or None
    return None
