"""The way back of chapter 9: from the right maze to the left, from scratch.

The chapter trains for fewer steps. Here it is as long as the recorded runs
`maze-transfer-rewards-demo/back-…`, with which the chapter compares it.
"""

from pathlib import Path
from typing import Any

from offairl_lite import experiments
from offairl_lite.core.loop import train
from offairl_lite.runs import records

RECORDS = Path(__file__).parents[1] / "records"
BACK = "maze-transfer-rewards/back-scratch"


def record() -> dict[str, Any]:
    """Return the curves of five seeds, on the rewards of PointMazeRight."""
    there = records.read(RECORDS / "maze-imitation-right-demo")
    config = experiments.configure(BACK, "demo")
    run = train(config, there.seeds, frozen_reward=there.reward)
    return {"steps": run.steps, "returns": run.returns}
