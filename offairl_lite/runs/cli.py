"""The command line, `offairl`: one function for each of its commands."""

import inspect
import sys
import textwrap
from collections.abc import Callable, Sequence
from itertools import pairwise
from json import dumps
from pathlib import Path
from typing import Annotated, Any, Literal

import gymnasium
import numpy as np
import tyro
from tyro.conf import OmitArgPrefixes, Positional

from offairl_lite import cloning, demonstrations, envs
from offairl_lite.analysis import films
from offairl_lite.config import CORRECTED
from offairl_lite.config.settings import EARLIER, SYNONYMS
from offairl_lite.core.acceleration import Execution
from offairl_lite.core.policies import Policy
from offairl_lite.core.rollouts import rollout
from offairl_lite.experiments import EXPERIMENTS, find
from offairl_lite.minari_storage import closed_task
from offairl_lite.runs import export as exports
from offairl_lite.runs import folders, inputs, launch, messages, records
from offairl_lite.runs import tensorboard as logs
from offairl_lite.runs.bench import Options, estimate, measure, table
from offairl_lite.scale import Scale, current


def list_experiments(name: Positional[str | None] = None, *, times: bool = False) -> None:
    """Show the experiments, and the tasks for which experts are shipped.

    Args:
        name: of the only experiment to show.
        times: try each for a moment, minutes in all, and say how long a run of it takes about, here
            and on one core, not compiled. Of those that are several runs it is the first.
    """
    print("Experiments (offairl run NAME):")
    for title, experiment in (EXPERIMENTS if name is None else {name: find(name)}).items():
        print(f"  {title:16} {messages.in_options(experiment.about)}")
        for size, config in experiment.configs.items():
            seeds = len(experiment.seeds[size])
            runs = [config.change(**c) for c in experiment.variants.values()] or [config]
            time = f", {_words(estimate(runs[0], seeds))}" if times else ""
            tasks = ", ".join(dict.fromkeys(run.env_id for run in runs))
            _indented(f"{size}: {tasks}, {config.total_steps:,} steps, {seeds} seeds{time}")
        if experiment.variants:
            _indented("--only some of these runs:")
            _indented(" ".join(experiment.variants))
    if name is None:
        print("\nExperts (offairl demos ENV_ID):")
        for path in sorted(demonstrations.EXPERTS.glob("*.safetensors")):
            policy = Policy.load(path)
            print(f"  {policy.env_id:26} {len(policy)} policies")


def _indented(text: str) -> None:
    """Print a text below the name of an experiment."""
    print(textwrap.indent(textwrap.fill(text, 78, break_on_hyphens=False), " " * 21))


def _words(seconds: float) -> str:
    """Return a duration, roughly, in words."""
    for unit, size in (("days", 86_400), ("hours", 3_600), ("minutes", 60)):
        if seconds >= 2 * size:
            return f"about {seconds / size:.0f} {unit}"
    return f"about {seconds:.0f} seconds"


