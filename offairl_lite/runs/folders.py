"""Runs that can be killed at any moment: made, worked on, resumed, extended.

A run's members train in shards: groups that one process takes forward together. All that a shard
needs to go on is in `members/SEEDS/`:

- `checkpoint.safetensors`: the trainer's state, what it belongs to, and how long the curve was;
- `replay.f32`: the replay, mapped into memory; it holds what the checkpoint looks back on;
- `curve.csv`: the rows of these members;
- `lock`: held by the process that is at work.
"""

import fcntl
import hashlib
import json
import logging
import os
import shutil
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import asdict, replace
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from torch import Tensor
from tqdm.auto import tqdm

from offairl_lite import demonstrations as data
from offairl_lite.config import Config
from offairl_lite.core.acceleration import Execution
from offairl_lite.core.discriminator import Reward
from offairl_lite.core.loop import Row, Trainer, complete
from offairl_lite.core.networks import Normaliser, load_weights, save_weights
from offairl_lite.core.policies import Policy
from offairl_lite.core.replay import Replay
from offairl_lite.core.rng import Streams
from offairl_lite.demonstrations import Demonstrations
from offairl_lite.runs import disk
from offairl_lite.runs.provenance import changed, origin
from offairl_lite.runs.records import (
    FORMAT,
    HEADER,
    Plan,
    lines,
    merged,
    read,
    read_json,
    require_format,
    write_json,
    write_whole,
)

log = logging.getLogger(__name__)

CHECKPOINT_EVERY = 2_000
"""Steps and updates, together, between checkpoints."""

INHERITED = {"reward": "frozen", "policy": "carried", "guide": "guide"}
"""What a trainer may be given of other runs, and the file that holds it."""

NEW = {"state": "waiting", "step": 0, "wall_s": 0.0, "diverged": {}}
"""What run.json says of a shard: how it is, the step of its last checkpoint, the seconds it took,
and members that were given up."""


def create(
    folder: str | PathLike,
    config: Config,
    seeds: Sequence[int],
    *,
    execution: Execution = Execution(),  # noqa: B008
    demonstrations: Demonstrations | None = None,
    reward: Reward | None = None,
    policy: Policy | None = None,
    guide: Policy | None = None,
    sources: Mapping[str, Sequence[Path]] | None = None,
    experiment: str | None = None,
    scale: str | None = None,
    shards: int = 1,
    checkpoint_every: int = CHECKPOINT_EVERY,
) -> str:
    """Make the folder of a new run, whole or not at all; `work` then does the run.

    Args:
        folder: a new or empty one.
        config: what to do.
        seeds: one for each member.
        execution: where and how it is computed.
        demonstrations: where a reward is to be learned. `work` loads them again if
            `demonstrations.load` has made them, and else must be given them.
        reward: a frozen reward, where `config.reward` is `frozen`.
        policy: one to carry over, where `config.carry` says so.
        guide: one that acts at the starts of episodes, where there are `config.start_steps`.
        sources: the files that `frozen`, `carried` and `guide` were loaded from, for the record.
        experiment: its name, for the record.
        scale: its scale, for the record.
        shards: groups that the members are split into, for as many processes.
        checkpoint_every: steps and updates, together, between checkpoints.

    Returns:
        The disk that the run needs, in words.

    Raises:
        FileExistsError: the folder holds something already; nothing is overwritten.
        ValueError: something that `config` needs is missing, or does not fit the task.
        OSError: the disk has no room for the run.
    """
    folder = Path(folder)
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise FileExistsError(
            f"{folder} is not empty: `offairl resume {folder}` goes on with a run that is there; "
            "for a new one choose another --out, or remove it"
        )
    # Made so that what does not fit is refused before anything is written. Whether a replay fits
    # is a question for GAN-GCL alone, whose own are small.
    small = replace(config, replay_size=config.update_every or 1)
    small = config if config.reward == "gan-gcl" else small
    given = {"reward": reward, "policy": policy, "guide": guide}
    Trainer(small, seeds, demonstrations, **_named(given), execution=execution).close()
    inherited = {INHERITED[name]: thing for name, thing in given.items() if thing is not None}
    groups = np.array_split(np.array(seeds), min(shards, len(seeds)))
    shown = None
    if demonstrations is not None:
        shown = {
            "trajectories": len(demonstrations),
            **(demonstrations.source or {}),
            "digest": _digest(demonstrations.transitions._asdict()),
        }
    plan = Plan(
        config,
        tuple(tuple(group.tolist()) for group in groups),
        asdict(execution),
        shown,
        checkpoint_every,
        experiment,
        scale,
        {
            name: {"files": [*map(str, (sources or {}).get(name, ()))], "digest": _weights(thing)}
            for name, thing in inherited.items()
        },
    )
    there = folder.resolve()
    needed = disk.use(plan)
    disk.require_room(next(p for p in (there, *there.parents) if p.exists()), needed, plan)
    there.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=f".{there.name}.", dir=there.parent) as hidden:
        made = Path(hidden) / "run"
        (made / "members").mkdir(parents=True)
        plan.write(made)
        (made / "curve.csv").write_text(HEADER)
        about = {"state": "waiting", **origin(execution), "wall_s": 0.0, "shards": {}}
        write_json(made / "run.json", about)
        for name, thing in inherited.items():
            thing.save(made / f"{name}.safetensors")
        if there != Path.cwd() and not there.is_mount():
            os.replace(made, there)
        else:
            # These cannot be replaced. A folder is a run once it has its configuration.
            for part in sorted(made.iterdir(), key=lambda part: part.name == "config.json"):
                shutil.move(part, there)
    return disk.words(needed)


