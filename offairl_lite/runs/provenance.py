"""What produces a run: versions, machine, and the commit of the package."""

import os
import platform
import subprocess
from contextlib import suppress
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch

from offairl_lite.core.acceleration import Execution

PACKAGES = ("offairl-lite", "torch", "numpy", "mujoco", "gymnasium", "minari")


def origin(execution: Execution) -> dict[str, Any]:
    """Return what produces a run, and when it was begun."""
    return {
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {name: version(name) for name in PACKAGES},
        "machine": platform.machine(),
        "processor": processor(),
        "vectors": torch.backends.cpu.get_cpu_capability(),
        "cores": os.cpu_count(),
        "threads": execution.threads,
        "commit": _commit(),
    }


def changed(then: dict[str, Any], now: dict[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Return what two origins have otherwise of all that may change a number: before and after.

    What an older origin does not say is None.
    """
    keys = ("versions", "processor", "vectors", "commit")
    return {key: (then.get(key), now[key]) for key in keys if then.get(key) != now[key]}


def processor() -> str:
    """Return the processor's name, which only Linux keeps in a file."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _commit() -> str | None:
    """Return the commit of the package, if it runs from a checkout."""
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return None
    command = ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    with suppress(OSError):
        done = subprocess.run(command, cwd=root, capture_output=True, text=True)
        return done.stdout.strip() or None
    return None