def demos(
    env_id: Positional[str],
    *,
    trajectories: int | None = None,
    dataset: str | None = None,
    experts: int | Literal["best"] | None = None,
    policy: str | None = None,
    step: int | None = None,
) -> None:
    """Make demonstrations of a task where there are none yet, check them, and say what they are.

    They are those of the shipped experts, a data set of your own that is there already, or a new
    one of the episodes of a policy: `offairl demos ENV_ID --policy RUN --dataset own/trained-v0`.

    Args:
        env_id: Gymnasium id of the task, for instance offairl/PointMazeLeft-v0.
        trajectories: how many episodes; by default all of a data set that is there, otherwise 50.
        dataset: a Minari data set of your own to check, or with --policy the name of a new one.
        experts: of how many of the shipped experts, or of the best; by default of all.
        policy: a run's folder, or a policy's file, to make the data set of: all members take
            turns, and actions are sampled.
        step: of the run's evaluation whose policies act; by default those of its end.
    """
    launch.RunInputs(dataset, experts=experts).require_use([CORRECTED], launch.RunInputs())
    if policy is not None:
        if dataset is None:
            raise ValueError(
                f"--policy {policy} makes a data set, which needs a name: add --dataset "
                "own/trained-v0, or another that is new"
            )
        demonstrations.generate(_policy(policy, step), env_id, trajectories or 50, dataset)
    data = demonstrations.load(env_id, trajectories, dataset, experts=experts)
    lengths, returns = np.array(data.lengths), data.returns
    ended = data.transitions.terminated[lengths.cumsum() - 1].numpy() == 1
    summary = f"return {returns.mean():.2f} (from {returns.min():.2f} to {returns.max():.2f})"
    summary = f"{summary if returns.any() else 'no rewards'}; {ended.sum()} of them terminated"
    print(f"{env_id}: {len(data)} trajectories, {sum(lengths):,} steps, {summary}")
    used = 50 * np.ptp(data.transitions.action.numpy(), axis=0)
    print(f"actions use {', '.join(f'{share:.0f}' for share in used)} % of their ranges")
    limit = envs.spec(env_id).max_episode_steps or np.inf
    if at_limit := (ended & (lengths == limit)).sum():
        note = f"{at_limit} terminated in the last step of the time limit; if the limit ended"
        messages.note(f"{note} them, write them with terminated=False")
    if longer := (lengths > limit).sum():
        note = f"episodes longer than the time limit of {limit} steps: {longer}; if they are"
        messages.note(f"{note} several in one, write them as several recordings")


def clone(
    env_id: Positional[str],
    *,
    out: Path,
    dataset: str | None = None,
    trajectories: int | None = None,
    experts: int | Literal["best"] | None = None,
    seeds: tuple[int, ...] = (0,),
    hidden: tuple[int, ...] = (256, 256),
    steps: int = 5_000,
    absorbing_state: bool = False,
    eval_episodes: int = 10,
) -> None:
    """Clone demonstrations: learn their actions, without a step of the task, in about a minute.

    Args:
        env_id: Gymnasium id of the task.
        out: the policy's file, such as clones/hopper.safetensors, for `watch`, `export`, `demos
            --policy` or `run --pretrained policy --pretrained-policy`.
        dataset: a Minari data set of your own; by default the shipped experts'.
        trajectories: how many of its episodes to use; by default all, and 50 of the experts.
        experts: how many of the shipped experts show the task, from the first on; or best.
        seeds: of the policies, one for each.
        hidden: layers of the actor, as of a run that goes on with it.
        steps: the most minibatches; each policy stops when it no longer learns.
        absorbing_state: for a run with --absorbing that goes on with it.
        eval_episodes: episodes in which each is then tried, without noise; 0 for none.
    """
    if out.suffix != ".safetensors":
        raise ValueError(f"out is {out}; expected a policy's file: --out {out}.safetensors")
    data = demonstrations.load(env_id, trajectories, dataset, experts=experts)
    policy = cloning.clone(data, seeds, hidden=hidden, steps=steps, absorbing_state=absorbing_state)
    records.write_whole(out, policy.save)
    known = f"return {data.returns.mean():.2f}" if data.returns.any() else "have no rewards"
    print(f"{out}: {len(policy)} policies; demonstrations {known}")
    if eval_episodes:
        returns = rollout(policy, env_id, seeds, eval_episodes).returns
        for seed, scores in zip(seeds, returns, strict=True):
            low, high = scores.min(), scores.max()
            print(f"seed {seed}: {scores.mean():.2f} (from {low:.2f} to {high:.2f})")


