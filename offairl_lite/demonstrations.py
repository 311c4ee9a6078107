"""Expert demonstrations: loaded from Minari, checked, or made on first use by shipped experts."""

import hashlib
import json
import logging
import shutil
import tempfile
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import minari
import numpy as np
import torch
from filelock import FileLock
from gymnasium.envs.registration import EnvSpec
from jaxtyping import Float
from minari.data_collector.episode_buffer import EpisodeBuffer
from minari.dataset.minari_dataset import parse_dataset_id
from minari.storage import get_dataset_path
from tqdm.auto import tqdm

from offairl_lite import envs
from offairl_lite.core.policies import Policy, unsquash
from offairl_lite.core.replay import Batch
from offairl_lite.core.rollouts import Episodes, require_actions, rollout

EXPERTS = Path(__file__).parent / "experts"
PURPOSE = 1
"""Sets the episodes of a data set apart from those of evaluations (`evaluate.episode_seeds`)."""
BLOCK = 10
"""Episodes of each expert that are made side by side, however few are asked for: matrix products of
other shapes round differently, and a trajectory would depend on how many there are."""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Demonstrations:
    """Episodes of an expert, as transitions.

    Args:
        env_id: the task.
        transitions: axes `N`, in order, with actions scaled to [-1, 1].
        lengths: transitions of each episode.
        whole_returns: of each episode, where `transitions` are only some of its steps.
        source: what `load` was asked for, to load them again: `dataset`, `subsample` and `experts`.
            None: they are from elsewhere.
    """

    env_id: str
    transitions: Batch
    lengths: tuple[int, ...]
    whole_returns: tuple[float, ...] | None = None
    source: Mapping[str, Any] | None = None

    @property
    def returns(self) -> np.ndarray:
        """Undiscounted return of each whole episode, however many of its steps are here."""
        if self.whole_returns is not None:
            return np.array(self.whole_returns, np.float32)
        return np.array([part.sum() for part in self.transitions.reward.split(self.lengths)])

    def __len__(self) -> int:
        return len(self.lengths)

    def subsample(
        self, trajectories: int | Sequence[int] | None = None, every: int = 1, seed: int = 0
    ) -> "Demonstrations":
        """Return some of the trajectories, and of each every k-th transition from a random one on.

        So Ho and Ermon (2016) thin demonstrations, and DAC after them. A termination is kept
        wherever it falls, as DAC keeps its absorbing transitions: it is the only sign of how an
        episode ends, and the absorbing state is made from it.

        Args:
            trajectories: how many, from the first on, or which; None: all.
            every: k. The first transition is one of a trajectory's first k.
            seed: of the first transitions; a trajectory's own is the same whichever others are
                taken.

        Raises:
            ValueError: fewer trajectories than one, or other than there are, or `every` below 1.
        """
        if trajectories is None:
            trajectories = len(self)
        chosen = range(trajectories) if np.ndim(trajectories) == 0 else list(trajectories)
        if not chosen or len({*chosen} & {*range(len(self))}) < len(chosen):
            raise ValueError(
                f"trajectories is {trajectories}; there are {len(self)}: give a number from 1 to "
                f"{len(self)}, or a list of different ones from 0 to {len(self) - 1}"
            )
        if every < 1:
            raise ValueError(f"every is {every}; expected at least 1, which keeps all transitions")
        ends = np.cumsum(self.lengths)
        kept = []
        for i in chosen:
            # A trajectory of fewer than k transitions keeps one of them.
            offset = np.random.default_rng((seed, i)).integers(min(every, self.lengths[i]))
            rows = np.arange(ends[i] - self.lengths[i] + offset, ends[i], every)
            if rows[-1] < ends[i] - 1 and self.transitions.terminated[ends[i] - 1]:
                rows = np.append(rows, ends[i] - 1)
            kept.append(rows)
        rows = torch.from_numpy(np.concatenate(kept))
        return Demonstrations(
            self.env_id,
            Batch(*(part[rows] for part in self.transitions)),
            tuple(map(len, kept)),
            tuple(self.returns[list(chosen)].tolist()),
        )


