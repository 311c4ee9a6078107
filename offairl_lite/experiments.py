"""The experiments, as data: each name means one configuration at demo and one at full scale."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from offairl_lite import ablations  # noqa: F401  (registers their settings)
from offairl_lite.config import CORRECTED, Config
from offairl_lite.scale import Scale


@dataclass(frozen=True)
class Experiment:
    """What is run under a name.

    Args:
        about: one line for a reader.
        configs: the configuration at each scale.
        seeds: the members at each scale.
        reward_from: the run whose learned reward is used, frozen; None for no such.
        variants: where it is several runs, their names, and what each changes in the configuration.
        experts: how many of the shipped experts show the task at each scale; None for all.
    """

    about: str
    configs: Mapping[Scale, Config]
    seeds: Mapping[Scale, tuple[int, ...]]
    reward_from: str | None = None
    variants: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    experts: Mapping[Scale, int | None] = field(
        default_factory=lambda: {"demo": None, "full": None}
    )


LEFT, RIGHT = "offairl/PointMazeLeft-v0", "offairl/PointMazeRight-v0"
ANT, DISABLED = "offairl/CustomAnt-v0", "offairl/DisabledAnt-v0"
MARSH, WEST = "offairl/PointMarsh-v0", "offairl/PointMarshWest-v0"
SEEDS: Mapping[Scale, tuple[int, ...]] = {"demo": tuple(range(5)), "full": tuple(range(10))}

# What the maze needs and the paper does not state. Warm-up actions are held for ten steps on
# average: a particle that draws a fresh push every step hardly ever gets round the barrier. The
# temperature is learned, for a policy twice as wide as usual, which falls back into the trap under
# the barrier less often.
MAZE_FULL = CORRECTED.change(env_id=LEFT, temperature=None, target_entropy=-1.0, warmup_hold=10.0)

# Small networks and batches and faster targets: a minute or two for five seeds on a laptop.
MAZE_DEMO = MAZE_FULL.change(
    total_steps=6_000,
    warmup_steps=3_000,
    batch_size=64,
    hidden=(64, 64),
    reward_hidden=(64, 64),
    shaping_hidden=(64, 64),
    target_rate=0.01,
    eval_every=1_000,
)


# Actors of SAC-MCP: how many primitives, and the gate's kind. Compare what has one kind of gate.
_ACTORS = {
    "plain": {},
    "4-softmax": {"primitives": 4},
    "8-softmax": {"primitives": 8},
    "4-sigmoid": {"primitives": 4, "gating": "sigmoid"},
    "8-sigmoid": {"primitives": 8, "gating": "sigmoid"},
    "4-released": {
        "learner": "sac-released",
        "log_density": "exact",
        "primitives": 4,
        "gating": "sigmoid",
    },
}


_SMALL_MCP = {"trunk_hidden": (64,), "primitive_hidden": (64,), "gate_hidden": (64, 64)}


def _both(demo: dict, full: dict, **common) -> Mapping[Scale, Config]:
    return {
        "demo": MAZE_DEMO.change(**common).change(**demo),
        "full": MAZE_FULL.change(**common).change(**full),
    }


# PPO, for the on-policy methods. Its policy is wide at first and remains so: the noise of its
# actions is all that leads it out of the trap.
_ON_POLICY = {
    "learner": "ppo",
    "temperature": 1e-3,
    "log_std_range": (-2.0, 2.0),
    "update_every": 2_000,
    "replay_size": 2_000,
    "warmup_steps": 2_000,
    "discriminator_updates": 100,
    "batch_size": 250,
}
_ON_POLICY_DEMO = {"total_steps": 60_000, "eval_every": 5_000}
_LOCOMOTION_DEMO = {
    "total_steps": 20_000,
    "hidden": (64, 64),
    "reward_hidden": (64, 64),
    "shaping_hidden": (64, 64),
    "eval_every": 2_000,
    "eval_episodes": 2,
}
_SIGNS = {
    "survival": {"reward": "gail-survival"},
    "termination": {"reward": "gail-termination"},
    "log-odds": {"reward": "dac"},
}
_DAC = {"td3": {"learner": "td3"}, "sac": {"learner": "sac"}}


def _locomotion(env_id: str, demo: dict | None = None, **common) -> Mapping[Scale, Config]:
    # Members end their episodes at different times, so they train every 1,000 steps.
    full = CORRECTED.change(env_id=env_id, update_every=1_000)
    small = full.change(**_LOCOMOTION_DEMO)
    return {"demo": small.change(**common).change(**(demo or {})), "full": full.change(**common)}


# Demonstrations of one expert, at demo scale: the records there were made when there was one.
_ONE_EXPERT: Mapping[Scale, int | None] = {"demo": 1, "full": None}

# A logit whose log π has no tail, see `DiscriminatorConfig.loss`.
_MIXTURE = {"loss": "mixture"}

# In less the ant learns nothing, and five seeds of it take hours.
_ANT_DEMO = {"total_steps": 50_000, "eval_every": 5_000}
_FEW: Mapping[Scale, tuple[int, ...]] = {"demo": (0, 1, 2), "full": SEEDS["full"]}
# The linear velocity of the torso, in the observations of both ants.
_VELOCITY = (13, 14, 15)

# Off-policy AIRL with SAC and SAC-MCP, and DAC with SAC and TD3, on the paper's tasks, with an
# absorbing state where a fall ends them. AIRL with α = 1, the temperature for which its logit is
# derived, too: at any other, a step of life is paid by the unit of actions.
_IMITATORS = {
    "airl": {},
    "airl-mixture": _MIXTURE,
    "airl-soft": {**_MIXTURE, "temperature": 1.0},
    "mcp-4": {"primitives": 4},
    "mcp-8": {"primitives": 8},
    "dac": {"reward": "dac"},
    "dac-td3": {"reward": "dac", "learner": "td3"},
}
_SIDE_BY_SIDE = {
    f"{env_id.split('/')[-1].split('-')[0]}-{name}": {
        "env_id": env_id,
        "absorbing": absorbing,
        **changes,
    }
    for env_id, absorbing in (
        ("HalfCheetah-v5", "none"),
        ("Hopper-v5", "bootstrap"),
        ("Walker2d-v5", "bootstrap"),
        ("Ant-v5", "bootstrap"),
        (ANT, "none"),
    )
    for name, changes in _IMITATORS.items()
}


# What makes off-policy AIRL work on robots: its loss, the temperature, and how many random steps
# come first. The released loss at 0.2 after the short warm-up is the recipe.
_RELEASED = {"loss": "released"}
_LOSSES = {"exact": {}, "mixture": _MIXTURE, "released": _RELEASED, "dac": {"reward": "dac"}}
_TEMPERATURES = {"fixed": 0.2, "learned": None, "one": 1.0}
_WARMUPS = {"short": 1_000, "long": 10_000}
_ROBOTS = {
    "Hopper": {"env_id": "Hopper-v5", "absorbing": "bootstrap"},
    "Walker2d": {"env_id": "Walker2d-v5", "absorbing": "bootstrap"},
    "HalfCheetah": {"env_id": "HalfCheetah-v5"},
    "CustomAnt": {"env_id": ANT},
}
_WHAT_DECIDES = {
    f"{robot}-{loss}-{temperature}-{warmup}": {
        **task,
        **changes,
        "temperature": _TEMPERATURES[temperature],
        "warmup_steps": _WARMUPS[warmup],
    }
    for robot, task in _ROBOTS.items()
    for loss, changes in _LOSSES.items()
    for temperature in _TEMPERATURES
    for warmup in _WARMUPS
}
_WITH_THE_RECIPE = {
    f"{robot}-{name}": {**task, **changes}
    for robot, task in _ROBOTS.items()
    for name, changes in (
        ("airl", _RELEASED),
        ("dac", _LOSSES["dac"]),
        ("dac-td3", {**_LOSSES["dac"], "learner": "td3"}),
    )
}


# Paid by minus a distance of at most 0.6, SAC would park against the wall behind the goal, 0.045
# too far: the entropy is worth more. Magnified, the distance is.
_EXPERT = {"reward": "environment", "reward_scale": 100.0}

# The paper's three candidates for an expert, on its eight tasks.
_LEARNERS = {
    "td3": {"learner": "td3"},
    "sac-fixed": {"temperature": 0.2},
    "sac-learned": {"temperature": None},
}
_LOCOMOTION = (
    "HalfCheetah-v5",
    "Ant-v5",
    "Hopper-v5",
    "Walker2d-v5",
    ANT,
    DISABLED,
)
_ON_THE_MAZE = {"update_every": None, "warmup_hold": 10.0, **_EXPERT}


def _expert_variants() -> dict[str, dict[str, Any]]:
    tasks = {task: {} for task in _LOCOMOTION} | {LEFT: _ON_THE_MAZE, RIGHT: _ON_THE_MAZE}
    variants = {}
    for task, changes in tasks.items():
        for name, learner in _LEARNERS.items():
            wide = {"target_entropy": -1.0} if changes and name != "td3" else {}
            short = task.split("/")[-1].split("-")[0]
            variants[f"{short}-{name}"] = {"env_id": task, **changes, **wide, **learner}
    return variants


def _retraining_variants(alone: dict, start_steps: int) -> dict[str, dict[str, Any]]:
    """Return what may be kept of the policy, each with and without random starts.

    What begins with a policy has one episode of random actions, and no other help to explore:
    `alone` says so. A guide acts for at most `start_steps`.
    """
    kept: dict[str, dict[str, Any]] = {"scratch": {}, "policy": {"pretrained": "policy"}}
    for k in (4, 8):
        actor = {"primitives": k, "pretrained": "primitives"}
        kept |= {f"{k}-gate": {**actor, "fixed_primitives": True}, f"{k}-both": actor}
    variants = {}
    for name, changes in kept.items():
        variants[name] = {**changes, **(alone if "pretrained" in changes else {})}
        for guide in ("own", "expert"):
            variants[f"{name}-{guide}-starts"] = {**variants[name], "start_steps": start_steps}
    return variants


def _maze_retraining_variants() -> dict[str, dict[str, Any]]:
    """Return the ways to begin, and those with primitives with the warm-up of scratch, too."""
    alone = {"warmup_steps": 100, "warmup_hold": 1.0}
    helped = {
        f"{name}-helped": changes
        for name, changes in _retraining_variants({}, 50).items()
        if changes.get("pretrained") == "primitives" and "start_steps" not in changes
    }
    return _retraining_variants(alone, 50) | helped


def _ant_transfer_variants() -> dict[str, dict[str, Any]]:
    """Return the maze's ways to begin, and those without a guide in the published action order."""
    variants = _retraining_variants({"warmup_steps": 1_000}, 100)
    released = {
        f"{name}-released-order": {**changes, "env_id": "offairl/DisabledAntReleased-v0"}
        for name, changes in variants.items()
        if "start_steps" not in changes
    }
    return variants | released


