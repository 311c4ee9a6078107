"""Is a run that was killed the same as one that was left alone?

Imitation on PointMazeLeft at demo scale, with three seeds, twice. One run
is left alone. The other gets `kill -9` in the middle between two of its
evaluations, five times, and is resumed after each. It takes about two
minutes of a core.
"""

import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from offairl_lite.runs import records

KILLED = (3_000, 3_500, 4_000, 4_500, 5_000)
"""The last evaluations before a kill."""
RUN = ("maze-imitation", "--seeds", "0", "1", "2", "--eval-every", "500")


def offairl(log: Path, *words: str) -> subprocess.Popen:
    """Start a command of the package, with its bar in a file."""
    bin_ = Path(sys.executable).parent
    with log.open("w") as bar:
        return subprocess.Popen([bin_ / "offairl", *words], stderr=bar)


def life(log: Path) -> tuple[int, int]:
    """Return at which steps a bar began and ended."""
    steps = re.findall(r"(\d+)/\d+ \[", log.read_text("utf-8"))
    return int(steps[0]), int(steps[-1])


def last_step(run: Path) -> int:
    """Return the step of a run's last evaluation, or 0."""
    lines = (run / "curve.csv").read_text("utf-8").splitlines()[1:]
    return int(lines[-1].split(",")[1]) if lines else 0


def kill_after(process: subprocess.Popen, run: Path, step: int) -> None:
    """Kill a run between an evaluation and the next."""
    while not (run / "curve.csv").exists() or last_step(run) < step:
        assert process.poll() is None
        time.sleep(0.05)
    time.sleep(2)
    assert last_step(run) == step
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL


def results(run: Path) -> dict[str, bytes]:
    """Return what a run has come to: its curve, policies and rewards."""
    files = [run / "curve.csv", *run.rglob("*.safetensors")]
    return {
        file.relative_to(run).as_posix(): file.read_bytes()
        for file in files
        if file.parent.name != "checkpoint"
    }


def record() -> dict[str, Any]:
    """Return both curves, the lives of the killed run, and what differs."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        alone, killed = folder / "alone", folder / "killed"
        logs = [folder / f"{n}.txt" for n in range(len(KILLED) + 1)]
        process = offairl(folder / "log", "run", *RUN, "--out", str(alone))
        assert process.wait() == 0
        process = offairl(logs[0], "run", *RUN, "--out", str(killed))
        for step, log in zip(KILLED, logs[1:], strict=True):
            kill_after(process, killed, step)
            process = offairl(log, "resume", str(killed))
        assert process.wait() == 0
        first, second = results(alone), results(killed)
        assert first.keys() == second.keys()
        runs = {run.name: records.read(run) for run in (alone, killed)}
        lives = [life(log) for log in logs]
    return {
        "steps": runs["alone"].steps,
        **{name: run.returns for name, run in runs.items()},
        "lives": lives,
        "files": len(first),
        "different": [
            name for name in first if first[name] != second[name]
        ],
    }
