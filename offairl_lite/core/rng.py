"""Random numbers for a population: one generator a member, and no global state."""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Generator, Tensor


class Rng:
    """Generators of `S` members, one for each seed, which is 0 or above.

    Seed 7 draws the same numbers, on the CPU, alone or among ten and for every `device`.
    """

    def __init__(self, seeds: Sequence[int], device: str | torch.device = "cpu") -> None:
        self.device = torch.device(device)
        # SeedSequence spreads neighbouring seeds over the generator's state.
        spread = [int(np.random.SeedSequence(seed).generate_state(1)[0]) for seed in seeds]
        self.generators = [Generator().manual_seed(seed) for seed in spread]

    def __len__(self) -> int:
        return len(self.generators)

    def _stack(self, draw: Callable[[int, Generator], Tensor]) -> Tensor:
        return torch.stack([draw(i, g) for i, g in enumerate(self.generators)]).to(self.device)

    def normal(self, *shape: int) -> Float[Tensor, "S ..."]:
        """Draw standard normal numbers, `(S, *shape)`."""
        return self._stack(lambda _, g: torch.randn(shape, generator=g))

    def uniform(self, *shape: int) -> Float[Tensor, "S ..."]:
        """Draw numbers uniform in [0, 1), `(S, *shape)`."""
        return self._stack(lambda _, g: torch.rand(shape, generator=g))

    def integers(self, high: Sequence[int], *shape: int) -> Int[Tensor, "S ..."]:
        """Draw integers uniform in [0, high), `(S, *shape)`, with a bound for each member."""
        return self._stack(lambda i, g: torch.randint(high[i], shape, generator=g))

    def integer(self, member: int, high: int) -> Int[Tensor, ""]:
        """Draw an integer uniform in [0, high) for one member alone."""
        return torch.randint(high, (), generator=self.generators[member])

    @property
    def state(self) -> UInt8[Tensor, "S bytes"]:
        """The generators' states, one row a member; assign it to go on from there."""
        return torch.stack([g.get_state() for g in self.generators])

    @state.setter
    def state(self, state: UInt8[Tensor, "S bytes"]) -> None:
        for generator, row in zip(self.generators, state, strict=True):
            generator.set_state(row.clone())
