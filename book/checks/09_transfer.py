"""What chapter 9 says about transfer to another maze."""

import math

import numpy as np

from checks import demo_scale_only, exact, live, recorded
from offairl_lite import experiments
from offairl_lite.analysis.statistics import compare_successes
from offairl_lite.config import Frozen, differences
from offairl_lite.core.rollouts import rollout
from offairl_lite.envs.models import GOAL

BAR = -14  # above it a seed arrives
SMALL, LARGE = "maze-retraining-demo", "maze-retraining-full"
LEFT, RIGHT = "offairl/PointMazeLeft-v0", "offairl/PointMazeRight-v0"


# ---- The film, and what survives ----


@live
def the_old_policies_are_stuck(source):
    """The old policies are stuck in the new maze."""
    ends = rollout(source.policy, RIGHT, source.seeds, 3).returns.mean(1)
    assert (ends < -23).all()


@recorded
def new_policies(again, on_ppo):
    """New policies for the old reward find the way, and of five on the
    on-policy reward one does."""
    assert (again.returns[:, -1] > BAR).all()
    assert (on_ppo.returns[5:, -1] > BAR).sum() == 1


@live
def the_film(moving):
    """In the film all five new policies for the off-policy reward end at
    the goal, and no old policy does."""
    last = np.array([path[54] for path, *_ in moving])
    left = np.linalg.norm(last - GOAL, axis=1)
    assert left[:5].min() > 0.2
    assert left[5:10].max() < 0.2


@exact
def what_survives(errors):
    """A constant and a shaping that sees the next state change no policy; a
    shaping folded into state and action changes it in the new world."""
    assert max(*errors["old"], *errors["new"][:2]) < 1e-9
    assert errors["new"][2] > 0.1


# ---- The way back ----


@exact
def it_is_a_listed_experiment(config, imitation, size):
    """A transfer is an imitation with a frozen reward: this one is listed,
    and chapter 5's differs in the task and the number of steps."""
    experiment = experiments.find("maze-transfer-rewards")
    variant = experiment.variants["back-scratch"]
    listed = experiment.configs[size].change(**variant)
    assert config.change(total_steps=listed.total_steps) == listed
    transfer = experiments.find("maze-transfer").configs[size]
    changed = set(differences(config, transfer))
    assert transfer.discriminator == Frozen()
    assert {"env_id"} <= changed <= {"env_id", "total_steps"}


@live
def one_leaves_the_trap(moved):
    """On the reward from the right at least one new policy leaves the
    trap."""
    assert moved.returns.max() > -20


@recorded
def all_arrive_in_the_record(back):
    """In a recorded run of 8,000 steps all five new policies arrive."""
    assert back["steps"][-1] == 8_000
    assert (back["returns"][:, -1] > BAR).all()
    assert np.median(back["returns"][:, -1]) > -12


@live
def where_the_old_policies_stop(there, carried, seeds, size):
    """The old policies stop under the barrier on the side of the old gap,
    and return less than a particle in the trap."""
    demo_scale_only(size)
    assert (carried < -27).all()
    found = rollout(there.policy, LEFT, seeds, 1).next_obs
    rest = found[:, 0, -1, :2]
    assert (rest[:, 0] < GOAL[0] - 0.1).all()
    assert (rest[:, 1] < 0.3).all()


@recorded
def rewards_from_both_sides(source, there, values, places, size):
    """The rewards learned on the left and on the right correlate at more
    than 0.97 with one another, and at more than 0.96 with a hill."""
    demo_scale_only(size)
    left, right = values(source.reward), values(there.reward)
    alike = [np.corrcoef(a, b)[0, 1] for a in left for b in right]
    assert min(alike) > 0.97
    distance = np.linalg.norm(places[:, :2] - GOAL, axis=1)
    for reward in (*left, *right):
        assert np.corrcoef(reward, -distance)[0, 1] > 0.96


# ---- What to keep of the policy ----


@live
def held_actions_go_everywhere(fresh, held):
    """Beyond the barrier are about 1 % of the places of fresh actions, and
    19 % of those of held ones."""
    beyond = [(places[:, 1] > 0.33).mean() for places in (fresh, held)]
    assert beyond[0] < 0.02 < 0.16 < beyond[1] < 0.22


