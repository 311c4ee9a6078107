"""What a run is given: demonstrations, and a reward and policies of other runs.

A run folder keeps a copy of what came from other runs, and `config.json` says which files it was
loaded from. What a run goes on with must be what it began with, which digests tell.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from torch import Tensor

from offairl_lite import demonstrations as data
from offairl_lite.config import Config
from offairl_lite.core.policies import Policy
from offairl_lite.core.rewards import Reward
from offairl_lite.demonstrations import Demonstrations
from offairl_lite.runs import records
from offairl_lite.runs.records import RunSpec

Weights = Reward | Policy

CURES = {
    "frozen_reward": "--reward frozen",
    "pretrained_policy": "--pretrained policy",
    "guide": "--start-steps 50",
}
"""What a run may be given of other runs, and the option that makes use of it."""


def needed(config: Config) -> dict[str, type[Weights]]:
    """Return what a configuration needs of other runs, and of which kind it is."""
    uses = {
        "frozen_reward": (config.reward == "frozen", Reward),
        "pretrained_policy": (config.pretrained != "nothing", Policy),
        "guide": (config.schedule.start_steps > 0, Policy),
    }
    return {name: kind for name, (is_needed, kind) in uses.items() if is_needed}


def load(config: Config, seeds: Sequence[int], **files: Sequence[Path]) -> dict[str, Weights]:
    """Load what a configuration needs of other runs, for `folders.create`.

    The members of several files become one population, in the order of the files.

    Args:
        config: the configuration of the new run.
        seeds: its seeds. Where guides are fewer, they take turns.
        **files: for `frozen_reward` files of rewards, for `pretrained_policy` and `guide` files of
            policies; or folders of runs, which stand for the files in them.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: a file is needed and not given, or holds something else, or another number of
            members than there are seeds.
    """
    found: dict[str, Weights] = {}
    for name, kind in needed(config).items():
        if not files.get(name):
            own = f"{kind.__name__.lower()}.safetensors"
            raise ValueError(
                f"a {name.replace('_', ' ')} of another run is needed: give "
                f"--{name.replace('_', '-')} RUN/{own}, or RUN"
            )
        found[name] = records.join([load_one(path, kind) for path in files[name]])
    if "guide" in found:
        found["guide"] = _in_turn(found["guide"], range(len(seeds)))
    for name, thing in found.items():
        if len(thing) != len(seeds):
            raise ValueError(
                f"the {name.replace('_', ' ')} has {len(thing)} members for {len(seeds)} seeds: "
                f"give as many seeds, for instance --seeds {' '.join(map(str, range(len(thing))))}"
            )
    return found


def load_one(path: Path, kind: type[Weights]) -> Weights:
    """Return the policies, or the rewards, of a file or of a run.

    Raises:
        FileNotFoundError: there is no such file, or the run has not ended.
        ValueError: the file holds something else.
    """
    own = f"{kind.__name__.lower()}.safetensors"
    if not path.is_dir():
        return kind.load(path)
    if not any(path.rglob("config.json")):
        if not (path / own).is_file():
            raise FileNotFoundError(f"{path} is not a run's folder: it has no config.json")
        return kind.load(path / own)
    run = records.read(path)
    found = run.policy if kind is Policy else run.reward
    if found is None:
        raise FileNotFoundError(
            f"{path} has no {own}, which is written at the end of a run: `offairl resume {path}` "
            "goes on to it (not every record keeps its own)"
        )
    return found


def _in_turn(guides: Policy, members: Iterable[int]) -> Policy:
    return guides.member(*(member % len(guides) for member in members))


def require_use(configs: Iterable[Config], **files: Sequence[Path]) -> None:
    """Refuse files of other runs that no configuration makes use of.

    Args:
        configs: the configurations of new runs.
        **files: as for `load`.

    Raises:
        ValueError: there are such files.
    """
    used = {name for config in configs for name in needed(config)}
    for name, given in files.items():
        if given and name not in used:
            raise ValueError(
                f"--{name.replace('_', '-')} {' '.join(map(str, given))} would not be used: add "
                f"{CURES[name]}, or leave it out"
            )


def recorded(folder: Path, spec: RunSpec) -> dict[str, Weights]:
    """Return what a run was given of other runs.

    A record may lack the copies. They are then made again from the files that the run names.

    Raises:
        FileNotFoundError: it is in neither place.
        ValueError: it is not what the run began with.
    """
    found = {}
    for name, kind in needed(spec.config).items():
        copy, about = folder / f"{name}.safetensors", spec.inherited.get(name, {})
        if about.get("files") and not copy.is_file():
            where, members = about["files"], about.get("members")
            thing = records.join([load_one(Path(file), kind) for file in where])
            if name == "guide":
                thing = _in_turn(thing, members or range(len(spec.seeds)))
            elif members:
                thing = thing.member(*members)
        else:
            where, thing = [copy], kind.load(copy)
        if about and digest_of(thing) != about["digest"]:
            raise ValueError(
                f"{' and '.join(map(str, where))} is not the {name.replace('_', ' ')} that "
                f"{folder} began with: put that back, or start a new run"
            )
        found[name] = thing
    return found


def describe(demonstrations: Demonstrations | None) -> dict[str, Any] | None:
    """Return what `config.json` says of demonstrations."""
    if demonstrations is None:
        return None
    return {
        "trajectories": len(demonstrations),
        **(demonstrations.source or {}),
        "digest": digest(demonstrations.transitions._asdict()),
    }


def demonstrations_of(
    folder: Path, spec: RunSpec, given: Demonstrations | None = None
) -> Demonstrations | None:
    """Return the demonstrations that a run began with, loaded if they are not given.

    Raises:
        ValueError: they have changed since, or there is nothing to load them from.
    """
    shown = spec.demonstrations
    if shown is None:
        return None
    whose = "from elsewhere"
    if "dataset" in shown:
        whose = f"of {shown['dataset'] or 'the shipped experts'}"
    elif given is None:
        raise ValueError(
            f"{folder} began with demonstrations that `demonstrations.load` did not make: give the "
            "same to `worker.work` again"
        )
    if given is None:
        given = data.load(
            spec.config.env_id,
            shown["trajectories"],
            shown["dataset"],
            shown.get("subsample", 1),  # Older runs do not say,
            shown.get("experts"),  # nor this.
        )
    if digest(given.transitions._asdict()) != shown["digest"]:
        raise ValueError(
            f"{len(given)} trajectories {whose} are not those that {folder} began with: bring them "
            "back, or start a new run"
        )
    return given


def digest(tensors: Mapping[str, Tensor], about: dict[str, Any] | None = None) -> str:
    """Return the SHA-256 of names, shapes and bytes, and of what is said about them."""
    sha = hashlib.sha256(json.dumps(about).encode())
    for name, tensor in sorted(tensors.items()):
        array = tensor.detach().cpu().contiguous().numpy()
        sha.update(f"{name} {array.dtype} {array.shape}".encode())
        sha.update(array)
    return sha.hexdigest()


def digest_of(thing: Weights) -> str:
    """Return the SHA-256 of parameters and normaliser."""
    return digest({"params": thing.params, **thing.normaliser._asdict()})
