"""How fast this is, on the machine at hand: the command `offairl bench`.

Machines differ, and one machine differs from hour to hour. So the contestants take turns, round
after round: a rate is the median over the rounds, and what counts are ratios, each the median of
the ratios within a round. Everything runs on one thread unless asked otherwise, because a second
one is better spent on a process with other seeds; and on Linux whatever trains is kept to one core,
because JAX, asked for one thread, still uses a second. On HalfCheetah are measured:

- *Combined updates*: one of the discriminator, with its penalty, and one of SAC, whose actor
  learns every second time, in blocks as in training; compiled, where there is a compiler. One
  member is held up by thin products and by what remains of calls; many members by element-wise
  work, above all Adam's, which waits for memory. At demo size nothing is compiled, for that takes
  longer than the run: one member's time then goes to calling some four hundred small operations,
  whatever their size. Five members are called as often, so that what they cost more is their
  arithmetic, the products and the activations: the faster the processor at these, the less.
- *Products*: the matrix products of these updates alone, at exactly their shapes, back to back.
  They are the floor of the updates' time, and the share that they have in it is shown. What the
  machine makes of them depends on the shapes: first layers are thin, and slow. A layer with one
  output is a sum, and not counted.
- *Whole steps*: one step of the environment, which is physics, and one combined update. Beside
  them, on the same environment, with the same hidden layers and batch, Stable-Baselines3 or SBX:
  one step and one update of SAC, without a discriminator. The rest is at their defaults; the
  actor, for instance, learns every time. A tenth of our time goes to acting and physics, the rest
  to the updates. Stable-Baselines3 is held up by calls, SBX as we are by its products.
- *Environments* alone: ten members of each built-in task, under random actions.
- *Two processes* with the largest population, against one of them alone, on the CPU only. They
  share the memory's bandwidth and the last level of cache, and nothing else.
- *Memory*: the most that one such process has held, and this one with all its contestants; on a
  GPU, what PyTorch has held there.
"""

import json
import os
import platform
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from importlib.metadata import version
from importlib.util import find_spec
from statistics import median
from textwrap import fill
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils.flop_counter import flop_registry
from tqdm.auto import tqdm

from offairl_lite import envs
from offairl_lite.config import CORRECTED, Config
from offairl_lite.core.acceleration import Execution, compiler
from offairl_lite.core.loop import CHUNK, Trainer
from offairl_lite.core.replay import Batch
from offairl_lite.core.rng import Streams
from offairl_lite.demonstrations import Demonstrations
from offairl_lite.envs import TASKS, BatchedEnv
from offairl_lite.runs.provenance import PACKAGES, processor

TASK = "HalfCheetah-v5"
MEMBERS = 10
"""Members of an environment that is timed alone."""

OTHERS = {"sb3": ("stable-baselines3", "stable_baselines3"), "sbx": ("sbx-rl", "sbx")}
"""What the others are called by pip, and by Python."""


class Learner(NamedTuple):
    """Whose SAC, with which hidden layers and batch."""

    name: str
    hidden: tuple[int, ...]
    batch_size: int

    def __str__(self) -> str:
        return f"{self.name} {_dashed(self.hidden)}, batch {self.batch_size}"


ours = partial(Learner, "offairl-lite")
SMALL, PAPER = (256, 256), (400, 300)
DEMO = ours((64, 64), 64)
"""Demo scale; its discriminator is 64-64 as well. All others' is the paper's."""

STEP_TARGETS = (
    (ours(SMALL, 100), Learner("sb3", SMALL, 100), 1.6),
    (ours(SMALL, 100), Learner("sbx", SMALL, 100), 1.0),
    (ours(SMALL, 100), Learner("sb3", SMALL, 256), 2.4),
    (ours(PAPER, 100), Learner("sb3", SMALL, 256), 1.7),
)
"""How many times the second's steps the first is meant to make."""


