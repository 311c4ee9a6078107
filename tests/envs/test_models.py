"""The models against the published numbers."""

import mujoco
import numpy as np
import pytest

from offairl_lite.envs import models

CUSTOM_ORDER = (4, 1, 2, 3)


@pytest.fixture(scope="module")
def ants():
    return models.ant(False, CUSTOM_ORDER), models.ant(True, CUSTOM_ORDER)


def names(model, kind, count):
    return [mujoco.mj_id2name(model, kind, i) for i in range(count)]


def joints_of_actuators(model):
    joints = names(model, mujoco.mjtObj.mjOBJ_JOINT, model.njnt)
    return [joints[i] for i in model.actuator_trnid[:, 0]]


def masses(model):
    return dict(
        zip(names(model, mujoco.mjtObj.mjOBJ_BODY, model.nbody), model.body_mass, strict=True)
    )


@pytest.mark.parametrize("side", ["Left", "Right"])
def test_maze_physics(side):
    model = models.particle(models.START, side)
    assert model.opt.timestep == 0.01
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER
    np.testing.assert_array_equal(model.opt.gravity, 0)
    assert (model.nq, model.nv, model.nu) == (2, 2, 2)
    np.testing.assert_array_equal(model.dof_damping, 1)
    np.testing.assert_array_equal(model.dof_armature, 0)
    np.testing.assert_array_equal(model.actuator_gear[:, 0], 1)
    np.testing.assert_array_equal(model.actuator_ctrlrange, [[-1, 1], [-1, 1]])
    np.testing.assert_array_equal(model.jnt_axis, [[1, 0, 0], [0, 1, 0]])
    mass = 1000 * 4 / 3 * np.pi * 0.03**3
    assert model.body("particle").mass[0] == pytest.approx(mass)
    assert mass == pytest.approx(0.113, abs=5e-4)
    np.testing.assert_allclose(model.body("particle").pos, [0.3, 0, 0])
    np.testing.assert_allclose(model.body("target").pos, [0.3, 0.5, 0])


def test_maze_touches_only_particle_and_walls():
    model = models.particle(models.START, "Left")
    particle = model.body("particle").geomadr[0]

    def collide(a, b):
        return bool(
            model.geom_contype[a] & model.geom_conaffinity[b]
            or model.geom_contype[b] & model.geom_conaffinity[a]
        )

    touched = [g for g in range(model.ngeom) if g != particle and collide(g, particle)]
    assert len(touched) == 5
    assert (model.geom_type[touched] == mujoco.mjtGeom.mjGEOM_CAPSULE).all()
    np.testing.assert_allclose(model.geom_friction[touched], np.tile([0.5, 0.1, 0.1], (5, 1)))
    np.testing.assert_allclose(model.geom_margin[touched], 0.002)
    np.testing.assert_array_equal(model.geom_condim[touched], 1)
    np.testing.assert_allclose(model.geom_size[touched, 0], 0.02)


def test_the_marsh_is_the_maze_without_barrier_and_stops_nobody():
    model, maze = models.particle(models.WEST, None), models.particle(models.START, "Left")
    np.testing.assert_allclose(model.body("particle").pos, [0.05, 0, 0])
    np.testing.assert_array_equal(model.body("target").pos, maze.body("target").pos)
    np.testing.assert_array_equal(model.body_mass, maze.body_mass)
    np.testing.assert_array_equal(models.walls(None), models.walls("Left")[:4])
    box = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_BOX)
    assert (model.geom_contype[box] == 0).all()
    assert (model.geom_conaffinity[box] == 0).all()
    corners = model.geom_pos[box, :2] + np.array([[-1], [1]]) * model.geom_size[box, :2]
    np.testing.assert_allclose(corners, models.MARSH)
    assert (model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE).sum() == 4


