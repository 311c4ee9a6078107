"""Training in a run folder: from its last checkpoint to the end, by one process at a time."""

import errno
import logging
import signal
import sys
import time
from contextlib import closing, suppress
from os import PathLike
from pathlib import Path
from typing import Any

from offairl_lite.core.acceleration import Execution
from offairl_lite.core.loop import Trainer, complete
from offairl_lite.core.results import Row
from offairl_lite.demonstrations import Demonstrations
from offairl_lite.runs import checkpoints, inputs, jobs, records
from offairl_lite.runs.provenance import changed, origin
from offairl_lite.runs.records import RunSpec, read_json, write_json, write_whole

log = logging.getLogger(__name__)

FINISHED, DIVERGED = "finished", "stopped: every member has diverged"
"""What `run.json` has as the state of a run that is not gone on with."""


def work(
    folder: str | PathLike, *, demonstrations: Demonstrations | None = None, progress: bool = True
) -> None:
    """Train a run folder from where it is to its end. A run that has ended is left as it is.

    Members that diverge are given up: run.json says why, and the others go on. ValueError says that
    the run is not what it began as, or that a file is damaged; OSError that another process is at
    work on it, or that the disk is full.

    Args:
        folder: the run folder.
        demonstrations: what the run began with; by default they are loaded.
        progress: whether to show a bar.
    """
    folder = Path(folder)
    spec = RunSpec.read(folder)
    if is_finished(folder):
        return
    demonstrations = inputs.demonstrations_of(folder, spec, demonstrations)
    given, found = inputs.recorded(folder, spec), checkpoints.load(folder, spec)
    try:
        with checkpoints.lock(folder):
            if found is None:
                (folder / checkpoints.REPLAY).unlink(missing_ok=True)
                (folder / "curve.csv").write_text(records.HEADER)
            trainer = Trainer(
                spec.config,
                spec.seeds,
                demonstrations,
                **given,
                execution=Execution(**spec.execution),
                replay_file=folder / checkpoints.REPLAY,
                memory=checkpoints.most_steps_between(spec),
            )
            with closing(trainer):
                worker = _Worker(folder, spec, trainer)
                if found is not None:
                    worker.restore(found)
                worker.work(progress)
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        raise OSError(
            f"the disk of {folder} is full: free some of it, and `offairl resume {folder}` goes on "
            "from the last checkpoint"
        ) from error


def is_finished(folder: Path) -> bool:
    """Return whether a run folder is at its end. Where every member has diverged, it is."""
    return read_json(folder / "run.json")["state"] in (FINISHED, DIVERGED)


class _Worker:
    """One process's work on a run folder: trains, and keeps what comes of it on the way."""

    def __init__(self, folder: Path, spec: RunSpec, trainer: Trainer) -> None:
        self.folder, self.spec, self.trainer = folder, spec, trainer
        # The step of the last checkpoint, and the steps and updates before it.
        self.step, self.saved, self.start = 0, 0, time.monotonic()

    def restore(self, found: tuple[dict[str, Any], dict[str, Any]]) -> None:
        """Go back to a checkpoint; note versions or a machine that are not those of before."""
        checkpoints.restore(self.folder, self.trainer, found)
        self.start -= found[1]["wall_s"]
        self.step, self.saved = self.trainer.steps, self.done
        now, about = origin(self.trainer.execution), read_json(self.folder / "run.json")
        past = about.get("continued", [])
        if news := changed([about, *past][-1], now):
            if news.keys() != {"commit"}:
                said = "; ".join(
                    f"{key}: {here}, before {was}" for key, (was, here) in news.items()
                )
                log.warning("%s goes on from step %d with other %s", self.folder, self.step, said)
            about["continued"] = [*past, {"step": self.step, **now}]
            write_json(self.folder / "run.json", about)

    def work(self, progress: bool) -> None:
        """Go on to the end."""
        try:
            self.note("running")
            try:
                complete(self.trainer, progress, self.keep)
                state = FINISHED
            except FloatingPointError:
                state = DIVERGED
            # Whoever diverges before the warm-up is over has no policy yet.
            for result in (self.trainer.policy, self.trainer.reward):
                if result is not None:
                    write_whole(self.folder / records.file_name(type(result)), result.save)
            if state == FINISHED:
                self.checkpoint()
            self.note(state)  # Last: without this word the end may not have been written.
        except BaseException as error:
            with suppress(OSError):
                self.note(f"stopped: {error!r}")
            raise

    def keep(self, rows: list[Row]) -> None:
        """Add the rows of an evaluation to the curve, and take a checkpoint where one is due."""
        if rows:
            with open(self.folder / "curve.csv", "a") as file:
                file.write(records.lines(rows))
            self.note("running")
        if self.done - self.saved >= self.spec.checkpoint_every:
            self.checkpoint()

    @property
    def done(self) -> int:
        """Steps and updates, together."""
        return self.trainer.steps + self.trainer.trained

    def checkpoint(self) -> None:
        """Keep all that it takes to go on from here."""
        checkpoints.save(self.folder, self.spec, self.trainer, time.monotonic() - self.start)
        self.step, self.saved = self.trainer.steps, self.done
        self.note("running")

    def note(self, state: str) -> None:
        """Write to run.json how things are."""
        about = read_json(self.folder / "run.json")
        about |= {"state": state, "step": self.step, "diverged": self.trainer.members.diverged}
        about["wall_s"] = round(time.monotonic() - self.start, 1)
        write_json(self.folder / "run.json", about)


def main() -> None:
    """Train the run folder that the command line names: `python -m offairl_lite.runs.worker`."""
    # A shell has its background jobs, and theirs, ignore what ends this process.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with jobs.terminable():
            work(Path(sys.argv[1]), progress=False)
    except (ValueError, OSError, ImportError) as error:
        sys.exit(f"offairl: {error}")
    except KeyboardInterrupt:
        sys.exit("offairl: stopped")


if __name__ == "__main__":
    main()
