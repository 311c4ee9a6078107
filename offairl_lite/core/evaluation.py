"""Evaluation: whole episodes with the policies' modes, in environments of their own."""

import numpy as np
import torch

from offairl_lite.core.collector import Collector
from offairl_lite.core.policies import Policy
from offairl_lite.core.results import Row
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rollouts import FAULTY, Episodes, ReadingError, rollout
from offairl_lite.core.shapes import Metrics


def evaluate(
    policy: Policy, reward: Reward | None, collector: Collector, metrics: Metrics, num_threads: int
) -> list[Row]:
    """Return a row for each member that is still training, and for no other.

    Each plays `eval_episodes` episodes with its mode, the same ones every time. A member whose task
    gives faulty numbers is given up.
    """
    config, members, step = collector.config, collector.members, collector.steps
    env_id, episodes = config.env_id, config.schedule.eval_episodes
    while True:
        left = members.left
        seeds = [members.seeds[i] for i in left]
        try:
            played = rollout(policy.member(*left), env_id, seeds, episodes, num_threads=num_threads)
            break
        except ReadingError as error:
            lost = torch.zeros(len(members.seeds), dtype=torch.bool)
            lost[[left[i] for i in error.members]] = True
            members.give_up(lost, step, f"observation or reward is {FAULTY}", f"mend {env_id}")
    learned = learned_returns(played, reward and reward.member(*left))
    return [
        Row(
            members.seeds[i],
            step,
            int(collector.episodes[i]),
            float(returns.mean()),
            tuple(map(float, returns)),
            float(learned_return.mean()),
            {name: float(value[i]) for name, value in metrics.items()},
        )
        for i, returns, learned_return in zip(left, played.returns, learned, strict=True)
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
