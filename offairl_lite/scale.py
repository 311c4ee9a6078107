"""Demo scale or full scale: the one place that reads `OFFAIRL_SCALE`."""

import os
from typing import Literal

Scale = Literal["demo", "full"]


def current() -> Scale:
    """Return the scale that `OFFAIRL_SCALE` names, `demo` where it is unset.

    `demo` trains really, but small: minutes on two cores. `full` is the paper's protocol.

    Raises:
        ValueError: the variable holds anything but `demo` or `full`.
    """
    match os.environ.get("OFFAIRL_SCALE", "demo"):
        case "demo" | "full" as scale:
            return scale
        case other:
            raise ValueError(f"OFFAIRL_SCALE is {other!r}; set it to 'demo' or 'full', or unset it")