def expert(env_id: str) -> Policy:
    """Return the shipped experts of a task.

    Raises:
        FileNotFoundError: none is shipped for it; the message lists the tasks that have some.
    """
    return Policy.load(expert_file(env_id))


def expert_file(env_id: str) -> Path:
    """Return where the shipped experts of a task are.

    Raises:
        FileNotFoundError: none is shipped for it; the message lists the tasks that have some.
    """
    path = EXPERTS / f"{short_name(env_id)}.safetensors"
    # Another task can have the same short name, as a `mine/PointMazeLeft-v0` of one's own has.
    if not path.is_file() or Policy.load(path).env_id != env_id:
        files = sorted(EXPERTS.glob("*.safetensors"))
        have = ", ".join(Policy.load(file).env_id for file in files) or "none yet"
        raise FileNotFoundError(
            f"no expert is shipped for {env_id} (there are: {have}); pass the id of a Minari data "
            "set of your own, or train an expert with reward='environment' and have `offairl demos "
            f"{env_id} --policy RUN --dataset own/expert-v0` make one"
        )
    return path


def short_name(env_id: str) -> str:
    """Return `PointMazeLeft` for `offairl/PointMazeLeft-v0`."""
    return env_id.split("/")[-1].rsplit("-v", 1)[0]


def load(
    env_id: str,
    trajectories: int = 50,
    dataset_id: str | None = None,
    subsample: int = 1,
    experts: int | None = None,
) -> Demonstrations:
    """Return demonstrations of a task from Minari's local storage.

    Without `dataset_id` they are the shipped experts' own, made the first time and then kept, under
    a name that changes when the experts do. A trajectory is always the same, whether 5 are asked
    for or 50.

    Args:
        env_id: the task.
        trajectories: how many episodes to take, from the first on.
        dataset_id: a data set of your own, as `minari.list_local_datasets()` names it.
        subsample: of each trajectory every so many-th transition is taken, see
            `Demonstrations.subsample`.
        experts: without `dataset_id`, how many of the shipped experts show it, from the first on;
            by default all.

    Raises:
        FileNotFoundError: there is no such data set, and no expert to make it.
        ModuleNotFoundError: the task's id names a module that is not there.
        OSError: Minari's local storage is no folder, or the shipped experts' episodes must be made
            and cannot be kept there.
        ValueError: the data set does not fit the task; says what was expected and what was found.
            Or the task is not known, or its spaces are not what `envs.require_boxes` expects. Or
            `trajectories` or `subsample` is below 1, or there are not so many `experts`.
    """
    if trajectories < 1:
        raise ValueError(f"trajectories is {trajectories}; expected at least 1")
    if subsample < 1:
        raise ValueError(f"subsample is {subsample}; expected at least 1, which keeps all steps")
    source = {"dataset": dataset_id, "subsample": subsample, "experts": experts}
    if dataset_id is None:
        envs.spec(env_id)  # A task that is not known is refused as such.
        policy = expert(env_id)
        if experts is not None:
            if not 1 <= experts <= len(policy):
                raise ValueError(
                    f"experts is {experts}; {len(policy)} are shipped for {env_id}, and by default "
                    "all of them show it"
                )
            policy = policy.member(*range(experts))
        digest = _digest(expert_file(env_id).read_bytes())[:8]
        some = "" if experts is None else f"-first-{experts}"
        dataset_id = f"offairl/{short_name(env_id)}/experts-{digest}{some}-{trajectories}-v0"
        with warnings.catch_warnings():
            # It may be one that another process is about to write.
            warnings.filterwarnings("ignore", "Misconfigured dataset")
            whole = _is_whole(dataset_id, trajectories)
        if not whole:
            with _storage():
                alone = FileLock(get_dataset_path() / ".offairl.lock").acquire()
            with alone:
                if not _is_whole(dataset_id, trajectories):
                    # Nobody else is writing, so what is there was given up half-way.
                    shutil.rmtree(get_dataset_path(dataset_id), ignore_errors=True)
                    _compare(generate(policy, env_id, trajectories, dataset_id), env_id)
    else:
        source["experts"] = None  # It is by none of ours.
        known = _known()
        if dataset_id not in known:
            raise FileNotFoundError(
                f"Minari has no local data set {dataset_id!r}; here are: "
                f"{', '.join(known) or 'no data set at all'}. "
                "Download one with `minari download`, make one of recordings with "
                "`demonstrations.write`, or have `offairl demos --policy` make one"
            )
    data = from_minari(minari.load_dataset(dataset_id), env_id, trajectories)
    thin = data if subsample == 1 else data.subsample(every=subsample)
    return replace(thin, source=source)


