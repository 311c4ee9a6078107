"""Episodes in Minari's local storage: written, listed, checked against a task, and read."""

import logging
import shutil
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import gymnasium
import minari
import numpy as np
import torch
from gymnasium.envs.registration import EnvSpec
from gymnasium.spaces import Box
from jaxtyping import Float
from minari.data_collector.episode_buffer import EpisodeBuffer
from minari.dataset.minari_dataset import parse_dataset_id
from minari.dataset.minari_storage import MinariStorage
from minari.storage import get_dataset_path

from offairl_lite import envs
from offairl_lite.config.settings import checked
from offairl_lite.core.policies import unsquash
from offairl_lite.core.replay import Batch
from offairl_lite.core.rollouts import FAULTY, faulty

log = logging.getLogger(__name__)

E = TypeVar("E", minari.EpisodeData, EpisodeBuffer)


class Recording(NamedTuple):
    """A recorded episode of T steps, with actions in the task's own units.

    `terminated` says whether the task had ended for good; otherwise the recording was cut. Rewards
    may be unknown. Observations may be dictionaries where the task's are (`envs.flatten`).
    """

    obs: Float[np.ndarray, "T+1 O"]
    action: Float[np.ndarray, "T A"]
    terminated: bool = False
    reward: Float[np.ndarray, "T"] | None = None


def write(
    recordings: Sequence[Recording], env_id: str, dataset_id: str, *, description: str | None = None
) -> None:
    """Write a Minari data set of episodes from anywhere.

    Args:
        recordings: the episodes.
        env_id: their task.
        dataset_id: a new name, such as `own/arm-v0`.
        description: in a sentence.

    Raises:
        FileExistsError: there is such a data set.
        OSError: the storage cannot be written to.
        ValueError: a recording does not fit the task, or an argument is not valid.
    """
    require_new(dataset_id)
    if not isinstance(recordings, Sequence) or not recordings:
        raise ValueError(f"recordings is {recordings!r}; expected a list of at least one Recording")
    buffer = _episodes(recordings, env_id)
    env, seen, units = closed_task(env_id)
    # Minari stores it, so that the data set can be told from data sets of other tasks.
    env.unwrapped.spec = _storable(envs.spec(env_id))
    with warnings.catch_warnings(), ExitStack() as undo:
        undo.callback(shutil.rmtree, get_dataset_path(dataset_id), ignore_errors=True)
        # Minari asks for an author and a description; this data set stays on this machine.
        unset = "`(code_permalink|author|author_email|description)` is set to None"
        warnings.filterwarnings("ignore", unset)
        minari.create_dataset_from_buffers(
            dataset_id,
            buffer,
            env=env.unwrapped,
            eval_env=env.unwrapped,
            observation_space=seen,
            action_space=units,
            algorithm_name="unknown",
            description=description,
        )
        undo.pop_all()  # It is whole, and stays.


def _episodes(recordings: Sequence[Recording], env_id: str) -> list[EpisodeBuffer]:
    """Return recordings as Minari's episodes; ValueError says what does not fit the task."""
    seen, units = envs.spaces(env_id)
    episodes, clipped = [], []
    for i, recording in enumerate(recordings):
        where = f"recording {i}, for the task {env_id}"
        with _reading(where):
            if isinstance(recording, Recording):
                recording = recording._replace(obs=envs.flatten(env_id, recording.obs))
            episode = _episode(i, recording, seen, units)
        episodes.append(_within_bounds(episode, where, seen, units, env_id))
        clipped.append(episodes[-1].actions - episode.actions)
    _say_what_is_clipped(clipped, env_id)
    return episodes


def transitions_of(recordings: Sequence[Recording], env_id: str) -> tuple[Batch, tuple[int, ...]]:
    """Return what `read` returns, of recordings that are in no data set."""
    units = envs.spaces(env_id)[1]
    parts = [_transitions(episode, units) for episode in _episodes(recordings, env_id)]
    return Batch(*map(torch.cat, zip(*parts, strict=True))), tuple(len(p.reward) for p in parts)


