"""The experiments, as data: each name means one configuration at demo and one at full scale."""

from collections.abc import Mapping

from offairl_lite.config import Config
from offairl_lite.experiments import mazes, robots
from offairl_lite.experiments.base import SEEDS, Experiment
from offairl_lite.scale import Scale

__all__ = ["EXPERIMENTS", "SEEDS", "Experiment", "configure", "find"]

EXPERIMENTS: Mapping[str, Experiment] = {**robots.EXPERIMENTS, **mazes.EXPERIMENTS}


def find(name: str) -> Experiment:
    """Return an experiment by name; ValueError lists those there are."""
    if name not in EXPERIMENTS:
        raise ValueError(f"no experiment {name!r}; there are: {', '.join(EXPERIMENTS)}")
    return EXPERIMENTS[name]


def configure(run: str, scale: Scale) -> Config:
    """Return the configuration of a run, `EXPERIMENT/VARIANT`; ValueError lists those there are."""
    name, _, variant = run.partition("/")
    experiment = find(name)
    variants = experiment.variants or {"": {}}
    if variant not in variants:
        names = ", ".join(f"{name}/{v}" if v else name for v in variants)
        raise ValueError(f"no run {run!r}; there are: {names}")
    return experiment.configs[scale].change(**variants[variant])
