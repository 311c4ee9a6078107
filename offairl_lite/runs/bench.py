"""How fast the package trains on this machine: `offairl bench`, and how long a run would take.

Machines differ, and one machine differs from hour to hour. So the contestants take turns, round
after round, in one process. On Linux it is kept to one core, unless you ask for more threads. Rates
are medians over the rounds; the ratios, which are what counts, are medians of the ratios within a
round. On HalfCheetah there are:

- *updates*: of the discriminator, with its penalty, and of SAC, in blocks as in training, compiled
  where there is a compiler;
- *products*: the matrix products of these updates alone, one after the other. An update cannot be
  faster than they are. A layer with one output is a sum and does not count;
- *steps*: of the environment, with an update each. With `--against`, the SAC of Stable-Baselines3
  or SBX steps on the same environment, with the same hidden layers and batch, and otherwise its
  own defaults: it trains no discriminator, and its actor learns every time.
"""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from statistics import median
from typing import Any, Literal

import torch
from gymnasium.spaces.utils import flatdim
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils.flop_counter import flop_registry
from tqdm.auto import tqdm

from offairl_lite import envs
from offairl_lite.config import CORRECTED, Config
from offairl_lite.core.acceleration import Execution, compiler
from offairl_lite.core.fitting import CHUNK
from offairl_lite.core.loop import Trainer
from offairl_lite.core.replay import Batch
from offairl_lite.core.rng import Rng
from offairl_lite.demonstrations import Demonstrations
from offairl_lite.runs.records import origin

TASK, BATCH = "HalfCheetah-v5", 100
OTHERS = {"sb3": ("stable-baselines3", "stable_baselines3"), "sbx": ("sbx-rl", "sbx")}
"""The names of the other libraries, for pip and for Python."""


@dataclass(frozen=True)
class Options:
    """What is measured, and for how long.

    Args:
        hidden: layers of actor and critics; by default 256 256, and then the paper's 400 300.
        populations: numbers of members whose updates are measured.
        against: whose SAC to measure beside ours, at the first network: that of Stable-Baselines3
            (at its own batch of 256 as well), that of SBX.
        device: where our networks and replay live; the others' stay on the CPU.
        compile: whether our updates are compiled, by default where there is a compiler.
        threads: of PyTorch, of JAX and of the physics.
        rounds: how often each contestant has its turn.
        seconds: how long a turn takes at least.
    """

    hidden: tuple[int, ...] | None = None
    populations: tuple[int, ...] = (1, 2, 5, 10)
    against: tuple[Literal["sb3", "sbx"], ...] = ()
    device: Literal["cpu", "cuda"] = "cpu"
    compile: bool = field(default_factory=lambda: compiler() is not None)
    threads: int = 1
    rounds: int = 5
    seconds: float = 1.0

    def require_positive(self) -> None:
        """Raise ValueError unless all numbers are positive."""
        for name in ("hidden", "populations", "threads", "rounds", "seconds"):
            value = getattr(self, name)
            numbers = value if isinstance(value, tuple) else (value,)
            if value is not None and not (numbers and min(numbers) > 0):
                raise ValueError(f"{name} is {value!r}; expected positive numbers")


@dataclass
class Contestant:
    """Something that takes turns with others: `act` does an amount of work."""

    act: Callable[[], object]
    amount: float
    rates: list[float] = field(default_factory=list)
    cpu_s: list[float] = field(default_factory=list)

    def turn(self, seconds: float) -> None:
        """Act for some time; note the amount per second, and the CPU's seconds for each unit."""
        start, cpu, times, elapsed = time.perf_counter(), time.process_time(), 0, 0.0
        while times == 0 or elapsed < seconds:
            self.act()
            if torch.cuda.is_initialized():
                torch.cuda.synchronize()
            times, elapsed = times + 1, time.perf_counter() - start
        self.rates.append(times * self.amount / elapsed)
        self.cpu_s.append((time.process_time() - cpu) / (times * self.amount))


