"""Episodes in Minari's local storage: written, listed, checked against a task, and read."""

import logging
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import gymnasium
import minari
import numpy as np
import torch
from gymnasium.envs.registration import EnvSpec
from gymnasium.spaces import Box
from jaxtyping import Float
from minari.data_collector.episode_buffer import EpisodeBuffer
from minari.dataset.minari_dataset import parse_dataset_id
from minari.storage import get_dataset_path

from offairl_lite import envs
from offairl_lite.core.policies import unsquash
from offairl_lite.core.replay import Batch

log = logging.getLogger(__name__)


class Recording(NamedTuple):
    """A recorded episode of T steps, with actions in the task's own units.

    `terminated` says whether the task had ended for good; otherwise the recording was cut. Rewards
    are used for `Demonstrations.returns` alone, and may be unknown.
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
    """Write a Minari data set of episodes from anywhere, under a new name such as `own/arm-v0`.

    Raises FileExistsError rather than overwrite, OSError if the storage cannot be written to, and
    ValueError if a recording does not fit the task, or the name or the task is not valid. Nothing
    is written then.
    """
    require_new(dataset_id)
    if not recordings:
        raise ValueError("there are no recordings; expected at least one")
    env, units = closed_task(env_id)
    buffer = []
    for i, (obs, action, terminated, reward) in enumerate(recordings):
        last = np.arange(len(action)) == len(action) - 1
        episode = EpisodeBuffer(
            id=i,
            observations=np.asarray(obs, env.observation_space.dtype),
            actions=np.asarray(action, units.dtype),
            rewards=np.zeros(len(action)) if reward is None else np.asarray(reward),
            terminations=last & terminated,
            truncations=last & (not terminated),
        )
        _check(episode, f"recording {i}, for the task {env_id}", env.observation_space, units)
        buffer.append(episode)
    # Minari stores it, so that the data set can be told from data sets of other tasks.
    env.unwrapped.spec = _storable(envs.spec(env_id))
    with warnings.catch_warnings():
        # Minari asks for an author and a description; this data set stays on this machine.
        warnings.filterwarnings("ignore", r"`(code_permalink|author|author_email)` is set to None")
        warnings.filterwarnings("ignore", "`description` is set to None")
        minari.create_dataset_from_buffers(
            dataset_id,
            buffer,
            env=env.unwrapped,
            eval_env=env.unwrapped,
            observation_space=env.observation_space,
            action_space=units,
            algorithm_name=algorithm,
            description=description,
        )


def read(
    dataset: minari.MinariDataset, env_id: str, trajectories: int
) -> tuple[Batch, tuple[int, ...]]:
    """Return the transitions of the first episodes, axes `N` in order, and each episode's length.

    Actions are scaled to [-1, 1]. A data set that was made on another task is accepted if it fits
    this one, and the log says so. It is a ValueError if there are too few episodes, or if shapes,
    ranges, finiteness or episode ends do not fit the task.
    """
    (env, units), name = closed_task(env_id), dataset.spec.dataset_id
    if dataset.total_episodes < trajectories:
        raise ValueError(
            f"{name}: {trajectories} trajectories were asked for; it has {dataset.total_episodes}: "
            f"give --trajectories {dataset.total_episodes}, or fewer"
        )
    parts = []
    for episode in dataset.iterate_episodes(range(trajectories)):
        where = f"data set {name}, episode {episode.id}, for the task {env_id}"
        _check(episode, where, env.observation_space, units)
        parts.append(_transitions(episode, units))
    made_on = dataset.spec.env_spec and dataset.spec.env_spec.id
    # The module that registers a task may be named before its id.
    if made_on and made_on.split(":")[-1] != env_id.split(":")[-1]:
        # Neither an error nor a warning, which may be turned into an error: it may be intended.
        log.warning(
            f"The data set {name} was made on {made_on}, and is taken for demonstrations of "
            f"{env_id}. Shapes and bounds fit, and nothing else tells the two tasks apart: if you "
            f"did not mean to show another task, give a data set of {env_id}."
        )
    transitions = Batch(*map(torch.cat, zip(*parts, strict=True)))
    return transitions, tuple(len(part.reward) for part in parts)


def local_datasets() -> dict[str, dict[str, Any]]:
    """Return the metadata of each data set in the local storage, by name."""
    with storage_errors():
        return minari.list_local_datasets()


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
            "own/trained-v0"
        ) from error
    with storage_errors():
        path = get_dataset_path(dataset_id)
        tempfile.TemporaryFile(dir=get_dataset_path()).close()
    if path.exists():
        raise FileExistsError(
            f"the data set {dataset_id} exists already, and is not overwritten: choose another "
            f"name, or remove {path}"
        )


def closed_task(env_id: str) -> tuple[gymnasium.Env, Box]:
    """Return a task, closed, and its action space; see `envs.spec` and `envs.require_boxes`."""
    envs.spec(env_id)  # Its error for an unknown task is more helpful than Gymnasium's.
    env = gymnasium.make(env_id)
    env.close()
    return env, envs.require_boxes(env_id, env.observation_space, env.action_space)


def _storable(spec: EnvSpec) -> EnvSpec:
    """Return a specification that Minari can store: the id alone if the rest has no JSON form."""
    try:
        spec.to_json()
    except (TypeError, ValueError):  # An entry point that is a class, or an array among the kwargs.
        return EnvSpec(spec.id)
    return spec


def _check(
    episode: minari.EpisodeData | EpisodeBuffer, where: str, seen: gymnasium.Space, units: Box
) -> None:
    """Raise ValueError unless an episode fits a task; `where` says in the message which one."""

    def expect(met: bool, expected: str, found: object) -> None:
        if not met:
            raise ValueError(f"{where}: expected {expected}; found {found}")

    steps = len(episode.rewards)
    expect(steps > 0, "at least one step", "none")
    shapes = {"observations": (steps + 1, *(seen.shape or ())), "actions": (steps, *units.shape)}
    for part, shape in {**shapes, "rewards": (steps,)}.items():
        array = getattr(episode, part)
        found = getattr(array, "shape", type(array).__name__)
        expect(found == shape, f"{part} of shape {shape}", found)
        bad = np.argwhere(~np.isfinite(array))
        found = f"{len(bad)} that are not, the first at {bad[:1]}"
        expect(len(bad) == 0, f"finite {part}", found)
    actions = np.asarray(episode.actions)
    inside = (actions >= units.low - 1e-5).all() and (actions <= units.high + 1e-5).all()
    found = f"{actions.min():.6g} to {actions.max():.6g}"
    expect(bool(inside), f"actions in [{units.low}, {units.high}]", found)
    ends = np.flatnonzero(np.asarray(episode.terminations) | np.asarray(episode.truncations))
    expected = f"one end, terminated or truncated, at its last step ({steps - 1})"
    expect(ends.tolist() == [steps - 1], expected, f"ends at {ends.tolist()}")


def _transitions(episode: minari.EpisodeData, units: Box) -> Batch:
    """Return an episode's transitions, with actions scaled to [-1, 1]."""
    action = 2 * (np.asarray(episode.actions) - units.low) / (units.high - units.low) - 1
    obs, rewards, ends = episode.observations, episode.rewards, episode.terminations
    parts = (obs[:-1], action, obs[1:], rewards, ends)
    tensors = Batch(*(torch.as_tensor(np.asarray(p), dtype=torch.float32) for p in parts))
    return tensors._replace(pre_tanh=unsquash(tensors.pre_tanh))
