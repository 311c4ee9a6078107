"""MuJoCo models of the shifting maze, the marsh, and the ants with four and with two good legs.

The maze and the ants are those of Fu, Luo and Levine (2018), as used by Arnob (2020); the marsh is
this package's own. Lengths are in metres, angles in degrees, time in seconds.
"""

from typing import Literal

import mujoco
import numpy as np
from mujoco import mjtGeom, mjtIntegrator, mjtJoint, mjtLimited, mjtTrn

Side = Literal["Left", "Right"]

LENGTH = 0.6  #: Upper end of the maze in x and y; the lower end is at -0.1.
START = np.array([LENGTH / 2, 0.0])  #: Where the particle starts, (2,).
GOAL = np.array([LENGTH / 2, LENGTH - 0.1])  #: Centre of the target, (2,).
MARSH = np.array([(-0.1, 0.1), (0.4, 0.3)])  #: Lower and upper corner of the marsh, (2, 2).
WEST = np.array([0.05, 0.0])  #: Another start, whose straight way crosses the marsh as well, (2,).
PARTICLE_RADIUS = 0.03
WALL_RADIUS = 0.02  #: Half the thickness of a wall.

_GROUND = (0.90, 0.90, 0.87, 1.0)
_ANT = (0.85, 0.62, 0.38, 1.0)
_BLACK = (0.05, 0.05, 0.05, 1.0)
_UNTOUCHED = {"contype": 0, "conaffinity": 0}

# Diagonal direction of each leg, and the axis and range of its ankle: the feet point down.
_LEGS = {
    1: ((1, 1), (-1, 1, 0), (30, 70)),
    2: ((-1, 1), (1, 1, 0), (-70, -30)),
    3: ((-1, -1), (-1, 1, 0), (-70, -30)),
    4: ((1, -1), (1, 1, 0), (30, 70)),
}
_BACK_LEGS = (3, 4)


def walls(side: Side | None) -> np.ndarray:
    """Return the maze's walls as segments `(4 or 5, 2, 2)`: wall, end, coordinate (x, y).

    Four borders, then the barrier, attached on a side: `"Left"` leaves the gap on the right.
    """
    low, high, middle = -0.1, LENGTH, LENGTH / 2
    corners = [(low, low), (high, low), (high, high), (low, high)]
    lines = [[corners[i - 1], corners[i]] for i in (1, 2, 3, 0)]
    if side is not None:
        barrier = (low, 2 * LENGTH / 3) if side == "Left" else (LENGTH / 3, high)
        lines.append([(barrier[0], middle), (barrier[1], middle)])
    return np.array(lines)


def particle(start: np.ndarray, side: Side | None) -> mujoco.MjModel:
    """Return a particle in a box with a target and a barrier or, with None for a side, the marsh.

    `qpos` is its displacement from `start`, (2,), `ctrl` the force along x and y, in newtons.
    """
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.01
    spec.option.gravity = (0, 0, 0)
    spec.option.integrator = mjtIntegrator.mjINT_EULER
    geom = spec.default.geom
    geom.friction, geom.margin, geom.condim = (0.5, 0.1, 0.1), 0.002, 1
    geom.contype, geom.conaffinity = 2, 1
    spec.default.joint.damping[0] = 1
    body = spec.worldbody.add_body(name="particle", pos=(*start, 0))
    solid = {"contype": 1, "density": 1000, "rgba": (0.13, 0.35, 0.85, 1)}
    body.add_geom(type=mjtGeom.mjGEOM_SPHERE, size=(PARTICLE_RADIUS, 0, 0), **solid)
    for name, axis in (("x", (1, 0, 0)), ("y", (0, 1, 0))):
        body.add_joint(name=name, type=mjtJoint.mjJNT_SLIDE, axis=axis)
        _add_motor(spec, name, gear=1)
    target = spec.worldbody.add_body(name="target", pos=(*GOAL, 0))
    target.add_geom(
        type=mjtGeom.mjGEOM_SPHERE, size=(0.02, 0, 0), rgba=(0.1, 0.75, 0.25, 1), **_UNTOUCHED
    )
    for index, (end, other) in enumerate(walls(side)):
        colour = (0.9, 0.45, 0.35, 1) if index == 4 else (0.62, 0.64, 0.7, 1)
        _add_capsule(spec.worldbody, (*end, 0.01), (*other, 0.01), WALL_RADIUS, colour)
    # The ground is only drawn: gravity is off and nothing touches it. It is a body of its own
    # because MuJoCo's rays miss a plane beyond the bounds of the body's other shapes.
    ground = spec.worldbody.add_body(name="ground", pos=(0, 0, -PARTICLE_RADIUS))
    ground.add_geom(type=mjtGeom.mjGEOM_PLANE, size=(40, 40, 0.1), rgba=_GROUND, **_UNTOUCHED)
    if side is None:
        low, high = MARSH
        place = {"pos": (*(low + high) / 2, -PARTICLE_RADIUS), "size": (*(high - low) / 2, 0.001)}
        spec.worldbody.add_geom(
            type=mjtGeom.mjGEOM_BOX, rgba=(0.62, 0.72, 0.6, 1), **place, **_UNTOUCHED
        )
    return spec.compile()