def work(
    folder: str | PathLike,
    seeds: Sequence[int] | None = None,
    *,
    demonstrations: Demonstrations | None = None,
    progress: bool = True,
) -> None:
    """Take a run from where it is to its end. It does nothing to a run that has ended.

    Members that diverge are given up: run.json says why, and the others go on.

    Args:
        folder: of the run.
        seeds: of the one shard to take forward; None for all, one after the other.
        demonstrations: those the run began with; by default they are loaded.
        progress: whether to show a bar.

    Raises:
        FileNotFoundError: there is no such run, or its checkpoint is gone.
        ValueError: the checkpoint is damaged, or of another format or run; or the configuration,
            the demonstrations, or what comes from other runs, have changed.
        OSError: another process is at work on the run, or its disk is full.
    """
    folder = Path(folder)
    plan = Plan.read(folder)
    if seeds is not None and tuple(seeds) not in plan.shards:
        known = ", ".join(" ".join(map(str, shard)) for shard in plan.shards)
        raise ValueError(f"{folder} has no members {list(seeds)} of their own; there are: {known}")
    shards = plan.shards if seeds is None else (tuple(seeds),)
    left, reached = unfinished(folder, shards), _reached(folder, plan, shards)
    if reached > plan.config.total_steps:
        raise ValueError(
            f"{folder} has reached step {reached}, and its total_steps is "
            f"{plan.config.total_steps}: `offairl resume {folder} --steps N` takes any N from "
            f"{reached} on"
        )
    execution = Execution(**plan.execution)
    if left and plan.demonstrations is not None:
        demonstrations = _demonstrations(folder, plan, demonstrations)
    for shard in left:
        _Worker(folder, plan, shard).work(demonstrations, execution, progress)
    _publish(folder)


def _demonstrations(
    folder: Path, plan: Plan, given: Demonstrations | None = None
) -> Demonstrations:
    """Return what a run began with, loaded if it is not given.

    Raises:
        ValueError: they have changed since, or there is nothing to load them from.
    """
    shown = plan.demonstrations
    whose = "from elsewhere"
    if "dataset" in shown:
        whose = f"of {shown['dataset'] or 'the shipped experts'}"
    elif given is None:
        raise ValueError(
            f"{folder} began with demonstrations that `demonstrations.load` has not made: give the "
            "same to `runs.work` again"
        )
    if given is None:
        given = data.load(
            plan.config.env_id,
            shown["trajectories"],
            shown["dataset"],
            shown.get("subsample", 1),  # Older runs do not say,
            shown.get("experts"),  # nor this.
        )
    if _digest(given.transitions._asdict()) != shown["digest"]:
        raise ValueError(
            f"{len(given)} trajectories {whose} are not those that {folder} began with: bring them "
            "back, or start a new run"
        )
    return given


