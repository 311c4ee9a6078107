"""Draw the recipe's picture: each robot as its imitator moves it.

The policies are those recorded after 500,000 steps of the recipe, and the
percentages are of what the expert returns without noise.

.venv/bin/python book/_static/robots.py
"""

import numpy as np
import strips

from offairl_lite import demonstrations
from offairl_lite.analysis import films
from offairl_lite.runs import records

RUNS = strips.HERE.parent / "records/locomotion-demo"
# How many steps lie between two pictures.
EVERY = {"Hopper": 25, "Walker2d": 10, "HalfCheetah": 3, "CustomAnt": 4}
BEGIN, SHOWN = 40, 2

columns, titles = [], []
for robot, every in EVERY.items():
    run = records.read(RUNS / f"{robot}-airl")
    end = run.returns[:, -1]
    median = int(np.argsort(end)[len(end) // 2])
    pictures = films.frames(
        run.policy.member(median),
        run.config.env_id,
        max_steps=every * (BEGIN + SHOWN - 1),
        every=every,
    )[-SHOWN:]
    columns.append(pictures)
    noted = demonstrations.EXPERTS / f"{robot}.json"
    without_noise = records.read_json(noted)["returns"][0]
    titles.append(f"{robot}: {100 * end[median] / without_noise:.0f} %")
strips.save(
    "robots",
    zip(*columns, strict=True),
    titles=titles,
    labels=[""] * SHOWN,
    size=(8.2, 4.2),
)
