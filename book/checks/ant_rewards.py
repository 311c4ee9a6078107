"""What the note on the ant and the constant of a reward says."""

import numpy as np

from checks import exact as exactly
from checks import recorded
from offairl_lite import demonstrations, experiments
from offairl_lite.config import differences
from offairl_lite.runs import records

FIRST, SECOND, THIRD, FOURTH = (f"implementation-{n}" for n in range(1, 5))


@recorded
def runs_are_the_experiments(exact):
    """The five runs have three seeds each, and the settings of the
    experiment as it is now, but for their lengths."""
    for name, run in exact.items():
        wanted = experiments.configure(f"ant-rewards/{name}", "demo")
        assert set(differences(run.config, wanted)) <= {"total_steps"}
        assert len(run.seeds) == 3
        twice = name in (THIRD, FOURTH)
        assert run.steps[-1] == (100_000 if twice else 50_000)


@recorded
def demonstrations_return_about_2000():
    """The demonstrations return about 2,000."""
    noted = demonstrations.EXPERTS / "CustomAnt.json"
    shown = records.read_json(noted)["demonstrated"][0]
    assert 1_950 < shown < 2_050


@recorded
def dac_learns_to_walk(exact, between):
    """DAC learns to walk: it reaches half of the demonstrations' return in
    50,000 steps."""
    assert between(exact["dac"], 40_000, 50_000).min() > 700
    assert exact["dac"].returns[:, -1].mean() > 1_000


@recorded
def none_of_the_four_walks(exact, between):
    """None of the four Implementations learns to walk, 3 and 4 not even in
    twice as many steps."""
    for name in (FIRST, SECOND, THIRD, FOURTH):
        assert between(exact[name], 40_000, 50_000).max() < 150
    for name in (THIRD, FOURTH):
        assert between(exact[name], 80_000, 100_000).max() < 150


@recorded
def the_first_two_do_worse_than_nothing(exact, between, learned_returns):
    """Implementations 1 and 2 end near −85, and the return under their
    reward falls below minus one million."""
    for name in (FIRST, SECOND):
        assert between(exact[name], 40_000, 50_000).max() < -80
        assert learned_returns(exact[name])[:, -1].max() < -1e6


@recorded
def all_motors_at_full_strength(weakest):
    """With Implementations 1 and 2 all motors are at full strength at every
    step."""
    for least in weakest.values():
        assert least.min() > 0.99


@recorded
def one_ant_forgets_its_steps(exact):
    """One seed of Implementation 3 takes some steps at 80,000 and forgets
    them."""
    moved = exact[THIRD].returns
    assert moved[:2].max() < 150 < 450 < moved[2].max()
    assert moved[2, exact[THIRD].steps == 80_000] > 350
    assert moved[2, -1] < 0


@recorded
def learned_returns_follow_loosely(exact, follows):
    """The learned return of the four follows the true one loosely at
    best."""
    for name in (FIRST, SECOND, THIRD, FOURTH):
        assert follows(exact[name]).max() < 0.7


@recorded
def with_the_density_of_the_replay_it_walks(ants, between):
    """With the density of the replay Implementation 4 walks, but later: not
    in 50,000 steps, and at the last evaluation, after 100,000, in all
    seeds."""
    whole = ants["whole state"]
    assert between(whole, 40_000, 50_000).max() < 150
    late = between(whole, 80_000, 100_000)
    assert 50 < late.min() < late.max() < 400
    assert whole.returns[:, -1].min() > 100


@recorded
def its_discriminator_is_surer(ants):
    """Its discriminator tells the two sides apart more surely than DAC's
    does."""
    sure = {
        name: np.mean(
            [
                row.metrics["accuracy"]
                for row in ants[name].rows
                if 40_000 <= row.step <= 50_000
            ]
        )
        for name in ("whole state", "DAC")
    }
    assert sure["whole state"] > sure["DAC"]


@recorded
def the_reward_has_a_constant(ants, learned_returns):
    """The reward of the whole state is about −8 in each of 1,000 steps."""
    per_step = learned_returns(ants["whole state"])[:, -1] / 1_000
    assert -11 < per_step.min() < per_step.max() < -5


@exactly
def a_constant_changes_nothing(changed):
    """A constant in the reward and the value leaves f as it is."""
    assert changed < 1e-3


@recorded
def centred_they_walk_well(ants, between):
    """Centred, all three ants walk with a reward of the whole state, though
    later than DAC's."""
    centred = ants["whole state, centred"]
    assert between(centred, 80_000, 100_000).min() > 600
    there = between(centred, 40_000, 50_000).mean()
    assert there < between(ants["DAC"], 40_000, 50_000).mean()


@recorded
def halfcheetah_is_no_better_when_centred(last, cheetahs, learned_returns):
    """On HalfCheetah with the density of the replay four of five seeds
    begin to run when centred, later than as it is, where the reward is −4
    to −8 a step."""
    mixture = "HalfCheetah-airl-mixture"
    level = learned_returns(cheetahs[mixture, "short"])[:, -1]
    assert -8_000 < level.min() < level.max() < -4_000
    assert last[mixture, "short"].min() > 500
    assert np.median(last[mixture, "centred"]) < 700
    assert (last[mixture, "centred"] > 400).sum() == 4


@recorded
def the_exact_logit_learns_nothing(last):
    """With the exact logit HalfCheetah learns nothing, centred or not."""
    for form in ("short", "centred"):
        assert last["HalfCheetah-airl", form].max() < 0


@recorded
def the_velocity_learns_sooner_and_falls_back(ants):
    """A reward of the velocity alone learns sooner; at the last evaluation
    all three seeds have fallen back."""
    returns = ants["velocity"].returns
    assert returns[:, -2].min() > 500
    assert (returns[:, -1] < returns[:, -2]).all()
    assert returns[:, -1].min() < 0


@recorded
def centred_the_velocity_falls_back_too(HOME):
    """With a centred reward of the velocity each seed passes 900 within
    50,000 steps and falls back again."""
    place = HOME / "ant-rewards-centred-demo/implementation-4-velocity"
    run = records.read(place)
    assert run.steps[-1] == 50_000
    assert run.returns.max(1).min() > 900
    assert run.returns[:, -1].max() < 550
