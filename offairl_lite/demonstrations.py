"""Expert demonstrations: read from Minari, into which those of the shipped experts are put."""

import hashlib
import json
import logging
import lzma
import shutil
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch
from filelock import FileLock, Timeout
from jaxtyping import Float
from minari.storage import get_dataset_path
from tqdm.auto import tqdm

from offairl_lite import envs, minari_storage
from offairl_lite.config.settings import Count, checked
from offairl_lite.core.policies import Policy
from offairl_lite.core.replay import Batch, pack
from offairl_lite.core.rollouts import Episodes, episode_seeds, faulty, require_actions, rollout
from offairl_lite.minari_storage import Recording, outside, write
from offairl_lite.recordings import from_flat, played, recording_of

EXPERTS = Path(__file__).parent / "experts"  # The folder of the shipped experts.
PURPOSE = 1  #: For `rollouts.episode_seeds`: other episodes than those of evaluations.
ACTIONS = ".actions.xz"  #: The files with the experts' actions, zeros after an episode's end.
BLOCK = 10
"""Number of episodes of each expert that are made side by side, however few are needed: matrix
products of other shapes round differently, and a trajectory would depend on their number."""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Demonstrations:
    """Episodes of an expert, as transitions."""

    env_id: str  #: The task.
    transitions: Batch  #: Axes `N`, in order, with actions scaled to [-1, 1].
    lengths: tuple[int, ...]  #: Number of transitions of each episode.
    whole_returns: tuple[float, ...] | None = None  #: If only some of the episodes' steps are here.
    source: Mapping[str, Any] | None = None
    """`dataset`, `subsample` and `experts` for `load` to load them again, if it has loaded them."""

    @property
    def returns(self) -> np.ndarray:
        """Undiscounted return of each whole episode, even if only some of its steps are here."""
        if self.whole_returns is not None:
            return np.array(self.whole_returns, np.float32)
        return np.array([part.sum() for part in self.transitions.reward.split(self.lengths)])

    def __len__(self) -> int:
        return len(self.lengths)

    def subsample(self, every: int) -> "Demonstrations":
        """Return every k-th transition of each trajectory, from a random one of the first k on.

        Each is returned k times, since it stands for k (Ho and Ermon 2016); a termination is always
        kept, once, since it stands for itself, as in DAC's code.
        """
        checked("every", every, Count)
        kept_rows = []
        for i, (end, length) in enumerate(zip(np.cumsum(self.lengths), self.lengths, strict=True)):
            thinned_end = end - int(self.transitions.terminated[end - 1])
            # A trajectory of fewer than k transitions keeps one of them.
            times = min(every, thinned_end - (end - length))
            offset = np.random.default_rng((0, i)).integers(max(times, 1))
            thinned = np.arange(end - length + offset, thinned_end, every).repeat(times)
            kept_rows.append(np.append(thinned, np.arange(thinned_end, end)))
        taken = torch.from_numpy(np.concatenate(kept_rows))
        transitions = Batch(*(part[taken] for part in self.transitions))
        returns = tuple(self.returns.tolist())
        return Demonstrations(self.env_id, transitions, tuple(map(len, kept_rows)), returns)


def require_demonstrations(demos: Demonstrations, env: envs.BatchedEnv | envs.SerialEnv) -> None:
    """Raise ValueError unless demonstrations, whoever made them, are whole and fit a task."""
    if not isinstance(demos, Demonstrations) or not demos.lengths:
        raise ValueError(f"demonstrations is {demos!r}; expected some of `demonstrations.load`")
    ends = np.cumsum(checked("lengths", demos.lengths, tuple[Count, ...]))
    space, steps = env.single_observation_space, int(ends[-1])
    widths = space.shape, env.single_action_space.shape, space.shape, (), ()
    for name, part, width in zip(Batch._fields, demos.transitions, widths, strict=True):
        kind, shape = getattr(part, "dtype", type(part)), tuple(getattr(part, "shape", ()))
        if kind != torch.float32 or shape != (steps, *width):
            expected = f"expected torch.float32 of shape {(steps, *width)}"
            raise ValueError(f"demonstrations: {name} is {kind} of shape {shape}; {expected}")
    obs, _, next_obs, _, terminated = (part.numpy() for part in demos.transitions)
    wrong = (outside(obs, space) | outside(next_obs, space)).any(1)
    wrong |= faulty(pack(demos.transitions).numpy()).any(1)
    wrong |= (terminated != 0) & (terminated != np.isin(np.arange(steps), ends - 1))
    for at in np.flatnonzero(wrong)[:1]:
        episode = np.searchsorted(ends, at, "right")
        raise ValueError(
            f"demonstrations, episode {episode}: expected finite numbers, observations in {space}, "
            f"and terminated 0, or 1 at the end; found {[part[at] for part in demos.transitions]}"
        )


