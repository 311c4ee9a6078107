"""What the note on one fallen ant says."""

import numpy as np

import rollouts
from checks import recorded
from offairl_lite.analysis.statistics import difference
from robot_runs import WARMUPS, demonstrated

RECIPE, DAC = "recipe, r(s)", "DAC, α = 1"
EXACT, OF_ACTION = "AIRL loss, α = 1, r(s)", "AIRL loss, α = 1, r(s, a)"
MIXTURE, COLD = "mixture, α = 0.2, r(s)", "AIRL loss, α = 0.2, r(s)"
HURT = (
    *(f"mixture-{x}-short" for x in ("fixed", "learned", "one")),
    *(f"mixture-{x}-long" for x in ("fixed", "learned", "one")),
    *(f"{x}-one-{w}" for x in ("exact", "dac") for w in WARMUPS),
)


def _ends(returns, setting, episodes):
    return returns[f"{setting}, {episodes}"][:, -1]


def _gain(returns, setting):
    # What leaving out the fallen ant wins at the last evaluation.
    pair = (_ends(returns, setting, x) for x in ("49", "fifty"))
    return [round(x) for x in difference(*pair)]


def _around(ends):
    return [round(ends.min()), round(ends.max())]


@recorded
def one_of_fifty_falls():
    """In one of fifty demonstrations the ant turns over after 269 steps and
    lies for the other 731; it returns 460, the others 1,944 to 2,113."""
    usual = rollouts.read("fallen_ant")
    assert (usual["turns over"], usual["steps on its back"]) == (269, 731)
    assert usual["lowest"] == 460
    assert (usual["second"], usual["highest"]) == (1_944, 2_113)


@recorded
def the_mean_shows_it():
    """The other 49 have the mean return that the usual fifty leave them."""
    others = (50 * demonstrated("CustomAnt") - 460) / 49
    assert 1_944 < others < 2_113
    assert demonstrated("CustomAnt") < others - 30


@recorded
def nine_settings_lose_most(costs):
    """The mixture loses 25 to 52 points, and at 1 the AIRL loss and DAC
    lose 31 to 58, all clearly."""
    hurt = {kind: costs[kind] for kind in HURT if kind in costs}
    assert (len(costs), len(hurt)) == (16, 9)
    for at_end, four in hurt.values():
        assert max(at_end[2], four[2]) < 0
    mixture, others = (
        [
            -round(four[0])
            for kind, (_, four) in hurt.items()
            if kind.startswith("mixture") == is_mixture
        ]
        for is_mixture in (True, False)
    )
    assert (min(mixture), max(mixture)) == (25, 52)
    assert (min(others), max(others)) == (31, 58)


@recorded
def five_settings_lose_less(costs, percent, upright):
    """Five settings lose 0 to 22 points, three of them clearly, and all
    their seeds end at 26 % or more on both sets."""
    rest = [k for k in costs if k not in HURT and "exact" not in k]
    four = [costs[kind][1] for kind in rest]
    sizes = [-round(value) for value, *_ in four]
    assert (len(sizes), min(sizes), max(sizes)) == (5, 0, 22)
    assert sum(high < 0 for *_, high in four) == 3
    assert all(k.endswith("long") for k in rest if "released" in k)
    ends = [
        x[f"CustomAnt-{k}"].min() for x in (percent, upright) for k in rest
    ]
    assert round(min(ends)) == 26


@recorded
def it_ruins_the_exact_logit(returns):
    """With all fifty nine of ten seeds of the AIRL loss at 1 reach 46 %
    and fall back, seven below 24 %, the others to 37 and 56 %."""
    both = [returns[f"{x}, fifty"] for x in (EXACT, OF_ACTION)]
    best = np.concatenate([found.max(1) for found in both])
    last = np.concatenate([found[:, -1] for found in both])
    reached = last[best > 45.5]
    assert len(reached) == 9
    assert (reached < 24).sum() == 7
    assert np.sort(reached)[-2:].round().tolist() == [37, 56]


