"""Training in a run folder: from its last checkpoint to the end, by one process at a time."""

import logging
import signal
import sys
import time
import warnings
from contextlib import closing, suppress
from os import PathLike
from pathlib import Path
from typing import Any

from tqdm.auto import tqdm

from offairl_lite.core.acceleration import Execution
from offairl_lite.core.loop import Trainer
from offairl_lite.demonstrations import Demonstrations
from offairl_lite.runs import checkpoints, inputs, jobs
from offairl_lite.runs.checkpoints import SUBFOLDER
from offairl_lite.runs.provenance import changed, origin
from offairl_lite.runs.records import HEADER, RunSpec, lines, read_json, write_json, write_whole

log = logging.getLogger(__name__)

DIVERGED = "stopped: every member has diverged"
"""What `run.json` has as the state of a run that is not tried again."""


def work(
    folder: str | PathLike,
    *,
    demonstrations: Demonstrations | None = None,
    progress: bool = True,
) -> None:
    """Train a run folder from where it is to its end. A run that has ended is left as it is.

    Members that diverge are given up: run.json says why, and the others go on.

    Args:
        folder: the run folder.
        demonstrations: what the run began with; by default they are loaded.
        progress: whether to show a bar.

    Raises:
        FileNotFoundError: there is no such run, or its checkpoint is gone.
        ValueError: the checkpoint is damaged, or of another format or run; or the configuration,
            the demonstrations, or what comes from other runs, have changed.
        OSError: another process is at work on the run, or its disk is full.
    """
    folder = Path(folder)
    spec = RunSpec.read(folder)
    if is_finished(folder):
        return
    if (reached := checkpoints.reached(folder, spec)) > spec.config.total_steps:
        raise ValueError(
            f"{folder} has reached step {reached}, and its total_steps is "
            f"{spec.config.total_steps}: `offairl resume {folder} --steps N` takes any N from "
            f"{reached} on"
        )
    demonstrations = inputs.demonstrations_of(folder, spec, demonstrations)
    with checkpoints.lock(folder), checkpoints.full_disk_explained(folder, spec):
        _Worker(folder, spec, progress).work(demonstrations)


def is_finished(folder: str | PathLike) -> bool:
    """Return whether a run folder is at its end. Where every member has diverged, it is.

    Raises:
        FileNotFoundError: there is no such run, or its checkpoint is gone.
        ValueError: the checkpoint is damaged or of another format or run.
    """
    folder = Path(folder)
    spec, state = RunSpec.read(folder), read_json(folder / "run.json")["state"]
    found = checkpoints.load(folder, spec)
    whole = found and found[1]["finished"] and found[1]["steps"] >= spec.config.total_steps
    kept = (folder / "policy.safetensors").is_file()
    # run.json is written last: without its word the end may not have been written.
    return state == DIVERGED or bool(whole and kept and state == "finished")


class _Worker:
    """One process's work on a run folder.

    Args:
        folder: the run folder.
        spec: its `config.json`.
        progress: whether to show a bar.
    """

    def __init__(self, folder: Path, spec: RunSpec, progress: bool) -> None:
        self.folder, self.spec, self.progress = folder, spec, progress
        self.curve, self.replay = folder / "curve.csv", folder / SUBFOLDER / "replay.f32"
        self.trainer: Trainer
        # Steps at the last checkpoint, and steps and updates.
        self.step, self.saved = 0, 0
        self.start = time.monotonic()

    def work(self, demonstrations: Demonstrations | None) -> None:
        """Go from the last checkpoint to the end."""
        self._begin(demonstrations)
        with closing(self.trainer):
            try:
                self._note("running")
                try:
                    self._train()
                    state = "finished"
                except FloatingPointError:
                    state = DIVERGED
                # Whoever diverges before the warm-up is over has no policy yet.
                results = {"policy": self.trainer.policy, "reward": self.trainer.reward}
                for name, result in results.items():
                    if result is not None:
                        write_whole(self.folder / f"{name}.safetensors", result.save)
                if state == "finished":
                    self._checkpoint()
                self._note(state)
            except BaseException as error:
                with suppress(OSError):
                    why = f"{type(error).__name__}: {error}" if str(error) else repr(error)
                    self._note(f"stopped: {why}")
                raise

    def _begin(self, demonstrations: Demonstrations | None) -> None:
        """Put the trainer where the checkpoint says."""
        config, execution = self.spec.config, Execution(**self.spec.execution)
        found = checkpoints.load(self.folder, self.spec)
        if found is None:
            self.replay.unlink(missing_ok=True)
            self.curve.write_text(HEADER)
        self.trainer = Trainer(
            config,
            self.spec.seeds,
            demonstrations,
            **inputs.recorded(self.folder, self.spec),
            execution=execution,
            replay_file=self.replay,
            memory=checkpoints.most_steps_between(self.spec),
        )
        if found is not None:
            checkpoints.restore(self.folder, self.trainer, found)
            self.start -= found[1]["wall_s"]
            self.saved, self.step = self._done, self.trainer.steps
            self._note_change(origin(execution))

    def _train(self) -> None:
        """Train to the end, and keep what comes of it on the way."""
        trainer, total = self.trainer, self.spec.config.total_steps
        with tqdm(
            total=total, initial=trainer.trained, unit="step", disable=not self.progress
        ) as bar:
            for rows in trainer.run():
                bar.update(trainer.trained - bar.n)
                if rows:
                    returns = " ".join(f"{row.mean_return:.4g}" for row in rows)
                    bar.set_postfix_str(f"return {returns}")
                    with open(self.curve, "a") as file:
                        file.write(lines(rows))
                    self._note("running")
                if self._done - self.saved >= self.spec.checkpoint_every:
                    self._checkpoint()
            bar.update(trainer.steps - bar.n)
        if not trainer.trained:
            warnings.warn(
                "nothing was trained: no episode was over between step "
                f"{self.spec.config.schedule.warmup_steps}, the end of the warm-up, and step "
                f"{trainer.steps}; raise total_steps",
                stacklevel=2,
            )

    @property
    def _done(self) -> int:
        return self.trainer.steps + self.trainer.trained

    def _checkpoint(self) -> None:
        checkpoints.save(self.folder, self.spec, self.trainer, time.monotonic() - self.start)
        self.saved, self.step = self._done, self.trainer.steps
        self._note("running")

    def _note(self, state: str) -> None:
        """Write to run.json how things are."""
        status = {
            "state": state,
            "step": self.step,
            "wall_s": round(time.monotonic() - self.start, 1),
            "diverged": self.trainer.members.diverged,
        }
        path = self.folder / "run.json"
        write_json(path, read_json(path) | status)

    def _note_change(self, now: dict[str, Any]) -> None:
        """Note in run.json where a run goes on with other versions, or elsewhere, than before."""
        path = self.folder / "run.json"
        about = read_json(path)
        before = [about, *about.get("continued", [])][-1]
        if not (found := changed(before, now)):
            return
        if found.keys() != {"commit"}:
            said = "; ".join(f"{key}: {here}, before {was}" for key, (was, here) in found.items())
            log.warning("%s goes on from step %d with other %s", self.folder, self.step, said)
        about["continued"] = [*about.get("continued", []), {"step": self.step, **now}]
        write_json(path, about)


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
