"""What a run is, in three groups: its schedule, its learner, and its discriminator.

`Config.flat` puts all settings side by side, for tables, grids and the command line; `Config.of`
and `Config.change` take such flat names. `PAPER` is the text of the paper, `CORRECTED` is
the same without its slips; what its released code optimises is `ablations.released.RELEASE`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any, Literal, get_args

from offairl_lite.config.groups import (
    DiscriminatorConfig,
    Frozen,
    Implementation,
    LabelReward,
    Labels,
    LearnedReward,
    LearnerConfig,
    PPOConfig,
    RewardName,
    SACConfig,
    Schedule,
    TD3Config,
)
from offairl_lite.config.settings import Checked, checked, current, kinds

GROUPS = {"schedule": Schedule, "learner": LearnerConfig, "discriminator": DiscriminatorConfig}
"""Of each group of settings the type that all its types extend."""


@dataclass(frozen=True)
class Config:
    """One run. The defaults are the preset `CORRECTED` at the paper's scale."""

    schedule: Schedule = field(default_factory=Schedule)  #: When things happen, and on what.
    learner: SACConfig | TD3Config | PPOConfig = field(default_factory=SACConfig)
    discriminator: DiscriminatorConfig | Labels | Frozen | None = field(
        default_factory=DiscriminatorConfig
    )
    """`Frozen` for a reward that was learned before (transfer), `Labels` for SQIL and IQ-Learn,
    which learn none, None for the task's own (plain reinforcement learning)."""

    def __post_init__(self) -> None:
        for message in self._conflicts():
            raise ValueError(message)

    def _conflicts(self) -> Iterator[str]:
        """Yield what does not fit together, and what to do about it."""
        schedule, reward, ppo = self.schedule, self.reward, isinstance(self.learner, PPOConfig)
        total, warmup, start = schedule.total_steps, schedule.learning_starts, schedule.guide_steps
        every, size, absorbing = schedule.train_every, schedule.replay_size, schedule.absorbing
        if warmup > total:
            yield f"learning_starts is {warmup}, total_steps {total}: lower learning_starts"
        if (every or 0) + ppo * warmup > total:
            yield f"train_every is {every}, total_steps {total}: lower train_every"
        if start >= warmup:
            yield f"guide_steps is {start}; expected less than learning_starts, {warmup}"
        if ppo and not 1 <= (every or 0) <= size:
            why = "learner ppo learns from the last so many steps"
            yield f"train_every is {every}; {why}: set it, to replay_size ({size}) at most"
        if ppo and start:
            yield f"guide_steps is {start}, and ppo learns from every step: set it to 0"
        if ppo and absorbing != "none":
            yield f"absorbing={absorbing!r} is not for ppo: set absorbing='none'"
        if reward == "environment" and absorbing != "none":
            yield f"absorbing={absorbing!r} is for learned rewards: set absorbing='none'"
        if absorbing == "analytic" and self.learner.discount == 1:
            yield "absorbing='analytic' divides by 1 - discount: set discount below 1"
        if reward in get_args(Implementation) and isinstance(self.learner, TD3Config):
            yield f"reward {reward!r} needs log π, and td3's policy has none: use learner='sac'"
        yield from self._label_conflicts()
        if start and getattr(self.discriminator, "loss", "") == "airl-mixture":
            yield "loss='airl-mixture' counts the steps of a guide: set guide_steps=0"

    def _label_conflicts(self) -> Iterator[str]:
        """Yield what does not fit SQIL and IQ-Learn."""
        learner, absorbing = self.learner, self.schedule.absorbing
        if not isinstance(self.discriminator, Labels):
            return
        if not isinstance(learner, SACConfig):
            yield f"reward {self.reward!r} is for SAC's critics: use learner='sac'"
        elif self.reward == "iq-learn" and (learner.centre_reward or learner.reward_scale != 1):
            yield (
                f"reward_scale is {learner.reward_scale} and centre_reward "
                f"{learner.centre_reward}, and iq-learn pays no reward: set them to 1 and False"
            )
        if absorbing == "analytic":
            why = f"reward {self.reward!r} gives the absorbing state no reward of its own"
            yield f"absorbing={absorbing!r}, and {why}: set absorbing='bootstrap'"

    @property
    def env_id(self) -> str:
        """Gymnasium id of the task."""
        return self.schedule.env_id

    @property
    def total_steps(self) -> int:
        """Environment steps of each member."""
        return self.schedule.total_steps

    @property
    def reward(self) -> str:
        """What the learner maximises, as in `RewardName`."""
        if isinstance(self.discriminator, DiscriminatorConfig | Labels):
            return self.discriminator.reward
        return "environment" if self.discriminator is None else "frozen"

    @property
    def imitates(self) -> bool:
        """Whether demonstrations are learned from, with a reward or without."""
        return isinstance(self.discriminator, DiscriminatorConfig | Labels)

    @property
    def pretrained(self) -> str:
        """What the actor starts with of an earlier policy; `nothing` for TD3."""
        return getattr(self.learner, "pretrained", "nothing")

    def flat(self) -> dict[str, Any]:
        """Return all settings by their flat names."""
        flat: dict[str, Any] = {"reward": self.reward, "learner": self.learner.kind}
        if isinstance(self.discriminator, DiscriminatorConfig):
            flat["ablation"] = self.discriminator.kind or None
        for group in (self.schedule, self.learner, self.discriminator):
            if isinstance(group, Checked):
                own = group.settings.items()
                flat |= {flat_name: getattr(group, name) for flat_name, (name, _) in own}
        return flat

    @classmethod
    def of(cls, **flat: Any) -> "Config":
        """Return the configuration with these settings, and defaults for the others.

        Raises:
            ValueError: there is no such setting, or learner and reward have no use for it.
        """
        flat = current(flat)
        chosen = {name: default for name, (_, default, _) in _choices().items()} | flat
        used = used_settings(chosen)
        if "discount" in flat and "discriminator_discount" in used:
            # The shaping needs the learner's, or it is none.
            chosen.setdefault("discriminator_discount", flat["discount"])
        for name in [name for name in flat if name not in used]:
            if name not in (names := flat_settings()):
                near = " or ".join(get_close_matches(name, names))
                near = f"; did you mean {near}?" if near else ""
                raise ValueError(f"no setting {name!r}{near}; there are: {', '.join(names)}")
            choice = [f"{k}={chosen[k]!r}" for k in ("learner", "reward", "ablation") if chosen[k]]
            raise ValueError(f"{name} has no use with {', '.join(choice)}: leave it out")
        others = {"frozen": Frozen(), **{name: Labels(name) for name in get_args(LabelReward)}}
        groups: dict[str, Any] = {"discriminator": others.get(chosen["reward"])}
        for part, group in _types(chosen).items():
            own = group.settings.items()
            groups[part] = group(**{name: chosen[x] for x, (name, _) in own if x in chosen})
        return cls(**groups)

    def change(self, **flat: Any) -> "Config":
        """Return the configuration with some settings changed; errors are those of `of`.

        With another learner or reward, settings that it does not have are dropped.
        """
        now, flat = self.flat(), current(flat)
        if "discount" in flat and now.get("discriminator_discount") == now["discount"]:
            del now["discriminator_discount"]  # It goes with the learner's.
        kept = used_settings(now | flat)
        return Config.of(**{name: value for name, value in now.items() if name in kept} | flat)


