"""What the note on the benchmark says, of whatever is recorded so far."""

import csv

import numpy as np

import rollouts
from benchmark_runs import (
    BLOCKS,
    COLD,
    COUNTS,
    METHODS,
    PLAN,
    RECORDS,
    ROBOTS,
    THEIR_EXPERTS,
    THEIRS,
    average,
    clear,
    clones_beside,
    expert,
    iq_learn_cold,
    lead,
    summary,
)
from checks import recorded
from offairl_lite.analysis.statistics import difference
from offairl_lite.config import differences
from offairl_lite.experiments import configure
from offairl_lite.runs.records import RunSpec, read, run_folders
from rollouts.benchmark import settings

LONG = {"4-long": 500_000}
METHODS_OF_TWO = ("airl", "clone")


def specs(runs):
    """Yield the configuration of every part of every run, with its cell."""
    for key, place in runs.items():
        for part in run_folders(place):
            yield key, RunSpec.read(part)


@recorded
def runs_are_of_the_experiment(runs):
    """Every run has the configuration of its experiment, and only the
    longer ones have more steps."""
    for (block, robot, method), spec in specs(runs):
        name = "benchmark-warm" if method == "airl-warm" else "benchmark"
        assert (spec.experiment, spec.scale) == (name, "demo")
        own = configure(f"{name}/{robot}-{method}", "demo")
        changed = set(differences(own, spec.config))
        assert changed == ({"total_steps"} if block in LONG else set())


@recorded
def runs_have_five_seeds_and_all_steps(runs):
    """Every run has the seeds 0 to 4, and ends at its 100,000 or 500,000
    steps with ten episodes of each seed."""
    for (block, *_), place in runs.items():
        run = read(place)
        assert run.seeds == tuple(range(5))
        assert run.config.total_steps == LONG.get(block, 100_000)
        ended = [row for row in run.rows if row.step in run.steps[-1:]]
        if len(run.diverged) < len(run.seeds):
            assert run.steps[-1] == run.config.total_steps
            assert len(ended) == len(run.seeds) - len(run.diverged)
        assert all(len(row.returns) == 10 for row in ended)


@recorded
def runs_have_the_demonstrations_of_their_folder(runs):
    """The number of demonstrations is what the folder says, they are those
    of the strongest expert, and thinned by 20 where it says so."""
    for (block, *_), spec in specs(runs):
        shown = spec.demonstrations
        assert shown["trajectories"] == int(block.split("-")[0])
        assert shown["subsample"] == (20 if block == "4-thinned" else 1)
        assert shown["experts"] == "best"
        assert shown["dataset"] is None


@recorded
def methods_have_the_same_demonstrations(runs):
    """In a cell all methods have the same demonstrations, bit for bit."""
    digests = {}
    for (block, robot, _), spec in specs(runs):
        shown = block.removesuffix("-long"), robot
        digests.setdefault(shown, set()).add(spec.demonstrations["digest"])
    assert all(len(found) == 1 for found in digests.values())


@recorded
def only_the_warm_start_begins_with_a_policy(runs):
    """Only the recipe from a clone begins with a policy."""
    for (*_, method), spec in specs(runs):
        given = {"pretrained_policy"} if method == "airl-warm" else set()
        assert set(spec.inherited) == given


@recorded
def clones_are_of_the_defaults(cloned):
    """Ten seeds are cloned in a cell, with the defaults of cloning."""
    for name, value in settings().items():
        kept = rollouts.read("benchmark")["settings"][name]
        assert np.array_equal(kept, value)
    for robots in cloned.values():
        for cell in robots.values():
            assert cell["returns"].shape == (10,)
            assert cell["seconds"] > 0


@recorded
def clones_had_the_shipped_demonstrations(cloned):
    """The fifty demonstrations that were cloned return what is shipped."""
    for robot, cell in cloned["50"].items():
        gap = cell["demonstrations"] / expert(robot)[1] - 1
        assert abs(gap) < 1e-4


