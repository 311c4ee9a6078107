"""What the note on all 24 runs of experts says."""

import numpy as np

from checks import recorded
from offairl_lite import experiments
from offairl_lite.analysis.statistics import interquartile_mean
from offairl_lite.runs import records


def ends(run):
    """Return the last evaluation of each seed."""
    return run.returns[:, -1]


@recorded
def runs_are_the_papers(runs, ROBOTS):
    """All 24 runs have the settings of the experiment and networks of
    400-300, with three seeds on robots and ten on mazes."""
    planned = experiments.find("experts").variants
    assert set(planned) == {"-".join(name) for name in runs}
    for name, run in runs.items():
        settings = run.config.flat()
        for field, value in planned["-".join(name)].items():
            if field in ("env_id", "learner", "temperature"):
                assert settings[field] == value
        assert run.config.learner.hidden == (400, 300)
        assert not np.isnan(run.returns).any()
        assert len(run.seeds) == (3 if name[0] in ROBOTS else 10)


@recorded
def the_mazes_experts_are_small(listed):
    """The experts of the mazes that the package ships have networks of
    64-64 and a learned temperature."""
    small = [run for _, learner, _, run in listed if learner == "shipped"]
    assert len(small) == 2
    for run in small:
        assert run.config.learner.hidden == (64, 64)
        assert run.config.learner.temperature is None


@recorded
def they_come_close_to_the_paper(runs, chosen, PAPER, ROBOTS):
    """With 30 % of the paper's steps the best seed of every robot but the
    Ant reaches more than 90 % of the paper's mean."""
    best = {}
    for task in ROBOTS:
        run = runs[task, chosen[task]]
        assert run.steps[-1] == 300_000
        best[task] = ends(run).max() / PAPER[task][0]
    assert 0.5 < best.pop("Ant") < 0.6
    assert min(best.values()) > 0.9
    ant = runs["CustomAnt", chosen["CustomAnt"]]
    assert ends(ant).min() > 0.9 * PAPER["CustomAnt"][0]


@recorded
def a_seed_matters_on_halfcheetah(runs, chosen):
    """On HalfCheetah the worst of three seeds ends at less than 70 % of the
    best."""
    found = ends(runs["HalfCheetah", chosen["HalfCheetah"]])
    assert found.min() < 0.7 * found.max()


@recorded
def walkers_fall_or_walk(runs):
    """The Walker2d that ends lowest falls early in five of its last ten
    episodes and returns more than 4,000 in the five others."""
    run = runs["Walker2d", "sac-fixed"]
    lasts = [row for row in run.rows if row.step == run.steps[-1]]
    worst = min(lasts, key=lambda row: row.mean_return)
    assert sum(x < 200 for x in worst.returns) == 5
    assert sum(x > 4_000 for x in worst.returns) == 5


@recorded
def a_fixed_temperature_leads(at_equal, LEARNERS, ROBOTS):
    """On robots the fixed temperature leads on five of six tasks, and the
    learned one on DisabledAnt."""
    for task in ROBOTS:
        means = {name: at_equal[task, name].mean() for name in LEARNERS}
        leader = max(means, key=means.get)
        learned = task == "DisabledAnt"
        assert leader == ("sac-learned" if learned else "sac-fixed")


@recorded
def td3_has_not_begun_on_small_ants(at_equal):
    """On the two small ants TD3 has not begun to walk."""
    assert at_equal["CustomAnt", "td3"].max() < 100
    assert at_equal["DisabledAnt", "td3"].max() < 50


@recorded
def the_ant_is_ahead_at_a_fixed_temperature(at_equal):
    """After 100,000 steps the Ant with α = 0.2 returns more than twice as
    much as with the learned temperature, and its worst seed more than the
    best seed there."""
    fixed, learned = (
        at_equal["Ant", name] for name in ("sac-fixed", "sac-learned")
    )
    assert fixed.mean() > 2 * learned.mean()
    assert fixed.min() > learned.max()


@recorded
def the_ant_stays_up_and_hardly_walks(runs):
    """From 50,000 steps on the curve of the Ant with α = 0.2 is level,
    about half of its evaluation episodes return less than 700, and hardly
    one more than 1,150; training episodes last 330 to 430 steps."""
    ant = runs["Ant", "sac-fixed"]
    level = interquartile_mean(ant.returns)[-11:]
    assert level.max() < 1.5 * level.min()
    late = [row for row in ant.rows if row.step >= 50_000]
    returns = np.concatenate([row.returns for row in late])
    assert 0.45 < (returns < 700).mean() < 0.55
    assert (returns > 1_150).mean() < 0.02
    count = {(row.seed, row.step): row.episodes for row in ant.rows}
    first, end = late[0].step, ant.steps[-1]
    lasting = [
        (end - first) / (count[seed, end] - count[seed, first])
        for seed in ant.seeds
    ]
    assert 330 < min(lasting) < max(lasting) < 430


@recorded
def the_learned_temperature_goes_past(runs):
    """Over its last five evaluations the Ant with the learned temperature
    returns more than twice as much as the other does at best, and still
    rises."""
    level = interquartile_mean(runs["Ant", "sac-fixed"].returns)
    rising = interquartile_mean(runs["Ant", "sac-learned"].returns)
    assert rising[-5:].mean() > 2 * level.max()
    earlier, later = np.split(rising[-30:], 2)
    assert later.mean() > 1.2 * earlier.mean()