# What the end of an episode is worth to an imitator: each reward, with each way to go on after it.
_ABSORBING = {
    f"{reward}-{absorbing}": {"reward": reward, "absorbing": absorbing}
    for reward in ("dac", "implementation-4")
    for absorbing in ("none", "bootstrap", "analytic")
}


# The paper's four rewards, and DAC's; the four once more, with log π without its tail. The first
# two contain -log π, and SAC adds α of it: to count it once, either SAC has as good as no
# temperature (cold), or it has all of it (soft). Or SAC has what it learns to need, and the reward
# nothing (learned).
_REWARDS = {
    **{f"implementation-{n}": {"reward": f"implementation-{n}"} for n in (1, 2, 3, 4)},
    "dac": {"reward": "dac"},
}
_WITHOUT_TAIL = {
    f"{name}-mixture": {**changes, **_MIXTURE}
    for name, changes in _REWARDS.items()
    if name != "dac"
}
_COLD = {"temperature": 1e-3, "target_entropy": None}
_SOFT = {"temperature": 1.0, "target_entropy": None, "log_prob_in_reward": False}
_LEARNED = {"log_prob_in_reward": False}
_ENTROPY_ONCE = {
    f"implementation-{n}-{name}": {"reward": f"implementation-{n}", **changes}
    for name, changes in (("cold", _COLD), ("soft", _SOFT), ("learned", _LEARNED))
    for n in (1, 2)
}
# What keeps the discriminator from being too steep or too sure.
_PENALTIES = {
    "none": {"gradient_penalty": 0.0},
    "logit": {},
    "one-sided": {"ablation": "one-sided"},
    "probability": {"ablation": "penalty-on-probability"},
    "spectral": {"gradient_penalty": 0.0, "ablation": "spectral-norm"},
    "bottleneck": {"gradient_penalty": 0.0, "ablation": "bottleneck", "bottleneck_rate": 1e-3},
}


