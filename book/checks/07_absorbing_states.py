"""What the chapter on absorbing states says."""

import math

import numpy as np
import torch

from checks import exact, live, recorded
from offairl_lite.core import absorbing
from offairl_lite.core.experience import analytic_return
from offairl_lite.plain import Batch, Discriminator

LENGTHS = {"total_steps", "eval_every", "eval_episodes"}


# ---- What is the end worth? ----


@exact
def price_of_life(action_values, reward, before, life):
    """A constant adds c times the discounted length of life if the end is
    worth nothing, and the same everywhere if the end pays c as well."""
    c = 0.7
    assert np.allclose(action_values(reward(c, 0)), before + c * life)
    assert np.allclose(action_values(reward(c, c)), before + c / 0.1)
    assert np.ptp(life) > 1  # so the order of policies changes


@exact
def two_thresholds(
    nothing, itself, shifts, never, fall, FALLS, ARRIVES, STAYS
):
    """If the end is worth nothing, never ending is best above one threshold
    of the constant, and falling below the other. If it pays the constant
    as well, arriving is always best."""
    c = shifts[:, None]
    # On a threshold both are equally good.
    clear = (abs(c - never) > 1e-6) & (abs(c - fall) > 1e-6)
    assert ((nothing == STAYS) == (c > never))[clear].all()
    assert ((nothing == FALLS) == (c < fall))[clear].all()
    assert (itself == ARRIVES).all()


@exact
def both_signs_can_be_biased(fate, STAYS, ARRIVES):
    """At γ = 0.99, with c = 0.0102, it is better to live for ever than to
    reach the goal; with a little less it is not."""
    assert fate(0.0102, 0.99, 0) == STAYS
    assert fate(0.0100, 0.99, 0) == ARRIVES


# ---- Nobody chose the constant ----


@exact
def the_loss_leaves_the_constant_open():
    """f does not change if r is raised by c, and V by c / (1 - γ)."""
    rng, c = torch.Generator().manual_seed(0), 2.0
    airl = Discriminator(4, rng)
    obs, next_obs = torch.randn(2, 64, 4, generator=rng)
    with torch.no_grad():
        f, r = airl.f(obs, next_obs), airl.r(obs)
        airl.reward[-1].bias += c
        airl.value[-1].bias += c / (1 - airl.discount)
        assert torch.allclose(airl.f(obs, next_obs), f, atol=1e-3)
        assert torch.allclose(airl.r(obs), r + c, atol=1e-5)


# ---- An episode that goes on ----


@exact
def stored_as_in_the_package(go_on):
    """The package stores an episode that terminates in the same way, and
    leaves one that is cut as it is."""
    rng = torch.Generator().manual_seed(0)
    x = torch.randn(4, 2, generator=rng)
    ends = torch.tensor([0.0, 0.0, 1.0])
    u = torch.randn(3, 1, generator=rng)
    parts = x[:-1], u, x[1:], torch.zeros(3)
    ended, cut = Batch(*parts, ends), Batch(*parts, 0 * ends)
    theirs = absorbing.with_absorbing_states(ended)
    assert all(map(torch.equal, go_on(ended), theirs))
    assert len(absorbing.with_absorbing_states(cut).reward) == 3


@exact
def value_of_the_last_step(R_T):
    """The last step is worth γ r(s_a) / (1 - γ), -9 here."""
    assert math.isclose(R_T, -9)
    assert math.isclose(R_T, analytic_return(0.0, -1.0, 0.9))


@live
def two_ways_to_one_value(learned, predicted, R_T):
    """Critics come to the same value in both ways: `analytic` within 200
    updates, and `bootstrap` after more than 1,000, along the predicted
    curve."""
    off = {name: abs(q / R_T - 1) for name, q in learned.items()}
    assert np.abs(learned["bootstrap"] - predicted)[200:].max() < 2
    assert all(x[-1] < 0.15 for x in off.values())
    assert off["analytic"][200:].max() < 0.1
    assert off["bootstrap"][600] > 0.1
    assert off["bootstrap"][800] > 0.06