def ant(disabled: bool, actuator_legs: tuple[int, ...]) -> mujoco.MjModel:
    """Return the ant, gear 30; if disabled, its back legs are half as long, with motors of gear 1.

    An action drives the legs in the order of `actuator_legs`, hip before ankle.
    """
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.01
    spec.option.integrator = mjtIntegrator.mjINT_RK4
    joint, geom = spec.default.joint, spec.default.geom
    joint.armature, joint.damping[0] = 1, 1
    geom.friction, geom.density, geom.margin = (1.5, 0.5, 0.5), 5, 0.01
    geom.condim, geom.conaffinity = 3, 0
    floor = {"name": "floor", "size": (40, 40, 40), "conaffinity": 1, "rgba": _GROUND}
    spec.worldbody.add_geom(type=mjtGeom.mjGEOM_PLANE, **floor)
    torso = spec.worldbody.add_body(name="torso", pos=(0, 0, 0.75))
    free = {"armature": 0, "damping": (0, 0, 0), "margin": 0.01}
    torso.add_joint(name="root", type=mjtJoint.mjJNT_FREE, **free)
    torso.add_geom(type=mjtGeom.mjGEOM_SPHERE, size=(0.25, 0, 0), rgba=_ANT)
    _add_eyes(torso)
    for leg, (direction, ankle_axis, ankle_range) in _LEGS.items():
        weak = disabled and leg in _BACK_LEGS
        colour = (0.75, 0.25, 0.22, 1) if weak else _ANT
        x, y = 0.2 * np.array(direction)
        scale = 0.5 if weak else 1.0
        thigh, shin = (scale * x, scale * y, 0), (2 * scale * x, 2 * scale * y, 0)
        limb = torso.add_body(name=f"leg_{leg}")
        _add_capsule(limb, (0, 0, 0), (x, y, 0), 0.08, colour)
        limb = limb.add_body(name=f"thigh_{leg}", pos=(x, y, 0))
        _add_hinge(limb, f"hip_{leg}", (0, 0, 1), (-30, 30))
        _add_capsule(limb, (0, 0, 0), thigh, 0.08, colour)
        limb = limb.add_body(name=f"shin_{leg}", pos=thigh)
        _add_hinge(limb, f"ankle_{leg}", ankle_axis, ankle_range)
        _add_capsule(limb, (0, 0, 0), shin, 0.08, colour)
    for leg in actuator_legs:
        gear = 1 if disabled and leg in _BACK_LEGS else 30
        _add_motor(spec, f"hip_{leg}", gear)
        _add_motor(spec, f"ankle_{leg}", gear)
    return spec.compile()


def _add_eyes(torso) -> None:
    # Eyes and brows are ornaments, but they have mass, as they had in the published model.
    depth, height = -0.21, 0.1
    for sign in (1, -1):
        x = 0.07 * sign
        _add_capsule(torso, (x, 0, height), (x, depth, height), 0.03, (1.0, 1.0, 1.0, 1))
        _add_capsule(torso, (x, 0, height), (x, depth - 0.02, height), 0.02, _BLACK)
        inner = (x - 0.03 * sign, depth, height + 0.07)
        outer = (x + 0.03 * sign, depth, height + 0.1)
        _add_capsule(torso, inner, outer, 0.02, _BLACK)


def _add_capsule(body, start, end, radius, rgba) -> None:
    shape = {"type": mjtGeom.mjGEOM_CAPSULE, "size": (radius, 0, 0)}
    body.add_geom(fromto=(*start, *end), rgba=rgba, **shape)


def _add_hinge(body, name, axis, limits) -> None:
    limited = {"range": limits, "limited": mjtLimited.mjLIMITED_TRUE}
    body.add_joint(name=name, type=mjtJoint.mjJNT_HINGE, axis=axis, **limited)


def _add_motor(spec, joint, gear) -> None:
    limited = {"ctrlrange": (-1, 1), "ctrllimited": mjtLimited.mjLIMITED_TRUE}
    target = {"target": joint, "trntype": mjtTrn.mjTRN_JOINT}
    spec.add_actuator(name=joint, gear=(gear, 0, 0, 0, 0, 0), **target, **limited)
