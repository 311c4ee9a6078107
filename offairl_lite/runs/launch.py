"""The commands `offairl run` and `offairl resume`: run folders made, and trained to their ends.

A run is a grid of one point. Every point has a run folder, or several where its seeds are spread
over processes.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction

from offairl_lite import demonstrations
from offairl_lite.config import Config, differences
from offairl_lite.core.acceleration import fitting, is_large
from offairl_lite.core.loop import Run
from offairl_lite.demonstrations import Demonstrations
from offairl_lite.experiments import EXPERIMENTS, Experiment, find
from offairl_lite.runs import checkpoints, folders, inputs, jobs, records, worker
from offairl_lite.runs.grid import axes, grid, options, options_named, point, require_use
from offairl_lite.runs.records import RunSpec, run_folders, seeds_name
from offairl_lite.scale import Scale


@dataclass(frozen=True)
class Given:
    """What new runs are given beside their configuration."""

    dataset: str | None = None
    """A Minari data set to imitate; by default the shipped experts'."""

    trajectories: int = 50
    """How many of its episodes to use."""

    subsample: int = 1
    """Use every so many-th transition of each."""

    experts: int | None = None
    """How many of the shipped experts show the task, from the first on. None: all."""

    frozen_reward: tuple[Path, ...] = ()
    """An earlier run, or its reward.safetensors, where the reward is frozen. Several become one
    population."""

    pretrained_policy: tuple[Path, ...] = ()
    """An earlier run, or its policy.safetensors, where `pretrained` is not nothing."""

    guide: tuple[Path, ...] = ()
    """Policies that act at the start of episodes, where there are `start_steps`."""

    device: Literal["cpu", "cuda"] = "cpu"
    """Where networks live."""

    threads: int = 1
    """Threads of PyTorch and of the physics in each process. Small networks need one."""

    compile: Literal["auto", "yes", "no"] = "auto"
    """Whether updates are compiled; auto: long runs of large networks."""

    @property
    def files(self) -> dict[str, tuple[Path, ...]]:
        """Return the files of other runs, by the names that `inputs.load` has for them."""
        return {name: getattr(self, name) for name in inputs.CURES}

    def require_use(self, configs: Sequence[Config], experts: int | None) -> None:
        """Refuse what no configuration makes use of.

        Args:
            configs: the configurations of the new runs.
            experts: the default of `experts`.

        Raises:
            ValueError: something would not be used.
        """
        inputs.require_use(configs, **self.files)
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

    def recorded(self) -> dict[str, Any]:
        """Return what a run folder must say of demonstrations and of files of other runs."""
        experts = None if self.dataset else self.experts
        files = {name: [*map(str, paths)] for name, paths in self.files.items()}
        about = {name: getattr(self, name) for name in ("dataset", "trajectories", "subsample")}
        return {**about, "experts": experts, **files}


def run_command(name: str, size: Scale, command: jobs.Command = jobs.resume) -> Any:
    """Return `offairl run`, with the defaults of one experiment at one scale.

    Args:
        name: the experiment's name.
        size: the scale.
        command: what a job runs.
    """
    experiment, defaults = find(name), (name, size)
    settings = options(experiment.configs[size])

    def run(
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
        schedule: settings["schedule"] = {},  # noqa: B006
        learner: settings["learner"] = {},  # noqa: B006
        discriminator: settings["discriminator"] = {},  # noqa: B006
    ) -> None:
        """Run an experiment, in one configuration or in many, and record it; or go on with it.

        Each run has a folder of its own. The same command again goes on with what is there.

        Args:
            experiment: its name; the defaults below are this experiment's at this scale.
            scale: demo takes minutes, full is the paper's protocol.
            grid: a setting and its values, as in temperature=0.1,0.2 or hidden=64x64,400x300. All
                combinations are run.
            only: of an experiment that is several runs, the names of some.
            seeds: of each run, one member of the population for each.
            out: where the run is recorded; by default runs/EXPERIMENT-SCALE, with a grid
                runs/sweep-EXPERIMENT-SCALE. Several runs are in subfolders.
            prepare: make the run folders, and leave the training to others.
            processes: how many at a time; by default one on each core for several runs, and for
                one run of large networks, whose seeds are then spread over them.
            engine: processes on this machine, or on a Ray cluster.
            address: of the Ray cluster, auto on one of its nodes; by default a local one.
            given: what the runs are given beside their configuration.
            schedule: when things happen, and on what, in all runs.
            learner: what trains the policy.
            discriminator: what the reward is learned by.
        """
        if (experiment, scale) != defaults:
            raise ValueError(
                f"{experiment} at {scale} scale was asked for, and the defaults are those of "
                f"{name} at {size} scale: name the experiment before all options"
            )
        if processes is not None and processes < 1:
            raise ValueError(f"processes is {processes}; expected at least 1")
        if len(set(seeds)) < len(seeds):
            raise ValueError(f"seeds are {seeds}: two members with one seed are the same")
        chosen = {**schedule, **learner, **discriminator}
        points = _points(find(experiment), scale, chosen, grid, only)
        place = out or Path("runs") / f"{'sweep-' if grid else ''}{experiment}-{scale}"
        source = find(experiment).reward_from
        frozen = any(point.reward == "frozen" for point in points.values())
        if source and not given.frozen_reward and frozen:
            raise ValueError(
                f"{experiment} is paid by the reward of another run: first `offairl run {source}`, "
                f"then add --frozen-reward runs/{source}-{scale}"
            )
        here = 1 if prepare or engine == "ray" else jobs.cores()
        folders = _folders_of_each(points, processes, here if given.device == "cpu" else None)
        about = {"experiment": experiment, "scale": scale}
        data = _create(place, points, seeds, folders, given, about)
        if not prepare:
            how = {"engine": engine, "workers": processes, "address": address}
            gpus = float(given.device != "cpu")
            _finish(place, points, data, **how, gpus=gpus, command=command)

    return run