@recorded
def longer_is_enough(LONGER, PAPER):
    """Hopper ends at 3,500 after 800,000 steps, 99 % of the paper's mean,
    and the Ant at 4,744 after 650,000, 110 %."""
    for task, steps, found, percent in (
        ("Hopper", 800_000, 3_500, 99),
        ("Ant", 650_000, 4_744, 110),
    ):
        run = LONGER[task]
        (end,) = ends(run)
        assert run.steps[-1] == steps
        assert round(end) == found
        assert round(100 * end / PAPER[task][0]) == percent


@recorded
def hopper_is_level_and_the_ant_rises(LONGER):
    """Hopper has been level since 400,000 steps but for two falls, and the
    Ant's curve still rises."""
    hop, walk = LONGER["Hopper"], LONGER["Ant"]
    level = hop.returns[0, hop.steps > 400_000]
    assert (level < 3_000).sum() == 2
    assert np.ptp(np.median(level.reshape(4, -1), axis=1)) < 60
    assert walk.returns[0, -10:].mean() > walk.returns[0, -20:-10].mean()


@recorded
def it_is_the_length(LONGER, runs, chosen):
    """At 300,000 steps Hopper's new seed, with 1,000 random steps, is below
    the best of the old ones, and the Ant's below all three."""
    for task, run in LONGER.items():
        old = runs[task, chosen[task]]
        assert run.config.learner.hidden == (400, 300)
        assert run.config.schedule.warmup_steps == 1_000
        assert old.config.schedule.warmup_steps == 10_000
        then = run.returns[0, run.steps == 300_000].item()
        assert (ends(old) > then).sum() == (1 if task == "Hopper" else 3)


@recorded
def small_experts_had_a_million_steps(million, chosen, RECORDS):
    """Three seeds of 64-64 had a million steps, the first 1,000 of them
    random."""
    for task in million:
        run = records.read(RECORDS / f"experts-small/{task}-{chosen[task]}")
        assert run.config.learner.hidden == (64, 64)
        assert run.config.schedule.warmup_steps == 1_000
        assert (run.seeds, run.steps[-1]) == ((0, 1, 2), 10**6)


@recorded
def small_experts_are_as_good_on_hopper(million):
    """On Hopper the best small expert is as good as the best shipped one,
    and on Walker2d it returns 93 % as much."""
    share = {
        task: found["64-64"]["mode"].max() / found["shipped"]["mode"].max()
        for task, found in million.items()
    }
    assert 0.99 < share["Hopper"] < 1.01
    assert round(100 * share["Walker2d"]) == 93
    noisy = {
        label: both["with noise"].max()
        for label, both in million["Hopper"].items()
    }
    assert noisy["64-64"] > noisy["shipped"]


@recorded
def no_small_expert_is_better(million):
    """No small expert's mode returns more than that of the best shipped
    one."""
    for found in million.values():
        assert found["64-64"]["mode"].max() < found["shipped"]["mode"].max()


@recorded
def small_ants_come_no_farther(million, runs):
    """On the Ant small networks come to 1,868 at best in a million steps,
    no farther than large ones in 300,000."""
    best = million["Ant"]["64-64"]["mode"].max()
    assert round(best) == 1_868
    assert best < 0.5 * million["Ant"]["shipped"]["mode"].max()
    older = ends(runs["Ant", "sac-learned"])
    assert 1_300 < older.min() < best < older.max() < 2_400


@recorded
def small_imitators_return_more(million, RECORDS):
    """Imitators with networks as small return about twice as much or
    more."""
    best = million["Ant"]["64-64"]["mode"].max()
    for method in ("airl", "dac"):
        run = records.read(RECORDS / f"locomotion-strong-demo/Ant-{method}")
        assert run.config.learner.hidden == (64, 64)
        assert ends(run).min() > 1.95 * best


@recorded
def all_learners_arrive_on_mazes(above):
    """On the mazes at least nine of ten seeds of SAC, and eight of TD3, end
    above the paper's mean."""
    for (_, learner), count in above.items():
        assert count >= (8 if learner == "td3" else 9)
    assert above["PointMazeRight", "td3"] == 8


@recorded
def the_learned_temperature_is_first(at_soon, MAZES):
    """After 30,000 steps the learned temperature leads on both mazes,
    before the fixed one and TD3."""
    for task in MAZES:
        td3, fixed, learned = (
            at_soon[task, name]
            for name in ("td3", "sac-fixed", "sac-learned")
        )
        assert td3 < fixed < learned


@recorded
def mazes_need_a_low_temperature(listed, MAZES, PAPER):
    """With large and with small networks at least nine of ten seeds with a
    learned temperature end above the paper's mean, and below 0.01 in
    metres."""
    for task, learner, _, run in listed:
        if task in MAZES and learner in ("sac-learned", "shipped"):
            assert (ends(run) > PAPER[task][0]).sum() >= 9
            lasts = [row for row in run.rows if row.step == run.steps[-1]]
            hottest = max(row.metrics["temperature"] for row in lasts)
            assert hottest / run.config.learner.reward_scale < 0.01


@recorded
def what_is_shipped(shipped, MAZES, LONGER):
    """The package ships five policies for each maze; for each robot those
    seeds that return at least 80 % of the best, and behind them, for Hopper
    and the Ant, the better one with more steps."""
    for task, returns in shipped.items():
        if task in MAZES:
            assert len(returns) == 5
            continue
        *others, last = returns
        kept = others if task in LONGER else returns
        assert min(kept) > 0.8 * max(kept)
        assert task not in LONGER or last > max(others)