@pytest.mark.parametrize(("side", "gap"), [("Left", (0.4, 0.6)), ("Right", (-0.1, 0.2))])
def test_walls_are_where_walls_says(side, gap):
    model = models.particle(models.START, side)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    capsules = model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE
    centres, axes = data.geom_xpos[capsules], data.geom_xmat[capsules].reshape(-1, 3, 3)[..., 2]
    half = model.geom_size[capsules, 1:2] * axes
    built = np.stack([centres - half, centres + half], axis=1)
    np.testing.assert_allclose(built[..., 2], 0.01, atol=1e-12)
    for segment, expected in zip(built[..., :2], models.walls(side), strict=True):
        np.testing.assert_allclose(
            sorted(map(tuple, segment)), sorted(map(tuple, expected)), atol=1e-9
        )
    barrier = models.walls(side)[-1]
    np.testing.assert_allclose(barrier[:, 1], 0.3)
    covered = sorted(barrier[:, 0])
    np.testing.assert_allclose([-0.1, covered[0], covered[1], 0.6], sorted([-0.1, 0.6, *covered]))
    open_end = (covered[1], 0.6) if side == "Left" else (-0.1, covered[0])
    np.testing.assert_allclose(open_end, gap)


def test_custom_ant_physics(ants):
    model, _ = ants
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    assert model.opt.timestep == 0.01
    assert (model.nq, model.nv, model.nu, model.nbody) == (15, 14, 8, 14)
    np.testing.assert_array_equal(model.actuator_gear[:, 0], 30)
    assert joints_of_actuators(model) == [
        f"{j}_{leg}" for leg in CUSTOM_ORDER for j in ("hip", "ankle")
    ]
    np.testing.assert_allclose(model.qpos0[:7], [0, 0, 0.75, 1, 0, 0, 0])
    for leg, ankle, axis in (
        (1, (30, 70), (-1, 1, 0)),
        (2, (-70, -30), (1, 1, 0)),
        (3, (-70, -30), (-1, 1, 0)),
        (4, (30, 70), (1, 1, 0)),
    ):
        np.testing.assert_allclose(np.rad2deg(model.joint(f"hip_{leg}").range), (-30, 30))
        np.testing.assert_allclose(np.rad2deg(model.joint(f"ankle_{leg}").range), ankle)
        np.testing.assert_allclose(model.joint(f"ankle_{leg}").axis, np.array(axis) / np.sqrt(2))
    assert model.jnt_limited[1:].all()
    assert not model.jnt_limited[0]
    for values in (model.dof_armature, model.dof_damping):
        np.testing.assert_array_equal(values, [0] * 6 + [1] * 8)
    np.testing.assert_allclose(model.geom_friction, np.tile([1.5, 0.5, 0.5], (model.ngeom, 1)))
    np.testing.assert_array_equal(model.geom_condim, 3)
    np.testing.assert_allclose(model.geom_margin, 0.01)
    np.testing.assert_array_equal(model.geom_conaffinity, [1] + [0] * (model.ngeom - 1))

    def capsule(radius, length):
        return 5 * np.pi * (radius**2 * length + 4 / 3 * radius**3)

    assert masses(model)["thigh_1"] == pytest.approx(capsule(0.08, 0.2 * np.sqrt(2)))
    assert masses(model)["shin_1"] == pytest.approx(capsule(0.08, 0.4 * np.sqrt(2)))
    # The eyes and brows carry mass.
    assert masses(model)["torso"] > 5 * 4 / 3 * np.pi * 0.25**3 * 1.01


def test_disabled_ant_differs_in_its_back_legs_only(ants):
    custom, disabled = ants
    assert joints_of_actuators(custom) == joints_of_actuators(disabled)
    weak = np.array(["_3" in name or "_4" in name for name in joints_of_actuators(custom)])
    np.testing.assert_array_equal(disabled.actuator_gear[:, 0], np.where(weak, 1, 30))
    changed = {
        name
        for name, mass in masses(custom).items()
        if mass != pytest.approx(masses(disabled)[name])
    }
    assert changed == {"thigh_3", "thigh_4", "shin_3", "shin_4"}
    for leg in (3, 4):
        np.testing.assert_allclose(np.abs(disabled.body(f"shin_{leg}").pos), [0.1, 0.1, 0])
        np.testing.assert_allclose(np.abs(custom.body(f"shin_{leg}").pos), [0.2, 0.2, 0])
        for limb, length in (("thigh", 0.1), ("shin", 0.2)):
            geom = disabled.body(f"{limb}_{leg}").geomadr[0]
            assert 2 * disabled.geom_size[geom, 1] == pytest.approx(length * np.sqrt(2))
    for field in ("jnt_range", "jnt_axis", "dof_damping", "dof_armature", "actuator_ctrlrange"):
        np.testing.assert_array_equal(getattr(custom, field), getattr(disabled, field))
