"""What the note on the cost of the runs says."""

from checks import recorded
from offairl_lite.runs import records
from robot_runs import RECORDS


@recorded
def all_runs(found):
    """There are 233 runs, which took 91 hours, most of them of five
    seeds."""
    counts, hours = zip(*found.values(), strict=True)
    assert sum(counts) == 233
    assert round(sum(hours)) == 91
    seeds = [
        len(records.read(path.parent).seeds)
        for path in RECORDS.glob("what-decides-demo/*/run.json")
    ]
    assert set(seeds) == {5}


@recorded
def dearest_and_cheapest(found):
    """The paper's networks took 10 hours for six runs, more than any other
    row; the marsh took 17 minutes."""
    count, hours = found["the paper's networks"]
    assert (count, round(hours)) == (6, 10)
    assert hours == max(hours for _, hours in found.values())
    assert round(60 * found["the marsh"][1]) == 17


@recorded
def small_change(found):
    """The ten dearest of 31 kinds of run took two thirds of the hours, and
    the 21 others a third."""
    hours = sorted(spent for _, spent in found.values())
    assert len(hours) == 31
    assert round(sum(hours[:-10]) / sum(hours), 2) == 0.33


@recorded
def small_runs(found):
    """A run of the grid took 11 minutes on Hopper, 13 on Walker2d, 16 on
    CustomAnt and 20 on HalfCheetah, and there are 24 of each."""
    for robot, minutes in (
        ("Hopper", 11),
        ("Walker2d", 13),
        ("CustomAnt", 16),
        ("HalfCheetah", 20),
    ):
        count, hours = found[f"{robot}, 100,000 steps"]
        assert (count, round(60 * hours / count)) == (24, minutes)