def _episode(i: int, recording: Recording, seen: Box, units: Box) -> EpisodeBuffer:
    """Return recording i as Minari's episode, in the task's types where it has them."""
    if not isinstance(recording, Recording):
        type_name = type(recording).__name__
        raise TypeError(f"it is a {type_name}; expected a Recording(obs, action, terminated=...)")
    obs, action, terminated, reward = recording
    checked("terminated", terminated, bool)
    if action is None:
        raise TypeError("action is None; expected (T, A), such as zeros if they are not known")
    steps = len(np.atleast_1d(action))
    reward = np.zeros(steps) if reward is None else reward
    arrays = []
    for part, dtype in ((obs, seen.dtype), (action, units.dtype), (reward, float)):
        array = np.asarray(part)
        if np.can_cast(array.dtype, dtype, "same_kind"):
            with np.errstate(over="ignore"):  # What is too large becomes infinite, and is found.
                array = array.astype(dtype)
        arrays.append(array)
    last = np.arange(steps) == steps - 1
    return EpisodeBuffer(i, None, None, *arrays, last & terminated, last & (not terminated))


def read(dataset_id: str, env_id: str, trajectories: int) -> tuple[Batch, tuple[int, ...]]:
    """Return the transitions of a data set's first episodes, axes `N`, and each episode's length.

    Actions are scaled to [-1, 1]. What was made on another task is accepted if it fits, and logged.

    Args:
        dataset_id: its name.
        env_id: the task.
        trajectories: how many episodes.

    Raises:
        ValueError: there are too few, a file is damaged, or something does not fit the task.
    """
    seen, units = envs.spaces(env_id)
    with _reading(f"data set {dataset_id}"):
        dataset = minari.load_dataset(dataset_id)
    if dataset.total_episodes < trajectories:
        raise ValueError(
            f"{dataset_id}: {trajectories} trajectories were asked for; it has "
            f"{dataset.total_episodes}: give trajectories={dataset.total_episodes}, or fewer"
        )
    if made_on := _other_task(dataset.spec.env_spec, env_id):
        # Neither an error nor a warning, which may be turned into an error: it may be intended.
        log.warning(
            f"The data set {dataset_id} was made on {made_on}, and is taken for demonstrations of "
            f"{env_id}. Where shapes and bounds fit, nothing else tells the two tasks apart: if "
            f"you did not mean that, give a data set of {env_id}, or that task (one with arguments "
            "has to be registered with them, under an id of your own)."
        )
    parts, clipped = [], []
    for i in range(trajectories):
        where = f"data set {dataset_id}, episode {i}, for the task {env_id}"
        with _reading(where):
            (episode,) = dataset.iterate_episodes([i])
            flat = envs.flatten(env_id, episode.observations)
            episode = replace(episode, observations=flat)
        within = _within_bounds(episode, where, seen, units, env_id)
        parts.append(_transitions(within, units))
        clipped.append(np.asarray(within.actions) - episode.actions)
    _say_what_is_clipped(clipped, env_id)
    transitions = Batch(*map(torch.cat, zip(*parts, strict=True)))
    return transitions, tuple(len(part.reward) for part in parts)


def _other_task(made_on: EnvSpec | None, env_id: str) -> str:
    """Return what a data set was made on if that is not `env_id`: its id, or its arguments."""
    if made_on is None:
        return ""
    # As a data set keeps it, where tuples are lists.
    here = EnvSpec.from_json(_storable(envs.spec(env_id)).to_json())
    # The module that registers a task may be named before its id; a picture changes no step.
    name, has = made_on.id.split(":")[-1], here.kwargs
    changed = {k: v for k, v in made_on.kwargs.items() if k != "render_mode" and v != has.get(k)}
    if name == here.id:
        return f"{name} with {changed}" * bool(changed)
    family = name.rpartition("-v")[0] == here.id.rpartition("-v")[0]
    return name + ", another version of the task" * family


@contextmanager
def _reading(where: str) -> Iterator[None]:
    """Turn whatever NumPy, Minari and HDF5 raise on odd or damaged data into a ValueError."""
    try:
        yield
    except Exception as error:
        raise ValueError(f"{where}, cannot be read: {type(error).__name__}: {error}") from error


