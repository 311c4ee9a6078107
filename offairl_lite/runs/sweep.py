"""Many runs: the points of a grid, each in a run folder of its own, executed side by side."""

import csv
import itertools
import json
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, get_args, get_origin

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction

from offairl_lite import demonstrations
from offairl_lite.config import Config, differences
from offairl_lite.core.acceleration import Execution, fitting, is_large
from offairl_lite.experiments import EXPERIMENTS, Experiment, find
from offairl_lite.runs import folders as runs
from offairl_lite.runs import jobs
from offairl_lite.runs.records import Plan
from offairl_lite.scale import Scale


@dataclass(frozen=True)
class Given:
    """What new runs are given beside their configuration: options that `run` and `sweep` share."""

    dataset: str | None = None
    """A Minari data set to imitate; by default the shipped experts'."""

    trajectories: int = 50
    """How many of its episodes to use."""

    subsample: int = 1
    """Of each, only every so many-th transition."""

    experts: int | None = None
    """Of how many of the shipped experts they are, from the first on. None: of all."""

    frozen: tuple[Path, ...] = ()
    """An earlier run, or its reward.safetensors, where the reward is frozen; of several, one
    population after the other."""

    carried: tuple[Path, ...] = ()
    """An earlier run, or its policy.safetensors, where `carry` is not nothing."""

    guide: tuple[Path, ...] = ()
    """Policies that act at the start of episodes, where there are `start_steps`."""

    device: Literal["cpu", "cuda"] = "cpu"
    """Where networks live."""

    threads: int = 1
    """Of PyTorch and of the physics, in each process; small networks are fastest with one."""

    compile: Literal["auto", "yes", "no"] = "auto"
    """Whether updates are compiled; auto: long runs of large networks."""

    @property
    def files(self) -> dict[str, tuple[Path, ...]]:
        """Of other runs, by the names that `runs.inherit` has for them."""
        return {"frozen": self.frozen, "carried": self.carried, "guide": self.guide}

    def require_use(self, configs: Sequence[Config], experts: int | None) -> None:
        """Refuse what no configuration makes use of.

        Args:
            configs: of the new runs.
            experts: what `experts` is by default.

        Raises:
            ValueError: something would not be used.
        """
        runs.require_use(configs, **self.files)
        why = None
        if not any(config.learns_reward for config in configs):
            names, why = ("dataset", "trajectories", "subsample"), "no reward is learned"
        elif self.dataset is not None:
            names, why = (), f"{self.dataset} is by none of the shipped ones"
        if why is None:
            return
        wanted = {name: getattr(Given, name) for name in names} | {"experts": experts}
        for name, default in wanted.items():
            if (value := getattr(self, name)) != default:
                raise ValueError(f"--{name} {value} would not be used, since {why}: leave it out")

    def demonstrations(self, env_id: str) -> demonstrations.Demonstrations:
        """Return those of a task; raises what `demonstrations.load` does."""
        return demonstrations.load(
            env_id, self.trajectories, self.dataset, self.subsample, self.experts
        )

    def execution(self, config: Config) -> Execution:
        """Return how a run is executed; raises what `execution.fitting` does."""
        return fitting(config, self.device, self.threads, self.compile)


def grid(config: Config, **values: Iterable[Any]) -> dict[str, Config]:
    """Return the configurations of a grid, by names such as `reward=dac,temperature=0.1`.

    Args:
        config: what all have in common.
        values: for each field to vary, its values, or texts of them: `none`, `true`, `false`;
            the numbers of a tuple are separated by `x`, as in `hidden=400x300`.

    Raises:
        ValueError: no such field, a value it cannot have, or one that is given twice.
    """
    kinds = {field.name: field.type for field in fields(Config)}
    for name in values.keys() - kinds.keys():
        raise ValueError(f"no field {name!r} to vary; there are: {', '.join(kinds)}")
    axes = [[(name, _parse(name, v, kinds[name])) for v in vs] for name, vs in values.items()]
    points: dict[str, Config] = {}
    for point in itertools.product(*axes):
        name = ",".join(f"{field}={_text(value)}" for field, value in point).replace("/", "-")
        if name in points:
            raise ValueError(f"{name} is in the grid twice: give every value once")
        try:
            points[name] = replace(config, **dict(point))
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from error
    if not points or not values:
        raise ValueError("the grid is empty: give a field and at least one value")
    return points


def _text(value: Any) -> str:
    if isinstance(value, tuple | list):
        return "x".join(map(_text, value))
    return str(value).lower() if value is None or isinstance(value, bool) else str(value)