@dataclass(frozen=True)
class Options:
    """What is measured, and for how long."""

    hidden: tuple[int, ...] | None = None
    """Hidden layers of actor and critics; by default 256 256, and then the paper's 400 300."""

    batch_size: int = 100
    """Transitions from the demonstrations, and as many from replay, in one update."""

    populations: tuple[int, ...] = (1, 2, 5, 10)
    """Numbers of members whose updates are measured."""

    against: tuple[Literal["sb3", "sbx"], ...] = ()
    """Whose SAC to measure beside ours, at the first network: that of Stable-Baselines3 (at its
    own batch of 256 as well), that of SBX."""

    device: Literal["cpu", "cuda"] = "cpu"
    """Where our networks and replay live; the others' stay on the CPU."""

    compile: bool = field(default_factory=lambda: compiler() is not None)
    """Whether our updates are compiled, by default where there is a compiler; those at demo size
    never are."""

    threads: int = 1
    """Of PyTorch, of JAX and of the physics."""

    rounds: int = 5
    """How often each contestant has its turn."""

    seconds: float = 1.0
    """How long a turn takes at least."""

    def __post_init__(self) -> None:
        for name in ("batch_size", "threads", "rounds", "seconds"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} is {getattr(self, name)!r}; expected a positive number")
        for name in ("hidden", "populations"):
            value = getattr(self, name)
            if value is not None and not (value and min(value) > 0):
                raise ValueError(f"{name} is {value!r}; expected one or more positive numbers")

    @property
    def learners(self) -> list[Learner]:
        """Ours, of each network."""
        return [
            ours(h, self.batch_size) for h in ([self.hidden] if self.hidden else [SMALL, PAPER])
        ]

    @property
    def opponents(self) -> list[Learner]:
        """The others'."""
        hidden = self.learners[0].hidden
        own = [Learner("sb3", hidden, 256)] if "sb3" in self.against else []
        return [Learner(name, hidden, self.batch_size) for name in self.against] + own


@dataclass
class Contestant:
    """Something that takes turns with others.

    Args:
        act: does a piece of work.
        amount: how much of what is counted that is.
    """

    act: Callable[[], object]
    amount: float
    rates: list[float] = field(default_factory=list)

    def turn(self, seconds: float) -> float:
        """Act for some time; note and return the amount per second."""
        start, times, elapsed = time.perf_counter(), 0, 0.0
        while times == 0 or elapsed < seconds:
            self.act()
            if torch.cuda.is_initialized():
                torch.cuda.synchronize()
            times, elapsed = times + 1, time.perf_counter() - start
        self.rates.append(times * self.amount / elapsed)
        return self.rates[-1]

    @property
    def rate(self) -> float:
        """The median over the rounds."""
        return median(self.rates)

    def over(self, other: "Contestant") -> float:
        """Return how many times as fast as another, by the median over the rounds."""
        return median(a / b for a, b in zip(self.rates, other.rates, strict=True))


def race(
    what: str, makers: dict[Any, Callable[[], Contestant]], rounds: int, seconds: float
) -> dict[Any, Contestant]:
    """Make all contestants, and let each have its turn in every round."""
    bar = partial(tqdm, leave=False)
    made = {key: make() for key, make in bar(makers.items(), desc=f"{what}: preparing")}
    for contestant in bar([*made.values()] * rounds, desc=what):
        contestant.turn(seconds)
    return made


def random_demonstrations(env_id: str, rows: int = 1000) -> Demonstrations:
    """Return one trajectory of numbers with the sizes of a task's, and nothing else of it."""
    env, streams = envs.make(env_id, 1, 0), Streams([0])
    obs_dim, action_dim = env.single_observation_space.shape[0], env.single_action_space.shape[0]
    parts = (streams.normal(rows, width)[0] for width in (obs_dim, action_dim, obs_dim))
    zero = torch.zeros(rows)
    return Demonstrations(env_id, Batch(*parts, reward=zero, terminated=zero), (rows,))