def local_datasets() -> dict[str, dict[str, Any]]:
    """Return the metadata of each data set in the local storage, by name."""
    datasets = {}
    with storage_errors():
        for path in sorted((root := get_dataset_path()).rglob("data/metadata.json")):
            name = path.parent.parent.relative_to(root).as_posix()
            try:
                parse_dataset_id(name)
                metadata = MinariStorage.read_raw_metadata(path.parent)
                if metadata["dataset_id"] != name:
                    raise ValueError(f"it is of {metadata['dataset_id']}")
            except (KeyError, TypeError, ValueError) as error:
                log.warning(f"{path.parent.parent} is no Minari data set, and is left out: {error}")
            else:
                datasets[name] = metadata
    return datasets


@contextmanager
def storage_errors() -> Iterator[None]:
    """Turn an OSError about Minari's local storage into one that says what to do."""
    try:
        yield
    except OSError as error:
        raise OSError(
            f"demonstrations are kept in Minari's local storage, which cannot be used: {error}; "
            "set MINARI_DATASETS_PATH to a folder that can be written to"
        ) from error


def require_new(dataset_id: str) -> None:
    """Raise FileExistsError, OSError or ValueError unless a data set can get this name."""
    try:
        parse_dataset_id(dataset_id)
    except (TypeError, ValueError) as error:  # A TypeError if there is no version, such as -v0.
        raise ValueError(
            f"{dataset_id!r} is not a valid name of a Minari data set; expected a name such as "
            "own/trained-v0: letters, digits, - and _, each part at least two, and a version"
        ) from error
    with storage_errors():
        path = get_dataset_path(dataset_id)
        tempfile.TemporaryFile(dir=get_dataset_path()).close()
    if path.exists():
        raise FileExistsError(
            f"the data set {dataset_id} exists already, and is not overwritten: choose another "
            f"name, or remove {path}"
        )


def closed_task(env_id: str) -> tuple[gymnasium.Env, Box, Box]:
    """Return a task, closed, and its spaces; see `envs.spec` and `envs.require_boxes`."""
    envs.spec(env_id)  # Its error for an unknown task is more helpful than Gymnasium's.
    with envs.own_code(env_id, "making"):
        env = gymnasium.make(env_id)
    env.close()
    return env, *envs.require_boxes(env_id, env.observation_space, env.action_space)


def _storable(spec: EnvSpec) -> EnvSpec:
    """Return a specification that Minari can store: the id alone if the rest has no JSON form."""
    try:
        spec.to_json()
    except (TypeError, ValueError):  # An entry point that is a class, or an array among the kwargs.
        return EnvSpec(spec.id)
    return spec


def _check(episode: minari.EpisodeData | EpisodeBuffer, where: str, seen: Box, units: Box) -> None:
    """Raise ValueError unless an episode fits a task; `where` says in the message which one."""

    def expect(met: bool, expected: str, actual: object) -> None:
        if not met:
            raise ValueError(f"{where}: expected {expected}; found {actual}")

    steps = len(np.atleast_1d(episode.terminations))
    expect(steps > 0, "at least one step", "none")
    spaces = {"observations": seen, "actions": units}
    shapes = {"observations": (steps + 1, *seen.shape), "actions": (steps, *units.shape)}
    shapes |= dict.fromkeys(("rewards", "terminations", "truncations"), (steps,))
    for part, shape in shapes.items():
        array = getattr(episode, part)
        if isinstance(array, dict):
            names = ", ".join(map(str, array))
            expect(False, f"{part} of shape {shape}, as the task has", f"a dictionary of {names}")
        actual = getattr(array, "shape", type(array).__name__)
        rule = "; T actions go with T + 1 observations" * (part == "observations")
        expect(actual == shape, f"{part} of shape {shape}", f"{actual}{rule}")
        expect(array.dtype.kind in "biuf", f"{part} that are numbers", array.dtype)
        bad = np.argwhere(faulty(array))
        actual = f"{len(bad)} {FAULTY}, the first at {bad[:1]}: {array[tuple(bad[:1].T)]}"
        expect(not len(bad), f"finite {part}", actual)
    for part, space in spaces.items():
        array = getattr(episode, part)
        for step, i in np.argwhere(outside(array, space))[:1]:
            cure = "mend it, or the task's space"
            if part == "actions":
                cure = "np.clip it if the robot did; this task, which was tried, does not clip"
            actual = f"{array[step, i]:.6g} in step {step}: {cure}"
            expect(False, f"{part}[{i}] in [{space.low[i]:.6g}, {space.high[i]:.6g}]", actual)
    ends = np.flatnonzero(np.any([episode.terminations, episode.truncations], 0))
    expected = f"one end, terminated or truncated, at its last step ({steps - 1})"
    actual = f"ends at {ends.tolist()}" if len(ends) else "no end: mark the last step as truncated"
    expect(ends.tolist() == [steps - 1], expected, actual)