def watch(
    source: Positional[str],
    *,
    env_id: str | None = None,
    member: int = 0,
    seed: int = 0,
    max_steps: int = 200,
    out: Path = Path("film.mp4"),
    step: int | None = None,
) -> None:
    """Film one episode of a policy.

    Args:
        source: a run's folder, a policy's file, or the id of a task with shipped experts.
        env_id: where the policy acts; by default where it was trained.
        member: which member of the population.
        seed: of the episode.
        max_steps: where to stop at the latest; the film runs at the task's own speed, render_fps.
        out: the MP4 file to write, in a folder that may be new.
        step: of the run's evaluation whose policy acts; by default that of its end.
    """
    if out.suffix != ".mp4":
        raise ValueError(f"out is {out}; expected the name of an MP4 file: --out {out.stem}.mp4")
    for path in Path(source).rglob("config.json") if env_id is None else ():
        folders.known(path.parent, command="watch")
    policy = _policy(source, step).member(member)
    # Before the film is made, which takes longer than it takes to learn that it has no place.
    out.parent.mkdir(parents=True, exist_ok=True)
    task = env_id or policy.env_id
    fps = closed_task(task)[0].metadata.get("render_fps") or 20
    every = max(round(fps / 25), 1)
    pictures = films.frames(policy, task, seed, max_steps, every)
    film = films.mp4(pictures, round(fps / every))
    records.write_whole(out, lambda path: path.write_bytes(film))
    print(f"{out}: {len(pictures)} frames of {task}")


def _policy(source: str, step: int | None) -> Policy:
    """Return the policy of a run, of a file, or of a task with shipped experts."""
    path = Path(source)
    if path.exists() or path.suffix == ".safetensors":
        return inputs.load_one(path, Policy, step)
    # A folder's name may end like a task's: runs/Hopper is not Hopper-v5.
    if source not in gymnasium.registry:
        raise FileNotFoundError(
            f"there is no run or policy file {source}, and no expert is shipped for {source}: "
            "`offairl list` names the tasks with experts, and `ls runs` your runs"
        )
    return demonstrations.expert(source)


def tensorboard(run: Positional[Path], *, out: Path | None = None, follow: bool = False) -> None:
    """Write the curves of a run for TensorBoard; any run, also one that is recorded.

    Args:
        run: its folder.
        out: the folder for the event files, a new one; by default RUN/tensorboard, anew.
        follow: go on writing until the run has ended; one that was killed may be resumed.
    """
    folder = out or run / "tensorboard"
    count = logs.export(run, folder, follow, anew=out is None)
    print(f"{count} evaluations written; to look at them: tensorboard --logdir {folder}")


def export(
    source: Positional[Path],
    *,
    out: Path,
    member: int | None = None,
    env_id: str | None = None,
    step: int | None = None,
) -> None:
    """Write policies, and rewards, of a run or a file for programs that do not know this package.

    Each is an ONNX file, if ONNX is installed, and a program of PyTorch. They take the observations
    of the task, and give and take actions in its own units. OUT/README.txt tells how to load them.

    Args:
        source: the folder of a run that has ended, or a policy's file, such as a clone.
        out: the folder for the files; those of an earlier export are overwritten.
        member: which member of the population; by default every one that has not diverged.
        step: of the evaluation whose policies and rewards are written; by default those of the end.
        env_id: the task, my_module:MyTask-v0, where that is in a module of your own.
    """
    for part in [] if source.is_file() else records.run_folders(source):
        folders.known(part, env_id, f"export --out {out}")
    notes = exports.export(source, out, member, step, env_id)
    for note in notes:
        messages.note(note)
    print(f"exported to {out}; how to load it: {out / 'README.txt'}")


