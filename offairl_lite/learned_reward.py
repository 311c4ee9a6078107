r"""The learned reward in anybody's trainer: a Gymnasium wrapper that pays it instead of the task's.

It pays what retraining on a frozen reward maximises (`core.loop`). The reward sees the observation
in which an action was chosen, not the next one, and actions scaled to [-1, 1]. If it knows of an
absorbing state, a termination is paid the rest of the return at once,
$r + \gamma \, r(s_a) / (1 - \gamma)$; a truncation is not. What `reward_scale` and `centre_reward`
do is left to the trainer: `gymnasium.wrappers.TransformReward` multiplies the reward, or takes off
a constant. For a vector of tasks, give it to `gymnasium.make_vec` as one of the `wrappers`.
"""

from os import PathLike
from typing import Annotated

import gymnasium
import numpy as np
import torch
from gymnasium.utils import RecordConstructorArgs
from jaxtyping import Float32
from torch import Tensor

from offairl_lite.config.settings import checked
from offairl_lite.core.absorbing import absorbing_state
from offairl_lite.core.experience import analytic_return
from offairl_lite.core.rewards import Reward
from offairl_lite.envs import flatten, require_boxes
from offairl_lite.runs.inputs import load_one

BelowOne = Annotated[float, "in [0, 1)", lambda x: 0 <= x < 1]


class LearnedReward(gymnasium.Wrapper, RecordConstructorArgs):
    """A task that pays a learned reward; its own is in `info["task_reward"]`.

    Args:
        env: a task with as many observations as the one where the reward was learned.
        reward: a learned reward, its file, or the folder of a run.
        member: which of the reward's members pays; may be None if there is only one.
        discount: that of the trainer; a reward without an absorbing state has no use for it.

    Raises:
        ValueError: the reward does not fit the task, or no member is chosen.
    """

    def __init__(
        self,
        env: gymnasium.Env,
        reward: Reward | str | PathLike,
        member: int | None = None,
        discount: float = 0.99,
    ) -> None:
        RecordConstructorArgs.__init__(self, reward=reward, member=member, discount=discount)
        super().__init__(env)
        env_id = env.spec.id if env.spec else str(env)
        seen, self._units = require_boxes(env_id, env.observation_space, env.action_space)
        reward = reward if isinstance(reward, Reward) else load_one(reward, Reward)
        if member is None and len(reward) > 1:
            many = f"the reward of {reward.env_id} has {len(reward)} members, and one of them pays"
            raise ValueError(f"{many}: choose it, member=0 to {len(reward) - 1}")
        self._reward = reward.member(0 if member is None else member).to("cpu")
        (obs_dim,), (action_dim,) = seen.shape, self._units.shape
        sees, takes = reward.sees
        if sees not in (obs_dim, obs_dim + 1) or takes not in (0, action_dim):
            raise ValueError(
                f"the reward of {reward.env_id} sees {sees} numbers of an observation (one more "
                f"where it knows of an absorbing state) and {takes or 'none'} of an action; "
                f"{env_id} has {obs_dim} and {action_dim}: wrap a task like {reward.env_id}"
            )
        discount, self._rest = checked("discount", discount, BelowOne), 0.0
        if sees > obs_dim:
            absent, still = absorbing_state(torch.zeros(1, 1, sees)), torch.zeros(1, 1, action_dim)
            r_absorbing = self._reward(absent, still).double()
            self._rest = analytic_return(torch.zeros(()), r_absorbing, discount).item()

    def reset(
        self, *, seed: int | None = None, options: dict | None = None
    ) -> tuple[np.ndarray, dict]:
        """Start a new episode."""
        obs, info = self.env.reset(seed=seed, options=options)
        self._seen = _copy(flatten(self.env.observation_space, obs))
        return obs, info

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Act once."""
        obs, task_reward, terminated, truncated, info = self.env.step(action)
        low, high = self._units.low, self._units.high
        scaled = 2 * (np.asarray(action) - low) / (high - low) - 1
        paid = self._reward(self._seen, _copy(scaled)).item() + self._rest * terminated
        self._seen = _copy(flatten(self.env.observation_space, obs))
        return obs, float(paid), terminated, truncated, {**info, "task_reward": task_reward}


def _copy(numbers: np.ndarray) -> Float32[Tensor, "1 1 N"]:
    """Return what a reward sees: a copy, since a task may overwrite its own."""
    return torch.tensor(numbers, dtype=torch.float32).view(1, 1, -1)