def outside(array: np.ndarray, space: Box) -> np.ndarray:
    """Tell which numbers are beyond a space's bounds, by more than rounding."""
    below, above = (1e-5 * np.maximum(1, abs(bound)) for bound in (space.low, space.high))
    return (array < space.low - below) | (array > space.high + above)


def _within_bounds(episode: E, where: str, seen: Box, units: Box, env_id: str) -> E:
    """Return an episode that fits a task, its actions clipped where the task clips them itself."""
    actions = np.asarray(episode.actions)
    if actions.shape[1:] == units.shape and actions.dtype.kind in "biuf" and actions.size:
        beyond = outside(actions, units).any(1)
        if beyond.any() and not faulty(actions).any() and _clips(env_id, actions[beyond]):
            clipped = np.clip(actions, units.low, units.high).astype(actions.dtype)
            episode = replace(episode, actions=clipped)
    _check(episode, where, seen, units)
    return episode


def _say_what_is_clipped(differences: Sequence[np.ndarray], env_id: str) -> None:
    """Log by how much the actions of episodes were beyond the bounds, if any was."""
    beyond = [np.abs(episode).max(1, initial=0) for episode in differences]
    if (excess := np.concatenate(beyond)).any():
        log.warning(
            f"{env_id}: actions in {(excess > 0).sum()} of {len(excess)} steps, of "
            f"{sum(map(np.any, beyond))} of {len(beyond)} episodes, are out of bounds, by up to "
            f"{excess.max():.3g}. The task clips them, as playing them both ways shows, and so "
            "they are clipped here"
        )


def _clips(env_id: str, actions: Float[np.ndarray, "T A"]) -> bool:
    """Tell whether a task itself clips actions: whether they lead where the clipped ones lead."""
    with suppress(Exception), ExitStack() as stack:  # One that refuses them does not clip.
        both = [stack.enter_context(closing(gymnasium.make(env_id))) for _ in range(2)]
        bounds: Any = both[0].action_space
        ended = True
        for action in actions[:1000]:
            if ended:
                for env in both:
                    env.reset(seed=0)
            pair = action.astype(bounds.dtype), np.clip(action, bounds.low, bounds.high)
            one, other = (env.step(x) for env, x in zip(both, pair, strict=True))
            first, second = (envs.flatten(env_id, step[0]) for step in (one, other))
            if not np.array_equal(first, second) or one[2:4] != other[2:4]:
                return False
            ended = bool(one[2] or one[3])
        return True
    return False


def _transitions(episode: minari.EpisodeData, units: Box) -> Batch:
    """Return an episode's transitions, with actions scaled to [-1, 1]."""
    action = 2 * (np.asarray(episode.actions) - units.low) / (units.high - units.low) - 1
    obs, rewards, ends = episode.observations, episode.rewards, episode.terminations != 0
    parts = (obs[:-1], action, obs[1:], rewards, ends)
    tensors = Batch(*(torch.as_tensor(np.asarray(p), dtype=torch.float32) for p in parts))
    return tensors._replace(pre_tanh=unsquash(tensors.pre_tanh))
