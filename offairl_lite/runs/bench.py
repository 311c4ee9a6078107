"""How fast the package trains on this machine: `offairl bench`, and how long a run would take.

Machines differ, and from hour to hour. So all measurements take turns, round after round, in one
process, and rates are medians. On HalfCheetah there are, for each network and number of members:

- *updates*: of discriminator and SAC, in blocks as in training, compiled where that is possible;
- *steps*: with an update each; on request those of another library's SAC, too, which has no
  discriminator to train.
"""

import importlib
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import asdict, dataclass, field
from functools import partial
from itertools import product
from statistics import median
from typing import Any, Literal

import gymnasium
import torch
from gymnasium.spaces.utils import flatdim
from tqdm.auto import tqdm

from offairl_lite import envs
from offairl_lite.config import CORRECTED, Config
from offairl_lite.core.acceleration import Execution, choose_execution, compiler
from offairl_lite.core.loop import Trainer
from offairl_lite.core.replay import CHUNK, Batch
from offairl_lite.core.rng import Rng
from offairl_lite.demonstrations import Demonstrations
from offairl_lite.runs.records import origin

TASK, BATCH = "HalfCheetah-v5", 100
PEERS = {"sb3": ("stable_baselines3", "Stable-Baselines3"), "sbx": ("sbx", "SBX")}
"""The modules and the names of other libraries; each is an extra of this package."""


@dataclass(frozen=True)
class Options:
    """What is measured, and for how long.

    Args:
        hidden: layers of actor and critics; by default 256 256, and then the paper's 400 300.
        populations: numbers of members that are measured.
        device: where networks and replay live.
        compile: whether updates are compiled, by default where there is a compiler.
        threads: of PyTorch and of the physics.
        against: other libraries, whose SAC is measured beside ours.
        rounds: how often each measurement has its turn.
        seconds: how long a turn takes at least.
    """

    hidden: tuple[int, ...] | None = None
    populations: tuple[int, ...] = (1, 2, 5, 10)
    device: Literal["cpu", "cuda"] = "cpu"
    compile: bool = field(default_factory=lambda: compiler() is not None)
    threads: int = 1
    against: tuple[Literal["sb3", "sbx"], ...] = ()
    rounds: int = 5
    seconds: float = 1.0

    def require_positive(self) -> None:
        """Raise ValueError unless all numbers are positive."""
        for name in ("hidden", "populations", "threads", "rounds", "seconds"):
            value = getattr(self, name)
            numbers = value if isinstance(value, tuple) else (value,)
            if value is not None and not (numbers and min(numbers) > 0):
                raise ValueError(f"{name} is {value!r}; expected positive numbers")


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


def measured(options: Options, hidden: tuple[int, ...], members: int) -> dict[str, Callable]:
    """Return what makes 2 `CHUNK` updates of each member, and as many steps with their updates."""
    often = dict.fromkeys(("learning_starts", "train_every"), 2 * CHUNK)
    never = dict.fromkeys(("total_steps", "eval_every"), 10**9)
    # The temperature is learned, as in other libraries.
    sizes = {"hidden": hidden, "batch_size": BATCH, "replay_size": 100_000}
    config = CORRECTED.change(env_id=TASK, temperature=None, **sizes, **often, **never)
    compile: Literal["yes", "no"] = "yes" if options.compile else "no"
    chosen = choose_execution(config, options.device, options.threads, compile)
    trainer = Trainer(config, range(members), random_demonstrations(TASK), execution=chosen)
    blocks = trained_blocks(trainer)
    next(blocks)
    return {"updates": partial(trainer.train_on_block, 2 * CHUNK), "steps": partial(next, blocks)}


def peer(library: str, hidden: tuple[int, ...]) -> Callable[[], object]:
    """Return what makes 2 `CHUNK` steps, with an update each, with the SAC of another library."""
    module, name = PEERS[library]
    try:
        sac = importlib.import_module(module).SAC
    except ImportError as error:
        cure = f"pip install 'offairl-lite[{library}]', or leave out against={library}"
        raise ModuleNotFoundError(f"{name} is not installed: {cure}") from error
    env, layers = gymnasium.make(TASK), {"net_arch": [*hidden]}
    starts: dict[str, Any] = {"batch_size": BATCH, "learning_starts": 2 * CHUNK}
    model = sac("MlpPolicy", env, device="cpu", policy_kwargs=layers, **starts)
    model.learn(2 * CHUNK + 20)  # the random steps, and some updates: SBX compiles at the first
    return partial(model.learn, 2 * CHUNK, reset_num_timesteps=False)


def turn(act: Callable[[], object], seconds: float) -> float:
    """Act for some time, once at least; return how often it was done in a second."""
    start, times, elapsed = time.perf_counter(), 0, 0.0
    while times == 0 or elapsed < seconds:
        act()
        if torch.cuda.is_initialized():
            torch.cuda.synchronize()
        times, elapsed = times + 1, time.perf_counter() - start
    return times / elapsed


def measure(options: Options) -> dict[str, Any]:
    """Measure all: what `offairl bench --json` prints; `rates` are of all members together."""
    execution = Execution(options.device, options.threads, options.compile)
    torch.set_num_threads(options.threads)
    networks = [options.hidden] if options.hidden else [(256, 256), (400, 300)]
    makers = [(hidden, n) for hidden in networks for n in options.populations]
    acts: dict[str, tuple[Callable, int]] = {}
    for hidden, n in tqdm(makers, desc="preparing", leave=False):
        title = f"{'-'.join(map(str, hidden))}, batch {BATCH}, members {n}"
        for rate_title, act in measured(options, hidden, n).items():
            acts[f"{rate_title}, {title}"] = act, 2 * CHUNK * n
    for hidden, library in product(networks, options.against):
        title = f"{'-'.join(map(str, hidden))}, batch {BATCH}, SAC of {PEERS[library][1]}"
        acts[f"steps, {title}"] = peer(library, hidden), 2 * CHUNK
    turns: dict[str, list[float]] = {title: [] for title in acts}
    for title in tqdm([*acts] * options.rounds, desc="measuring", leave=False):
        act, amount = acts[title]
        turns[title].append(amount * turn(act, options.seconds))
    rates = {title: median(samples) for title, samples in turns.items()}
    return {"origin": origin(execution), "options": asdict(options), "rates": rates}


def table(report: dict[str, Any]) -> str:
    """Lay a report out for people."""
    origin = report["origin"]
    lines = [", ".join(f"{name} {number}" for name, number in origin["versions"].items()), ""]
    lines.append(f"{origin['processor']:60} a second")
    lines += [f"{title:60} {rate:8.0f}" for title, rate in report["rates"].items()]
    return "\n".join([*lines, "", "Of all members together. With each step come its updates."])


def estimate(config: Config, members: int) -> float:
    """Return roughly how many seconds a run takes here, on one core, not compiled.

    We time one block of training and one episode, on random demonstrations. A policy that survives
    longer than the untrained one takes longer to evaluate.
    """
    schedule = config.schedule
    every = (config.learner.kind == "ppo" and schedule.train_every) or 20
    short = {"guide_steps": 0, "learning_starts": every, "train_every": every, "eval_episodes": 1}
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