@exact
def one_fixed_point(reward, move, END, RIGHT):
    """On the chain, with a table for a critic, both have one fixed
    point."""
    r, gamma = reward(0.3, end=-0.2), 0.9
    tables = {name: np.zeros((4, 3)) for name in ("bootstrap", "analytic")}
    for _ in range(400):
        for name in tables:
            value = tables[name].max(1)
            if name == "analytic":
                value[END] = r[END, 0] / (1 - gamma)
            tables[name] = r + gamma * move @ value
    assert np.allclose(*tables.values())
    known = analytic_return(1.3, -0.2, gamma)
    assert math.isclose(tables["bootstrap"][2, RIGHT], known)


@exact
def a_constant_cancels(reward, move, END, LEFT, STAY, RIGHT):
    """With `bootstrap` a constant cancels at every update. With `analytic`
    it cancels when life has caught up: until then a negative one holds the
    agent back from the goal, and a positive one makes it fall."""
    gamma = 0.9

    def preferences(c, name):
        # What a table prefers at each update, if its target is slow.
        r, slow, found = reward(c, end=c), np.zeros((4, 3)), []
        for _ in range(1_200):
            value = slow.max(1)
            if name == "analytic":
                value[END] = r[END, 0] / (1 - gamma)
            quick = r + gamma * move @ value
            slow += 0.05 * (quick - slow)
            found.append(quick[:END] - quick[:END, [STAY]])
        return np.array(found)

    plain = preferences(0, "bootstrap")
    early = {}
    for c in (-1, 1):
        assert np.allclose(preferences(c, "bootstrap"), plain)
        analytic = preferences(c, "analytic")
        assert np.allclose(analytic[-1], plain[-1], atol=0.1)
        early[c] = analytic[0]
    assert early[-1][2, RIGHT] < 0
    assert early[1][0, LEFT] > 0


@exact
def counted_after_8000_updates(live):
    """After 8,000 updates `bootstrap` has counted 18 % of what follows the
    end; its time constant is 40,000 updates."""
    tau, life = live.learner.target_rate, 1 - live.learner.discount
    assert math.isclose(2 / (tau * life), 40_000, rel_tol=1e-6)
    counted = 1 - (1 - tau * life) ** (8_000 / 2)
    assert round(100 * counted) == 18


# ---- The hopper ----


@recorded
def same_settings(recipe, live, long, falling):
    """The recorded imitators have the settings of the one that is trained
    here; those without an absorbing state differ in nothing else."""

    def flat(config):
        settings = config.flat().items()
        return {k: v for k, v in settings if k not in LENGTHS}

    assert flat(recipe) == flat(live) == flat(long.config)
    without = flat(falling.config)
    differ = {k for k in without if without[k] != flat(live)[k]}
    assert differ == {"absorbing"}
    assert falling.steps[-1] == long.steps[-1] == 100_000


@recorded
def expert_falls(kept):
    """The expert falls in 43 of its 50 demonstrations."""
    assert kept["demonstrations_that_fall"] == 43


@recorded
def film(kept, FRAMES):
    """In the film the expert never falls, the imitator with an absorbing
    state comes farther than the one without, which falls at once."""
    last, told = FRAMES - 1, kept["film"]
    assert told["expert"]["falls"][last] == 0
    reached = {name: seen["farthest"][last] for name, seen in told.items()}
    assert reached["expert"] > reached["with"] > reached["without"]
    assert told["without"]["falls"][last] > 20  # in 228 steps


@recorded
def without_it_they_fall(falling, kept):
    """Without an absorbing state all five seeds fall at once after 8,000
    steps. After 100,000 four still do, within about eight steps, and one of
    them stood for a while in between; the fifth stays up for about a
    hundred steps."""
    assert kept["short"]["without"]["steps"][-1] == 8_000
    assert kept["short"]["without"]["returns"][:, -1].max() < 20
    assert falling.returns[:, falling.steps == 8_000].max() < 20
    assert falling.returns[:4, -1].max() < 20
    assert 190 < falling.returns[4, -1] < 195
    stood = falling.returns.max(1) > 1_000
    assert stood.tolist() == [False, False, False, True, False]
    assert kept["lengths"][:4].max() <= 8
    assert 90 < kept["lengths"][4].mean() < 110
    assert min(row.episodes for row in falling.rows[-5:]) > 500


