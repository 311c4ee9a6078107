"""What the note on the density of the replay says."""

import math

import numpy as np
import torch

from checks import exact, recorded
from offairl_lite.core.policies import defensive_log_density
from offairl_lite.core.rewards import IMPLEMENTATIONS
from offairl_lite.runs import records


@recorded
def expert_pushes_hard(measured, shown):
    """HalfCheetah's expert returns about 8,700, and more than 40 % of the
    numbers in its actions are beyond 0.9."""
    assert 8_700 < shown < 8_800
    assert measured["share beyond 0.9"] > 0.4


@recorded
def short_runs(runs):
    """In the first figure each method has five seeds and 20,000 steps, of
    which the first 10,000 are random, and a learned temperature."""
    for run in runs.values():
        schedule, config = run.config.schedule, run.config
        assert len(run.seeds) == 5
        assert run.steps[-1] == 20_000 == 2 * schedule.warmup_steps
        assert config.learner.temperature is None


@recorded
def the_airl_loss_learns_nothing(last):
    """With the AIRL loss no seed learns in 20,000 steps; with a floor
    under σ two of five begin to run."""
    assert last["AIRL loss"].max() < 0
    assert (last["AIRL loss, σ > 0.37"] > 500).sum() == 2


@recorded
def others_learn(last):
    """The log-ratio loss and DAC learn in every seed, equally fast; the
    mixture does in every seed, too, but more slowly."""
    middle = {name: np.median(returns) for name, returns in last.items()}
    for name in ("log-ratio loss", "DAC"):
        assert last[name].min() > 1_500
        assert middle["the mixture"] < middle[name]
    assert 0.95 < middle["log-ratio loss"] / middle["DAC"] < 1.05
    assert last["the mixture"].min() > 500


@recorded
def tail_of_log_pi(medians):
    """log π is far lower on the robot than on the maze, above all at the
    expert's steps, where its median is −6 to −1 on the maze and −1,488 to
    −419 on the robot; at the warm-up's steps −log π is in the tens."""
    easy, hard = medians["maze"], medians["HalfCheetah"]
    assert easy["expert"].min() > -10
    assert -20 < easy["warm-up"].min() < easy["warm-up"].max() < -5
    assert hard["expert"].max() < -200
    ends = [
        [round(float(x["expert"].min())), round(float(x["expert"].max()))]
        for x in (easy, hard)
    ]
    assert ends == [[-6, -1], [-1_488, -419]]
    assert -100 < hard["warm-up"].min() < hard["warm-up"].max() < -15


@recorded
def sure_of_the_expert(runs):
    """With the AIRL loss the mean logit at the expert's steps ends above
    300, and that at the policy's below 0."""
    now = [row.metrics for row in runs["AIRL loss"].rows[-5:]]
    assert min(m["expert_logit"] for m in now) > 300
    assert max(m["policy_logit"] for m in now) < 0
    assert max(m["entropy"] for m in now) < 0.02


@recorded
def accuracy_is_lower(runs):
    """The AIRL loss's discriminator is less accurate than the others."""
    accuracy = {
        name: np.mean([row.metrics["accuracy"] for row in run.rows])
        for name, run in runs.items()
    }
    assert 0.85 < accuracy["AIRL loss"] < 0.9
    for name in ("DAC", "log-ratio loss", "the mixture"):
        assert accuracy[name] > 0.97


@recorded
def floor_of_the_mixture(measured):
    """More than 99 % of the expert's actions are below the mixture's floor,
    and the policy's own actions are above."""
    mixed = measured["mixture"]
    floor = math.log(1 / 2) - 6 * math.log(2)
    assert math.isclose(mixed["floor"], floor, rel_tol=1e-5)
    assert mixed["lowest"] >= floor - 1e-4
    assert mixed["median exact"] < -100
    assert mixed["median mixture"] > -5
    assert mixed["below the floor"] > 0.99
    assert mixed["own above the floor"] > 0.99


