"""How fast the package trains on this machine: the command `offairl bench`.

Machines differ, and one machine differs from hour to hour. So the contestants take turns, round
after round. A rate is the median over the rounds. The ratios are what counts, and each is the
median of the ratios within a round. Everything runs on one thread unless you ask for more, because
a second core does more good with a second process. Whatever trains is kept to one core on Linux,
because JAX uses a second one even if it is told not to. The benchmark measures, on HalfCheetah:

- *Combined updates*: one update of the discriminator, with its penalty, and one of SAC, whose actor
  learns every second time. They come in blocks, as in training, and are compiled where there is a
  compiler. One member waits for thin products and for calls; many members wait for element-wise
  work, above all Adam's, which waits for memory. At demo size nothing is compiled, because
  compiling takes longer than the run. One member's time then goes to calling some four hundred
  small operations. Five members make as many calls, and what they cost more is arithmetic.
- *Products*: the matrix products of these updates alone, in the same shapes, one after the other.
  An update cannot be faster than they are, and the table shows their share of its time. Products
  of thin first layers are slow. A layer with one output is a sum and does not count.
- *Whole steps*: one step of the environment and one combined update. With `--against`, the SAC of
  Stable-Baselines3 or SBX runs on the same environment, with the same hidden layers and batch, and
  otherwise its own defaults: one step and one update, without a discriminator. Its actor learns
  every time. About a tenth of our time goes to acting and physics. Stable-Baselines3 waits for
  calls, SBX waits for its products as we do.
- *Environments*: ten members of each built-in task, with random actions.
- *Two processes* with the largest population, beside one of them alone, on the CPU only. They share
  the memory's bandwidth and the last level of cache.
- *Memory*: the most that one such process has held, and this one with all its contestants; on a
  GPU, what PyTorch has held there.
"""

import json
import os
import platform
import resource
import subprocess
import sys
from contextlib import ExitStack
from dataclasses import asdict
from functools import partial
from importlib.metadata import version
from importlib.util import find_spec
from statistics import median
from textwrap import fill
from typing import Any, Literal

import torch
from tqdm.auto import tqdm

from offairl_lite.core.acceleration import Execution
from offairl_lite.envs import TASKS
from offairl_lite.runs.contestants import (
    DEMO,
    MEMBERS,
    PAPER,
    SMALL,
    TASK,
    Contestant,
    Learner,
    Options,
    environment_steps,
    kept_to_cores,
    other_steps,
    our_products,
    our_steps,
    our_updates,
    ours,
    race,
)
from offairl_lite.runs.estimate import estimate as estimate
from offairl_lite.runs.provenance import PACKAGES, processor

OTHERS = {"sb3": ("stable-baselines3", "stable_baselines3"), "sbx": ("sbx-rl", "sbx")}
"""The names of the other libraries, for pip and for Python."""

STEP_TARGETS = (
    (ours(SMALL, 100), Learner("sb3", SMALL, 100), 1.6),
    (ours(SMALL, 100), Learner("sbx", SMALL, 100), 1.0),
    (ours(SMALL, 100), Learner("sb3", SMALL, 256), 2.4),
    (ours(PAPER, 100), Learner("sb3", SMALL, 256), 1.7),
)
"""How many times as many steps as the second the first should make."""


def two_processes(options: Options) -> dict[str, float]:
    """Return the rate of one process and of two at once, their ratio, and one's peak memory."""
    command = [sys.executable, "-m", "offairl_lite.runs.bench", json.dumps(asdict(options))]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}

    def turn(*processes: subprocess.Popen) -> list[dict[str, float]]:
        for process in processes:
            print(options.seconds, file=process.stdin, flush=True)
        answers = [process.stdout.readline() for process in processes]
        if not all(answers):
            raise RuntimeError("a process of the benchmark has died; its last words are above")
        return [json.loads(answer) for answer in answers]

    one, two = [], []
    with ExitStack() as stack:
        pair = [stack.enter_context(subprocess.Popen(command, **pipes)) for _ in range(2)]
        turn(*pair)  # so that both are there
        for _ in tqdm(range(options.rounds), desc="two processes", leave=False):
            alone, together = turn(pair[0]) + turn(pair[1]), turn(*pair)
            one.append(sum(answer["rate"] for answer in alone) / 2)
            two.append(sum(answer["rate"] for answer in together))
    return {
        "one": median(one),
        "two": median(two),
        "ratio": median(b / a for a, b in zip(one, two, strict=True)),
        "memory_mib": max(answer["memory_mib"] for answer in together),
    }


