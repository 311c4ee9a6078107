"""Whole episodes of a fixed policy."""

from collections.abc import Sequence
from contextlib import ExitStack, closing
from typing import NamedTuple

import numpy as np
import torch
from gymnasium.spaces import Box
from jaxtyping import Bool, Float

from offairl_lite import envs
from offairl_lite.config.settings import Count, Natural, checked
from offairl_lite.core.policies import Policy
from offairl_lite.core.rng import Rng

LONGEST = 20_000  #: Steps by which an episode must end where the task has no time limit.
LARGEST = 1e8
"""A task's number beyond ±this is a fault: MuJoCo's robots read hundreds, hydraulics in Pa 5e7."""
FAULTY = f"not within ±{LARGEST:g}"  #: How messages say so.


def faulty(reading: np.ndarray) -> np.ndarray:
    """Return which numbers of a task, observations or rewards, are NaN or beyond ±`LARGEST`."""
    return ~(np.abs(reading) <= LARGEST)


def require_sound(env_id: str, when: str, seeds: Sequence[int], **readings: np.ndarray) -> None:
    """Raise ValueError, with the number and whose it is, if a task gives one that is `faulty`."""
    for name, reading in readings.items():
        for i, *place in np.argwhere(faulty(reading)).tolist():
            value = f"{name}{place or ''} is {reading[i, *place]:.6g}, {FAULTY}"
            whose = f"{env_id}, seed {seeds[i]}, is at fault in {when}"
            raise ValueError(f"{whose}: its {value}; mend it")


class Episodes(NamedTuple):
    """Episodes of each member, side by side; after its end an episode is padded with zeros."""

    obs: Float[np.ndarray, "S E T O"]
    action: Float[np.ndarray, "S E T A"]
    next_obs: Float[np.ndarray, "S E T O"]
    reward: Float[np.ndarray, "S E T"]
    terminated: Bool[np.ndarray, "S E"]
    running: Bool[np.ndarray, "S E T"]

    @property
    def returns(self) -> Float[np.ndarray, "S E"]:
        """Undiscounted sums of the task's reward."""
        return self.reward.sum(-1)

    @property
    def lengths(self) -> np.ndarray:
        """Steps of each episode, `(S, E)`."""
        return self.running.sum(-1)


def episode_seeds(
    seeds: Sequence[int], episodes: int, purpose: int = 0, first: int = 0
) -> list[int]:
    """Derive a seed for every episode of every member, `S * episodes`, in that order.

    `purpose` keeps the episodes of, say, an evaluation apart from those of a data set. `first` is
    the number of the first episode.
    """
    episodes = checked("episodes", episodes, Count)
    purpose, first = checked("purpose", purpose, Natural), checked("first", first, Natural)
    seeds = checked("seeds", [*seeds] if np.ndim(seeds) else seeds, tuple[Natural, ...])
    return [
        int(np.random.SeedSequence((seed, purpose, episode)).generate_state(1)[0])
        for seed in seeds
        for episode in range(first, first + episodes)
    ]


def require_actions(policy: Policy, space: Box) -> None:
    """Raise ValueError if a policy gives another number of actions than a task takes."""
    if space.shape != (policy.actor.action_dim,):
        gives = f"the policy of {policy.env_id} gives {policy.actor.action_dim} numbers"
        cure = "choose a task with as many actions"
        raise ValueError(f"{gives}, and actions have the shape {space.shape}: {cure}")


def require_fit(policy: Policy, env: envs.BatchedEnv | envs.SerialEnv) -> None:
    """Raise ValueError if a policy sees or gives other numbers than an environment has."""
    policy.act(policy.params.new_zeros(1, 1, *env.single_observation_space.shape))
    require_actions(policy, env.single_action_space)


def require_end(env_id: str, steps: int, limit: int) -> None:
    """Raise ValueError if an episode has gone on for as many steps as it may last."""
    if steps == limit:
        raise ValueError(
            f"an episode of {env_id} has not ended after {limit:,} steps: give the task a time "
            "limit, gymnasium.register(..., max_episode_steps=1000), or wrap it, "
            "gymnasium.wrappers.TimeLimit(env, 1000)"
        )


