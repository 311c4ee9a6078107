"""What the note on three losses, solved exactly, says."""

import numpy as np

from checks import exact, recorded
from figures.three_losses import CAUSES, EXPERTS
from offairl_lite import demonstrations, tabular
from offairl_lite.analysis.statistics import difference
from offairl_lite.runs import records


def _halfway(world, true_reward, replay):
    # A policy on its way to the expert; 30 % random actions in the replay.
    policy = tabular.soft_value_iteration(world, true_reward / 2)
    mixed = replay(world, policy.policy, 0.3)
    return policy.log_policy, mixed


@exact
def newton_finds_the_optima(
    world,
    true_reward,
    replay,
    offset,
    fit,
    form,
    cross_entropy,
    expert,
    seen,
):
    """Newton's method finds the formulas' optima to five decimals, and the
    form r(s) + γ V(s') - V(s) costs at most 2e-5 nats."""
    log_pi, mixed = _halfway(world, true_reward, replay)
    mu, d_R = mixed / mixed.sum(1, keepdims=True), mixed.sum(1)
    log_d = np.log(seen.sum(1) / d_R)[:, None]
    formulas = {
        "exact": expert.log_policy + log_d + log_pi - np.log(mu),
        "replay": expert.log_policy + log_d,
        "released": expert.log_policy - np.log(mu) + log_d,
    }
    sides = seen.ravel(), mixed.ravel()
    for loss, formula in formulas.items():
        b = offset(loss, log_pi, mixed)
        free = fit(np.eye(mixed.size), b, *sides)
        f = form(world) @ fit(form(world), b, *sides)
        best = cross_entropy(free - b, *sides)
        assert np.abs(free - formula.ravel()).max() < 1e-5
        assert -1e-9 < cross_entropy(f - b, *sides) - best < 2e-5


@exact
def released_is_the_ratio_of_transitions(
    slippery, true_reward, S, A, visits, replay, fit
):
    """In a slippery world a table over (s, s') finds the log ratio of
    transitions with the released loss."""
    p = slippery.transition.toarray().reshape(S, A, S)
    policy = tabular.soft_value_iteration(slippery, true_reward).policy
    ones = (visits(slippery, policy)[..., None] * p).ravel()
    zeros = (replay(slippery, policy**0 / A, 0.3)[..., None] * p).ravel()
    possible = zeros > 0
    s, _, to = np.unravel_index(np.flatnonzero(possible), p.shape)
    pairs, which = np.unique(s * S + to, return_inverse=True)
    ones, zeros = ones[possible], zeros[possible]
    table = fit(np.eye(len(pairs))[which], 0.0, ones, zeros)
    ratio = np.bincount(which, ones) / np.bincount(which, zeros)
    assert np.abs(table - np.log(ratio)).max() < 1e-5


@exact
def a_limit_is_expensive_for_the_exact_logit(excess):
    """With 10 % random actions and |f| within 5 the exact logit is 0.37
    nats above its optimum, the replay's density less than 0.01 and the
    released loss less than 0.0005."""
    assert 0.365 < excess("exact", 0.1, [5.0])[0] < 0.375
    assert excess("replay", 0.1, [5.0])[0] < 0.01
    assert excess("released", 0.1, [5.0])[0] < 0.0005


@exact
def it_grows_with_the_random_share(excess, shares):
    """The cost grows in proportion to the random share."""
    cost = [excess("exact", share, [5.0])[0] for share in shares]
    assert np.allclose(np.divide(cost, shares), 3.7, atol=0.1)


@exact
def worse_than_no_discriminator(demand, cross_entropy, seen):
    """A discriminator that knows nothing is only 0.05 nats above the
    optimum; the exact logit limited around the best constant is 0.13."""
    f, b, mixed = demand("exact", 0.1)
    sides = seen.ravel(), mixed
    best = cross_entropy(f - b, *sides)
    limited = [
        cross_entropy(np.clip(f, middle - 5, middle + 5) - b, *sides)
        for middle in range(-35, 6)
    ]
    assert 0.045 < 2 * np.log(2) - best < 0.055
    assert 0.125 < min(limited) - best < 0.135


@exact
def twice_the_range(demand):
    """The exact logit asks for an f down to -35, the replay's density to
    -20 and the released loss to -16."""
    least = [
        demand(x, 0.1)[0].min() for x in ("exact", "replay", "released")
    ]
    assert np.round(least).tolist() == [-35, -20, -16]


@exact
def runs_away_when_cold(games):
    """At 0.2 the exact logit's range grows by 1.4 a round, past 2,000."""
    ranges = games["exact", 0.2][2]
    assert ranges[-1] > 2000
    assert len(ranges) < 40
    assert np.abs(ranges[-5:] / ranges[-6:-1] - 1.4).max() < 0.1


