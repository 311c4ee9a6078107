"""Bring the records of runs from format 2 to format 3: `python tools/migrate_records.py FOLDER`.

What a run was given of other runs has other names; run.json speaks of one process; a run whose
seeds were trained by several processes becomes several run folders below the record's folder.
"""

import csv
import io
import json
import sys
from dataclasses import replace
from pathlib import Path

from offairl_lite.core.discriminator import Reward
from offairl_lite.core.policies import Policy
from offairl_lite.runs.records import FORMAT, seeds_name, write_json

NAMES = {"frozen": "frozen_reward", "carried": "pretrained_policy", "guide": "guide"}


def migrate(folder: Path) -> None:
    """Rewrite one record."""
    config = json.loads((folder / "config.json").read_text("utf-8"))
    about = json.loads((folder / "run.json").read_text("utf-8"))
    assert config.pop("format") == 2, folder
    shards, states = config.pop("shards"), about.pop("shards")
    inherited = {NAMES[name]: value for name, value in config.pop("inherited", {}).items()}
    seeds = [seed for shard in shards for seed in shard]
    assert len(states) == len(shards)
    for shard in shards:
        there = folder if len(shards) == 1 else folder / seeds_name(shard)
        there.mkdir(exist_ok=True)
        state = states["-".join(map(str, shard))]
        diverged = {"step": state["step"], "diverged": state["diverged"]}
        if len(shards) > 1:
            diverged |= {"state": state["state"], "wall_s": state["wall_s"]}
        spec = {"format": FORMAT, "config": config["config"], "seeds": shard}
        spec |= {name: value for name, value in config.items() if name != "config"}
        write_json(there / "config.json", {**spec, "inherited": inherited})
        write_json(there / "run.json", about | diverged)
        if len(shards) > 1:
            split(folder, there, seeds, shard)
    if len(shards) > 1:
        for path in folder.iterdir():
            if path.is_file():
                path.unlink()


def split(folder: Path, there: Path, seeds: list[int], shard: list[int]) -> None:
    """Write the rows, the policies and the rewards of some seeds."""
    reader = csv.reader(io.StringIO((folder / "curve.csv").read_text("utf-8")))
    lines = (folder / "curve.csv").read_text("utf-8").splitlines(True)
    kept = [
        line
        for line, row in zip(lines, reader, strict=True)
        if row[0] == "seed" or int(row[0]) in shard
    ]
    (there / "curve.csv").write_text("".join(kept))
    members = [seeds.index(seed) for seed in shard]
    for name, kind in (("policy", Policy), ("reward", Reward)):
        if (folder / f"{name}.safetensors").is_file():
            part = kind.load(folder / f"{name}.safetensors").member(*members)
            replace(part).save(there / f"{name}.safetensors")


if __name__ == "__main__":
    for path in sorted(Path(sys.argv[1]).rglob("config.json")):
        migrate(path.parent)
