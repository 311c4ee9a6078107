"""What a run is given: demonstrations, and a reward and policies of other runs.

A run folder keeps a copy of what came from other runs, and `config.json` says which files it was
loaded from. What a run goes on with must be what it began with, which digests tell.
"""

import hashlib
import json
import logging
from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from torch import Tensor

from offairl_lite import demonstrations as data
from offairl_lite.config import Config, Labels
from offairl_lite.core.networks import load_weights
from offairl_lite.core.policies import Policy
from offairl_lite.core.replay import Batch
from offairl_lite.core.rewards import Reward
from offairl_lite.demonstrations import Demonstrations
from offairl_lite.runs.records import RunSpec, again, file_name, join, read, run_folders

log = logging.getLogger(__name__)

CURES = {
    "frozen_reward": "reward='frozen'",
    "pretrained_policy": "pretrained='policy'",
    "pretrained_reward": "reward='r-s'",
    "guide": "guide_steps=50",
}
"""What a run may be given of other runs, and the option that makes use of it."""
COPY = "demonstrations.safetensors"  #: Those of a run folder that could not be loaded again.


def needed(config: Config, files: Mapping[str, Any] = {}) -> dict[str, Any]:
    """Return what a configuration needs or may have of other runs: for each name its type."""
    uses = {
        "frozen_reward": config.reward == "frozen",
        "pretrained_policy": config.pretrained != "nothing",
        "guide": config.schedule.guide_steps > 0,
        "pretrained_reward": files.get("pretrained_reward"),
    }
    return {name: Reward if "reward" in name else Policy for name in uses if uses[name]}


def load(config: Config, seeds: Sequence[int], **files: Sequence[Path]) -> dict[str, Any]:
    """Return the rewards and policies of other runs that a configuration needs, by their names.

    Several `files`, or folders of runs, become one population; guides take turns if they are fewer
    than the seeds. ValueError: a file is needed and not given, or holds something else.
    """
    loaded = {}
    for name, kind in needed(config, files).items():
        if not files.get(name):
            raise ValueError(
                f"a {name.replace('_', ' ')} of another run is needed: give "
                f"{name}=RUN/{file_name(kind)}, or RUN"
            )
        loaded[name] = join([load_one(path, kind) for path in files[name]])
        if name == "guide":
            loaded[name] = _in_turn(loaded[name], range(len(seeds)))
    return loaded


def why_no_reward(config: Config) -> str | None:
    """Return why a run leaves no reward to use again, or None if it leaves one."""
    if config.reward == "environment":
        return "it was trained on the task's own"
    if isinstance(config.discriminator, Labels):
        return f"{config.reward} imitates without learning one"
    if getattr(config.discriminator, "kind", "") == "state-pairs":
        return "state-only DAC judges steps from state to state"
    return None


def load_one(path: Any, kind: Any, step: int | None = None) -> Any:
    """Return the policies, or rewards, of a file or of a run, at its end or at a `step`."""
    if isinstance(path, kind):
        return path
    path = Path(path)
    if not (path.is_dir() and any(path.rglob("config.json"))):
        if step is not None:
            raise ValueError(f"{path} is no run's folder, in which there are steps: leave out step")
        return kind.load(path / file_name(kind) if path.is_dir() else path)
    run = read(path, step)
    network = run.policy if kind is Policy else run.reward
    if network is None and kind is Reward and (why := why_no_reward(run.config)):
        raise ValueError(f"{path} has no reward to use again: {why}")
    if network is None:
        raise FileNotFoundError(
            f"{path} has no {file_name(kind)}, which is written at the end of a run: "
            f"{again(path, RunSpec.read(run_folders(path)[0]))} goes on to it (not every record "
            "keeps its own)" + "".join(f"; or take step={row.step}" for row in run.rows[-1:])
        )
    if run.diverged:
        failed = f"{path} has seeds that diverged, {run.diverged}"
        if len(run.diverged) == len(run.seeds):
            raise ValueError(f"{failed}: there is nothing to use")
        log.warning(f"{failed}; members are then worth nothing: choose others")
    return network


