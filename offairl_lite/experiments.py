"""The experiments, as data: each name means one configuration at demo and one at full scale."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from offairl_lite.config import CORRECTED, Config
from offairl_lite.scale import Scale


@dataclass(frozen=True)
class Experiment:
    """What is run under a name.

    Args:
        about: one line for a reader.
        configs: the configuration at each scale.
        seeds: the members at each scale.
        reward_from: the experiment whose learned reward is used, frozen; None for no such.
    """

    about: str
    configs: Mapping[Scale, Config]
    seeds: Mapping[Scale, tuple[int, ...]]
    reward_from: str | None = None


LEFT, RIGHT = "offairl/PointMazeLeft-v0", "offairl/PointMazeRight-v0"
SEEDS: Mapping[Scale, tuple[int, ...]] = {"demo": tuple(range(5)), "full": tuple(range(10))}

# What the maze needs and the paper does not state. Warm-up actions are held for ten steps on
# average: a particle that draws a fresh push every step hardly ever gets round the barrier. The
# temperature is learned, for a policy twice as wide as usual, which falls back into the trap under
# the barrier less often.
MAZE_FULL = replace(CORRECTED, env_id=LEFT, temperature=None, target_entropy=-1.0, warmup_hold=10.0)

# Small networks and batches and faster targets: a minute or two for five seeds on a laptop.
MAZE_DEMO = replace(
    MAZE_FULL,
    total_steps=6_000,
    warmup_steps=3_000,
    batch_size=64,
    hidden=(64, 64),
    reward_hidden=(64, 64),
    shaping_hidden=(64, 64),
    target_rate=0.01,
    eval_every=1_000,
)


def _both(demo: dict, full: dict, **common) -> Mapping[Scale, Config]:
    return {
        "demo": replace(MAZE_DEMO, **common, **demo),
        "full": replace(MAZE_FULL, **common, **full),
    }


# Paid by minus a distance of at most 0.6, SAC would park against the wall behind the goal, 0.045
# too far: the entropy is worth more. Magnified, the distance is.
_EXPERT = {"reward": "environment", "reward_scale": 100.0}

EXPERIMENTS: Mapping[str, Experiment] = {
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
    "maze-transfer": Experiment(
        "SAC from scratch on PointMazeRight, paid by the reward that was learned on PointMazeLeft",
        _both({"total_steps": 8_000}, {}, env_id=RIGHT, reward="frozen"),
        SEEDS,
        reward_from="maze-imitation",
    ),
    "imitate": Experiment(
        "Off-policy AIRL on a task of your own: give --env-id and --dataset",
        {
            "demo": replace(
                CORRECTED,
                total_steps=20_000,
                warmup_steps=1_000,
                update_every=200,
                hidden=(64, 64),
                reward_hidden=(64, 64),
                shaping_hidden=(64, 64),
                temperature=None,
                eval_every=2_000,
            ),
            "full": replace(CORRECTED, update_every=1_000, temperature=None),
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
