"""Run folders: made, trained to their ends by one process at a time, extended, and verified."""

import errno
import logging
import os
import shutil
import signal
import sys
import threading
import time
import zlib
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from glob import escape
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import torch

from offairl_lite import envs
from offairl_lite.config.settings import Count, Natural, checked
from offairl_lite.core.acceleration import Execution
from offairl_lite.core.loop import Stop, Trainer, complete, train
from offairl_lite.core.networks import save_weights
from offairl_lite.core.policies import Policy
from offairl_lite.core.results import Row
from offairl_lite.core.rewards import Reward
from offairl_lite.demonstrations import Demonstrations
from offairl_lite.runs import checkpoints, inputs, jobs, messages, records
from offairl_lite.runs.records import RunSpec, again, origin, read_state, run_folders, write_json

log = logging.getLogger(__name__)


def create(
    folder: Path,
    spec: RunSpec,
    inherited: Mapping[str, Policy | Reward],
    demos: Demonstrations | None = None,
) -> None:
    """Make the folder of a new run, whole or not at all. `work` then trains.

    Args:
        folder: new or empty; it may be one below a run folder.
        spec: what the run is.
        inherited: what it has of other runs, as `inputs.load` returns it.
        demos: demonstrations of which it keeps a copy.

    Raises:
        FileExistsError: the folder is not empty.
    """
    existing = records.beginning(folder)
    taken = FileExistsError(
        f"{folder} is not empty: `offairl resume {folder}` goes on with a run, if one is there; "
        "for a new one choose another folder, or remove this one"
    )
    if existing == folder and any(folder.iterdir()):
        raise taken
    existing, folder = existing.resolve(), folder.resolve()
    folder.parent.mkdir(parents=True, exist_ok=True)
    for path in folder.parent.glob(f".{escape(folder.name)}.*"):
        with suppress(FileNotFoundError):  # Who is not killed removes it, within a moment.
            if time.time() - path.stat().st_mtime > 10:
                shutil.rmtree(path)
    with TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as hidden:
        made = Path(hidden) / "run"
        (made / "checkpoint").mkdir(parents=True)
        (made / "curve.csv").write_text(records.HEADER)
        begun = {"state": "waiting", "step": 0, "wall_s": 0.0, "diverged": {}}
        write_json(made / "run.json", {**begun, **origin(Execution(**spec.execution))})
        for name, network in inherited.items():
            network.save(made / f"{name}.safetensors")
        if demos is not None:
            of = {"lengths": torch.tensor(demos.lengths), "returns": torch.tensor(demos.returns)}
            tensors, about = {**demos.transitions._asdict(), **of}, {"kind": "demonstrations"}
            save_weights(made / inputs.COPY, tensors, about)
        spec.write(made)
        try:
            if existing != folder:
                os.replace(made, folder)
                return
            # It may be a mount. A folder is a run once it has its configuration.
            for path in sorted(made.iterdir(), key=lambda path: (path.name == "config.json", path)):
                shutil.move(path, folder)
        except OSError as error:
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST, None):
                raise
            raise taken from None  # Another command has made it just now.


def work(
    folder: str | PathLike, *, demonstrations: Demonstrations | None = None, progress: bool = True
) -> None:
    """Train a run folder from where it is to its end. A run that has ended is left as it is.

    Members that diverge are given up: run.json says why, and the others go on.

    Args:
        folder: of the run.
        demonstrations: those that it began with; by default they are loaded.
        progress: whether a bar is shown.

    Raises:
        ValueError: the run is not what it began as, or a file is damaged.
        OSError: another process is at work on it, or the disk is full.
    """
    folder = Path(folder)
    spec = known(folder)
    if is_finished(folder):
        return
    demonstrations = inputs.demonstrations_of(folder, spec, demonstrations)
    inherited, checkpoint = inputs.recorded(folder, spec), checkpoints.load(folder, spec)
    with checkpoints.lock(folder):
        if checkpoint is None:
            (folder / checkpoints.REPLAY).unlink(missing_ok=True)
            (folder / "curve.csv").write_text(records.HEADER)
        trainer = Trainer(
            spec.config,
            spec.seeds,
            demonstrations,
            **inherited,
            execution=Execution(**spec.execution),
            replay_file=folder / checkpoints.REPLAY,
            memory=checkpoints.most_steps_between(spec),
        )
        with closing(trainer):
            worker = _Worker(folder, spec, trainer)
            if checkpoint is not None:
                worker.restore(checkpoint)
            worker.work(progress)


