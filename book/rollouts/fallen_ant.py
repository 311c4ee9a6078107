"""The fallen ant among CustomAnt's usual demonstrations.

The usual ones are those with which the robots' runs were trained. Where a
processor rounds otherwise an expert shows other episodes, so what is kept
can only be computed again where the usual ones are.
"""

import numpy as np

from offairl_lite import demonstrations
from robot_runs import demonstrated


def record():
    """Return returns, rounded, and when the worst ant turns over."""
    shown = demonstrations.load("offairl/CustomAnt-v0", 50, experts=1)
    if not np.isclose(shown.returns.mean(), demonstrated("CustomAnt")):
        raise ValueError(
            "the demonstrations of CustomAnt are not the usual ones: their "
            f"mean return is {shown.returns.mean():.1f}, expected "
            f"{demonstrated('CustomAnt'):.1f}; keep the record as it is"
        )
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
