"""What a run needs to be given, and what does not fit together."""

from collections.abc import Sequence

from gymnasium.vector import VectorEnv

from offairl_lite.config import Config
from offairl_lite.core.policies import Policy, make_actor
from offairl_lite.core.rewards import Reward
from offairl_lite.demonstrations import Demonstrations


def require_inputs(
    config: Config,
    seeds: Sequence[int],
    demonstrations: Demonstrations | None,
    frozen_reward: Reward | None,
    pretrained_policy: Policy | None,
    guide: Policy | None,
) -> None:
    """Raise ValueError unless a run is given what its configuration asks for, and no more."""
    if not seeds:
        raise ValueError("no seeds: give one for each member of the population")
    if len(set(seeds)) < len(seeds):
        raise ValueError(f"seeds are {tuple(seeds)}: two members with one seed are the same")
    if config.learns_reward and demonstrations is None:
        raise ValueError(f"reward={config.reward!r} is learned from demonstrations: give some")
    if (config.reward == "frozen") != (frozen_reward is not None):
        raise ValueError(f"reward={config.reward!r} and a frozen reward go together")
    pretrained, start_steps = config.pretrained, config.schedule.start_steps
    if (pretrained != "nothing") != (pretrained_policy is not None):
        raise ValueError(f"pretrained={pretrained!r} and a pretrained policy go together")
    if (start_steps > 0) != (guide is not None):
        raise ValueError(f"start_steps={start_steps} and a guide go together")
    populations = ("frozen rewards", frozen_reward), ("policies", pretrained_policy)
    for what, given in (*populations, ("guides", guide)):
        if given is not None and len(given) != len(seeds):
            numbers = " ".join(map(str, range(len(given))))
            raise ValueError(
                f"{len(given)} {what} for {len(seeds)} seeds: give as many seeds, for instance "
                f"--seeds {numbers}"
            )
    if demonstrations is not None and demonstrations.env_id != config.env_id:
        raise ValueError(f"demonstrations of {demonstrations.env_id} for a run on {config.env_id}")


def require_fit(
    config: Config,
    env: VectorEnv,
    frozen_reward: Reward | None,
    pretrained_policy: Policy | None,
    guide: Policy | None,
) -> tuple[int, int]:
    """Return O and A as networks see them.

    Raises:
        ValueError: what a run is given of other runs does not fit its task or its configuration.
    """
    env_obs_dim = env.single_observation_space.shape[0]
    action_dim = env.single_action_space.shape[0]
    obs_dim = env_obs_dim + (config.schedule.absorbing != "none")
    reward_sees = config.discriminator.reward_sees if config.learns_reward else None
    if reward_sees is not None and max(reward_sees) >= obs_dim:
        raise ValueError(
            f"reward_sees is {reward_sees}; observations of {config.env_id} have "
            f"{obs_dim} numbers, so expected are indices from 0 to {obs_dim - 1}"
        )
    if frozen_reward is not None:
        _require_reward_fits(config, frozen_reward, env_obs_dim, action_dim)
    if pretrained_policy is not None:
        actor = make_actor(config.learner, obs_dim, action_dim)
        if pretrained_policy.actor != actor:
            raise ValueError(
                f"the pretrained policy is a {pretrained_policy.actor}, and the actor of this "
                f"run a {actor}: make the configurations the same"
            )
    if guide is not None and (guide.actor.obs_dim, guide.actor.action_dim) != (obs_dim, action_dim):
        raise ValueError(
            f"the guide, of {guide.env_id}, sees {guide.actor.obs_dim} numbers and gives "
            f"{guide.actor.action_dim}; this run has {obs_dim} and {action_dim}"
        )
    return obs_dim, action_dim


def _require_reward_fits(config: Config, reward: Reward, env_obs_dim: int, action_dim: int) -> None:
    """Raise ValueError if a frozen reward sees other numbers than a run has."""
    kind, env_id = config.schedule.absorbing, config.env_id
    obs_dim = env_obs_dim + (kind != "none")
    sees = reward.normaliser.mean.shape[-1]
    if sees != obs_dim:
        # The absorbing state's indicator is one number.
        other = f"it was learned on {reward.env_id}"
        cure = f"{other}; give the reward of a task like {env_id}"
        if kind == "none" and sees == obs_dim + 1:
            cure = f"{other}; if that had an absorbing state, set absorbing='bootstrap'"
        elif kind != "none" and sees == env_obs_dim:
            cure = f"{other}; if that had no absorbing state, set absorbing='none'"
        raise ValueError(
            f"the frozen reward sees {sees} numbers; with absorbing={kind!r}, {env_id} "
            f"gives {obs_dim}: {cure}"
        )
    if reward.state_only:
        return
    sees = reward.net.sizes[0] - obs_dim
    if sees != action_dim:
        raise ValueError(
            f"the frozen reward is an r(s, a) of {reward.env_id}, with {sees} actions, and "
            f"{env_id} has {action_dim}: give one of the state alone, for instance "
            "Implementation 4's"
        )


def episode_length(config: Config, demonstrations: Demonstrations | None) -> int:
    """Return how many steps the discriminator judges together: 1, or GAN-GCL's whole episodes.

    Raises:
        ValueError: GAN-GCL's episodes are not all of one length, or blocks do not hold whole ones.
    """
    if config.reward != "gan-gcl":
        return 1
    lengths, schedule = set(demonstrations.lengths), config.schedule
    multiples = schedule.warmup_steps, schedule.update_every, schedule.replay_size
    if len(lengths) > 1 or any(n % min(lengths) for n in multiples):
        raise ValueError(
            "gan-gcl compares whole episodes of one length: the demonstrations have "
            f"{min(lengths)} to {max(lengths)} steps, and warmup_steps, update_every and "
            f"replay_size, {multiples}, must be multiples of that"
        )
    return lengths.pop()
