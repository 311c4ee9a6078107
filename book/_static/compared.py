"""Strips of recorded policies, filmed by a camera that stands still."""

from collections.abc import Mapping, Sequence

import numpy as np
import strips

from offairl_lite.core.rollouts import Episodes, rollout
from offairl_lite.envs.tasks import TASKS
from offairl_lite.runs import records


def played(folder: str, rank: int) -> tuple[str, Episodes]:
    """Play an episode of a recorded seed; 0 ranks the lowest return.

    With it comes the id of the task.
    """
    run = records.read(strips.HERE.parent / "records" / folder)
    member = int(np.argsort(run.returns[:, -1])[rank])
    env_id = run.config.env_id
    return env_id, rollout(run.policy.member(member), env_id, (0,), 1)


def filmed(
    folder: str, rank: int, steps: Sequence[int], lead: float, away: float
) -> tuple[str, list[strips.Picture]]:
    """Film a recorded seed with a camera that stands still, `away` metres.

    It looks at a point `lead` metres ahead of where the robot is at the
    first of the steps. With the pictures comes a label for them.
    """
    env_id, episode = played(folder, rank)
    task, obs, at = TASKS[env_id], episode.obs[0, 0], np.array(steps)
    model = task.model()
    # Places follow from velocities, which are observed after positions.
    n = strips.unobserved(model)
    speed = obs[:, model.nq - n : model.nq]
    places = speed.cumsum(0) * model.opt.timestep * task.frame_skip
    x, y, *_ = (*places[at[0]], 0.0)
    camera = task.camera._replace(
        body=0, distance=away, lookat=(x + lead, y, task.camera.lookat[2])
    )
    shot = strips.pictures(task, obs[at], camera, places[at], (280, 210))
    metres, returns = places[-1, 0], episode.returns[0, 0]
    label = f"{metres:z.0f} m,\nreturns {returns:z,.0f}"
    return label.replace("-", "−"), list(shot)


def draw(
    name: str,
    ranks: Mapping[str, int],
    lead: float,
    away: float,
    steps: Sequence[int] = (400, 440, 480),
) -> None:
    """Draw a row of pictures for each folder of a record, as `filmed`."""
    rows = [filmed(*row, steps, lead, away) for row in ranks.items()]
    labels, shots = zip(*rows, strict=True)
    titles = [f"step {step}" for step in steps]
    strips.save(name, shots, titles, labels, size=(4.6, 2.4), dpi=160)