def endless(options: Options, hidden: tuple[int, ...], members: int, every: int) -> Trainer:
    """Return a trainer on random demonstrations, with blocks of `every` steps; one is random."""
    config = CORRECTED.change(
        env_id=TASK,
        hidden=hidden,
        batch_size=BATCH,
        temperature=None,  # learned, as in the other libraries
        warmup_steps=every,
        update_every=every,
        replay_size=100_000,
        total_steps=10**9,
        eval_every=10**9,
    )
    how = Execution(options.device, options.threads, options.compile, options.device == "cpu")
    return Trainer(config, range(members), random_demonstrations(TASK), execution=how)


def random_demonstrations(env_id: str, rows: int = 1000) -> Demonstrations:
    """Return one trajectory of random numbers, of the same sizes as the task's."""
    with closing(envs.make(env_id, 1, 0)) as env:
        obs, action = flatdim(env.single_observation_space), flatdim(env.single_action_space)
    rng, zero = Rng([0]), torch.zeros(rows)
    now, decided, after = (rng.normal(rows, width)[0] for width in (obs, action, obs))
    return Demonstrations(env_id, Batch(now, decided, after, zero, zero), (rows,))


def trained_blocks(trainer: Trainer) -> Iterator[None]:
    """Run a trainer and yield each time that it has trained on a block of steps."""
    trained = trainer.trained
    for _ in trainer.run():
        if trainer.trained > trained:
            trained = trainer.trained
            yield


def our_updates(options: Options, hidden: tuple[int, ...], members: int) -> Contestant:
    """Return combined updates; those of all members count."""
    trainer = endless(options, hidden, members, CHUNK)
    next(trained_blocks(trainer))
    return Contestant(partial(trainer.fit, CHUNK), CHUNK * members)


class Products(TorchDispatchMode):
    """Records the matrix products that are made under it."""

    def __init__(self) -> None:
        super().__init__()
        self.calls: list[tuple] = []
        self.operands: dict[tuple, tuple[list[Tensor], Tensor]] = {}

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        """Let an operation do its work; take a note where it is a product."""
        kwargs = kwargs or {}
        result, operation = func(*args, **kwargs), func.overloadpacket
        if operation in flop_registry:
            call = operation, *((x.shape, x.stride()) for x in args)
            self.calls.append(call)
            if call not in self.operands:
                generator = torch.Generator(result.device).manual_seed(0)
                drawn = [torch.empty_like(x).normal_(generator=generator) for x in args]
                self.operands[call] = drawn, torch.empty_like(result)
        return result

    @torch.no_grad()
    def again(self) -> None:
        """Make the same products of random operands, into memory that is there already."""
        for call in self.calls:
            operands, out = self.operands[call]
            call[0].out(*operands, out=out)


def our_products(options: Options, hidden: tuple[int, ...], members: int) -> Contestant:
    """Return the products alone of as many combined updates, made eagerly."""
    trainer = endless(replace(options, compile=False), hidden, members, CHUNK)
    products = Products()
    again = trainer.execution.widen(products.again)  # tries oneDNN, which is not to be counted
    with products:
        next(trained_blocks(trainer))
    return Contestant(again, CHUNK * members)


def our_steps(options: Options, hidden: tuple[int, ...]) -> Contestant:
    """Return our whole loop, with one member."""
    blocks = trained_blocks(endless(options, hidden, 1, 2 * CHUNK))
    next(blocks)
    return Contestant(partial(next, blocks), 2 * CHUNK)


def other_steps(name: str, hidden: tuple[int, ...], batch_size: int) -> Contestant:
    """Return another library's loop, compiled and past its warm-up."""
    SAC = import_module(OTHERS[name][1]).SAC
    networks = {"policy_kwargs": {"net_arch": [*hidden]}, "batch_size": batch_size}
    model = SAC("MlpPolicy", TASK, train_freq=1, gradient_steps=1, device="cpu", **networks)
    learn = partial(model.learn, log_interval=None, reset_num_timesteps=False)
    learn(model.learning_starts + CHUNK)
    return Contestant(partial(learn, CHUNK), CHUNK)


