"""Evaluation: whole episodes with the policies' modes, in environments of their own."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from offairl_lite.config import Config
from offairl_lite.core.collector import Members
from offairl_lite.core.policies import Policy
from offairl_lite.core.results import Row
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rollouts import Episodes, NotFiniteError, rollout


def evaluate(
    config: Config,
    policy: Policy,
    reward: Reward | None,
    members: Members,
    step: int,
    episodes: Sequence[int],
    metrics: dict[str, Tensor],
    num_threads: int = 1,
) -> list[Row]:
    """Run `eval_episodes` episodes with the mode of each member, the same ones every time.

    Args:
        config: of the run.
        policy: of all members.
        reward: the learned reward as it is now, or None.
        members: those whose task gives numbers that are not finite are given up.
        step: environment steps so far.
        episodes: training episodes of each member so far.
        metrics: diagnostics of the last updates.
        num_threads: for the physics and PyTorch.

    Returns:
        A row for each member that is still training.
    """
    while True:
        left = members.left
        try:
            played = rollout(
                policy.member(*left),
                config.env_id,
                [members.seeds[i] for i in left],
                config.schedule.eval_episodes,
                num_threads=num_threads,
            )
            break
        except NotFiniteError as error:
            lost = torch.zeros(len(members.seeds), dtype=torch.bool)
            lost[[left[i] for i in error.members]] = True
            members.give_up(lost, step, "observation or reward", f"mend {config.env_id}")
    learned = learned_returns(played, reward and reward.member(*left))
    return [
        Row(
            members.seeds[i],
            step,
            int(episodes[i]),
            float(returns.mean()),
            tuple(float(r) for r in returns),
            float(learned_return.mean()),
            {name: float(value[i]) for name, value in metrics.items()},
        )
        for i, returns, learned_return in zip(left, played.returns, learned, strict=True)
    ]


def learned_returns(episodes: Episodes, reward: Reward | None) -> np.ndarray:
    """Return the sum of the learned reward along each episode, `(S, E)`; NaN without one."""
    if reward is None:
        return np.full(episodes.returns.shape, np.nan)
    obs, action = (
        torch.as_tensor(x, dtype=torch.float32, device=reward.params.device).flatten(1, 2)
        for x in (episodes.obs, episodes.action)
    )
    r = reward(obs, action).view(episodes.reward.shape).cpu().numpy()
    return (r * episodes.running).sum(-1)
