"""The three groups of settings: schedule, learner, discriminator."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal

from offairl_lite.config.settings import (
    AtLeastOne,
    Checked,
    Count,
    Fraction,
    Indices,
    Interval,
    Natural,
    NonNegative,
    Positive,
    Sizes,
)

Implementation = Literal["logit-sa", "logit-s", "r-sa", "r-s"]
"""The paper's Implementations 1 to 4."""
LearnedReward = Literal[Implementation, "dac", "gail-survival", "gail-termination", "gan-gcl"]
LabelReward = Literal["sqil", "iq-learn"]
RewardName = Literal[LearnedReward, LabelReward, "environment", "frozen"]


@dataclass(frozen=True)
class Schedule(Checked):
    """When things happen, and on what."""

    env_id: str = "offairl/PointMazeLeft-v0"
    """Gymnasium id of the task; observations and actions must be boxes."""
    total_steps: Count = 1_000_000
    """Environment steps of each member."""
    learning_starts: Count = 10_000
    """Initial steps, with uniform random actions, before networks are trained. Then their updates
    are made up for, except by PPO, which learns from its own actions alone."""
    random_hold: AtLeastOne = 1.0
    """Mean number of steps for which an initial random action is held; 1 draws one every step."""
    guide_steps: Natural = 0
    """The most steps for which a guide, another policy, acts at the start of an episode (random
    state initialisation). How many is drawn each time. They count, and are not learned from."""
    train_every: Count | None = None
    """Environment steps between training blocks, each of as many updates of the discriminator and
    then of the learner. None: the end of the episode, as in Algorithm 1. PPO learns from the
    block itself."""
    batch_size: Count = 100
    """Transitions from the demonstrations, and as many from replay, in one update."""
    replay_size: Count = 1_000_000
    """Transitions kept for each member; the oldest are overwritten. With PPO it says how far back
    the discriminator's negatives go: `train_every` is on-policy to the letter."""
    absorbing: Literal["none", "bootstrap", "analytic"] = "none"
    """What follows a termination: nothing; an absorbing state that loops (DAC); or the loop's
    return in closed form (the paper's R_T)."""
    normalise: bool = True
    """Whether networks see observations scaled to mean 0 and standard deviation 1: fixed statistics
    of the warm-up and, half and half, the demonstrations if there are any."""
    eval_every: Count = 5_000
    """Environment steps between evaluations."""
    eval_episodes: Count = 10
    """Episodes, with the policy's mode, of one evaluation. They run side by side: of a task of
    one's own, `eval_episodes` environments are open for each seed, and one more for training."""


@dataclass(frozen=True)
class LearnerConfig(Checked):
    """What all learners have in common."""

    on_policy: ClassVar[bool] = False

    hidden: Sizes = (400, 300)
    """Hidden layers of actor and critics, ReLU."""
    discount: Fraction = 0.99
    """γ of the learner."""
    learning_rate: Positive = 1e-3
    """Adam's, for actor, critics and temperature."""
    reward_scale: Positive = 1.0
    """Factor on the learner's reward; the returns reported are without it."""


@dataclass(frozen=True)
class OffPolicyConfig(LearnerConfig):
    """What SAC and TD3 have in common."""

    target_rate: Fraction = 0.005
    """τ: the share of the critics that enters their targets after each update of the actor."""
    centre_reward: bool = False
    """Whether the learner's reward is paid without its mean over the replayed transitions of each
    chunk of updates. A learned reward has an arbitrary constant, which critics must first learn,
    and again whenever it drifts. Where episodes can end the constant matters: set `absorbing`."""


@dataclass(frozen=True)
class TD3Config(OffPolicyConfig):
    """TD3: deterministic, so it has no log π and cannot serve AIRL."""

    kind = "td3"


