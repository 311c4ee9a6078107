"""What chapter 2 says."""

import math

import numpy as np
import torch

from checks import exact, live, recorded
from offairl_lite import demonstrations
from offairl_lite.core.rewards import OF_LOGIT
from offairl_lite.runs import records

SURVIVE, GIVE_UP, ODDS = "-log(1 - D)", "log D", "log D - log(1 - D)"


def kl(p, q):
    """Return the Kullback-Leibler divergence."""
    return (p * np.log(p / q)).sum()


@live
def the_discriminator_knows_the_experts_pushes(verdicts):
    """The discriminator takes the pushes of the expert and of the imitator
    for the expert's, and random pushes not."""
    judged = {name: x.mean() for name, x in verdicts.items()}
    assert judged["random pushes"] < 0.35
    assert judged["the imitator"] > 0.5
    assert judged["the expert"] > 0.5


@live
def up_and_right_at_the_start(all_pushes, actors):
    """At the start up and to the right looks most like the expert."""
    first = all_pushes(actors["the expert"][0][0])
    assert first[-1, -1] > first[0, 0] + 0.15  # up, right; down, left
    assert first.max() < first[-1, -1] + 0.1


@live
def the_imitator_goes_the_experts_way(last_paths, SHOWN):
    """The recorded imitator goes round the barrier to the star."""
    assert last_paths["sac"].returns[SHOWN] > -9


@exact
def the_best_logit_is_the_log_ratio(occupancy, expert_A, uniform):
    """The best logit is the log ratio of the occupancies, and the game's
    value the Jensen-Shannon divergence."""
    theirs, ours = occupancy(expert_A), occupancy(uniform)
    middle = (theirs + ours) / 2
    jsd = (kl(theirs, middle) + kl(ours, middle)) / 2

    def objective(logit):
        log_d = -np.logaddexp(0, -logit)
        log_not_d = -np.logaddexp(0, logit)
        return (theirs * log_d + ours * log_not_d).sum()

    best = np.log(theirs / ours)
    value = objective(best)
    assert math.isclose(value, 2 * jsd - 2 * math.log(2))
    rng = np.random.default_rng(0)
    for _ in range(100):
        assert objective(best + 0.1 * rng.normal(size=best.shape)) < value


@exact
def the_logit_pays_the_expert(
    occupancy, action_values, expert_A, uniform, start
):
    """The logit as a reward returns a divergence to the expert, and minus
    a divergence to the imitator."""
    theirs, ours = occupancy(expert_A), occupancy(uniform)
    best = np.log(theirs / ours)
    for policy, mean in (
        (expert_A, kl(theirs, ours)),
        (uniform, -kl(ours, theirs)),
    ):
        at_start = start @ (policy * action_values(policy, best)).sum(1)
        z = start @ (policy * action_values(policy, 1 + 0 * best)).sum(1)
        assert math.isclose(at_start, z * mean)


@exact
def the_rewards_are_the_packages(REWARDS):
    """The three rewards are those of the package."""
    logits = torch.linspace(-6, 6, 50)
    names = ("gail-survival", "gail-termination", "dac")
    for reward, name in zip(REWARDS.values(), names, strict=True):
        expected = OF_LOGIT[name](logits)
        assert np.allclose(reward(logits.numpy()), expected, atol=1e-6)


@exact
def what_the_rewards_advise(preference):
    """If D is 1/2 everywhere, the first reward says stay, the second says
    leave at once, and the third says nothing."""
    assert preference[SURVIVE][-1] < -10  # at the door
    assert abs(preference[SURVIVE][0]) < 1e-6
    assert (preference[GIVE_UP] > 0.4).all()  # anywhere
    assert (preference[ODDS] == 0).all()


@exact
def survival_keeps_the_imitator_inside(played, far, gone):
    """With −log(1 − D) the imitator of expert A never leaves, and turns
    round in front of the door; that of expert B becomes the expert."""
    survivor = played["A", SURVIVE]
    assert far["A", SURVIVE] > 0.4
    assert gone(survivor, 50) < 0.01
    assert survivor[-1, 1] < 0.01  # it does not go right
    assert far["B", SURVIVE] < 1e-3


@exact
def giving_up_is_too_early(played, far, gone, expert_A, expert_B):
    """With log D the imitator of expert B leaves in a third of its
    episodes, and that of expert A leaves too early."""
    assert 0.01 < far["B", GIVE_UP] < 0.1
    assert 0.3 < gone(played["B", GIVE_UP]) < 0.4
    assert gone(played["B", GIVE_UP]) > gone(expert_B) + 0.1
    assert 0.01 < far["A", GIVE_UP] < 0.1
    assert f"{gone(played['A', GIVE_UP], 4):.0%}" == "99%"
    assert f"{gone(expert_A, 4):.0%}" == "81%"


@exact
def the_log_odds_imitate_both(far, moved):
    """With the log odds the imitator becomes the expert, A or B, and stays
    there."""
    for who in "AB":
        assert far[who, ODDS] < 1e-3
        assert moved[who, ODDS] < 1e-6


