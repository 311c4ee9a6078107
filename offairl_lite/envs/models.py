"""MuJoCo models of the shifting maze, of the marsh, and of the ants with four and two good legs.

The marsh is this package's own. The numbers of the others are those of Fu, Luo and Levine,
"Learning Robust Rewards with Adversarial Inverse Reinforcement Learning" (2018), as used by Arnob,
"Off-Policy Adversarial Inverse Reinforcement Learning" (2020). Lengths are in metres, angles in
degrees, time in seconds.
"""

from typing import Literal

import mujoco
import numpy as np

Side = Literal["Left", "Right"]

LENGTH = 0.6
"""Upper end of the maze in x and y; the lower end is at -0.1."""
START = np.array([LENGTH / 2, 0.0])
"""Where the particle starts, (2,)."""
GOAL = np.array([LENGTH / 2, LENGTH - 0.1])
"""Centre of the target, (2,)."""
MARSH = np.array([(-0.1, 0.1), (0.4, 0.3)])
"""Lower and upper corner of the marsh, (2, 2)."""
WEST = np.array([0.05, 0.0])
"""Another start on the marsh, from which the straight way to the goal crosses it too, (2,)."""
PARTICLE_RADIUS = 0.03
WALL_RADIUS = 0.02

_PARTICLE = (0.13, 0.35, 0.85, 1.0)
_TARGET = (0.10, 0.75, 0.25, 1.0)
_BORDER = (0.62, 0.64, 0.70, 1.0)
_BARRIER = (0.90, 0.45, 0.35, 1.0)
_GROUND = (0.90, 0.90, 0.87, 1.0)
_MARSH = (0.62, 0.72, 0.60, 1.0)
_ANT = (0.85, 0.62, 0.38, 1.0)
_WEAK_LEG = (0.75, 0.25, 0.22, 1.0)
_WHITE = (1.0, 1.0, 1.0, 1.0)
_BLACK = (0.05, 0.05, 0.05, 1.0)

# Diagonal direction of each leg, and the axis and range of its ankle: the feet point down.
_LEGS = {
    1: ((1, 1), (-1, 1, 0), (30, 70)),
    2: ((-1, 1), (1, 1, 0), (-70, -30)),
    3: ((-1, -1), (-1, 1, 0), (-70, -30)),
    4: ((1, -1), (1, 1, 0), (30, 70)),
}
_BACK_LEGS = (3, 4)


def walls(side: Side | None) -> np.ndarray:
    """Centre lines of the maze's walls: four borders, then the barrier.

    Args:
        side: the side on which the barrier is attached. `"Left"` leaves its gap on the right,
            `"Right"` on the left. None: there is no barrier.

    Returns:
        Segments `(4 or 5, 2, 2)`: wall, end, coordinate (x, y). Every wall is `WALL_RADIUS` thick.

    Raises:
        ValueError: `side` is neither `"Left"` nor `"Right"` nor None.
    """
    if side not in ("Left", "Right", None):
        raise ValueError(f"side must be 'Left' or 'Right', or None, not {side!r}")
    low, high, middle = -0.1, LENGTH, LENGTH / 2
    lines = [
        [(low, low), (high, low)],
        [(high, low), (high, high)],
        [(high, high), (low, high)],
        [(low, high), (low, low)],
    ]
    if side is not None:
        barrier = (low, 2 * LENGTH / 3) if side == "Left" else (LENGTH / 3, high)
        lines.append([(barrier[0], middle), (barrier[1], middle)])
    return np.array(lines)


def point_maze(side: Side) -> mujoco.MjModel:
    """The shifting maze: a particle pushed in the plane, a barrier between it and its target.

    `qpos` is the particle's displacement from `START`, `ctrl` the force along x and y in newtons,
    each limited to [-1, 1].

    Args:
        side: the side on which the barrier is attached.

    Raises:
        ValueError: `side` is neither `"Left"` nor `"Right"`.
    """
    if side is None:
        raise ValueError("side must be 'Left' or 'Right', not None")
    return _particle_in_box(f"PointMaze{side}", walls(side), START).compile()


def point_marsh(start: np.ndarray) -> mujoco.MjModel:
    """The maze's particle and target, and a marsh in place of the barrier: it stops nobody.

    `qpos` is the particle's displacement from its start.

    Args:
        start: where the particle starts, (2,).
    """
    spec = _particle_in_box("PointMarsh", walls(None), start)
    low, high = MARSH
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=(*(low + high) / 2, -PARTICLE_RADIUS),
        size=(*(high - low) / 2, 0.001),
        contype=0,
        conaffinity=0,
        rgba=_MARSH,
    )
    return spec.compile()