def known(folder: Path, task: str | None = None, command: str = "resume") -> RunSpec:
    """Read what a run is, to compute it; a module is imported if the user names the `task`, too."""
    spec = RunSpec.read(folder)
    module = (env_id := spec.config.env_id).rpartition(":")[0]
    if task is not None:
        envs.spec(checked("env_id", task, Literal[env_id]))
    elif module and module not in sys.modules:
        why = "for safety, no module is imported because a file names it. Name it yourself"
        raise ValueError(f"{folder} is a run on {env_id}; {why}: {again(folder, spec, command)}")
    return spec


def is_finished(folder: Path) -> bool:
    """Return whether a run folder is at its end. Where every member has diverged, it is."""
    with suppress(ValueError):  # What is damaged is not; who goes on with it is told why.
        return read_state(folder)["state"] in (records.FINISHED, records.DIVERGED)
    return False


class _Worker:
    """One process's work on a run folder: trains, and keeps what comes of it on the way."""

    def __init__(self, folder: Path, spec: RunSpec, trainer: Trainer) -> None:
        self.folder, self.spec, self.trainer = folder, spec, trainer
        # The step of the last checkpoint, and the steps and updates before it.
        self.step, self.saved, self.start = 0, 0, time.monotonic()
        self.checksums = checkpoints.Checksums(trainer.collector.replay)

    def restore(self, checkpoint: tuple[dict[str, Any], dict[str, Any]]) -> None:
        """Go back to a checkpoint; note versions or a machine that are not those of before."""
        checkpoints.restore(self.folder, self.trainer, checkpoint, self.checksums)
        self.start -= checkpoint[1]["wall_s"]
        self.step, self.saved = self.trainer.steps, self.done
        now, status = origin(self.trainer.execution), read_state(self.folder)
        past = status.get("continued", [])
        if news := records.changed([status, *past][-1], now):
            if news.keys() != {"commit"}:
                changes = "; ".join(f"{key}: {b}, before {a}" for key, (a, b) in news.items())
                log.warning(f"{self.folder} goes on from step {self.step} with other {changes}")
            status["continued"] = [*past, {"step": self.step, **now}]
            write_json(self.folder / "run.json", status)

    def work(self, progress: bool) -> None:
        """Go on to the end."""
        try:
            self.note("running")
            try:
                complete(self.trainer, progress, self.keep)
                state = records.FINISHED
            except FloatingPointError:
                state = records.DIVERGED
            # Whoever diverges before the warm-up is over has no policy yet.
            for result in (self.trainer.policy, self.trainer.reward):
                if result is not None:
                    records.write_whole(self.folder / records.file_name(type(result)), result.save)
            if state == records.FINISHED:
                self.checkpoint()
            self.note(state)  # Last: without this word the end may not have been written.
        except BaseException as error:
            with suppress(OSError, ValueError):
                self.note(f"stopped: {error!r}")
            error.add_note(f"{again(self.folder, self.spec)} goes on from step {self.step}")
            raise

    def keep(self, rows: list[Row]) -> None:
        """Add the rows of an evaluation to the curve, and take a checkpoint where one is due."""
        if rows:  # Policies and rewards are kept before the curve speaks of them.
            learned = None if self.trainer.discriminator is None else self.trainer.reward
            for result in (self.trainer.policy, learned):
                if result is not None:
                    name = records.file_name(type(result), self.trainer.steps)
                    records.write_whole(self.folder / name, result.save)
            with open(self.folder / "curve.csv", "a") as file:
                file.write(records.lines(rows))
            self.note("running")
            self.draw()
        if self.done - self.saved >= self.spec.checkpoint_every:
            self.checkpoint()

    def draw(self) -> None:
        """Bring the run's picture up to date; where that fails, the run goes on without."""
        try:
            # Matplotlib takes a second to import, for which no other command should wait.
            from offairl_lite.runs import pictures

            pictures.draw(self.folder)
        except Exception as error:
            log.warning("%s could not be drawn: %r", self.folder / records.PICTURE, error)

    @property
    def done(self) -> int:
        """Steps and updates, together."""
        return self.trainer.steps + self.trainer.trained

    def checkpoint(self) -> None:
        """Keep all that it takes to go on from here."""
        wall_s, blocks = time.monotonic() - self.start, self.checksums.update()
        checkpoints.save(self.folder, self.spec, self.trainer, wall_s, blocks)
        self.step, self.saved = self.trainer.steps, self.done
        self.note("running")

    def note(self, state: str) -> None:
        """Write to run.json how things are."""
        status = read_state(self.folder)
        status |= {"state": state, "step": self.step, "diverged": self.trainer.members.diverged}
        curve = (self.folder / "curve.csv").read_bytes()
        status["curve.csv"] = zlib.crc32(curve) if state == records.FINISHED else None
        status["wall_s"] = round(time.monotonic() - self.start, 1)
        write_json(self.folder / "run.json", status)


