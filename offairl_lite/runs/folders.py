"""Run folders: runs that can be killed at any moment, made, trained, resumed and extended.

One process trains the population of a run folder. What it needs to go on is in `checkpoint/`:

- `checkpoint.safetensors`: the trainer's state, what it belongs to, and how long the curve was;
- `replay.f32`: the replay, mapped into memory, with all that the checkpoint refers to;
- `lock`: held by the process that trains;
- `log.txt`: the output of a process that another one started.
"""

import operator
import os
import shutil
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import asdict, replace
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tqdm.auto import tqdm

from offairl_lite.config import Config
from offairl_lite.core.acceleration import Execution
from offairl_lite.core.loop import Row, Trainer
from offairl_lite.core.policies import Policy
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rng import Rng
from offairl_lite.demonstrations import Demonstrations
from offairl_lite.runs import checkpoints, inputs
from offairl_lite.runs.checkpoints import SUBFOLDER, in_words
from offairl_lite.runs.provenance import origin
from offairl_lite.runs.records import (
    HEADER,
    RunSpec,
    read,
    read_json,
    run_folders,
    seeds_name,
    write_json,
)

CHECKPOINT_EVERY = 2_000
"""Steps and updates, together, between checkpoints."""


def create(
    folder: str | PathLike,
    config: Config,
    seeds: Sequence[int],
    *,
    execution: Execution = Execution(),  # noqa: B008
    demonstrations: Demonstrations | None = None,
    frozen_reward: Reward | None = None,
    pretrained_policy: Policy | None = None,
    guide: Policy | None = None,
    sources: Mapping[str, Sequence[Path]] | None = None,
    members: Sequence[int] | None = None,
    experiment: str | None = None,
    scale: str | None = None,
    checkpoint_every: int = CHECKPOINT_EVERY,
) -> str:
    """Make the folder of a new run, whole or not at all. `worker.work` then trains.

    Args:
        folder: a new or empty folder. It may also be a new one below a run folder.
        config: the configuration.
        seeds: one for each member of the population.
        execution: where and how the run is computed.
        demonstrations: where a reward is to be learned. `worker.work` loads them again if
            `demonstrations.load` has made them, and must be given them otherwise.
        frozen_reward: where `config.reward` is `frozen`.
        pretrained_policy: where `config.pretrained` says what of it the actor begins with.
        guide: a policy that acts at the start of episodes, where there are `start_steps`.
        sources: the files that `frozen_reward`, `pretrained_policy` and `guide` were loaded from,
            for the record.
        members: which members of these files they are, if not all.
        experiment: the experiment's name, for the record.
        scale: its scale, for the record.
        checkpoint_every: steps and updates, together, between checkpoints.

    Returns:
        The disk space that the run needs, such as `12 MB`.

    Raises:
        FileExistsError: the folder holds something already. Nothing is overwritten.
        ValueError: something that `config` needs is missing, or does not fit the task.
        OSError: the disk has no room for the run.
    """
    folder = Path(folder)
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise FileExistsError(
            f"{folder} is not empty: `offairl resume {folder}` goes on with a run that is there; "
            "for a new one choose another --out, or remove it"
        )
    given = {"frozen_reward": frozen_reward, "pretrained_policy": pretrained_policy, "guide": guide}
    given = {name: thing for name, thing in given.items() if thing is not None}
    _require_fit(config, seeds, demonstrations, given, execution)
    part = {} if members is None else {"members": [*members]}
    inherited = {
        name: {"files": [*map(str, (sources or {}).get(name, ()))], **part, "digest": digest}
        for name, digest in ((name, inputs.digest_of(thing)) for name, thing in given.items())
    }
    spec = RunSpec(
        config,
        tuple(map(operator.index, seeds)),
        asdict(execution),
        inputs.describe(demonstrations),
        checkpoint_every,
        experiment,
        scale,
        inherited,
    )
    there, space = folder.resolve(), checkpoints.disk_space(spec)
    checkpoints.require_room(there, space, config)
    _write(there, spec, given)
    return in_words(space)


