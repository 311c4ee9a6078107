"""How updates are executed: as they are written, compiled, or replayed as a CUDA graph.

The update is the same function in each case; only the order of floating-point sums may differ.
Compiled, hundreds of small operations become a few dozen, at two to three times the speed.
"""

import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, wraps
from typing import Any, Literal

import torch
from torch import Tensor
from torch.utils._pytree import tree_leaves, tree_map_only

from offairl_lite.config import Config
from offairl_lite.config.settings import checked


@dataclass(frozen=True)
class Execution:
    """Where and how a run is computed. Another choice gives the same run up to rounding."""

    device: str = "cpu"  #: Where networks live, `cpu` or `cuda`.
    threads: int = 1  #: Of PyTorch, in the whole process, and of the physics.
    compile: bool = False  #: Whether updates are compiled: it takes a C++ compiler and a minute.
    onednn: bool = False
    """Whether oneDNN makes the products of large networks, if that costs no precision."""

    def __post_init__(self) -> None:
        if not 1 <= self.threads <= 256:
            raise ValueError(f"threads is {self.threads}; expected a number from 1 to 256")
        if self.device != "cpu" and not torch.cuda.is_available():
            raise ValueError(f"device is {self.device!r}, and PyTorch sees no GPU here: use cpu")
        if self.compile and self.device == "cpu" and compiler() is None:
            raise ValueError(
                "compile needs a C++ compiler, and there is none: install g++ (Debian, Ubuntu: "
                "apt install g++; macOS: xcode-select --install), or go without"
            )

    def accelerate(self, step: Callable, hidden: tuple[int, ...]) -> Callable:
        """Return a function that does what `step` does, an update of networks with `hidden` layers.

        It takes tensors, always of the same shapes, tuples, None and flags; it returns tensors.
        """
        if self.compile:
            # Gradients are taken inside the function that is compiled.
            torch._dynamo.config.trace_autograd_ops = True
            # One form for each learner and flag; a process may hold many learners.
            torch._dynamo.config.recompile_limit = 1_000
            torch._dynamo.config.accumulated_recompile_limit = 1_000
            step = torch.compile(step, fullgraph=True, dynamic=False)
        if self.onednn and is_large(hidden) and onednn_is_exact():
            step = with_onednn(step)
        return step if self.device == "cpu" else CudaGraphed(step)


def is_large(hidden: tuple[int, ...]) -> bool:
    """Return whether networks are so large that the time goes to arithmetic, not to calls."""
    return max(hidden, default=0) > 128


def choose_execution(
    config: Config, device: str, threads: int = 1, compile: Literal["auto", "yes", "no"] = "auto"
) -> Execution:
    """Return how a run is best executed; `auto` compiles long ones where there is a compiler."""
    checked("device", device, Literal["cpu", "cuda"])
    checked("compile", compile, Literal["auto", "yes", "no"])
    onednn = device == "cpu" and is_large(config.learner.hidden) and onednn_is_faster()
    if compile == "auto" and config.total_steps >= 50_000 and compiler() is not None:
        compile = "yes"
    return Execution(device, threads, compile == "yes", onednn)


PIECE = 500  #: Rows that go through a large network at once where `piecewise` has a say.


def piecewise(function: Callable[..., Tensor]) -> Callable[..., Tensor]:
    """Return `function` for one member at a time and few rows, which stay in a core's cache."""

    @wraps(function)
    def pieces(params: Tensor, *tensors: Tensor) -> Tensor:
        outputs = []
        members = zip(params.split(1), *(x.split(1) for x in tensors), strict=True)
        for weights, *member in members:
            for rows in zip(*(x.split(PIECE, 1) for x in member), strict=True):
                outputs.append(function(weights, *rows))
        return torch.cat(outputs, 1).view(tensors[0].shape[:2])

    return pieces


def compiler() -> str | None:
    """Return the C++ compiler that PyTorch would use, or None."""
    return shutil.which("g++") or shutil.which("clang++")


def with_onednn(step: Callable) -> Callable:
    """Return `step`, its matrix products made by oneDNN.

    PyTorch's own MKL uses half the width of an AMD processor's vectors. oneDNN uses all of it, and
    is asked where rounding to 16 bits is allowed: whether it rounds, `onednn_is_exact` finds out.
    """
    settings: Any = torch.backends.mkldnn.matmul  # type: ignore[attr-defined]

    @wraps(step)
    def stepped(*args: Any) -> Any:
        before, settings.fp32_precision = settings.fp32_precision, "bf16"
        try:
            return step(*args)
        finally:
            settings.fp32_precision = before

    return stepped


@cache
def onednn_is_exact() -> bool:
    """Return whether `with_onednn` leaves products in single precision, by making one."""
    # A sum of 256 products is about 16. Single precision misses it by 1e-5, 16 bits by 0.1.
    x = torch.randn(2, 256, 256, generator=torch.Generator().manual_seed(0))
    error = with_onednn(torch.bmm)(x, x) - torch.bmm(x.double(), x.double())
    return error.abs().max().item() < 1e-3


@cache
def onednn_is_faster() -> bool:
    """Return whether products of a large network take less time here `with_onednn`."""
    generator = torch.Generator().manual_seed(0)
    x, w = (torch.randn(2, n, 256, generator=generator) for n in (100, 256))
    kinds: dict[bool, Callable] = {False: torch.bmm, True: with_onednn(torch.bmm)}
    seconds: dict[bool, list[float]] = {False: [], True: []}
    for _ in range(20):  # They take turns, and the best counts: the machine may be busy.
        for kind, product in kinds.items():
            start = time.perf_counter()
            for _ in range(10):
                product(x, w)
            seconds[kind].append(time.perf_counter() - start)
    return min(seconds[True]) < 0.9 * min(seconds[False])


class CudaGraphed:
    """A step that is captured as a CUDA graph the second time it is called with the same flags.

    The first call runs as written, to make libraries ready. Capturing itself computes nothing.
    """

    def __init__(self, step: Callable) -> None:
        self.step = step
        self.graphs: dict[tuple, tuple[torch.cuda.CUDAGraph, Any, dict[str, Tensor]] | None] = {}

    def __call__(self, *args: Any) -> dict[str, Tensor]:
        """Make the update."""
        leaves = tree_leaves(args)
        key = tuple(x.shape if isinstance(x, Tensor) else x for x in leaves)
        captured = self.graphs.get(key)
        if captured is None:
            # With the strides of the graph's inputs, so that capturing compiles nothing anew.
            inputs = tree_map_only(Tensor, torch.clone, args)
            if key not in self.graphs:
                self.graphs[key] = None
                return self.step(*inputs)
            graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(graph):
                outputs = self.step(*inputs)
            captured = self.graphs[key] = graph, tree_leaves(inputs), outputs
        graph, places, outputs = captured
        for place, value in zip(places, leaves, strict=True):
            if isinstance(place, Tensor):
                place.copy_(value)
        graph.replay()
        return {name: value.clone() for name, value in outputs.items()}