@recorded
def with_it_they_hop(long, kept):
    """After 8,000 steps with an absorbing state the recorded imitators have
    begun to hop, but return less than the 1,000 of standing still. After
    100,000 all five return more than 2,000. A seed returns 2,717 at 20,000
    steps and 272 at 30,000."""
    begun = kept["short"]["with"]["returns"][:, -1]
    assert begun.min() > 100
    assert begun.max() < 1_000
    assert long.returns[:, -1].min() > 2_000
    assert long.steps[1:3].tolist() == [20_000, 30_000]
    assert long.returns[0, 1:3].round().tolist() == [2_717, 272]


@live
def yours_stays_up(run, falling):
    """The hopper that is trained here stays up longer than those that have
    learned to fall."""
    assert np.isfinite(run.returns).all()
    fallen = falling.returns[:, falling.steps == 5_000]
    assert fallen.max() < 10
    assert run.returns[:, -2:].max() > 6 * fallen.max()


@recorded
def what_a_step_pays(kept, falling):
    """After 8,000 steps without an absorbing state a demonstrated step
    pays, and a step of the imitator's own costs, in every seed; with it,
    both pay more than the end does."""
    without, known = kept["pays"]["without"], kept["pays"]["with"]
    assert without["own"].max() < -2
    assert without["demonstrated"].min() > 1
    assert known["demonstrated"].mean() > 1
    assert known["own"].min() > 0
    life = 1 / (1 - falling.config.learner.discount)
    assert math.isclose(life, 100)


@recorded
def the_discriminator_recognises_steps(falling):
    """Without an absorbing state the discriminator recognises at least 88 %
    of the steps at every evaluation."""
    right = [row.metrics["accuracy"] for row in falling.rows]
    assert min(right) > 0.875


# ---- A time limit is no end ----


@exact
def hazard_at_the_goal(hazard, RIGHT):
    """The cut seems to come soon at the goal: the hazard is highest there,
    about 1/18."""
    assert math.isclose(hazard[2, RIGHT], 1 / 18, abs_tol=5e-4)
    assert hazard[2, RIGHT] == hazard.max()


@exact
def the_cut_as_an_end(stored, hazard, LEFT, RIGHT):
    """Stored as an end worth 0, the cut makes the agent leave the goal if a
    constant is added; as the way to s_a, without any constant."""
    leaves = [each.policy[2, LEFT] for each in stored.values()]
    assert np.allclose(leaves, [0, 0, 1, 1])
    assert math.isclose(math.log(1 / 20), -3, abs_tol=0.005)
    staying = [
        pays / (1 - 0.99 * (1 - hazard[state, RIGHT]))
        for state, pays in ((2, 3), (0, 1))
    ]
    assert [round(value) for value in staying] == [46, 90]


# ---- Exercises ----


@exact
def one_flag(learned_value):
    """With a limit of 100 nearly all of the true value is gone, and with
    1,000 a fifth, if the cut leads to an absorbing state that pays -1."""
    assert math.isclose(learned_value(math.inf, 0), 100)
    assert 50 < learned_value(100, 0) < 51
    assert abs(learned_value(100, -1)) < 1.5
    assert 81 < learned_value(1_000, -1) < 83


@exact
def harmless_constants(threshold):
    """The smallest constant for which it is best never to end is 0.0101 if
    the end pays nothing, and 0.0202 if it pays half of the constant."""
    assert math.isclose(threshold(0.0), 0.01 / 0.99, abs_tol=1e-4)
    assert math.isclose(threshold(0.5), 0.02 / 0.99, abs_tol=1e-4)


@exact
def how_often_the_loop_is_stored(logit_there):
    """With one row an episode the logit in the absorbing state is -2.95,
    with a hundred -1.43; it is 0 for episodes of one length, and above 0
    if the imitator's are longer."""
    assert math.isclose(logit_there(400, 20, 1), -2.95, abs_tol=0.01)
    assert math.isclose(logit_there(400, 20, 100), -1.43, abs_tol=0.01)
    assert logit_there(400, 1_000, 1) > 0
    assert logit_there(400, 400, 1) == logit_there(400, 400, 100) == 0
