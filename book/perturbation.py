"""Pretend to be another processor.

Other processors round differently, and libraries have other kernels for
them. So perturbation `number` changes what a page computes by about a
rounding error: initial weights, learning rates and actions by a millionth,
and the kernels of PyTorch and NumPy. Number 0 changes nothing. A number
changes the same things in the same way, however often they are computed,
so that a seed still gives the same run twice.
"""

import os
import platform
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import nbformat
import numpy as np
from nbclient import NotebookClient

SIZE = 1e-6
"""Relative change of weights, learning rates and actions."""
KERNELS = {
    "ATEN_CPU_CAPABILITY": ("", "default", "avx2"),  # all of PyTorch
    "MKL_CBWR": ("", "AVX2", "COMPATIBLE"),  # its matrix products
    "OPENBLAS_CORETYPE": ("", "Haswell", "Sandybridge"),  # NumPy's
    "OPENBLAS_NUM_THREADS": ("1", "2"),
    "NPY_DISABLE_CPU_FEATURES": ("", "X86_V3,X86_V4"),  # NumPy's exp, log
}


def run(
    page: Path, number: int, scratch: Path, book: Path
) -> list[dict[str, str]]:
    """Return what became of a page's statements under a perturbation."""
    notebook = nbformat.read(page, as_version=4)
    first = f"__import__('perturbation').start({number})"
    notebook.cells.insert(0, nbformat.v4.new_code_cell(first))
    quiet = ["--IPKernelApp.log_level=40"]
    client = NotebookClient(
        notebook,
        timeout=600,
        kernel_name="python3",
        extra_arguments=quiet,
    )
    with tempfile.TemporaryDirectory(dir=scratch) as folder:
        variables = {
            "OFFAIRL_STRICT": "",
            "OFFAIRL_SCALE": "demo",
            "OMP_NUM_THREADS": "1",
            "PYTHONPATH": os.pathsep.join([str(book), str(book.parent)]),
            "IPYTHONDIR": f"{folder}/ipython",
            # Demonstrations that are made here are perturbed, too.
            "MINARI_DATASETS_PATH": f"{scratch}/minari-{number}",
        }
        env = {**os.environ, **variables, **kernels(number)}
        # A copy, so that pages may write beside themselves.
        place = Path(folder) / page.relative_to(book.parent).parent
        place.mkdir(parents=True)
        for path in book.iterdir():
            if path.suffix != ".ipynb" and path.name != "notes":
                (Path(folder) / "book" / path.name).symlink_to(path)
        try:
            client.execute(cwd=str(place), env=env)
            evidence = "it does not call `hold`"
        except Exception as error:  # Whatever it is, it is counted.
            evidence = " ".join(str(error).split())[-300:]
    outputs = [out for c in notebook.cells for out in c.get("outputs", [])]
    data = [out.get("metadata", {}).get("checks", []) for out in outputs]
    ends = {"name": "(runs to its end)", "evidence": evidence}
    return [one for found in data for one in found] or [ends]


def kernels(number: int) -> dict[str, str]:
    """Return the environment variables with which a process is to start."""
    if not number or platform.machine().lower() not in ("x86_64", "amd64"):
        return {}
    chosen = {
        name: values[number // (1 + i) % len(values)]
        for i, (name, values) in enumerate(KERNELS.items())
    }
    return {name: value for name, value in chosen.items() if value}


def start(number: int) -> None:
    """Perturb this process, before it computes anything; draw nothing."""
    skip_pictures()
    if number:
        rng = np.random.default_rng((number, 1))
        weights, rate, action = SIZE * rng.uniform(0.3, 1, 3)
        perturb_weights(weights, number)
        perturb_rates(1 + rate * rng.choice((-1, 1)))
        perturb_actions(1 - action)  # Smaller, so within the bounds.


def perturb_weights(size: float, seed: int) -> None:
    """Change the networks' initial weights."""
    import torch

    from offairl_lite.core.networks import StackedMLP

    def perturbed(init: Callable[..., torch.Tensor]) -> Callable:
        @torch.no_grad()
        def changed(*args: Any, **kwargs: Any) -> torch.Tensor:
            drawn = init(*args, **kwargs)
            # The same for all members, whichever are trained together.
            rng = torch.Generator().manual_seed(seed)
            noise = torch.rand(drawn.shape[-1], generator=rng)
            return drawn.mul_(1 + size * (2 * noise - 1))

        return changed

    uniform = torch.nn.init.xavier_uniform_
    torch.nn.init.xavier_uniform_ = perturbed(uniform)
    StackedMLP.init = perturbed(StackedMLP.init)


def perturb_rates(factor: float) -> None:
    """Change the learning rates."""
    from torch import optim

    from offairl_lite.core import networks

    ours, theirs = networks.Adam.__init__, optim.Adam.__init__

    def adam(self: Any, params: Any, learning_rate: float) -> None:
        ours(self, params, learning_rate * factor)

    def torch_adam(
        self: Any, params: Any, lr: float = 1e-3, *args: Any, **kwargs: Any
    ) -> None:
        theirs(self, params, lr * factor, *args, **kwargs)

    networks.Adam.__init__ = adam
    optim.Adam.__init__ = torch_adam


def perturb_actions(factor: float) -> None:
    """Change the actions that tasks receive, whoever acts."""
    from gymnasium.wrappers import OrderEnforcing  # of `gymnasium.make`

    from offairl_lite.envs import BatchedEnv

    for kind in (BatchedEnv, OrderEnforcing):
        step = kind.step

        def changed(self: Any, action: Any, step: Callable = step) -> Any:
            return step(self, action * factor)

        kind.step = changed


def skip_pictures() -> None:
    """Draw nothing: it takes long, and no statement depends on it."""
    import matplotlib.pyplot as plt
    from matplotlib.figure import Figure

    from offairl_lite.analysis import films

    pictures: dict[str, np.ndarray] = {}
    render = films._picture

    def first(env: Any, env_id: str) -> np.ndarray:
        if env_id not in pictures:
            pictures[env_id] = render(env, env_id)
        return pictures[env_id]

    films._picture = first
    films.mp4 = lambda *args, **kwargs: b""
    Figure.draw = lambda *args: None
    plt.show = lambda *args, **kwargs: plt.close("all")
