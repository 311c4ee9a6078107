"""What `offairl bench` times: pieces of work, which take turns."""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from statistics import median
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils.flop_counter import flop_registry
from tqdm.auto import tqdm

from offairl_lite.config import CORRECTED
from offairl_lite.core.acceleration import Execution, compiler
from offairl_lite.core.fitting import CHUNK
from offairl_lite.core.loop import Trainer
from offairl_lite.envs import BatchedEnv
from offairl_lite.runs.estimate import random_demonstrations, trained_blocks

TASK = "HalfCheetah-v5"
MEMBERS = 10
"""Members of an environment that is timed alone."""


class Learner(NamedTuple):
    """Whose SAC, with which hidden layers and batch."""

    name: str
    hidden: tuple[int, ...]
    batch_size: int

    @property
    def layers(self) -> str:
        """The hidden layers, to be read."""
        return "-".join(map(str, self.hidden))

    def __str__(self) -> str:
        return f"{self.name} {self.layers}, batch {self.batch_size}"


ours = partial(Learner, "offairl-lite")
SMALL, PAPER = (256, 256), (400, 300)
DEMO = ours((64, 64), 64)
"""Demo scale. Its discriminator has layers of 64, too; all others have the paper's."""


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
        layers = [self.hidden] if self.hidden else [SMALL, PAPER]
        return [ours(hidden, self.batch_size) for hidden in layers]

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
        amount: how much work that is, in the unit that is counted.
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


Makers = dict[Any, Callable[[], Contestant]]


def race(what: str, makers: Makers, rounds: int, seconds: float) -> dict[Any, Contestant]:
    """Make all contestants, and let each have its turn in every round."""
    bar = partial(tqdm, leave=False)
    made = {key: make() for key, make in bar(makers.items(), desc=f"{what}: preparing")}
    for contestant in bar([*made.values()] * rounds, desc=what):
        contestant.turn(seconds)
    return made


def make_trainer(options: Options, learner: Learner, population: int, every: int) -> Trainer:
    """Return a trainer on random demonstrations, with blocks of `every` steps; one is random."""
    layers = DEMO.hidden if learner == DEMO else CORRECTED.discriminator.reward_hidden
    config = CORRECTED.change(
        env_id=TASK,
        hidden=learner.hidden,
        reward_hidden=layers,
        shaping_hidden=layers,
        batch_size=learner.batch_size,
        temperature=None,  # learned, as in the other libraries
        warmup_steps=every,
        update_every=every,
        replay_size=100_000,
        total_steps=10**9,
        eval_every=10**9,
    )
    large = learner != DEMO
    execution = Execution(
        options.device,
        options.threads,
        options.compile and large,
        onednn=options.device == "cpu" and large,
    )
    shown = random_demonstrations(TASK)
    return Trainer(config, range(population), shown, execution=execution)


def our_updates(options: Options, learner: Learner, population: int) -> Contestant:
    """Return combined updates; those of all members count."""
    trainer = make_trainer(options, learner, population, CHUNK)
    next(trained_blocks(trainer))
    return Contestant(partial(trainer.fit, CHUNK), CHUNK * population)


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
        next(trained_blocks(trainer))
    return Contestant(again, products.flop)


def our_steps(options: Options, learner: Learner) -> Contestant:
    """Return our whole loop, with one member."""
    blocks = trained_blocks(make_trainer(options, learner, 1, 2 * CHUNK))
    next(blocks)
    return Contestant(partial(next, blocks), 2 * CHUNK)


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
    """Keep this thread, and those it starts meanwhile, to so many cores, where the system can."""
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
    return Contestant(lambda: [env.step(action) for action in actions], CHUNK * MEMBERS)