@torch.no_grad()
def action(
    policy: Policy,
    obs: Float[np.ndarray, "*B O"],
    space: Box,
    noise: Float[np.ndarray, "*B A"] | None = None,
) -> Float[np.ndarray, "*B A"]:
    """Return what a one-member policy does, in the units of the task.

    Args:
        policy: of one member.
        obs: an observation as the task itself gives it, or a batch.
        space: `env.action_space`, whose bounds a policy knows as -1 and 1.
        noise: standard normal, for a sample; None for the mode.

    Raises:
        ValueError: there are several members, `obs` does not fit, or an action would be NaN.
    """
    if len(policy) != 1:
        raise ValueError(f"{len(policy)} members for one action; choose one: policy.member(0)")
    require_actions(policy, space)
    array = np.asarray(obs)
    if array.ndim not in (1, 2) or array.dtype.kind not in "biuf":
        raise ValueError(f"obs is {obs!r}; expected numbers of shape ({policy.actor.obs_dim},)")
    x, *noises = (
        torch.tensor(part, dtype=torch.float32, device=policy.params.device)
        for part in (array, noise)
        if part is not None
    )
    inputs = (torch.atleast_2d(part).unsqueeze(0) for part in (x, *noises))
    unit = policy.act(*inputs)[0].cpu().numpy().reshape(*array.shape[:-1], -1)
    scaled = space.low + (unit + 1) / 2 * (space.high - space.low)
    if not (x.isfinite().all() and np.isfinite(scaled).all()):
        raise ValueError(f"obs is {obs}, and the action {scaled}; expected finite numbers")
    return np.clip(scaled.astype(space.dtype), space.low, space.high)  # which rounding may leave


def rollout(
    policy: Policy,
    env_id: str,
    seeds: Sequence[int],
    episodes: int,
    *,
    sample: bool = False,
    purpose: int = 0,
    first: int = 0,
    num_threads: int = 1,
    actions: Float[np.ndarray, "S E T A"] | None = None,
) -> Episodes:
    """Run whole episodes with each of the S members of a policy, all at the same time.

    The same arguments give the same episodes; other threads round otherwise.

    Args:
        policy: of S members.
        env_id: the task.
        seeds: one for each member.
        episodes: of each member.
        sample: whether actions are samples, or modes.
        purpose: see `episode_seeds`.
        first: the number of the first episode.
        num_threads: of the physics and PyTorch.
        actions: what is done instead.

    Raises:
        ValueError: arguments do not fit, an episode has no end, or a number is NaN or huge.
    """
    each = episode_seeds(seeds, episodes, purpose, first)
    if len(seeds) != len(policy):
        raise ValueError(f"{len(seeds)} seeds for a policy of {len(policy)} members")
    shape, device = (len(policy), episodes), policy.params.device
    env = envs.make(env_id, len(each), each, num_threads=num_threads)
    limit = envs.spec(env_id).max_episode_steps or LONGEST
    # A generator for each episode: its noise is the same however many episodes there are.
    rng, action_dim = Rng(each, device), policy.actor.action_dim
    steps: list[tuple[np.ndarray, ...]] = []
    running = np.ones(len(each), bool)
    with closing(env), ExitStack() as afterwards:
        afterwards.callback(torch.set_num_threads, torch.get_num_threads())
        torch.set_num_threads(num_threads)
        require_fit(policy, env)
        obs, _ = env.reset()
        while running.any():
            require_end(env_id, len(steps), limit)
            if actions is None:
                x = torch.as_tensor(obs, dtype=torch.float32, device=device)
                noise = rng.normal(action_dim).view(*shape, -1) if sample else None
                action = policy.act(x.view(*shape, -1), noise).view(-1, action_dim).cpu().numpy()
            else:
                action = actions[:, :, len(steps)].reshape(-1, action_dim)
            next_obs, reward, terminated, truncated, _ = env.step(action)
            readings = {"observation": next_obs[running], "reward": reward[running]}
            whose = np.repeat(seeds, episodes)[running].tolist()
            require_sound(env_id, f"step {len(steps)} of an episode", whose, **readings)
            steps.append((obs, action, next_obs, reward, running & terminated, running))
            done = terminated | truncated
            running, obs = running & ~done, next_obs
            if done.any():
                obs, _ = env.reset(options={"reset_mask": done})
    columns = [np.stack(column, 1) for column in zip(*steps, strict=True)]
    obs, action, next_obs, reward, terminated, alive = (
        column.reshape(*shape, *column.shape[1:]) for column in columns
    )
    mask, ended = alive[..., None], terminated.max(-1)
    return Episodes(obs * mask, action * mask, next_obs * mask, reward * alive, ended, alive)
