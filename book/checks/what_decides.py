"""What the note on what makes off-policy AIRL work says."""

import numpy as np

from checks import recorded
from offairl_lite import demonstrations
from offairl_lite.analysis.statistics import difference
from offairl_lite.runs import records
from robot_runs import (
    GRID,
    LOSSES,
    OTHERS,
    RECIPE,
    RECORDS,
    ROBOTS,
    VARIANTS,
    WARMUPS,
    demonstrated,
    ended,
    last_four,
    tried,
)


def _clear(one, other):
    # 1 or -1 if the one is clearly better or worse than the other, else 0.
    _, low, high = difference(one, other)
    return int(low > 0) - int(high < 0)


def _rounded(numbers):
    return [round(x) for x in numbers]


@recorded
def a_grid_of_96(percent):
    """The grid has 96 runs, and every run that is drawn has five seeds."""
    assert len(percent) == len(VARIANTS) == 96
    for place in RECORDS.glob("*decides-*demo"):
        if "-more-" not in place.name:
            for folder in place.glob("*-*-*-*"):
                seeds = records.RunSpec.read(folder).seeds
                assert seeds == (0, 1, 2, 3, 4)


@recorded
def hopper_is_better_without_noise():
    """Hopper's most probable actions return half as much again."""
    noted = records.read_json(demonstrations.EXPERTS / "Hopper.json")
    assert 1.45 < noted["returns"][0] / demonstrated("Hopper") < 1.55


@recorded
def at_0_2_the_exact_logit_fails(percent):
    """At 0.2 the exact logit is clearly worse than the recipe on every
    robot; its best seeds are at 13 % (Hopper), 26 % (Walker2d) and below 0
    (HalfCheetah)."""
    for robot in ROBOTS:
        exact = percent[f"{robot}-exact-fixed-short"]
        assert _clear(percent[f"{robot}-{RECIPE}"], exact) == 1
    best = [percent[f"{x}-exact-fixed-short"].max() for x in ROBOTS[:3]]
    assert _rounded(best[:2]) == [13, 26]
    assert best[2] < 0


@recorded
def only_the_recipe_moves_all_robots(percent):
    """The recipe's worst seeds are at 101, 49, 59 and 46 %. All other
    settings have one at 24 % or below, the best of them DAC with the same
    temperature and random steps."""
    worst = [percent[f"{robot}-{RECIPE}"].min() for robot in ROBOTS]
    assert _rounded(worst) == [101, 49, 59, 46]
    settings = {name.split("-", 1)[1] for name in percent}
    least = {
        each: min(percent[f"{robot}-{each}"].min() for robot in ROBOTS)
        for each in settings
    }
    *_, second, first = sorted(least, key=least.__getitem__)
    assert (first, second) == (RECIPE, "dac-fixed-short")
    assert round(least[second]) == 24


@recorded
def one_change_at_a_time(percent):
    """Which medians the AIRL loss has in the recipe; what 1 and 10,000
    random steps do instead has its own statement."""
    ends = [percent[f"{robot}-exact-fixed-short"] for robot in ROBOTS]
    assert _rounded(map(np.median, ends)) == [0, 9, -3, 1]


@recorded
def yardsticks():
    """A hopper that stands still is at about 50 %, a walker at about 25."""
    stand = {robot: 1e5 / demonstrated(robot) for robot in ROBOTS[:2]}
    assert 45 < stand["Hopper"] < 55
    assert 20 < stand["Walker2d"] < 30


@recorded
def ten_seeds_of_walker():
    """With ten seeds 10,000 random steps cost Walker2d 51 points at the
    last evaluation and 40 over the last four."""
    folders = [
        [
            f"what-decides-{home}/Walker2d-released-fixed-{warmup}"
            for home in ("demo", "more-demo")
        ]
        for warmup in WARMUPS
    ]
    for over, cost in (ended, 51), (last_four, 40):
        both = [over(*names) for names in folders]
        assert [len(ends) for ends in both] == [10, 10]
        assert round(difference(*both)[0]) == cost


@recorded
def four_ants_of_five_fail(percent):
    """Four ants stay below 5 % with the exact logit at 0.2, and one reaches
    44 %."""
    ends = percent["CustomAnt-exact-fixed-short"]
    assert (ends < 5).sum() == 4
    assert round(ends.max()) == 44


