"""The experiments on the mazes and the marsh."""

from collections.abc import Mapping
from functools import partial

from offairl_lite.config import CORRECTED
from offairl_lite.experiments import base
from offairl_lite.experiments.base import Changes, Experiment, crossed, experiment

MARSH, WEST = "offairl/PointMarsh-v0", "offairl/PointMarshWest-v0"

# What the maze needs and the paper does not state. Warm-up actions are held for ten steps on
# average: a particle that draws a fresh push every step hardly ever gets round the barrier. The
# temperature is learned, for a policy twice as wide as usual, which falls back into the trap under
# the barrier less often.
MAZE_FULL = CORRECTED.change(
    env_id=base.LEFT, temperature=None, target_entropy=-1.0, random_hold=10.0
)

# Small networks and batches and faster targets: a minute or two for five seeds on a laptop.
_STEPS = {"total_steps": 6_000, "learning_starts": 3_000, "eval_every": 1_000}
MAZE_DEMO = MAZE_FULL.change(batch_size=64, target_rate=0.01, **_STEPS, **base.SMALL)

_maze = partial(experiment, {"demo": MAZE_DEMO, "full": MAZE_FULL})

_OF_STATE = base.REWARDS["implementation-2"]
_TRANSFER = {"env_id": base.RIGHT, "reward": "frozen"}
_SHORT = {"total_steps": 8_000}
_EXPERT_DEMO = {"total_steps": 16_000, "target_rate": 0.02, "eval_every": 2_000}
_ON_POLICY_DEMO = {"total_steps": 60_000, "eval_every": 5_000}

# Actors of SAC-MCP: how many primitives, and the gate's kind. Compare what has one kind of gate.
_SIGMOID: Changes = {"primitives": 4, "gating": "sigmoid"}
_ACTORS = {
    "plain": {},
    "4-softmax": {"primitives": 4},
    "8-softmax": {"primitives": 8},
    "4-sigmoid": _SIGMOID,
    "8-sigmoid": {**_SIGMOID, "primitives": 8},
    "4-released": {**_SIGMOID, "learner": "sac-released", "log_density": "exact"},
}

# The ways to begin, those with primitives with the warm-up of scratch, too, and the gate alone with
# a temperature that cannot run away.
_UNHELPED = base.retraining_variants({"learning_starts": 100, "random_hold": 1.0}, 50)
_HELPED, _PRIMITIVES = base.retraining_variants({}, 50), ("4-gate", "4-both", "8-gate", "8-both")
_RETRAINING = _UNHELPED | {f"{name}-helped": _HELPED[name] for name in _PRIMITIVES}
_RETRAINING |= {f"{k}-gate-cool": {**_UNHELPED[f"{k}-gate"], "temperature": 0.02} for k in (4, 8)}

# The first two rewards contain -log π, and SAC adds α of it: to count it once, either SAC has as
# good as no temperature (cold), or it has all of it (soft). Or SAC has what it learns to need, and
# the reward nothing (learned).
_ENTROPY_ONCE = crossed(
    {name: base.REWARDS[name] for name in ("implementation-1", "implementation-2")},
    {
        "cold": {"temperature": 1e-3, "target_entropy": None},
        "soft": {"temperature": 1.0, "target_entropy": None, "log_prob_in_reward": False},
        "learned": {"log_prob_in_reward": False},
    },
)

# From scratch and with a policy, with help to explore and alone: on PointMazeRight and, `back`, on
# PointMazeLeft, paid by a reward that is to be given; and on PointMazeRight by the task's own.
_WORTH = crossed(
    {"": {}, "back": {"env_id": base.LEFT}, "true": base.EXPERT},
    {
        "scratch": {},
        "scratch-alone": {"random_hold": 1.0},
        "policy": {"pretrained": "policy"},
        "policy-alone": {"pretrained": "policy", "learning_starts": 100, "random_hold": 1.0},
    },
)