def _parse(name: str, value: Any, kind: Any) -> Any:
    """Return a value, or its text, as what its field holds."""
    text = _text(value)
    try:
        if get_origin(kind) is UnionType:  # of something and None
            return None if text == "none" else _parse(name, value, get_args(kind)[0])
        if get_origin(kind) is tuple:
            one, *more = get_args(kind)
            parts = tuple(_parse(name, part, one) for part in text.split("x"))
            if more != [...] and len(parts) != 1 + len(more):
                raise ValueError
            return parts
        if kind is bool:
            return {"true": True, "false": False}[text.lower()]
        return kind(text) if kind in (int, float) else text  # Config knows the choices
    except (KeyError, ValueError):
        kind = kind.__name__ if isinstance(kind, type) else kind
        raise ValueError(f"{name} is {text!r}; expected {kind}") from None


def require_defaults(experiment: str, scale: Scale, name: str, size: Scale) -> None:
    """Refuse a command line whose defaults are not those of its experiment and scale.

    Args:
        experiment: that the command line asks for.
        scale: that it asks for.
        name: of the experiment that the defaults were taken from.
        size: the scale that they were taken from.

    Raises:
        ValueError: they are of another experiment or scale.
    """
    if (experiment, scale) != (name, size):
        raise ValueError(
            f"{experiment} at {scale} scale was asked for, and the defaults are those of {name} at "
            f"{size} scale: name the experiment before all options"
        )


