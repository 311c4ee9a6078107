"""What training reports: evaluations, and the run that they make up."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import torch

from offairl_lite.config import Config
from offairl_lite.core.policies import Policy
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rollouts import Episodes


class Row(NamedTuple):
    """One evaluation of one member, after `step` environment steps and `episodes` of training.

    `returns` are undiscounted sums of the task's own reward; `learned_return` is the mean of those
    of the learned reward, NaN without one. `metrics` are diagnostics of the last update.
    """

    seed: int
    step: int
    episodes: int
    mean_return: float
    returns: tuple[float, ...]
    learned_return: float
    metrics: dict[str, float]


@dataclass
class Run:
    """The result of a run: its learning curve, and the policies and rewards at its end.

    `diverged` gives, by seed, the reason why a member was given up. Such a member has no rows from
    there on, and its weights are zeros. `name` is that of a recorded run's folder.
    """

    config: Config
    seeds: tuple[int, ...]
    rows: list[Row] = field(default_factory=list)
    policy: Policy | None = None
    reward: Reward | None = None
    diverged: dict[int, str] = field(default_factory=dict)
    name: str = ""

    @property
    def steps(self) -> np.ndarray:
        """Environment steps of the evaluations, `(K,)`."""
        return np.unique([row.step for row in self.rows])

    @property
    def returns(self) -> np.ndarray:
        """Mean return of each member at each evaluation, `(S, K)`; NaN where there was none."""
        means = {(row.seed, row.step): row.mean_return for row in self.rows}
        return np.array([[means.get((seed, k), np.nan) for k in self.steps] for seed in self.seeds])

    def to_frame(self) -> Any:
        """Return a pandas DataFrame, a row for each seed and evaluation, a column for each number.

        Raises:
            ImportError: pandas is not installed.
        """
        try:
            from pandas import DataFrame
        except ImportError as error:
            raise ImportError("pandas is not installed: pip install pandas") from error
        about = {"run": self.name, "task": self.config.env_id}
        lines = [{**about, **row._asdict(), **row.metrics} for row in self.rows]
        return DataFrame(lines).drop(columns=["returns", "metrics"], errors="ignore")


def learned_returns(episodes: Episodes, reward: Reward | None) -> np.ndarray:
    """Return the sum of the learned reward along each episode, `(S, E)`; NaN without one."""
    if reward is None:
        return np.full(episodes.returns.shape, np.nan)
    device = reward.params.device
    obs, action = (
        torch.as_tensor(x, dtype=torch.float32, device=device).flatten(1, 2)
        for x in (episodes.obs, episodes.action)
    )
    r = reward(obs, action).view(episodes.reward.shape).cpu().numpy()
    return (r * episodes.running).sum(-1)