def make_trainer(options: Options, learner: Learner, population: int, every: int) -> Trainer:
    """Return a trainer on random demonstrations, which trains after every `every` steps.

    The first of them are random.
    """
    discriminator = DEMO.hidden if learner == DEMO else CORRECTED.reward_hidden
    config = replace(
        CORRECTED,
        env_id=TASK,
        hidden=learner.hidden,
        reward_hidden=discriminator,
        shaping_hidden=discriminator,
        batch_size=learner.batch_size,
        temperature=None,  # learned, as the others learn theirs
        warmup_steps=every,
        update_every=every,
        replay_size=100_000,
        total_steps=10**9,
        eval_every=10**9,
    )
    return Trainer(
        config,
        range(population),
        random_demonstrations(TASK),
        execution=Execution(
            options.device,
            options.threads,
            options.compile and learner != DEMO,
            onednn=options.device == "cpu" and learner != DEMO,
        ),
    )


def next_block(trainer: Trainer) -> None:
    """Go on until the next block has been trained on."""
    before = trainer.trained
    while trainer.trained == before:
        trainer.advance()


def estimate(config: Config, members: int) -> float:
    """Return about how many seconds a run takes here, by one process on one core, not compiled.

    A block of training and an episode's evaluation are timed, with random demonstrations where a
    reward is learned; a policy that keeps on its legs for longer takes longer to evaluate.
    """
    every = config.update_every if config.generator == "ppo" else 20
    short = replace(
        config,
        reward="environment" if config.reward == "frozen" else config.reward,
        carry="nothing",
        start_steps=0,
        warmup_steps=every,
        update_every=every,
        total_steps=10**9,
        eval_every=10**9,
        eval_episodes=1,
        replay_size=max(10_000, every),
    )
    shown = random_demonstrations(config.env_id)
    with closing(Trainer(short, range(members), shown)) as trainer:
        next_block(trainer)
        starts = time.perf_counter()
        next_block(trainer)
        trained = time.perf_counter()
        trainer.evaluate()
        evaluated = time.perf_counter()
    evaluation = (evaluated - trained) * config.eval_episodes
    per_step = (trained - starts) / every + evaluation / config.eval_every
    return config.total_steps * per_step


def our_updates(options: Options, learner: Learner, population: int) -> Contestant:
    """Return combined updates; those of all members count."""
    trainer = make_trainer(options, learner, population, CHUNK)
    next_block(trainer)
    return Contestant(partial(trainer.train, CHUNK), CHUNK * population)


class Products(TorchDispatchMode):
    """Records the matrix products that are made under it, and what they cost: `flop`."""

    def __init__(self) -> None:
        super().__init__()
        self.flop = 0
        self._calls: list[tuple] = []
        self._operands: dict[tuple, tuple[list[Tensor], Tensor]] = {}

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        """Let an operation do its work; take a note where it is a product."""
        kwargs = kwargs or {}
        result, operation = func(*args, **kwargs), func.overloadpacket
        if operation in flop_registry:
            self.flop += flop_registry[operation](*args, **kwargs, out_val=result)
            call = operation, *((x.shape, x.stride()) for x in args)
            self._calls.append(call)
            if call not in self._operands:
                generator = torch.Generator(result.device).manual_seed(0)
                drawn = [torch.empty_like(x).normal_(generator=generator) for x in args]
                self._operands[call] = drawn, torch.empty_like(result)
        return result

    @torch.no_grad()
    def again(self) -> None:
        """Make the same products of random operands, into memory that is there already."""
        for call in self._calls:
            operands, out = self._operands[call]
            call[0].out(*operands, out=out)


def our_products(options: Options, learner: Learner, population: int) -> Contestant:
    """Return the products alone of a block of combined updates, made eagerly; FLOP count."""
    trainer = make_trainer(replace(options, compile=False), learner, population, CHUNK)
    products = Products()
    again = trainer.execution.widen(products.again)  # tries oneDNN, which is not to be counted
    with products:
        next_block(trainer)
    return Contestant(again, products.flop)