@recorded
def without_it_the_exact_logit_walks(returns):
    """Without the fallen ant all ten walk, at 53 to 77 %: a gain of 57
    points (22 to 72) for r(s) and of 72 (46 to 76) for r(s, a)."""
    walked = [_ends(returns, x, "49") for x in (EXACT, OF_ACTION)]
    assert _around(np.concatenate(walked)) == [53, 77]
    assert _gain(returns, EXACT) == [57, 22, 72]
    assert _gain(returns, OF_ACTION) == [72, 46, 76]


@recorded
def so_it_does_on_other_episodes(upright):
    """Ten seeds on the fifty other episodes end at 50 to 79 %."""
    ends = [upright[f"CustomAnt-exact-one-{x}"] for x in WARMUPS]
    assert _around(np.concatenate(ends)) == [50, 79]


@recorded
def dac_suffers_at_1(returns):
    """Without the fallen ant DAC ends at 68 to 76 % instead of -1 to 61 %,
    a gain of 44 points (19 to 70)."""
    assert _around(_ends(returns, DAC, "49")) == [68, 76]
    assert _around(_ends(returns, DAC, "fifty")) == [-1, 61]
    assert _gain(returns, DAC) == [44, 19, 70]


@recorded
def it_spoils_the_mixture(returns):
    """Without it all five seeds of the mixture walk, at 49 to 72 %, a gain
    of 59 points (47 to 71)."""
    assert _around(_ends(returns, MIXTURE, "49")) == [49, 72]
    assert _gain(returns, MIXTURE) == [59, 47, 71]


@recorded
def the_recipe_walks_all_the_same(returns):
    """With it the recipe's ants end at 46 % or more. Without it four come
    to 90 %, and the fifth falls back from 87 to 49 %; in the last four the
    recipe gains 14 points (4 to 24)."""
    assert round(_ends(returns, RECIPE, "fifty").min()) == 46
    found = returns[f"{RECIPE}, 49"]
    fell = found[:, -1].argmin()
    assert (found[:, -1].round() >= 90).sum() == 4
    assert round(found[fell].max()) == 87
    assert round(found[fell, -1]) == 49
    four = [
        returns[f"{RECIPE}, {x}"][:, -4:].mean(1) for x in ("49", "fifty")
    ]
    assert [round(x) for x in difference(*four)] == [14, 4, 24]


@recorded
def the_recipe_is_ahead(returns):
    """On the 49 the recipe is ahead of the mixture by 32 points (1 to 42),
    and of the AIRL loss at 0.2 by 83 (52 to 93)."""
    for other, ahead in (MIXTURE, [32, 1, 42]), (COLD, [83, 52, 93]):
        pair = (_ends(returns, x, "49") for x in (RECIPE, other))
        assert [round(x) for x in difference(*pair)] == ahead


@recorded
def at_0_2_the_exact_logit_fails_anyway(returns):
    """At 0.2 the AIRL loss ends below 23 % with and without the fallen
    ant, but for one seed at 44 %."""
    ends = [_ends(returns, COLD, x) for x in ("49", "fifty")]
    *_, second, best = np.sort(np.concatenate(ends))
    assert second < 23
    assert round(best) == 44


@recorded
def the_logit_may_be_involved(logits):
    """With all fifty the mean logit is above 10 in 10 of 100 evaluations of
    the AIRL loss at 1, and without the fallen ant in none."""
    fifty, cured = (
        np.concatenate([logits[f"{x}, {n}"] for x in (EXACT, OF_ACTION)])
        for n in ("fifty", "49")
    )
    assert ((fifty > 10).sum(), len(fifty)) == (10, 100)
    assert cured.max() < 10


@recorded
def five_fall_back_without(returns, logits):
    """Five of the nine that fall back never show such a logit."""
    back = [
        (label, seed)
        for label in (f"{EXACT}, fifty", f"{OF_ACTION}, fifty")
        for seed in range(5)
        if returns[label][seed].max() > 45.5
        and logits[label][seed::5].max() < 10
    ]
    assert len(back) == 5
