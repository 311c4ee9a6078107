"""Evaluations for TensorBoard, as they come or from a record."""

import math
import time
from collections.abc import Sequence
from os import PathLike
from pathlib import Path

from offairl_lite.core.loop import Row
from offairl_lite.runs import records

POLL_S = 10.0
"""Seconds between two looks at a run that is followed."""


class TensorBoard:
    """Writes each evaluation for TensorBoard: what `core.loop.train` takes as `on_evaluation`.

    Every seed is a run of its own, so that TensorBoard draws them in one figure. Returns are under
    `return/`, diagnostics of the last update under `update/`. An evaluation that was written before
    is left out.

    Args:
        folder: for the event files.

    Raises:
        ImportError: TensorBoard is not installed.
    """

    def __init__(self, folder: str | PathLike) -> None:
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError as error:
            raise ImportError(
                "TensorBoard is not installed: pip install -e '.[tensorboard]', in a clone"
            ) from error
        self.folder, self._open, self._writers = Path(folder), SummaryWriter, {}
        self._written: set[tuple[int, int]] = set()

    def __call__(self, rows: Sequence[Row]) -> None:
        """Write the rows of an evaluation, or of many."""
        for row in rows:
            if (row.seed, row.step) in self._written:
                continue
            self._written.add((row.seed, row.step))
            if row.seed not in self._writers:
                self._writers[row.seed] = self._open(str(self.folder / f"seed-{row.seed}"))
            scalars = {"return/true": row.mean_return, "return/learned": row.learned_return}
            scalars |= {f"update/{name}": value for name, value in row.metrics.items()}
            for name, value in scalars.items():
                if not math.isnan(value):  # As is the learned return where no reward is learned.
                    self._writers[row.seed].add_scalar(name, value, row.step)
        for writer in self._writers.values():
            writer.flush()


def export(run: Path, folder: Path, follow: bool = False) -> int:
    """Write the evaluations of a recorded run for TensorBoard.

    Args:
        run: its folder.
        folder: for the event files.
        follow: whether to go on until the run has ended. One that was killed has not: it may be
            resumed.

    Returns:
        How many evaluations there were.

    Raises:
        FileExistsError: the folder has event files already.
        FileNotFoundError: there is no such run.
        ImportError: TensorBoard is not installed.
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