def _known() -> dict[str, dict[str, Any]]:
    """Return what Minari has here, with its metadata, by name."""
    with _storage():
        return minari.list_local_datasets()


def _is_whole(dataset_id: str, trajectories: int) -> bool:
    """Return whether a data set is there, and has all its episodes, which are counted last."""
    return _known().get(dataset_id, {}).get("total_episodes") == trajectories


@contextmanager
def _storage() -> Iterator[None]:
    """What goes wrong with Minari's local storage, with the way out."""
    try:
        yield
    except OSError as error:
        raise OSError(
            f"demonstrations are kept in Minari's local storage, which cannot be used: {error}; "
            "set MINARI_DATASETS_PATH to a folder that can be written to"
        ) from error


def generate(policy: Policy, env_id: str, trajectories: int, dataset_id: str) -> Episodes:
    """Write a Minari data set of a policy's first episodes, shared out evenly among its members.

    Actions are sampled, as maximum-entropy experts act. Episode `i` is the `i // n`-th of member
    `i % n`.

    Args:
        policy: n members: experts, or those of a run of your own.
        env_id: the task.
        trajectories: how many episodes.
        dataset_id: a new name, such as `own/trained-v0`.

    Returns:
        The first episodes of each member, `BLOCK` of them.

    Raises:
        FileExistsError: there is a data set of this name; nothing is overwritten.
        ModuleNotFoundError: the task's id names a module that is not there.
        OSError: Minari's local storage cannot be written to.
        ValueError: the policy or the name does not fit, the task is not known, its spaces are not
            what `envs.require_boxes` expects, or `trajectories` is below 1.
    """
    # All that can go wrong is found out now, and not after minutes of work.
    if trajectories < 1:
        raise ValueError(f"trajectories is {trajectories}; expected at least 1")
    _require_new(dataset_id)
    space = _task(env_id).action_space
    require_actions(policy, space)
    first = made = _block(policy, env_id)
    recordings = []
    with tqdm(total=trajectories, unit="episode", desc=f"demonstrations of {env_id}") as bar:
        for i in range(trajectories):
            e, member = divmod(i, len(policy))
            if i > 0 and member == e % BLOCK == 0:
                made = _block(policy, env_id, e)
            at = member, e % BLOCK
            length = made.lengths[at]
            obs, last = made.obs[at][:length], made.next_obs[at][length - 1 : length]
            # In the task's own units; from -1 to 1 this changes nothing.
            middle, half = (space.low + space.high) / 2, (space.high - space.low) / 2
            recordings.append(
                Recording(
                    np.concatenate([obs, last]),
                    np.clip(middle + half * made.action[at][:length], space.low, space.high),
                    bool(made.terminated[at]),
                    made.reward[at][:length],
                )
            )
            bar.update()
    by = f"Episodes of {len(policy)} policies that were trained on {policy.env_id}."
    write(recordings, env_id, dataset_id, algorithm=type(policy.actor).__name__, description=by)
    return first


class Recording(NamedTuple):
    """An episode of T steps, as it was recorded.

    `terminated` says whether the task had ended for good; otherwise the recording was cut. Rewards
    are for `Demonstrations.returns` alone, and need not be known.
    """

    obs: Float[np.ndarray, "T+1 O"]
    action: Float[np.ndarray, "T A"]
    terminated: bool = False
    reward: Float[np.ndarray, "T"] | None = None


