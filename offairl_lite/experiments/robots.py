"""The experiments on robots."""

from collections.abc import Mapping
from functools import partial

from offairl_lite.config import CORRECTED
from offairl_lite.demonstrations import short_name
from offairl_lite.experiments import base
from offairl_lite.experiments.base import Changes, Experiment, crossed, experiment

ANT, DISABLED = "offairl/CustomAnt-v0", "offairl/DisabledAnt-v0"

# Members end their episodes at different times, so they train every 1,000 steps.
_FULL = CORRECTED.change(train_every=1_000)

_DEMO = _FULL.change(total_steps=20_000, eval_every=2_000, eval_episodes=2, **base.SMALL)

# Demonstrations of the experts that there were when the records were made: one, and later two.
_robot = partial(experiment, {"demo": _DEMO, "full": _FULL}, experts={"demo": 1, "full": 2})

# In less the ant learns nothing, and five seeds of it take hours.
_ANT_DEMO: Changes = {"total_steps": 50_000, "eval_every": 5_000}
_FEW = {"demo": (0, 1, 2), "full": base.SEEDS["full"]}

# The linear velocity of the torso, in the observations of both ants.
_VELOCITY: Changes = {"reward_sees": (13, 14, 15)}

_IDS = ("HalfCheetah-v5", "Ant-v5", "Hopper-v5", "Walker2d-v5", ANT, DISABLED)
_TASKS: dict[str, Changes] = {short_name(env_id): {"env_id": env_id} for env_id in _IDS}
_HOPPER, _DAC = _TASKS["Hopper"], base.REWARDS["dac"]
_DAC_TD3 = {**_DAC, **base.DAC["td3"]}


def _imitated(*names: str) -> dict[str, Changes]:
    """Return tasks, with an absorbing state where a fall ends them."""
    falls, absorbing = ("Hopper", "Walker2d", "Ant"), {"absorbing": "bootstrap"}
    return {name: {**_TASKS[name], **(absorbing if name in falls else {})} for name in names}


_FIVE = _imitated("HalfCheetah", "Hopper", "Walker2d", "Ant", "CustomAnt")
_MCP: dict[str, Changes] = {f"mcp-{k}": {"primitives": k} for k in (4, 8)}
_AND_DAC: dict[str, Changes] = {"dac": _DAC, "dac-td3": _DAC_TD3}

# The first settings. AIRL with α = 1, the temperature for which its logit is derived, too: at any
# other, a step of life is paid by the unit of actions.
_SOFT: Changes = {**base.MIXTURE, "temperature": 1.0}
_LOSSES: dict[str, Changes] = {"airl": {}, "airl-mixture": base.MIXTURE, "airl-soft": _SOFT}
_FIRST = crossed(_FIVE, {**_LOSSES, **_MCP, **_AND_DAC})

# What makes off-policy AIRL work on robots: its loss, the temperature, and how many random steps
# come first. The released loss at 0.2 after the short warm-up is the recipe.
_RELEASED = {"loss": "log-ratio"}
_BY_THE_RECIPE = {"airl": _RELEASED, **crossed(_MCP, {"": _RELEASED}), **_AND_DAC}
_ROBOTS = _imitated("Hopper", "Walker2d", "HalfCheetah", "CustomAnt")
_WHAT_DECIDES = crossed(
    _ROBOTS,
    {"exact": {}, "mixture": base.MIXTURE, "released": _RELEASED, "dac": _DAC},
    {"fixed": {"temperature": 0.2}, "learned": {"temperature": None}, "one": {"temperature": 1.0}},
    {"short": {"learning_starts": 1_000}, "long": {"learning_starts": 10_000}},
)

# What one would use instead, on the five robots, each with its strongest expert. How many
# demonstrations there are is not of the configuration: give --trajectories. The recipe may also
# start from a clone, whose file has to be given, so these runs are an experiment of their own:
# `offairl clone` makes it, with --experts best, --hidden 64 64 (400 300 at full scale) and, for
# Hopper, Walker2d and Ant, --absorbing-state; --pretrained-policy begins with it.
_STATE_DAC: dict[str, Changes] = {"state-dac": {**_DAC, "ablation": "state-pairs"}}
_SOFT_Q: dict[str, Changes] = {name: {"reward": name} for name in ("sqil", "iq-learn")}
_BENCHMARK = crossed(_FIVE, {"airl": _RELEASED, "dac": _DAC, **_STATE_DAC, **_SOFT_Q})
_WARM = crossed(_FIVE, {"airl-warm": {**_RELEASED, "pretrained": "policy"}})

_LONG: Changes = {"total_steps": 100_000, "eval_every": 10_000, "eval_episodes": 10}
_BEST: base.Experts = {"demo": "best", "full": "best"}
_ALL = base.ALL_EXPERTS

# The paper's three candidates for an expert, on its eight tasks.
_MAZES = {short_name(env_id): {"env_id": env_id} for env_id in (base.LEFT, base.RIGHT)}
_ON_THE_MAZE: Changes = {"train_every": None, "random_hold": 10.0, **base.EXPERT}
_TD3 = {"td3": base.DAC["td3"]}
_SAC: dict[str, Changes] = {"sac-fixed": {"temperature": 0.2}, "sac-learned": {"temperature": None}}
_EXPERTS = crossed(_TASKS, _TD3 | _SAC) | crossed(
    crossed(_MAZES, {"": _ON_THE_MAZE}), _TD3 | crossed(_SAC, {"": {"target_entropy": -1.0}})
)

