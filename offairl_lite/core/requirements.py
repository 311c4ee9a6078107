"""What a run is given, what it needs to be given, and what does not fit together."""

from collections.abc import Sequence
from typing import NamedTuple

import torch

from offairl_lite.config import Config, DiscriminatorConfig
from offairl_lite.core.policies import Policy, make_actor
from offairl_lite.core.rewards import Reward
from offairl_lite.demonstrations import Demonstrations
from offairl_lite.envs import BatchedEnv, SerialEnv


class Inherited(NamedTuple):
    """What a run is given of other runs, each with as many members as the run has seeds."""

    frozen_reward: Reward | None = None
    pretrained_policy: Policy | None = None
    guide: Policy | None = None

    def to(self, device: torch.device) -> "Inherited":
        """Return the same on a device."""
        return Inherited._make(given and given.to(device) for given in self)


def require_inputs(
    config: Config,
    seeds: Sequence[int],
    demonstrations: Demonstrations | None,
    inherited: Inherited,
) -> None:
    """Raise ValueError unless a run is given what its configuration asks for, and no more."""
    kinds = {"config": Config, "demonstrations": Demonstrations, "frozen_reward": Reward}
    kinds |= {"pretrained_policy": Policy, "guide": Policy}
    all_given = config, demonstrations, *inherited
    for (name, kind), given in zip(kinds.items(), all_given, strict=True):
        if not isinstance(given, kind) and (given is not None or name == "config"):
            raise ValueError(f"{name} is {given!r}; expected a {kind.__name__}")
    if not seeds:
        raise ValueError("no seeds: give one for each member of the population")
    if len(set(seeds)) < len(seeds):
        raise ValueError(f"seeds are {tuple(seeds)}: two members with one seed are the same")
    if config.imitates and demonstrations is None:
        raise ValueError(f"reward={config.reward!r} is learned from demonstrations: give some")
    if demonstrations is not None and demonstrations.env_id != config.env_id:
        raise ValueError(f"demonstrations of {demonstrations.env_id} for a run on {config.env_id}")
    pretrained, start_steps = config.pretrained, config.schedule.start_steps
    asked = {
        f"reward={config.reward!r} and a frozen reward": config.reward == "frozen",
        f"pretrained={pretrained!r} and a pretrained policy": pretrained != "nothing",
        f"start_steps={start_steps} and a guide": start_steps > 0,
    }
    for (what, is_needed), given in zip(asked.items(), inherited, strict=True):
        if is_needed != (given is not None):
            raise ValueError(f"{what} go together")
        if given is not None and len(given) != len(seeds):
            numbers = " ".join(map(str, range(len(given))))
            raise ValueError(
                f"{what} of {len(given)} members for {len(seeds)} seeds: give as many seeds, for "
                f"instance --seeds {numbers}"
            )


def require_fit(
    config: Config, env: BatchedEnv | SerialEnv, inherited: Inherited
) -> tuple[int, int]:
    """Return O and A as networks see them; ValueError if what a run is given does not fit them."""
    (obs_dim,), (action_dim,) = env.single_observation_space.shape, env.single_action_space.shape
    obs_dim += config.schedule.absorbing != "none"
    discriminator, (reward, policy, guide) = config.discriminator, inherited
    sees = discriminator.reward_sees if isinstance(discriminator, DiscriminatorConfig) else None
    if sees is not None and max(sees) >= obs_dim:
        raise ValueError(
            f"reward_sees is {sees}; observations of {config.env_id} have {obs_dim} numbers, so "
            f"expected are indices from 0 to {obs_dim - 1}"
        )
    if reward is not None:
        _require_reward_fits(config, reward, obs_dim, action_dim)
    actor = make_actor(config.learner, obs_dim, action_dim)
    if policy is not None and policy.actor != actor:
        raise ValueError(
            f"the pretrained policy is a {policy.actor}, and the actor of this run a {actor}: "
            "make the configurations the same"
        )
    if guide is not None and (guide.actor.obs_dim, guide.actor.action_dim) != (obs_dim, action_dim):
        raise ValueError(
            f"the guide, of {guide.env_id}, sees {guide.actor.obs_dim} numbers and gives "
            f"{guide.actor.action_dim}; this run has {obs_dim} and {action_dim}"
        )
    return obs_dim, action_dim


def _require_reward_fits(config: Config, reward: Reward, obs_dim: int, action_dim: int) -> None:
    """Raise ValueError if a frozen reward sees other numbers than a run has."""
    sees = reward.normaliser.mean.shape[-1]
    takes = reward.net.sizes[0] - sees
    if sees != obs_dim or takes != action_dim * (not reward.state_only):
        raise ValueError(
            f"the frozen reward, of {reward.env_id}, sees {sees} numbers and {takes or 'none'} of "
            f"an action; with absorbing={config.schedule.absorbing!r}, {config.env_id} gives "
            f"{obs_dim} and {action_dim}: set absorbing as the reward's run did, or give the "
            "reward of a task like this one"
        )


def episode_length(config: Config, demonstrations: Demonstrations | None) -> int:
    """Return how many steps the discriminator judges together: 1, or GAN-GCL's whole episodes."""
    if config.reward != "gan-gcl" or demonstrations is None:
        return 1
    lengths, schedule = set(demonstrations.lengths), config.schedule
    multiples = schedule.warmup_steps, schedule.update_every or 0, schedule.replay_size
    if len(lengths) > 1 or any(n % min(lengths) for n in multiples):
        raise ValueError(
            "gan-gcl compares whole episodes of one length: the demonstrations have "
            f"{min(lengths)} to {max(lengths)} steps, and warmup_steps, update_every and "
            f"replay_size, {multiples}, must be multiples of that"
        )
    return lengths.pop()
