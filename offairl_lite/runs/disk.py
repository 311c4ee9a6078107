"""The disk that a run takes: known before it starts, and explained where it runs out."""

import errno
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from offairl_lite import envs
from offairl_lite.core.loop import replay_slots
from offairl_lite.core.networks import StackedMLP
from offairl_lite.core.sac import stochastic_actor
from offairl_lite.runs.records import Plan


def use(plan: Plan) -> int:
    """Return the bytes that the replay and the checkpoints of a run come to."""
    config = plan.config
    env = envs.make(config.env_id, 1, 0)
    obs = env.single_observation_space.shape[0] + (config.absorbing != "none")
    action = env.single_action_space.shape[0]
    env.close()
    rows = replay_slots(config, plan.checkpoint_every) * (2 * obs + action + 2)
    # Two critics, r and V.
    shapes = [((obs + action, *config.hidden, 1), 2)]
    if config.learns_reward:
        shapes += [((obs + action, *config.reward_hidden, 1), 1)]
        shapes += [((obs, *config.shaping_hidden, 1), 1)]
    weights = sum(count * StackedMLP(sizes).num_params for sizes, count in shapes)
    weights += stochastic_actor(config, obs, action).num_params
    # Weights, two memories of Adam's and a target; generators and environments. While a checkpoint
    # is written, the one before is still there.
    checkpoint = 4 * 4 * weights + 2**15
    return len(plan.seeds) * (4 * rows + 2 * checkpoint)


def missing(folder: Path, plan: Plan) -> int:
    """Return the bytes that a run may still take, beside the replay that it has."""
    held = sum(path.stat().st_size for path in folder.glob("members/*/replay.f32"))
    return use(plan) - held


def require_room(place: Path, needed: int, plan: Plan) -> None:
    """Refuse a run for which a disk has no room.

    Raises:
        OSError: it has less than `needed` bytes left.
    """
    free = shutil.disk_usage(place).free
    if free < needed:
        raise OSError(
            f"the run needs {words(needed)} of disk, mostly replay, and {place} has "
            f"{words(free)} left: lower replay_size ({plan.config.replay_size}), give fewer "
            "seeds, or choose another disk"
        )


@contextmanager
def explained(folder: Path, plan: Plan) -> Iterator[None]:
    """Say what to do where the disk of a run is full.

    Raises:
        OSError: it is.
    """
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        raise OSError(
            f"the disk of {folder} is full: free {words(missing(folder, plan))}, and "
            f"`offairl resume {folder}` goes on from the last checkpoint"
        ) from error


def words(size: int) -> str:
    """Return a number of bytes in words."""
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.1f} MB"