@exact
def perfect_imitators_move_away(far, moved):
    """In three of six games a perfect imitator moves away, and ends as far
    off as from a random start."""
    away = {key for key, x in moved.items() if x > 0.01}
    assert away == {("A", SURVIVE), ("A", GIVE_UP), ("B", GIVE_UP)}
    assert all(abs(moved[key] - far[key]) < 0.02 for key in away)


@exact
def the_sum_pays_for_the_length(
    play, action_values, expert_A, start, REWARDS
):
    """With expert A the first reward makes an episode longer, from 4 steps
    to 20, and the second shorter."""

    def length(policy):
        one = np.ones_like(policy)
        return start @ (policy * action_values(policy, one)).sum(1)

    longest, shortest = (
        play(expert_A, REWARDS[name], expert_A)
        for name in (SURVIVE, GIVE_UP)
    )
    assert round(length(expert_A)) == 4
    assert round(length(longest)) == 20
    assert length(shortest) < 3.8


@exact
def a_mean_does_not_pay_for_the_length(
    occupancy, action_values, distance, uniform, EXPERTS, REWARDS
):
    """If the average reward is subtracted from every step, each of the
    three rewards leads to the expert."""

    def play_for_mean(expert, reward, policy):
        theirs = occupancy(expert)
        for _ in range(150):
            ours = occupancy(policy)
            r = reward(np.log((theirs + 1e-6) / (ours + 1e-6)))
            centred = r - (ours * r).sum()
            policy = policy * np.exp(0.1 * action_values(policy, centred))
            policy = policy / policy.sum(1, keepdims=True)
            policy = np.maximum(policy, 1e-6)
            policy /= policy.sum(1, keepdims=True)
        return policy

    for expert in EXPERTS.values():
        for reward in REWARDS.values():
            for first in (uniform, expert):
                last = play_for_mean(expert, reward, first)
                assert distance(last, expert) < 1e-4


@live
def the_penalty_levels_the_slope(fitted):
    """Without the penalty the logit is steepest between the two clouds;
    with it the slope is about 1 everywhere."""
    slopes = {
        name: np.gradient(logit, x)
        for name, (_, _, x, logit) in fitted.items()
    }
    below, between, above = slopes["without penalty"][[20, 60, 100]]
    assert between > 2 * max(below, above)
    assert np.abs(slopes["with penalty"][20:101] - 1).max() < 0.3


@live
def your_imitator_finds_the_way(history):
    """Your imitator finds the way round the barrier, and still knows it at
    the end."""
    scores = np.array([path.reward.sum() for path, _ in history])
    assert scores.max() > -14  # In the trap it is -26.5.
    assert np.median(scores[-5:]) > -16


@live
def the_place_no_longer_tells_them_apart(history, places):
    """At first nearly anything above the barrier looks like the expert; at
    the end less does."""
    beyond = places[:, 1].view(41, 41).numpy() > 0.35
    early, late = ((history[k][1][beyond] > 0.5).mean() for k in (1, -1))
    assert early > 0.75
    assert late < early - 0.05


@live
def the_trap(env, run_episode):
    """Pushing straight towards the star ends under the barrier, with a
    return of about −26.5."""
    path = run_episode(env, lambda _: torch.tensor([0.0, 9.0]))
    assert -27 < path.reward.sum() < -26


@recorded
def demonstrations_return():
    """The demonstrations return −6.5 on average."""
    path = demonstrations.EXPERTS / "PointMazeLeft.json"
    assert f"{records.read_json(path)['demonstrated'][-1]:.1f}" == "-6.5"


@recorded
def escapes_from_the_trap(runs, escape, median):
    """The median seed of DAC is out of the trap by step 3,000, and GAIL's
    after 15,000 to 25,000 steps; with the log odds after 20,000."""
    assert all((run.returns > -12).any(1).all() for run in runs.values())
    assert sorted(escape["DAC with SAC"]) == [3_000] * 4 + [4_000]
    assert median["DAC with SAC"] == median["DAC with TD3"] == 3_000
    assert median["GAIL, log D − log(1 − D)"] == 20_000
    slow = [m for name, m in median.items() if "GAIL" in name]
    assert (min(slow), max(slow)) == (15_000, 25_000)
    assert max(slow) == median["GAIL, −log(1 − D)"]
    assert {
        type(run.config.learner).__name__
        for name, run in runs.items()
        if "GAIL" in name
    } == {"PPOConfig"}


@recorded
def returns_at_the_end(ends):
    """After 60,000 steps all seeds of GAIL are above the demonstrations,
    about −5.5; DAC with SAC returns −7.6 after 6,000, and one seed of DAC
    with TD3 has lost the way."""
    gail = [end for name, end in ends.items() if "GAIL" in name]
    assert np.concatenate(gail).size == 15
    assert np.concatenate(gail).min() > -6.5
    assert min(map(np.median, gail)) > -5.65
    assert max(map(np.median, gail)) < -5.35
    assert f"{np.median(ends['DAC with SAC']):.1f}" == "-7.6"
    assert (ends["DAC with TD3"] < -30).sum() == 1