def verify(
    folder: str | PathLike, evaluations: int = 1, progress: bool = True
) -> list[tuple[Row | None, Row | None]]:
    """Do the beginning of a recorded run again, in memory, and set it beside the record.

    Args:
        folder: of the record. Its checkpoints are not needed.
        evaluations: how many, from the first one on, of the members that were trained together
            with the first.
        progress: whether to show a bar.

    Returns:
        Pairs of a recorded row and the same one, as it comes out here and now; None stands for a
        member that had diverged, there or here.

    Raises:
        FileNotFoundError: there is no such record, or what it had of another run is gone.
        ValueError: the demonstrations, or what it had of another run, are no longer those it began
            with, or the record has not so many evaluations.
    """
    folder = Path(folder)
    plan = Plan.read(folder)
    shard, execution = plan.shards[0], Execution(**plan.execution)
    rows = [row for row in read(folder).rows if row.seed in shard]
    steps = sorted({row.step for row in rows})
    if not 1 <= evaluations <= len(steps):
        raise ValueError(f"evaluations is {evaluations}; {folder} has {len(steps)} to do again")
    last = steps[evaluations - 1]
    shown = None if plan.demonstrations is None else _demonstrations(folder, plan)
    inherited = _named(_inherited(folder, plan, shard))
    again = []
    with (
        closing(Trainer(plan.config, shard, shown, **inherited, execution=execution)) as trainer,
        tqdm(total=last, unit="step", disable=not progress) as bar,
        suppress(FloatingPointError),  # Every member diverges.
    ):
        while trainer.evaluated < last:
            again += trainer.advance()
            bar.update(trainer.trained - bar.n)
    there = {(row.seed, row.step): row for row in rows if row.step <= last}
    here = {(row.seed, row.step): row for row in again}
    return [(there.get(key), here.get(key)) for key in there | here]


def unfinished(
    folder: str | PathLike, shards: Sequence[tuple[int, ...]] | None = None
) -> list[tuple[int, ...]]:
    """Return the seeds of each shard, of all or of some, that is not at its end.

    Raises:
        FileNotFoundError: there is no such run, or its checkpoint is gone.
        ValueError: a checkpoint is damaged or of another format or run, or the plan has changed.
    """
    folder = Path(folder)
    plan, left = Plan.read(folder), []
    lost = read_json(folder / "run.json")["shards"].keys() - set(map(_name, plan.shards))
    if lost:
        raise ValueError(
            f"{folder}/config.json has lost the shards {sorted(lost)}, which the run has: put "
            "their seeds back"
        )
    for shard in plan.shards if shards is None else shards:
        found = _load(folder, plan, shard)
        whole = found and found[1]["finished"] and found[1]["steps"] >= plan.config.total_steps
        kept = (home(folder, shard) / "policy.safetensors").is_file()
        # The manifest is written last: without its word the end may not have been published.
        state = _status(folder, shard)["state"]
        if state != "diverged" and not (whole and kept and state == "finished"):
            left.append(shard)
    return left


def extend(folder: str | PathLike, steps: int | None = None, seeds: Sequence[int] = ()) -> None:
    """Have a run go on to another number of steps, or with further members.

    All is done or nothing. What is new starts the next time the run is worked on; until its end
    there is no policy and no reward of the whole run.

    Args:
        folder: of the run.
        steps: environment steps of each member, in all.
        seeds: of new members, a shard of their own.

    Raises:
        ValueError: the run has gone further already; a seed is there already, or the run builds
            upon members of another.
        OSError: a process is at work on it, or the disk has no room.
    """
    if steps is None and not seeds:
        raise ValueError(f"to extend {folder} give it steps, or seeds of new members")
    folder = Path(folder)
    with _alone(folder) as plan:
        new = plan
        if steps is not None:
            reached = _reached(folder, plan, plan.shards)
            if steps < reached:
                raise ValueError(f"{folder} has reached step {reached}; it cannot end at {steps}")
            new = replace(new, config=replace(plan.config, total_steps=steps))
        if seeds:
            _require_new(folder, plan, seeds)
            new = replace(new, shards=(*plan.shards, tuple(seeds)))
        disk.require_room(folder, disk.missing(folder, new), new)
        new.write(folder)
        _publish(folder)