# The maze's ways to begin, and those without a guide in the published action order.
_ANT_TRANSFER = base.retraining_variants({"learning_starts": 1_000}, 100)
_ANT_TRANSFER |= {
    f"{name}-released-order": {**changes, "env_id": "offairl/DisabledAntReleased-v0"}
    for name, changes in _ANT_TRANSFER.items()
    if "guide_steps" not in changes
}

# What the end of an episode is worth to an imitator: each reward, with each way to go on.
_ABSORBING = crossed(
    {name: base.REWARDS[name] for name in ("dac", "implementation-4")},
    {way: {"absorbing": way} for way in ("none", "bootstrap", "analytic")},
)
_FEWER_STEPS: Changes = {"learning_starts": 1_000}
_SMALL_BATCHES: Changes = {"total_steps": 6_000, "train_every": 200, "batch_size": 64}
_EXPERTS_DEMO: Changes = {**_FEWER_STEPS, **_SMALL_BATCHES}
_ABSORBING_DEMO: Changes = {
    **{"total_steps": 12_000, "learning_starts": 2_000, "train_every": 250, "batch_size": 64},
    **{"temperature": None, "target_rate": 0.01},
}
_HALF_A_MILLION: Changes = {"total_steps": 500_000, "eval_every": 25_000, "eval_episodes": 10}
_LOCOMOTION_DEMO: Changes = {**base.SMALL_MCP, **_HALF_A_MILLION}

_ABOUT = """\
experts: TD3 and SAC, with α fixed and learned, on the true reward of the eight tasks: 24 runs
hopper-gail: GAIL with PPO on Hopper, where episodes end when it falls: its two rewards, and DAC's
hopper-dac: DAC with TD3 and with SAC on Hopper, with absorbing states
hopper-absorbing: DAC and off-policy AIRL on Hopper, with absorbing states and without: 6 runs
locomotion: Off-policy AIRL by the recipe, with SAC and SAC-MCP, and DAC with SAC and TD3: 25 runs
locomotion-first: The same before the recipe, α learned or 1, which fails: for comparison, 35 runs
what-decides: What makes off-policy AIRL work on robots: loss, temperature and warm-up, 96 runs
benchmark: The recipe, two DACs, SQIL and IQ-Learn, 25 runs by the best experts: give trajectories=
benchmark-warm: The recipe from a clone: give trajectories=, pretrained_policy= and only=, one robot
ant-transfer: On DisabledAnt, paid by CustomAnt's reward: what of the policy to keep, α learned
ant-rewards: Implementations 1 to 4 on CustomAnt, without log π's tail or the legs, too, and DAC
imitate: Off-policy AIRL by the recipe, on a task of your own: give env_id= and dataset=
"""
_cheetah = partial(_robot, {**_TASKS["HalfCheetah"], **_FEWER_STEPS})
_GAIL = {**_HOPPER, **base.ON_POLICY, **base.SIGNS["survival"]}
_DISABLED = {**_TASKS["DisabledAnt"], "reward": "frozen", "temperature": None}
_OTHERS = {"reward_from": "locomotion/CustomAnt-airl", "seeds": _FEW, "experts": _ALL}
_SIGHT = base.REWARDS | {"implementation-4-velocity": {**base.MIXTURE, **_VELOCITY}}
_OWN = {**_FEWER_STEPS, **_RELEASED}
_OWN_DEMO: Changes = {"train_every": 200, "eval_episodes": 10}
_FIRST_TASK = {**_TASKS["HalfCheetah"], "temperature": None}
_ON_TRUE = {**_TASKS["HalfCheetah"], "reward": "environment"}

EXPERIMENTS: Mapping[str, Experiment] = base.described(
    _ABOUT,
    {
        "experts": _robot(_ON_TRUE, demo=_EXPERTS_DEMO, variants=_EXPERTS, experts=_ALL),
        "hopper-gail": _robot(_GAIL, variants=base.SIGNS),
        "hopper-dac": _robot({**_ROBOTS["Hopper"], **_DAC}, variants=base.DAC),
        "hopper-absorbing": _robot({**_HOPPER, **_DAC}, demo=_ABSORBING_DEMO, variants=_ABSORBING),
        "locomotion": _cheetah(demo=_LOCOMOTION_DEMO, variants=crossed(_FIVE, _BY_THE_RECIPE)),
        "locomotion-first": _robot(_FIRST_TASK, demo=base.SMALL_MCP, variants=_FIRST),
        "what-decides": _robot(_HOPPER, demo={**_LONG, "eval_episodes": 5}, variants=_WHAT_DECIDES),
        "benchmark": _cheetah(demo=_LONG, variants=_BENCHMARK, experts=_BEST),
        "benchmark-warm": _cheetah(demo=_LONG, variants=_WARM, experts=_BEST),
        "ant-transfer": _robot(
            _DISABLED, demo={**base.SMALL_MCP, **_ANT_DEMO}, variants=_ANT_TRANSFER, **_OTHERS
        ),
        "ant-rewards": _robot(_TASKS["CustomAnt"], demo=_ANT_DEMO, variants=_SIGHT, seeds=_FEW),
        "imitate": _robot(_OWN, demo=_OWN_DEMO, experts=_ALL),
    },
)
