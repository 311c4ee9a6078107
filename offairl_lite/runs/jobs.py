"""Jobs: processes that take run folders to their ends, on this machine or on a Ray cluster.

Every job is a process of its own, on either engine, so that one that crashes takes no other with
it. What is known of a job is what lies in its run folder. After an interruption, or a power cut,
the same jobs are therefore executed again, and go on.

Workers of a Ray cluster import this module, so it imports nothing large.
"""

import json
import os
import platform
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, get_args

from tqdm.auto import tqdm

from offairl_lite.runs.folders import home

Engine = Literal["processes", "ray"]
POLL_S = 1.0
"""Seconds between two looks at the jobs."""
GRACE_S = 10.0
"""Seconds that a process is given to end when it is asked to."""
TAIL = 20
"""Lines of the log that are shown of a job that failed."""


@dataclass(frozen=True)
class Job:
    """One process's share of a run: some of its members, from where they stand to the end.

    Args:
        folder: the run's.
        members: their seeds.
        steps: of the whole run.
    """

    folder: Path
    members: tuple[int, ...]
    steps: int

    @property
    def shard(self) -> Path:
        """Where these members are kept."""
        return home(self.folder, self.members)

    @property
    def log(self) -> Path:
        """What the job's processes had to say."""
        return self.shard / "log.txt"

    @property
    def finished(self) -> bool:
        """Whether the run is, with all its members."""
        try:
            return json.loads((self.folder / "run.json").read_text())["state"] == "finished"
        except FileNotFoundError:
            return False

    @property
    def step(self) -> int:
        """The step of the last evaluation so far."""
        try:
            with open(self.shard / "curve.csv", "rb") as file:
                header = file.readline()
                file.seek(max(len(header), file.seek(0, os.SEEK_END) - 10_000))
                # What follows the last end of a line is still being written.
                rows = file.read().split(b"\n")[:-1]
            return int(rows[-1].split(b",")[header.strip().split(b",").index(b"step")])
        except (FileNotFoundError, IndexError):
            return 0

    def __str__(self) -> str:
        return f"{self.folder}, seeds {' '.join(map(str, self.members))}"


def of(folder: Path) -> list[Job]:
    """Return the jobs of a run, one for each of its shards."""
    about = json.loads((folder / "config.json").read_text())
    steps = about["config"]["total_steps"]
    return [Job(folder, tuple(shard), steps) for shard in about["shards"]]


@dataclass(frozen=True)
class Failure:
    """A job that failed twice.

    Args:
        job: which.
        reason: how its process ended.
        tail: the last lines of its log.
    """

    job: Job
    reason: str
    tail: str

    def __str__(self) -> str:
        return f"{self.job}: {self.reason}\n{self.job.log}:\n{self.tail}"


Command = Callable[[Job], list[str]]


def resume(job: Job) -> list[str]:
    """Return the command that takes a job to its end, from its checkpoint if there is one."""
    cli = [sys.executable, "-m", "offairl_lite.runs.cli"]
    return [*cli, "resume", str(job.folder), "--members", *map(str, job.members)]


