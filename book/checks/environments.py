"""What the appendix on the environments says."""

import numpy as np

from checks import exact, live
from offairl_lite import envs


@exact
def which_tasks_terminate(ends):
    """Hopper, Walker2d and Gymnasium's Ant can terminate, and no other
    task."""
    names = [name for name in ends if ends[name]]
    assert names == ["Hopper", "Walker2d", "Ant"]


@exact
def sizes_of_the_ants(sizes, models):
    """Our ants have 14 bodies and observe 111 numbers, and Gymnasium's
    observes 105."""
    assert sizes["CustomAnt"] == 111
    assert sizes["Ant"] == 105
    assert len(models["offairl/CustomAnt-v0"].body_mass) == 14


@exact
def velocities_are_clipped(bounds):
    """Hopper's and Walker2d's velocities are clipped to ±10, and those of
    no other task."""
    clipped = {
        name: size for name, size in bounds.items() if 0 < size < 1e3
    }
    assert clipped == {"Hopper": 10, "Walker2d": 10}


@live
def the_maze_shows_the_position():
    """An observation of the maze contains the particle's position, and at
    the start that is (0.3, 0)."""
    maze = envs.make("offairl/PointMazeLeft-v0", 1, seed=0)
    assert np.allclose(maze.reset()[0][0], [*envs.models.START, 0])
    assert np.allclose(envs.models.START, [0.3, 0])


@live
def the_world_feels_no_force():
    """Our ants observe contact forces within ±1; those of the world are
    always 0."""
    ant = envs.make("offairl/CustomAnt-v0", 8, seed=0)
    rng = np.random.default_rng(0)
    ant.reset()
    for _ in range(20):
        action = rng.uniform(-1, 1, (8, 8)).astype("f")
        forces = ant.step(action)[0][:, 27:]
    assert (forces[:, :6] == 0).all()
    assert (forces[:, 6:] != 0).any()
    assert np.abs(forces).max() <= 1


@exact
def actions_lie_between_minus_one_and_one(models):
    """Every number of an action lies in [−1, 1]."""
    for model in models.values():
        assert (model.actuator_ctrlrange == [-1, 1]).all()


@exact
def the_order_of_the_motors(orders):
    """Both ants of this book have the same order of motors; in the
    published one each output moves another joint."""
    custom, disabled, released = (
        [joint for joint, _ in order] for order in orders
    )
    assert custom == disabled
    assert all(a != b for a, b in zip(custom, released, strict=True))
    assert released == [*custom[2:], *custom[:2]]


@exact
def two_legs_are_weak(orders):
    """The disabled ant has two weak legs."""
    weak = {joint for joint, gear in orders[1] if gear == 1}
    assert weak == {"hip_3", "ankle_3", "hip_4", "ankle_4"}


@live
def rewards_can_be_computed(errors):
    """The rewards of the mazes, the marshes and our ants can be computed
    from observations and actions."""
    assert len(errors) == 7
    assert max(errors.values()) < 1e-5


@exact
def noise_of_the_resets(models):
    """Resets add noise as the text says: to the velocity of particles, up
    to ±0.005 to Hopper and Walker2d, and up to ±0.1 to the positions of
    all others."""
    rng = np.random.default_rng(0)
    for env_id, task in envs.TASKS.items():
        pairs = [task.noise(rng, models[env_id]) for _ in range(1000)]
        position, velocity = map(np.array, zip(*pairs, strict=True))
        if env_id.startswith("offairl/Point"):
            assert (position == 0).all()
            assert 0.0099 < np.abs(velocity).max() <= 0.01
        elif env_id in ("Hopper-v5", "Walker2d-v5"):
            for part in (position, velocity):
                assert 0.0049 < np.abs(part).max() <= 0.005
        else:
            assert 0.099 < np.abs(position).max() <= 0.1
            assert 0.095 < velocity.std() < 0.105
            assert np.abs(velocity).max() > 0.3


@exact
def where_the_goal_is():
    """The goal is at (0.3, 0.5)."""
    assert np.allclose(envs.models.GOAL, [0.3, 0.5])


@live
def rewired_ants_move_alike(apart, unwired):
    """With its actions in the released order DisabledAntReleased moves as
    DisabledAnt does, and otherwise it does not."""
    assert np.abs(apart).max() < 1e-5
    assert np.abs(unwired).max() > 1e-3
