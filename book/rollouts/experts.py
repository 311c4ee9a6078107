"""Returns of the shipped experts, and of those with small networks."""

from typing import Any

from offairl_lite import demonstrations
from offairl_lite.core.rollouts import rollout
from offairl_lite.runs import records
from rollouts import RECORDS

SMALL = {
    "Hopper": "sac-fixed",
    "Walker2d": "sac-fixed",
    "Ant": "sac-learned",
}


def record() -> dict[str, Any]:
    """Return each expert's mean return over ten episodes of two kinds."""
    found = {}
    for task, learner in SMALL.items():
        run = records.read(RECORDS / f"experts-small/{task}-{learner}")
        shipped = demonstrations.expert(run.config.env_id)
        found[task] = {
            label: {
                kind: rollout(
                    policy,
                    policy.env_id,
                    range(len(policy)),
                    10,
                    sample=kind == "with noise",
                ).returns.mean(1)
                for kind in ("mode", "with noise")
            }
            for label, policy in (
                ("64-64", run.policy),
                ("shipped", shipped),
            )
        }
    return found
