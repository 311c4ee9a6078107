"""What the note on how the claims are judged says."""

import math

import numpy as np

from checks import exact, recorded
from offairl_lite.analysis.statistics import compare_successes, success_rate
from paper_claims import BAR
from paper_verdicts import CONFIRMED, COULD_NOT_FAIL, SEEDS, at_plateau
from paper_verdicts import recorded as record


@exact
def six_pairs():
    """Six pairs on one side and none on the other have p ≈ 3 %."""
    _, p = compare_successes(np.ones(6), np.zeros(6), paired=True)
    assert math.isclose(p, 2 * 2**-6)
    assert round(p, 2) == 0.03


@exact
def wilson():
    """Wilson's interval is what the formula says, and has a width even if
    all seeds arrive or none does."""
    n, z = 10, 1.959964
    for k in range(n + 1):
        centre = (k + z**2 / 2) / (n + z**2)
        half = z / (n + z**2) * (k * (n - k) / n + z**2 / 4) ** 0.5
        _, low, high = success_rate(np.arange(n) < k)
        assert np.allclose([low, high], [centre - half, centre + half])
        assert high - low > 0.2


@recorded
def claim_8_for_sac(arrived, p, FOUND):
    """Of claim 8 for SAC ten seeds arrive with the expert as guide and
    seven without, p = 0.25."""
    assert [seeds.sum() for seeds in arrived.values()] == [10, 7]
    assert math.isclose(p, 2 * 0.5**3)
    assert math.isclose(FOUND[8][0].chance, p)


@recorded
def claim_4_has_wilsons_interval(FOUND):
    """The share of old policies that arrive has Wilson's interval."""
    assert np.allclose(
        FOUND[4][0].effect[0], success_rate(np.arange(10) < 8)
    )


@recorded
def first_and_second_example(changed, FOUND):
    """Three pairs differ. On CustomAnt Implementation 4 is 28 (−2 to 59)
    above 3 and 153 (79 to 268) above 1, with three small networks."""
    assert changed.sum() == 3
    one, _, three = FOUND[1]
    assert [round(x) for x in one.effect] == [153, 79, 268]
    assert [round(x) for x in three.effect] == [28, -2, 59]
    assert (one.seen, three.seen) == ("as claimed", "unclear")
    assert one.scale.startswith("small, 3 ×")
    assert three.scale.startswith("small, 3 ×")


@recorded
def claim_6_is_confirmed_for_some_steps(FOUND, VERDICTS):
    """Nobody arrives with the gate alone in 30,000 and 15,000 steps, with
    no temperature that runs away, and claim 6 is confirmed by that."""
    assert VERDICTS[6] == CONFIRMED
    assert [found.scale for found in FOUND[6]] == [
        "paper-size, 10 × 30k",
        "paper-size, 10 × 15k",
    ]
    assert all(found.effect[0][0] == 0 for found in FOUND[6])
    assert all(found.runaways == 0 for found in FOUND[6])


@recorded
def claim_4_could_not_fail(VERDICTS):
    """At the first evaluation of the old policies no seed had arrived."""
    assert VERDICTS[4] == COULD_NOT_FAIL
    old = record("maze-retraining/policy", "full")
    assert (old.returns[:, 0] > BAR).sum() == 0


@recorded
def an_old_policy_left_a_plateau():
    """An old policy was at a plateau before its eighth seed arrived."""
    old = record("maze-retraining/policy", "full")
    kept = old.steps <= 52_500
    assert at_plateau(old, 52_500)
    assert (old.returns[:, kept][:, -1] > BAR).sum() == 7
    assert (old.returns[:, -1] > BAR).sum() == 8


@recorded
def all_at_a_plateau(tens, drifts):
    """All runs with paper-size networks and ten seeds have come to a
    plateau."""
    assert len(drifts) == len(tens) > 20
    for run, (end, (_, low, high)) in drifts.items():
        assert len(record(run, "full").seeds) >= SEEDS
        assert max(-low, high) < abs(end) / 10, run


@recorded
def some_still_rise(drifts):
    """Some of these runs still rise clearly, by a few percent."""
    rising = [
        moved / abs(end)
        for end, (moved, low, _) in drifts.values()
        if low > 0
    ]
    assert 3 <= len(rising) < len(drifts)
    assert max(rising) < 0.1
