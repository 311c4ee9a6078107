"""Draw the picture of the notes' index: an ant that walks, one that lies.

Both are demonstrations of the first expert of CustomAnt.

.venv/bin/python book/_static/fallen.py
"""

import numpy as np
import strips

from offairl_lite import demonstrations
from offairl_lite.envs.tasks import TASKS

ANT = TASKS["offairl/CustomAnt-v0"]
STEPS = (200, 280, 360)

shown = demonstrations.load("offairl/CustomAnt-v0", 50, experts=1)
obs = shown.transitions.obs.view(50, 1_000, -1).numpy()
both = (0, int(np.argmin(shown.returns)))
strips.save(
    "fallen",
    [strips.pictures(ANT, obs[i, STEPS, :], ANT.camera) for i in both],
    titles=[f"step {step}" for step in STEPS],
    labels=[f"returns {shown.returns[i]:,.0f}" for i in both],
    size=(6.2, 4.2),
)
