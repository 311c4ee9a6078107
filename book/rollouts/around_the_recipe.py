"""What rewards pay for the first steps, for the note around the recipe."""

import numpy as np
import torch

from offairl_lite import demonstrations
from offairl_lite.core import absorbing
from offairl_lite.runs import records
from robot_runs import RECIPE, RECORDS

FOLDERS = {
    "whole": "decides-four-whole-demo",
    "ends once": "decides-four-demo",
    "ends 20 times": "decides-four-ends-demo",
}


def record():
    """Return what r pays a step, less its pay in the end, for each seed.

    The steps are the first five of each demonstration, and four of these
    demonstrations taught the reward, whole or thinned.
    """
    starts = {robot: _starts(robot) for robot in ("Hopper", "Walker2d")}
    return {
        kind: {
            robot: _paid(RECORDS / folder / f"{robot}-{RECIPE}", obs)
            for robot, obs in starts.items()
        }
        for kind, folder in FOLDERS.items()
    }


def _starts(robot):
    shown = demonstrations.load(f"{robot}-v5", 50, experts=1)
    first = np.cumsum((0, *shown.lengths))[:-1]
    rows = torch.from_numpy(np.add.outer(first, np.arange(5)).ravel())
    return absorbing.extend(shown.transitions.obs[rows])


def _paid(folder, starts):
    run = records.read(folder)
    both = torch.stack([starts, absorbing.absorbing_state(starts)])
    r = run.reward(both.flatten(0, 1).expand(len(run.seeds), -1, -1))
    there, gone = r.view(len(run.seeds), 2, -1).mean(-1).T
    return there - gone