def serve(options: Options) -> None:
    """Be one of two processes: take a turn for each line that comes in, of so many seconds."""
    torch.set_num_threads(options.threads)
    contestant = our_updates(options, options.learners[-1], max(options.populations))
    for line in sys.stdin:
        rate = contestant.turn(float(line))
        print(json.dumps({"rate": rate, "memory_mib": peak_memory()}), flush=True)


def peak_memory(device: str = "cpu") -> float:
    """Return the most memory that this process has held, in MiB."""
    if device == "cuda":
        return torch.cuda.max_memory_allocated() / 2**20
    unit = 1 if sys.platform == "darwin" else 2**10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20


def measure(options: Options) -> dict[str, Any]:
    """Measure everything.

    Returns:
        What `offairl bench --json` prints:

        - `machine`, `versions`, `options`;
        - `updates`: see `update_row`, for each network and population;
        - `steps`: of each learner, per second; `environments`: steps of each task, per second;
        - `processes`: updates per second of one and of two at once, their ratio, and the most
          memory that one has held; null on a GPU;
        - `memory_mib`: the most that this process has held, on the device;
        - `targets`: ratios, with what they are meant to be.

    Raises:
        ValueError: something that `options` needs is not there.
    """
    for package, module in (OTHERS[name] for name in options.against):
        if find_spec(module) is None:
            raise ValueError(f"{package} is not installed: pip install -e '.[bench]', in a clone")
    Execution(options.device, options.threads, options.compile)  # refuses what is not there
    torch.set_num_threads(options.threads)
    # First, while this process is small: Linux counts what it holds among its children's peak.
    processes = two_processes(options) if options.device == "cpu" else None
    sizes = [(learner, n) for learner in options.learners for n in options.populations]
    sizes = list(dict.fromkeys([*sizes, (DEMO, 1), (DEMO, 5)]))
    works = {"updates": our_updates, "products": our_products}
    makers = {
        (kind, *size): partial(works[kind], options, *size) for size in sizes for kind in works
    }
    steps = {learner: partial(our_steps, options, learner) for learner in options.learners}
    steps |= {learner: partial(other_steps, options, learner) for learner in options.opponents}
    with kept_to_cores(options.threads):
        made = race("training", makers | steps, options.rounds, options.seconds)
    makers = {task: partial(environment_steps, options, task) for task in TASKS}
    environments = race("environments", makers, options.rounds, options.seconds / 2)
    packages = [*PACKAGES, *(OTHERS[name][0] for name in options.against)]
    updates = {size: update_row(*size, *(made[kind, *size] for kind in works)) for size in sizes}
    return {
        "machine": {
            "processor": processor(),
            "cores": os.cpu_count(),
            "gpu": torch.cuda.get_device_name() if options.device == "cuda" else None,
        },
        "versions": {"python": platform.python_version(), **{p: version(p) for p in packages}},
        "options": asdict(options),
        "updates": list(updates.values()),
        "steps": [{**key._asdict(), "steps_per_s": made[key].rate} for key in steps],
        "environments": {task: env.rate for task, env in environments.items()},
        "processes": processes,
        "memory_mib": peak_memory(options.device),
        "targets": ratios(made, updates, processes),
    }


def update_row(
    learner: Learner, members: int, updates: Contestant, products: Contestant
) -> dict[str, Any]:
    """Return how long combined updates take, and what of it their products would take alone.

    `updates_per_s` is of all members together, and `ms` is the time of one update of all; `flop` is
    of one member's update.
    """
    flop = products.amount / updates.amount
    return {
        "hidden": learner.hidden,
        "batch_size": learner.batch_size,
        "population": members,
        "updates_per_s": updates.rate,
        "ms": 1e3 * members / updates.rate,
        "products_ms": 1e3 * members * flop / products.rate,
        "flop": flop,
        "products_flop_per_s": products.rate,
        "products_share": updates.over(products) * flop,
    }


