"""What a run needs to go on, in `checkpoint/`, its disk space, and its lock.

There are `checkpoint.safetensors`, the trainer's state and what it belongs to; `replay.f32`, the
replay, mapped into memory; `lock`, held by the process that trains; and `log.txt`, its output.
"""

import json
import os
import shutil
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from filelock import FileLock, Timeout
from gymnasium.spaces.utils import flatdim
from torch import Tensor

from offairl_lite import envs
from offairl_lite.config import DiscriminatorConfig, flat_settings
from offairl_lite.core.collector import part_of
from offairl_lite.core.loop import Trainer
from offairl_lite.core.networks import StackedMLP, load_weights, save_weights
from offairl_lite.core.policies import make_actor
from offairl_lite.core.replay import Replay, replay_slots
from offairl_lite.runs import records
from offairl_lite.runs.inputs import digest
from offairl_lite.runs.records import RunSpec, damaged

CHECKPOINT, REPLAY = Path("checkpoint/checkpoint.safetensors"), Path("checkpoint/replay.f32")

MARGIN = 2**23  #: Bytes of disk for each seed besides replay, policies and rewards.
Found = tuple[dict[str, Tensor], dict[str, Any]]  #: A trainer's state, and what is said about it.
FORMAT = 4  #: Of checkpoints; it changes when older ones can no longer be resumed.
BLOCK = 1024  #: Places in the replay, with the rows of all members, that have one checksum.