def _require_new(folder: Path, plan: Plan, seeds: Sequence[int]) -> None:
    """Raise ValueError unless a run can have further members of these seeds."""
    if inherited := _inherited(folder, plan, plan.seeds):
        raise ValueError(
            f"{folder} has of another run the {' and the '.join(inherited)}, of "
            f"{len(plan.seeds)} members and none for further seeds: start a run of its own"
        )
    Streams(seeds)  # It refuses what cannot be a seed.
    if len({*plan.seeds, *seeds}) < len(plan.seeds) + len(seeds):
        raise ValueError(f"seeds {list(seeds)} are not all new: there are {list(plan.seeds)}")


class _Worker:
    """One process's work on one shard.

    Args:
        folder: of the run.
        plan: of the run.
        shard: the members' seeds.
    """

    def __init__(self, folder: Path, plan: Plan, shard: tuple[int, ...]) -> None:
        self.folder, self.plan, self.shard = folder, plan, shard
        self.home = home(folder, shard)
        self.curve, self.replay = self.home / "curve.csv", self.home / "replay.f32"
        self.identity = _identity(folder, plan, shard)
        self.trainer: Trainer | None = None
        # Steps at the last checkpoint, and steps and updates.
        self.step, self.saved = 0, 0
        self.start = time.monotonic()

    def work(
        self, demonstrations: Demonstrations | None, execution: Execution, progress: bool
    ) -> None:
        """Go from the last checkpoint to the end."""
        self.home.mkdir(parents=True, exist_ok=True)
        with _lock(self.home / "lock"), disk.explained(self.folder, self.plan), ExitStack() as last:
            self._begin(demonstrations, execution)
            last.callback(self.trainer.close)
            try:
                self._note("running")
                try:
                    complete(self.trainer, progress, self._advanced)
                    state = "finished"
                except FloatingPointError:
                    state = "diverged"
                # Whoever diverges before the warm-up is over has no policy yet.
                policy = self.trainer.generator and self.trainer.generator.policy
                results = {"policy": policy, "reward": self.trainer.reward}
                for name, result in results.items():
                    if result is not None:
                        write_whole(self.home / f"{name}.safetensors", result.save)
                if state == "finished":
                    self._checkpoint()
                self._note(state)
            except BaseException as error:
                with suppress(OSError):
                    why = f"{type(error).__name__}: {error}" if str(error) else repr(error)
                    self._note(f"stopped: {why}")
                raise

    def _begin(self, demonstrations: Demonstrations | None, execution: Execution) -> None:
        """Put the trainer where the checkpoint says."""
        found = _load(self.folder, self.plan, self.shard)
        if found is None:
            self.replay.unlink(missing_ok=True)
            self.curve.write_text(HEADER)
        self.trainer = Trainer(
            self.plan.config,
            self.shard,
            demonstrations,
            **_named(_inherited(self.folder, self.plan, self.shard)),
            execution=execution,
            replay_file=self.replay,
            memory=self.plan.checkpoint_every,
        )
        if found is not None:
            state, about = found
            self.trainer.restore(state)
            if about["ends"] != _ends(self.trainer.replay):
                raise ValueError(_damaged(self.replay, "it is not as it was at the checkpoint"))
            self.trainer.diverged |= {int(seed): why for seed, why in about["diverged"].items()}
            os.truncate(self.curve, about["curve.csv"])
            self.start -= about["wall_s"]
            self.saved, self.step = self._done, self.trainer.steps
            _note_change(self.folder, self.step, origin(execution))

    @property
    def _done(self) -> int:
        return self.trainer.steps + self.trainer.trained

    def _advanced(self, rows: list[Row]) -> None:
        """Record what was done, after each piece of work."""
        if rows:
            with open(self.curve, "a") as file:
                file.write(lines(rows))
            self._note("running")
        if self._done - self.saved >= self.plan.checkpoint_every:
            self._checkpoint()

    def _checkpoint(self) -> None:
        """Keep the state. The replay file holds what it takes to come back to the last one too."""
        self.trainer.replay.flush()
        with open(self.curve, "rb") as file:
            os.fsync(file.fileno())
        state = self.trainer.state()
        about = {
            "kind": "checkpoint",
            "format": FORMAT,
            "identity": self.identity,
            "steps": self.trainer.steps,
            "finished": self.trainer.finished,
            "curve.csv": self.curve.stat().st_size,
            "replay.f32": self.replay.stat().st_size,
            "ends": _ends(self.trainer.replay),
            "wall_s": time.monotonic() - self.start,
            "diverged": self.trainer.diverged,
        }
        about["digest"] = _digest(state, about)
        path = self.home / "checkpoint.safetensors"
        write_whole(path, lambda part: save_weights(part, state, about))
        self.saved, self.step = self._done, self.trainer.steps

    def _note(self, state: str) -> None:
        wall = round(time.monotonic() - self.start, 1)
        diverged = self.trainer.diverged
        status = {"state": state, "step": self.step, "wall_s": wall, "diverged": diverged}
        _publish(self.folder, self.shard, status)


