"""What the experiments on mazes and on robots have in common."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from offairl_lite.config import Config
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

SEEDS: Mapping[Scale, tuple[int, ...]] = {"demo": tuple(range(5)), "full": tuple(range(10))}

SMALL_MCP = {"trunk_hidden": (64,), "primitive_hidden": (64,), "gate_hidden": (64, 64)}

# PPO, for the on-policy methods. Its policy is wide at first and remains so: the noise of its
# actions is all that leads it out of the trap.
ON_POLICY = {
    "learner": "ppo",
    "temperature": 1e-3,
    "log_std_range": (-2.0, 2.0),
    "update_every": 2_000,
    "replay_size": 2_000,
    "warmup_steps": 2_000,
    "discriminator_updates": 100,
    "batch_size": 250,
}

SIGNS = {
    "survival": {"reward": "gail-survival"},
    "termination": {"reward": "gail-termination"},
    "log-odds": {"reward": "dac"},
}

DAC = {"td3": {"learner": "td3"}, "sac": {"learner": "sac"}}

# A logit whose log π has no tail, see `DiscriminatorConfig.loss`.
MIXTURE = {"loss": "mixture"}

# Paid by minus a distance of at most 0.6, SAC would park against the wall behind the goal, 0.045
# too far: the entropy is worth more. Magnified, the distance is.
EXPERT = {"reward": "environment", "reward_scale": 100.0}


def retraining_variants(alone: dict, start_steps: int) -> dict[str, dict[str, Any]]:
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


# The paper's four rewards, and DAC's; the four once more, with log π without its tail. The first
# two contain -log π, and SAC adds α of it: to count it once, either SAC has as good as no
# temperature (cold), or it has all of it (soft). Or SAC has what it learns to need, and the reward
# nothing (learned).
REWARDS = {
    **{f"implementation-{n}": {"reward": f"implementation-{n}"} for n in (1, 2, 3, 4)},
    "dac": {"reward": "dac"},
}

WITHOUT_TAIL = {
    f"{name}-mixture": {**changes, **MIXTURE} for name, changes in REWARDS.items() if name != "dac"
}