def _reward_variants() -> dict[str, dict[str, Any]]:
    """Return two starts, from scratch and with a policy, with help to explore and alone.

    Each on PointMazeRight and, `back`, on PointMazeLeft, paid by a reward that is to be given; and
    on PointMazeRight, `true`, by the task's own.
    """
    begins = {
        "scratch": {},
        "scratch-alone": {"warmup_hold": 1.0},
        "policy": {"pretrained": "policy"},
        "policy-alone": {"pretrained": "policy", "warmup_steps": 100, "warmup_hold": 1.0},
    }
    tasks = {"": {}, "back-": {"env_id": LEFT}, "true-": _EXPERT}
    return {
        prefix + name: {**task, **begin}
        for prefix, task in tasks.items()
        for name, begin in begins.items()
    }


EXPERIMENTS: Mapping[str, Experiment] = {
    "experts": Experiment(
        "TD3 and SAC, with α fixed and learned, on the true reward of the eight tasks: 24 runs",
        {
            "demo": CORRECTED.change(
                env_id="HalfCheetah-v5",
                reward="environment",
                total_steps=6_000,
                warmup_steps=1_000,
                update_every=200,
                batch_size=64,
                hidden=(64, 64),
                eval_every=2_000,
                eval_episodes=2,
            ),
            "full": CORRECTED.change(
                env_id="HalfCheetah-v5", reward="environment", update_every=1_000
            ),
        },
        SEEDS,
        variants=_expert_variants(),
    ),
    "maze-expert": Experiment(
        "SAC on the true reward of the maze: trains the experts, and is the upper line of figures",
        _both({"total_steps": 16_000, "target_rate": 0.02, "eval_every": 2_000}, {}, **_EXPERT),
        SEEDS,
    ),
    "maze-imitation": Experiment(
        "Off-policy AIRL, Implementation 4, from demonstrations of PointMazeLeft",
        _both({}, {}),
        SEEDS,
    ),
    "maze-mcp": Experiment(
        "Off-policy AIRL on PointMazeLeft with actors of several primitives: 6 runs",
        _both(_SMALL_MCP, {}),
        SEEDS,
        variants=_ACTORS,
    ),
    "maze-transfer": Experiment(
        "SAC from scratch on PointMazeRight, paid by the reward that was learned on PointMazeLeft",
        _both({"total_steps": 8_000}, {}, env_id=RIGHT, reward="frozen"),
        SEEDS,
        reward_from="maze-imitation",
    ),
    "maze-gail": Experiment(
        "GAIL with PPO, from demonstrations of PointMazeLeft: its two rewards, and DAC's",
        _both(_ON_POLICY_DEMO, {}, **_ON_POLICY, reward="gail-survival"),
        SEEDS,
        variants=_SIGNS,
    ),
    "maze-dac": Experiment(
        "DAC with TD3 and with SAC, from demonstrations of PointMazeLeft",
        _both({}, {}, reward="dac"),
        SEEDS,
        variants=_DAC,
    ),
    "maze-airl-ppo": Experiment(
        "What came before off-policy AIRL, with PPO: AIRL with r(s) and r(s, a), and GAN-GCL",
        _both(_ON_POLICY_DEMO, {}, **_ON_POLICY, reward="implementation-2"),
        SEEDS,
        variants={
            "state": {"reward": "implementation-2"},
            "state-action": {"reward": "implementation-1"},
            "gan-gcl": {"reward": "gan-gcl"},
        },
    ),
    "hopper-gail": Experiment(
        "GAIL with PPO on Hopper, where episodes end when it falls: its two rewards, and DAC's",
        _locomotion("Hopper-v5", **_ON_POLICY, reward="gail-survival"),
        SEEDS,
        variants=_SIGNS,
        experts=_ONE_EXPERT,
    ),
    "hopper-dac": Experiment(
        "DAC with TD3 and with SAC on Hopper, with absorbing states",
        _locomotion("Hopper-v5", reward="dac", absorbing="bootstrap"),
        SEEDS,
        variants=_DAC,
        experts=_ONE_EXPERT,
    ),
    "hopper-absorbing": Experiment(
        "DAC and off-policy AIRL on Hopper, with absorbing states and without: 6 runs",
        {
            "demo": _locomotion("Hopper-v5", reward="dac")["demo"].change(
                total_steps=12_000,
                warmup_steps=2_000,
                update_every=250,
                batch_size=64,
                temperature=None,
                target_rate=0.01,
            ),
            "full": _locomotion("Hopper-v5", reward="dac")["full"],
        },
        SEEDS,
        variants=_ABSORBING,
        experts=_ONE_EXPERT,
    ),
    "locomotion": Experiment(
        "Off-policy AIRL with SAC and SAC-MCP beside DAC with SAC and TD3, α learned or 1: 35 runs",
        _locomotion("HalfCheetah-v5", _SMALL_MCP, temperature=None),
        SEEDS,
        variants=_SIDE_BY_SIDE,
        experts=_ONE_EXPERT,
    ),
    "what-decides": Experiment(
        "What makes off-policy AIRL work on robots: loss, temperature and warm-up, 96 runs",
        _locomotion(
            "Hopper-v5", {"total_steps": 100_000, "eval_every": 10_000, "eval_episodes": 5}
        ),
        SEEDS,
        variants=_WHAT_DECIDES,
        experts=_ONE_EXPERT,
    ),
    "recipe": Experiment(
        "Robots for 500,000 steps: off-policy AIRL by the recipe, DAC with SAC and TD3, 12 runs",
        _locomotion(
            "Hopper-v5",
            {"total_steps": 500_000, "eval_every": 25_000, "eval_episodes": 10},
            warmup_steps=1_000,
        ),
        SEEDS,
        variants=_WITH_THE_RECIPE,
        experts=_ONE_EXPERT,
    ),
    "maze-retraining": Experiment(
        "On PointMazeRight, paid by the reward from PointMazeLeft: what of the policy to keep",
        _both({"total_steps": 8_000, **_SMALL_MCP}, {}, env_id=RIGHT, reward="frozen"),
        SEEDS,
        reward_from="maze-imitation",
        variants=_maze_retraining_variants(),
    ),
    "ant-transfer": Experiment(
        "On DisabledAnt, paid by the reward from CustomAnt: what of the policy to keep, α learned",
        _locomotion(DISABLED, _SMALL_MCP | _ANT_DEMO, reward="frozen", temperature=None),
        _FEW,
        reward_from="locomotion/CustomAnt-airl",
        variants=_ant_transfer_variants(),
    ),
    "maze-airl-memory": Experiment(
        "AIRL with PPO and r(s), whose negatives are not of the last block alone: 2 runs",
        _both(_ON_POLICY_DEMO, {}, **_ON_POLICY, reward="implementation-2"),
        SEEDS,
        variants={"recent": {"replay_size": 40_000}, "all": {"replay_size": 1_000_000}},
    ),
    "maze-rewards": Experiment(
        "Implementations 1 to 4 and DAC's reward on PointMazeLeft; 1 and 2 with entropy once, too",
        _both({}, {}),
        SEEDS,
        variants={**_REWARDS, **_ENTROPY_ONCE, **_WITHOUT_TAIL},
    ),
    "maze-penalties": Experiment(
        "Implementation 4 on PointMazeLeft with other bounds on the discriminator: 6 runs",
        _both({}, {}),
        SEEDS,
        variants=_PENALTIES,
    ),
    "ant-rewards": Experiment(
        "Implementations 1 to 4 on CustomAnt, with and without log π's tail or the legs, and DAC",
        _locomotion(ANT, _ANT_DEMO),
        _FEW,
        variants={
            **_REWARDS,
            **_WITHOUT_TAIL,
            "implementation-4-velocity": {**_MIXTURE, "reward_sees": _VELOCITY},
        },
        experts=_ONE_EXPERT,
    ),
    "maze-transfer-rewards": Experiment(
        "What a reward is worth in the other maze: from scratch or a policy, with help or alone",
        _both({"total_steps": 8_000}, {}, env_id=RIGHT, reward="frozen"),
        SEEDS,
        reward_from="maze-imitation",
        variants=_reward_variants(),
    ),
    "marsh-expert": Experiment(
        "SAC on the true reward of the marsh, which is best gone round: trains the experts",
        _both(
            {"total_steps": 16_000, "target_rate": 0.02, "eval_every": 2_000},
            {},
            env_id=MARSH,
            **_EXPERT,
        ),
        SEEDS,
    ),
    "marsh-imitation": Experiment(
        "Off-policy AIRL, Implementation 4, and DAC, from demonstrations of the marsh",
        _both({}, {}, env_id=MARSH),
        SEEDS,
        variants={"implementation-4": {}, "dac": {"reward": "dac"}},
    ),
    "marsh-transfer": Experiment(
        "On the marsh again, and from another start, paid by what was learned there, or truly",
        _both({"total_steps": 8_000}, {}, env_id=MARSH, reward="frozen"),
        SEEDS,
        reward_from="marsh-imitation",
        variants={
            "again": {},
            "west": {"env_id": WEST},
            "true-west": {"env_id": WEST, **_EXPERT},
        },
    ),
    "imitate": Experiment(
        "Off-policy AIRL by the recipe, on a task of your own: give --env-id and --dataset",
        {
            "demo": CORRECTED.change(
                total_steps=20_000,
                warmup_steps=1_000,
                update_every=200,
                hidden=(64, 64),
                reward_hidden=(64, 64),
                shaping_hidden=(64, 64),
                eval_every=2_000,
                **_RELEASED,
            ),
            "full": CORRECTED.change(warmup_steps=1_000, update_every=1_000, **_RELEASED),
        },
        SEEDS,
    ),
}


def find(name: str) -> Experiment:
    """Return an experiment by name.

    Raises:
        ValueError: there is none; the message lists those there are.
    """
    if name not in EXPERIMENTS:
        raise ValueError(f"no experiment {name!r}; there are: {', '.join(EXPERIMENTS)}")
    return EXPERIMENTS[name]


def configure(run: str, scale: Scale) -> Config:
    """Return the configuration of a run: `EXPERIMENT`, or `EXPERIMENT/VARIANT`.

    Raises:
        ValueError: there is no such experiment, or no such run of it; the message lists those
            there are.
    """
    name, _, variant = run.partition("/")
    experiment = find(name)
    variants = experiment.variants or {"": {}}
    if variant not in variants:
        there = ", ".join(f"{name}/{v}" if v else name for v in variants)
        raise ValueError(f"no run {run!r}; there are: {there}")
    return experiment.configs[scale].change(**variants[variant])
