"""Draw the recipe's picture: each robot as its imitator moves it.

The policies are those recorded after 500,000 steps of the recipe.

.venv/bin/python book/_static/robots.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from offairl_lite import demonstrations
from offairl_lite.analysis import films, plots
from offairl_lite.runs import records

BOOK = Path(__file__).parents[1]
BEGIN, EVERY, SHOWN = 100, 4, 4  # steps, steps, pictures

robots = ("Hopper", "Walker2d", "HalfCheetah", "CustomAnt")
with plots.style():
    fig, axes = plt.subplots(2, 2, figsize=(9, 5.4), layout="constrained")
    for ax, robot in zip(axes.flat, robots, strict=True):
        run = records.read(BOOK / f"records/locomotion-demo/{robot}-airl")
        end = run.returns[:, -1]
        member = int(np.argsort(end)[len(end) // 2])
        pictures = films.frames(
            run.policy.member(member),
            run.config.env_id,
            max_steps=BEGIN + EVERY * (SHOWN - 1),
            every=EVERY,
        )[-SHOWN:]
        width = pictures.shape[2] // 4
        strip = [picture[:, width:-width] for picture in pictures]
        ax.imshow(np.concatenate(strip, 1))
        noted = demonstrations.EXPERTS / f"{robot}.json"
        demonstrated = records.read_json(noted)["demonstrated"][0]
        share = 100 * end[member] / demonstrated
        print(robot, end.round(), round(share))
        ax.set_title(f"{robot}: {share:.0f} % of the demonstrations")
        ax.set_axis_off()
    fig.savefig(BOOK / "_static/robots.png", dpi=110)
