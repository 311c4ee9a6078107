"""Write what toys compute with but cannot learn themselves.

The rewards of the maze are those recorded at the paper's size, five seeds,
on squares, each from 0 to 999.

.venv/bin/python book/_static/toys/tables.py
"""

import json
from pathlib import Path

import torch

from offairl_lite import tabular
from offairl_lite.runs import records

FOLDER = Path(__file__).parent
CELLS = 28


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


if __name__ == "__main__":
    content = json.dumps({"cells": CELLS, "rewards": rewards()})
    path = FOLDER / "tables.js"
    path.write_text(
        "// Written by tables.py: rewards that were learned in the maze.\n"
        f"window.toys.tables = {content};\n"
    )
    print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")