def expert(env_id: str) -> Policy:
    """Return the shipped experts of a task."""
    return Policy.load(expert_file(env_id))


def expert_file(env_id: str) -> Path:
    """Return the file of the shipped experts; FileNotFoundError lists the tasks that have some."""
    path = EXPERTS / f"{short_name(env_id)}.safetensors"
    # A user's own task, such as `mine/PointMazeLeft-v0`, can have the same short name.
    if not path.is_file() or Policy.load(path).env_id != env_id:
        files = sorted(EXPERTS.glob("*.safetensors"))
        have = ", ".join(Policy.load(file).env_id for file in files) or "none yet"
        raise FileNotFoundError(
            f"no expert is shipped for {env_id} (there are: {have}); give episodes, flat arrays, a "
            "policy, or the id of a Minari data set of your own, or train an expert with "
            f"reward='environment' and have `offairl demos {env_id} --policy RUN --dataset "
            "own/expert-v0` make one"
        )
    return path


def short_name(env_id: str) -> str:
    """Return `PointMazeLeft` for `offairl/PointMazeLeft-v0`."""
    return checked("env_id", env_id, str).split("/")[-1].rsplit("-v", 1)[0]


def load(
    env_id: str,
    trajectories: int | None = None,
    dataset_id: str | None = None,
    subsample: int = 1,
    experts: int | Literal["best"] | None = None,
) -> Demonstrations:
    """Return demonstrations of a task from Minari's local storage.

    The shipped experts' actions, of 50 episodes each, are played again on first use; where they
    lead elsewhere the log says so, and the experts act anew. A trajectory is always the same,
    however many are asked for.

    Args:
        env_id: the task.
        trajectories: the first so many; by default all of a data set, and 50 of the experts.
        dataset_id: a data set of your own; by default the shipped experts demonstrate.
        subsample: k, for every k-th transition, k times (`Demonstrations.subsample`).
        experts: the first few, or the `best`, whose mode returns most; by default all.

    Raises:
        FileNotFoundError: there is no such data set, or no expert to make it.
        OSError: Minari's local storage cannot be used.
        ValueError: the data set does not fit the task, or an argument is not valid.
    """
    trajectories = checked("trajectories", trajectories, Count | None)
    if trajectories is None:
        known = minari_storage.local_datasets() if dataset_id else {}
        trajectories = known.get(dataset_id or "", {}).get("total_episodes", 50)
    subsample = checked("subsample", subsample, Count)
    several = Annotated[int, "of at least 1, or 'best'", lambda n: n >= 1]
    experts = experts if experts == "best" else checked("experts", experts, several | None)
    source = {"dataset": dataset_id, "subsample": subsample, "experts": experts}
    if dataset_id is None:
        dataset_id = _made_by_experts(env_id, trajectories, experts)
    else:
        source["experts"] = None  # A data set of one's own is not made by the shipped experts.
        known = minari_storage.local_datasets()
        if dataset_id not in known:
            raise FileNotFoundError(
                f"Minari has no local data set {dataset_id!r}; in {get_dataset_path()}, which "
                f"MINARI_DATASETS_PATH can set, is {', '.join(known) or 'no data set at all'}. "
                f"Download it with `minari download {dataset_id}`, make one of recordings with "
                "`demonstrations.write`, or have `offairl demos --policy` make one"
            )
        if not {"observation_space", "action_space"} <= known[dataset_id].keys():
            # Minari would make the task, and so import whatever the file names.
            raise ValueError(f"data set {dataset_id}: expected both spaces among its metadata")
    data = Demonstrations(env_id, *minari_storage.read(dataset_id, env_id, trajectories))
    return replace(data if subsample == 1 else data.subsample(subsample), source=source)


