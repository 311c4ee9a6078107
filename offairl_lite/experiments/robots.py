"""The experiments on robots."""

from collections.abc import Mapping
from typing import Any

from offairl_lite.config import CORRECTED, Config
from offairl_lite.experiments.base import (
    DAC,
    EXPERT,
    LEFT,
    MIXTURE,
    ON_POLICY,
    REWARDS,
    RIGHT,
    SEEDS,
    SIGNS,
    SMALL_MCP,
    WITHOUT_TAIL,
    Experiment,
    retraining_variants,
)
from offairl_lite.scale import Scale

ANT, DISABLED = "offairl/CustomAnt-v0", "offairl/DisabledAnt-v0"

_LOCOMOTION_DEMO = {
    "total_steps": 20_000,
    "hidden": (64, 64),
    "reward_hidden": (64, 64),
    "shaping_hidden": (64, 64),
    "eval_every": 2_000,
    "eval_episodes": 2,
}


def _locomotion(env_id: str, demo: dict | None = None, **common) -> Mapping[Scale, Config]:
    # Members end their episodes at different times, so they train every 1,000 steps.
    full = CORRECTED.change(env_id=env_id, update_every=1_000)
    small = full.change(**_LOCOMOTION_DEMO)
    return {"demo": small.change(**common).change(**(demo or {})), "full": full.change(**common)}


# Demonstrations of one expert, at demo scale: the records there were made when there was one.
_ONE_EXPERT: Mapping[Scale, int | None] = {"demo": 1, "full": None}

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
    "airl-mixture": MIXTURE,
    "airl-soft": {**MIXTURE, "temperature": 1.0},
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

_LOSSES = {"exact": {}, "mixture": MIXTURE, "released": _RELEASED, "dac": {"reward": "dac"}}

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

_ON_THE_MAZE = {"update_every": None, "warmup_hold": 10.0, **EXPERT}


def _expert_variants() -> dict[str, dict[str, Any]]:
    tasks = {task: {} for task in _LOCOMOTION} | {LEFT: _ON_THE_MAZE, RIGHT: _ON_THE_MAZE}
    variants = {}
    for task, changes in tasks.items():
        for name, learner in _LEARNERS.items():
            wide = {"target_entropy": -1.0} if changes and name != "td3" else {}
            short = task.split("/")[-1].split("-")[0]
            variants[f"{short}-{name}"] = {"env_id": task, **changes, **wide, **learner}
    return variants


def _ant_transfer_variants() -> dict[str, dict[str, Any]]:
    """Return the maze's ways to begin, and those without a guide in the published action order."""
    variants = retraining_variants({"warmup_steps": 1_000}, 100)
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
    "hopper-gail": Experiment(
        "GAIL with PPO on Hopper, where episodes end when it falls: its two rewards, and DAC's",
        _locomotion("Hopper-v5", **ON_POLICY, reward="gail-survival"),
        SEEDS,
        variants=SIGNS,
        experts=_ONE_EXPERT,
    ),
    "hopper-dac": Experiment(
        "DAC with TD3 and with SAC on Hopper, with absorbing states",
        _locomotion("Hopper-v5", reward="dac", absorbing="bootstrap"),
        SEEDS,
        variants=DAC,
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
        _locomotion("HalfCheetah-v5", SMALL_MCP, temperature=None),
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
    "ant-transfer": Experiment(
        "On DisabledAnt, paid by the reward from CustomAnt: what of the policy to keep, α learned",
        _locomotion(DISABLED, SMALL_MCP | _ANT_DEMO, reward="frozen", temperature=None),
        _FEW,
        reward_from="locomotion/CustomAnt-airl",
        variants=_ant_transfer_variants(),
    ),
    "ant-rewards": Experiment(
        "Implementations 1 to 4 on CustomAnt, with and without log π's tail or the legs, and DAC",
        _locomotion(ANT, _ANT_DEMO),
        _FEW,
        variants={
            **REWARDS,
            **WITHOUT_TAIL,
            "implementation-4-velocity": {**MIXTURE, "reward_sees": _VELOCITY},
        },
        experts=_ONE_EXPERT,
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
