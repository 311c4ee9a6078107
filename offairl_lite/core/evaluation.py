"""Evaluation: whole episodes with the policies' modes, in environments of their own."""

import numpy as np
import torch

from offairl_lite.core.collector import Collector
from offairl_lite.core.policies import Policy
from offairl_lite.core.results import Row
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rollouts import Episodes, rollout
from offairl_lite.core.shapes import Metrics


def evaluate(
    policy: Policy, reward: Reward | None, collector: Collector, metrics: Metrics, num_threads: int
) -> list[Row]:
    """Return a row for each member that is still training, and for no other.

    Each plays `eval_episodes` episodes with its mode, the same ones every time.
    """
    config, members = collector.config, collector.members
    seeds = [members.seeds[i] for i in members.left]
    what = config.env_id, seeds, config.schedule.eval_episodes
    played = rollout(policy.member(*members.left), *what, num_threads=num_threads)
    learned = learned_returns(played, reward and reward.member(*members.left))
    return [
        Row(
            members.seeds[i],
            collector.steps,
            int(collector.episodes[i]),
            float(returns.mean()),
            tuple(map(float, returns)),
            float(learned_return.mean()),
            {name: float(value[i]) for name, value in metrics.items()},
        )
        for i, returns, learned_return in zip(members.left, played.returns, learned, strict=True)
    ]


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
