"""Draw the picture of the notes' index: an ant that walks, one that lies.

Both are demonstrations of the first expert of CustomAnt.

.venv/bin/python book/_static/fallen.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import mujoco
import numpy as np

from offairl_lite import demonstrations
from offairl_lite.analysis import plots
from offairl_lite.envs.raycast import render
from offairl_lite.envs.tasks import TASKS

BOOK = Path(__file__).parents[1]
ANT = TASKS["offairl/CustomAnt-v0"]
STEPS = (200, 280, 360)
SIZE = 240

shown = demonstrations.load("offairl/CustomAnt-v0", 50, experts=1)
obs = shown.transitions.obs.view(50, 1_000, -1).numpy()
fallen = int(np.argmin(shown.returns))
model = ANT.model()
data = mujoco.MjData(model)
with plots.style():
    fig, axes = plt.subplots(
        2, len(STEPS), figsize=(6.2, 4.2), layout="constrained"
    )
    for row, which in zip(axes, (0, fallen), strict=True):
        for ax, step in zip(row, STEPS, strict=True):
            # Where the ant is on the plane is not observed.
            data.qpos[2:] = obs[which, step, : model.nq - 2]
            mujoco.mj_kinematics(model, data)
            ax.imshow(render(model, data, SIZE, SIZE, ANT.camera))
            ax.set(xticks=[], yticks=[])
            ax.spines[:].set_visible(False)
        row[0].set_ylabel(f"returns {shown.returns[which]:,.0f}")
    for ax, step in zip(axes[0], STEPS, strict=True):
        ax.set_title(f"step {step}")
    fig.get_layout_engine().set(wspace=0.01, hspace=0.01, w_pad=0, h_pad=0)
    fig.savefig(BOOK / "_static/fallen.png", dpi=110)
