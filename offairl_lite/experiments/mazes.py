"""The experiments on the mazes and the marsh."""

from collections.abc import Mapping
from typing import Any

from offairl_lite.config import CORRECTED, Config
from offairl_lite.experiments.base import (
    DAC,
    EXPERT,
    LEFT,
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

MARSH, WEST = "offairl/PointMarsh-v0", "offairl/PointMarshWest-v0"

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


def _both(demo: dict, full: dict, **common) -> Mapping[Scale, Config]:
    return {
        "demo": MAZE_DEMO.change(**common).change(**demo),
        "full": MAZE_FULL.change(**common).change(**full),
    }


_ON_POLICY_DEMO = {"total_steps": 60_000, "eval_every": 5_000}


def _maze_retraining_variants() -> dict[str, dict[str, Any]]:
    """Return the ways to begin, and those with primitives with the warm-up of scratch, too."""
    alone = {"warmup_steps": 100, "warmup_hold": 1.0}
    helped = {
        f"{name}-helped": changes
        for name, changes in retraining_variants({}, 50).items()
        if changes.get("pretrained") == "primitives" and "start_steps" not in changes
    }
    return retraining_variants(alone, 50) | helped


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
    tasks = {"": {}, "back-": {"env_id": LEFT}, "true-": EXPERT}
    return {
        prefix + name: {**task, **begin}
        for prefix, task in tasks.items()
        for name, begin in begins.items()
    }


EXPERIMENTS: Mapping[str, Experiment] = {
    "maze-expert": Experiment(
        "SAC on the true reward of the maze: trains the experts, and is the upper line of figures",
        _both({"total_steps": 16_000, "target_rate": 0.02, "eval_every": 2_000}, {}, **EXPERT),
        SEEDS,
    ),
    "maze-imitation": Experiment(
        "Off-policy AIRL, Implementation 4, from demonstrations of PointMazeLeft",
        _both({}, {}),
        SEEDS,
    ),
    "maze-mcp": Experiment(
        "Off-policy AIRL on PointMazeLeft with actors of several primitives: 6 runs",
        _both(SMALL_MCP, {}),
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
        _both(_ON_POLICY_DEMO, {}, **ON_POLICY, reward="gail-survival"),
        SEEDS,
        variants=SIGNS,
    ),
    "maze-dac": Experiment(
        "DAC with TD3 and with SAC, from demonstrations of PointMazeLeft",
        _both({}, {}, reward="dac"),
        SEEDS,
        variants=DAC,
    ),
    "maze-airl-ppo": Experiment(
        "What came before off-policy AIRL, with PPO: AIRL with r(s) and r(s, a), and GAN-GCL",
        _both(_ON_POLICY_DEMO, {}, **ON_POLICY, reward="implementation-2"),
        SEEDS,
        variants={
            "state": {"reward": "implementation-2"},
            "state-action": {"reward": "implementation-1"},
            "gan-gcl": {"reward": "gan-gcl"},
        },
    ),
    "maze-retraining": Experiment(
        "On PointMazeRight, paid by the reward from PointMazeLeft: what of the policy to keep",
        _both({"total_steps": 8_000, **SMALL_MCP}, {}, env_id=RIGHT, reward="frozen"),
        SEEDS,
        reward_from="maze-imitation",
        variants=_maze_retraining_variants(),
    ),
    "maze-airl-memory": Experiment(
        "AIRL with PPO and r(s), whose negatives are not of the last block alone: 2 runs",
        _both(_ON_POLICY_DEMO, {}, **ON_POLICY, reward="implementation-2"),
        SEEDS,
        variants={"recent": {"replay_size": 40_000}, "all": {"replay_size": 1_000_000}},
    ),
    "maze-rewards": Experiment(
        "Implementations 1 to 4 and DAC's reward on PointMazeLeft; 1 and 2 with entropy once, too",
        _both({}, {}),
        SEEDS,
        variants={**REWARDS, **_ENTROPY_ONCE, **WITHOUT_TAIL},
    ),
    "maze-penalties": Experiment(
        "Implementation 4 on PointMazeLeft with other bounds on the discriminator: 6 runs",
        _both({}, {}),
        SEEDS,
        variants=_PENALTIES,
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
            **EXPERT,
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
            "true-west": {"env_id": WEST, **EXPERT},
        },
    ),
}