def _publish(
    folder: Path, shard: tuple[int, ...] | None = None, status: dict[str, Any] | None = None
) -> None:
    """Put the shards' curves together, and policies and rewards at the end; note how things are."""
    with _lock(folder / "members" / "lock", wait=True):
        plan, about = Plan.read(folder), read_json(folder / "run.json")
        if shard is not None:
            about["shards"][_name(shard)] = status
        homes = [home(folder, shard) for shard in plan.shards]
        paths = [place / "curve.csv" for place in homes]
        curve = merged((path.read_text() for path in paths if path.is_file()), plan.seeds)
        write_whole(folder / "curve.csv", lambda part: part.write_text(curve))
        shards = [about["shards"].get(place.name, NEW) for place in homes]
        states = [_state(status, plan.config.total_steps) for status in shards]
        ended = set(states) <= {"finished", "diverged"}
        for name, kind in (("policy", Policy), ("reward", Reward)):
            path = folder / f"{name}.safetensors"
            parts = [place / path.name for place in homes]
            found = [kind.load(part) if part.is_file() else None for part in parts]
            known = next((part for part in found if part is not None), None)
            if not ended:
                path.unlink(missing_ok=True)
            elif known is not None:
                # Zeros for those who diverged before they had any.
                whole = [
                    _zeros(known, len(shard)) if part is None else part
                    for part, shard in zip(found, plan.shards, strict=True)
                ]
                write_whole(path, _together(whole).save)
        about["state"] = _summary(states)
        about["wall_s"] = round(sum(status["wall_s"] for status in shards), 1)
        write_json(folder / "run.json", about)


def _note_change(folder: Path, step: int, now: dict[str, Any]) -> None:
    """Note in run.json where a run goes on with other versions, or elsewhere, than before."""
    with _lock(folder / "members" / "lock", wait=True):
        about = read_json(folder / "run.json")
        before = [about, *about.get("continued", [])][-1]
        if not (found := changed(before, now)):
            return
        if found.keys() != {"commit"}:
            said = "; ".join(f"{key}: {here}, before {was}" for key, (was, here) in found.items())
            log.warning("%s goes on from step %d with other %s", folder, step, said)
        about["continued"] = [*about.get("continued", []), {"step": step, **now}]
        write_json(folder / "run.json", about)


def _state(status: dict[str, Any], total_steps: int) -> str:
    """Return how a shard is; what was the end before the run was extended no longer is."""
    extended = status["state"] == "finished" and status["step"] < total_steps
    return "waiting" if extended else status["state"]


def _summary(states: list[str]) -> str:
    """Return how a run is, from how its shards are."""
    for kind in ("stopped", "running", "waiting", "finished"):
        for state in states:
            if state.startswith(kind):
                return state
    return "stopped: every member has diverged"


def _zeros(like: Policy | Reward, count: int) -> Policy | Reward:
    """Return members of the same kind that were given up, as they are kept elsewhere."""
    obs_dim = like.normaliser.mean.shape[-1]
    return replace(
        like,
        params=torch.zeros(count, like.params.shape[-1]),
        normaliser=Normaliser.identity(count, obs_dim),
    )


def _together(parts: list) -> Any:
    """Return one population of several policies, or of several rewards.

    Raises:
        ValueError: they are not of one task and architecture.
    """
    kinds = {replace(part, params=None, normaliser=None) for part in parts}
    if len(kinds) > 1:
        raise ValueError(f"members of one population must be of one kind, not {kinds}")
    pairs = zip(*(part.normaliser for part in parts), strict=True)
    params = torch.cat([part.params for part in parts])
    return replace(parts[0], params=params, normaliser=Normaliser(*map(torch.cat, pairs)))


