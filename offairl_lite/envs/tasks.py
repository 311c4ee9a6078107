"""The tasks, each defined once, for n simulations along a leading axis.

The mazes and the ants with strong and with weak legs follow Arnob (2020). Half cheetah, hopper,
walker and ant equal Gymnasium's `v5` to the last bit: operations and draws have the same order.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import gymnasium
import mujoco
import numpy as np

from offairl_lite.envs import models
from offairl_lite.envs.raycast import Camera


class Physics(NamedTuple):
    """The state from which observations and rewards are computed, for n simulations."""

    qpos: np.ndarray  #: Generalised positions, (n, nq).
    qvel: np.ndarray  #: Generalised velocities, (n, nv).
    torso: np.ndarray
    """x and y of body 1 as MuJoCo leaves them after a step, one substep late, (n, 2)."""
    contact: np.ndarray
    """External forces on every body, clipped to [-1, 1], (n, nbody, 6); zero after a reset, and
    always for a task without `contact_forces`."""


Noise = Callable[[np.random.Generator, mujoco.MjModel], tuple[np.ndarray, np.ndarray]]


def _never(physics: Physics) -> np.ndarray:
    return np.zeros(len(physics.qpos), bool)


@dataclass(frozen=True)
class Task:
    """A task, as functions of n simulations at once."""

    model: Callable[[], mujoco.MjModel]
    camera: Camera
    noise: Noise
    """Draws what a reset adds to the model's `qpos0`, (nq,), and to zero velocity, (nv,)."""
    observe: Callable[[Physics], np.ndarray]  #: Physics -> observations, (n, O) float64.
    reward: Callable[[Physics, np.ndarray, Physics, float], np.ndarray]
    """Physics before, actions (n, A), physics after, seconds in between -> (n,) float64."""
    terminated: Callable[[Physics], np.ndarray] = _never
    """Physics -> whether the task itself has ended the episode, (n,) bool."""
    frame_skip: int = 5  #: Physics steps in one environment step.
    max_episode_steps: int = 1000
    contact_forces: bool = False  #: Whether `Physics.contact` is computed.


def _uniform_and_normal(rng, model):
    return rng.uniform(-0.1, 0.1, model.nq), 0.1 * rng.standard_normal(model.nv)


def _effort(actions: np.ndarray) -> np.ndarray:
    return np.sum(np.square(actions), axis=1)


def _impact(physics: Physics) -> np.ndarray:
    # Flat rows, so that each sum adds in the order in which Gymnasium's adds.
    return 5e-4 * np.sum(np.square(physics.contact.reshape(len(physics.contact), -1)), axis=1)


def _forward(before: Physics, after: Physics, seconds: float) -> np.ndarray:
    return (after.qpos[:, 0] - before.qpos[:, 0]) / seconds


MARSH_COST = 2.0  #: Of a step that begins in the marsh, besides the distance from the goal.


def in_marsh(position: np.ndarray) -> np.ndarray:
    """Return whether positions `(..., 2 or more)`, in metres, are in the marsh, `(...)` bool."""
    low, high = models.MARSH
    position = position[..., :2]
    return ((position > low) & (position < high)).all(-1)


def _hopper_healthy(physics: Physics) -> np.ndarray:
    height, angle = physics.qpos[:, 1], physics.qpos[:, 2]
    others = np.concatenate([physics.qpos[:, 2:], physics.qvel], axis=1)
    return (height > 0.7) & (np.abs(angle) < 0.2) & (np.abs(others) < 100).all(axis=1)


def _walker_healthy(physics: Physics) -> np.ndarray:
    height, angle = physics.qpos[:, 1], physics.qpos[:, 2]
    return (height > 0.8) & (height < 2.0) & (np.abs(angle) < 1.0)


def _ant_unhealthy(physics: Physics) -> np.ndarray:
    state = np.concatenate([physics.qpos, physics.qvel], axis=1)
    height = physics.qpos[:, 2]
    return ~(np.isfinite(state).all(axis=1) & (height >= 0.2) & (height <= 1.0))


def _ant_reward(before, actions, after, seconds):
    velocity = (after.torso[:, 0] - before.torso[:, 0]) / seconds
    return velocity + ~_ant_unhealthy(after) - (0.5 * _effort(actions) + _impact(after))


def _gymnasium_model(file: str) -> mujoco.MjModel:
    # Gymnasium's half cheetah uses a deprecated attribute: without a handler, MuJoCo would print a
    # warning and write a log file into the working directory.
    handler = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        folder = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"
        return mujoco.MjModel.from_xml_path(str(folder / file))
    finally:
        mujoco.set_mju_user_warning(handler)


