"""Jobs: processes that train run folders, on this machine or on a Ray cluster.

Each is a process of its own, so that one that crashes takes no other with it. After an interruption
the same folders can be given again. Ray's workers import this module, so it imports nothing large.
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
from contextlib import contextmanager, nullcontext
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

from tqdm.auto import tqdm

Engine = Literal["processes", "ray"]
Attempt = Callable[[Path, threading.Event], str]
"""Runs a job, or ends it when the event is set. It returns nothing, or what went wrong."""
POLL_S = 1.0  #: Seconds between two looks at the jobs.
GRACE_S = 10.0  #: Seconds that a process is given to end when it is asked to.
TAIL = 20  #: Lines of the log that are shown of a job that failed.


def log_of(folder: Path) -> Path:
    """Return the file with the output of a job's processes."""
    return folder / "checkpoint" / "log.txt"


def command(folder: Path) -> list[str]:
    """Return the command that trains a run folder, whose task is `folders.known`, to its end."""
    task = _from(folder / "config.json")["config"]["env_id"]
    return [sys.executable, "-m", "offairl_lite.runs.folders", str(folder), task]


def cores() -> int:
    """Return how many cores this process may use: on a shared machine fewer than there are."""
    allowed = getattr(os, "sched_getaffinity", lambda _: range(os.cpu_count() or 1))
    return len(allowed(0))


def execute(
    folders: Sequence[Path],
    engine: Engine = "processes",
    workers: int | None = None,
    *,
    address: str | None = None,
    gpus: float = 0.0,
) -> list[str]:
    """Train run folders to their ends, one process for each, and try once more what fails.

    A KeyboardInterrupt, or SIGTERM, ends the jobs, which can be gone on with.

    Args:
        folders: those of the runs.
        engine: processes here, or Ray.
        workers: how many at a time.
        address: of the Ray cluster; by default one is started here.
        gpus: that each job takes on it.

    Returns:
        Of each job that failed twice its folder, how its process ended, and the end of its log.
    """
    if engine == "processes" and address is not None:
        raise ValueError(f"address {address!r} is a Ray cluster's: give the engine ray with it")
    stop, progress = threading.Event(), (0, "")
    failures: list[str] = []

    def job(attempt: Attempt, folder: Path) -> None:
        if (reason := attempt(folder, stop)) and not stop.is_set():
            bar.write(f"{folder}: {reason}; it is tried once more", file=sys.stderr)
            reason = attempt(folder, stop)
        if reason and not stop.is_set():
            log = log_of(folder)
            lines = log.read_text(errors="replace").splitlines() if log.exists() else []
            failures.append("\n".join([f"{folder}: {reason}", f"{log}:", *lines[-TAIL:]]))

    specs = [_from(folder / "config.json") for folder in folders]
    total = sum(spec["config"]["total_steps"] for spec in specs if spec)
    most = workers or (cores() if engine == "processes" else len(folders))
    here = nullcontext(lambda folder, stop: _child(folder, command(folder), stop))
    with (
        tqdm(total=total, unit="step") as bar,
        here if engine == "processes" else _on_ray(address, gpus) as attempt,
        terminable(),  # Ray has a handler of its own.
        ThreadPoolExecutor(min(most, len(folders))) as pool,
    ):
        waiting = {pool.submit(job, attempt, folder) for folder in folders}
        try:
            while waiting:
                ended, waiting = wait(waiting, POLL_S)
                for future in ended:
                    future.result()
                done = len(folders) - len(waiting) - len(failures)
                step = sum(_from(folder / "run.json").get("step", 0) for folder in folders)
                now = step, f"{done} done, {len(failures)} failed"
                # A clock that ticks is welcome on a terminal, and fills a log file.
                if sys.stderr.isatty() or now != progress:
                    bar.n, progress = now[0], now
                    bar.set_postfix_str(now[1])
        except BaseException:
            stop.set()
            pool.shutdown(cancel_futures=True)
            raise
    return failures


@contextmanager
def terminable() -> Iterator[None]:
    """Have SIGTERM, by which schedulers end a job, do what Ctrl-C does."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt("SIGTERM")

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


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
            ["env", "OMP_NUM_THREADS=1", *command, str(os.getpid())],
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
def _on_ray(address: str | None, gpus: float) -> Iterator[Attempt]:
    """Run jobs as children of Ray's workers; each is a task that takes a core."""
    try:
        import ray
    except ImportError:
        raise ValueError("Ray is not installed: pip install -e '.[ray]', in a clone") from None
    owned = not ray.is_initialized()
    if owned:
        options: dict[str, Any] = {}
        if address is None:
            os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
            options["include_dashboard"] = False
        ray.init(address or "local", log_to_driver=False, logging_level="ERROR", **options)
    # A task is repeated by Ray where its node dies. How a job fails is answered in `execute`.
    task = ray.remote(num_cpus=1, num_gpus=gpus, max_retries=1)(_task)

    def attempt(folder: Path, stop: threading.Event) -> str:
        folder = folder.absolute()
        result = task.remote(folder, command(folder), version("offairl-lite"))
        while not ray.wait([result], timeout=min(POLL_S, 0.2))[0]:
            if stop.is_set():
                ray.cancel(result)
                ray.wait([result], timeout=2 * GRACE_S)
                return "stopped"
        try:
            return ray.get(result)
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
    if (here := version("offairl-lite")) != expected:
        raise ValueError(f"{platform.node()} has offairl-lite {here}: install {expected} there")
    # Ray's workers hold SIGINT back, and a child would inherit that.
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    return _child(folder, command, threading.Event())


def _from(path: Path) -> dict[str, Any]:
    """Return what a JSON file holds; nothing where it cannot be seen, while another node may."""
    return json.loads(path.read_bytes()) if path.exists() else {}