def _write(folder: Path, spec: RunSpec, given: Mapping[str, inputs.Weights]) -> None:
    """Write the folder of a new run aside, and put it in its place."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as hidden:
        made = Path(hidden) / "run"
        (made / SUBFOLDER).mkdir(parents=True)
        (made / "curve.csv").write_text(HEADER)
        begun = {"state": "waiting", "step": 0, "wall_s": 0.0, "diverged": {}}
        write_json(made / "run.json", {**begun, **origin(Execution(**spec.execution))})
        for name, thing in given.items():
            thing.save(made / f"{name}.safetensors")
        spec.write(made)
        if folder != Path.cwd() and not folder.is_mount():
            os.replace(made, folder)
        else:
            # These cannot be replaced. A folder is a run once it has its configuration.
            for path in sorted(made.iterdir(), key=lambda path: path.name == "config.json"):
                shutil.move(path, folder)


def _require_fit(
    config: Config,
    seeds: Sequence[int],
    demonstrations: Demonstrations | None,
    given: Mapping[str, Any],
    execution: Execution,
) -> None:
    """Make a trainer, which refuses what does not fit before anything is written."""
    if config.reward != "gan-gcl":  # It compares the size of its replay, a small one, with others.
        config = config.change(replay_size=config.schedule.update_every or 1)
    Trainer(config, seeds, demonstrations, **given, execution=execution).close()


def verify(
    folder: str | PathLike, evaluations: int = 1, progress: bool = True
) -> list[tuple[Row | None, Row | None]]:
    """Train the beginning of a recorded run again, in memory, and set it beside the record.

    Args:
        folder: of the record. Its checkpoints are not needed. Of several run folders the first is
            verified.
        evaluations: how many evaluations to do again, from the first one on.
        progress: whether to show a bar.

    Returns:
        Pairs of a recorded row and the same row as it comes out now. None stands for a member that
        had diverged, there or here.

    Raises:
        FileNotFoundError: there is no such record, or what it was given of another run is gone.
        ValueError: the demonstrations, or what it was given of another run, have changed, or the
            record has fewer evaluations.
    """
    folder = run_folders(folder)[0]
    spec = RunSpec.read(folder)
    rows = [row for row in read(folder).rows if row.seed in spec.seeds]
    steps = sorted({row.step for row in rows})
    if not 1 <= evaluations <= len(steps):
        raise ValueError(f"evaluations is {evaluations}; {folder} has {len(steps)} to do again")
    last, again = steps[evaluations - 1], []
    demonstrations = inputs.demonstrations_of(folder, spec)
    given = {**inputs.recorded(folder, spec), "execution": Execution(**spec.execution)}
    with (
        closing(Trainer(spec.config, spec.seeds, demonstrations, **given)) as trainer,
        tqdm(total=last, unit="step", disable=not progress) as bar,
        suppress(FloatingPointError),  # Every member diverges.
    ):
        for found in trainer.run():
            again += found
            bar.update(trainer.trained - bar.n)
            if found and trainer.steps >= last:
                break
    there = {(row.seed, row.step): row for row in rows if row.step <= last}
    here = {(row.seed, row.step): row for row in again}
    return [(there.get(key), here.get(key)) for key in there | here]


def extend(folder: str | PathLike, steps: int | None = None, seeds: Sequence[int] = ()) -> None:
    """Set a run another number of steps, or add seeds to it. `worker.work` then trains what is new.

    More steps are for all run folders of the run. New seeds get a run folder of their own, inside
    `folder`, where `read` finds it; nothing is moved.

    Args:
        folder: the run's folder.
        steps: environment steps of each seed, in all.
        seeds: the seeds to add.

    Raises:
        ValueError: the run has gone further already; a seed is there already, or the run builds
            upon members of another.
        OSError: a process is at work on the run, or the disk has no room.
    """
    if steps is None and not seeds:
        raise ValueError(f"to extend {folder} give it steps, or seeds of new members")
    folder = Path(folder)
    with ExitStack() as locks:
        specs = {path: RunSpec.read(path) for path in run_folders(folder)}
        for path in specs:
            checkpoints.load(path, specs[path])  # It refuses what is damaged.
            locks.enter_context(checkpoints.lock(path))
        if seeds:
            _require_new(folder, specs, seeds)
        longer = specs
        if steps is not None:
            for path, spec in specs.items():
                if steps < (reached := checkpoints.reached(path, spec)):
                    raise ValueError(f"{path} has reached step {reached}; it cannot end at {steps}")
            longer = {
                path: replace(spec, config=spec.config.change(total_steps=steps))
                for path, spec in specs.items()
            }
        missing = sum(checkpoints.missing_space(path, spec) for path, spec in longer.items())
        one = next(iter(longer.values()))
        if seeds:
            missing += checkpoints.disk_space(replace(one, seeds=tuple(seeds)))
        checkpoints.require_room(folder, missing, one.config)
        if seeds:
            _add_seeds(folder, next(iter(specs)), one, seeds)
        for path, spec in longer.items():
            about = read_json(path / "run.json")
            ended = about["state"] == "finished" and spec != specs[path]
            for name in ("policy", "reward"):
                if ended:
                    (path / f"{name}.safetensors").unlink(missing_ok=True)
            spec.write(path)
            if ended:
                write_json(path / "run.json", about | {"state": "waiting"})


def _require_new(folder: Path, specs: Mapping[Path, RunSpec], seeds: Sequence[int]) -> None:
    """Raise ValueError unless a run can have further members of these seeds."""
    read(folder)  # It refuses several configurations.
    for path, spec in specs.items():
        if inherited := inputs.recorded(path, spec):
            raise ValueError(
                f"{path} has of another run the {' and the '.join(inherited).replace('_', ' ')}, "
                f"of {len(spec.seeds)} members and none for further seeds: start a run of its own"
            )
    Rng(seeds)  # It refuses what cannot be a seed.
    there = [seed for spec in specs.values() for seed in spec.seeds]
    if len({*there, *seeds}) < len(there) + len(seeds):
        raise ValueError(f"seeds {list(seeds)} are not all new: there are {there}")


def _add_seeds(folder: Path, sibling: Path, spec: RunSpec, seeds: Sequence[int]) -> None:
    create(
        folder / seeds_name(seeds),
        spec.config,
        seeds,
        execution=Execution(**spec.execution),
        demonstrations=inputs.demonstrations_of(sibling, spec),
        experiment=spec.experiment,
        scale=spec.scale,
        checkpoint_every=spec.checkpoint_every,
    )