def write(
    recordings: Sequence[Recording],
    env_id: str,
    dataset_id: str,
    *,
    algorithm: str = "unknown",
    description: str | None = None,
) -> None:
    """Write a Minari data set of episodes from anywhere.

    Args:
        recordings: the episodes, with actions in the task's own units.
        env_id: the task.
        dataset_id: a new name, such as `own/recorded-v0`.
        algorithm: by which they were made, for the data set.
        description: of them, for the data set.

    Raises:
        FileExistsError: there is a data set of this name; nothing is overwritten.
        ModuleNotFoundError: the task's id names a module that is not there.
        OSError: Minari's local storage cannot be written to.
        ValueError: a recording does not fit the task, the name is none, the task is not known, or
            its spaces are not what `envs.require_boxes` expects; nothing is written.
    """
    _require_new(dataset_id)
    if not recordings:
        raise ValueError("there are no recordings; expected at least one")
    env = _task(env_id)
    buffer = []
    for i, (obs, action, terminated, reward) in enumerate(recordings):
        steps = len(action)
        last = np.arange(steps) == steps - 1
        episode = EpisodeBuffer(
            id=i,
            observations=np.asarray(obs, env.observation_space.dtype),
            actions=np.asarray(action, env.action_space.dtype),
            rewards=np.zeros(steps) if reward is None else np.asarray(reward),
            terminations=last & terminated,
            truncations=last & (not terminated),
        )
        where = f"recording {i}, for the task {env_id}"
        _check(episode, where, env.observation_space, env.action_space)
        buffer.append(episode)
    # Minari keeps it, so that the data set can be told from those of other tasks.
    env.unwrapped.spec = _storable(envs.spec(env_id))
    with warnings.catch_warnings():
        # Minari would like to know whom to write to about a data set; this one stays here.
        warnings.filterwarnings("ignore", r"`(code_permalink|author|author_email)` is set to None")
        warnings.filterwarnings("ignore", "`description` is set to None")
        minari.create_dataset_from_buffers(
            dataset_id,
            buffer,
            env=env.unwrapped,
            eval_env=env.unwrapped,
            observation_space=env.observation_space,
            action_space=env.action_space,
            algorithm_name=algorithm,
            description=description,
        )


def _require_new(dataset_id: str) -> None:
    """Raise FileExistsError, OSError or ValueError unless a data set can get this name."""
    try:
        parse_dataset_id(dataset_id)
    except (TypeError, ValueError) as error:  # The former without a version, -v0.
        raise ValueError(
            f"{dataset_id!r} is no name for a Minari data set; expected one such as own/trained-v0"
        ) from error
    with _storage():
        there = get_dataset_path(dataset_id)
        tempfile.TemporaryFile(dir=get_dataset_path()).close()
    if there.exists():
        raise FileExistsError(
            f"the data set {dataset_id} is there already, and is not overwritten: choose another "
            f"name, or remove {there}"
        )


def _task(env_id: str) -> gymnasium.Env:
    """Return a task, closed, to be asked for its spaces.

    Raises:
        ModuleNotFoundError: its id names a module that is not there.
        ValueError: it is not known, or its spaces are not what `envs.require_boxes` expects.
    """
    envs.spec(env_id)  # Refuses an unknown one with more help than Gymnasium gives.
    env = gymnasium.make(env_id)
    env.close()
    envs.require_boxes(env_id, env.observation_space, env.action_space)
    return env


def _storable(spec: EnvSpec) -> EnvSpec:
    """Return what Minari can write down of a task: if not how it is made, then its id alone."""
    try:
        spec.to_json()
    except (TypeError, ValueError):  # An entry point that is a class, or an array among the kwargs.
        return EnvSpec(spec.id)
    return spec


def write_reference(env_id: str) -> Path:
    """Write down, beside the shipped experts of a task, what they do here.

    That is `returns`, of each expert's mode over ten episodes; `demonstrated`, the mean return of
    50 demonstrations of the first expert, of the first two, and so on, as `load` counts `experts`;
    and what tells the demonstrations that they make here from those that they make elsewhere.

    Returns:
        The file, to be shipped with the experts.

    Raises:
        FileNotFoundError: no expert is shipped for the task.
    """
    path = expert_file(env_id).with_suffix(".json")
    policy = expert(env_id)
    returns = [round(float(mean), 4) for mean in _mode_returns(policy)]
    shown = {"returns": returns, "demonstrated": _demonstrated(policy, env_id)}
    content = {**shown, **_description(_block(policy, env_id), env_id)}
    path.write_text(json.dumps(content, indent=2) + "\n")
    return path