def verify(record: Positional[Path], *, env_id: str | None = None) -> None:
    """Do the beginning of a recorded run again, and compare.

    On the machine that made the record, with the same versions, the numbers are the same to the
    last digit. Elsewhere training, which magnifies the smallest differences, comes out otherwise.
    What the run had of other runs is looked for in the record, then in the files that its
    config.json names.

    Args:
        record: its folder.
        env_id: the run's task, my_module:MyTask-v0, where that is in a module of your own.
    """
    pairs = folders.verify(record, sys.stderr.isatty(), env_id)
    print(f"{'seed':>5} {'step':>9} {'recorded':>12} {'here':>12}")
    for (seed, step), pair in pairs.items():
        means = (f"{row.mean_return:.4f}" if row else "diverged" for row in pair)
        print(f"{seed:5} {step:9,}", *(f"{mean:>12}" for mean in means))
    if all(old and new and old.returns == new.returns for old, new in pairs.values()):
        return print("the same, every return of every episode")
    first = records.run_folders(record)[0]
    then = records.read_json(first / "run.json")
    differences = [f"{record} comes out otherwise here"]
    if records.RunSpec.read(first).execution.get("compile"):
        differences.append("its updates are compiled, and every compiler rounds in its own way")
    for key, (was, here) in records.changed(then, records.origin(Execution())).items():
        cure = " (the environment variable ATEN_CPU_CAPABILITY sets them)" * (key == "vectors")
        differences.append(f"{key}: {was}, here {here}{cure}")
    raise ValueError("; ".join(differences))


def bench(options: Annotated[Options, OmitArgPrefixes], *, json: bool = False) -> None:
    """Measure how fast this machine trains, in five to ten minutes.

    Args:
        options: what to measure.
        json: print numbers for a program instead of a table.
    """
    options.require_positive()
    report = measure(options)
    print(dumps(report, indent=2) if json else table(report))


REMOVED = {
    "sweep": "run NAME --grid SETTING=VALUE,VALUE",
    "--generator": "--learner",
    "--carry": "--pretrained",
    "--no-policy-in-logit": "--loss log-ratio",
    "--replay-density": "--loss airl-mixture",
}
"""What was in earlier versions, and what to write instead."""


def in_current_words(args: Sequence[str]) -> list[str]:
    """Return arguments with earlier names and other spellings of settings replaced.

    `--scale=full` becomes `--scale full`.
    """
    parts = [
        part for arg in args for part in (arg.split("=", 1) if arg.startswith("--") else [arg])
    ]
    options = {f"--{old}".replace("_", "-"): f"--{new}" for old, new in EARLIER.items()}
    parts = [options.get(part.replace("_", "-"), part) for part in parts]
    return [
        SYNONYMS.get(before.removeprefix("--"), {}).get(part, part)
        for before, part in pairwise(["", *parts])
    ]


def main(args: Sequence[str] | None = None) -> None:
    """Off-policy adversarial inverse reinforcement learning, from the command line.

    What to run for a robot of your own is on the page "The recipe" of the book, book/recipe.md.
    """
    # A task of one's own may be in a module of the working directory (`python -m` looks there).
    sys.path.append(str(Path.cwd()))
    given = sys.argv[1:] if args is None else args
    args = in_current_words(given)
    with messages.one_line():
        for old in {*args[:1], *(arg for arg in args if arg.startswith("--"))} & REMOVED.keys():
            raise ValueError(f"{old} is of an earlier version: write {REMOVED[old]}")
        names = {arg.split("=")[0].lstrip("-").replace("-", "_") for arg in given}
        for name in names & EARLIER.keys():
            messages.note(f"{name} is called {EARLIER[name]} now; the earlier name will go")
        # The experiment and the scale decide the defaults that --help shows, so they come first.
        # What follows an option is its value, `--out imitate`.
        free = [arg for before, arg in pairwise(["", *args]) if not before.startswith("--")]
        name = next((arg for arg in free if arg in EXPERIMENTS), "imitate")
        scale = dict(pairwise(args)).get("--scale")
        size: Scale = "full" if scale == "full" else "demo" if scale == "demo" else current()
        commands: dict[str, Callable[..., Any]] = {"list": list_experiments}
        commands |= {"run": launch.run_command(name, size), "resume": launch.resume}
        others = demos, clone, watch, tensorboard, export, verify, bench
        commands |= {command.__name__: command for command in others}
        tyro.extras.subcommand_cli_from_dict(
            commands, prog="offairl", description=inspect.getdoc(main), args=args
        )


if __name__ == "__main__":
    main()
