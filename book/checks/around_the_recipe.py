"""What the note around the recipe says."""

import numpy as np

import rollouts
from checks import recorded
from offairl_lite.analysis.statistics import difference
from offairl_lite.runs import records
from robot_runs import (
    GRID,
    RECIPE,
    RECORDS,
    ROBOTS,
    demonstrated,
    ended,
    last_four,
)


def _clear(one, other):
    # 1 or -1 if the one is clearly better or worse than the other, else 0.
    _, low, high = difference(one, other)
    return int(low > 0) - int(high < 0)


def _gain(one, other):
    return [round(x) for x in difference(one, other)]


def _around(ends):
    return [round(ends.min()), round(ends.max())]


def _last_four(place, robot):
    return last_four(f"{place}/{robot}-{RECIPE}")


def _walkers():
    # All 25 policies that the recipe has trained on Walker2d.
    return ended(
        f"what-decides-demo/Walker2d-{RECIPE}",
        f"what-decides-more-demo/Walker2d-{RECIPE}",
        "locomotion-demo/Walker2d-airl",
        "locomotion-again-demo/Walker2d-airl",
    )


@recorded
def a_penalty_of_1_makes_no_difference(OURS, LIGHTER):
    """A penalty of weight 1 makes no clear difference on any robot."""
    for robot in ROBOTS:
        assert _clear(LIGHTER[robot], OURS[robot]) == 0


@recorded
def a_penalty_of_a_tenth(OURS, LIGHT):
    """With 0.1 Walker2d gains 16 points (4 to 38) over 25 policies of the
    recipe; three of five hoppers end below 60 %, which is not clear."""
    assert len(_walkers()) == 25
    assert _gain(LIGHT["Walker2d"], _walkers()) == [16, 4, 38]
    assert (LIGHT["Hopper"] < 60).sum() == 3
    for robot in ("Hopper", "HalfCheetah", "CustomAnt"):
        assert _clear(LIGHT[robot], OURS[robot]) == 0


@recorded
def shorter_blocks_make_no_difference(OURS, BLOCKS):
    """Shorter blocks make no clear difference but on Walker2d's five seeds,
    with a median of 41 %, and not beside all 25."""
    for robot in ROBOTS:
        worse = _clear(BLOCKS[robot], OURS[robot])
        assert worse == -(robot == "Walker2d")
    assert round(np.median(BLOCKS["Walker2d"])) == 41
    assert _clear(BLOCKS["Walker2d"], _walkers()) == 0


@recorded
def larger_networks_help_two_robots(OURS, WIDE):
    """With larger networks HalfCheetah ends at 83 to 90 %, 18 points (13 to
    25) more, and CustomAnt at 92 to 105 %, 25 (11 to 47) more."""
    assert _around(WIDE["HalfCheetah"]) == [83, 90]
    assert _around(WIDE["CustomAnt"]) == [92, 105]
    gains = {x: _gain(WIDE[x], OURS[x]) for x in ROBOTS[2:]}
    assert gains["HalfCheetah"] == [18, 13, 25]
    assert gains["CustomAnt"] == [25, 11, 47]


@recorded
def small_networks_come_as_far():
    """In 500,000 steps small networks come to 84 to 91 % on HalfCheetah and
    to 102 to 108 % on CustomAnt."""
    for robot, far in ("HalfCheetah", [84, 91]), ("CustomAnt", [102, 108]):
        run = records.read(RECORDS / f"locomotion-demo/{robot}-airl")
        assert run.steps[-1] == 500_000
        last = 100 * run.returns[:, -1] / demonstrated(robot)
        assert _around(last) == far


@recorded
def larger_networks_on_robots_that_fall(OURS, WIDE):
    """Larger networks are barely clearly ahead on Hopper in the last four,
    by 23 points (0 to 40), and not on Walker2d, where four seeds end at 75
    to 86 % and one at 28 %."""
    walked = np.sort(WIDE["Walker2d"]).round()
    assert (walked[0], walked[1], walked[-1]) == (28, 75, 86)
    for robot in ("Hopper", "Walker2d"):
        assert _clear(WIDE[robot], OURS[robot]) == 0
    places = "decides-wide-demo", GRID
    four = [_last_four(place, "Hopper") for place in places]
    assert _gain(*four) == [23, 0, 40]
    assert _clear(*(_last_four(x, "Walker2d") for x in places)) == 0


@recorded
def larger_networks_take_longer():
    """On one core CustomAnt took four to six times as long."""
    wide, *small = (
        records.read_json(RECORDS / place / f"CustomAnt-{RECIPE}/run.json")
        for place in ("decides-wide-demo", GRID, "decides-penalty-1-demo")
    )
    for run in small:
        assert 4 < wide["wall_s"] / run["wall_s"] < 6


@recorded
def the_factor_helps_the_mixture(percent, SCALED, OURS):
    """With the mixture f/α helps by 20 points (12 to 35) on HalfCheetah and
    by 64 (47 to 86) on CustomAnt, to where the recipe is; in the last four
    CustomAnt is 27 points (1 to 37) behind."""
    for robot, gain in (
        ("HalfCheetah", [20, 12, 35]),
        ("CustomAnt", [64, 47, 86]),
    ):
        mixed = percent[f"{robot}-mixture-fixed-short"]
        assert _gain(SCALED[robot], mixed) == gain
        assert _clear(SCALED[robot], OURS[robot]) == 0
    slow = last_four("decides-scaled-demo/CustomAnt-mixture-fixed-short")
    assert _gain(_last_four(GRID, "CustomAnt"), slow) == [27, 1, 37]