@recorded
def cells_are_what_the_curves_say(runs, cells):
    """A cell is the mean of the middle three of five seeds at the last
    step, in percent of the expert without noise, with the worst of them."""
    for (block, robot, method), place in runs.items():
        ends = []
        for part in run_folders(place):
            with (part / "curve.csv").open() as file:
                rows = list(csv.DictReader(file))
            last = str(LONG.get(block, 100_000))
            ends += [
                float(row["mean_return"])
                for row in rows
                if row["step"] == last
            ]
        ends = sorted([*ends, *[0.0] * (5 - len(ends))])
        found = summary(cells[block, robot, method].ends)
        unit = expert(robot)[0] / 100
        assert np.isclose(found.mean, np.mean(ends[1:4]) / unit)
        assert np.isclose(found.worst, ends[0] / unit)
        assert found.low <= found.mean <= found.high


@recorded
def clones_cells_are_their_returns(cloned, cells):
    """A cell of clones is the mean of the middle six of ten seeds."""
    for block, robots in cloned.items():
        for robot, cell in robots.items():
            ends = np.sort(cell["returns"]) / expert(robot)[0] * 100
            found = summary(cells[block, robot, "clone"].ends)
            assert np.isclose(found.mean, ends[2:8].mean())
            assert np.isclose(found.worst, ends[0])


@recorded
def what_is_filled_is_counted(runs, cloned, cells, FILLED):
    """The plan has 92 cells, and as many are filled as runs and clones of
    them have ended."""
    wanted = {
        (block, robot, method)
        for block in BLOCKS
        for method in PLAN[block]
        for robot in PLAN[block][method]
    }
    assert len(wanted) == 92
    of_clones = {
        (b, r, "clone") for b, robots in cloned.items() for r in robots
    }
    assert set(cells) == set(runs) | of_clones
    assert FILLED.startswith(f"{len(wanted & set(cells))} of 92 cells")


@recorded
def five_times_the_steps(cells, LONG):
    """From four demonstrations the recipe and DAC come to 97 and 96 % on
    Hopper and to 90 and 88 on HalfCheetah in 500,000 steps: clearly ahead
    of the clone, and neither of the other. One hopper ends at 48 %."""
    told = {
        ("Hopper", "airl"): (88, 97),
        ("Hopper", "dac"): (82, 96),
        ("HalfCheetah", "airl"): (50, 90),
        ("HalfCheetah", "dac"): (54, 88),
    }
    assert {*LONG} == {robot for robot, _ in told}
    for (robot, method), means in told.items():
        ends = [
            cells[block, robot, method].ends for block in ("4", "4-long")
        ]
        assert tuple(round(summary(x).mean) for x in ends) == means
        _, low, _ = difference(ends[1], cells["4", robot, "clone"].ends)
        assert low > 0
    for robot in LONG:
        ahead, behind = clear(cells, "4-long", "airl", "dac", [robot])
        assert not ahead
        assert not behind
    worst = cells["4-long", "Hopper", "airl"].ends.min()
    assert round(worst) == 48


@recorded
def every_name_is_known(cells):
    """Every recorded cell is of one of the blocks, robots and methods."""
    for block, robot, method in cells:
        assert block in BLOCKS
        assert robot in ROBOTS
        assert method in METHODS