@recorded
def hoppers_fall_or_stay_up(hopping, expert_length):
    """With −log(1 − D) the hoppers stay up; with log D and with the log
    odds they fall in eight steps. DAC with absorbing states stays up."""
    lasting = {name: lasted[:, -1] for name, (_, lasted) in hopping.items()}
    assert round(expert_length, -1) == 590
    assert np.median(lasting["GAIL, −log(1 − D)"]) > 400
    assert round(np.median(lasting["GAIL, log D − log(1 − D)"])) == 8
    for name in ("GAIL, log D", "GAIL, log D − log(1 − D)"):
        assert max(lasting[name]) < 12
    steps, lasted = hopping["DAC, absorbing states"]
    middle = np.median(lasted, 0)[steps >= 30_000]
    assert round(middle.min(), -1) == 590
    assert round(middle.max(), -1) == 910
    assert lasting["DAC, absorbing states"].min() >= 500


@recorded
def falling_no_longer_pays(taught, RECORDS):
    """The demonstrations fall 43 times in 29,535 steps, so the best logit
    of the absorbing state is −4.3; a step upright costs the hoppers 2.3."""
    # One step in the absorbing state for each fall.
    steps, ended = taught["lengths"].sum(), taught["terminated"]
    assert (steps, ended) == (29_535, 43)
    share = (steps + ended) / ended
    assert round(share) == 688
    assert f"{math.log(9 / share):.1f}" == "-4.3"
    fallen = records.read(RECORDS / "hopper-gail-demo/log-odds")
    logit = [
        row.metrics["policy_logit"]
        for row in fallen.rows
        if row.step <= 100_000
    ]
    assert f"{np.mean(logit):.1f}" == "-2.3"


@exact
def replay_biases_the_policy(drift, distance, ends_at, expert_A, torn):
    """Random steps in replay move the policy away from its expert, and
    farther if the expert is more random."""
    for who, policy in (("95 %", expert_A), ("60 %", torn)):
        assert distance(ends_at[who][0], policy) < 1e-6
    certain, uncertain = drift["95 %"], drift["60 %"]
    assert max(certain[:9]) < 0.06  # up to 80 % old steps
    assert np.ptp(certain[2:9]) < 0.01
    assert 0.1 < certain[-1] < 0.15
    assert 0.14 < uncertain[5] < 0.18
    assert uncertain[-1] > 0.4


@exact
def the_policy_makes_up_for_random_steps(chances):
    """In the first six rooms the policy goes right more often than its
    expert; with many random steps it lingers in the last room."""
    assert chances["95 %"][0, 2:].min() > 0.99  # little to overshoot
    assert 0.64 < chances["60 %"][0, 5] < 0.7
    assert chances["95 %"][1, 6] > 0.95 > 0.75 > chances["95 %"][1, 9]
    assert chances["60 %"][1, 9] < 0.01


@exact
def random_steps_rarely_reach_the_last_room(
    occupancy, uniform, expert_A, ends_at
):
    """Random steps rarely reach the last room, so with many the policy
    stays there longer than expert A."""
    lingers = ends_at["95 %"][-1]
    share = [occupancy(p)[-1].sum() for p in (uniform, expert_A, lingers)]
    assert share[0] < 0.05 < 0.2 < share[1] < share[2]


@recorded
def no_reward_is_left(runs):
    """GAIL's discriminator judges 94 % of the pairs correctly at step
    5,000, and 55 % at step 60,000."""
    gail = runs["GAIL, −log(1 − D)"]
    assert gail.steps[[0, -1]].tolist() == [5_000, 60_000]
    correct = [
        np.mean(
            [r.metrics["accuracy"] for r in gail.rows if r.step == step]
        )
        for step in gail.steps[[0, -1]]
    ]
    assert [f"{share:.0%}" for share in correct] == ["94%", "55%"]


@exact
def a_cost_for_a_reward_drives_away(
    flees, occupancy, distance, gone, expert_A
):
    """With log(1 − D) as a reward the imitator flees to the two rooms on
    the left and never leaves."""
    assert occupancy(flees)[:2].sum() > 0.75
    assert distance(flees, expert_A) > 0.9
    assert gone(flees) < 0.01


@exact
def swapped_labels(swapped, distance, gone, expert_A):
    """Minus the cost of Ho and Ermon is the survival reward; −log D with
    our labels makes the policy flee from the expert."""
    logit = torch.linspace(-5, 5, 11)
    theirs = -torch.sigmoid(-logit).log()
    ours = OF_LOGIT["gail-survival"](logit)
    assert torch.allclose(theirs, ours, atol=1e-5)
    assert distance(swapped, expert_A) > 0.7
    assert gone(swapped) < 0.01
