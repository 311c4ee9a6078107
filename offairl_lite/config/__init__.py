"""What a run is, in three groups: its schedule, its learner, and its discriminator.

Each part of the code receives its own group. `Config.flat` puts all settings side by side, for
tables, grids and the command line; `Config.of` and `Config.change` take such flat names.

`PAPER` is the text of the paper and `CORRECTED` the mathematics done right; what its released code
optimises is `ablations.released.RELEASE`. What the paper leaves unsaid is filled in from that code.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from typing import Any, Literal

from offairl_lite.config.groups import (
    DiscriminatorConfig,
    Frozen,
    LearnedReward,
    LearnerConfig,
    PPOConfig,
    RewardName,
    SACConfig,
    Schedule,
    TD3Config,
)
from offairl_lite.config.settings import Checked, checked, kinds, settings

__all__ = [
    "CORRECTED",
    "PAPER",
    "Config",
    "DiscriminatorConfig",
    "Frozen",
    "LearnedReward",
    "LearnerConfig",
    "PPOConfig",
    "RewardName",
    "SACConfig",
    "Schedule",
    "TD3Config",
    "differences",
    "flat_settings",
    "used_settings",
]


@dataclass(frozen=True)
class Config:
    """One run. The defaults are the preset `CORRECTED` at the paper's scale.

    Args:
        schedule: when things happen, and on what.
        learner: of the policy: `SACConfig`, `TD3Config` or `PPOConfig`.
        discriminator: of the reward; `Frozen` for a reward that was learned before (transfer), None
            for the task's own (plain reinforcement learning).
    """

    schedule: Schedule = field(default_factory=Schedule)
    learner: LearnerConfig = field(default_factory=SACConfig)
    discriminator: DiscriminatorConfig | Frozen | None = field(default_factory=DiscriminatorConfig)

    def __post_init__(self) -> None:
        schedule, reward = self.schedule, self.reward
        if schedule.warmup_steps > schedule.total_steps:
            raise ValueError(
                f"warmup_steps is {schedule.warmup_steps}, total_steps {schedule.total_steps}: "
                "nothing would be trained; lower warmup_steps"
            )
        on_policy = isinstance(self.learner, PPOConfig)
        first = (schedule.update_every or 0) + (schedule.warmup_steps if on_policy else 0)
        if first > schedule.total_steps:
            raise ValueError(
                f"update_every is {schedule.update_every}, total_steps {schedule.total_steps}: "
                "nothing would be trained; lower update_every"
            )
        if not schedule.start_steps < schedule.warmup_steps:
            raise ValueError(
                f"start_steps is {schedule.start_steps}; expected 0 or more, and fewer than the "
                f"{schedule.warmup_steps} warmup_steps, of which something must be left to learn "
                "from"
            )
        if schedule.absorbing != "none" and reward == "environment":
            raise ValueError(
                f"absorbing={schedule.absorbing!r} is for learned rewards; the task's own reward "
                "is known to end with the episode: set absorbing='none'"
            )
        if schedule.absorbing == "analytic" and self.learner.discount == 1:
            raise ValueError("absorbing='analytic' divides by 1 - discount: set discount below 1")
        if on_policy:
            self._check_on_policy()
        elif reward == "gan-gcl":
            raise ValueError(
                "reward 'gan-gcl' is for whole episodes of the present policy: use learner='ppo'"
            )
        if isinstance(self.discriminator, DiscriminatorConfig):
            self._check_discriminator(self.discriminator)

    def _check_discriminator(self, discriminator: DiscriminatorConfig) -> None:
        schedule, reward = self.schedule, self.reward
        log_prob_needed = reward.startswith("implementation") or reward == "gan-gcl"
        if isinstance(self.learner, TD3Config) and log_prob_needed:
            raise ValueError(
                f"reward {reward!r} needs log π, and td3's policy is deterministic: "
                "use learner='sac', or reward='dac'"
            )
        if schedule.start_steps and discriminator.loss == "mixture":
            raise ValueError(
                f"start_steps is {schedule.start_steps}, and loss='mixture' counts the steps of a "
                "guide, which replay does not hold: set start_steps=0 or loss='exact'"
            )
        if discriminator.reward_sees is not None and schedule.absorbing != "none":
            raise ValueError(
                f"reward_sees is {discriminator.reward_sees}, without the absorbing state: set "
                "absorbing='none'"
            )

    def _check_on_policy(self) -> None:
        schedule = self.schedule
        if schedule.update_every is None or schedule.update_every > schedule.replay_size:
            raise ValueError(
                f"update_every is {schedule.update_every}; ppo learns from the last so many steps: "
                f"set it, to replay_size ({schedule.replay_size}) at most"
            )
        if schedule.absorbing != "none":
            raise ValueError(
                f"absorbing={schedule.absorbing!r} is not for ppo: set absorbing='none'"
            )
        if schedule.start_steps:
            raise ValueError(
                f"start_steps is {schedule.start_steps}, and ppo learns from every step: set it to "
                "0"
            )

    @property
    def env_id(self) -> str:
        """Gymnasium id of the task."""
        return self.schedule.env_id

    @property
    def total_steps(self) -> int:
        """Environment steps of each member."""
        return self.schedule.total_steps

    @property
    def reward(self) -> RewardName:
        """What the learner maximises, by name."""
        if self.discriminator is None:
            return "environment"
        return "frozen" if self.discriminator == Frozen() else self.discriminator.reward

    @property
    def learns_reward(self) -> bool:
        """Whether a discriminator is trained."""
        return isinstance(self.discriminator, DiscriminatorConfig)

    @property
    def pretrained(self) -> str:
        """What the actor starts with of an earlier policy; `nothing` for TD3."""
        return getattr(self.learner, "pretrained", "nothing")

    def flat(self) -> dict[str, Any]:
        """Return all settings by their flat names."""
        flat = {"reward": self.reward, "learner": self.learner.kind}
        if self.learns_reward:
            flat["ablation"] = self.discriminator.kind or None
        for group in (self.schedule, self.learner, self.discriminator):
            if isinstance(group, Checked):
                names = settings(type(group))
                flat |= {group.renamed.get(name, name): getattr(group, name) for name in names}
        return flat

    @classmethod
    def of(cls, **flat: Any) -> "Config":
        """Return the configuration with these settings, and defaults for the others.

        Raises:
            ValueError: there is no such setting, or learner and reward have no use for it.
        """
        reward = checked("reward", flat.pop("reward", "implementation-4"), RewardName)
        learner = _kind("learner", flat.pop("learner", "sac"), LearnerConfig)
        ablation = flat.pop("ablation", None)
        discriminator = _kind("ablation", ablation, DiscriminatorConfig)
        learned = reward not in ("environment", "frozen")
        if ablation is not None and not learned:
            raise ValueError(
                f"ablation={ablation!r} is a discriminator's, and reward={reward!r} has none: "
                "leave it out"
            )
        made = []
        for group in (Schedule, learner, *([discriminator] if learned else [])):
            names = {group.renamed.get(name, name): name for name in settings(group)}
            given = {names[flat_name]: flat.pop(flat_name) for flat_name in names & flat.keys()}
            made.append(group(**(given | ({"reward": reward} if "reward" in names else {}))))
        if flat:
            raise ValueError(_not_used(flat, learner.kind, reward, ablation))
        if not learned:
            made.append(Frozen() if reward == "frozen" else None)
        return cls(*made)

    def change(self, **flat: Any) -> "Config":
        """Return the configuration with some settings changed.

        With another learner or reward, settings that it does not have are dropped.

        Raises:
            ValueError: see `of`.
        """
        kept = self.flat()
        reward, ablation = (flat.get(name, kept.get(name)) for name in ("reward", "ablation"))
        names = used_settings(flat.get("learner", self.learner.kind), reward, ablation)
        return Config.of(**({name: x for name, x in kept.items() if name in names} | flat))


def differences(one: Config, other: Config) -> dict[str, tuple[Any, Any]]:
    """Return the flat settings in which two configurations differ, with both values.

    None stands for a setting that one of them has no use for.
    """
    here, there = one.flat(), other.flat()
    pairs = {name: (here.get(name), there.get(name)) for name in here | there}
    return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}


def used_settings(learner: str, reward: str, ablation: str | None = None) -> set[str]:
    """Return the flat names of the settings for which a learner and a reward have a use.

    Raises:
        ValueError: there is no such learner or ablation.
    """
    groups, names = [Schedule, _kind("learner", learner, LearnerConfig)], {"reward", "learner"}
    if reward not in ("environment", "frozen"):
        groups.append(_kind("ablation", ablation, DiscriminatorConfig))
        names.add("ablation")
    for group in groups:
        names |= {group.renamed.get(name, name) for name in settings(group)}
    return names


def flat_settings() -> dict[str, tuple[Any, Any, str]]:
    """Return type, default and group of every setting of any group, by its flat name."""
    learners = Literal[tuple(filter(None, kinds(LearnerConfig)))]
    ablations = Literal[tuple(filter(None, kinds(DiscriminatorConfig)))]
    found = {
        "reward": (RewardName, "implementation-4", "discriminator"),
        "learner": (learners, "sac", "learner"),
        "ablation": (ablations | None, None, "discriminator"),
    }
    for base, group in ((Schedule, "schedule"), (LearnerConfig, "learner")):
        for kind in kinds(base).values():
            for one in fields(kind):
                found.setdefault(one.name, (settings(kind)[one.name], one.default, group))
    for kind in kinds(DiscriminatorConfig).values():
        for one in fields(kind):
            name = kind.renamed.get(one.name, one.name)
            found.setdefault(name, (settings(kind)[one.name], one.default, "discriminator"))
    return found


def _kind(name: str, kind: str | None, base: type[Checked]) -> type[Checked]:
    """Return the type of a group by its kind; None is the kind of what is no ablation."""
    there = {k or None: t for k, t in kinds(base).items() if k or base is DiscriminatorConfig}
    if not isinstance(kind, str | None) or kind not in there:
        raise ValueError(f"{name} is {kind!r}; expected one of {', '.join(map(repr, there))}")
    return there[kind]


def _not_used(flat: Iterable[str], learner: str, reward: str, ablation: str | None) -> str:
    known, name = flat_settings(), next(iter(flat))
    if name not in known:
        return f"no setting {name!r}; there are: {', '.join(known)}"
    chosen = f"learner={learner!r}, reward={reward!r}"
    chosen += f", ablation={ablation!r}" if ablation else ""
    return f"{name} has no use with {chosen}: leave it out"


CORRECTED = Config()
"""Expert label 1, logit f - log π with the exact squashed density, inputs normalised."""

PAPER = Config(Schedule(normalise=False))
"""The text of the paper. It differs from `CORRECTED` where the text is silent or wrong: inputs
are left as the task gives them."""