@recorded
def seven_of_ten_walk_as_far_as_the_demonstrations(SCALED):
    """Three of five and four of five more walkers end at 96 to 105 %, which
    none of the recipe's 25 reaches; the others stay below 20 %, so the
    difference is not clear: 27 points (-19 to 51)."""
    more = ended("decides-scaled-more-demo/Walker2d-mixture-fixed-short")
    far = np.append(SCALED["Walker2d"], more)
    walks = far > 90
    assert (walks.sum(), walks[:5].sum()) == (7, 3)
    assert _around(far[walks]) == [96, 105]
    assert far[~walks].max() < 20
    assert _walkers().max() < far[walks].min()
    assert _gain(far, _walkers()) == [27, -19, 51]


@recorded
def the_factor_on_hopper(SCALED, PLAIN):
    """No hopper comes beyond 41 % with the mixture and f/α, and none beyond
    8 % with the exact log π."""
    assert round(SCALED["Hopper"].max()) == 41
    assert round(PLAIN["Hopper"].max()) == 8


@recorded
def the_factor_with_the_exact_policy(percent, PLAIN, OURS):
    """With the exact log π and f/α HalfCheetah returns -3 to 47 %, clearly
    more than without the factor and clearly less than with the recipe."""
    ran = PLAIN["HalfCheetah"]
    assert _around(ran) == [-3, 47]
    assert _clear(ran, percent["HalfCheetah-exact-fixed-short"]) == 1
    assert _clear(ran, OURS["HalfCheetah"]) == -1


@recorded
def the_mixture_at_1(percent):
    """With the mixture at 1 and a slope near 1 HalfCheetah stays below 8 %
    and Walker2d below 28 %; three of five hop, and with the exact log π
    all five."""
    ends = {x: percent[f"{x}-mixture-one-short"] for x in ROBOTS[:3]}
    assert round(ends["HalfCheetah"].max()) == 7
    assert round(ends["Walker2d"].max()) == 27
    assert (ends["Hopper"] > 100).sum() == 3
    assert percent["Hopper-exact-one-short"].min() > 59


@recorded
def without_noise_nothing_is_better(OURS, QUIET):
    """Without noise in the demonstrations Walker2d is clearly worse at the
    last evaluation, with a median of 31 %, and not in the last four nor
    beside 25 policies; on Hopper and HalfCheetah nothing is clear."""
    assert round(np.median(QUIET["Walker2d"])) == 31
    assert round(np.median(OURS["Walker2d"])) == 70
    for robot in ROBOTS[:3]:
        worse = _clear(QUIET[robot], OURS[robot])
        assert worse == -(robot == "Walker2d")
        both = [_last_four(x, robot) for x in ("decides-mode-demo", GRID)]
        assert _clear(*both) == 0
    assert _clear(QUIET["Walker2d"], _walkers()) == 0


@recorded
def ends_that_count_twenty_times_teach_falling(ONCE, OFTEN):
    """After the first evaluation Hopper and Walker2d return less than 30 in
    37 of 90 evaluations where ends count twenty times, and six of ten seeds
    do at the end; where they count once it is 2 of 90, and none."""
    fell = []
    for kind in ("four-ends", "four"):
        later = [
            records.read(
                RECORDS / f"decides-{kind}-demo/{robot}-{RECIPE}"
            ).returns[:, 1:]
            for robot in ROBOTS[:2]
        ]
        assert np.size(later) == 90
        fell.append((np.array(later) < 30).sum())
    assert fell == [37, 2]
    for found, count in (OFTEN, 6), (ONCE, 0):
        last = [found[x] / 100 * demonstrated(x) for x in ROBOTS[:2]]
        assert (np.array(last) < 30).sum() == count


@recorded
def the_reward_shows_it():
    """Where ends count twenty times the reward pays the first five steps
    1.8 to 3.3 a step less than the end, where they count once 0.8 to 2.2
    less, and with whole episodes 0.5 less to 1.6 more."""
    paid = rollouts.read("around_the_recipe")
    for kind, low, high in (
        ("ends 20 times", -3.3, -1.8),
        ("ends once", -2.2, -0.8),
        ("whole", -0.5, 1.6),
    ):
        values = np.concatenate([*paid[kind].values()])
        assert round(values.min(), 1) == low
        assert round(values.max(), 1) == high


@recorded
def four_whole_episodes_suffice(OURS, WHOLE):
    """Four whole episodes teach as well as fifty: nothing is clear."""
    for robot in ROBOTS[:2]:
        assert _clear(WHOLE[robot], OURS[robot]) == 0
        places = "decides-four-whole-demo", GRID
        assert _clear(*(_last_four(x, robot) for x in places)) == 0


@recorded
def thinned_ones_cost(OURS, WHOLE, ONCE):
    """Thinned ones are clearly worse than whole ones in the last four only,
    by 40 points (2 to 76) on Hopper and 20 (4 to 37) on Walker2d; beside
    the recipe they cost Hopper 77 points (14 to 119)."""
    for robot, worse in ("Hopper", [40, 2, 76]), ("Walker2d", [20, 4, 37]):
        places = "decides-four-whole-demo", "decides-four-demo"
        assert _gain(*(_last_four(x, robot) for x in places)) == worse
        assert _clear(WHOLE[robot], ONCE[robot]) == 0
    assert _gain(OURS["Hopper"], ONCE["Hopper"]) == [77, 14, 119]
    assert _clear(OURS["Walker2d"], ONCE["Walker2d"]) == 0


@recorded
def cheetahs_learn_from_200_steps(OURS, ONCE):
    """HalfCheetah learns from 200 steps as well as from 50 episodes."""
    assert _clear(ONCE["HalfCheetah"], OURS["HalfCheetah"]) == 0