def extend(folder: Path, steps: int | None = None, seeds: Sequence[int] = ()) -> None:
    """Set a run another number of steps, or add seeds to it. `work` then trains what is new.

    New seeds get a run folder of their own, inside `folder`. A finished run keeps its policies and
    rewards until the longer one has its own. If an error is raised, nothing is changed.

    Args:
        folder: of the run.
        steps: of all its run folders, in all.
        seeds: those to add.

    Raises:
        ValueError: a step or a seed is there already, or the run cannot go on; says why.
        OSError: that is gone, a process is at work on the run, or the disk has no room.
    """
    before = {path: known(path) for path in run_folders(folder)}
    changes = {} if steps is None else {"total_steps": checked("steps", steps, Count)}
    specs = {p: replace(spec, config=spec.config.change(**changes)) for p, spec in before.items()}
    with ExitStack() as locks:
        for path, spec in specs.items():
            checkpoints.load(path, spec)  # It refuses what cannot go on to there.
            if "dataset" in (spec.demonstrations or {}):
                inputs.demonstrations_of(path, spec)
            inputs.recorded(path, spec)
            locks.enter_context(checkpoints.lock(path))
        new = []
        if seeds:
            _require_new(folder, specs, seeds)
            new = [replace(next(iter(specs.values())), seeds=tuple(seeds))]
        replays = [path / checkpoints.REPLAY for path in specs]
        used = sum(replay.stat().st_size for replay in replays if replay.is_file())
        space = sum(map(checkpoints.disk_space, [*specs.values(), *new]))
        checkpoints.require_room(folder, space - used)
        for spec in new:
            create(folder / records.seeds_name(seeds), spec, {})
        for path, spec in specs.items():
            status, steps = read_state(path), spec.config.total_steps
            # Once it waits to go on, the old number of steps makes it finished again.
            if status["step"] and status["state"] in ("waiting", records.FINISHED):
                state = records.FINISHED if status["step"] == steps else "waiting"
                write_json(path / "run.json", status | {"state": state})
            spec.write(path)


def _require_new(folder: Path, specs: Mapping[Path, RunSpec], seeds: Sequence[int]) -> None:
    """Raise ValueError unless a run can have further members of these seeds."""
    existing = records.read(folder).seeds  # It refuses several configurations.
    first = next(iter(specs.values()))
    if names := {**inputs.needed(first.config), **first.inherited}:
        raise ValueError(
            f"{folder} has of another run the {' and the '.join(names).replace('_', ' ')}, of "
            f"{len(existing)} members and none for further seeds: start a run of its own"
        )
    checked("seeds", tuple(seeds), tuple[Natural, ...])
    if len({*existing, *seeds}) < len(existing) + len(seeds):
        raise ValueError(f"seeds {list(seeds)} are not all new: there are {list(existing)}")


def verify(
    folder: str | PathLike, progress: bool = True, task: str | None = None
) -> dict[tuple[int, int], tuple[Row | None, Row | None]]:
    """Train the beginning of a recorded run again, in memory, and set it beside the record.

    Its checkpoints are not needed. Of several run folders the first is verified; see `known`.

    Returns:
        By seed and step of the first evaluation, the recorded row and the row as it comes out now;
        None for a member that had diverged.
    """
    folder = run_folders(folder)[0]
    spec = known(folder, task, "verify")
    rows = [row for row in records.read(folder).rows if row.seed in spec.seeds]
    if not rows:
        raise ValueError(f"{folder} has no evaluation to do again: {again(folder, spec)} goes on")
    first = min(row.step for row in rows)
    here: dict[tuple[int, int], Row] = {}

    def keep(rows: list[Row]) -> None:
        here.update({(row.seed, row.step): row for row in rows})
        raise Stop

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
    before = {(row.seed, row.step): row for row in rows if row.step == first}
    return {key: (before.get(key), here.get(key)) for key in before | here}


def main() -> None:
    """Train a run folder: `python -m offairl_lite.runs.folders FOLDER [TASK PROCESS_ID]`."""
    # A shell has its background jobs, and theirs, ignore what ends this process.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    folder, *rest = sys.argv[1:]
    for parent in rest[1:]:
        threading.Thread(target=_end_with, args=(int(parent),), daemon=True).start()
    with messages.one_line():
        known(Path(folder), *rest[:1])
        work(folder, progress=False)


def _end_with(parent: int) -> None:
    """Stop, as Ctrl-C does, when the process that has started this one is gone."""
    while os.getppid() == parent:
        time.sleep(jobs.POLL_S)
    os.kill(os.getpid(), signal.SIGINT)


if __name__ == "__main__":
    main()