@exact
def floor_sinks_slowly():
    """Without a share of the warm-up the mixture is AIRL's logit; at
    1,000,000 steps, one percent, the floor is still −8.8."""
    foreign = torch.tensor(-1_000.0)
    assert defensive_log_density(foreign, 0.0, 6) == foreign
    floor = float(defensive_log_density(foreign, 0.01, 6))
    assert round(floor, 1) == -8.8


@recorded
def patience(long, arrived):
    """In ten times as many steps the mixture stays behind DAC, and the
    AIRL loss learns nothing."""
    assert all(run.steps[-1] == 200_000 for run in long.values())
    assert long["DAC"].config.learner.temperature is None
    assert arrived["the mixture"].min() > 0.55
    assert arrived["the mixture"].max() < 0.7
    assert arrived["DAC"].min() > 0.8
    assert long["AIRL loss"].returns[:, 1:].max() < 0


@recorded
def mixture_is_early(long, arrived, shown):
    """After 50,000 steps the mixture has more than half of its final
    return."""
    run = long["the mixture"]
    assert run.steps[4] == 50_000
    assert (run.returns[:, 4] / shown > arrived["the mixture"] / 2).all()


@recorded
def nearer_to_the_expert(measured):
    """At the end 18 % of the expert's actions are above the floor of the
    short runs, where fewer than 1 % were."""
    mixed = measured["mixture"]
    assert round(mixed["later above the floor"], 2) == 0.18
    assert 1 - mixed["below the floor"] < 0.01


@recorded
def hoppers_rescues_do_not_help(arrived, others):
    """Neither a temperature of 1 nor the whole logit as the reward, which
    rescue Hopper, helps here."""
    assert all(run.steps[-1] == 200_000 for run in others.values())
    assert arrived["the mixture, α = 1"].max() < 0.1
    paid = arrived["the mixture, logit with r(s, a) as the reward"]
    assert paid.max() < arrived["the mixture"].min()


@recorded
def two_changes(long, others):
    """The reward of the second is the whole logit, with an r that sees the
    action, and all else is equal."""
    run = others["the mixture, logit with r(s, a) as the reward"]
    ours, other = long["the mixture"].config.flat(), run.config.flat()
    (changed,) = {key for key in ours if ours[key] != other[key]}
    ours, other = (IMPLEMENTATIONS[c[changed]] for c in (ours, other))
    assert (ours.state_only, ours.reward_is_logit) == (True, False)
    assert (other.state_only, other.reward_is_logit) == (False, True)


@recorded
def diagnostics(HOME):
    """On the maze, with the AIRL loss, the accuracy is about one half,
    replay has the higher mean logit, and the cross-entropy stays above
    2 log 2."""
    maze = records.read(HOME / "maze-imitation-demo")
    end = [row.metrics for row in maze.rows[-5:]]
    assert np.median([m["accuracy"] for m in end]) < 0.6
    assert sum(m["policy_logit"] > m["expert_logit"] for m in end) >= 4
    assert np.median([m["cross_entropy"] for m in end]) > 2 * math.log(2)


@recorded
def learned_rewards_rank(measured):
    """Each of five learned rewards ranks the episodes of 25 imitators
    roughly as the true reward does: the rank correlations are above
    0.6."""
    assert len(measured["rank correlations"]) == 5
    assert measured["rank correlations"].min() > 0.6


@recorded
def log_ratio_loss_at_low_temperature(HOME):
    """At α = 0.2 and with 1,000 random steps each of five seeds of the
    log-ratio loss returns more than all five of the mixture."""
    decided = {}
    for loss in ("mixture", "released"):
        path = f"what-decides-demo/HalfCheetah-{loss}-fixed-short"
        run = records.read(HOME / path)
        assert run.config.schedule.warmup_steps == 1_000
        assert (run.config.learner.temperature, run.steps[-1]) == (
            0.2,
            100_000,
        )
        kinds = {"mixture": "airl-mixture", "released": "log-ratio"}
        assert run.config.discriminator.loss == kinds[loss]
        assert len(run.seeds) == 5
        decided[loss] = run.returns[:, -5:].mean(1)
    assert decided["released"].min() > decided["mixture"].max()