def differences(one: Config, other: Config) -> dict[str, tuple[Any, Any]]:
    """Return the flat settings that differ, with both values; None where one has no use for it."""
    here, others = one.flat(), other.flat()
    pairs = {name: (here.get(name), others.get(name)) for name in here | others}
    return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}


def _choices() -> dict[str, tuple[Any, Any, str]]:
    """Return type, default and group of the settings that choose the types of the groups."""
    literal: Any = Literal
    learners = literal[tuple(filter(None, kinds(LearnerConfig)))]
    ablations = literal[tuple(filter(None, kinds(DiscriminatorConfig)))]
    return {
        "reward": (RewardName, "r-s", "discriminator"),
        "learner": (learners, "sac", "learner"),
        "ablation": (ablations | None, None, "discriminator"),
    }


def _types(flat: Mapping[str, Any]) -> dict[str, type[Checked]]:
    """Return the types of the groups that are chosen; without a reward to learn there are two."""
    chosen = {name: checked(name, flat.get(name), hint) for name, (hint, *_) in _choices().items()}
    types: dict[str, type[Checked]] = {
        "schedule": Schedule,
        "learner": kinds(LearnerConfig)[chosen["learner"]],
    }
    if chosen["reward"] in get_args(LearnedReward):
        types["discriminator"] = kinds(DiscriminatorConfig)[chosen["ablation"] or ""]
    return types


def used_settings(flat: Mapping[str, Any]) -> set[str]:
    """Return the flat names of the settings for which learner, reward and ablation have a use.

    ValueError: there is no such learner, reward or ablation.
    """
    types, names = _types(flat), {"reward", "learner"}
    if "discriminator" in types or flat.get("ablation") is None:
        names.add("ablation")
    return names.union(*(group.settings for group in types.values()))


def flat_settings() -> dict[str, tuple[Any, Any, str]]:
    """Return type, default and group of every setting of any group, by its flat name."""
    by_name = _choices()
    for group, base in GROUPS.items():
        for kind in kinds(base).values():
            for flat, (name, hint) in kind.settings.items():
                by_name.setdefault(flat, (hint, getattr(kind, name), group))
    return by_name


CORRECTED = Config()
"""Expert label 1, logit f - log π with the exact squashed density, inputs normalised."""
PAPER = Config(Schedule(normalise=False))
"""The text of the paper. It differs from `CORRECTED` where the text is silent or wrong: inputs
are left as the task gives them."""