def of(
    source: Any,
    env_id: str,
    trajectories: int | None = None,
    subsample: int = 1,
    experts: int | Literal["best"] | None = None,
) -> Demonstrations:
    """Return demonstrations of a task, in whatever form they are given.

    Args:
        source: a list of episodes, each a `Recording`, its parts (obs, action, terminated), named
            arrays, or a `Trajectory` of imitation; flat arrays, or their .npz file, for
            `from_flat`; a Minari data set's name; somebody who acts, whom `record` asks for 50
            episodes: a `Policy`, a function, or a model with `predict`; None for the shipped
            experts; or `Demonstrations`.
        env_id: the task.
        trajectories: the first so many; by default all that are there.
        subsample: as of `load`.
        experts: as of `load`.

    Raises:
        ValueError: what is wrong, and with which recording.
    """
    checked("trajectories", trajectories, Count | None)
    checked("subsample", subsample, Count)
    if isinstance(source, Demonstrations):
        return source
    if isinstance(source, str | Path) and Path(source).suffix == ".npz":
        source = np.load(source)
    if source is None or isinstance(source, str):
        return load(env_id, trajectories, source, subsample, experts)
    if hasattr(source, "predict"):
        model, source = source, lambda obs: model.predict(obs, deterministic=True)[0]
    if isinstance(source, Policy) or callable(source):
        source = record(source, env_id, trajectories or 50)
    if isinstance(source, Mapping):
        source = from_flat(source)
    if not isinstance(source, list | tuple) or not source:
        raise ValueError(
            f"demonstrations are {source!r}; expected a list of episodes, each a Recording or "
            "(obs, action), flat arrays by their names, a Minari data set's name, or a policy"
        )
    limit = envs.spec(env_id).max_episode_steps
    parts = [recording_of(i, one, limit) for i, one in enumerate(source)]
    data = Demonstrations(env_id, *minari_storage.transitions_of(parts[:trajectories], env_id))
    return data if subsample == 1 else data.subsample(subsample)


def _made_by_experts(env_id: str, trajectories: int, experts: int | str | None) -> str:
    """Return the name of the shipped experts' data set, after making it if it is not complete."""
    envs.spec(env_id)  # Refuses an unknown task before experts are looked for.
    policy = expert(env_id)
    file = expert_file(env_id)
    valid = Annotated[int, f"in [1, {len(policy)}], or 'best'", lambda n: 0 < n <= len(policy)]
    if experts == "best":
        members = [int(np.argmax(json.loads(file.with_suffix(".json").read_bytes())["returns"]))]
    else:
        members = [*range(len(policy) if experts is None else checked("experts", experts, valid))]
    content = [part.read_bytes() for part in (file, file.with_suffix(ACTIONS)) if part.is_file()]
    digest, who = hashlib.sha256(b"".join(content)).hexdigest()[:8], "-".join(map(str, members))
    dataset_id = f"offairl/{short_name(env_id)}/experts-{digest}-{who}-of-{trajectories}-v0"

    def complete() -> bool:
        # Minari counts the episodes after it has written them.
        dataset = minari_storage.local_datasets().get(dataset_id, {})
        return dataset.get("total_episodes") == trajectories

    with warnings.catch_warnings():
        # Another process may have begun to write it.
        warnings.filterwarnings("ignore", "Misconfigured dataset")
        if complete():
            return dataset_id
    with minari_storage.storage_errors():
        lock = FileLock(get_dataset_path() / ".offairl.lock")
        try:
            held = lock.acquire(timeout=1)
        except Timeout:
            log.warning(f"waiting for another process that makes demonstrations: {lock.lock_file}")
            held = lock.acquire()
    with held:
        if not complete():
            # No other process is writing, so an incomplete data set was abandoned.
            shutil.rmtree(get_dataset_path(dataset_id), ignore_errors=True)
            generate(policy.member(*members), env_id, trajectories, dataset_id, members)
    return dataset_id


