"""Run folders for tests, made without the command line."""

from dataclasses import asdict
from pathlib import Path

from offairl_lite.core.acceleration import Execution
from offairl_lite.runs import folders, inputs
from offairl_lite.runs.records import RunSpec


def create(folder, config, seeds, demonstrations=None, sources=(), checkpoint_every=2_000, **given):
    """Make a run folder of a configuration, seeds, and what the run is given."""
    shown, inherited = inputs.describe(demonstrations), inputs.inherited(given, dict(sources), None)
    execution = asdict(Execution())
    spec = RunSpec(config, seeds, execution, shown, checkpoint_every, inherited=inherited)
    folders.create(Path(folder), spec, given)
