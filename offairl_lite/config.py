"""Everything that a run depends on, in one frozen dataclass, and the three presets.

`PAPER` is the text of the paper, `RELEASE` what its released code optimises, `CORRECTED` the
mathematics done right. What the paper leaves unsaid is filled in from the released code.
"""

from dataclasses import dataclass, fields, replace
from typing import Any, Literal, Self, get_args, get_origin

RewardName = Literal[
    "implementation-1",
    "implementation-2",
    "implementation-3",
    "implementation-4",
    "dac",
    "gail-survival",
    "gail-termination",
    "gan-gcl",
    "environment",
    "frozen",
]


@dataclass(frozen=True)
class Config:
    """One run: the task, the reward, the learners and the schedule.

    The defaults are the preset `CORRECTED` at the paper's scale.
    """

    env_id: str = "offairl/PointMazeLeft-v0"
    """Gymnasium id of the task; observations and actions must be boxes."""

    reward: RewardName = "implementation-4"
    """What the generator maximises: a variant of the paper's reward, DAC's, GAIL's of either sign,
    GAN-GCL's, the task's own (plain reinforcement learning), or a reward learned before and now
    frozen (transfer)."""

    generator: Literal["sac", "td3", "ppo"] = "sac"
    """The learner: SAC and TD3 are off-policy, PPO is on-policy. TD3 is deterministic, so it has no
    log π and cannot serve AIRL."""

    total_steps: int = 1_000_000
    """Environment steps of each member."""

    warmup_steps: int = 10_000
    """Steps of uniform random actions. Their updates are made up for when they are over, but not by
    PPO, which learns from its own actions alone."""

    warmup_hold: float = 1.0
    """Mean number of steps for which a warm-up action is held; 1 draws a fresh one every step."""

    update_every: int | None = None
    """Environment steps between training blocks, each of as many updates of the discriminator and
    then of the generator. None: the end of the episode, as in Algorithm 1. PPO learns from the
    block itself."""

    discriminator_updates: int | None = None
    """Updates of the discriminator at a training block. None: as many as the block has steps."""

    epochs: int = 10
    """How often PPO goes through a block, in minibatches of `batch_size`."""

    batch_size: int = 100
    """Transitions from the demonstrations, and as many from replay, in one update. GAN-GCL takes
    as many whole episodes as that comes to."""

    replay_size: int = 1_000_000
    """Transitions kept for each member; the oldest are overwritten. With PPO it says how far back
    the discriminator's negatives go: `update_every` is on-policy to the letter."""

    discount: float = 0.99
    """γ of the generator."""

    hidden: tuple[int, ...] = (400, 300)
    """Hidden layers of actor and critics, ReLU."""

    learning_rate: float = 1e-3
    """Adam's, for actor, critics and temperature."""

    target_rate: float = 0.005
    """τ: the share of the critics that enters their targets after each update of the actor."""

    actor_delay: int = 2
    """Critic updates for one update of the actor and the targets."""

    temperature: float | None = 0.2
    """SAC's α, and the weight of the entropy in PPO's loss. None, for SAC: learned from 0.2 on, for
    a policy entropy of `target_entropy`. AIRL's logit f - log π is derived for 1. Where episodes
    can end, Implementations 3 and 4 need it: at another temperature the unit of actions decides
    whether a step of life is worth more than the end."""

    target_entropy: float | None = None
    """Entropy, in nats, that a learned temperature holds. None: minus the number of actions."""

    log_std_range: tuple[float, float] = (-5.0, 2.0)
    """Bounds of the actor's log σ, approached smoothly."""

    primitives: int | None = None
    """SAC-MCP's number of primitives. None: the actor is one squashed Gaussian."""

    trunk_hidden: tuple[int, ...] = (512, 256)
    """Layers that the primitives have in common, ReLU."""

    primitive_hidden: tuple[int, ...] = (256,)
    """Hidden layers of each primitive after the trunk, ReLU."""

    gate_hidden: tuple[int, ...] = (512, 256, 256)
    """Hidden layers of the gate, ReLU."""

    gating: Literal["softmax", "sigmoid", "softplus"] = "softmax"
    """How the gate's outputs become weights: adding up to 1, each in (0, 1), or each positive."""

    composition: Literal["exact", "released"] = "exact"
    """The product of Gaussians; `released`: with standard deviations in the place of variances."""

    fixed_primitives: bool = False
    """Whether only the gate of the actor learns."""

    carry: Literal["nothing", "policy", "primitives"] = "nothing"
    """What the actor has of an earlier policy at the start: nothing; all of it, with the scaling of
    its inputs; or all but the gate, which begins anew."""

    start_steps: int = 0
    """The most steps for which a guide, another policy, acts at the start of an episode (random
    state initialisation). How many is drawn each time. They count as steps, and are not learned
    from."""

    reward_scale: float = 1.0
    """Factor on the generator's reward; the returns reported are without it."""

    centre_reward: bool = False
    """Whether the generator's reward is paid without its mean over the replayed transitions of each
    chunk of updates. A learned reward has an arbitrary constant, which critics must first learn,
    and again whenever it drifts. Where episodes can end the constant matters: set `absorbing`."""

    log_prob_in_reward: bool = True
    """Whether Implementations 1 and 2 pay f - log π. False: they pay f, and -log π is left to the
    generator's own entropy term, whose `temperature` is then to be larger by 1."""

    log_density: Literal["exact", "released"] = "exact"
    """Density of a squashed action in the discriminator. `released`: the Gaussian density taken
    at the squashed action, without the tanh's Jacobian."""

    policy_in_logit: bool = True
    """Whether the loss is that of D = e^f / (e^f + π), with logit f - log π. False: the released
    loss, whose gradient is that of D = σ(f)."""

    replay_density: Literal["policy", "mixture"] = "policy"
    """Which density of the actions in replay the discriminator compares e^f with. `policy`: that of
    π as it is now, as if all of them were its own. `mixture`: that of π and of the warm-up's
    uniform actions, mixed as replay has them, which has no tail."""

    discriminator_discount: float = 0.99
    """γ in f(s, a, s') = r + γ V(s') - V(s)."""

    reward_hidden: tuple[int, ...] = (100, 100)
    """Hidden layers of r."""

    reward_sees: tuple[int, ...] | None = None
    """Which numbers of an observation r sees, by their indices; actions, where it sees actions, it
    sees whole. None: all of them. V sees all of them in any case."""

    shaping_hidden: tuple[int, ...] = (100, 100)
    """Hidden layers of V."""

    discriminator_activation: Literal["tanh", "relu"] = "tanh"
    """Activation in r and V."""

    discriminator_learning_rate: float = 1e-3
    """Adam's, for r and V."""

    gradient_penalty: float = 10.0
    """Weight of the penalty (‖∇‖ - 1)²."""

    penalty_on: Literal["logit", "probability"] = "logit"
    """What the penalty differentiates: the learned part of the logit, by all it sees, at one
    random point between an expert's and a policy's transition; or, as released, the probability
    D, by the state alone, with a coefficient of its own for each of s, a, s' and log π."""

    penalty_sides: Literal["two", "one"] = "two"
    """Which slopes it punishes: all but 1, or, one-sided, only those above 1: max(0, ‖∇‖ - 1)²."""

    spectral_norm: bool = False
    """Whether each weight matrix of r and V is divided by its largest singular value, which makes
    the slopes of both 1 at most (Miyato et al. 2018)."""

    bottleneck: float | None = None
    """I_c: the most nats that a transition's stochastic code may carry, on average (Peng et al.
    2019). None: r and V see their inputs as they are."""

    bottleneck_size: int = 8
    """Numbers in the code of r's input, and in that of V's."""

    bottleneck_rate: float = 1e-5
    """Step of the dual ascent that enforces `bottleneck`."""

    absorbing: Literal["none", "bootstrap", "analytic"] = "none"
    """What follows a termination: nothing; an absorbing state that loops (DAC); or the loop's
    return in closed form (the paper's R_T)."""

    normalise: bool = True
    """Whether networks see observations scaled to mean 0 and spread 1: fixed statistics of the
    warm-up and the demonstrations, half and half, or of the warm-up alone where there are none."""

    eval_every: int = 5_000
    """Environment steps between evaluations."""

    eval_episodes: int = 10
    """Episodes, with the policy's mode, of one evaluation. They run side by side: of a task of
    one's own, `eval_episodes` environments are open for each seed, and one more for training."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value, kind = getattr(self, field.name), field.type
            if get_origin(kind) is Literal and value not in get_args(kind):
                raise ValueError(f"{field.name} is {value!r}; expected one of {get_args(kind)}")
        for name in _POSITIVE:
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} is {getattr(self, name)!r}; expected a positive number")
        for name in ("discount", "discriminator_discount", "target_rate"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} is {getattr(self, name)!r}; expected a number in [0, 1]")
        for name in (
            "update_every",
            "temperature",
            "discriminator_updates",
            "primitives",
            "bottleneck",
        ):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise ValueError(f"{name} is {value!r}; expected a positive number or None")
        if self.warmup_steps > self.total_steps:
            raise ValueError(
                f"warmup_steps is {self.warmup_steps}, total_steps {self.total_steps}: nothing "
                "would be trained; lower warmup_steps"
            )
        first = self.update_every or 0
        first += self.warmup_steps if self.generator == "ppo" else 0
        if first > self.total_steps:
            raise ValueError(
                f"update_every is {self.update_every}, total_steps {self.total_steps}: nothing "
                "would be trained; lower update_every"
            )
        if self.gradient_penalty < 0:
            raise ValueError(f"gradient_penalty is {self.gradient_penalty!r}; expected 0 or more")
        for name in (
            "hidden",
            "trunk_hidden",
            "primitive_hidden",
            "gate_hidden",
            "reward_hidden",
            "shaping_hidden",
        ):
            if not all(size > 0 for size in getattr(self, name)):
                raise ValueError(f"{name} is {getattr(self, name)!r}; expected positive sizes")
        if not self.log_std_range[0] < self.log_std_range[1]:
            raise ValueError(
                f"log_std_range is {self.log_std_range!r}; expected a lower and an upper bound"
            )
        if self.warmup_hold < 1:
            raise ValueError(f"warmup_hold is {self.warmup_hold!r}; expected at least 1 step")
        log_prob_needed = self.reward.startswith("implementation") or self.reward == "gan-gcl"
        if self.generator == "td3" and log_prob_needed:
            raise ValueError(
                f"reward {self.reward!r} needs log π, and td3's policy is deterministic: "
                "use generator='sac', or reward='dac'"
            )
        if self.generator == "ppo":
            self._check_ppo()
        elif self.reward == "gan-gcl":
            raise ValueError(
                "reward 'gan-gcl' is for whole episodes of the present policy: use generator='ppo'"
            )
        if self.primitives is not None and self.generator != "sac":
            raise ValueError(
                f"primitives={self.primitives} are a form of SAC's actor, and the generator is "
                f"{self.generator!r}: use generator='sac'"
            )
        if self.fixed_primitives and self.primitives is None:
            raise ValueError("fixed_primitives=True, and there are none: set primitives")
        if self.carry == "primitives" and self.primitives is None:
            raise ValueError("carry='primitives', and there are none: set primitives")
        if self.carry != "nothing" and self.generator == "td3":
            raise ValueError(f"carry={self.carry!r} is not for td3: use generator='sac' or 'ppo'")
        if self.start_steps and self.learns_reward and self.replay_density == "mixture":
            raise ValueError(
                f"start_steps is {self.start_steps}, and replay_density='mixture' counts the steps "
                "of a guide, which replay does not hold: set one of them to 0 or 'policy'"
            )
        if not 0 <= self.start_steps < self.warmup_steps:
            raise ValueError(
                f"start_steps is {self.start_steps}; expected 0 or more, and fewer than the "
                f"{self.warmup_steps} warmup_steps, of which something must be left to learn from"
            )
        if self.absorbing != "none" and self.reward == "environment":
            raise ValueError(
                f"absorbing={self.absorbing!r} is for learned rewards; the task's own reward is "
                "known to end with the episode: set absorbing='none'"
            )
        if self.absorbing == "analytic" and self.discount == 1:
            raise ValueError("absorbing='analytic' divides by 1 - discount: set discount below 1")
        if not self.log_prob_in_reward and self.reward not in (
            "implementation-1",
            "implementation-2",
        ):
            raise ValueError(
                f"log_prob_in_reward=False, and reward {self.reward!r} has no log π to leave out: "
                "it is for implementation-1 and implementation-2"
            )
        if self.replay_density == "mixture" and self.log_density == "released":
            raise ValueError(
                "replay_density='mixture' mixes densities of the squashed action, which "
                "log_density='released' is not: set log_density='exact'"
            )
        if self.bottleneck is not None and self.spectral_norm:
            raise ValueError(
                f"bottleneck={self.bottleneck} and spectral_norm=True are alternatives: set one"
            )
        if self.reward_sees is not None:
            self._check_reward_sees()
        if self.bottleneck is not None and self.reward == "gan-gcl":
            raise ValueError(
                f"bottleneck={self.bottleneck} is for single transitions, and gan-gcl judges whole "
                "episodes: set bottleneck=None"
            )

    def _check_reward_sees(self) -> None:
        given = f"reward_sees is {self.reward_sees}"
        if not self.reward_sees or min(self.reward_sees) < 0:
            raise ValueError(f"{given}; expected indices from 0 on, or None")
        if self.spectral_norm or self.bottleneck is not None:
            raise ValueError(
                f"{given}, which is for plain networks: set spectral_norm=False, bottleneck=None"
            )
        if self.absorbing != "none":
            raise ValueError(f"{given}, without the absorbing state: set absorbing='none'")

    def _check_ppo(self) -> None:
        if self.update_every is None or self.update_every > self.replay_size:
            raise ValueError(
                f"update_every is {self.update_every}; ppo learns from the last so many steps: set "
                f"it, to replay_size ({self.replay_size}) at most"
            )
        if self.temperature is None:
            raise ValueError("temperature is None, and ppo does not learn it: set a small number")
        if self.absorbing != "none":
            raise ValueError(f"absorbing={self.absorbing!r} is not for ppo: set absorbing='none'")
        if self.centre_reward:
            raise ValueError("centre_reward=True is for replay, and ppo has none: set it to False")
        if self.start_steps:
            raise ValueError(
                f"start_steps is {self.start_steps}, and ppo learns from every step: set it to 0"
            )

    def flat(self) -> dict[str, Any]:
        """Return every field with its value."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @classmethod
    def of(cls, **flat: Any) -> Self:
        """Return the configuration of these fields; those that are left out have their defaults."""
        return cls(**flat)

    def change(self, **flat: Any) -> Self:
        """Return this configuration with other values of some fields."""
        return replace(self, **flat)

    @property
    def learns_reward(self) -> bool:
        """Whether a discriminator is trained."""
        return self.reward not in ("environment", "frozen")