@recorded
def nothing_rescues_the_exact_logit(percent):
    """With a learned temperature or a long warm-up three of 60 seeds, all
    of them hoppers with a learned temperature, end above 50 %; one of them
    averages 63 %."""
    rescued = [
        percent[f"{robot}-exact-{kind}"]
        for kind in ("learned-short", "fixed-long", "learned-long")
        for robot in ROBOTS
    ]
    assert np.size(rescued) == 60
    assert (np.array(rescued) > 50).sum() == 3
    hops = [f"Hopper-exact-learned-{x}" for x in WARMUPS]
    ends = np.concatenate([percent[name] for name in hops])
    late = last_four(*(f"{GRID}/{name}" for name in hops))
    assert (ends > 50).sum() == 3
    assert late[ends > 50].round().tolist() == [45, 50, 63]


@recorded
def at_1_the_exact_logit_hops(percent):
    """At 1 the exact logit teaches Hopper, with a median of 108 %; the
    released loss has 34 points more (2 to 68), and the other losses no
    clear difference to it, nor Walker2d."""
    exact = percent["Hopper-exact-one-short"]
    released = percent["Hopper-released-one-short"]
    assert _rounded([np.median(exact), np.median(released)]) == [108, 134]
    assert exact.min() > 50
    assert percent["Hopper-dac-one-short"].min() > 120
    assert _rounded(difference(released, exact)) == [34, 2, 68]
    for robot in ("Hopper", "Walker2d"):
        for loss in ("exact", "mixture", "dac"):
            names = [f"{robot}-{x}-one-short" for x in (loss, "released")]
            if (robot, loss) != ("Hopper", "exact"):
                assert _clear(*(percent[name] for name in names)) == 0
            four = [last_four(f"{GRID}/{name}") for name in names]
            assert _clear(*four) == 0


@recorded
def two_robots_do_not_learn_at_1_with_it(percent):
    """At 1 the exact logit does better than at 0.2, but Walker2d and
    HalfCheetah end below 50 %."""
    for robot in ROBOTS[:3]:
        hot = percent[f"{robot}-exact-one-short"]
        assert _clear(hot, percent[f"{robot}-exact-fixed-short"]) == 1
        assert robot == "Hopper" or hot.max() < 50


@recorded
def ants_walk_at_1(upright):
    """On other episodes, after 10,000 random steps, CustomAnt's medians at
    1 are 79, 73, 73 and 67 %."""
    hot = {loss: upright[f"CustomAnt-{loss}-one-long"] for loss in LOSSES}
    medians = {loss: round(np.median(ends)) for loss, ends in hot.items()}
    assert medians == {
        "released": 79,
        "mixture": 73,
        "exact": 73,
        "dac": 67,
    }
    assert min(ends.min() for ends in hot.values()) > 45


@recorded
def ants_differ_a_little_at_1(upright):
    """There DAC is clearly behind the released loss, by 11 points (2 to
    17), and the exact logit in the last four only, by 17 (3 to 25)."""
    released, dac, exact = (
        upright[f"CustomAnt-{loss}-one-long"]
        for loss in ("released", "dac", "exact")
    )
    assert _rounded(difference(released, dac)) == [11, 2, 17]
    assert _clear(released, exact) == 0
    four = [
        last_four(f"{OTHERS}/CustomAnt-{loss}-one-long")
        for loss in ("released", "exact")
    ]
    assert _rounded(difference(*four)) == [17, 3, 25]


@recorded
def hoppers_after_a_long_warmup_at_1(percent):
    """After 10,000 random steps at 1 four of DAC's hoppers stand still,
    three of the exact logit's are at 50 % or below, and with the other two
    losses most still hop."""
    hop = {loss: percent[f"Hopper-{loss}-one-long"] for loss in LOSSES}
    assert (hop["dac"] < 52).sum() == 4
    assert (hop["exact"].round() <= 50).sum() == 3
    assert all((hop[x] > 75).sum() == 4 for x in ("released", "mixture"))


@recorded
def gaps_of_the_released_loss(gaps):
    """The logit gap ends between 1 and 4 nats with the released loss and
    with DAC's."""
    for arm in ("log-ratio loss", "DAC"):
        for gap in gaps[arm].values():
            assert 0.5 < gap.min() < gap.max() < 4.5


@recorded
def the_exact_logit_runs_away(gaps):
    """With the exact logit at 0.2 the gap ends at tens to thousands on
    three robots; on CustomAnt two are near 85, and two below 0."""
    exact = gaps["AIRL loss"]
    for robot, least in zip(ROBOTS[:3], (25, 800, 700), strict=True):
        assert exact[robot].min() > least
    assert (exact["CustomAnt"] < 0).sum() == 2
    assert (np.abs(exact["CustomAnt"] - 85) < 5).sum() == 2