def our_steps(options: Options, learner: Learner) -> Contestant:
    """Return our whole loop, with one member."""
    trainer = make_trainer(options, learner, 1, 2 * CHUNK)
    next_block(trainer)
    return Contestant(partial(next_block, trainer), 2 * CHUNK)


def other_steps(options: Options, learner: Learner) -> Contestant:
    """Return another library's loop, compiled and past its warm-up."""
    if learner.name == "sbx":
        # JAX would take every core. This is where it looks, once, when it starts.
        os.putenv("NPROC", str(options.threads))
        os.putenv("XLA_FLAGS", f"--xla_cpu_multi_thread_eigen={options.threads > 1}".lower())
        from sbx import SAC
    else:
        from stable_baselines3 import SAC
    model = SAC(
        "MlpPolicy",
        TASK,
        batch_size=learner.batch_size,
        train_freq=1,
        gradient_steps=1,
        policy_kwargs={"net_arch": list(learner.hidden)},
        device="cpu",
    )
    learn = partial(model.learn, log_interval=None, reset_num_timesteps=False)
    learn(model.learning_starts + CHUNK)
    return Contestant(partial(learn, CHUNK), CHUNK)


@contextmanager
def kept_to_cores(number: int) -> Iterator[None]:
    """Keep this thread, and those it starts meanwhile, to so many cores, where the system can.

    JAX, asked for one thread, works on a second one besides. On one core it has to share.
    """
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, sorted(before)[-number:])
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def environment_steps(options: Options, task: str) -> Contestant:
    """Return a task's environment alone; steps of all members count."""
    env = BatchedEnv(task, MEMBERS, seeds=range(MEMBERS), num_threads=options.threads)
    env.reset()
    low, high = env.action_space.low, env.action_space.high
    actions = np.random.default_rng(0).uniform(low, high, (CHUNK, *low.shape)).astype(low.dtype)

    def act() -> None:
        for action in actions:
            env.step(action)

    return Contestant(act, CHUNK * MEMBERS)


def two_processes(options: Options) -> dict[str, float]:
    """Return the rate of one process and of two at once, their ratio, and one's peak memory."""
    command = [sys.executable, "-m", "offairl_lite.runs.bench", json.dumps(asdict(options))]
    start = partial(
        subprocess.Popen, command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )

    def turn(*processes: subprocess.Popen) -> list[dict[str, float]]:
        for process in processes:
            print(options.seconds, file=process.stdin, flush=True)
        answers = [process.stdout.readline() for process in processes]
        if not all(answers):
            raise RuntimeError("a process of the benchmark has died; its last words are above")
        return [json.loads(answer) for answer in answers]

    one, two = [], []
    with ExitStack() as stack:
        pair = [stack.enter_context(start()) for _ in range(2)]
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
        - `updates`: for each network and population the updates per second of all members
          together, milliseconds of one update and of its products alone, FLOP of one member's
          update, FLOP per second of the products alone, and their share of the time;
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
    makers: dict[Any, Callable[[], Contestant]] = {}
    for size in sizes:
        makers["updates", *size] = partial(our_updates, options, *size)
        makers["products", *size] = partial(our_products, options, *size)
    makers |= {learner: partial(our_steps, options, learner) for learner in options.learners}
    makers |= {learner: partial(other_steps, options, learner) for learner in options.opponents}
    with kept_to_cores(options.threads):
        made = race("training", makers, options.rounds, options.seconds)
    makers = {task: partial(environment_steps, options, task) for task in TASKS}
    environments = race("environments", makers, options.rounds, options.seconds / 2)

    learners = {key: made[key] for key in made if isinstance(key, Learner)}
    targets = [
        _target(f"{one} / {other}", learners[one].over(learners[other]), ">=", factor)
        for one, other, factor in STEP_TARGETS
        if one in learners and other in learners
    ]
    updates = []
    for learner, n in sizes:
        update, products = made["updates", learner, n], made["products", learner, n]
        flop = products.amount / update.amount
        share = update.over(products) * flop
        row = {
            "hidden": learner.hidden,
            "batch_size": learner.batch_size,
            "population": n,
            "updates_per_s": update.rate,
            "ms": 1e3 * n / update.rate,
            "products_ms": 1e3 * n * flop / products.rate,
            "flop": flop,
            "products_flop_per_s": products.rate,
            "products_share": share,
        }
        updates.append(row)
        if learner != DEMO:
            what = f"share of products, {_dashed(learner.hidden)}, population {n}"
            targets.append(_target(what, share, ">=", 0.5))
    slower = 5 * made["updates", DEMO, 1].over(made["updates", DEMO, 5])
    targets.append(_target("time of five members / of one, demo size", slower, "<=", 1.5))
    if processes is not None:
        targets.append(_target("two processes / one", processes["ratio"], ">=", 1.9))
    packages = [*PACKAGES, *(OTHERS[name][0] for name in options.against)]
    return {
        "machine": {
            "processor": processor(),
            "cores": os.cpu_count(),
            "gpu": torch.cuda.get_device_name() if options.device == "cuda" else None,
        },
        "versions": {"python": platform.python_version(), **{p: version(p) for p in packages}},
        "options": asdict(options),
        "updates": updates,
        "steps": [{**key._asdict(), "steps_per_s": made[key].rate} for key in learners],
        "environments": {task: env.rate for task, env in environments.items()},
        "processes": processes,
        "memory_mib": peak_memory(options.device),
        "targets": targets,
    }