def ratios(
    made: dict[Any, Contestant],
    updates: dict[tuple[Learner, int], dict[str, Any]],
    processes: dict[str, float] | None,
) -> list[dict[str, Any]]:
    """Return the ratios that were measured, beside what they are meant to be."""
    found = [
        _target(f"{one} / {other}", made[one].over(made[other]), ">=", factor)
        for one, other, factor in STEP_TARGETS
        if one in made and other in made
    ]
    for (learner, members), row in updates.items():
        if learner != DEMO:
            what = f"share of products, {learner.layers}, population {members}"
            found.append(_target(what, row["products_share"], ">=", 0.5))
    slower = 5 * made["updates", DEMO, 1].over(made["updates", DEMO, 5])
    found.append(_target("time of five members / of one, demo size", slower, "<=", 1.5))
    if processes is not None:
        found.append(_target("two processes / one", processes["ratio"], ">=", 1.9))
    return found


def _target(what: str, measured: float, sense: Literal[">=", "<="], target: float) -> dict:
    met = measured >= target if sense == ">=" else measured <= target
    return {"what": what, "measured": measured, "sense": sense, "target": target, "met": met}


def table(report: dict[str, Any]) -> str:
    """Lay a report out for people."""
    machine, options, processes = (report[x] for x in ("machine", "options", "processes"))
    versions = ", ".join(f"{name} {number}" for name, number in report["versions"].items())
    lines = [
        f"{machine['processor']}, cores: {machine['cores']}, threads used: {options['threads']}, "
        f"GPU used: {machine['gpu'] or 'none'}",
        fill(versions, 100),
        f"{TASK}; rounds: {options['rounds']}, a turn: {options['seconds']} s or more",
        "",
        "Combined updates, of the discriminator and SAC, and their matrix products alone",
        "  network  batch  members  updates/s       ms   MFLOP   GFLOP/s  products ms  share",
    ]
    for row in report["updates"]:
        lines.append(
            f"{ours(row['hidden'], 0).layers:>9} {row['batch_size']:6} {row['population']:8} "
            f"{row['updates_per_s']:10.0f} {row['ms']:8.2f} {row['flop'] / 1e6:7.0f} "
            f"{row['products_flop_per_s'] / 1e9:9.0f} {row['products_ms']:12.2f} "
            f"{row['products_share']:6.2f}"
        )
    lines += ["", "Whole steps, of one member; only offairl-lite trains a discriminator, too"]
    for row in report["steps"]:
        learner = Learner(row["name"], row["hidden"], row["batch_size"])
        lines.append(_line(learner, row["steps_per_s"], "steps/s"))
    lines += ["", f"Environments alone, {MEMBERS} members"]
    lines += [_line(task, rate, "steps/s") for task, rate in report["environments"].items()]
    if processes is not None:
        lines += [
            "",
            f"Two processes with {max(options['populations'])} members each",
            _line("one alone", processes["one"], "updates/s"),
            _line("both together", processes["two"], "updates/s"),
            _line("peak memory of one", processes["memory_mib"], "MiB"),
        ]
    where = " on the GPU" if machine["gpu"] else ""
    lines += ["", f"Peak memory of this process{where}: {report['memory_mib']:.0f} MiB", ""]
    lines.append(f"{'Ratios':72} measured  target")
    for row in report["targets"]:
        lines.append(
            f"  {row['what']:70} {row['measured']:8.2f} {row['sense']} {row['target']:.2f}"
            + "  missed" * (not row["met"])
        )
    return "\n".join(lines)


def _line(what: object, number: float, unit: str) -> str:
    return f"  {what!s:34} {number:8.0f} {unit}"


if __name__ == "__main__":
    serve(Options(**json.loads(sys.argv[1])))
