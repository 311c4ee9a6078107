"""Roll-outs and short trainings of which a page tells, made once and kept.

Legged robots are chaotic: on another processor a rounding error becomes
another trajectory within seconds. So what a page says of such roll-outs is
computed once, on the machine that made the other records. The module
`rollouts.NAME` computes it, in its function `record`, and
`records/rollouts/NAME.json` keeps it:

    PYTHONPATH=book .venv/bin/python -m rollouts NAME

computes it afresh; `git diff` then shows what has changed. A film of robots
is kept beside it, `records/rollouts/NAME.mp4`.
"""

import importlib
import json
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import mediapy
import numpy as np
from IPython.display import HTML

RECORDS = Path(__file__).parents[1] / "records"
KEPT = RECORDS / "rollouts"
DIGITS = 6
"""Digits of each number that are kept."""


def read(name: str) -> dict[str, Any]:
    """Return what `record` of a module returned; lists become arrays."""
    return _arrays(json.loads((KEPT / f"{name}.json").read_text("utf-8")))


def film(name: str, caption: str) -> HTML:
    """Return a player of a recorded film."""
    recorded = (KEPT / f"{name}.mp4").read_bytes()
    # A track's header ends with its size, in 65,536ths of a pixel.
    size = struct.unpack_from(">II", recorded, recorded.index(b"tkhd") + 80)
    width, height = (side >> 16 for side in size)
    player = mediapy.html_from_compressed_video(recorded, width, height)
    return HTML(
        f"<figure>{player}<figcaption>{caption}</figcaption></figure>"
    )


def write(names: Iterable[str]) -> None:
    """Compute the results of some modules afresh, and keep them."""
    KEPT.mkdir(exist_ok=True)
    for name in names:
        result = importlib.import_module(f"rollouts.{name}").record()
        lines = [
            f"{json.dumps(key)}: {json.dumps(_plain(value))}"
            for key, value in result.items()
        ]
        text = "{\n" + ",\n".join(lines) + "\n}\n"
        (KEPT / f"{name}.json").write_text(text, "utf-8")
        print(f"{KEPT / name}.json: {len(text):,} bytes")


def _plain(value: Any) -> Any:
    """Return numbers as JSON holds them, rounded."""
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    if hasattr(value, "tolist"):  # of NumPy and PyTorch
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    return (
        float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value
    )


def _arrays(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _arrays(part) for key, part in value.items()}
    if isinstance(value, list) and any(isinstance(x, dict) for x in value):
        return [_arrays(part) for part in value]
    return np.array(value) if isinstance(value, list) else value
