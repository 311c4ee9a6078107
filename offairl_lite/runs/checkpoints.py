"""What a run needs to go on: the files in `checkpoint/`, their disk space, and their lock."""

import errno
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import torch
from filelock import FileLock, Timeout
from torch import Tensor

from offairl_lite import envs
from offairl_lite.config import Config, flat_settings
from offairl_lite.core.loop import Trainer, replay_slots
from offairl_lite.core.networks import load_weights, save_weights
from offairl_lite.core.replay import Replay
from offairl_lite.runs import inputs
from offairl_lite.runs.records import FORMAT, RunSpec, read_json, require_format, write_whole

SUBFOLDER = "checkpoint"
"""The subfolder of what is needed to go on."""

MARGIN = 2**23
"""Bytes of disk for each seed beside the replay: checkpoints, curve, policy and reward."""


def save(folder: Path, spec: RunSpec, trainer: Trainer, wall_s: float) -> None:
    """Keep a trainer's state. The replay file still has what the checkpoint before it needs."""
    curve, replay = folder / "curve.csv", folder / SUBFOLDER / "replay.f32"
    trainer.collector.replay.flush()
    with open(curve, "rb") as file:
        os.fsync(file.fileno())
    state = trainer.state()
    about = {
        "kind": "checkpoint",
        "format": FORMAT,
        "identity": _identity(folder, spec),
        "steps": trainer.steps,
        "finished": trainer.finished,
        "curve.csv": curve.stat().st_size,
        "replay.f32": replay.stat().st_size,
        "ends": _ends(trainer.collector.replay),
        "wall_s": wall_s,
        "diverged": trainer.members.diverged,
    }
    about["digest"] = inputs.digest(state, about)
    path = folder / SUBFOLDER / "checkpoint.safetensors"
    write_whole(path, lambda part: save_weights(part, state, about))


def load(folder: Path, spec: RunSpec) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
    """Return a run's checkpoint, verified; None where the run has yet to begin.

    Raises:
        FileNotFoundError: the checkpoint is gone.
        ValueError: it is damaged, or of another format or run.
    """
    path, reached = (
        folder / SUBFOLDER / "checkpoint.safetensors",
        read_json(folder / "run.json")["step"],
    )
    if not path.is_file():
        if reached:
            raise FileNotFoundError(
                f"{path} is gone, and the run had reached step {reached}: bring all of {folder} "
                "back, or start a new run"
            )
        return None
    try:
        state, about = load_weights(path, "checkpoint")
        sound = about.pop("digest", None) == inputs.digest(state, about)
    except ValueError as error:
        raise ValueError(_damaged(folder, path, error)) from error
    require_format(path, about.get("format", 1))
    if not sound:
        raise ValueError(_damaged(folder, path, "its contents are not those that were written"))
    # A setting that the checkpoint does not know has the value it had before there was one.
    defaults = {name: default for name, (_, default, _) in flat_settings().items()}
    was = {**json.loads(json.dumps(defaults)), **about["identity"]}
    now = json.loads(json.dumps(_identity(folder, spec)))
    changed = [f"{k} was {was.get(k)!r}, is {now[k]!r}" for k in now if was.get(k) != now[k]]
    if changed:
        raise ValueError(
            f"{path} is of another run than {folder}/config.json: {'; '.join(changed)}; put back "
            "what was changed, or start a new run"
        )
    for file in (folder / "curve.csv", folder / SUBFOLDER / "replay.f32"):
        found = file.stat().st_size if file.is_file() else 0
        if found < about[file.name]:
            why = f"it had {about[file.name]} bytes, and has {found}"
            raise ValueError(_damaged(folder, file, why))
    return state, about


def restore(
    folder: Path, trainer: Trainer, checkpoint: tuple[dict[str, Tensor], dict[str, Any]]
) -> None:
    """Put a trainer, and the curve, where a checkpoint has them.

    Raises:
        ValueError: the replay is not the one that the checkpoint belongs to.
    """
    state, about = checkpoint
    trainer.restore(state)
    if about["ends"] != _ends(trainer.collector.replay):
        path = folder / SUBFOLDER / "replay.f32"
        raise ValueError(_damaged(folder, path, "it is not as it was at the checkpoint"))
    trainer.members.diverged.update({int(seed): why for seed, why in about["diverged"].items()})
    os.truncate(folder / "curve.csv", about["curve.csv"])


