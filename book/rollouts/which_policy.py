"""Which of a run's policies to take, if the true reward is not known?

The run folders of some cells of the benchmark, with the policies of their
evaluations, are looked for in `runs/benchmark`:

    offairl run benchmark --only Hopper-dac --trajectories 4 --out ...

Of the policies in the second half of training, each rule chooses one for
each seed, by ten episodes; ten others say what it is worth.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from offairl_lite.core.rollouts import Episodes, rollout
from offairl_lite.runs import records

RUNS = Path("runs/benchmark")
EPISODES = 10


def learned_returns(run: records.Run, episodes: Episodes) -> np.ndarray:
    """Return the mean return of each member by the run's last reward."""
    shape = episodes.obs.shape
    obs, action = (
        torch.as_tensor(part, dtype=torch.float32).flatten(1, 2)
        for part in (episodes.obs, episodes.action)
    )
    with torch.no_grad():
        reward = run.reward(obs, action).view(shape[:3]).numpy()
    return (reward * episodes.running).sum(-1).mean(-1)


def choices(folder: Path) -> dict[str, Any]:
    """Return what each rule's choice returns, for each seed of a run."""
    run = records.read(folder)
    seeds, env_id = run.seeds, run.config.env_id
    half = run.config.total_steps // 2
    steps = sorted({r.step for r in run.rows if r.step > half})
    policies = [records.read(folder, step).policy for step in steps]
    mean = torch.stack([policy.params for policy in policies]).mean(0)
    policies.append(replace(policies[-1], params=mean))
    tried, judged = (
        [rollout(p, env_id, seeds, EPISODES, purpose=n) for p in policies]
        for n in (1, 2)
    )
    worth = np.stack([each.returns.mean(1) for each in judged])
    scores = {
        "the learned return": [learned_returns(run, e) for e in tried[:-1]],
        "the length": [e.lengths.mean(1) for e in tried[:-1]],
        "the true return": [e.returns.mean(1) for e in tried[:-1]],
    }
    result = {"the last": worth[-2], "the mean of the weights": worth[-1]}
    for name, score in scores.items():
        result[name] = worth[np.argmax(score, 0), range(len(seeds))]
    result["one at random"] = worth[:-1].mean(0)
    return {name: values.tolist() for name, values in result.items()}


def record() -> dict[str, Any]:
    """Return the choices in each of the cells that are there."""
    torch.set_num_threads(1)
    return {
        folder.name: choices(folder) for folder in sorted(RUNS.iterdir())
    }