@recorded
def gaps_at_1(gaps):
    """At 1 Hopper's gap ends at 2 to 3, and the medians of Walker2d and
    HalfCheetah are a fiftieth of those at 0.2, or less."""
    cold, hot = gaps["AIRL loss"], gaps["AIRL loss, α = 1"]
    assert 1.5 < hot["Hopper"].min() < hot["Hopper"].max() < 3.5
    for robot in ("Walker2d", "HalfCheetah"):
        assert np.median(cold[robot]) > 50 * np.median(hot[robot])


@recorded
def the_mixture_does_not_run_away(gaps):
    """The mixture's gaps end between 2.5 and 9.5."""
    ends = np.concatenate([*gaps["mixture"].values()])
    assert 2.5 < ends.min() < ends.max() < 9.5


@recorded
def the_mixture_on_robots(percent):
    """At 0.2 the mixture's best hopper is at 24 % and its best ant at 14 %;
    HalfCheetah's median is 44 %, 69 with the released loss, and Walker2d's
    seeds are far apart."""
    best = [
        percent[f"{robot}-mixture-fixed-short"].max()
        for robot in ("Hopper", "CustomAnt")
    ]
    assert _rounded(best) == [24, 14]
    run = [
        percent[f"HalfCheetah-{loss}-fixed-short"]
        for loss in ("mixture", "released")
    ]
    assert _rounded(map(np.median, run)) == [44, 69]
    walked = np.sort(percent["Walker2d-mixture-fixed-short"])
    assert walked.round().tolist() == [0, 6, 56, 83, 88]


@recorded
def the_mixture_with_other_settings(percent):
    """With a learned temperature nine of ten hoppers and walkers end below
    1 % with the mixture; with a long warm-up medians are 27, 7 and 56 %."""
    fell = [percent[f"{x}-mixture-learned-short"] for x in ROBOTS[:2]]
    assert (np.concatenate(fell) < 1).sum() == 9
    more = [percent[f"{x}-mixture-fixed-long"] for x in ROBOTS[:3]]
    assert _rounded(map(np.median, more)) == [27, 7, 56]
    assert np.sort(more[0]).round().tolist()[-2:] == [34, 139]


@recorded
def dac_is_much_the_same(percent):
    """DAC makes a clear difference on Walker2d alone, with a median of 26
    instead of 70 %, and not in the last four."""
    for robot in ROBOTS:
        names = [f"{robot}-{x}-fixed-short" for x in ("released", "dac")]
        over = _clear(*(percent[name] for name in names))
        assert over == (robot == "Walker2d")
    medians = [
        np.median(percent[f"Walker2d-{loss}-fixed-short"])
        for loss in ("released", "dac")
    ]
    four = [
        last_four(f"{GRID}/Walker2d-{loss}-fixed-short")
        for loss in ("released", "dac")
    ]
    assert _rounded(medians) == [70, 26]
    assert _clear(*four) == 0


@recorded
def medians_of_the_released_loss(percent):
    """Which medians the released loss has, and which settings are clearly
    worse than the recipe."""
    kinds = ("fixed-short", "fixed-long", "learned-short", "one-short")
    for robot, medians, worse in (
        ("Hopper", [141, 74, 140, 134], ["fixed-long"]),
        ("Walker2d", [70, 13, 33, 25], [*kinds[1:]]),
        ("HalfCheetah", [69, 71, 71, 4], ["one-short"]),
        ("CustomAnt", [75, 84, 56, 68], ["learned-short"]),
    ):
        ends = {kind: percent[f"{robot}-released-{kind}"] for kind in kinds}
        assert _rounded(map(np.median, ends.values())) == medians
        recipe = ends["fixed-short"]
        clear = [k for k in kinds if _clear(recipe, ends[k]) == 1]
        assert clear == worse


@recorded
def ants_at_1_with_the_released_loss(percent):
    """All five ants walk at 1, the worst at 60 %; after 10,000 random steps
    they are clearly worse than at 0.2, by 12 points (4 to 31)."""
    assert round(percent["CustomAnt-released-one-short"].min()) == 60
    long = [
        percent[f"CustomAnt-released-{x}-long"] for x in ("fixed", "one")
    ]
    assert _rounded(difference(*long)) == [12, 4, 31]


