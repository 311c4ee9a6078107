"""The fallen ant among CustomAnt's usual demonstrations."""

import numpy as np

from offairl_lite import demonstrations


def record():
    """Return returns, rounded, and when the worst ant turns over."""
    shown = demonstrations.load("offairl/CustomAnt-v0", 50, experts=1)
    lowest, second, *_, highest = np.sort(shown.returns).round().tolist()
    obs = shown.transitions.obs.view(50, 1_000, -1)
    # Two components of the torso's quaternion tell where its top is.
    sideways = obs[np.argmin(shown.returns), :, 2:4]
    lying = 1 - 2 * sideways.square().sum(1) < 0
    return {
        "lowest": lowest,
        "second": second,
        "highest": highest,
        "turns over": int(lying.int().argmax()),
        "steps on its back": int(lying.sum()),
    }
