"""The commands `offairl run` and `offairl resume`: run folders made, and trained to their ends.

A run is a grid of one point. Every point has a run folder, or several where its seeds are spread
over processes.
"""

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction

from offairl_lite import demonstrations, envs
from offairl_lite.config import Config, DiscriminatorConfig, differences
from offairl_lite.config.settings import Count, Natural, checked
from offairl_lite.core.acceleration import Execution, choose_execution, is_large
from offairl_lite.core.results import Run
from offairl_lite.demonstrations import Demonstrations
from offairl_lite.experiments import EXPERIMENTS, find
from offairl_lite.runs import checkpoints, folders, inputs, jobs, messages, preflight, records
from offairl_lite.runs.grid import options, points
from offairl_lite.runs.records import RunSpec, run_folders, seeds_name
from offairl_lite.scale import Scale

CHECKPOINT_EVERY = 2_000  #: Steps and updates, together, between checkpoints.


@dataclass(frozen=True)
class RunInputs:
    """What new runs have beside their configuration.

    Args:
        dataset: A Minari data set to imitate; by default the shipped experts'.
        trajectories: How many of its episodes to use; by default all, and 50 of the experts.
        subsample: Use every so many-th transition of each.
        experts: How many of the shipped experts show the task, from the first on; or best. None:
            all.
        frozen_reward: An earlier run, or its reward.safetensors, where the reward is frozen.
            Several become one population.
        pretrained_policy: An earlier run, or its policy.safetensors, where `pretrained` is not
            nothing.
        pretrained_reward: An earlier run, or its reward.safetensors, with which the learned reward
            begins; as many as seeds, with the settings of that run.
        guide: Policies that act at the start of episodes, where there are `guide_steps`.
        device: Where networks live.
        threads: Threads of PyTorch and of the physics in each process. Small networks need one.
        compile: Whether updates are compiled; auto: in runs of 50,000 steps or more.
    """

    dataset: str | None = None
    trajectories: int | None = None
    subsample: int = 1
    experts: int | Literal["best"] | None = None
    frozen_reward: tuple[Path, ...] = ()
    pretrained_policy: tuple[Path, ...] = ()
    pretrained_reward: tuple[Path, ...] = ()
    guide: tuple[Path, ...] = ()
    device: Literal["cpu", "cuda"] = "cpu"
    threads: int = 1
    compile: Literal["auto", "yes", "no"] = "auto"

    @property
    def files(self) -> dict[str, tuple[Path, ...]]:
        """The files of other runs, by the names that `inputs.load` has for them."""
        return {name: getattr(self, name) for name in inputs.CURES}

    def execution(self, config: Config) -> Execution:
        """Return where, and how, a configuration is trained."""
        return choose_execution(config, self.device, self.threads, self.compile)

    def require_use(self, configs: Iterable[Config], default: "RunInputs") -> None:
        """Raise ValueError where no configuration makes use of what is not the default."""
        configs = list(configs)
        needed = {name for config in configs for name in inputs.needed(config)}
        if any(isinstance(config.discriminator, DiscriminatorConfig) for config in configs):
            needed.add("pretrained_reward")
        cures = inputs.CURES.items()
        unused = {name: f": add {cure}, or" for name, cure in cures if name not in needed}
        if not any(config.imitates for config in configs):
            names = ("dataset", "trajectories", "subsample", "experts")
            unused |= dict.fromkeys(names, ", since no reward is learned:")
        elif self.dataset is not None:
            unused["experts"] = f", since {self.dataset} is by none of the shipped ones:"
        for name, why in unused.items():
            if (value := getattr(self, name)) != getattr(default, name):
                value = " ".join(map(str, value)) if isinstance(value, tuple) else value
                raise ValueError(f"{name}={value} would not be used{why} leave it out")