def _in_turn(network: Any, members: Iterable[int]) -> Any:
    return network.member(*(member % len(network) for member in members))


def inherited(
    things: Mapping[str, Any], files: Mapping[str, Sequence[Path]], members: Sequence[int] | None
) -> dict[str, dict[str, Any]]:
    """Return what `config.json` says of things from other runs: all of the files', or `members`."""
    part = {} if members is None else {"members": [*members]}
    return {
        # What was given as it is has no file.
        name: {
            "files": [str(f) for f in files.get(name, ()) if isinstance(f, str | PathLike)],
            **part,
            "digest": digest_of(network),
        }
        for name, network in things.items()
    }


def recorded(folder: Path, spec: RunSpec) -> dict[str, Any]:
    """Return what a run was given of other runs; ValueError if that is something else now.

    A record may lack the copies. They are then made again from the files that the run names.
    """
    loaded = {}
    for name, kind in needed(spec.config, spec.inherited).items():
        copy, source = folder / f"{name}.safetensors", spec.inherited.get(name, {})
        where = [copy] if copy.is_file() else source.get("files") or [copy]
        network = join([load_one(file, kind) for file in where])
        if where != [copy]:
            network = _in_turn(network, source.get("members") or range(len(spec.seeds)))
        if source and digest_of(network) != source["digest"]:
            raise ValueError(
                f"{' and '.join(map(str, where))} is not the {name.replace('_', ' ')} that "
                f"{folder} began with: put that back, or start a new run"
            )
        loaded[name] = network
    return loaded


def describe(demonstrations: Demonstrations | None) -> dict[str, Any] | None:
    """Return what `config.json` says of demonstrations: how many, from where, and their digest."""
    if demonstrations is None:
        return None
    source = {"trajectories": len(demonstrations), **(demonstrations.source or {})}
    return {**source, "digest": digest(demonstrations.transitions._asdict())}


def demonstrations_of(
    folder: Path, spec: RunSpec, demos: Demonstrations | None = None
) -> Demonstrations | None:
    """Return the demonstrations that a run began with, loaded if they are not given.

    ValueError: they have changed since, or there is nothing to load them from.
    """
    if (source := spec.demonstrations) is None:
        return None
    if demos is None and (copy := folder / COPY).is_file():
        tensors, _ = load_weights(copy, "demonstrations")
        lengths, returns = (tuple(tensors.pop(name).tolist()) for name in ("lengths", "returns"))
        demos = Demonstrations(spec.config.env_id, Batch(**tensors), lengths, returns)
    elif demos is None:
        if "dataset" not in source:
            raise ValueError(
                f"{folder} began with demonstrations that `demonstrations.load` did not make: give "
                "the same to `folders.work` again"
            )
        # Older runs do not say how they were thinned, nor of how many experts they are.
        rest = source["dataset"], source.get("subsample", 1), source.get("experts")
        demos = data.load(spec.config.env_id, source["trajectories"], *rest)
    if digest(demos.transitions._asdict()) != source["digest"]:
        whose = source.get("dataset", "elsewhere") or "the shipped experts"
        raise ValueError(
            f"{len(demos)} trajectories from {whose} are not those that {folder} began with: bring "
            "them back, or start a new run"
        )
    return demos


def digest(tensors: Mapping[str, Tensor], about: dict[str, Any] | None = None) -> str:
    """Return the SHA-256 of names, shapes and bytes, and of what is said about them."""
    sha = hashlib.sha256(json.dumps(about).encode())
    for name, tensor in sorted(tensors.items()):
        array = tensor.detach().cpu().contiguous().numpy()
        sha.update(f"{name} {array.dtype} {array.shape}".encode())
        sha.update(array.data)
    return sha.hexdigest()


def digest_of(thing: Policy | Reward) -> str:
    """Return the SHA-256 of parameters and normaliser."""
    return digest({"params": thing.params, **thing.normaliser._asdict()})
