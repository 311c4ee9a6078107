"""Draw the recipe's picture: each robot as its imitator moves it.

The policies are those recorded after 500,000 steps of the recipe, and the
percentages are of what the expert returns without noise.

.venv/bin/python book/_static/robots.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from offairl_lite import demonstrations
from offairl_lite.analysis import films, plots
from offairl_lite.runs import records

BOOK = Path(__file__).parents[1]
# How many steps lie between two pictures.
EVERY = {"Hopper": 25, "Walker2d": 10, "HalfCheetah": 3, "CustomAnt": 4}
BEGIN, SHOWN = 40, 2

with plots.style():
    fig, axes = plt.subplots(
        SHOWN, 4, figsize=(8.2, 4.2), layout="constrained"
    )
    for column, (robot, every) in zip(axes.T, EVERY.items(), strict=True):
        run = records.read(BOOK / f"records/locomotion-demo/{robot}-airl")
        end = run.returns[:, -1]
        median = int(np.argsort(end)[len(end) // 2])
        pictures = films.frames(
            run.policy.member(median),
            run.config.env_id,
            max_steps=every * (BEGIN + SHOWN - 1),
            every=every,
        )[-SHOWN:]
        for ax, picture in zip(column, pictures, strict=True):
            ax.imshow(picture)
            ax.set_axis_off()
        noted = demonstrations.EXPERTS / f"{robot}.json"
        without_noise = records.read_json(noted)["returns"][0]
        share = 100 * end[median] / without_noise
        column[0].set_title(f"{robot}: {share:.0f} %")
    fig.get_layout_engine().set(wspace=0.01, hspace=0.01, w_pad=0, h_pad=0)
    fig.savefig(BOOK / "_static/robots.png", dpi=110)
