"""Off-policy adversarial inverse reinforcement learning, small and fast."""

from typing import TYPE_CHECKING, Any

# The tasks are registered with Gymnasium, and the ablations with the settings.
from offairl_lite import ablations, envs  # noqa: F401

if TYPE_CHECKING:
    from offairl_lite.airl import AIRL

__all__ = ["AIRL"]


def __getattr__(name: str) -> Any:
    """Import `AIRL` when it is asked for: with it come Minari and MuJoCo, a second or two."""
    if name != "AIRL":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from offairl_lite.airl import AIRL

    return AIRL