def run_command(name: str, size: Scale) -> Callable[..., None]:
    """Return `offairl run`, with the defaults of one experiment at one scale."""
    defined, defaults = find(name), (name, size)
    default = RunInputs(experts=defined.experts[size])

    def run(
        experiment: str,
        *,
        scale: Scale = size,
        grid: Annotated[tuple[str, ...], UseAppendAction] = (),
        only: tuple[str, ...] = (),
        seeds: tuple[int, ...] = defined.seeds[size],
        out: Path | None = None,
        prepare: bool = False,
        processes: int | None = None,
        engine: jobs.Engine = "processes",
        address: str | None = None,
        run_inputs: Annotated[RunInputs, OmitArgPrefixes] = default,
        schedule: Any,
        learner: Any,
        discriminator: Any,
    ) -> None:
        """Run an experiment, in one configuration or in many, and record it; or go on with it.

        Each run has a folder of its own. The same command again goes on with what is there.

        Args:
            experiment: its name, imitate for a task of your own; the defaults below are this
                experiment's at this scale.
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
            run_inputs: what the runs are given beside their configuration.
            schedule: when things happen, and on what, in all runs.
            learner: what trains the policy.
            discriminator: what the reward is learned by.
        """
        if (experiment, scale) != defaults:
            raise ValueError(
                f"{experiment} at {scale} scale was asked for, and the defaults are those of "
                f"{name} at {size} scale: name the experiment before all options"
            )
        checked("processes", processes, Count | None)
        if not seeds:
            raise ValueError("seeds are (); expected at least one: seeds=(0, 1, 2)")
        configs = points(defined, scale, {**schedule, **learner, **discriminator}, grid, only)
        for config in configs.values():
            envs.spec(config.env_id)  # It imports a module that is named.
        frozen = any(config.reward == "frozen" for config in configs.values())
        if frozen and defined.reward_from and not run_inputs.frozen_reward:
            raise ValueError(f"{name} is paid by {_reward_of(defined.reward_from, scale)}")
        run_inputs.require_use(configs.values(), default)
        place = out or Path("runs") / f"{'sweep-' if grid else ''}{name}-{scale}"
        idle = 1 if prepare or engine == "ray" else jobs.cores()
        each = (processes or idle) // len(configs) if run_inputs.device == "cpu" else 1
        alone = processes is not None and len(configs) == 1
        spread = {n: each if alone or is_large(c.learner.hidden) else 1 for n, c in configs.items()}
        data = _create(place, configs, seeds, run_inputs, spread, name, scale)
        if not prepare:
            engine_options = {"engine": engine, "workers": processes, "address": address}
            _finish(place, configs, data, **engine_options, gpus=float(run_inputs.device != "cpu"))

    run.__annotations__ |= {
        "experiment": Positional[Literal[tuple(EXPERIMENTS)]],  # type: ignore
        **options(defined.configs[size]),
    }
    return run


def _reward_of(run: str, scale: Scale) -> str:
    """Return what to type to have the reward of another experiment, or of one of its runs."""
    other, _, variant = run.partition("/")
    first = f"`offairl run {other}{f' --only {variant}' * bool(variant)} --scale {scale}`"
    folder = Path("runs") / f"{other}-{scale}" / variant
    return f"the reward of another run: first {first}, then add frozen_reward={folder}"


def _create(
    place: Path,
    configs: Mapping[str, Config],
    seeds: Sequence[int],
    run_inputs: RunInputs,
    spread: Mapping[str, int],
    experiment: str,
    scale: Scale,
) -> dict[str, Demonstrations]:
    """Make the run folders that are not there yet; return the demonstrations, by task."""
    checked("seeds", tuple(seeds), tuple[Natural, ...])
    missing = {n: _missing_seeds(place / n, configs[n], seeds, run_inputs) for n in configs}
    data: dict[str, Demonstrations] = {}
    todo = []
    for name, config in configs.items():
        if not missing[name]:
            continue
        networks = inputs.load(config, seeds, **run_inputs.files)
        env_id, demos = config.env_id, None
        notes = preflight.try_out(env_id, seeds[0])
        if config.imitates:
            source = run_inputs.dataset, run_inputs.subsample, run_inputs.experts
            if env_id not in data:
                data[env_id] = demonstrations.load(env_id, run_inputs.trajectories, *source)
            demos = data[env_id]
        execution = run_inputs.execution(config)
        for note in notes + preflight.check(config, seeds, demos, networks):
            messages.note(note)
        for option, network in networks.items():
            one, other = (task.split(":")[-1] for task in (network.env_id, env_id))
            if one != other and not find(experiment).reward_from:  # These experiments mean it.
                name_of = option.replace("_", " ")
                text = f"the {name_of} is of {one}, this run of {other}; only sizes are checked"
                messages.note(text)
        parts = max(min(spread[name], len(missing[name])), 1)
        for part in np.array_split(missing[name], parts):
            some, folder, mine, members = tuple(part.tolist()), place / name, networks, None
            if len(some) < len(seeds):
                folder, members = folder / seeds_name(some), [seeds.index(seed) for seed in some]
                mine = {name: network.member(*members) for name, network in networks.items()}
            shown, began = inputs.describe(demos), inputs.inherited(mine, run_inputs.files, members)
            spec = RunSpec(
                config, some, asdict(execution), shown, CHECKPOINT_EVERY, experiment, scale, began
            )
            todo.append((folder, spec, mine))
    checkpoints.require_room(place, sum(checkpoints.disk_space(spec) for _, spec, _ in todo))
    for folder, spec, mine in todo:
        folders.create(folder, spec, mine)
        space = checkpoints.in_words(checkpoints.disk_space(spec))
        updates = "compiled" if spec.execution["compile"] else "not compiled"
        watch = f"to watch it: {folder / records.PICTURE}"
        print(f"{folder} takes up to {space} of disk, mostly replay; updates: {updates}; {watch}")
    return data


