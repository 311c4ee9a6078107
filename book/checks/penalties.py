"""What the note on what keeps a discriminator in bounds says."""

import numpy as np
import torch

import other_bounds
from checks import exact, recorded
from offairl_lite.config import differences


@exact
def power_iteration(weight, u):
    """Power iteration finds the largest singular value of a matrix."""
    largest = torch.linalg.matrix_norm(weight, ord=2)
    assert torch.isclose((weight @ u).norm(), largest, rtol=1e-3)


@exact
def steepest_sigmoid():
    """D (1 − D) is at most 1/4, so f needs a slope of 4 where D is 1/2."""
    d = np.linspace(0, 1, 101)
    assert (d * (1 - d)).max() == 0.25


@recorded
def runs_are_those_of_the_experiment(runs):
    """All six variants train as `other_bounds` says, with five seeds."""
    for name, run in runs.items():
        wanted = other_bounds.configure(name, "demo")
        assert set(differences(run.config, wanted)) <= {"total_steps"}
        assert run.seeds == (0, 1, 2, 3, 4)


@recorded
def no_bound_is_no_bound(runs):
    """Without a bound the penalty is never small, and the discriminator is
    accurate throughout."""
    metrics = [row.metrics for row in runs["none"].rows]
    assert min(m["penalty"] for m in metrics) > 1_000
    assert min(m["accuracy"] for m in metrics) > 0.9


@recorded
def without_a_bound(middle, steep, distance):
    """Without any bound the policy returns little less than with the
    penalty, but the reward is more than ten times as steep, and far from
    the truth."""
    assert -14 < middle["none"] < -10 < middle["logit"] < -8
    assert steep["none"] > 10 * steep["logit"]
    assert distance["none"] > 3 * distance["logit"]


@recorded
def one_sided_is_as_good(middle, steep, distance):
    """One-sided or two-sided makes no difference: both have the best
    returns and the smallest distances."""
    one, two = "one-sided", "logit"
    assert abs(middle[one] - middle[two]) < 2
    assert 0.8 < steep[one] / steep[two] < 1.25
    best = {one, two}
    others = [name for name in middle if name not in best]
    for name in best:
        assert middle[name] > max(middle[other] for other in others)
        assert distance[name] < 0.1
        assert distance[name] < min(distance[other] for other in others)


@recorded
def spectral_normalisation(middle, reached, steepest, away):
    """Spectral normalisation holds the slope to at most 1 at all 200 places
    in every seed, and most of its policies rest in the upper right corner;
    yet its rewards are nearer to the truth than without a bound."""
    assert steepest["spectral"] < 1
    assert middle["spectral"] < -24
    assert reached.sum() == 3
    assert away["spectral"].max() < away["none"].min()


@recorded
def bottleneck(ends, middle, steep, distance):
    """Under the bottleneck two of five seeds imitate, and the reward is as
    steep as without a bound, and far from the truth."""
    assert (ends["bottleneck"] > -20).sum() == 2
    assert middle["bottleneck"] < -24
    assert 0.8 < steep["bottleneck"] / steep["none"] < 1.3
    assert distance["bottleneck"] > 0.2


@recorded
def nats_of_the_codes(runs):
    """The three codes end with 0.5 to 0.7 nats."""
    excess = [row.metrics["excess"] for row in runs["bottleneck"].rows[-5:]]
    assert -0.01 < min(excess) < max(excess) < 0.2


@recorded
def on_the_probability(ends, middle, steep, distance):
    """The penalty on the probability lets four of five seeds imitate; its r
    is several times as steep as under the penalty on f, and its EPIC
    distance about four times as large."""
    assert middle["probability"] > -12
    assert (ends["probability"] > -20).sum() == 4
    assert steep["probability"] > 4 * steep["logit"]
    assert 3.5 < distance["probability"] / distance["logit"] < 5


@recorded
def planes(flat):
    """Under spectral normalisation r is nearly a plane; under the penalty
    it is not."""
    assert flat["spectral"].min() > 0.99
    assert flat["logit"].max() < 0.9


@recorded
def the_experts_path(measured):
    """Only under the bottleneck is the experts' path much higher than the
    rest."""
    path = measured["path"]
    others = [path[name].max() for name in path if name != "bottleneck"]
    assert path["bottleneck"].min() > 0.9 > 0.5 > max(others)
    assert path["none"].min() > 0.1
    for name in ("logit", "spectral"):
        assert np.abs(path[name]).max() < 0.03