def _load(
    folder: Path, plan: Plan, shard: tuple[int, ...]
) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
    """Return a shard's checkpoint, verified; None where the shard has yet to begin."""
    here = home(folder, shard)
    path, reached = here / "checkpoint.safetensors", _status(folder, shard)["step"]
    if not path.is_file():
        if reached:
            raise FileNotFoundError(
                f"{path} is gone, and the run had reached step {reached}: bring all of {here} "
                "back, or start a new run"
            )
        return None
    try:
        state, about = load_weights(path, "checkpoint")
        sound = about.pop("digest", None) == _digest(state, about)
    except ValueError as error:
        raise ValueError(_damaged(path, error)) from error
    require_format(path, about.get("format", 1))
    if not sound:
        raise ValueError(_damaged(path, "its contents are not those that were written"))
    # A field that the checkpoint has never heard of is as it was before there was one.
    was = {**json.loads(json.dumps(asdict(Config()))), **about["identity"]}
    now = json.loads(json.dumps(_identity(folder, plan, shard)))
    changed = [f"{k} was {was.get(k)!r}, is {now[k]!r}" for k in now if was.get(k) != now[k]]
    if changed:
        raise ValueError(
            f"{path} is of another run than {folder}/config.json: {'; '.join(changed)}; put back "
            "what was changed, or start a new run"
        )
    for name in ("curve.csv", "replay.f32"):
        found = (here / name).stat().st_size if (here / name).is_file() else 0
        if found < about[name]:
            raise ValueError(_damaged(here / name, f"it had {about[name]} bytes, and has {found}"))
    return state, about


def _reached(folder: Path, plan: Plan, shards: Sequence[tuple[int, ...]]) -> int:
    """Return the last step from which one of some shards can go on."""
    return max(found[1]["steps"] if (found := _load(folder, plan, s)) else 0 for s in shards)


def _damaged(path: Path, why: object) -> str:
    return f"{path} is damaged: {why}; bring all of {path.parent} back, or start a new run"


def _identity(folder: Path, plan: Plan, shard: tuple[int, ...]) -> dict[str, Any]:
    """Return all that a checkpoint depends on and that must stay as it is."""
    identity = {
        **asdict(plan.config),
        **plan.execution,
        "seeds": shard,
        "checkpoint_every": plan.checkpoint_every,
        "demonstrations": plan.demonstrations and plan.demonstrations["digest"],
        **{
            INHERITED[name]: _weights(thing)
            for name, thing in _inherited(folder, plan, shard).items()
        },
    }
    del identity["total_steps"]
    return identity


def _inherited(folder: Path, plan: Plan, shard: tuple[int, ...]) -> dict[str, Reward | Policy]:
    """Return what a shard has of other runs, by the names that `Trainer` has for it.

    A record is without the copies of a run's folder: there they are made anew from the files that
    the plan names.

    Raises:
        FileNotFoundError: it is in neither place.
        ValueError: it is not what the run began with.
    """
    files = {}
    for name in (INHERITED[name] for name in _heritable(plan.config)):
        copy, sources = folder / f"{name}.safetensors", plan.inherited.get(name, {}).get("files")
        files[name] = [Path(f) for f in sources] if sources and not copy.is_file() else [copy]
    found = inherit(plan.config, plan.seeds, **files)
    for name, thing in found.items():
        was = plan.inherited.get(INHERITED[name])
        if was and _weights(thing) != was["digest"]:
            raise ValueError(
                f"{' and '.join(map(str, files[INHERITED[name]]))} is not the {name} that {folder} "
                "began with: put that back, or start a new run"
            )
    members = [*map(plan.seeds.index, shard)]
    return {name: thing.member(*members) for name, thing in found.items()}