def measure(options: Options) -> dict[str, Any]:
    """Measure everything: what `offairl bench --json` prints.

    Beside `origin` and `options` these are the `rates` of each contestant: how much a second, the
    CPU's milliseconds for each, and a ratio. That of updates is the share of their time that their
    products alone would take; that of another library's steps, how many times as fast ours are.
    """
    for package, module in (OTHERS[name] for name in options.against):
        if find_spec(module) is None:
            raise ValueError(f"{package} is not installed: pip install -e '.[bench]', in a clone")
    execution = Execution(options.device, options.threads, options.compile)
    torch.set_num_threads(options.threads)
    if hasattr(os, "sched_setaffinity"):  # JAX uses a second core even if it is told not to.
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-options.threads :])
    networks = [options.hidden] if options.hidden else [(256, 256), (400, 300)]
    makers: dict[str, Callable[[], Contestant]] = {}
    rivals: dict[str, tuple[str, str]] = {}
    for hidden in networks:
        ours = f"offairl-lite {'-'.join(map(str, hidden))}, batch {BATCH}"
        for n in options.populations:
            title, alone = f"updates, {ours}, members {n}", f"products, {ours}, members {n}"
            makers[title] = partial(our_updates, options, hidden, n)
            makers[alone] = partial(our_products, options, hidden, n)
            rivals[title] = title, alone
        makers[f"steps, {ours}"] = partial(our_steps, options, hidden)
    first, layers = networks[0], "-".join(map(str, networks[0]))
    for name in options.against:
        for batch_size in (BATCH, 256) if name == "sb3" else (BATCH,):
            title = f"steps, {name} {layers}, batch {batch_size}"
            makers[title] = partial(other_steps, name, first, batch_size)
            rivals[title] = f"steps, offairl-lite {layers}, batch {BATCH}", title
    made = {title: make() for title, make in tqdm(makers.items(), desc="preparing", leave=False)}
    for contestant in tqdm([*made.values()] * options.rounds, desc="measuring", leave=False):
        contestant.turn(options.seconds)
    rates: dict[str, dict[str, float]] = {}
    for title, it in made.items():
        rates[title] = {"per_s": median(it.rates), "cpu_ms": 1e3 * median(it.cpu_s)}
        if title in rivals:
            one, other = (made[rival].rates for rival in rivals[title])
            rates[title]["ratio"] = median(a / b for a, b in zip(one, other, strict=True))
    about, others = origin(execution), [OTHERS[name][0] for name in options.against]
    about["versions"] |= {package: version(package) for package in others}
    return {"origin": about, "options": asdict(options), "rates": rates}


def table(report: dict[str, Any]) -> str:
    """Lay a report out for people."""
    about = report["origin"]
    lines = [", ".join(f"{name} {number}" for name, number in about["versions"].items()), ""]
    lines.append(f"{about['processor']:60} a second  CPU ms each  ratio")
    for title, row in report["rates"].items():
        ratio = f"{row['ratio']:6.2f}" if "ratio" in row else ""
        lines.append(f"{title:60} {row['per_s']:8.0f} {row['cpu_ms']:12.3f} {ratio}".rstrip())
    return "\n".join([*lines, "", "A ratio is the share of products, or how much faster ours are."])


def estimate(config: Config, members: int) -> float:
    """Return roughly how many seconds a run takes here, in one process on one core, not compiled.

    We time one block of training and one episode of evaluation, on random demonstrations where a
    reward is learned. A policy that survives longer than the untrained one takes longer to
    evaluate.
    """
    schedule = config.schedule
    every = (config.learner.kind == "ppo" and schedule.update_every) or 20
    short = {"start_steps": 0, "warmup_steps": every, "update_every": every, "eval_episodes": 1}
    short |= {"total_steps": 10**9, "eval_every": 10**9, "replay_size": max(10_000, every)}
    plain = {"reward": "environment", "absorbing": "none"} if config.reward == "frozen" else {}
    fresh = {"pretrained": "nothing"} if config.pretrained != "nothing" else {}
    tried = config.change(**short, **plain, **fresh)
    with closing(Trainer(tried, range(members), random_demonstrations(config.env_id))) as trainer:
        blocks = trained_blocks(trainer)
        next(blocks)  # the warm-up's
        start = time.perf_counter()
        next(blocks)
        trained = time.perf_counter()
        trainer.evaluate()
        evaluated = time.perf_counter()
    evaluation = (evaluated - trained) * schedule.eval_episodes
    return schedule.total_steps * ((trained - start) / every + evaluation / schedule.eval_every)