@exact
def drifts_at_one(games):
    """At 1 the exact logit's range grows steadily."""
    ranges = games["exact", 1.0][2]
    drift = np.diff(ranges)[-30:]
    assert ranges[-1] > 100
    assert 0 < drift.min() < drift.max() < 1.3 * drift.min()


@exact
def the_other_losses_settle(games):
    """With the density of the replay and the released loss f settles."""
    for game in ("replay", 1.0), ("released", 1.0), ("released", 0.2):
        ranges = games[game][2]
        assert abs(ranges[-1] / ranges[-20] - 1) < 0.01


@exact
def cooler_by_one(world, true_reward, play, games):
    """The exact logit at 2 ends at the policy of the released loss at 1, to
    0.002."""
    _, log_pi, _ = play(world, true_reward, "exact", 2.0, 0.1, 100)
    gap = np.exp(log_pi) - np.exp(games["released", 1.0][1])
    assert np.abs(gap).max() < 2e-3


@exact
def rests_with_fresh_data(world, true_reward, play):
    """With fresh data alone the exact logit rests at 0.2, near the true
    reward."""
    r, _, ranges = play(world, true_reward, "exact", 0.2, 0.0, 60)
    assert abs(ranges[-1] / ranges[-20] - 1) < 0.01
    assert np.ptp(r - true_reward) < 1


@exact
def where_the_released_loss_rests(world, true_reward, play, visits, seen):
    """With fresh data the released loss settles at the reward of the
    formula."""
    for alpha in (0.2, 1.0):
        game = play(world, true_reward, "released", alpha, 0.0, 50)
        now = visits(world, np.exp(game[1])).sum(1)
        formula = true_reward + np.log(seen.sum(1) / now)
        assert np.ptp(game[0] - alpha / (1 + alpha) * formula) < 1e-2


@exact
def a_table_does_not_suffer(games, distance):
    """Every policy ends within 0.02 of the expert's visits, and with the
    released loss nearer at 0.2 than at 1."""
    far = {setting: distance(game[1]) for setting, game in games.items()}
    assert max(far.values()) < 0.02
    assert far["released", 0.2] < 0.5 * far["released", 1.0]


REWARDS = (
    "exact logit, α = 1",
    "exact logit, α = 1.2",
    "density of the replay, α = 1",
    "released, α = 1",
    "released, α = 0.2",
)


@recorded
def rewards_of_the_state_survive(transferred):
    """All rewards r(s) survive in the rooms and in the median world."""
    for share in ("0.01", "0.5"):
        for name in REWARDS:
            assert transferred["rooms"][share][name] > 99
            assert np.median(transferred["worlds"][share][name]) > 80


@recorded
def others_fail(transferred):
    """DAC's f(s, a) and the old policy fail."""
    for share in ("0.01", "0.5"):
        for name in "DAC's f(s, a), α = 0.2", "the old policy":
            assert transferred["rooms"][share][name] < 50
            assert np.median(transferred["worlds"][share][name]) < 60


@recorded
def the_replays_density_is_most_faithful(transferred):
    """In the worst world of both shares the density of the replay is best,
    above 90."""
    worst = {
        name: min(x[name].min() for x in transferred["worlds"].values())
        for name in REWARDS
    }
    best, second, *_ = sorted(worst, key=worst.get, reverse=True)
    assert best == "density of the replay, α = 1"
    assert worst[best] > worst[second] + 5
    assert worst[best] > 90


@recorded
def twins(transferred):
    """The exact logit at 1.2 does as the released loss at 0.2."""
    for share in ("0.01", "0.5"):
        exact, released = (
            transferred["worlds"][share][name]
            for name in ("exact logit, α = 1.2", "released, α = 0.2")
        )
        assert np.median(np.abs(exact - released)) < 1


@recorded
def the_worst_world(transferred):
    """In the worst world, with half of the replay random, the released loss
    comes to 90 at 1 and to 49 at 0.2, and its twin to 49."""
    light, heavy = (
        {name: round(worlds[name].min()) for name in REWARDS}
        for worlds in transferred["worlds"].values()
    )
    assert min(light.values()) > min(heavy.values()) == 49
    assert heavy["exact logit, α = 1.2"] == 49
    assert heavy["released, α = 0.2"] == 49
    assert heavy["released, α = 1"] == 90


def _percent(robots, robot):
    # each run's returns at every evaluation, in percent of the expert
    return {
        name: 100 * run["returns"] / EXPERTS[robot]
        for name, run in robots[robot].items()
    }


def _ends(robots, robot):
    return {
        name: np.sort(percent[:, -1])
        for name, percent in _percent(robots, robot).items()
    }


@recorded
def percents_are_of_the_experts():
    """100 % is what each robot's expert returns without noise."""
    for robot, best in EXPERTS.items():
        noted = records.read_json(demonstrations.EXPERTS / f"{robot}.json")
        assert round(max(noted["returns"])) == best


