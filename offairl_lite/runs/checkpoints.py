"""What a run needs to go on, in the subfolder `checkpoint/`, its disk space, and its lock.

- `checkpoint.safetensors`: the trainer's state, what it belongs to, and how long the curve was;
- `replay.f32`: the replay, mapped into memory, with all that the checkpoint refers to;
- `lock`: held by the process that trains;
- `log.txt`: the output of a process that another one started.
"""

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import torch
from filelock import FileLock, Timeout
from gymnasium.spaces.utils import flatdim
from torch import Tensor

from offairl_lite import envs
from offairl_lite.config import flat_settings
from offairl_lite.core.loop import Trainer, replay_slots
from offairl_lite.core.networks import load_weights, save_weights
from offairl_lite.core.replay import Replay
from offairl_lite.runs.inputs import digest
from offairl_lite.runs.records import FORMAT, RunSpec, read_json, require_format, write_whole

CHECKPOINT, REPLAY = Path("checkpoint/checkpoint.safetensors"), Path("checkpoint/replay.f32")

MARGIN = 2**23
"""Bytes of disk for each seed beside the replay: checkpoints, curve, policy and reward."""


def save(folder: Path, spec: RunSpec, trainer: Trainer, wall_s: float) -> None:
    """Keep a trainer's state. The replay file still has what the checkpoint before it needs."""
    trainer.collector.replay.flush()
    with open(folder / "curve.csv", "rb") as file:
        os.fsync(file.fileno())
    state = trainer.state()
    about = {
        "kind": "checkpoint",
        "format": FORMAT,
        "identity": _identity(spec),
        "steps": trainer.steps,
        "curve.csv": (folder / "curve.csv").stat().st_size,
        "replay.f32": (folder / REPLAY).stat().st_size,
        "ends": _ends(trainer.collector.replay),
        "wall_s": wall_s,
        "diverged": trainer.members.diverged,
    }
    about["digest"] = digest(state, about)
    write_whole(folder / CHECKPOINT, lambda part: save_weights(part, state, about))


def load(folder: Path, spec: RunSpec) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
    """Return a run's checkpoint: the state, and what is said about it; None if there is none yet.

    FileNotFoundError says that it is gone, ValueError that it or another file is damaged, or that
    it is of another format or run, or further than the run is to go.
    """
    path, step = folder / CHECKPOINT, read_json(folder / "run.json")["step"]
    if not path.is_file():
        if step:
            raise FileNotFoundError(
                f"{path} is gone, and the run had reached step {step}: bring all of {folder} back, "
                "or start a new run"
            )
        return None
    try:
        state, about = load_weights(path, "checkpoint")
        sound = about.pop("digest", None) == digest(state, about)
    except ValueError as error:
        raise _damaged(folder, path, error) from error
    require_format(path, about.get("format", 1))
    if not sound:
        raise _damaged(folder, path, "its contents are not those that were written")
    # A setting that the checkpoint does not know has the value it had before there was one.
    defaults = {name: default for name, (_, default, _) in flat_settings().items()}
    was, now = json.loads(json.dumps(defaults)) | about["identity"], _identity(spec)
    changed = [f"{k} was {was.get(k)!r}, is {now[k]!r}" for k in now if was.get(k) != now[k]]
    if changed:
        raise ValueError(
            f"{path} is of another run than {folder}/config.json: {'; '.join(changed)}; put back "
            "what was changed, or start a new run"
        )
    for file in (folder / "curve.csv", folder / REPLAY):
        found = file.stat().st_size if file.is_file() else 0
        if found < about[file.name]:
            raise _damaged(folder, file, f"it had {about[file.name]} bytes, and has {found}")
    if (reached := about["steps"]) > spec.config.total_steps:
        raise ValueError(
            f"{folder} has reached step {reached}; it cannot end at {spec.config.total_steps}: "
            f"`offairl resume {folder} --steps N` takes any N from {reached} on"
        )
    return state, about


def restore(
    folder: Path, trainer: Trainer, checkpoint: tuple[dict[str, Tensor], dict[str, Any]]
) -> None:
    """Put a trainer, and the curve, where a checkpoint has them, if the replay belongs to it."""
    state, about = checkpoint
    trainer.restore(state)
    if about["ends"] != _ends(trainer.collector.replay):
        raise _damaged(folder, folder / REPLAY, "it is not as it was at the checkpoint")
    trainer.members.diverged.update({int(seed): why for seed, why in about["diverged"].items()})
    os.truncate(folder / "curve.csv", about["curve.csv"])


def _damaged(folder: Path, path: Path, why: object) -> ValueError:
    return ValueError(f"{path} is damaged: {why}; bring all of {folder} back, or start a new run")


def _identity(spec: RunSpec) -> dict[str, Any]:
    """Return all that a checkpoint depends on and that must stay as it is, as JSON has it."""
    identity = {
        **spec.config.flat(),
        **spec.execution,
        "seeds": spec.seeds,
        "checkpoint_every": spec.checkpoint_every,
        "demonstrations": spec.demonstrations and spec.demonstrations["digest"],
        **{name: about["digest"] for name, about in spec.inherited.items()},
    }
    del identity["total_steps"]
    return json.loads(json.dumps(identity))


def _ends(replay: Replay) -> str:
    """Return the SHA-256 of each member's oldest and newest row, which tells replays apart."""
    last = replay.added - 1
    first = replay.added - torch.tensor(replay.sizes)
    rows = replay.rows[torch.stack([first, last]) % len(replay.rows), torch.arange(len(last))]
    return digest({"rows": rows})


def most_steps_between(spec: RunSpec) -> int:
    """Return the most steps between two checkpoints, which are taken at the ends of blocks.

    The block in which the warm-up ends may be cut short, and add to the next.
    """
    schedule = spec.config.schedule
    block = schedule.update_every or envs.spec(schedule.env_id).max_episode_steps
    return spec.checkpoint_every + 2 * (block or schedule.total_steps)


def disk_space(spec: RunSpec) -> int:
    """Return the bytes that a run takes at most: its replay, and a margin for all else."""
    schedule = spec.config.schedule
    with closing(envs.make(schedule.env_id, 1, 0)) as env:
        obs, action = flatdim(env.single_observation_space), flatdim(env.single_action_space)
    width = 2 * (obs + (schedule.absorbing != "none")) + action + 2
    rows = replay_slots(schedule, most_steps_between(spec))
    return len(spec.seeds) * (4 * rows * width + MARGIN)


def require_room(place: Path, space: int) -> None:
    """Raise OSError unless the disk of a folder, which may be a new one, has so many bytes left."""
    there = place.absolute()
    free = shutil.disk_usage(next(path for path in (there, *there.parents) if path.exists())).free
    if free < space:
        raise OSError(
            f"{in_words(space)} of disk are needed, mostly for replay, and {place} has "
            f"{in_words(free)} left: lower replay_size, give fewer seeds, or choose another disk"
        )


def in_words(size: int) -> str:
    """Return a number of bytes, such as `12.0 MB`."""
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.1f} MB"


@contextmanager
def lock(folder: Path) -> Iterator[None]:
    """Hold a run folder's lock, while the process lives; raise OSError if another one has it."""
    try:
        with FileLock(folder / "checkpoint" / "lock", timeout=0):
            yield
    except Timeout:
        raise OSError(
            f"another process is at work on {folder}: let it finish, or stop it"
        ) from None