def _point(start: np.ndarray, side: models.Side | None = None) -> Task:
    marsh_cost = MARSH_COST if side is None else 0.0

    def observe(physics):
        height = np.zeros((len(physics.qpos), 1))
        return np.concatenate([start + physics.qpos, height], axis=1)

    def reward(before, actions, after, seconds):
        position = start + before.qpos
        distance = np.linalg.norm(position - models.GOAL, axis=1)
        return -distance - 0.001 * _effort(actions) - marsh_cost * in_marsh(position)

    def noise(rng, model):
        return np.zeros(model.nq), rng.uniform(-0.01, 0.01, model.nv)

    camera = Camera(lookat=(0.25, 0.24, 0.0), distance=1.18, elevation=-72, tiles=False)
    model = partial(models.particle, start, side)
    return Task(model, camera, noise, observe, reward, max_episode_steps=100)


def _ant(model: Callable[[], mujoco.MjModel], first_body: int, reward, terminated=_never) -> Task:
    def observe(physics):
        contact = physics.contact[:, first_body:].reshape(len(physics.contact), -1)
        return np.concatenate([physics.qpos[:, 2:], physics.qvel, contact], axis=1)

    camera = Camera(lookat=(0, 0, 0.45), distance=3.6, azimuth=75, elevation=-22, body=1)
    noise = _uniform_and_normal
    return Task(model, camera, noise, observe, reward, terminated, contact_forces=True)


def _custom_ant(disabled: bool, actuator_legs: tuple[int, ...]) -> Task:
    def reward(before, actions, after, seconds):
        flipped = after.qpos[:, 2] < 0.2
        return before.qvel[:, 0] - 0.01 * _effort(actions) - _impact(after) - flipped

    return _ant(partial(models.ant, disabled, actuator_legs), 0, reward)


def _biped(file: str, healthy: Callable[[Physics], np.ndarray]) -> Task:
    def observe(physics):
        return np.concatenate([physics.qpos[:, 1:], np.clip(physics.qvel, -10, 10)], axis=1)

    def reward(before, actions, after, seconds):
        return _forward(before, after, seconds) + healthy(after) - 1e-3 * _effort(actions)

    def noise(rng, model):
        return rng.uniform(-5e-3, 5e-3, model.nq), rng.uniform(-5e-3, 5e-3, model.nv)

    model, ended = partial(_gymnasium_model, file), lambda physics: ~healthy(physics)
    camera = Camera(lookat=(0.0, 0.0, 0.8), distance=3.2, elevation=-12, body=1)
    return Task(model, camera, noise, observe, reward, ended, frame_skip=4)


def _half_cheetah() -> Task:
    def observe(physics):
        return np.concatenate([physics.qpos[:, 1:], physics.qvel], axis=1)

    def reward(before, actions, after, seconds):
        return _forward(before, after, seconds) - 0.1 * _effort(actions)

    model = partial(_gymnasium_model, "half_cheetah.xml")
    camera = Camera(lookat=(0.0, 0.0, 0.45), distance=3.0, elevation=-12, body=1)
    return Task(model, camera, _uniform_and_normal, observe, reward)


TASKS: dict[str, Task] = {
    "offairl/PointMazeLeft-v0": _point(models.START, "Left"),
    "offairl/PointMazeRight-v0": _point(models.START, "Right"),
    "offairl/CustomAnt-v0": _custom_ant(disabled=False, actuator_legs=(4, 1, 2, 3)),
    "offairl/DisabledAnt-v0": _custom_ant(disabled=True, actuator_legs=(4, 1, 2, 3)),
    # As released: an actor trained on CustomAnt drives the wrong joints here.
    "offairl/DisabledAntReleased-v0": _custom_ant(disabled=True, actuator_legs=(1, 2, 3, 4)),
    "offairl/PointMarsh-v0": _point(models.START),
    "offairl/PointMarshWest-v0": _point(models.WEST),
    "HalfCheetah-v5": _half_cheetah(),
    "Hopper-v5": _biped("hopper.xml", _hopper_healthy),
    "Walker2d-v5": _biped("walker2d_v5.xml", _walker_healthy),
    "Ant-v5": _ant(partial(_gymnasium_model, "ant.xml"), 1, _ant_reward, _ant_unhealthy),
}
"""The eight tasks of the paper, DisabledAnt with the actuator order of the released code, and the
marsh from two starts."""