def _missing_seeds(
    folder: Path, config: Config, seeds: Sequence[int], run_inputs: RunInputs
) -> tuple[int, ...]:
    """Return the seeds that a run does not have yet; raise ValueError if it is of another kind."""
    existing: list[int] = []
    now = vars(run_inputs) | {name: [*map(str, paths)] for name, paths in run_inputs.files.items()}
    now["experts"] = None if run_inputs.dataset else run_inputs.experts
    if run_inputs.trajectories is None:
        del now["trajectories"]
    for path in records.folders_in(folder):
        spec = RunSpec.read(path)
        files = {name: of["files"] for name, of in spec.inherited.items() if of["files"]}
        was = {**(spec.demonstrations or {}), **files}
        changes = {name: (was[name], now[name]) for name in now if name in was}
        changes |= differences(spec.config, config)
        if not set(spec.seeds) <= set(seeds):
            changes["seeds"] = spec.seeds, tuple(seeds)
        changed = {name: pair for name, pair in changes.items() if pair[0] != pair[1]}
        if changed:
            cure, steps = "give the same, or choose another folder", config.total_steps
            if len(changed) == 1 and spec.config.total_steps < steps:
                cure = f"{records.again(path, spec, f'resume --steps {steps}')} extends it"
            said = ", ".join(f"{name} {old!r}, not {new!r}" for name, (old, new) in changed.items())
            raise ValueError(f"{path} is a run with {said}: {cure}")
        existing += spec.seeds
    return tuple(seed for seed in seeds if seed not in existing)


def resume(
    folder: Positional[Path],
    *,
    steps: int | None = None,
    seeds: tuple[int, ...] = (),
    processes: int | None = None,
    env_id: str | None = None,
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
        env_id: the run's task, my_module:MyTask-v0, where that is in a module of your own.
    """
    checked("processes", processes, Count | None)
    for path in run_folders(folder) if env_id is not None else ():
        folders.known(path, env_id)
    if steps is not None or seeds:
        for path in run_folders(folder):  # None can be given by hand here.
            inputs.demonstrations_of(path, folders.known(path))
        folders.extend(folder, steps, seeds)
    paths = run_folders(folder)
    runs = [p.parent if p.name.startswith("seeds-") and p != folder else p for p in paths]
    names = dict.fromkeys(run.relative_to(folder).as_posix() for run in runs)
    _finish(folder, names, {}, workers=processes)


def _finish(
    place: Path, names: Iterable[str], data: Mapping[str, Demonstrations], **job_options: Any
) -> None:
    """Train run folders to their ends, one of them in this process, and show what came of it."""
    todo = [path for name in names for path in run_folders(place / name)]
    left = [path for path in todo if not folders.is_finished(path)]
    specs = [folders.known(path) for path in left]
    failures: list[str] = []
    try:
        if len(left) == 1 and job_options.get("engine", "processes") == "processes":
            folders.work(left[0], demonstrations=data.get(specs[0].config.env_id))
        elif left:
            failures = jobs.execute(left, **job_options)
    except KeyboardInterrupt:
        sys.exit(f"offairl: stopped; {records.again(place, specs[0])} goes on")
    if failures:
        print(*failures, sep="\n\n", file=sys.stderr)
    runs = {name: records.read(place / name) for name in names}
    print(_table(runs))
    print(f"recorded in {place}")
    for env_id, shown in data.items():
        mean = f": {shown.returns.mean():.2f}" if shown.returns.any() else " have no rewards"
        print(f"demonstrations of {env_id}{mean}")
    if failures:
        raise ChildProcessError(
            f"{len(failures)} of {len(left)} jobs failed, twice: see above; "
            f"{records.again(place, specs[0])} goes on with them"
        )
    reasons = [why for run in runs.values() for why in run.diverged.values()]
    if reasons and (len(runs) == 1 or any(len(r.diverged) == len(r.seeds) for r in runs.values())):
        again = "" if left else ". It is not tried again: start a new run"
        raise FloatingPointError("; ".join(reasons) + again)


def _table(runs: Mapping[str, Run]) -> str:
    """Return the last evaluation of each seed of one run; of many, each run's mean and range."""
    ends = {name: list({r.seed: r for r in run.rows}.values()) for name, run in runs.items()}
    if len(runs) == 1:
        (rows,) = ends.values()
        lines = ["", f"{'seed':>5} {'step':>9} {'return':>10}"]
        return "\n".join(lines + [f"{r.seed:5} {r.step:9,} {r.mean_return:10.2f}" for r in rows])
    lines = [f"{'step':>9} {'return':>10} {'least':>10} {'greatest':>10}"]
    for name, rows in ends.items():
        returns = [row.mean_return for row in rows]
        numbers = [sum(returns) / len(returns), min(returns), max(returns)] if returns else []
        text = " ".join(f"{x:10.2f}" for x in numbers) or " ".join([f"{'-':>10}"] * 3)
        failed = runs[name].diverged
        note = f" (diverged: {' '.join(map(str, failed))})" if failed else ""
        lines.append(f"{min((row.step for row in rows), default=0):9,} {text}  {name}{note}")
    return "\n".join(lines)
