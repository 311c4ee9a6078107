"""Demo scale or full scale: the one place that reads `OFFAIRL_SCALE`."""

import os
from typing import Literal

from offairl_lite.config.settings import checked

Scale = Literal["demo", "full"]


def current() -> Scale:
    """Return the scale that `OFFAIRL_SCALE` names: `demo`, small and in minutes, or the paper's."""
    return checked("OFFAIRL_SCALE", os.environ.get("OFFAIRL_SCALE", "demo"), Scale)