def _block(policy: Policy, env_id: str, first: int = 0) -> Episodes:
    """Make the `first` episode of each expert and those that follow."""
    seeds = range(len(policy))
    return rollout(policy, env_id, seeds, BLOCK, sample=True, purpose=PURPOSE, first=first)


def _demonstrated(policy: Policy, env_id: str, count: int = 50) -> list[float]:
    """Return the mean return of so many demonstrations, by the first expert, the first two, ..."""
    blocks = [_block(policy, env_id, first).returns for first in range(0, count, BLOCK)]
    returns, i = np.concatenate(blocks, 1), np.arange(count)
    return [round(float(returns[i % n, i // n].mean()), 4) for n in range(1, len(policy) + 1)]


def _description(made: Episodes, env_id: str) -> dict[str, Any]:
    """Return what tells each expert's first demonstrations from what another machine makes."""
    digests = []
    for member, lengths in enumerate(made.lengths):
        steps = member, np.arange(made.obs.shape[2]) < lengths[:, None]
        digests.append(
            _digest(made.obs[steps], made.action[steps], made.next_obs[steps], made.reward[steps])
        )
    return {
        "experts": _digest(expert_file(env_id).read_bytes()),
        "demonstrations": digests,
        "mean_returns": [round(float(mean), 4) for mean in made.returns.mean(1)],
        "mujoco": version("mujoco"),
    }


def _compare(made: Episodes, env_id: str) -> None:
    """Log whether the first demonstrations are other than those that came with the experts.

    It is logged and not warned of, since a warning can be made an error, and nothing is wrong.
    """
    path = expert_file(env_id).with_suffix(".json")
    if not path.is_file():
        return
    there, here = json.loads(path.read_text()), _description(made, env_id)
    members = len(made.returns)
    same_experts = there["experts"] == here["experts"]
    if same_experts and there["demonstrations"][:members] != here["demonstrations"]:
        log.warning(
            "The demonstrations of %s are fine to use, but not byte for byte those of the records: "
            "made with MuJoCo %s, expected %s (another processor rounds differently as well). The "
            "mean return of the first %d is %.4f here, and was %.4f there.",
            env_id,
            here["mujoco"],
            there["mujoco"],
            made.returns.size,
            np.mean(here["mean_returns"]),
            np.mean(there["mean_returns"][:members]),
        )


def _digest(*parts: bytes | np.ndarray) -> str:
    """Return the SHA-256 of some bytes, or of those of arrays."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(np.ascontiguousarray(part) if isinstance(part, np.ndarray) else part)
    return digest.hexdigest()


def from_minari(
    dataset: minari.MinariDataset, env_id: str, trajectories: int | None = None
) -> Demonstrations:
    """Check a Minari data set against a task and return its transitions.

    A data set of another task, which fits this one as well, is taken, and the log says so.

    Raises:
        ModuleNotFoundError: the task's id names a module that is not there.
        ValueError: shapes, ranges, finiteness or episode ends are not what the task makes them. Or
            the task is not known, or its spaces are not what `envs.require_boxes` expects.
    """
    env = _task(env_id)
    obs_space, action_space = env.observation_space, env.action_space
    name = dataset.spec.dataset_id
    if trajectories is not None and dataset.total_episodes < trajectories:
        raise ValueError(
            f"{name}: {trajectories} trajectories were asked for; it has {dataset.total_episodes}: "
            f"give --trajectories {dataset.total_episodes}, or fewer"
        )
    indices = None if trajectories is None else range(trajectories)
    parts = []
    for episode in dataset.iterate_episodes(indices):
        where = f"data set {name}, episode {episode.id}, for the task {env_id}"
        _check(episode, where, obs_space, action_space)
        parts.append(_transitions(episode, action_space))
    made_on = dataset.spec.env_spec and dataset.spec.env_spec.id
    # The module that registers a task may be named before its id.
    if made_on and made_on.split(":")[-1] != env_id.split(":")[-1]:
        # No error, and no warning that can be made one: that may be what is wanted.
        log.warning(
            "The data set %s was made on %s, and is taken for demonstrations of %s. Shapes and "
            "bounds fit, and nothing else tells the two tasks apart: if you did not mean to show "
            "another task, give a data set of %s.",
            name,
            made_on,
            env_id,
            env_id,
        )
    transitions = Batch(*(torch.cat(column) for column in zip(*parts, strict=True)))
    return Demonstrations(env_id, transitions, tuple(len(part.reward) for part in parts))


def _check(
    episode: minari.EpisodeData | EpisodeBuffer,
    where: str,
    obs_space: gymnasium.spaces.Box,
    action_space: gymnasium.spaces.Box,
) -> None:
    steps = len(episode.rewards)
    _expect(steps > 0, where, "at least one step", "none")
    expected = {
        "observations": (episode.observations, (steps + 1, *obs_space.shape)),
        "actions": (episode.actions, (steps, *action_space.shape)),
        "rewards": (episode.rewards, (steps,)),
    }
    for part, (array, shape) in expected.items():
        found = getattr(array, "shape", type(array).__name__)
        _expect(found == shape, where, f"{part} of shape {shape}", found)
        bad = np.argwhere(~np.isfinite(array))
        _expect(
            len(bad) == 0, where, f"finite {part}", f"{len(bad)} that are not, first at {bad[:1]}"
        )
    low, high = action_space.low - 1e-5, action_space.high + 1e-5
    inside = (episode.actions >= low).all() and (episode.actions <= high).all()
    found = f"{episode.actions.min():.6g} to {episode.actions.max():.6g}"
    _expect(inside, where, f"actions in [{action_space.low}, {action_space.high}]", found)
    ends = np.flatnonzero(np.asarray(episode.terminations) | np.asarray(episode.truncations))
    _expect(
        ends.tolist() == [steps - 1],
        where,
        f"one end, terminated or truncated, at its last step ({steps - 1})",
        f"ends at {ends.tolist()}",
    )


def _expect(met: bool, where: str, expected: str, found: object) -> None:
    if not met:
        raise ValueError(f"{where}: expected {expected}; found {found}")


def _transitions(episode: minari.EpisodeData, action_space: gymnasium.spaces.Box) -> Batch:
    low, high = action_space.low, action_space.high
    action = 2 * (np.asarray(episode.actions) - low) / (high - low) - 1

    def tensor(array: Sequence | np.ndarray) -> torch.Tensor:
        return torch.as_tensor(np.asarray(array), dtype=torch.float32)

    return Batch(
        tensor(episode.observations[:-1]),
        unsquash(tensor(action)),
        tensor(episode.observations[1:]),
        tensor(episode.rewards),
        tensor(episode.terminations),
    )


def ship(policy: Policy, seeds: Sequence[int], count: int = 5) -> Path:
    """Make the `count` best members of a trained population the shipped experts of its task.

    They are ranked by the mean return of 20 episodes of their mode, and kept in the order they
    have: put those first that are shipped already, and what imitated the first alone can be done
    again. They are kept in half precision if that changes no expert's mean return over ten episodes
    by more than one per cent.

    Args:
        policy: the population, of at least one member.
        seeds: of its members.
        count: how many to keep, if there are as many.

    Returns:
        Their file; what they do is in the JSON file beside it, see `write_reference`.
    """
    ranking = rollout(policy, policy.env_id, seeds, 20).returns.mean(1)
    kept = policy.member(*np.sort(np.argsort(-ranking)[:count]).tolist())
    rounded = replace(kept, params=kept.params.half().float())
    before, after = _mode_returns(kept), _mode_returns(rounded)
    if (np.abs(after - before) <= 0.01 * np.abs(before)).all():
        kept = replace(kept, params=kept.params.half())
    path = EXPERTS / f"{short_name(policy.env_id)}.safetensors"
    kept.save(path)
    write_reference(policy.env_id)
    return path


def _mode_returns(policy: Policy) -> np.ndarray:
    """Return the mean return of each member's mode over ten episodes."""
    return rollout(policy, policy.env_id, range(len(policy)), 10).returns.mean(1)