@dataclass(frozen=True)
class SACConfig(OffPolicyConfig):
    """SAC, and SAC-MCP where there are `primitives`."""

    kind = "sac"

    temperature: Positive | None = 0.2
    """α. None: learned from 0.2 on, for a policy entropy of `target_entropy`. AIRL's logit
    f - log π is derived for 1."""
    target_entropy: float | None = None
    """Entropy, in nats, that a learned temperature holds. None: minus the dimension of actions."""
    log_std_range: Interval = (-5.0, 2.0)
    """Bounds of the actor's log σ, approached smoothly."""
    pretrained: Literal["nothing", "policy", "primitives"] = "nothing"
    """What the actor starts with of an earlier policy: nothing; all of it, with the scaling of its
    inputs; or all but the gate, which begins anew."""
    primitives: Count | None = None
    """SAC-MCP's number of primitives. None: the actor is one squashed Gaussian."""
    trunk_hidden: Sizes = (512, 256)
    """Layers that the primitives have in common, ReLU."""
    primitive_hidden: Sizes = (256,)
    """Hidden layers of each primitive after the trunk, ReLU."""
    gate_hidden: Sizes = (512, 256, 256)
    """Hidden layers of the gate, ReLU."""
    gating: Literal["softmax", "sigmoid", "softplus"] = "softmax"
    """How the gate's outputs become weights: adding up to 1, each in (0, 1), or each positive."""
    fixed_primitives: bool = False
    """Whether only the gate of the actor learns."""

    def conflicts(self) -> Iterator[str]:
        """Yield what does not fit together, and what to do about it."""
        if self.primitives is None and (self.fixed_primitives or self.pretrained == "primitives"):
            yield (
                f"fixed_primitives={self.fixed_primitives}, pretrained={self.pretrained!r}, and "
                "there are none: set primitives"
            )


@dataclass(frozen=True)
class PPOConfig(LearnerConfig):
    """PPO, the on-policy learner; its actor is SAC's."""

    kind = "ppo"
    on_policy = True

    temperature: Positive = 0.2
    """Weight of the entropy in the loss."""
    log_std_range: Interval = (-5.0, 2.0)
    """Bounds of the actor's log σ, approached smoothly."""
    pretrained: Literal["nothing", "policy"] = "nothing"
    """Whether the actor starts with an earlier policy, and the scaling of its inputs."""


@dataclass(frozen=True)
class DiscriminatorConfig(Checked):
    """What the reward is learned by."""

    renamed: ClassVar[dict[str, str]] = {
        name: f"discriminator_{name}" for name in ("discount", "activation", "updates")
    }
    selects: ClassVar[bool] = True  #: Whether `reward_sees` is of use.

    reward: LearnedReward = "r-s"
    """What the learner maximises. AIRL's: the reward r(s), r(s, a), or the discriminator's logit
    with either of them (the paper's Implementations 4, 3, 2 and 1). Or DAC's, or GAIL's of
    either sign. Records have GAN-GCL's, which is trained no more."""
    loss: Literal["airl", "airl-mixture", "log-ratio"] = "airl"
    """The logit of AIRL's discriminator. `airl`: f - log π, with π as it is now. `airl-mixture`:
    the same, with π mixed with the initial random actions, as replay has them, so that log π has
    no tail. `log-ratio`: f alone, whose optimum is a log density ratio, as in the released code."""
    log_prob_in_reward: bool = True
    """Whether logit-sa and logit-s pay f - log π. False: they pay f, and -log π is left to the
    learner's own entropy term, whose `temperature` is then to be larger by 1."""
    updates: Count | None = None
    """Updates of the discriminator at a training block. None: as many as the block has steps."""
    discount: Fraction = 0.99
    """γ in f(s, a, s') = r + γ V(s') - V(s): the learner's `discount`, unless it is set apart."""
    reward_hidden: Sizes = (100, 100)
    """Hidden layers of r."""
    shaping_hidden: Sizes = (100, 100)
    """Hidden layers of V."""
    activation: Literal["tanh", "relu"] = "tanh"
    """Activation in r and V."""
    reward_sees: Indices | None = None
    """Which dimensions of an observation r sees, by their indices; actions, where it sees actions,
    it sees whole, and the absorbing state it knows. None: all of them. V sees all in any case."""
    gradient_penalty: NonNegative = 10.0
    """Weight of the penalty (‖∇f‖ - 1)², at one random point between an expert's and a policy's
    transition, by all that f sees."""

    def conflicts(self) -> Iterator[str]:
        """Yield what does not fit together, and what to do about it."""
        if self.reward_sees is not None and not self.selects:
            yield (
                f"reward_sees is {self.reward_sees}, and ablation={self.kind!r} sees all of an "
                "observation: set it to None"
            )
        if not (self.log_prob_in_reward or self.reward.startswith("logit")):
            yield (
                f"log_prob_in_reward=False, and reward {self.reward!r} has no log π to leave out: "
                "it is for logit-sa and logit-s"
            )


@dataclass(frozen=True)
class Frozen:
    """Instead of a discriminator: a reward that was learned before."""


@dataclass(frozen=True)
class Labels(Checked):
    """Instead of a discriminator: minibatches of half demonstrations, half replay; no reward."""

    reward: LabelReward
    """What SAC does with the halves. SQIL pays the demonstrations 1 and replay 0; IQ-Learn's critic
    has a loss of its own."""