def execute(
    jobs: Sequence[Job],
    engine: Engine = "processes",
    workers: int | None = None,
    progress: bool = True,
    *,
    address: str | None = None,
    gpus: float = 0.0,
    command: Command = resume,
) -> list[Failure]:
    """Take to their ends the jobs that are not there yet, and try once more what fails.

    Args:
        jobs: what to do, each with a run folder.
        engine: processes of this machine, or of a Ray cluster.
        workers: at most so many at a time; None for one on each core.
        progress: whether to show a bar over the steps of all jobs.
        address: of the Ray cluster, `auto` on one of its nodes; None for one on this machine that
            is started and ended here.
        gpus: that a job takes on a Ray cluster; a fraction where several share one.
        command: what a job runs.

    Returns:
        What failed twice.

    Raises:
        ValueError: the engine is not there, or a node does not see a run folder.
        KeyboardInterrupt: interrupted or terminated; so are the jobs, which can be gone on with.
    """
    if engine not in get_args(Engine):
        raise ValueError(f"engine is {engine!r}; expected one of {get_args(Engine)}")
    if workers is not None and workers < 1:
        raise ValueError(f"workers is {workers}; expected at least 1")
    if engine == "processes" and address is not None:
        raise ValueError(f"address {address!r} is a Ray cluster's: give the engine ray with it")
    waiting = deque(job for job in jobs if not job.finished)
    steps = {job: job.step if job in waiting else job.steps for job in jobs}
    done, running, failed, failures = len(jobs) - len(waiting), {}, set(), []
    bar = tqdm(
        total=sum(job.steps for job in jobs),
        initial=sum(steps.values()),
        unit="step",
        disable=not progress,
    )

    shown = None

    def show() -> None:
        nonlocal shown
        before = shown
        counts = f"{done} done, {len(running)} running, {len(failures)} failed"
        bar.set_postfix_str(counts, refresh=False)
        bar.update(sum(steps.values()) - bar.n)
        shown = bar.n, counts
        # A clock that ticks is welcome on a terminal, and fills a log file.
        if sys.stderr.isatty() or shown != before:
            bar.refresh()

    if not waiting:
        show()
        bar.close()
        return failures
    crew = (
        Processes(command, workers)
        if engine == "processes"
        else Ray(command, workers, address, gpus)
    )
    # Signals are noted until the last job has ended.
    with bar, _signals() as signals, ExitStack() as last:
        last.callback(crew.close)
        last.callback(lambda: crew.stop(list(running.values())))
        while waiting or running:
            while waiting and len(running) < crew.capacity():
                job = waiting.popleft()
                running[job] = crew.start(job)
            show()
            time.sleep(POLL_S)
            if signals:
                raise KeyboardInterrupt
            for job, handle in list(running.items()):
                steps[job] = job.step
                if (reason := crew.outcome(handle)) is None:
                    continue
                del running[job]
                if not reason:
                    done, steps[job] = done + 1, job.steps
                elif job not in failed:
                    failed.add(job)
                    waiting.append(job)
                    bar.write(f"{job}: {reason}; it is tried once more", file=sys.stderr)
                else:
                    failures.append(Failure(job, reason, _tail(job.log)))
        show()
    return failures


@contextmanager
def _signals() -> Iterator[list[int]]:
    """Note signals, instead of being interrupted in the middle of starting a process."""
    caught: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield caught
        return
    numbers = signal.SIGINT, signal.SIGTERM
    before = [signal.signal(number, lambda number, _: caught.append(number)) for number in numbers]
    try:
        yield caught
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


def _tail(log: Path) -> str:
    lines = log.read_text(errors="replace").splitlines() if log.exists() else []
    return "\n".join(lines[-TAIL:])


def cores() -> int:
    """Return how many cores this process may use: on a shared machine fewer than there are."""
    allowed = getattr(os, "sched_getaffinity", lambda _: range(os.cpu_count() or 1))
    return len(allowed(0))


