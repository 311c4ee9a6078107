"""Demo scale or full scale: the one place that reads `OFFAIRL_SCALE`."""

import os
from typing import Literal

from offairl_lite.config.settings import checked

Scale = Literal["demo", "full"]


def current() -> Scale:
    """Return `OFFAIRL_SCALE`: `demo`, the default, or `full`, the paper's; else ValueError."""
    return checked("OFFAIRL_SCALE", os.environ.get("OFFAIRL_SCALE", "demo"), Scale)
