"""How strongly the ants of two rewards drive their motors."""

from typing import Any

import numpy as np

from offairl_lite.core.rollouts import rollout
from offairl_lite.runs import records
from rollouts import RECORDS


def record() -> dict[str, Any]:
    """Return the weakest action of an episode, for each seed."""
    found = {}
    for n in (1, 2):
        run = records.read(RECORDS / f"ant-rewards-demo/implementation-{n}")
        episodes = rollout(run.policy, "offairl/CustomAnt-v0", run.seeds, 1)
        found[f"implementation-{n}"] = np.abs(episodes.action).min(
            (1, 2, 3)
        )
    return {"weakest action": found}
