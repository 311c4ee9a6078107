"""What the experiments on mazes and on robots have in common."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any, Literal

from offairl_lite.config import Config
from offairl_lite.scale import Scale

Changes = Mapping[str, Any]  #: Settings of a configuration, by their flat names.
NOTHING: Changes = {}

Seeds = Mapping[Scale, tuple[int, ...]]
Experts = Mapping[Scale, int | Literal["best"] | None]

SEEDS: Seeds = {"demo": tuple(range(5)), "full": tuple(range(10))}
ALL_EXPERTS: Experts = {"demo": None, "full": None}


@dataclass(frozen=True)
class Experiment:
    """What is run under a name: configurations and seeds at each scale.

    `variants` are its runs, where it is several, and what each changes. `reward_from` is the run
    whose reward is used, frozen; `experts` says how many show the task, None all, `best` the
    strongest.
    """

    configs: Mapping[Scale, Config]
    variants: Mapping[str, Changes] = field(default_factory=dict)
    reward_from: str | None = None
    seeds: Seeds = field(default_factory=lambda: SEEDS)
    experts: Experts = field(default_factory=lambda: ALL_EXPERTS)
    about: str = ""


def experiment(
    base: Mapping[Scale, Config],
    changes: Changes = NOTHING,
    *,
    demo: Changes = NOTHING,
    **others: Any,
) -> Experiment:
    """Return an experiment that changes this at both scales, and some more at demo scale."""
    full, small = (base[scale].change(**changes) for scale in ("full", "demo"))
    return Experiment({"demo": small.change(**demo), "full": full}, **others)


def described(texts: str, experiments: Mapping[str, Experiment]) -> dict[str, Experiment]:
    """Return experiments with what each is about, of lines with their names."""
    about = dict(line.split(": ", 1) for line in texts.splitlines())
    return {name: replace(one, about=about.pop(name)) for name, one in experiments.items()}


def crossed(*axes: Mapping[str, Changes]) -> dict[str, Changes]:
    """Return each combination of one entry of every axis: the names joined, the changes merged."""
    return {
        "-".join(name for name, _ in chosen if name): dict(i for _, c in chosen for i in c.items())
        for chosen in product(*(axis.items() for axis in axes))
    }


LEFT, RIGHT = "offairl/PointMazeLeft-v0", "offairl/PointMazeRight-v0"

SMALL: Changes = dict.fromkeys(("hidden", "reward_hidden", "shaping_hidden"), (64, 64))
SMALL_MCP = {"trunk_hidden": (64,), "primitive_hidden": (64,), "gate_hidden": (64, 64)}

# PPO, for the on-policy methods. Its policy is wide at first and remains so: the noise of its
# actions is all that leads it out of the trap.
ON_POLICY: Changes = {
    **{"learner": "ppo", "temperature": 1e-3, "log_std_range": (-2.0, 2.0), "batch_size": 250},
    **dict.fromkeys(("train_every", "replay_size", "learning_starts"), 2_000),
    "discriminator_updates": 100,
}

SIGNS = {
    "survival": {"reward": "gail-survival"},
    "termination": {"reward": "gail-termination"},
    "log-odds": {"reward": "dac"},
}

DAC = {"td3": {"learner": "td3"}, "sac": {"learner": "sac"}}

# Paid by minus a distance of at most 0.6, SAC would park against the wall behind the goal, 0.045
# too far: the entropy is worth more. Magnified, the distance is.
EXPERT: Changes = {"reward": "environment", "reward_scale": 100.0}

# The paper's four rewards; the four once more, with a log π that has no tail
# (`DiscriminatorConfig.loss`), and DAC's.
MIXTURE = {"loss": "airl-mixture"}
_FOUR = {
    f"implementation-{n}": {"reward": reward}
    for n, reward in enumerate(("logit-sa", "logit-s", "r-sa", "r-s"), 1)
}
REWARDS = {**_FOUR, "dac": {"reward": "dac"}, **crossed(_FOUR, {"mixture": MIXTURE})}


def retraining_variants(alone: Changes, guide_steps: int) -> dict[str, Changes]:
    """Return what may be kept of the policy, each with and without a guide's `guide_steps`.

    What begins with a policy has one episode of random actions, and no other help to explore:
    `alone` says so.
    """
    kept: dict[str, Changes] = {"scratch": {}, "policy": {"pretrained": "policy", **alone}}
    for k in (4, 8):
        actor = {"primitives": k, "pretrained": "primitives", **alone}
        kept |= {f"{k}-gate": {**actor, "fixed_primitives": True}, f"{k}-both": actor}
    guided = {"guide_steps": guide_steps}
    return crossed(kept, {"": {}, "own-starts": guided, "expert-starts": guided})
