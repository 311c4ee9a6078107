"""Transitions, and the replay buffer of a population."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from offairl_lite.streams import Streams


class Batch(NamedTuple):
    """Transitions; the leading axes are usually `S B`.

    `terminated` is 1 where the task ended for good. A time limit is no termination: the next
    observation still has a value, and a learner must go on counting on it.
    """

    obs: Float[Tensor, "*batch O"]
    pre_tanh: Float[Tensor, "*batch A"]
    next_obs: Float[Tensor, "*batch O"]
    reward: Float[Tensor, "*batch"]
    terminated: Float[Tensor, "*batch"]

    def split(self, size: int) -> list["Batch"]:
        """Cut the second axis into minibatches of `size`, which are views."""
        return [Batch(*parts) for parts in zip(*(x.split(size, 1) for x in self), strict=True)]

    @property
    def action(self) -> Float[Tensor, "*batch A"]:
        """The actions, in [-1, 1]."""
        return torch.tanh(self.pre_tanh)


def pack(batch: Batch) -> Float[Tensor, "*batch D"]:
    """Lay transitions out as rows, so that a minibatch is one gather."""
    return torch.cat([*batch[:3], batch.reward.unsqueeze(-1), batch.terminated.unsqueeze(-1)], -1)


def unpack(rows: Float[Tensor, "*batch D"], obs_dim: int) -> Batch:
    """Undo `pack`; the parts are views."""
    action_dim = rows.shape[-1] - 2 * obs_dim - 2
    obs, pre_tanh, next_obs, reward, terminated = rows.split(
        [obs_dim, action_dim, obs_dim, 1, 1], -1
    )
    return Batch(obs, pre_tanh, next_obs, reward.squeeze(-1), terminated.squeeze(-1))


def gather(rows: Float[Tensor, "S N D"], index: Int[Tensor, "S M"]) -> Float[Tensor, "S M D"]:
    """Return each member's rows at its own indices, by one index operation."""
    population, capacity, width = rows.shape
    offset = torch.arange(population, device=rows.device).unsqueeze(1) * capacity
    flat = (index + offset).flatten()
    return rows.view(-1, width).index_select(0, flat).view(*index.shape, width)


class Replay:
    """The last `capacity` transitions of each member.

    Members fill at their own pace: an episode that terminates may add rows (see `absorbing`).

    Args:
        population: S.
        capacity: rows a member.
        obs_dim: O.
        action_dim: A.
        device: where the rows live.
    """

    def __init__(
        self,
        population: int,
        capacity: int,
        obs_dim: int,
        action_dim: int,
        device: str | torch.device = "cpu",
    ) -> None:
        self.obs_dim, self.capacity = obs_dim, capacity
        self.rows = torch.zeros(population, capacity, 2 * obs_dim + action_dim + 2, device=device)
        self.added = torch.zeros(population, dtype=torch.long)

    @property
    def sizes(self) -> list[int]:
        """Transitions held for each member."""
        return self.added.clamp(max=self.capacity).tolist()

    def add(self, batch: Batch, members: Int[Tensor, "M"] | None = None) -> None:
        """Add one transition for each member, or for each of `members`, axes `M`.

        Raises:
            ValueError: the shapes are not those of the buffer.
        """
        rows = pack(batch)
        members = torch.arange(len(self.rows)) if members is None else members
        if rows.shape != (len(members), self.rows.shape[-1]):
            raise ValueError(
                f"transitions pack to {tuple(rows.shape)}; this buffer takes "
                f"{(len(members), self.rows.shape[-1])} (members, 2 obs + action + 2)"
            )
        self.rows[members, self.added[members] % self.capacity] = rows.to(self.rows)
        self.added[members] += 1

    def sample(self, streams: Streams, count: int) -> Batch:
        """Draw `count` transitions of each member, uniformly with replacement: axes `S count`.

        Raises:
            ValueError: a member has no transition yet.
        """
        if min(self.sizes) == 0:
            raise ValueError(f"a member's replay is empty (sizes {self.sizes}): add to it first")
        return unpack(gather(self.rows, streams.integers(self.sizes, count)), self.obs_dim)