def _named(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a run has of others by the names of the trainer's parameters."""
    names = {"reward": "frozen_reward", "policy": "pretrained_policy", "guide": "guide"}
    return {names[name]: thing for name, thing in given.items()}


def _heritable(config: Config) -> dict[str, type[Reward] | type[Policy]]:
    """Return what a configuration needs of other runs."""
    needed = {
        "reward": (config.reward == "frozen", Reward),
        "policy": (config.carry != "nothing", Policy),
        "guide": (config.start_steps > 0, Policy),
    }
    return {name: kind for name, (is_needed, kind) in needed.items() if is_needed}


def inherit(
    config: Config,
    seeds: Sequence[int],
    *,
    frozen: Sequence[Path] = (),
    carried: Sequence[Path] = (),
    guide: Sequence[Path] = (),
) -> dict[str, Reward | Policy]:
    """Load what a configuration needs of other runs, for `create`.

    The members of several files come one after the other, as one population.

    Args:
        config: that of the new run.
        seeds: of its members. Where guides are fewer, they take turns.
        frozen: files of rewards, or runs that have one.
        carried: files of policies, or runs.
        guide: files of policies, or runs.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: a file is needed that is not given, or it holds something else.
    """
    files, given = {"reward": frozen, "policy": carried, "guide": guide}, {}

    def file(path: Path, own: str) -> Path:
        if path.is_dir() and not (path / own).is_file():
            raise FileNotFoundError(
                f"{path} has no {own}, which is written at the end of a run: `offairl resume "
                f"{path}` goes on to it"
            )
        return path / own if path.is_dir() else path

    for name, kind in _heritable(config).items():
        if not files[name]:
            raise ValueError(
                f"a {name} of another run is needed: give --{INHERITED[name]} "
                f"RUN/{kind.__name__.lower()}.safetensors, or RUN"
            )
        own = f"{kind.__name__.lower()}.safetensors"
        given[name] = _together([kind.load(file(f, own)) for f in files[name]])
    if "guide" in given:
        guides = given["guide"]
        given["guide"] = guides.member(*(i % len(guides) for i in range(len(seeds))))
    return given


def require_use(configs: Iterable[Config], **files: Sequence[Path]) -> None:
    """Refuse files of other runs that no configuration makes use of.

    Args:
        configs: of new runs.
        **files: as for `inherit`.

    Raises:
        ValueError: there are such files.
    """
    used = {INHERITED[name] for config in configs for name in _heritable(config)}
    cures = {"frozen": "--reward frozen", "carried": "--carry policy", "guide": "--start-steps 50"}
    for name, given in files.items():
        if given and name not in used:
            raise ValueError(
                f"--{name} {' '.join(map(str, given))} would not be used: add {cures[name]}, or "
                "leave it out"
            )


def _digest(tensors: Mapping[str, Tensor], about: dict[str, Any] | None = None) -> str:
    """Return the SHA-256 of names, shapes and bytes, and of what is said about them."""
    digest = hashlib.sha256(json.dumps(about).encode())
    for name, tensor in sorted(tensors.items()):
        array = tensor.detach().cpu().contiguous().numpy()
        digest.update(f"{name} {array.dtype} {array.shape}".encode())
        digest.update(array)
    return digest.hexdigest()


def _weights(thing: Reward | Policy) -> str:
    """Return the SHA-256 of parameters and normaliser."""
    return _digest({"params": thing.params, **thing.normaliser._asdict()})


def _ends(replay: Replay) -> str:
    """Return the SHA-256 of each member's oldest and newest row.

    It tells one replay from others, and from itself at another time.
    """
    last = replay.added - 1
    first = replay.added - torch.tensor(replay.sizes)
    rows = replay.rows[torch.stack([first, last]) % len(replay.rows), torch.arange(len(last))]
    return _digest({"rows": rows})


def home(folder: Path, shard: tuple[int, ...]) -> Path:
    """Return where a shard's own files are."""
    return folder / "members" / _name(shard)


def _name(shard: tuple[int, ...]) -> str:
    """Return the seeds; of many the first, the last and a digest, for a name has its limits."""
    seeds = "-".join(map(str, shard))
    if len(seeds) <= 100:
        return seeds
    return f"{shard[0]}-to-{shard[-1]}-{hashlib.sha256(seeds.encode()).hexdigest()[:8]}"


def _status(folder: Path, shard: tuple[int, ...]) -> dict[str, Any]:
    return read_json(folder / "run.json")["shards"].get(_name(shard), NEW)


@contextmanager
def _lock(path: Path, wait: bool = False) -> Iterator[None]:
    """Hold a file's lock, which ends with the process if not before."""
    with open(path, "a") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            raise OSError(
                f"another process is at work on {path.parent}: let it finish, or stop it"
            ) from None
        yield


@contextmanager
def _alone(folder: Path) -> Iterator[Plan]:
    """Give the plan of a run while nobody is at work on it."""
    unfinished(folder)
    with ExitStack() as locks:
        for shard in Plan.read(folder).shards:
            home(folder, shard).mkdir(exist_ok=True)
            locks.enter_context(_lock(home(folder, shard) / "lock"))
        yield Plan.read(folder)
