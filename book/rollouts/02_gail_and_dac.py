"""The demonstrations of Hopper, with which chapter 2 compares its runs."""

from typing import Any

from offairl_lite import demonstrations


def record() -> dict[str, Any]:
    """Return the lengths of the episodes, and how many terminated."""
    taught = demonstrations.load("Hopper-v5", experts=1)
    ended = int(taught.transitions.terminated.sum())
    return {
        "demonstrations": {"lengths": taught.lengths, "terminated": ended}
    }
