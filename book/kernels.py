"""Start the kernels of pages as copies of one process.

PyTorch, MuJoCo and Matplotlib take two seconds to import, longer than most
laboratory notes take to run. So one process imports them, before it has
any threads, and each kernel is a fork of it.
"""

import multiprocessing
import os
import sys
import time
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Any

from jupyter_client.provisioning import local_provisioner

IMPORTED = (
    "offairl_lite.core.loop",
    "offairl_lite.runs.records",
    "matplotlib.figure",
    "ipykernel.kernelapp",
)
INLINE = "module://matplotlib_inline.backend_inline"
"""Where Matplotlib draws. A kernel says so before anything is imported."""


def serve(arguments: list[str], cwd: str, env: dict[str, str]) -> None:
    """Be a kernel, in a process group of its own."""
    os.setsid()
    os.chdir(cwd)
    os.environ.update(env)
    # Pages import from the folder beside them, not from this script's.
    here = str(Path(__file__).parent)
    sys.path[:] = [path for path in sys.path if path != here]
    from ipykernel.kernelapp import IPKernelApp

    # It ends if its parent does.
    parent = f"--IPKernelApp.parent_handle={os.getppid()}"
    IPKernelApp.launch_instance([*arguments, parent])


class Fork(ForkServerProcess):
    """A kernel, with what `jupyter_client` asks of a process."""

    stdin = stdout = stderr = None

    def __init__(
        self, command: list[str], cwd: str, env: dict[str, str], **_: Any
    ) -> None:
        arguments = command[command.index("ipykernel_launcher") + 1 :]
        super().__init__(target=serve, args=(arguments, cwd, env))
        self.start()
        assert self.pid is not None
        # While it has no group of its own, a signal to its group is for us.
        while self.is_alive() and os.getpgid(self.pid) != self.pid:
            time.sleep(0.001)

    def poll(self) -> int | None:
        """Return its exit status, None while it runs."""
        return self.exitcode

    def wait(self, timeout: float | None = None) -> int | None:
        """Wait until it ends, and return its exit status."""
        self.join(timeout)
        return self.exitcode

    def send_signal(self, number: int) -> None:
        """Send it a signal."""
        assert self.pid is not None
        os.kill(self.pid, number)


def fork() -> None:
    """From now on start kernels as copies, where that is safe.

    On macOS it is not: system libraries do not expect to be copied.
    """
    if sys.platform == "linux":
        os.environ.setdefault("MPLBACKEND", INLINE)
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(list(IMPORTED))
        local_provisioner.launch_kernel = Fork  # type: ignore[assignment]
