"""What the note on the cost of the runs says."""

from checks import recorded
from robot_runs import LOSSES, ROBOTS, VARIANTS


@recorded
def the_grid_is_planned(PLAN):
    """The rows of the four robots and four losses are the whole grid."""
    rows = PLAN[: len(ROBOTS) * len(LOSSES)]
    assert sum(runs for _, _, runs, _ in rows) == len(VARIANTS)


@recorded
def no_more_than_planned(rows):
    """No row has more runs than it plans."""
    assert all(to_run >= 0 for _, to_run, *_ in rows)


@recorded
def nothing_is_left(totals):
    """Nothing of the plan is left."""
    to_run, running, _, _, hours_left = totals
    assert to_run == running == hours_left == 0