@recorded
def two_robots_do_not_move_at_1(percent):
    """At 1 Walker2d stands still with the released loss and DAC, which pays
    1,000; HalfCheetah's best seed is at 16 %. With the other losses no
    seed of them passes 44 and 8 %."""
    for loss in ("released", "dac"):
        stood = percent[f"Walker2d-{loss}-one-short"] / 100
        stood = stood * demonstrated("Walker2d")
        assert 1_000 < stood.min() < stood.max() < 1_250
    assert round(percent["HalfCheetah-released-one-short"].max()) == 16
    for robot, most in ("Walker2d", 44), ("HalfCheetah", 8):
        others = [
            percent[f"{robot}-{loss}-one-{warmup}"]
            for loss in ("exact", "mixture", "dac")
            for warmup in WARMUPS
        ]
        assert round(np.max(others)) == most


@recorded
def learned_temperatures():
    """With the released loss a learned temperature ends between 0.03 and
    0.07."""
    for robot in ROBOTS:
        folder = RECORDS / GRID / f"{robot}-released-learned-short"
        last = records.read(folder).rows[-5:]
        alphas = [row.metrics["temperature"] for row in last]
        assert 0.025 < min(alphas) < max(alphas) < 0.075


@recorded
def a_learned_temperature_harms_the_ant():
    """In the last four, too, a learned temperature is clearly worse on
    CustomAnt, and not on Walker2d."""
    for robot in ("Walker2d", "CustomAnt"):
        kinds = RECIPE, "released-learned-short"
        ends = [last_four(f"{GRID}/{robot}-{kind}") for kind in kinds]
        assert _clear(*ends) == (robot == "CustomAnt")


@recorded
def with_more_seeds(percent):
    """With more policies of the recipe the harm of a long warm-up and of a
    temperature of 1 holds up, and that of a learned one on Walker2d does
    not."""
    again = {
        "Hopper": ended("locomotion-demo/Hopper-airl"),
        "Walker2d": ended(
            "locomotion-demo/Walker2d-airl",
            "locomotion-again-demo/Walker2d-airl",
        ),
    }
    assert len(again["Walker2d"]) == 15
    for robot, kind, clear in (
        ("Walker2d", "learned-short", False),
        ("Hopper", "fixed-long", True),
        ("Walker2d", "fixed-long", True),
        ("Walker2d", "one-short", True),
    ):
        other = percent[f"{robot}-released-{kind}"]
        both = np.append(percent[f"{robot}-{RECIPE}"], again[robot])
        assert (_clear(both, other) == 1) == clear
        assert not clear or _clear(again[robot], other) == 1


@recorded
def twenty_more_walkers():
    """Of twenty more policies of Walker2d the worst was at 14 %."""
    more = ended(
        f"what-decides-more-demo/Walker2d-{RECIPE}",
        "locomotion-demo/Walker2d-airl",
        "locomotion-again-demo/Walker2d-airl",
    )
    assert (len(more), round(more.min())) == (20, 14)


@recorded
def at_1_2_the_exact_logit_hops(gaps):
    """At 1.2 all five hop, and two ants walk at 67 and 72 %; on Walker2d
    and HalfCheetah, which do not, the gap is six and three times that of
    the released loss at 0.2."""
    ends = tried("decides-1.2-demo", "exact-fixed-short")
    assert ends["Hopper"].min() > 60
    ants = np.sort(ends["CustomAnt"])
    assert ants.round().tolist() == [0, 20, 35, 67, 72]
    warm = gaps["AIRL loss, α = 1.2"]
    assert warm["Hopper"].max() < 4
    for robot, times in ("Walker2d", 6), ("HalfCheetah", 3):
        cold = np.median(gaps["log-ratio loss"][robot])
        assert round(np.median(warm[robot]) / cold) == times


@recorded
def a_weaker_penalty_helps_at_1(percent):
    """Under a penalty of weight 0.1 all walkers walk at 1, with a median of
    52 instead of 25 %, and four of five cheetahs run, 24 instead of 4 %."""
    steeper = tried("decides-steeper-demo", "released-one-short")
    for robot, medians in ("Walker2d", [52, 25]), ("HalfCheetah", [24, 4]):
        both = steeper[robot], percent[f"{robot}-released-one-short"]
        assert _rounded(map(np.median, both)) == medians
        assert _clear(*both) == 1
    assert steeper["Walker2d"].min() > 40
    assert (steeper["HalfCheetah"] > 20).sum() == 4


@recorded
def the_cost_of_a_long_warmup(percent):
    """10,000 random steps cost nearly 60 points: Hopper 15 to 87, Walker2d
    42 to 61."""
    for robot, cost in ("Hopper", [59, 15, 87]), ("Walker2d", [56, 42, 61]):
        both = [percent[f"{robot}-released-fixed-{x}"] for x in WARMUPS]
        assert _rounded(difference(*both)) == cost