def _folders_of_each(
    points: Mapping[str, Config], processes: int | None, cores: int | None
) -> dict[str, int]:
    """Return over how many run folders the seeds of each run are spread.

    Cores that runs leave idle train seeds of large networks, or as many as are asked for. None for
    `cores`: a GPU, which has all seeds in one population.
    """
    each = 1 if cores is None else (processes or cores) // len(points)
    alone = processes is not None and len(points) == 1
    return {n: each if alone or is_large(point.learner) else 1 for n, point in points.items()}


def _points(
    experiment: Experiment,
    scale: Scale,
    chosen: Mapping[str, Any],
    given: Sequence[str],
    only: Sequence[str],
) -> dict[str, Config]:
    """Return the configurations of an experiment's own runs, or some of them, times a grid.

    Raises:
        ValueError: there is no such run, the grid is no grid, a run itself sets something else than
            was chosen, or no run has a use for it.
    """
    variants = experiment.variants or {"": {}}
    if unknown := set(only) - set(variants):
        there = ", ".join(variants) or "none, since the experiment is one run"
        raise ValueError(f"no runs {sorted(unknown)}; there are: {there}")
    values, base, points = axes(given), experiment.configs[scale], {}
    for variant, changes in variants.items():
        if only and variant not in only:
            continue
        with options_named(chosen):
            own = point(variant, base, changes, chosen)
        some = grid(own, **values) if values else {"": own}
        points |= {",".join(filter(None, (variant, name))): p for name, p in some.items()}
    with options_named(chosen):
        require_use(points.values(), chosen)
    return points


def _create(
    place: Path,
    points: Mapping[str, Config],
    seeds: Sequence[int],
    spread: Mapping[str, int],
    given: Given,
    about: Mapping[str, str],
) -> dict[str, Demonstrations]:
    """Make the run folders that are not there yet; return the demonstrations that are loaded.

    Args:
        place: the folder of all.
        points: the configurations, by the names of their subfolders.
        seeds: of each.
        spread: over how many run folders the seeds of each are spread.
        given: what the runs are given beside their configuration.
        about: the experiment and its scale, for the record.
    """
    todo = {name: _missing_seeds(place / name, points[name], seeds, given) for name in points}
    given.require_use([*points.values()], find(about["experiment"]).experts[about["scale"]])
    data, fresh = {}, {}
    for name, missing in todo.items():
        if missing:
            fresh[name] = missing, inputs.load(points[name], seeds, **given.files)
    for name in fresh:
        env_id = points[name].env_id
        if points[name].learns_reward and env_id not in data:
            data[env_id] = demonstrations.load(
                env_id, given.trajectories, given.dataset, given.subsample, given.experts
            )
    every = folders.CHECKPOINT_EVERY
    specs = [RunSpec(points[name], seeds, {}, None, every) for name, (seeds, _) in fresh.items()]
    if specs:
        checkpoints.require_room(place, sum(map(checkpoints.disk_space, specs)), specs[0].config)
    for name, (missing, inherited) in fresh.items():
        config, parts = points[name], max(min(spread[name], len(missing)), 1)
        size, more = divmod(len(missing), parts)
        begins = [i * size + min(i, more) for i in range(parts + 1)]
        for begin, end in pairwise(begins):
            some = missing[begin:end]
            folder, members, own = place / name, None, inherited
            if len(some) < len(seeds):
                folder, members = folder / seeds_name(some), [seeds.index(seed) for seed in some]
                own = {name: thing.member(*members) for name, thing in inherited.items()}
            execution = fitting(config, given.device, given.threads, given.compile)
            space = folders.create(
                folder,
                config,
                some,
                execution=execution,
                demonstrations=data.get(config.env_id) if config.learns_reward else None,
                **own,
                sources=given.files,
                members=members,
                **about,
            )
            updates = "compiled" if execution.compile else "not compiled"
            print(f"{folder} takes up to {space} of disk, mostly replay; updates: {updates}")
    return data


