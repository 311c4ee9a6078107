r"""The learned reward in anybody's trainer: Gymnasium wrappers that pay it instead of the task's.

They pay what retraining on a frozen reward maximises (`core.loop`). The reward sees the observation
in which an action was chosen, not the next one, and actions scaled to [-1, 1]. If it knows of an
absorbing state, a termination is paid the rest of the return at once,
$r + \gamma \, r(s_a) / (1 - \gamma)$; a truncation is not. What `reward_scale` and `centre_reward`
do is left to the trainer: `gymnasium.wrappers.TransformReward` multiplies the reward, or takes off
a constant.
"""

from os import PathLike
from typing import Annotated, Any

import gymnasium
import numpy as np
import torch
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from jaxtyping import Bool, Float, Float32
from torch import Tensor

from offairl_lite.config.settings import checked
from offairl_lite.core.absorbing import absorbing_state, analytic_return
from offairl_lite.core.rewards import Reward
from offairl_lite.envs import require_boxes
from offairl_lite.runs.inputs import load_one

BelowOne = Annotated[float, "in [0, 1)", lambda x: 0 <= x < 1]


class _Payer:
    """What one member of a reward pays on a `task`: an environment, and the spaces of one."""

    def __init__(
        self, task: Any, reward: Reward | str | PathLike, member: int | None, discount: float
    ) -> None:
        env_id = task[0].spec.id if task[0].spec else str(task[0])
        seen, self.units = require_boxes(env_id, *task[1:])
        reward = reward if isinstance(reward, Reward) else load_one(reward, Reward)
        if member is None and len(reward) > 1:
            many = f"the reward of {reward.env_id} has {len(reward)} members, and one of them pays"
            raise ValueError(f"{many}: choose it, member=0 to {len(reward) - 1}")
        self.reward = reward.member(0 if member is None else member).to("cpu")
        (obs_dim,), (action_dim,) = seen.shape, self.units.shape
        sees = reward.normaliser.mean.shape[-1]
        takes = action_dim if reward.state_only else reward.net.sizes[0] - sees
        if sees not in (obs_dim, obs_dim + 1) or takes != action_dim:
            raise ValueError(
                f"the reward of {reward.env_id} sees {sees} numbers of an observation (one more "
                f"where it knows of an absorbing state) and {takes} of an action; {env_id} has "
                f"{obs_dim} and {action_dim}: wrap a task like {reward.env_id}"
            )
        discount, self.rest = checked("discount", discount, BelowOne), 0.0
        if sees > obs_dim:
            there, still = absorbing_state(torch.zeros(1, 1, sees)), torch.zeros(1, 1, action_dim)
            r_absorbing = self.reward(there, still).double()
            self.rest = analytic_return(torch.zeros(()), r_absorbing, discount).item()

    def __call__(
        self,
        obs: Float32[Tensor, "N O"],
        action: Float[np.ndarray, "N A"],
        terminated: Bool[np.ndarray, "N"],
    ) -> Float[np.ndarray, "N"]:
        """Return r of each step, and the absorbing state's return where it terminates."""
        low, high = self.units.low, self.units.high
        scaled = torch.as_tensor(2 * (action - low) / (high - low) - 1, dtype=torch.float32)
        r = self.reward(obs.unsqueeze(0), scaled.unsqueeze(0))[0]
        return r.double().numpy() + self.rest * terminated


class LearnedReward(gymnasium.Wrapper, RecordConstructorArgs):
    """A task that pays a learned reward; its own is in `info["task_reward"]`.

    It is a ValueError if the reward does not fit the task, or no member is chosen.

    Args:
        env: a task with as many observations as the one where the reward was learned.
        reward: a learned reward, its file, or the folder of a run.
        member: which of the reward's members pays; may be None if there is only one.
        discount: that of the trainer; a reward without an absorbing state has no use for it.
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
        task = env, env.observation_space, env.action_space
        self._pay = _Payer(task, reward, member, discount)

    def reset(
        self, *, seed: int | None = None, options: dict | None = None
    ) -> tuple[np.ndarray, dict]:
        """Start a new episode."""
        obs, info = self.env.reset(seed=seed, options=options)
        self._seen = _copy(obs)
        return obs, info

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Act once."""
        obs, own, terminated, truncated, info = self.env.step(action)
        (paid,) = self._pay(self._seen, np.asarray(action)[None], np.array([terminated]))
        self._seen = _copy(obs)
        return obs, float(paid), terminated, truncated, {**info, "task_reward": own}


class LearnedRewardVector(VectorWrapper):
    """A vector environment that pays a learned reward, the same to all; else as `LearnedReward`.

    A step that only resets an environment (Gymnasium's `NEXT_STEP`) is paid 0.
    """

    def __init__(
        self,
        env: VectorEnv,
        reward: Reward | str | PathLike,
        member: int | None = None,
        discount: float = 0.99,
    ) -> None:
        super().__init__(env)
        task = env, env.single_observation_space, env.single_action_space
        self._pay = _Payer(task, reward, member, discount)
        self._resets = np.zeros(self.num_envs, bool)

    def reset(self, *, seed: Any = None, options: dict | None = None) -> tuple[np.ndarray, dict]:
        """Start new episodes; `seed` is one, or one for each environment."""
        obs, info = self.env.reset(seed=seed, options=options)
        self._seen, self._resets = _copy(obs), np.zeros_like(self._resets)
        return obs, info

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict]:
        """Act once in each environment."""
        obs, own, terminated, truncated, info = self.env.step(actions)
        paid = np.where(self._resets, 0.0, self._pay(self._seen, actions, terminated))
        next_step = self.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
        self._seen, self._resets = _copy(obs), next_step & (terminated | truncated)
        own_too = {"task_reward": own, "_task_reward": np.ones_like(terminated)}
        return obs, paid, terminated, truncated, {**info, **own_too}


def _copy(obs: np.ndarray) -> Float32[Tensor, "N O"]:
    """Return observations as a reward sees them: a copy, since a task may overwrite its own."""
    return torch.tensor(np.atleast_2d(obs), dtype=torch.float32)
