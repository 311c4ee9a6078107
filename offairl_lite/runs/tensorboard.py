"""Evaluations of a recorded run for TensorBoard."""

import math
import time
from pathlib import Path

from offairl_lite.runs import records

POLL_S = 10.0  #: Seconds between two looks at a run that is followed.


def export(run: Path, folder: Path, follow: bool = False, anew: bool = False) -> int:
    """Write the evaluations of a run, each seed as a run of its own, and return their number.

    Args:
        run: its folder.
        folder: for the event files.
        follow: whether to go on until the run has ended; one that was killed has not.
        anew: whether to replace what was written before.

    Raises:
        ImportError: TensorBoard is not installed.
        FileExistsError: something else is in the folder.
    """
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError as error:
        raise ImportError("TensorBoard is not installed: pip install tensorboard") from error
    old = [path for path in folder.rglob("*") if not path.is_dir()]
    ours = anew and all(path.match("seed-*/events.out.tfevents.*") for path in old)
    if old and not ours:
        raise FileExistsError(f"{folder} has files already, {old[0]}: choose a new folder")
    records.read(run)  # It says what is wrong, before anything is removed.
    for path in old:
        path.unlink()
    written: set[tuple[int, int]] = set()
    while True:
        abouts = [records.read_json(path / "run.json") for path in records.run_folders(run)]
        rows = [row for row in records.read(run).rows if (row.seed, row.step) not in written]
        for seed in {row.seed for row in rows}:
            with SummaryWriter(str(folder / f"seed-{seed}")) as writer:
                for row in (row for row in rows if row.seed == seed):
                    scalars = {"return/true": row.mean_return, "return/learned": row.learned_return}
                    scalars |= {f"update/{name}": value for name, value in row.metrics.items()}
                    for name, value in scalars.items():
                        if not math.isnan(value):  # As is the learned return without a reward.
                            writer.add_scalar(name, value, row.step)
        written |= {(row.seed, row.step) for row in rows}
        if not follow or not {"waiting", "running"} & {run_state["state"] for run_state in abouts}:
            return len(written)
        time.sleep(POLL_S)