def _missing_seeds(
    folder: Path, config: Config, seeds: Sequence[int], given: Given
) -> tuple[int, ...]:
    """Return the seeds that a run does not have yet. What it has must be of the same kind.

    Raises:
        ValueError: it is of another configuration, or other seeds, or something else was given.
    """
    if not any(folder.rglob("config.json")):
        return tuple(seeds)
    there: list[int] = []
    for path in run_folders(folder):
        spec = RunSpec.read(path)
        files = {name: about["files"] for name, about in spec.inherited.items() if about["files"]}
        known = {**(spec.demonstrations or {}), **files}
        found = {
            name: (known[name], now) for name, now in given.recorded().items() if name in known
        }
        found |= differences(spec.config, config)
        if not set(spec.seeds) <= set(seeds):
            found["seeds"] = spec.seeds, tuple(seeds)
        said = [f"{name} {was!r}, not {now!r}" for name, (was, now) in found.items() if was != now]
        if said:
            raise ValueError(
                f"{path} is a run with {', '.join(said)}: give the same, or choose another --out"
            )
        there += spec.seeds
    return tuple(seed for seed in seeds if seed not in there)


def resume(
    folder: Positional[Path],
    *,
    steps: int | None = None,
    seeds: tuple[int, ...] = (),
    processes: int | None = None,
) -> None:
    """Go on with a run that was interrupted, or extend one that has ended.

    All run folders in FOLDER and below it are trained to their ends.

    Args:
        folder: the run's folder.
        steps: environment steps of each seed, in all: more than before to extend the run.
        seeds: seeds to add. They get a run folder of their own in FOLDER, such as
            FOLDER/seeds-5-6-7, and belong to the same run; nothing is moved.
        processes: how many at a time where there are several run folders; by default one on each
            core.
    """
    if processes is not None and processes < 1:
        raise ValueError(f"processes is {processes}; expected at least 1")
    if steps is not None or seeds:
        folders.extend(folder, steps, seeds)
    points = {}
    for path in run_folders(folder):
        own = path.parent if path.name.startswith("seeds-") and path != folder else path
        points[own.relative_to(folder).as_posix()] = RunSpec.read(path).config
    _finish(folder, points, {}, workers=processes)


def _finish(
    place: Path, points: Mapping[str, Config], data: Mapping[str, Demonstrations], **how: Any
) -> None:
    """Train run folders to their ends, one of them in this process, and show what came of it.

    Args:
        place: the folder of all.
        points: the configurations, by the names of their subfolders.
        data: demonstrations that are loaded already, by task.
        **how: as for `jobs.execute`.
    """
    todo = [path for name in points for path in run_folders(place / name)]
    left, failures = [path for path in todo if not worker.is_finished(path)], []
    try:
        if len(left) == 1 and how.get("engine", "processes") == "processes":
            worker.work(left[0], demonstrations=data.get(RunSpec.read(left[0]).config.env_id))
        elif left:
            failures = jobs.execute(left, **how)
    except KeyboardInterrupt:
        sys.exit(f"offairl: stopped; `offairl resume {place}` goes on")
    runs = {name: records.read(place / name) for name in points}
    print(_table_of_seeds(*runs.values()) if len(runs) == 1 else _table(runs))
    print(f"recorded in {place}")
    for env_id, shown in data.items():
        print(f"demonstrations of {env_id}: {shown.returns.mean():.2f}")
    if failures:
        print(*failures, sep="\n\n", file=sys.stderr)
        raise ChildProcessError(
            f"{len(failures)} of {len(left)} jobs failed, twice: see above; `offairl resume "
            f"{place}` goes on with them"
        )
    lost = [why for run in runs.values() for why in run.diverged.values()]
    if lost and (len(runs) == 1 or any(len(r.diverged) == len(r.seeds) for r in runs.values())):
        again = "" if left else ". It is not tried again: start a new run"
        raise FloatingPointError("; ".join(lost) + again)


def _table_of_seeds(run: Run) -> str:
    """Return the last evaluation of each seed."""
    last = {row.seed: row for row in run.rows}.values()
    rows = [f"{row.seed:5} {row.step:9,} {row.mean_return:10.2f}" for row in last]
    return "\n".join(["", f"{'seed':>5} {'step':>9} {'return':>10}", *rows])


def _table(runs: Mapping[str, Run]) -> str:
    """Return the last evaluation of each run: mean, least and greatest return over seeds."""
    lines = [f"{'step':>9} {'return':>10} {'least':>10} {'greatest':>10}"]
    for name, run in runs.items():
        last = {row.seed: row for row in run.rows}.values()
        returns = [row.mean_return for row in last]
        numbers = (sum(returns) / len(returns), min(returns), max(returns)) if returns else ()
        shown = " ".join(f"{x:10.2f}" for x in numbers) or " ".join([f"{'-':>10}"] * 3)
        note = f" (diverged: {' '.join(map(str, run.diverged))})" if run.diverged else ""
        lines.append(f"{min((row.step for row in last), default=0):9,} {shown}  {name}{note}")
    return "\n".join(lines)