_POSITIVE = (
    "total_steps",
    "warmup_steps",
    "batch_size",
    "epochs",
    "replay_size",
    "learning_rate",
    "actor_delay",
    "reward_scale",
    "discriminator_learning_rate",
    "bottleneck_size",
    "bottleneck_rate",
    "eval_every",
    "eval_episodes",
)


CORRECTED = Config()
"""Expert label 1, logit f - log π with the exact squashed density, inputs normalised."""

PAPER = Config(normalise=False)
"""The text of the paper. It differs from `CORRECTED` where the text is silent or wrong: inputs
are left as the task gives them."""

RELEASE = Config(
    hidden=(256, 256),
    temperature=None,
    log_std_range=(-20.0, 2.0),
    log_density="released",
    composition="released",
    policy_in_logit=False,
    discriminator_discount=0.9,
    reward_hidden=(256, 256),
    shaping_hidden=(100, 100),
    discriminator_activation="relu",
    penalty_on="probability",
    normalise=False,
)
"""What the released code optimises; its absorbing vectors and orthogonal initialisation are not
reproduced."""


def differences(one: Config, other: Config) -> dict[str, tuple[Any, Any]]:
    """Return the fields in which two configurations differ, with both values."""
    pairs = {f.name: (getattr(one, f.name), getattr(other, f.name)) for f in fields(Config)}
    return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}