@recorded
def who_is_ahead_is_of_the_cells(cells, FOUND):
    """A duel has a sign for each robot on which both methods were run: that
    of the interval of their difference, 0 if it includes 0. Where all five
    were run, the lead is the difference of the averages."""
    asked = {duel[:3] for duel in FOUND}
    assert len(asked) == len(FOUND) > 0
    for block, one, other, signs, by in FOUND:
        gaps = []
        for robot in ROBOTS:
            keys = [(block, robot, method) for method in (one, other)]
            assert (robot in signs) == all(key in cells for key in keys)
            if robot not in signs:
                continue
            ends = [np.sort(cells[key].ends) for key in keys]
            means = [x[len(x) // 4 : -(len(x) // 4)].mean() for x in ends]
            gaps.append(means[0] - means[1])
            _, low, high = difference(*ends)
            assert signs[robot] == (low > 0) - (high < 0)
        assert (by is not None) == (len(gaps) == len(ROBOTS))
        if by:
            mean, low, high = by
            assert np.isclose(mean, np.mean(gaps))
            assert low < mean < high


@recorded
def dac_and_the_recipe_with_four(cells):
    """With four recordings DAC is clearly ahead of the recipe on Walker2d
    alone, and behind on no robot."""
    assert clear(cells, "4", "dac", "airl") == (["Walker2d"], [])


@recorded
def cheetahs_of_the_film():
    """The best of the film's ten clones of HalfCheetah returns 9,356, the
    worst 3,007 and the expert 9,947."""
    returns = rollouts.read("clones_film")["returns"]["HalfCheetah"]
    assert len(returns) == 10
    assert (round(returns.max()), round(returns.min())) == (9_356, 3_007)
    assert round(expert("HalfCheetah")[0]) == 9_947


@recorded
def cheetahs_and_hoppers_of_four_recordings(cells):
    """On HalfCheetah the recipe has about half of the expert's return and
    the clones three quarters; on Hopper it has nine tenths and the clones
    about half."""
    for robot, low, high, better in (
        ("HalfCheetah", 50, 76, "clone"),
        ("Hopper", 52, 88, "airl"),
    ):
        means = {
            method: round(summary(cells["4", robot, method].ends).mean)
            for method in ("clone", "airl")
        }
        assert sorted(means.values()) == [low, high]
        assert max(means, key=means.get) == better


@recorded
def equal_networks(cells):
    """With 64-64, HalfCheetah's clones come to 34 % and not to 76, and are
    not ahead of the recipe; Walker2d's come to 42 and not to 23;
    CustomAnt's are still clearly ahead; and the average is 51."""
    small = rollouts.read("benchmark")["4-small"]
    ends = {
        robot: 100 * cell["returns"] / expert(robot)[0]
        for robot, cell in small.items()
    }
    assert round(np.mean([summary(x).mean for x in ends.values()])) == 51
    for robot, large, equal in (
        ("HalfCheetah", 76, 34),
        ("Walker2d", 23, 42),
    ):
        assert round(summary(cells["4", robot, "clone"].ends).mean) == large
        assert round(summary(ends[robot]).mean) == equal
    _, low, _ = difference(
        ends["HalfCheetah"], cells["4", "HalfCheetah", "airl"].ends
    )
    assert low < 0
    _, low, _ = difference(
        ends["CustomAnt"], cells["4", "CustomAnt", "airl"].ends
    )
    assert low > 0


@recorded
def a_clone_as_a_start(cells):
    """From a clone four of five seeds of HalfCheetah end at 74 to 83 %, and
    one at 13; without it at 27 to 58. The five robots come to 88, 68, 75,
    75 and 33, on average 68, the recipe alone to 54, DAC to 57 and clones
    to 57; on Walker2d it is clearly ahead of each of them, of SQIL and of
    IQ-Learn."""
    worst, *others = np.sort(cells["4", "HalfCheetah", "airl-warm"].ends)
    assert round(worst) == 13
    assert [round(x) for x in (others[0], others[-1])] == [74, 83]
    alone = cells["4", "HalfCheetah", "airl"].ends
    assert [round(x) for x in (alone.min(), alone.max())] == [27, 58]
    assert round(summary(cells["4", "Hopper", "airl"].ends).mean) == 88
    averages = {"airl-warm": 68, "airl": 54, "dac": 57, "clone": 57}
    for method, percent in averages.items():
        means = [
            summary(cells["4", robot, method].ends).mean for robot in ROBOTS
        ]
        assert round(np.mean(means)) == percent
        if method == "airl-warm":
            assert [round(x) for x in means] == [88, 68, 75, 75, 33]
    for method in ("airl", "dac", "state-dac", "clone", "sqil", "iq-learn"):
        _, behind = clear(cells, "4", method, "airl-warm", ["Walker2d"])
        assert behind


def leads(cells, other):
    """Return the lead of the recipe from a clone, on average over robots,
    and its interval, in whole percent."""
    warm = [cells["4", robot, "airl-warm"].ends for robot in ROBOTS]
    ends = [
        other[robot]
        if isinstance(other, dict)
        else cells["4", robot, other].ends
        for robot in ROBOTS
    ]
    return [round(x) for x in lead(warm, ends)]


@recorded
def leads_on_average(cells):
    """From a clone the average over five robots is 11 above cloning, -3 to
    18, 14 above the recipe alone, 3 to 19, and 11 above DAC, -1 to 17; on
    Hopper SQIL is clearly ahead of it, and on both ants cloning."""
    assert leads(cells, "clone") == [11, -3, 18]
    assert leads(cells, "airl") == [14, 3, 19]
    assert leads(cells, "dac") == [11, -1, 17]
    for robot, method in (
        ("Hopper", "sqil"),
        ("CustomAnt", "clone"),
        ("Ant", "clone"),
    ):
        ahead, _ = clear(cells, "4", method, "airl-warm", [robot])
        assert ahead


@recorded
def against_the_equal_clone(cells):
    """To the equal clones of five robots the recipe adds 17 on average, 3
    to 22: clearly on Hopper, on Walker2d and HalfCheetah, from 42 to 68
    and from 34 to 75, not clearly, and both ants lose, from 81 to 75 and
    from 56 to 33."""
    small = clones_beside("4-small")
    assert leads(cells, small) == [17, 3, 22]
    for robot, low, high, sign in (
        ("Hopper", 43, 88, 1),
        ("Walker2d", 42, 68, 0),
        ("HalfCheetah", 34, 75, 0),
        ("CustomAnt", 81, 75, -1),
        ("Ant", 56, 33, -1),
    ):
        warm = cells["4", robot, "airl-warm"].ends
        assert round(summary(small[robot]).mean) == low
        assert round(summary(warm).mean) == high
        _, least, most = difference(warm, small[robot])
        assert (least > 0) - (most < 0) == sign


@recorded
def state_only_dac(cells):
    """With four demonstrations state-only DAC averages 59 % over five
    robots, and the recipe 54; on Walker2d and HalfCheetah it is clearly
    ahead, and nowhere behind. No difference from DAC is clear."""
    for method, percent in (("state-dac", 59), ("airl", 54)):
        means = [
            summary(cells["4", robot, method].ends).mean for robot in ROBOTS
        ]
        assert round(np.mean(means)) == percent
    ahead = ["Walker2d", "HalfCheetah"]
    assert clear(cells, "4", "state-dac", "airl") == (ahead, [])
    assert clear(cells, "4", "state-dac", "dac") == ([], [])


@recorded
def clones_by_number(cells):
    """Clones of one demonstration come to 9 to 54 %, of four to 23 to 84,
    57 on average, of ten to 59 to 96, 83 on average, of twenty to 78 to
    100, 90 on average, of fifty to 90 to 100, 93 on average. With ten and
    twenty Hopper's come to least; with twenty its worst seed is at 32 and
    HalfCheetah's at 50. Ten seeds were cloned each time."""
    between = {block: clones_beside(block) for block in ("10", "20")}
    for block, low, mean, high in (
        ("1", 9, 33, 54),
        ("4", 23, 57, 84),
        ("10", 59, 83, 96),
        ("20", 78, 90, 100),
        ("50", 90, 93, 100),
    ):
        ends = between.get(block) or {
            robot: cells[block, robot, "clone"].ends for robot in ROBOTS
        }
        assert {len(of_robot) for of_robot in ends.values()} == {10}
        means = {robot: summary(ends[robot]).mean for robot in ROBOTS}
        in_order = sorted(means.values())
        assert (round(in_order[0]), round(in_order[-1])) == (low, high)
        assert round(np.mean(in_order)) == mean
        if block in between:
            assert min(means, key=means.get) == "Hopper"
    worst = {robot: round(x.min()) for robot, x in between["20"].items()}
    assert (worst["Hopper"], worst["HalfCheetah"]) == (32, 50)


@recorded
def clones_of_ten():
    """With ten recordings the clones of four robots come to 79 % or more,
    and Hopper's to 59."""
    ends = clones_beside("10")
    means = {robot: round(summary(x).mean) for robot, x in ends.items()}
    assert means.pop("Hopper") == 59
    assert min(means.values()) == 79


@recorded
def clones_of_fifty(cells):
    """Clones of fifty recordings come to 90 to 100 % on five robots."""
    for robot in ROBOTS:
        ends = cells["50", robot, "clone"].ends
        assert 90 <= round(summary(ends).mean) <= 100


@recorded
def the_recipe_and_dac_by_number(cells):
    """The recipe averages 57 % with one demonstration, 54 with four and 61
    with fifty; DAC 57, 57 and 58. With fifty state-only DAC averages 65,
    and cloning is 33 ahead of the recipe, 26 to 38, clearly on all robots
    but Hopper, and 36 ahead of DAC, 30 to 42, clearly on all five."""
    for method, percents in (("airl", (57, 54, 61)), ("dac", (57, 57, 58))):
        for block, percent in zip(COUNTS, percents, strict=True):
            assert round(average(cells, block, method)) == percent
    assert round(average(cells, "50", "state-dac")) == 65
    for method, numbers, behind in (
        ("airl", [33, 26, 38], ["Hopper"]),
        ("dac", [36, 30, 42], []),
    ):
        ahead = [robot for robot in ROBOTS if robot not in behind]
        assert clear(cells, "50", "clone", method) == (ahead, [])
        pair = (
            [cells["50", robot, m].ends for robot in ROBOTS]
            for m in ("clone", method)
        )
        assert [round(x) for x in lead(*pair)] == numbers


@recorded
def thinned_demonstrations(cells):
    """Of thinned demonstrations clones come to 0 % on Hopper and Walker2d,
    and to -3 % on HalfCheetah, -1 on average, the recipe to 85, 25 and 56,
    55 on average, and DAC to 76, 25 and 54, 52 on average. From all steps
    cloning comes to 52, 23 and 76, the recipe to 88, 23 and 50, and DAC to
    82, 41 and 54. No difference of the recipe or of DAC is clear, and
    every one of cloning is."""
    for method, percent in (("clone", -1), ("airl", 55), ("dac", 52)):
        assert round(average(cells, "4-thinned", method)) == percent
    for method, thinned, whole in (
        ("clone", (0, 0, -3), (52, 23, 76)),
        ("airl", (85, 25, 56), (88, 23, 50)),
        ("dac", (76, 25, 54), (82, 41, 54)),
    ):
        for i, robot in enumerate(ROBOTS[:3]):
            few = cells["4-thinned", robot, method].ends
            all_steps = cells["4", robot, method].ends
            assert round(summary(few).mean) == thinned[i]
            assert round(summary(all_steps).mean) == whole[i]
            _, low, high = difference(few, all_steps)
            assert (high < 0) == (method == "clone")
            assert low < 0


@recorded
def sqil_with_a_learned_temperature():
    """With a learned temperature, and nothing else changed, SQIL comes to
    12 % on HalfCheetah, 2 to 37, and not to 0."""
    place = RECORDS.parent / "sqil-learned-demo/HalfCheetah-sqil"
    own = configure("benchmark/HalfCheetah-sqil", "demo")
    changed = differences(own, RunSpec.read(place).config)
    assert changed == {"temperature": (0.2, None)}
    ends = 100 * read(place).returns[:, -1] / expert("HalfCheetah")[0]
    assert [round(x) for x in summary(ends)[:3]] == [12, 2, 37]


@recorded
def iq_learn_at_a_low_temperature(cells):
    """At its authors' default temperature, 0.01, and nothing else changed,
    IQ-Learn comes to 54 % on Hopper, 0 on Walker2d, 62 on HalfCheetah, 77
    on CustomAnt and 82 on Ant, on average 55, where at 0.2 it comes to 99,
    0, 0, 35 and 14. On Ant it is clearly ahead of each other row."""
    for robot in ROBOTS:
        spec = RunSpec.read(COLD / f"{robot}-iq-learn")
        own = configure(f"benchmark/{robot}-iq-learn", "demo")
        assert differences(own, spec.config) == {"temperature": (0.2, 0.01)}
        assert spec.demonstrations["trajectories"] == 4
    ends = iq_learn_cold()
    means = [round(summary(ends[robot]).mean) for robot in ROBOTS]
    assert means == [54, 0, 62, 77, 82]
    assert round(np.mean([summary(x).mean for x in ends.values()])) == 55
    for robot, percent in zip(ROBOTS, (99, 0, 0, 35, 14), strict=True):
        of_robot = cells["4", robot, "iq-learn"].ends
        assert round(summary(of_robot).mean) == percent
    for method in METHODS:
        of_method = cells["4", "Ant", method].ends
        assert difference(ends["Ant"], of_method)[1] > 0


@recorded
def one_recording(cells):
    """With one demonstration the recipe and DAC average 57 % over five
    robots, cloning 33, and 19 with networks of 64-64. The recipe is clearly
    ahead of the first on all but Hopper, and of the second likewise."""
    for method, percent in (("airl", 57), ("dac", 57), ("clone", 33)):
        means = [
            summary(cells["1", robot, method].ends).mean for robot in ROBOTS
        ]
        assert round(np.mean(means)) == percent
    ahead = [robot for robot in ROBOTS if robot != "Hopper"]
    assert clear(cells, "1", "airl", "clone") == (ahead, [])
    small = clones_beside("1-small")
    of_small = [summary(small[robot]).mean for robot in ROBOTS]
    assert round(np.mean(of_small)) == 19
    for robot in ROBOTS:
        _, low, _ = difference(cells["1", robot, "airl"].ends, small[robot])
        assert (low > 0) == (robot in ahead)


@recorded
def only_hopper(cells):
    """SQIL and IQ-Learn come to 99 % and more on Hopper, to at most 35 %
    on each other robot, and to 27 and 30 % on average."""
    for method, mean in (("sqil", 27), ("iq-learn", 30)):
        means = {
            robot: summary(cells["4", robot, method].ends).mean
            for robot in ROBOTS
        }
        assert round(np.mean(list(means.values()))) == mean
        assert means.pop("Hopper") > 98.5
        assert max(means.values()) < 35.5


@recorded
def sqil_and_iq_learn_on_hopper(cells):
    """From four recordings of Hopper SQIL comes to 100 % and IQ-Learn to
    99, SQIL clearly ahead of the recipe's 88; on Walker2d SQIL is at 22, no
    better than the recipe, and IQ-Learn at 0."""
    for method, percent in (("sqil", 100), ("iq-learn", 99), ("airl", 88)):
        ends = cells["4", "Hopper", method].ends
        assert round(summary(ends).mean) == percent
    for method, percent in (("sqil", 22), ("iq-learn", 0)):
        ends = cells["4", "Walker2d", method].ends
        assert round(summary(ends).mean) == percent
    for robot, ahead in (("Hopper", True), ("Walker2d", False)):
        pair = (cells["4", robot, m].ends for m in ("sqil", "airl"))
        assert (difference(*pair)[1] > 0) == ahead


@recorded
def ranges_with_four(cells):
    """With four recordings clones come to 23 to 84 %, and the recipe to 23
    to 88; over the robots cloning averages 57, the recipe 54, DAC 57."""
    for method, percent in (("clone", 57), ("airl", 54), ("dac", 57)):
        of_robots = [
            summary(cells["4", robot, method].ends).mean for robot in ROBOTS
        ]
        assert round(np.mean(of_robots)) == percent
    for method, most in (("clone", 84), ("airl", 88)):
        means = [
            round(summary(cells["4", robot, method].ends).mean)
            for robot in ROBOTS
        ]
        assert (min(means), max(means)) == (23, most)


@recorded
def who_wins_with_four(cells):
    """With four recordings the recipe is clearly ahead on Hopper, and
    cloning on HalfCheetah and CustomAnt."""
    for robot, wins in (
        ("Hopper", True),
        ("HalfCheetah", False),
        ("CustomAnt", False),
    ):
        pair = (cells["4", robot, method].ends for method in METHODS_OF_TWO)
        _, low, high = difference(*pair)
        assert low > 0 if wins else high < 0


@recorded
def noise_costs_the_experts():
    """Noise costs Hopper's expert most, 15 % of its return, and Ant's
    least, 4 %."""
    shares = {
        robot: expert(robot)[1] / expert(robot)[0] for robot in ROBOTS
    }
    lowest, *_, highest = sorted(shares, key=shares.get)
    assert (lowest, highest) == ("Hopper", "Ant")
    assert round(100 * shares["Hopper"]) == 85
    assert round(100 * shares["Ant"]) == 96


@recorded
def their_airl_fails_where_others_do_not():
    """In the published figures AIRL's best seed is at 5 % on Ant and at
    39 % on Walker2d, where cloning and GAIL are at 62 % or more, and on
    Hopper every seed of AIRL is ahead of cloning."""
    share = {
        (method, robot): 100 * np.array(returns) / THEIR_EXPERTS[robot]
        for method, robots in THEIRS.items()
        for robot, returns in robots.items()
    }
    assert round(share["their AIRL", "Ant"].max()) == 5
    assert round(share["their AIRL", "Walker2d"].max()) == 39
    for method in ("their cloning", "their GAIL"):
        for robot in ("Ant", "Walker2d"):
            assert share[method, robot].min() > 62
    ahead = share["their AIRL", "Hopper"].min()
    assert ahead > share["their cloning", "Hopper"].max()
