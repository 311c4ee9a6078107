"""Demo scale or full scale: the one place that reads `OFFAIRL_SCALE`."""

import os
from typing import Literal, get_args

Scale = Literal["demo", "full"]


def current() -> Scale:
    """Return the scale that `OFFAIRL_SCALE` names, `demo` where it is unset.

    `demo` trains really, but small: minutes on two cores. `full` is the paper's protocol.

    Raises:
        ValueError: the variable holds anything but `demo` or `full`.
    """
    scale = os.environ.get("OFFAIRL_SCALE", "demo")
    if scale not in get_args(Scale):
        raise ValueError(f"OFFAIRL_SCALE is {scale!r}; set it to 'demo' or 'full', or unset it")
    return scale
