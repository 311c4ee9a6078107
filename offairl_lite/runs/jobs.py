"""Jobs: processes that train run folders, on this machine or on a Ray cluster.

Every job is a process of its own, on either engine, so that one that crashes takes no other with
it. What is known of a job is what lies in its run folder. After an interruption the same folders
can therefore be given again, and their runs go on.

Workers of a Ray cluster import this module, so it imports nothing large.
"""

import json
import os
import platform
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Literal, NamedTuple, get_args

from tqdm.auto import tqdm

Engine = Literal["processes", "ray"]
Command = Callable[[Path], list[str]]
Attempt = Callable[[Path, threading.Event], str]
"""Runs a job, or ends it when the event is set. It returns nothing, or what went wrong."""

POLL_S = 1.0
"""Seconds between two looks at the jobs."""
GRACE_S = 10.0
"""Seconds that a process is given to end when it is asked to."""
TAIL = 20
"""Lines of the log that are shown of a job that failed."""


class Failure(NamedTuple):
    """A job that failed twice: its run folder, how its process ended, the end of its log."""

    folder: Path
    reason: str
    tail: str

    def __str__(self) -> str:
        return f"{self.folder}: {self.reason}\n{log_of(self.folder)}:\n{self.tail}"


def log_of(folder: Path) -> Path:
    """Return the file with the output of a job's processes."""
    return folder / "checkpoint" / "log.txt"


def resume(folder: Path) -> list[str]:
    """Return the command that trains a run folder to its end."""
    return [sys.executable, "-m", "offairl_lite.runs.worker", str(folder)]


def cores() -> int:
    """Return how many cores this process may use: on a shared machine fewer than there are."""
    allowed = getattr(os, "sched_getaffinity", lambda _: range(os.cpu_count() or 1))
    return len(allowed(0))


def execute(
    folders: Sequence[Path],
    engine: Engine = "processes",
    workers: int | None = None,
    progress: bool = True,
    *,
    address: str | None = None,
    gpus: float = 0.0,
    command: Command = resume,
) -> list[Failure]:
    """Train run folders to their ends, one process for each, and try once more what fails.

    Args:
        folders: the run folders.
        engine: processes of this machine, or of a Ray cluster.
        workers: how many at a time; by default one on each core.
        progress: whether to show a bar over the steps of all jobs.
        address: the address of the Ray cluster, `auto` on one of its nodes; None for a cluster on
            this machine that is started and ended here.
        gpus: how much of a GPU a job takes on a Ray cluster.
        command: what a job runs.

    Returns:
        The jobs that failed twice.

    Raises:
        ValueError: the engine is not there, or a node does not see a run folder.
        KeyboardInterrupt: interrupted or terminated, as are the jobs, which can be gone on with.
    """
    if engine not in get_args(Engine):
        raise ValueError(f"engine is {engine!r}; expected one of {get_args(Engine)}")
    if workers is not None and workers < 1:
        raise ValueError(f"processes is {workers}; expected at least 1")
    if engine == "processes" and address is not None:
        raise ValueError(f"address {address!r} is a Ray cluster's: give the engine ray with it")
    stop, failures, shown = threading.Event(), [], []

    def job(attempt: Attempt, folder: Path) -> None:
        for again in (False, True):
            if not (reason := attempt(folder, stop)) or stop.is_set():
                return
            if not again:
                bar.write(f"{folder}: {reason}; it is tried once more", file=sys.stderr)
        failures.append(Failure(folder, reason, _tail(folder)))

    def show(done: int) -> None:
        counts = f"{done - len(failures)} done, {len(failures)} failed"
        steps = sum(map(_step, folders))
        # A clock that ticks is welcome on a terminal, and fills a log file.
        if sys.stderr.isatty() or [steps, counts] != shown:
            bar.set_postfix_str(counts, refresh=False)
            bar.n, shown[:] = steps, [steps, counts]
            bar.refresh()

    there = _on_this_machine(command) if engine == "processes" else _on_ray(command, address, gpus)
    most = workers or (cores() if engine == "processes" else len(folders))
    total = sum(map(_steps, folders))
    with (
        tqdm(total=total, unit="step", disable=not progress) as bar,
        there as attempt,
        terminable(),  # Ray has a handler of its own.
        ThreadPoolExecutor(min(most, len(folders))) as pool,
    ):
        futures = [pool.submit(job, attempt, folder) for folder in folders]
        try:
            waiting = set(futures)
            while waiting:
                ended, waiting = wait(waiting, POLL_S)
                for future in ended:
                    future.result()
                show(len(folders) - len(waiting))
        except BaseException:
            stop.set()
            pool.shutdown(cancel_futures=True)
            raise
    return failures


