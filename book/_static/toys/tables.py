"""Write what toys compute with but cannot learn themselves.

`tables` are the rewards of the maze, recorded at the paper's size, five
seeds, on squares, each from 0 to 999. `networks` are the actor and critics
of the pendulum, trained by chapter 4's own cells; each layer has 16-bit
numbers, its weights row by row and then its biases, in units of `scale`.

.venv/bin/python book/_static/toys/tables.py [NAME ...]
"""

import base64
import json
import sys
from pathlib import Path

import nbformat
import numpy as np
import torch
from torch import Generator, Tensor, nn

sys.path.append(str(Path(__file__).parents[2]))
from offairl_lite import plain, tabular
from offairl_lite.runs import records

FOLDER = Path(__file__).parent
CHAPTER = FOLDER.parents[1] / "04_sac_and_the_experts.ipynb"
CELLS = 28
STEPS = 5_000


def rewards() -> list[list[int]]:
    """Return the reward of each seed in each square, row by row."""
    record = records.read(FOLDER.parents[1] / "records/maze-imitation-full")
    positions = tabular.maze(CELLS, "Left").positions
    obs = torch.zeros(1, CELLS**2, 3)
    obs[..., :2] = torch.as_tensor(positions)
    tables = []
    for seed in range(5):
        value = record.reward.member(seed)(obs).view(-1)
        value = (value - value.min()) / (value.max() - value.min())
        tables.append((999 * value).round().int().tolist())
    return tables


def trained(steps: int = STEPS) -> plain.SAC:
    """Train SAC on the pendulum as chapter 4 does, with its first seed."""
    names = vars(plain) | {"np": np, "Tensor": Tensor, "STEPS": steps}
    ids = "ded6c229", "9017047a", "3a93cf83", "d114682e"
    for cell in nbformat.read(CHAPTER, as_version=4).cells:
        if cell.id in ids:
            exec(cell.source, names)
    rng = Generator().manual_seed(0)
    sac = plain.SAC(3, 1, rng)
    for _ in names["train"](sac, plain.update_sac, names["act"], rng):
        pass
    return sac


def layers(net: nn.Module) -> list[dict]:
    """Return a network's layers, rounded, as a toy reads them."""
    written = []
    for layer in net.modules():
        if isinstance(layer, nn.Linear):
            numbers = torch.cat([layer.weight.flatten(), layer.bias])
            scale = numbers.abs().max().item() / (2**15 - 1)
            units = (numbers / scale).round().detach().numpy()
            text = base64.b64encode(units.astype("<i2").tobytes()).decode()
            written.append({"scale": scale, "numbers": text})
    return written


def networks() -> dict:
    """Return the layers of actor and critics."""
    sac = trained()
    critics = [layers(net) for net in sac.critic.nets]
    return {"actor": layers(sac.actor.net), "critics": critics}


FILES = {
    "tables": (
        "rewards that were learned in the maze",
        lambda: {"cells": CELLS, "rewards": rewards()},
    ),
    "networks": ("chapter 4's actor and critics", networks),
}

if __name__ == "__main__":
    for name in sys.argv[1:] or FILES:
        about, compute = FILES[name]
        path = FOLDER / f"{name}.js"
        path.write_text(
            f"// Written by tables.py: {about}.\n"
            f"window.toys.{name} = {json.dumps(compute())};\n"
        )
        print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")
