"""Run folders: made, extended, and verified."""

import os
import shutil
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory

from offairl_lite.core.acceleration import Execution
from offairl_lite.core.loop import train
from offairl_lite.core.policies import Policy
from offairl_lite.core.results import Row
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rng import Rng
from offairl_lite.runs import checkpoints, inputs, records
from offairl_lite.runs.provenance import origin
from offairl_lite.runs.records import RunSpec, read_json, run_folders, write_json
from offairl_lite.runs.worker import FINISHED


def create(folder: Path, spec: RunSpec, given: Mapping[str, Policy | Reward]) -> None:
    """Make the folder of a new run, whole or not at all. `worker.work` then trains.

    Args:
        folder: a new or empty one, also one below a run folder; FileExistsError says that it holds
            something.
        spec: what the run is.
        given: what it has of other runs, as `inputs.load` returns it.
    """
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise FileExistsError(
            f"{folder} is not empty: `offairl resume {folder}` goes on with a run that is there; "
            "for a new one choose another --out, or remove it"
        )
    folder = folder.resolve()
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as hidden:
        made = Path(hidden) / "run"
        (made / "checkpoint").mkdir(parents=True)
        (made / "curve.csv").write_text(records.HEADER)
        begun = {"state": "waiting", "step": 0, "wall_s": 0.0, "diverged": {}}
        write_json(made / "run.json", {**begun, **origin(Execution(**spec.execution))})
        for name, thing in given.items():
            thing.save(made / f"{name}.safetensors")
        spec.write(made)
        if folder != Path.cwd() and not folder.is_mount():
            os.replace(made, folder)
        else:
            # These cannot be replaced. A folder is a run once it has its configuration.
            for path in sorted(made.iterdir(), key=lambda path: path.name == "config.json"):
                shutil.move(path, folder)


def extend(folder: Path, steps: int | None = None, seeds: Sequence[int] = ()) -> None:
    """Set a run another number of steps, or add seeds to it. `worker.work` then trains what is new.

    More steps are for all run folders of the run. New seeds get a run folder of their own, inside
    `folder`, where `read` finds it; nothing is moved. ValueError says that the run has gone further
    already, that a seed is there already, or that the run builds upon members of another; OSError
    that a process is at work on the run, or that the disk has no room.
    """
    before = {path: RunSpec.read(path) for path in run_folders(folder)}
    changes = {} if steps is None else {"total_steps": steps}
    specs = {p: replace(spec, config=spec.config.change(**changes)) for p, spec in before.items()}
    with ExitStack() as locks:
        for path, spec in specs.items():
            checkpoints.load(path, spec)  # It refuses what is damaged, or has gone further.
            locks.enter_context(checkpoints.lock(path))
        new = []
        if seeds:
            _require_new(folder, specs, seeds)
            new = [replace(next(iter(specs.values())), seeds=tuple(seeds))]
        replays = [path / checkpoints.REPLAY for path in specs]
        there = sum(replay.stat().st_size for replay in replays if replay.is_file())
        space = sum(map(checkpoints.disk_space, [*specs.values(), *new]))
        checkpoints.require_room(folder, space - there)
        for spec in new:
            create(folder / records.seeds_name(seeds), spec, {})
        for path, spec in specs.items():
            about = read_json(path / "run.json")
            if about["state"] == FINISHED and spec != before[path]:
                write_json(path / "run.json", about | {"state": "waiting"})
                for kind in (Policy, Reward):
                    (path / records.file_name(kind)).unlink(missing_ok=True)
            spec.write(path)


def _require_new(folder: Path, specs: Mapping[Path, RunSpec], seeds: Sequence[int]) -> None:
    """Raise ValueError unless a run can have further members of these seeds."""
    there = records.read(folder).seeds  # It refuses several configurations.
    if names := inputs.needed(next(iter(specs.values())).config):
        raise ValueError(
            f"{folder} has of another run the {' and the '.join(names).replace('_', ' ')}, of "
            f"{len(there)} members and none for further seeds: start a run of its own"
        )
    Rng(seeds)  # It refuses what cannot be a seed.
    if len({*there, *seeds}) < len(there) + len(seeds):
        raise ValueError(f"seeds {list(seeds)} are not all new: there are {list(there)}")


def verify(
    folder: str | PathLike, evaluations: int = 1, progress: bool = True
) -> dict[tuple[int, int], tuple[Row | None, Row | None]]:
    """Train the beginning of a recorded run again, in memory, and set it beside the record.

    Args:
        folder: of the record. Its checkpoints are not needed. Of several run folders the first is
            verified.
        evaluations: how many evaluations to do again, from the first one on.
        progress: whether to show a bar.

    Returns:
        By seed and step the recorded row, and the row as it comes out now. None stands for a member
        that had diverged, there or here.
    """
    folder = run_folders(folder)[0]
    spec = RunSpec.read(folder)
    rows = [row for row in records.read(folder).rows if row.seed in spec.seeds]
    steps = sorted({row.step for row in rows})
    if not 1 <= evaluations <= len(steps):
        raise ValueError(f"evaluations is {evaluations}; {folder} has {len(steps)} to do again")
    last = steps[evaluations - 1]
    here: dict[tuple[int, int], Row] = {}

    def keep(again: list[Row]) -> None:
        here.update({(row.seed, row.step): row for row in again})
        if again[0].step >= last:
            raise StopIteration

    with suppress(FloatingPointError):  # Every member diverges.
        train(
            spec.config,
            spec.seeds,
            inputs.demonstrations_of(folder, spec),
            **inputs.recorded(folder, spec),
            execution=Execution(**spec.execution),
            progress=progress,
            on_evaluation=keep,
        )
    there = {(row.seed, row.step): row for row in rows if row.step <= last}
    return {key: (there.get(key), here.get(key)) for key in there | here}