@contextmanager
def terminable() -> Iterator[None]:
    """Have SIGTERM, by which schedulers end a job, do what Ctrl-C does."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(number: int, _: object) -> None:
        raise KeyboardInterrupt(signal.Signals(number).name)

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def _on_this_machine(command: Command) -> Iterator[Attempt]:
    """Run jobs as children of this process."""
    yield lambda folder, stop: _child(folder, command(folder), stop)


def _child(folder: Path, command: list[str], stop: threading.Event) -> str:
    """Run a child process to its end; return how it failed, or nothing."""
    if not folder.is_dir():
        raise ValueError(
            f"{platform.node()} does not see {folder}: put runs on a file system that all nodes "
            "share, under the same path on each"
        )
    log_of(folder).parent.mkdir(exist_ok=True)
    with open(log_of(folder), "a") as log:
        now = datetime.now(UTC).isoformat(timespec="seconds")
        print(f"# {now} on {platform.node()}", file=log, flush=True)
        process = subprocess.Popen(
            ["env", "OMP_NUM_THREADS=1", *command],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
        )
    try:
        while process.poll() is None and not stop.wait(min(POLL_S, 0.2)):
            pass
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(GRACE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
    code = process.returncode
    if code < 0:
        memory = " (out of memory?)" if code == -signal.SIGKILL else ""
        return f"killed by {signal.Signals(-code).name}{memory}"
    return f"exit status {code}" if code else ""


@contextmanager
def _on_ray(command: Command, address: str | None, gpus: float) -> Iterator[Attempt]:
    """Run jobs as children of Ray's workers; each is a task that takes a core.

    Raises:
        ValueError: Ray is not installed, or there is no GPU where one is needed.
    """
    try:
        import ray
    except ImportError:
        raise ValueError("Ray is not installed: pip install -e '.[ray]', in a clone") from None
    owned = not ray.is_initialized()
    if owned:
        if address is None:
            os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
        here = {"include_dashboard": False} if address is None else {}
        ray.init(address or "local", log_to_driver=False, logging_level="ERROR", **here)
    # A task is repeated by Ray where its node dies. How a job fails is answered in `execute`.
    task = ray.remote(num_cpus=1, num_gpus=gpus, max_retries=1)(_task)
    here = version("offairl-lite")

    def attempt(folder: Path, stop: threading.Event) -> str:
        folder = folder.absolute()
        found = task.remote(folder, command(folder), here)
        while not ray.wait([found], timeout=min(POLL_S, 0.2))[0]:
            if stop.is_set():
                ray.cancel(found)
                ray.wait([found], timeout=2 * GRACE_S)
                return "stopped"
        try:
            return ray.get(found)
        except ray.exceptions.RayTaskError as error:
            raise error.cause from None
        except ray.exceptions.RayError as error:  # a node or a worker that died, twice
            return str(error).split("\n")[0].split(". ")[0]

    try:
        if gpus and not ray.cluster_resources().get("GPU"):
            raise ValueError("the jobs need a GPU, and no node of the cluster has one: use cpu")
        yield attempt
    finally:
        if owned:
            ray.shutdown()


def _task(folder: Path, command: list[str], expected: str) -> str:
    """Run a job on a node of a cluster; return how it failed, or nothing."""
    if (found := version("offairl-lite")) != expected:
        raise ValueError(f"{platform.node()} has offairl-lite {found}: install {expected} there")
    # Ray's workers hold SIGINT back, and a child would inherit that.
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    return _child(folder, command, threading.Event())


def _step(folder: Path) -> int:
    """Return the step of a run's last checkpoint."""
    try:
        return json.loads((folder / "run.json").read_bytes()).get("step", 0)
    except FileNotFoundError:  # Another node may see it.
        return 0


def _steps(folder: Path) -> int:
    """Return the steps that a run is to have in all."""
    try:
        return json.loads((folder / "config.json").read_bytes())["config"]["total_steps"]
    except FileNotFoundError:
        return 0


def _tail(folder: Path) -> str:
    log = log_of(folder)
    lines = log.read_text(errors="replace").splitlines() if log.exists() else []
    return "\n".join(lines[-TAIL:])