_ABOUT = """\
maze-expert: SAC on the true reward of the maze: trains the experts; the upper line of figures
maze-imitation: Off-policy AIRL, Implementation 4, from demonstrations of PointMazeLeft
maze-mcp: Off-policy AIRL on PointMazeLeft with actors of several primitives: 6 runs
maze-transfer: SAC from scratch on PointMazeRight, paid by the reward learned on PointMazeLeft
maze-gail: GAIL with PPO, from demonstrations of PointMazeLeft: its two rewards, and DAC's
maze-dac: DAC with TD3 and with SAC, from demonstrations of PointMazeLeft
maze-airl-ppo: What came before off-policy AIRL: AIRL with PPO, with r(s) and r(s, a)
maze-retraining: On PointMazeRight, paid by PointMazeLeft's reward: what of the policy to keep
maze-airl-memory: AIRL with PPO and r(s), whose negatives are not of the last block alone: 2 runs
maze-rewards: Implementations 1 to 4 and DAC's reward on PointMazeLeft; 1 and 2 with entropy once
maze-transfer-rewards: What a reward is worth in the other maze: from scratch or a policy, or helped
marsh-expert: SAC on the true reward of the marsh, which is best gone round: trains the experts
marsh-imitation: Off-policy AIRL, Implementation 4, and DAC, from demonstrations of the marsh
marsh-transfer: On the marsh again, and from another start, paid by what was learned, or truly
"""
_GAIL = {**base.ON_POLICY, **base.SIGNS["survival"]}
_AIRL_PPO = {**base.ON_POLICY, **_OF_STATE}
_KINDS = {"state": _OF_STATE, "state-action": base.REWARDS["implementation-1"]}
_MEMORY = {"recent": {"replay_size": 40_000}, "all": {"replay_size": 1_000_000}}
_BACK: Changes = {**_SHORT, **base.SMALL_MCP}
_MARSH_EXPERT = {**base.EXPERT, "env_id": MARSH}
_MARSH_IMITATION = {"implementation-4": {}, "dac": base.REWARDS["dac"]}
_MARSH_TRANSFER = {
    "again": {},
    "west": {"env_id": WEST},
    "true-west": {"env_id": WEST, **base.EXPERT},
}
_paid = partial(_maze, _TRANSFER, reward_from="maze-imitation")
_REWARD = "marsh-imitation/implementation-4"
_marsh = partial(_maze, {"env_id": MARSH, "reward": "frozen"}, demo=_SHORT)

EXPERIMENTS: Mapping[str, Experiment] = base.described(
    _ABOUT,
    {
        "maze-expert": _maze(base.EXPERT, demo=_EXPERT_DEMO),
        "maze-imitation": _maze(),
        "maze-mcp": _maze(demo=base.SMALL_MCP, variants=_ACTORS),
        "maze-transfer": _paid(demo=_SHORT),
        "maze-gail": _maze(_GAIL, demo=_ON_POLICY_DEMO, variants=base.SIGNS),
        "maze-dac": _maze(base.REWARDS["dac"], variants=base.DAC),
        "maze-airl-ppo": _maze(_AIRL_PPO, demo=_ON_POLICY_DEMO, variants=_KINDS),
        "maze-retraining": _paid(demo=_BACK, variants=_RETRAINING),
        "maze-airl-memory": _maze(_AIRL_PPO, demo=_ON_POLICY_DEMO, variants=_MEMORY),
        "maze-rewards": _maze(variants=base.REWARDS | _ENTROPY_ONCE),
        "maze-transfer-rewards": _paid(demo=_SHORT, variants=_WORTH),
        "marsh-expert": _maze(_MARSH_EXPERT, demo=_EXPERT_DEMO),
        "marsh-imitation": _maze({"env_id": MARSH}, variants=_MARSH_IMITATION),
        "marsh-transfer": _marsh(variants=_MARSH_TRANSFER, reward_from=_REWARD),
    },
)