@recorded
def every_change_was_run_on_both(robots):
    """On both robots every single change was run, that of the temperature
    on HalfCheetah alone."""
    single = {name for name in CAUSES if "temperature" not in name}
    assert set(robots["HalfCheetah"]) == set(CAUSES)
    assert set(robots["Walker2d"]) == single


@recorded
def the_right_density_rescues_it(robots):
    """On HalfCheetah all five seeds end at 22 to 30 % of the expert with
    the density of the replay, each higher than after 20,000 steps, and at
    33 to 55 with the log-ratio loss."""
    percent = _percent(robots, "HalfCheetah")
    with_it, best = percent["density of the replay"], percent["log-ratio"]
    assert (with_it[:, -1] > with_it[:, 1]).all()
    assert [*np.round(np.sort(with_it[:, -1])[[0, -1]])] == [22, 30]
    assert [*np.round(np.sort(best[:, -1])[[0, -1]])] == [33, 55]


@recorded
def no_other_cause_decides_alone(robots):
    """On HalfCheetah two of five seeds run with log π cut off at -20, to 11
    and 23 %, one with the last 10,000 steps, to 7, and of all others that
    have one change none beyond 3. With -10, and with the last 1,000 steps,
    some run for a while."""
    ends = _ends(robots, "HalfCheetah")
    assert [*np.round(ends["clip -20"][-2:])] == [11, 23]
    assert ends["clip -20"][2] < 0
    assert round(ends["last 10,000"][-1]) == 7
    assert ends["last 10,000"][-2] < 1
    for name in ("clip -10", "last 1,000"):
        assert robots["HalfCheetah"][name]["returns"].max() > 1_000
    others = ("clip -10", "last 1,000", "temperature 1.2")
    for name in (*others, *(f"penalty {x}" for x in ("1", "0.1", "0"))):
        assert (ends[name] > 0).sum() <= 1
        assert ends[name][-1] < 3


@recorded
def on_walker2d_the_density_leads_too(robots):
    """On Walker2d the AIRL loss ends at 1 to 18 % of the expert, with the
    density of the replay at 10 to 26, and the log-ratio loss at 10 to 51.
    The last is clearly ahead of the first, by 27 points (9 to 41). The
    density is not, by 10 (-1 to 21), nor log π cut off at -20, by 9 (-3 to
    19)."""
    ends = _ends(robots, "Walker2d")
    names = ("exact", "density of the replay", "log-ratio")
    assert [[*np.round(ends[x][[0, -1]])] for x in names] == [
        [1, 18],
        [10, 26],
        [10, 51],
    ]
    leads = [
        [*np.round(difference(ends[x], ends["exact"]))]
        for x in ("log-ratio", "density of the replay", "clip -20")
    ]
    assert leads == [[27, 9, 41], [10, -1, 21], [9, -3, 19]]


@recorded
def on_walker2d_nothing_else_helps(robots):
    """On Walker2d no other single change is clearly ahead of the AIRL loss.
    Without a penalty no seed moves."""
    ends = _ends(robots, "Walker2d")
    for name in ends.keys() - {"density of the replay", "log-ratio"}:
        assert difference(ends[name], ends["exact"])[1] <= 0
    assert np.abs(ends["penalty 0"]).max() < 0.5


@recorded
def loop_and_penalty_together(robots):
    """At 1.2 without a penalty three of five seeds end at 5 to 19 % of the
    expert, and with a penalty of 0.1 none above 0."""
    hot = "temperature 1.2, penalty"
    ends = _ends(robots, "HalfCheetah")
    none, weak = (ends[f"{hot} {weight}"] for weight in ("0", "0.1"))
    assert [*np.round(none[[2, -1]])] == [5, 19]
    assert none[1] < 1
    assert weak.max() < 0


@recorded
def without_a_penalty_rewards_explode(robots):
    """With a hundredth of the penalty, or none, the rewards in the replay
    differ by 10 to 270, with the log-ratio loss by 1."""
    robot = robots["HalfCheetah"]
    spread = np.concatenate(
        [robot[f"penalty {x}"]["spread"] for x in ("0", "0.1")]
    )
    assert 9.5 < spread.min() < spread.max() < 270
    assert np.abs(robot["log-ratio"]["spread"] - 1).max() < 0.25


@recorded
def without_old_data_there_is_no_tail(robots):
    """With log π as it is and old data the rarest hundredth lies in the
    thousands below 0, without old data above −50."""
    robot = robots["HalfCheetah"]
    assert np.median(robot["exact"]["tail"]) < -1_000
    assert robot["last 1,000"]["tail"].min() > -50


@recorded
def at_a_higher_temperature_nobody_runs(robots):
    """At 1.2 the rarest hundredth of log π lies above −6, all five seeds
    stand still, and the rewards in the replay differ by less than 0.7."""
    hot = robots["HalfCheetah"]["temperature 1.2"]
    assert hot["tail"].min() > -6
    assert np.abs(hot["returns"][:, -1]).max() < 20
    assert 0.6 < hot["spread"].min() < hot["spread"].max() < 0.7
