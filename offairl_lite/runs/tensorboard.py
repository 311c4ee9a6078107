"""Evaluations for TensorBoard, as they come or from a record."""

import math
import time
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from offairl_lite.core.results import Row
from offairl_lite.runs import records

POLL_S = 10.0
"""Seconds between two looks at a run that is followed."""


class TensorBoard:
    """Writes each evaluation for TensorBoard: what `core.loop.train` takes as `on_evaluation`.

    Every seed is a run of its own, so that TensorBoard draws them in one figure. Returns are under
    `return/`, diagnostics of the last update under `update/`. An evaluation that was written before
    is left out. ImportError says that TensorBoard is not installed.

    Args:
        folder: for the event files.
    """

    def __init__(self, folder: str | PathLike) -> None:
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError as error:
            raise ImportError(
                "TensorBoard is not installed: pip install -e '.[tensorboard]', in a clone"
            ) from error
        self.folder, self.open = Path(folder), SummaryWriter
        self.writers: dict[int, Any] = {}
        self.written: set[tuple[int, int]] = set()

    def __call__(self, rows: Sequence[Row]) -> None:
        """Write the rows of an evaluation, or of many."""
        for row in rows:
            if (row.seed, row.step) in self.written:
                continue
            self.written.add((row.seed, row.step))
            if row.seed not in self.writers:
                self.writers[row.seed] = self.open(str(self.folder / f"seed-{row.seed}"))
            scalars = {"return/true": row.mean_return, "return/learned": row.learned_return}
            scalars |= {f"update/{name}": value for name, value in row.metrics.items()}
            for name, value in scalars.items():
                if not math.isnan(value):  # As is the learned return where no reward is learned.
                    self.writers[row.seed].add_scalar(name, value, row.step)
        for writer in self.writers.values():
            writer.flush()


def export(run: Path, folder: Path, follow: bool = False) -> int:
    """Write the evaluations of a recorded run for TensorBoard, and return how many there were.

    With `follow` it goes on until the run has ended. One that was killed has not: it may be
    resumed.
    """
    if any(folder.glob("seed-*/events.*")):
        raise FileExistsError(f"{folder} has event files already: choose a new folder, --out")
    records.run_folders(run)  # It tells of a folder that is no run.
    write = TensorBoard(folder)
    while True:
        abouts = [records.read_json(path / "run.json") for path in records.run_folders(run)]
        rows = records.read(run).rows
        write(rows)
        if not follow or not {"waiting", "running"} & {about["state"] for about in abouts}:
            return len(rows)
        time.sleep(POLL_S)
