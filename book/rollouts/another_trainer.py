"""What does a learned reward teach the SAC of Stable-Baselines3?

The lines of `recipe_out.md` that pay it by a reward of the maze, with five
seeds: as they are, and without one of the lines of which the page says what
they do. It needs stable-baselines3, and about 40 seconds of a core for each
seed.
"""

import os
import re
from pathlib import Path
from typing import Any

import numpy as np

BOOK = Path(__file__).parents[1]
SEEDS, EPISODES = range(5), 5
LINES = {
    "nothing": ("", ""),
    "the noise": ("    action_noise=push,\n", ""),
    "train": ("model.train(3000, batch_size=64)\n", ""),
    "VecNormalize": (
        "VecNormalize(DummyVecEnv([task]), norm_reward=False)",
        "DummyVecEnv([task])",
    ),
}
"""What is left out, with its text on the page and what replaces it."""


def program(left_out: str, seed: int) -> str:
    """Return the page's lines for a seed, without one of them."""
    page = (BOOK / "recipe_out.md").read_text("utf-8")
    blocks = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    (code,) = (block for block in blocks if "LearnedReward" in block)
    for old, new in (LINES[left_out], ("seed=0", f"seed={seed}")):
        assert old in code
        code = code.replace(old, new)
    return code


def task_return(names: dict[str, Any]) -> float:
    """Return the trained policy's mean return, by the task's reward."""
    env, model = names["env"], names["model"]
    env.training = False
    returns = []
    for _ in range(EPISODES):
        obs, done, total = env.reset(), [False], 0.0
        while not done[0]:
            action, _ = model.predict(obs, deterministic=True)
            obs, _, done, (info,) = env.step(action)
            total += info["task_reward"]
        returns.append(total)
    env.close()
    return float(np.mean(returns))


def record() -> dict[str, Any]:
    """Return what each seed returns, with all lines and without one."""
    os.chdir(BOOK.parent)  # the page's paths begin there
    result: dict[str, Any] = {}
    for left_out in LINES:
        result[left_out] = []
        for seed in SEEDS:
            exec(program(left_out, seed), names := {})
            result[left_out].append(task_return(names))
            print(left_out, seed, f"{result[left_out][-1]:.1f}", flush=True)
    return result