@recorded
def what_the_runs_are(runs):
    """A short warm-up is one episode, a long one 3,000 steps or 10,000
    with the paper's networks; a guide acts where the table says so."""
    for (size_of, _, end_of), run in runs.items():
        schedule = run.config.schedule
        long = end_of in ("-fresh", "-helped", "-cool")
        held = end_of in ("-helped", "-cool")
        steps = {SMALL: 3_000, LARGE: 10_000}[size_of] if long else 100
        assert schedule.warmup_steps == steps
        assert schedule.warmup_hold == (10 if held else 1)
        assert (schedule.start_steps > 0) == end_of.endswith("starts")
        fixed = 0.02 if end_of == "-cool" else None
        assert run.config.learner.temperature == fixed


@recorded
def how_long_the_runs_are(runs):
    """The table counts after 8,000 steps with small networks, and after
    20,000 to 40,000 with the paper's."""
    shorter = {
        ("scratch", "-helped"): 30_000,
        ("8-gate", "-helped"): 20_000,
        ("8-gate", "-cool"): 20_000,
    }
    for (size_of, *key), run in runs.items():
        if size_of == SMALL:
            assert run.steps[-1] == 8_000
        else:
            length = min(run.steps[-1], 40_000)
            assert length == shorter.get(tuple(key), 40_000)


@recorded
def the_counts(counts):
    """From scratch all arrive after the long held warm-up and none after
    fresh actions; the expert is the best guide; primitives never help."""
    assert counts[SMALL] == {
        "": ["", "1", "0", "0"],
        "-own-starts": ["", "2", "1", "0"],
        "-expert-starts": ["", "3", "3", "0"],
        "-fresh": ["0", "", "", ""],
        "-helped": ["5", "5", "5", "0"],
        "-cool": ["", "", "", ""],
    }
    assert counts[LARGE] == {
        "": ["", "7", "4", "0"],
        "-own-starts": ["", "9", "5", "0"],
        "-expert-starts": ["", "10", "10", "6"],
        "-fresh": ["", "", "", ""],
        "-helped": ["10", "", "", "1"],
        "-cool": ["", "", "", "7"],
    }


@recorded
def what_may_be_luck(arrives):
    """Where gate and primitives arrive in fewer seeds than the old policy,
    this may be luck, and so may the gain with the imitator as guide."""

    def may_be_luck(one, other):
        pair = arrives(one), arrives(other)
        return compare_successes(*pair, paired=True)[1] > 0.05

    for size_of in (SMALL, LARGE):
        for end_of in ("", "-own-starts", "-expert-starts"):
            kept = [(size_of, arm, end_of) for arm in ("policy", "8-both")]
            assert may_be_luck(*kept)
        for arm in ("policy", "8-both"):
            guided = [(size_of, arm, end) for end in ("", "-own-starts")]
            assert may_be_luck(*guided)


# ---- When a gate is enough ----


def _temperatures(runs, arm, end_of):
    run = runs[LARGE, arm, end_of]
    rows = [row for row in run.rows if row.step == 20_000]
    return np.array([row.metrics["temperature"] for row in rows])


@recorded
def the_primitives_must_push_left(offered, arrived):
    """The six seeds that arrive with the expert as guide are those with the
    highest shares, all above 90 %."""
    able = offered > 0.9
    assert able.sum() == 6
    assert set(np.flatnonzero(able)) == set(offered.argsort()[-6:])
    _, led, *_ = arrived.values()
    assert (led == able).all()


@exact
def by_chance():
    """There are 210 ways to pick six seeds of ten."""
    assert math.comb(10, 6) == 210


@recorded
def the_gate_must_see_the_way(runs, offered, arrived):
    """After the short fresh warm-up none arrives, although five of the six
    keep a temperature below 0.2."""
    none, *_ = arrived.values()
    assert none.sum() == 0
    short = _temperatures(runs, "8-gate", "")
    assert (short[offered > 0.9] < 0.2).sum() == 5


