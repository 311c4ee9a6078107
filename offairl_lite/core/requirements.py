"""Checks that a run's inputs match its configuration and its task."""

from collections.abc import Sequence
from typing import NamedTuple, get_args, get_type_hints

import torch

from offairl_lite.config import Config, DiscriminatorConfig
from offairl_lite.core.discriminator import make_discriminator
from offairl_lite.core.networks import Population
from offairl_lite.core.policies import Policy, make_actor
from offairl_lite.core.rewards import Reward
from offairl_lite.core.shapes import Layout
from offairl_lite.demonstrations import Demonstrations, require_demonstrations
from offairl_lite.envs import BatchedEnv, SerialEnv


class Inputs(NamedTuple):
    """What a run may have beside its configuration; see `loop.train`."""

    demonstrations: Demonstrations | None = None
    frozen_reward: Reward | None = None
    pretrained_policy: Policy | None = None
    pretrained_reward: Reward | None = None
    guide: Policy | None = None


def require_inputs(config: Config, seeds: Sequence[int], inputs: Inputs) -> None:
    """Raise ValueError unless a run is given what its configuration asks for, and no more."""
    if not isinstance(config, Config):
        raise ValueError(f"config is {config!r}; expected a Config")
    for (name, hint), value in zip(get_type_hints(Inputs).items(), inputs, strict=True):
        if not isinstance(value, hint):
            raise ValueError(f"{name} is {value!r}; expected a {get_args(hint)[0].__name__}")
    demonstrations, frozen_reward, pretrained_policy, pretrained_reward, guide = inputs
    if config.reward == "gan-gcl":
        raise ValueError(
            "GAN-GCL is a page now: it is read from records, and trained in "
            "book/notes/whole_trajectories; choose another reward"
        )
    if not seeds:
        raise ValueError("no seeds: give one for each member of the population")
    if len(set(seeds)) < len(seeds):
        raise ValueError(f"seeds are {tuple(seeds)}: two members with one seed are the same")
    if config.imitates and demonstrations is None:
        raise ValueError(f"reward={config.reward!r} is learned from demonstrations: give some")
    if demonstrations is not None and demonstrations.env_id != config.env_id:
        raise ValueError(f"demonstrations of {demonstrations.env_id} for a run on {config.env_id}")
    frozen, kept, guided = config.reward, config.pretrained, config.schedule.guide_steps
    pairs: list[tuple[str, bool, Population | None]] = [
        (f"reward={frozen!r} and a frozen reward", frozen == "frozen", frozen_reward),
        (f"pretrained={kept!r} and a pretrained policy", kept != "nothing", pretrained_policy),
        ("a pretrained reward", pretrained_reward is not None, pretrained_reward),
        (f"guide_steps={guided} and a guide", guided > 0, guide),
    ]
    for pair, is_needed, trained in pairs:
        if is_needed != (trained is not None):
            raise ValueError(f"{pair} go together")
        if trained is not None and len(trained) != len(seeds):
            raise ValueError(
                f"{pair} of {len(trained)} members for {len(seeds)} seeds: give as many seeds, for "
                f"instance seeds={tuple(range(len(trained)))}"
            )


def require_match(config: Config, env: BatchedEnv | SerialEnv, inputs: Inputs) -> tuple[int, int]:
    """Return O and A as networks see them; ValueError says what does not fit the task."""
    demonstrations, frozen_reward, policy, reward, guide = inputs
    (obs_dim,), (action_dim,) = env.single_observation_space.shape, env.single_action_space.shape
    discriminator = config.discriminator
    sees = discriminator.reward_sees if isinstance(discriminator, DiscriminatorConfig) else None
    if sees is not None and max(sees) >= obs_dim:
        raise ValueError(
            f"reward_sees is {sees}; observations of {config.env_id} have {obs_dim} numbers, so "
            f"expected are indices from 0 to {obs_dim - 1}"
        )
    obs_dim += config.schedule.absorbing != "none"
    dims = obs_dim, action_dim
    if frozen_reward is not None:
        obs_seen, action_seen = frozen_reward.sees
        if frozen_reward.sees != (obs_dim, action_dim * (not frozen_reward.state_only)):
            raise ValueError(
                f"the frozen reward, of {frozen_reward.env_id}, sees {obs_seen} numbers and "
                f"{action_seen or 'none'} of an action; with absorbing="
                f"{config.schedule.absorbing!r}, {config.env_id} gives {obs_dim} and {action_dim}: "
                "set absorbing as the reward's run did, or give the reward of a task like this one"
            )
    actor = make_actor(config.learner, *dims)
    if policy is not None and policy.actor != actor:
        knows = policy.actor.obs_dim + 1 == obs_dim
        raise ValueError(
            f"the pretrained policy is a {policy.actor}, and the actor of this run a {actor}: "
            "make the configurations the same"
            + ", and clone with absorbing_state=True, if it is a clone"
            * knows
        )
    if guide is not None and (guide.actor.obs_dim, guide.actor.action_dim) != dims:
        raise ValueError(
            f"the guide, of {guide.env_id}, sees {guide.actor.obs_dim} numbers and gives "
            f"{guide.actor.action_dim}; this run has {obs_dim} and {action_dim}"
        )
    if reward is not None:
        if not isinstance(discriminator, DiscriminatorConfig) or discriminator.kind:
            raise ValueError("a pretrained reward is for runs that learn one, without an ablation")
        own = make_discriminator(discriminator, Layout(1, *dims))
        expected = (obs_dim, action_dim * (not own.state_only)), own.reward_net
        if (reward.sees, reward.net) != expected:
            raise ValueError(
                f"the pretrained reward sees {reward.sees} numbers of an observation and an "
                f"action, by a {reward.net}; this run's sees {expected[0]}, by a {expected[1]}: "
                "give the settings of the run that it is from"
            )
        scales = [] if policy is None else zip(reward.normaliser, policy.normaliser, strict=True)
        if not all(torch.equal(one, other) for one, other in scales):
            raise ValueError(
                "the pretrained policy and the pretrained reward scale observations differently: "
                "give those of one run, or only one of them"
            )
    if demonstrations is not None:
        require_demonstrations(demonstrations, env)
    return dims