class Checksums:
    """The CRC-32 of each block of a replay's file: of rows that are held, since others may go."""

    def __init__(self, replay: Replay) -> None:
        self.replay, self.held = replay, np.zeros((2, len(replay.added)), int)
        self.blocks = [0] * -(-len(replay.rows) // BLOCK)

    def update(self) -> list[int]:
        """Return the checksums; only blocks in which rows have come or gone are read again."""
        rows, added, sizes = self.replay.rows, self.replay.added, torch.tensor(self.replay.sizes)
        slots, before = len(rows), self.held
        self.held = torch.stack([added - sizes, added]).numpy()
        pairs = zip(before.flat, self.held.flat, strict=True)
        places = [np.arange(max(old, new - slots), new) % slots for old, new in pairs]
        for block in np.unique(np.concatenate(places) // BLOCK).tolist():
            some = rows[block * BLOCK : (block + 1) * BLOCK]
            age = added - 1 - torch.arange(len(some)).unsqueeze(1) - block * BLOCK
            self.blocks[block] = zlib.crc32(some[age % slots < sizes].numpy().data)
        return self.blocks


def save(folder: Path, spec: RunSpec, trainer: Trainer, wall_s: float, blocks: list[int]) -> None:
    """Keep a trainer's state. The replay file still has what the checkpoint before it needs."""
    trainer.collector.replay.flush()
    with open(folder / "curve.csv", "rb") as file:
        os.fsync(file.fileno())
    state = trainer.state()
    metadata = {
        "kind": "checkpoint",
        "format": FORMAT,
        "identity": _identity(spec),
        "steps": trainer.steps,
        "curve.csv": (folder / "curve.csv").stat().st_size,
        "replay.f32": (folder / REPLAY).stat().st_size,
        "curve": zlib.crc32((folder / "curve.csv").read_bytes()),
        "blocks": blocks,
        "wall_s": wall_s,
        "diverged": trainer.members.diverged,
    }
    metadata["digest"] = digest(state, metadata)
    records.write_whole(folder / CHECKPOINT, lambda part: save_weights(part, state, metadata))


def load(folder: Path, spec: RunSpec) -> Found | None:
    """Return a run's checkpoint; None if there is none yet.

    Raises:
        FileNotFoundError: it is gone.
        ValueError: a file is damaged, or of another run, or the task cannot be played again.
    """
    path, step = folder / CHECKPOINT, records.read_state(folder)["step"]
    if not path.is_file():
        if step:
            raise FileNotFoundError(
                f"{path} is gone, and the run had reached step {step}: bring all of {folder} back, "
                "or start a new run"
            )
        return None
    try:
        state, metadata = load_weights(path, "checkpoint")
        sound = metadata.pop("digest", None) == digest(state, metadata)
    except ValueError as error:
        raise damaged(folder, path, error) from error
    records.require_format(path, metadata.get("format", 1), FORMAT)
    if not sound:
        raise damaged(folder, path, "its contents are not those that were written")
    # A setting that the checkpoint does not know has the value it had before there was one.
    defaults = {name: default for name, (_, default, _) in flat_settings().items()}
    was, now = json.loads(json.dumps(defaults)) | metadata["identity"], _identity(spec)
    changed = [f"{k} was {was.get(k)!r}, is {now[k]!r}" for k in now if was.get(k) != now[k]]
    if changed:
        raise ValueError(
            f"{path} is of another run than {folder}/config.json: {'; '.join(changed)}; put back "
            "what was changed, or start a new run"
        )
    for file in (folder / "curve.csv", folder / REPLAY):
        size = file.stat().st_size if file.is_file() else 0
        if size < metadata[file.name]:
            raise damaged(folder, file, f"it had {metadata[file.name]} bytes, and has {size}")
    records.require_checksum(folder / "curve.csv", metadata.get("curve"), metadata["curve.csv"])
    if (reached := metadata["steps"]) > spec.config.total_steps:
        raise ValueError(
            f"{folder} has reached step {reached}; it cannot end at {spec.config.total_steps}: "
            f"`offairl resume {folder} --steps N` takes any N from {reached} on"
        )
    if reached < spec.config.total_steps:
        with closing(envs.make(spec.config.env_id, len(spec.seeds), spec.seeds)) as env:
            env.set_state({k: x.numpy() for k, x in part_of(state, "collector.env").items()})
    return state, metadata


def restore(folder: Path, trainer: Trainer, checkpoint: Found, checksums: Checksums) -> None:
    """Put a trainer, and the curve, where a checkpoint has them, if the replay belongs to it."""
    state, metadata = checkpoint
    trainer.restore(state)
    now = checksums.update()
    # An older checkpoint has no checksums. A run that is extended may have more blocks.
    pairs = enumerate(zip(now, metadata.get("blocks", now), strict=False))
    if wrong := [block for block, (here, there) in pairs if here != there]:
        size = BLOCK * checksums.replay.rows[0].nbytes
        where = f"{len(wrong)} of its {len(now)} blocks, the first from byte {wrong[0] * size} on"
        raise damaged(folder, folder / REPLAY, f"{where}, are not as they were at the checkpoint")
    trainer.members.diverged.update({int(seed): why for seed, why in metadata["diverged"].items()})
    os.truncate(folder / "curve.csv", metadata["curve.csv"])


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


def most_steps_between(spec: RunSpec) -> int:
    """Return the most steps between two checkpoints, which are taken at the ends of blocks.

    The block in which the warm-up ends may be cut short, and add to the next.
    """
    schedule = spec.config.schedule
    block = schedule.train_every or envs.spec(schedule.env_id).max_episode_steps
    return spec.checkpoint_every + 2 * (block or schedule.total_steps)


def disk_space(spec: RunSpec) -> int:
    """Return the bytes that a run takes at most: replay, policies, and a margin for all else."""
    schedule = spec.config.schedule
    obs, action = map(flatdim, envs.spaces(schedule.env_id))
    obs += schedule.absorbing != "none"
    # Policy and reward are kept of every evaluation.
    weights = make_actor(spec.config.learner, obs, action).num_params
    if isinstance(discriminator := spec.config.discriminator, DiscriminatorConfig):
        weights += StackedMLP((obs + action, *discriminator.reward_hidden, 1)).num_params
    evaluations = schedule.total_steps // schedule.eval_every + 1
    rows = replay_slots(schedule, most_steps_between(spec))
    numbers = rows * (2 * obs + action + 2) + evaluations * weights
    return len(spec.seeds) * (4 * numbers + MARGIN)


def require_room(place: Path, space: int) -> None:
    """Raise OSError unless the disk of a folder, which may be a new one, has so many bytes left."""
    target = place.absolute()
    free = shutil.disk_usage(next(path for path in (target, *target.parents) if path.exists())).free
    if free < space:
        raise OSError(
            f"{in_words(space)} of disk are needed, mostly for replay, and {place} has "
            f"{in_words(free)} left: lower replay_size, give fewer seeds, or choose another disk"
        )


def in_words(size: int) -> str:
    """Return a number of bytes, such as `12.0 MB`."""
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.1f} MB"


def copy(source: Path, target: Path) -> None:
    """Copy a run folder, whole or not at all; a run that is at `target` is replaced.

    Raises:
        FileExistsError: something else is there.
        OSError: the run is at work.
    """
    RunSpec.read(source)
    source, target = source.resolve(), target.resolve()
    taken = records.beginning(target) == target and any(target.iterdir())
    if taken and not (target / "config.json").is_file():
        raise FileExistsError(f"{target} is not empty, and no run: choose another place")
    if source == target:
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=f".{target.name}.", dir=target.parent) as hidden:
        new, old = Path(hidden) / "new", Path(hidden) / "old"
        with lock(source):
            shutil.copytree(source, new, ignore=shutil.ignore_patterns("lock", ".*"))
        with ExitStack() as undo:
            if target.exists():
                os.replace(target, old)
                undo.callback(os.replace, old, target)
            os.replace(new, target)
            undo.pop_all()


@contextmanager
def lock(folder: Path) -> Iterator[None]:
    """Hold a run folder's lock, while the process lives; OSError if another process has it."""
    try:
        with FileLock(folder / "checkpoint" / "lock", timeout=0):
            yield
    except Timeout:
        who = _holder(folder / "checkpoint" / "lock")
        raise OSError(f"{who} is at work on {folder}: let it finish, or stop it") from None


def _holder(path: Path) -> str:
    """Return which process has locked a file, where Linux says so."""
    locks, inode = Path("/proc/locks"), f":{path.stat().st_ino} "
    lines = locks.read_text().splitlines() if locks.exists() else []
    pids = [line.split()[4] for line in lines if inode in line]
    return f"process {pids[0]}" if pids else "another process"