def generate(
    policy: Policy | Callable[[Float[np.ndarray, "O"]], Float[np.ndarray, "A"]],
    env_id: str,
    trajectories: int,
    dataset_id: str,
    members: Sequence[int] | None = None,
    at_least: float | None = None,
) -> None:
    """Write a Minari data set of the first episodes of a policy, or of any function that acts.

    Args:
        policy: a `Policy`, whose actions are sampled, n members in turn; or a function of one
            observation, as the task gives it, to an action in the task's own units: a controller of
            yours, or `lambda obs: model.predict(obs, deterministic=True)[0]`.
        env_id: the task.
        trajectories: how many episodes.
        dataset_id: a new name, such as `own/trained-v0`.
        members: which of the shipped experts the policy's are, whose episodes are shipped.
        at_least: the mean return that you know whoever acts to reach.

    Raises:
        ValueError: an action does not fit the task, with its episode and step; or the episodes
            return less, as those of a model do that was trained under VecNormalize and is used
            without it.
        OSError: as of `minari_storage.write`.
    """
    minari_storage.require_new(dataset_id)  # Before minutes of work.
    recordings = record(policy, env_id, trajectories, members)
    mean = float(np.mean([np.sum(np.asarray(one.reward)) for one in recordings]))
    if at_least is not None and mean < at_least:
        raise ValueError(
            f"the episodes return {mean:.4g} on average, and at_least is {at_least:.4g}: whoever "
            "acts may see observations otherwise than in training (VecNormalize scales them), or "
            "act in other units. Nothing is written"
        )
    by: Any = policy
    if isinstance(policy, Policy):
        by = f"{len(policy)} policies that were trained on {policy.env_id}"
    write(recordings, env_id, dataset_id, description=f"Episodes of {by}.")


def record(
    policy: Policy | Callable[[Float[np.ndarray, "O"]], Float[np.ndarray, "A"]],
    env_id: str,
    trajectories: int,
    members: Sequence[int] | None = None,
) -> list[Recording]:
    """Return the first episodes of a policy, or of any function that acts, as for `generate`."""
    checked("trajectories", trajectories, Count)
    units = envs.spaces(env_id)[1]
    if not isinstance(policy, Policy):
        if not callable(policy):
            raise ValueError(f"policy is {policy!r}; expected a Policy, or a function that acts")
        return played(policy, env_id, units, episode_seeds((0,), trajectories, PURPOSE))
    require_actions(policy, units)
    middle, half = (units.low + units.high) / 2, (units.high - units.low) / 2
    recordings = []
    for i in tqdm(range(trajectories), unit="episode", desc=f"demonstrations of {env_id}"):
        e, member = divmod(i, len(policy))
        if member == e % BLOCK == 0:
            made = first_episodes(policy, env_id, e, members)
        at = member, e % BLOCK
        length = made.lengths[at]
        obs = np.concatenate([made.obs[at][:length], made.next_obs[at][length - 1 : length]])
        # In the task's own units; with bounds -1 and 1 this changes nothing.
        action = np.clip(middle + half * made.action[at][:length], units.low, units.high)
        reward = made.reward[at][:length]
        recordings.append(Recording(obs, action, bool(made.terminated[at]), reward))
    return recordings


def first_episodes(
    policy: Policy, env_id: str, first: int = 0, members: Sequence[int] | None = None
) -> Episodes:
    """Return `BLOCK` episodes of each expert, from episode `first` on; `members` as in `generate`.

    Networks round differently on every processor. MuJoCo does not, so shipped actions are played.
    """
    seeds = range(len(policy)) if members is None else members
    seeding: dict[str, Any] = {"purpose": PURPOSE, "first": first}
    if members is not None and (file := expert_file(env_id).with_suffix(ACTIONS)).is_file():
        with lzma.open(file) as stream:
            actions = np.load(stream)[members, first : first + BLOCK]
        if actions.size:
            made = rollout(policy, env_id, seeds, BLOCK, actions=actions, **seeding)
            noted = json.loads(expert_file(env_id).with_suffix(".json").read_bytes())
            wanted = [noted["demonstrations"][member][first // BLOCK] for member in members]
            if digests(made) == wanted:
                return made
        _say_that_they_differ(env_id)
    return rollout(policy, env_id, seeds, BLOCK, sample=True, **seeding)


@cache
def _say_that_they_differ(env_id: str) -> None:
    """Log, once, that demonstrations are not those of the book."""
    log.warning(
        f"Demonstrations of {env_id} are sampled on this machine, and differ from the book's and "
        "from other machines': the shipped ones (50 of each expert) are too few, or come out "
        "otherwise with this version of MuJoCo or on this kind of processor."
    )


def digests(made: Episodes) -> list[str]:
    """Return the SHA-256 of each expert's episodes."""
    columns = zip(made.obs, made.action, made.next_obs, made.reward, made.running, strict=True)
    rows = [b"".join(part[running].tobytes() for part in parts) for *parts, running in columns]
    return [hashlib.sha256(row).hexdigest() for row in rows]