def subcommand(
    name: str, size: Scale, create: Callable[..., str], command: jobs.Command = jobs.resume
):
    """Return `offairl sweep`, with the defaults of one experiment at one scale.

    Args:
        name: of the experiment.
        size: the scale.
        create: makes a run folder and returns the disk that it needs: `runs.create`.
        command: what a job runs.
    """
    experiment, defaults = find(name), (name, size)

    def sweep(
        experiment: Positional[Literal[tuple(EXPERIMENTS)]] = name,
        *,
        scale: Scale = size,
        grid: Annotated[tuple[str, ...], UseAppendAction] = (),
        only: tuple[str, ...] = (),
        seeds: tuple[int, ...] = experiment.seeds[size],
        out: Path | None = None,
        prepare: bool = False,
        processes: int | None = None,
        engine: jobs.Engine = "processes",
        address: str | None = None,
        given: Annotated[Given, OmitArgPrefixes] = Given(experts=experiment.experts[size]),
        config: Annotated[Config, OmitArgPrefixes] = experiment.configs[size],
    ) -> None:
        """Run an experiment in many configurations, each in a folder of its own; or go on with it.

        Args:
            experiment: its name; the defaults below are this experiment's at this scale.
            scale: demo takes minutes, full is the paper's protocol.
            grid: a field and its values, as in temperature=0.1,0.2 or hidden=64x64,400x300. All
                combinations are run.
            only: of an experiment that is several runs, the names of some.
            seeds: of each run.
            out: where the run folders are; by default runs/EXPERIMENT-SCALE, with a grid
                runs/sweep-EXPERIMENT-SCALE.
            prepare: make the run folders, and leave the work in them to others.
            processes: at most so many at a time; by default one on each core. They do a run each;
                if there are fewer runs than that, those of large networks are shared.
            engine: processes on this machine, or on a Ray cluster.
            address: of the Ray cluster, auto on one of its nodes; by default a local one.
            given: what they are given beside their configuration.
            config: what all runs have in common.
        """
        require_defaults(experiment, scale, *defaults)
        points = _points(find(experiment), scale, config, grid, only)
        kind = "sweep-" if grid else ""
        folder = out or Path("runs") / f"{kind}{experiment}-{scale}"
        data, files = {}, given.files
        about = {
            "seeds": seeds,
            "dataset": given.dataset,
            "trajectories": given.trajectories,
            "subsample": given.subsample,
            "experts": None if given.dataset else given.experts,
            **{name: [*map(str, paths)] for name, paths in files.items()},
        }
        fresh = {
            name: point for name, point in points.items() if not _there(folder / name, point, about)
        }
        given.require_use([*points.values()], find(experiment).experts[scale])
        inherited = {name: runs.inherit(point, seeds, **files) for name, point in fresh.items()}
        for point in fresh.values():
            if point.learns_reward and point.env_id not in data:
                data[point.env_id] = given.demonstrations(point.env_id)
        # Cores that runs leave idle share the members of large networks.
        here = engine == "processes" and given.device == "cpu" and not prepare
        each = max((processes or jobs.cores()) // len(points), 1) if here else 1
        for name, point in fresh.items():
            needed = create(
                folder / name,
                point,
                seeds,
                execution=given.execution(point),
                demonstrations=data[point.env_id] if point.learns_reward else None,
                **inherited[name],
                sources=files,
                experiment=experiment,
                scale=scale,
                shards=each if is_large(point) else 1,
            )
            print(f"{folder / name} takes up to {needed} of disk")
        if prepare:
            return
        todo = [job for name in points for job in jobs.of(folder / name)]
        try:
            failures = jobs.execute(
                todo,
                engine,
                processes,
                address=address,
                gpus=float(given.device != "cpu"),
                command=command,
            )
        except KeyboardInterrupt:
            print("\nstopped; the same command goes on from the checkpoints", file=sys.stderr)
            sys.exit(130)
        print(_table(folder, points))
        lost = [name for name in points if "every member" in _about(folder / name)["state"]]
        if lost:
            raise FloatingPointError(
                f"every member of {', '.join(lost)} has diverged, as run.json says; they are not "
                "tried again"
            )
        if failures:
            print(*failures, sep="\n\n", file=sys.stderr)
            raise ChildProcessError(
                f"{len(failures)} of {len(todo)} jobs failed, twice: see above; the same command "
                "goes on with them"
            )

    return sweep


def _points(
    experiment: Experiment, scale: Scale, config: Config, axes: Sequence[str], only: Sequence[str]
) -> dict[str, Config]:
    """Return the configurations of an experiment's own runs, or some of them, times a grid.

    Raises:
        ValueError: there is no such run, the grid is no grid, or a run sets itself what `config`
            has otherwise than the experiment.
    """
    variants = experiment.variants or {"": {}}
    if unknown := set(only) - set(variants):
        raise ValueError(f"no runs {sorted(unknown)}; there are: {', '.join(variants)}")
    values: dict[str, list[str]] = {}
    for axis in axes:
        name, given, texts = axis.partition("=")
        name = name.replace("-", "_")
        if not given or name in values:
            raise ValueError(f"--grid {axis}: expected FIELD=VALUE,VALUE, and each field once")
        values[name] = texts.split(",")
    points = {}
    for variant, changes in variants.items():
        if only and variant not in only:
            continue
        if lost := changes.keys() & differences(experiment.configs[scale], config):
            raise ValueError(
                f"{variant} sets {' and '.join(sorted(lost))} itself: vary that with --grid, which "
                "comes last, or choose other runs with --only"
            )
        own = replace(config, **changes)
        some = grid(own, **values) if values or not variant else {"": own}
        points |= {",".join(filter(None, (variant, name))): p for name, p in some.items()}
    return points


def _there(folder: Path, config: Config, given: dict[str, Any]) -> bool:
    """Return whether there is a run already, which must be one of the same kind.

    Args:
        folder: of the run.
        config: that it must have.
        given: what decides a run beside its configuration: seeds, demonstrations, files.

    Raises:
        ValueError: it is of another configuration, or something else was given to it.
    """
    if not (folder / "config.json").exists():
        return False
    plan = Plan.read(folder)
    files = {name: about["files"] for name, about in plan.inherited.items() if about["files"]}
    there = {"seeds": plan.seeds, **(plan.demonstrations or {}), **files}
    found = {name: (there[name], now) for name, now in given.items() if name in there}
    found |= differences(plan.config, config)
    found = [f"{name} {was!r}, not {now!r}" for name, (was, now) in found.items() if was != now]
    if found:
        raise ValueError(
            f"{folder} is a run with {', '.join(found)}: give the same, or choose another --out"
        )
    return True


def _table(folder: Path, points: Iterable[str]) -> str:
    """Return the last evaluation of each run: mean, least and greatest return over seeds."""
    lines = [f"{'step':>9} {'return':>10} {'least':>10} {'greatest':>10}  {folder}"]
    for name in points:
        with open(folder / name / "curve.csv", newline="") as file:
            last = {row["seed"]: row for row in csv.DictReader(file)}.values()
        step = min((int(row["step"]) for row in last), default=0)
        returns = [float(row["mean_return"]) for row in last]
        numbers = (sum(returns) / len(returns), min(returns), max(returns)) if returns else ()
        shown = " ".join(f"{x:10.2f}" for x in numbers) or " ".join([f"{'-':>10}"] * 3)
        shards = _about(folder / name).get("shards", {})
        lost = [seed for shard in shards.values() for seed in shard["diverged"]]
        note = f" (diverged: {' '.join(lost)})" if lost else ""
        lines.append(f"{step:9,} {shown}  {name}{note}")
    return "\n".join(lines)


def _about(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "run.json").read_text())
