"""The shapes in signatures are those of the tensors: beartype checks every call of tiny runs."""

import subprocess
import sys

MCP = {"primitives": 3, "trunk_hidden": (8,), "primitive_hidden": (6,), "gate_hidden": (8,)}
HOPPER = {"env_id": "Hopper-v5", "train_every": 20}
CONFIGS = [
    {"reward": "logit-sa", "loss": "airl-mixture"},
    {"reward": "r-sa", "reward_sees": (0, 2), **MCP},
    {"reward": "environment", "temperature": None, "normalise": False},
    {"reward": "gail-survival", "learner": "ppo", "train_every": 30, "replay_size": 60},
    {"reward": "iq-learn"},
    {"ablation": "penalty-on-probability"},
    {**HOPPER, "absorbing": "analytic", "reward": "logit-s", "centre_reward": True},
    {**HOPPER, "absorbing": "bootstrap", "learner": "td3", "reward": "dac"},
    {**HOPPER, "absorbing": "bootstrap", "reward": "sqil"},
    {**HOPPER, "reward": "dac", "ablation": "state-pairs"},
]
PROGRAM = """
import sys
from jaxtyping import install_import_hook

install_import_hook("offairl_lite", "beartype.beartype")
import torch
from offairl_lite import ablations, envs
from offairl_lite.config import CORRECTED
from offairl_lite.core.loop import train
from offairl_lite.core.replay import Batch
from offairl_lite.core.rng import Rng
from offairl_lite.demonstrations import Demonstrations

TINY = {"total_steps": 200, "learning_starts": 100, "batch_size": 5, "eval_every": 200,
        "eval_episodes": 1, "hidden": (8, 6)}
for changes in eval(sys.argv[1]):
    config = CORRECTED.change(**(TINY | changes))
    spaces = envs.make(config.env_id, 1, (0,))
    (obs,), (action,) = (
        x.shape for x in (spaces.single_observation_space, spaces.single_action_space)
    )
    spaces.close()
    now, decided, after = (Rng([0]).normal(200, n)[0] for n in (obs, action, obs))
    ended = torch.zeros(200)
    shown = Batch(now, decided, after, ended.clone(), ended)
    shown = Demonstrations(config.env_id, shown, (100, 100)) if config.imitates else None
    run = train(config, (0, 1, 2), shown, progress=False)
    assert len(run.rows) == 3, changes
print("all shapes are right")
"""


def test_every_call_has_the_shapes_of_its_signature():
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, repr(CONFIGS)], capture_output=True, text=True
    )
    assert done.stdout.strip().endswith("all shapes are right"), done.stderr[-3000:]


def test_a_wrong_shape_is_an_error():
    wrong = PROGRAM.split("TINY =")[0] + (
        "from offairl_lite.core.sac import soft_value\n"
        "soft_value(torch.zeros(2, 3, 4), torch.zeros(3, 1), torch.zeros(3, 5))\n"
    )
    done = subprocess.run([sys.executable, "-c", wrong], capture_output=True, text=True)
    assert "TypeCheckError" in done.stderr
