"""Transitions, and the replay buffer of a population."""

import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from offairl_lite.config import Schedule
from offairl_lite.core.rng import Rng


class Batch(NamedTuple):
    """Transitions; the leading axes are usually `S B`.

    `terminated` is 1 where the task ended for good; after a time limit the next value counts.
    """

    obs: Float[Tensor, "*batch O"]
    pre_tanh: Float[Tensor, "*batch A"]
    next_obs: Float[Tensor, "*batch O"]
    reward: Float[Tensor, "*batch"]
    terminated: Float[Tensor, "*batch"]

    @property
    def action(self) -> Float[Tensor, "*batch A"]:
        """The actions, in [-1, 1]."""
        return torch.tanh(self.pre_tanh)


Parts = TypeVar("Parts", bound=tuple)


def split(batch: Parts, size: int) -> list[Parts]:
    """Cut the second axis of transitions into minibatches of `size`, which are views."""
    return [type(batch)(*parts) for parts in zip(*(x.split(size, 1) for x in batch), strict=True)]


LogDensity = Callable[[Batch], Float[Tensor, "S B"]]  #: log π of each transition of a scaled batch.
CHUNK = 50  #: Minibatches that are drawn at a time.


def chunks(minibatches: int) -> Iterator[int]:
    """Cut a number of minibatches into those that are drawn at a time."""
    return (min(CHUNK, minibatches - done) for done in range(0, minibatches, CHUNK))


def pack(batch: Batch) -> Float[Tensor, "*batch D"]:
    """Lay transitions out as rows, so that a minibatch is one gather."""
    return torch.cat([*batch[:3], batch.reward.unsqueeze(-1), batch.terminated.unsqueeze(-1)], -1)


def unpack(rows: Float[Tensor, "*batch D"], obs_dim: int) -> Batch:
    """Undo `pack`; the parts are views."""
    action_dim = rows.shape[-1] - 2 * obs_dim - 2
    widths = [obs_dim, action_dim, obs_dim, 1, 1]
    obs, pre_tanh, next_obs, reward, terminated = rows.split(widths, -1)
    return Batch(obs, pre_tanh, next_obs, reward.squeeze(-1), terminated.squeeze(-1))


def sample(demonstrations: Batch, rng: Rng, count: int) -> Batch:
    """Draw `count` of demonstrated transitions, axes `N`, for each member."""
    index = rng.integers([len(demonstrations.obs)] * len(rng), count)
    return Batch(*(part[index] for part in demonstrations))


class Replay:
    """The last `capacity` transitions of each member, which fill at their own pace.

    Rows stay in main memory, or in a `file` that is mapped into it; samples go to `device`. With
    more `slots` than `capacity`, a replay that is put back by some steps still finds its rows.
    """

    def __init__(
        self,
        population: int,
        capacity: int,
        obs_dim: int,
        action_dim: int,
        device: str | torch.device = "cpu",
        *,
        file: Path | None = None,
        slots: int | None = None,
    ) -> None:
        self.obs_dim, self.capacity, self.device = obs_dim, capacity, torch.device(device)
        shape = (slots or capacity, population, 2 * obs_dim + action_dim + 2)
        self._map = None if file is None else _mapped(file, shape)
        self.rows = torch.zeros(shape) if self._map is None else torch.from_numpy(self._map)
        self.added = torch.zeros(population, dtype=torch.long)
        self._everyone = torch.arange(population)

    @property
    def sizes(self) -> list[int]:
        """Transitions held for each member."""
        return self.added.clamp(max=self.capacity).tolist()

    def add(self, batch: Batch, members: Int[Tensor, "M"] | None = None) -> None:
        """Add one transition for each member, or for each of `members`, axes `M`."""
        rows, members = pack(batch), self._everyone if members is None else members
        if rows.shape != (shape := (len(members), self.rows.shape[-1])):
            raise ValueError(f"transitions pack to {tuple(rows.shape)}; this replay takes {shape}")
        self.rows[self.added[members] % len(self.rows), members] = rows.to(self.rows)
        self.added[members] += 1

    def held(self, member: int) -> Batch:
        """Return all that is held for one member, oldest first, axes `N`."""
        added = int(self.added[member])
        slots = torch.arange(added - self.sizes[member], added) % len(self.rows)
        return unpack(self.rows[slots, member].to(self.device), self.obs_dim)

    def last(self, count: int) -> Batch:
        """Return the last `count` transitions of each member, oldest first: axes `S count`."""
        if min(self.sizes) < count:
            raise ValueError(f"the last {count} transitions are wanted; held are {self.sizes}")
        return self._gather(self.added.unsqueeze(1) - count + torch.arange(count))

    def sample(self, rng: Rng, count: int) -> Batch:
        """Draw `count` transitions of each member: axes `S count`."""
        if not min(sizes := self.sizes):
            raise ValueError(f"a member's replay is empty (sizes {sizes}): add to it")
        oldest = (self.added - torch.tensor(sizes)).unsqueeze(1)
        return self._gather(oldest + rng.integers(sizes, count).cpu())

    def _gather(self, position: Int[Tensor, "S M"]) -> Batch:
        """Return transitions by their place in the order in which they were added."""
        slots, population, width = self.rows.shape
        index = position % slots * population + self._everyone.unsqueeze(1)
        rows = self.rows.view(-1, width).index_select(0, index.flatten())
        return unpack(rows.view(*index.shape, width).to(self.device), self.obs_dim)

    def flush(self) -> None:
        """Have what was added reach the disk."""
        if self._map is not None:
            self._map.flush()


def _mapped(file: Path, shape: tuple[int, int, int]) -> np.memmap:
    """Map a file of rows, which is made, or lengthened with zeros, to hold `shape`."""
    size = 4 * math.prod(shape)
    with open(file, "ab") as stream:
        missing = max(size - stream.tell(), 0)
        # The room is taken now: a mapped page that finds no room later kills the process.
        if missing and hasattr(os, "posix_fallocate"):
            os.posix_fallocate(stream.fileno(), size - missing, missing)
        else:
            for start in range(0, missing, 2**24):
                stream.write(bytes(min(2**24, missing - start)))
    return np.memmap(file, np.float32, "r+", shape=shape)


def replay_slots(schedule: Schedule, memory: int) -> int:
    """Return the rows to allocate for a member: `replay_size` and room to rewind `memory` steps."""
    # A terminated episode may add a row of the absorbing state.
    rows = 1 if schedule.absorbing == "none" else 2
    return min(schedule.replay_size + rows * memory, rows * schedule.total_steps)