class Processes:
    """Jobs as children of this process.

    An outcome is None before a job's end, then empty for success, or what went wrong.

    Args:
        command: what a job runs.
        workers: at most so many at a time; None for one on each core.
    """

    def __init__(self, command: Command, workers: int | None) -> None:
        self.command = command
        self.workers = workers or cores()

    def capacity(self) -> int:
        """Return how many jobs there may be at a time."""
        return self.workers

    def start(self, job: Job) -> subprocess.Popen:
        """Start a job as a process."""
        if not job.folder.is_dir():
            raise ValueError(
                f"{platform.node()} does not see {job.folder}: put runs on a file system that all "
                "nodes share, under the same path on each"
            )
        job.shard.mkdir(parents=True, exist_ok=True)
        with open(job.log, "a") as log:
            now = datetime.now(UTC).isoformat(timespec="seconds")
            print(f"# {now} on {platform.node()}", file=log, flush=True)
            return subprocess.Popen(
                ["env", "OMP_NUM_THREADS=1", *self.command(job)],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
            )

    def outcome(self, handle: subprocess.Popen) -> str | None:
        """Return how a job ended, None while it runs."""
        if (code := handle.poll()) is None:
            return None
        if code < 0:
            memory = " (out of memory?)" if code == -signal.SIGKILL else ""
            return f"killed by {signal.Signals(-code).name}{memory}"
        return f"exit status {code}" if code else ""

    def stop(self, handles: list[subprocess.Popen]) -> None:
        """End jobs before their time, by what Ctrl-C would send them."""
        for process in handles:
            process.send_signal(signal.SIGINT)
        deadline = time.monotonic() + GRACE_S
        for process in handles:
            try:
                process.wait(max(0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def close(self) -> None:
        """There is nothing to close."""


class Ray:
    """Jobs as children of Ray's workers; each is a task that takes a core.

    Args:
        command: what a job runs.
        workers: at most so many at a time; None for one on each core of the cluster.
        address: of the cluster; None for a local one, which ends with this process.
        gpus: that a job takes.

    Raises:
        ValueError: Ray is not installed, or there is no GPU where one is needed.
    """

    def __init__(
        self, command: Command, workers: int | None, address: str | None, gpus: float
    ) -> None:
        try:
            import ray
        except ImportError:
            raise ValueError("Ray is not installed: pip install -e '.[ray]', in a clone") from None
        self.ray, self.workers, self.gpus = ray, workers, gpus
        self.owned = not ray.is_initialized()
        if self.owned:
            here = {}
            if address is None:
                os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
                here = {"include_dashboard": False, "num_cpus": workers}
            ray.init(address or "local", log_to_driver=False, logging_level="ERROR", **here)
        if gpus and not ray.cluster_resources().get("GPU"):
            self.close()
            raise ValueError("the jobs need a GPU, and no node of the cluster has one: use cpu")
        # Failures are answered by the same rules as without Ray, not by its own.
        task = ray.remote(num_cpus=1, num_gpus=gpus, max_retries=0)(_attempt)
        self.task = lambda job: task.remote(job, command, version("offairl-lite"))

    def capacity(self) -> int:
        """Return how many jobs there may be at a time; nodes come and go."""
        there = self.ray.cluster_resources()
        slots = there.get("GPU", 0) / self.gpus if self.gpus else there.get("CPU", 0)
        return min(max(int(slots), 1), self.workers or sys.maxsize)

    def start(self, job: Job) -> Any:
        """Start a job as a task."""
        return self.task(replace(job, folder=job.folder.absolute()))

    def outcome(self, handle: Any) -> str | None:
        """Return how a job ended, None while it runs."""
        if not self.ray.wait([handle], timeout=0)[0]:
            return None
        try:
            return self.ray.get(handle)
        except self.ray.exceptions.RayTaskError as error:
            raise error.cause from None
        except self.ray.exceptions.RayError as error:  # a node or a worker that died
            return str(error).split("\n")[0].split(". ")[0]

    def stop(self, handles: list) -> None:
        """End jobs before their time."""
        for handle in handles:
            self.ray.cancel(handle)
        if handles:
            self.ray.wait(handles, num_returns=len(handles), timeout=2 * GRACE_S)

    def close(self) -> None:
        """Leave a cluster as it was found, and end a local one."""
        if self.owned:
            self.ray.shutdown()


def _attempt(job: Job, command: Command, expected: str) -> str:
    """Run a job on a node of a cluster; return its outcome."""
    if (found := version("offairl-lite")) != expected:
        raise ValueError(f"{platform.node()} has offairl-lite {found}: install {expected} there")
    here = Processes(command, 1)
    # Ray's workers hold SIGINT back, and a child would inherit that.
    held = signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    handle = here.start(job)
    signal.pthread_sigmask(signal.SIG_SETMASK, held)
    try:
        while (outcome := here.outcome(handle)) is None:
            time.sleep(0.2)
        return outcome
    finally:
        here.stop([handle])