def reached(folder: Path, spec: RunSpec) -> int:
    """Return the step from which a run goes on."""
    found = load(folder, spec)
    return found[1]["steps"] if found else 0


def _damaged(folder: Path, path: Path, why: object) -> str:
    return f"{path} is damaged: {why}; bring all of {folder} back, or start a new run"


def _identity(folder: Path, spec: RunSpec) -> dict[str, Any]:
    """Return all that a checkpoint depends on and that must stay as it is."""
    given = inputs.recorded(folder, spec)
    identity = {
        **spec.config.flat(),
        **spec.execution,
        "seeds": spec.seeds,
        "checkpoint_every": spec.checkpoint_every,
        "demonstrations": spec.demonstrations and spec.demonstrations["digest"],
        **{name: inputs.digest_of(thing) for name, thing in given.items()},
    }
    del identity["total_steps"]
    return identity


def _ends(replay: Replay) -> str:
    """Return the SHA-256 of each member's oldest and newest row.

    It tells one replay from others, and from itself at another time.
    """
    last = replay.added - 1
    first = replay.added - torch.tensor(replay.sizes)
    rows = replay.rows[torch.stack([first, last]) % len(replay.rows), torch.arange(len(last))]
    return inputs.digest({"rows": rows})


def most_steps_between(spec: RunSpec) -> int:
    """Return the most steps between two checkpoints, which are taken at the ends of blocks.

    The block in which the warm-up ends may be cut short, and add to the next.
    """
    config = spec.config
    block = config.schedule.update_every or envs.spec(config.env_id).max_episode_steps
    return spec.checkpoint_every + 2 * (block or config.total_steps)


def disk_space(spec: RunSpec) -> int:
    """Return the bytes that a run takes at most: its replay, and a margin for all else."""
    config = spec.config
    with closing(envs.make(config.env_id, 1, 0)) as env:
        obs = env.single_observation_space.shape[0] + (config.schedule.absorbing != "none")
        width = 2 * obs + env.single_action_space.shape[0] + 2
    rows = replay_slots(config.schedule, most_steps_between(spec))
    return len(spec.seeds) * (4 * rows * width + MARGIN)


def missing_space(folder: Path, spec: RunSpec) -> int:
    """Return the bytes that a run may still take, beside the replay that it has."""
    replay = folder / SUBFOLDER / "replay.f32"
    return disk_space(spec) - (replay.stat().st_size if replay.is_file() else 0)


def require_room(place: Path, space: int, config: Config) -> None:
    """Refuse a run for which the disk of a folder, which may be a new one, has no room.

    Raises:
        OSError: it has less than `space` bytes left.
    """
    there = place.absolute()
    free = shutil.disk_usage(next(path for path in (there, *there.parents) if path.exists())).free
    if free < space:
        raise OSError(
            f"the run needs {in_words(space)} of disk, mostly replay, and {place} has "
            f"{in_words(free)} left: lower replay_size ({config.schedule.replay_size}), give "
            "fewer seeds, or choose another disk"
        )


@contextmanager
def full_disk_explained(folder: Path, spec: RunSpec) -> Iterator[None]:
    """Say what to do when the disk of a run is full.

    Raises:
        OSError: the disk is full.
    """
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        raise OSError(
            f"the disk of {folder} is full: free {in_words(missing_space(folder, spec))}, and "
            f"`offairl resume {folder}` goes on from the last checkpoint"
        ) from error


def in_words(size: int) -> str:
    """Return a number of bytes, such as `12.0 MB`."""
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.1f} MB"


@contextmanager
def lock(folder: Path) -> Iterator[None]:
    """Hold a run folder's lock, which ends with the process if not before.

    Raises:
        OSError: another process holds it.
    """
    (folder / SUBFOLDER).mkdir(exist_ok=True)
    try:
        with FileLock(folder / SUBFOLDER / "lock", timeout=0):
            yield
    except Timeout:
        raise OSError(
            f"another process is at work on {folder}: let it finish, or stop it"
        ) from None