@recorded
def the_temperature_must_stay_low(runs, arrived):
    """After the long held warm-up the temperature is above 1 in nine seeds
    and above a million in two, and the remaining seed is the one that
    arrives; with the expert as guide none is above 0.01."""
    _, _, warmed, _ = arrived.values()
    assert warmed.sum() == 1
    hot = _temperatures(runs, "8-gate", "-helped")
    assert (hot > 1).sum() == 9
    assert (hot > 1e6).sum() == 2
    assert (np.flatnonzero(hot < 1) == np.flatnonzero(warmed)).all()
    assert _temperatures(runs, "8-gate", "-expert-starts").max() < 0.01


@recorded
def a_fixed_temperature(runs, offered, arrived):
    """At 0.02, about where the temperature settles if gate and primitives
    learn, the six arrive without an expert, and so does the seed at
    76 %."""
    usual = _temperatures(runs, "8-both", "-expert-starts")
    assert 0.01 < usual.min() < 0.02 < usual.max() < 0.03
    able = offered > 0.9
    *_, cool = arrived.values()
    assert cool[able].all()
    assert cool.sum() == 7
    assert round(100 * offered[cool & ~able].item()) == 76


# ---- Reward or exploration? ----


@recorded
def which_rewards_lead_to_the_goal(found):
    """Rewards of the state learned off-policy lead most policies to the
    goal after held actions, and the others hardly any; after fresh actions
    even the true reward leads only 3 of 10 there."""
    assert found == {
        "exact logit": [5, 5, 0, 1],
        "density of the replay": [3, 3, 0, 0],
        "released loss": [4, 5, 0, 0],
        "DAC": [0, 1, 0, 0],
        "PPO, r(s)": [1, 1, 0, 1],
        "PPO, r(s, a)": [0, 0, 0, 0],
        "true reward": [5, 5, 2, 1],
    }


@recorded
def which_rewards_prefer_a_failure(blamed):
    """No reward learned off-policy prefers a failure; PPO's r(s) does in
    half of the eight failures, and its r(s, a) in eight of ten."""
    assert {name: sum(each) for name, each in blamed.items()} == {
        "exact logit": 0,
        "density of the replay": 0,
        "released loss": 0,
        "DAC": 0,
        "PPO, r(s)": 8,
        "PPO, r(s, a)": 18,
    }
    held = [sum(blamed[f"PPO, {sees}"][:2]) for sees in ("r(s)", "r(s, a)")]
    assert held == [4, 8]


@recorded
def how_good_the_test_is(found, blamed):
    """After held steps the true reward leads every policy to the goal. On
    the learned rewards 32 fail: 18 on PPO's, of which the test catches 12,
    nine on DAC's and five on the others, of which it catches none."""
    failed = {name: 10 - sum(each[:2]) for name, each in found.items()}
    caught = {name: sum(each[:2]) for name, each in blamed.items()}
    assert failed["true reward"] == 0
    on_ppo = ("PPO, r(s)", "PPO, r(s, a)")
    assert sum(failed.values()) == 32
    assert sum(failed[name] for name in on_ppo) == 18
    assert failed["DAC"] == 9
    assert sum(caught.values()) == 12
    assert sum(caught[name] for name in on_ppo) == 12


@recorded
def from_right_to_left(backwards):
    """On the way back every old policy arrives after held actions; after
    fresh ones two do, and none from scratch."""
    assert (backwards["policy"] > BAR).all()
    assert (backwards["scratch-alone"] < -26).all()
    assert (backwards["policy-alone"] > BAR).sum() == 2


@recorded
def the_arrows(asked, spots, SEES):
    """Below the barrier most arrows ask for the old way, and nearly all are
    full pushes in both components."""
    under = spots[:, 1] < 0.25
    for name in SEES:
        right = asked[name][:, under, 0] > 0.1
        assert right.mean(1).min() > 0.7
        assert (abs(asked[name][0]) == 1).all(1).mean() > 0.9


# ---- Exercises ----


@exact
def five_out_of_five(least, bounds):
    """Five arrivals of five are compatible with a rate of 0.48, and it
    takes 36 seeds for a bound above 0.9."""
    assert least == 36
    assert bounds[0][1] == "0.48"


@exact
def the_convenient_reward(
    again_old, old_policy, soft_policy, of_state, new
):
    """Training on the advantage gives the old policy back, also in the new
    maze."""
    assert np.allclose(again_old, old_policy)
    assert np.abs(again_old - soft_policy(of_state, new)).max() > 0.1