def _particle_in_box(name: str, lines: np.ndarray, start: np.ndarray) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.modelname = name
    spec.option.timestep = 0.01
    spec.option.gravity = (0, 0, 0)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    geom = spec.default.geom
    geom.friction, geom.margin, geom.condim = (0.5, 0.1, 0.1), 0.002, 1
    geom.contype, geom.conaffinity = 2, 1
    spec.default.joint.damping[0] = 1

    particle = spec.worldbody.add_body(name="particle", pos=(*start, 0))
    particle.add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=(PARTICLE_RADIUS, 0, 0),
        contype=1,
        density=1000,
        rgba=_PARTICLE,
    )
    for name, axis in (("x", (1, 0, 0)), ("y", (0, 1, 0))):
        particle.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
        _add_motor(spec, name, gear=1)

    target = spec.worldbody.add_body(name="target", pos=(*GOAL, 0))
    target.add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=(0.02, 0, 0),
        contype=0,
        conaffinity=0,
        rgba=_TARGET,
    )
    for index, (end, other) in enumerate(lines):
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=(*end, 0.01, *other, 0.01),
            size=(WALL_RADIUS, 0, 0),
            rgba=_BARRIER if index == 4 else _BORDER,
        )
    # The ground is for the eye only: gravity is off and nothing touches it. It is a body of its own
    # because MuJoCo's rays miss a plane beyond the bounds of the body's other shapes.
    ground = spec.worldbody.add_body(name="ground", pos=(0, 0, -PARTICLE_RADIUS))
    ground.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=(40, 40, 0.1),
        contype=0,
        conaffinity=0,
        rgba=_GROUND,
    )
    return spec


def ant(disabled: bool, actuator_legs: tuple[int, ...]) -> mujoco.MjModel:
    """The ant with motors of gear 30; disabled, its two back legs are short and powerless.

    Args:
        disabled: halve thigh and shin of legs 3 and 4, and give their motors gear 1.
        actuator_legs: the legs 1 to 4 in the order in which an action drives them, hip then ankle.

    Raises:
        ValueError: `actuator_legs` is not an ordering of the legs 1 to 4.
    """
    if sorted(actuator_legs) != sorted(_LEGS):
        raise ValueError(f"actuator_legs must order the legs 1, 2, 3, 4, not {actuator_legs}")
    spec = mujoco.MjSpec()
    spec.modelname = "DisabledAnt" if disabled else "CustomAnt"
    spec.option.timestep = 0.01
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    joint, geom = spec.default.joint, spec.default.geom
    joint.armature, joint.damping[0] = 1, 1
    geom.friction, geom.density, geom.margin = (1.5, 0.5, 0.5), 5, 0.01
    geom.condim, geom.conaffinity = 3, 0

    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=(40, 40, 40),
        conaffinity=1,
        rgba=_GROUND,
    )
    torso = spec.worldbody.add_body(name="torso", pos=(0, 0, 0.75))
    torso.add_joint(
        name="root", type=mujoco.mjtJoint.mjJNT_FREE, armature=0, damping=(0, 0, 0), margin=0.01
    )
    torso.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.25, 0, 0), rgba=_ANT)
    _add_eyes(torso)

    for leg, (direction, ankle_axis, ankle_range) in _LEGS.items():
        weak = disabled and leg in _BACK_LEGS
        colour = _WEAK_LEG if weak else _ANT
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
        _add_capsule(torso, (x, 0, height), (x, depth, height), 0.03, _WHITE)
        _add_capsule(torso, (x, 0, height), (x, depth - 0.02, height), 0.02, _BLACK)
        inner = (x - 0.03 * sign, depth, height + 0.07)
        outer = (x + 0.03 * sign, depth, height + 0.1)
        _add_capsule(torso, inner, outer, 0.02, _BLACK)


def _add_capsule(body, start, end, radius, rgba) -> None:
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=(*start, *end), size=(radius, 0, 0), rgba=rgba
    )


def _add_hinge(body, name, axis, limits) -> None:
    body.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=axis,
        range=limits,
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
    )


def _add_motor(spec, joint, gear) -> None:
    spec.add_actuator(
        name=joint,
        target=joint,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        gear=(gear, 0, 0, 0, 0, 0),
        ctrlrange=(-1, 1),
        ctrllimited=mujoco.mjtLimited.mjLIMITED_TRUE,
    )