def _target(what: str, measured: float, sense: Literal[">=", "<="], target: float) -> dict:
    met = measured >= target if sense == ">=" else measured <= target
    return {"what": what, "measured": measured, "sense": sense, "target": target, "met": met}


def _dashed(layers: Sequence[int]) -> str:
    return "-".join(map(str, layers))


def table(report: dict[str, Any]) -> str:
    """Lay a report out for people."""
    machine, options = report["machine"], report["options"]
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
            f"{_dashed(row['hidden']):>9} {row['batch_size']:6} {row['population']:8} "
            f"{row['updates_per_s']:10.0f} {row['ms']:8.2f} {row['flop'] / 1e6:7.0f} "
            f"{row['products_flop_per_s'] / 1e9:9.0f} {row['products_ms']:12.2f} "
            f"{row['products_share']:6.2f}"
        )
    lines += ["", "Whole steps, of one member; only offairl-lite trains a discriminator, too"]
    for row in report["steps"]:
        name = Learner(row["name"], row["hidden"], row["batch_size"])
        lines.append(f"  {name!s:34} {row['steps_per_s']:8.0f} steps/s")
    lines += ["", f"Environments alone, {MEMBERS} members"]
    for task, rate in report["environments"].items():
        lines.append(f"  {task:34} {rate:8.0f} steps/s")
    processes = report["processes"]
    if processes is not None:
        lines += [
            "",
            f"Two processes with {max(options['populations'])} members each",
            f"  {'one alone':34} {processes['one']:8.0f} updates/s",
            f"  {'both together':34} {processes['two']:8.0f} updates/s",
            f"  {'peak memory of one':34} {processes['memory_mib']:8.0f} MiB",
        ]
    lines += [
        "",
        f"{'Peak memory of this process' + ' on the GPU' * bool(machine['gpu']):39} "
        f"{report['memory_mib']:5.0f} MiB",
        "",
        f"{'Ratios':72} measured  target",
    ]
    for row in report["targets"]:
        lines.append(
            f"  {row['what']:70} {row['measured']:8.2f} {row['sense']} {row['target']:.2f}"
            + "  missed" * (not row["met"])
        )
    return "\n".join(lines)


if __name__ == "__main__":
    serve(Options(**json.loads(sys.argv[1])))
