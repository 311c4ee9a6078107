"""What chapter 8 says about products of Gaussian policies."""

from pathlib import Path

import numpy as np
import scipy.integrate
import scipy.stats
import torch

from checks import demo_scale_only, exact, live, recorded
from offairl_lite import demonstrations
from offairl_lite.ablations.released import ReleasedProduct
from offairl_lite.analysis.statistics import difference
from offairl_lite.core.policies import (
    MultiplicativeGaussian,
    SquashedGaussian,
    make_actor,
    product_of_gaussians,
)
from offairl_lite.core.rng import Rng
from offairl_lite.runs import records

RECORDS = Path(__file__).parents[1] / "records"
BAR = -14  # above it a seed arrives


# ---- Products ----


@exact
def a_product_is_a_gaussian(compose):
    """The precisions add up: the formula gives the normalised product, and
    the package's is the same."""
    rng = np.random.default_rng(0)
    mean, std = rng.normal(size=(5, 1)), rng.uniform(0.2, 2, size=(5, 1))
    weight = rng.uniform(0, 1, size=5)
    mu, sigma = compose(mean, std, weight)

    def unnormalised(a):
        return np.prod(scipy.stats.norm.pdf(a, mean, std)[:, 0] ** weight)

    z, _ = scipy.integrate.quad(unnormalised, -20, 20, points=[mu[0]])
    for a in (-1.0, 0.0, 0.7):
        density = scipy.stats.norm.pdf(a, mu[0], sigma[0])
        assert np.isclose(density, unnormalised(a) / z, rtol=1e-6)
    theirs = product_of_gaussians(
        *map(torch.tensor, (mean, np.log(std), weight))
    )
    assert np.allclose(mu, theirs[0])
    assert np.allclose(sigma, theirs[1].exp())


@exact
def two_skills_multiplied(compose, legs_arm, sure, half):
    """After ten steps of the product legs and arm have each covered 0.99 m,
    with a standard deviation of 0.04 m."""
    mu, sigma = compose(legs_arm, sure, half)
    assert np.allclose(mu, 0.1 * 100 / 101)
    assert np.allclose(10 * mu, 0.99, atol=1e-3)
    assert np.allclose(10**0.5 * sigma, 0.0445, atol=1e-3)


@exact
def two_skills_added(legs_arm, sure):
    """After ten steps of the sum each has covered 0.5 m, with a standard
    deviation of 0.27 m."""
    mean = legs_arm.mean(0)
    assert np.allclose(10 * mean, 0.5)
    within, between = (sure**2).mean(0), legs_arm.var(0)
    spread = np.sqrt(10 * (within + between))
    assert [round(each, 2) for each in spread] == [0.27, 0.27]


@exact
def the_letter_sigma(compose, released_product):
    """The sure primitive should count a hundred times as much, and counts
    ten times as much in the released code."""
    mean = np.array([[0.0], [1.0]])
    std, half = np.array([[0.1], [1.0]]), np.array([0.5, 0.5])
    assert np.isclose(compose(mean, std, half)[0].item(), 1 / 101)
    assert np.isclose(released_product(mean, std, half)[0].item(), 1 / 11)


@exact
def the_released_code_has_this_formula(released_product):
    """The package's copy of the released product is this formula."""
    actor = ReleasedProduct(3, 2, (16,), (-9.0, 9.0), primitives=4)
    params, obs = actor.init(Rng([0])), Rng([1]).normal(5, 3)
    theirs = [x[0].numpy() for x in actor.distribution(params, obs)]
    each = [x[0].numpy() for x in actor.parts(params, obs)]
    for n, (mean, log_std, weight) in enumerate(zip(*each, strict=True)):
        mu, sigma = released_product(mean, np.exp(log_std), weight)
        assert np.allclose(mu, theirs[0][n], rtol=1e-4, atol=1e-6)
        assert np.allclose(np.log(sigma), theirs[1][n], atol=1e-5)


@exact
def gates_at_the_start(start):
    """Under a softmax the number of primitives makes no difference at the
    start, and under a sigmoid more of them make a narrower policy."""
    for k in (1, 4, 8):
        assert np.isclose(start["softmax", k], 1, rtol=1e-5)
        narrow = (k / 2) ** -0.5
        assert np.isclose(start["sigmoid", k], narrow, rtol=1e-5)


@exact
def one_primitive_is_plain_sac():
    """With one primitive under a softmax the actor is that of plain SAC."""
    actor = MultiplicativeGaussian(
        3, 2, (16, 16), primitives=1, primitive_hidden=(8,)
    )
    plain = SquashedGaussian(3, 2, (16, 16, 8))
    params = actor.init(Rng((0, 1)))
    trunk, primitive, _ = actor.split(params)
    obs, noise = Rng((2, 3)).normal(5, 3), Rng((4, 5)).normal(5, 2)
    alone = torch.cat([trunk, primitive[:, 0]], 1)
    for ours, theirs in zip(
        actor.sample(params, obs, noise),
        plain.sample(alone, obs, noise),
        strict=True,
    ):
        assert torch.allclose(ours, theirs, rtol=1e-4, atol=1e-5)


@exact
def fixed_primitives(learns):
    """With fixed primitives the gate alone has a gradient."""
    assert learns == {
        False: ["trunk", "primitives", "gate"],
        True: ["gate"],
    }


# ---- On the maze ----


@live
def the_seed_trained_here(run, size):
    """The seed that is trained here leaves the trap."""
    demo_scale_only(size)
    assert run.returns[0].max() > -20


@recorded
def it_is_one_of_five(five, config, seeds, size):
    """The five recorded seeds are those of the page's configuration."""
    demo_scale_only(size)
    assert five.seeds == seeds
    assert five.config == config
    assert (five.returns[:, -1] > BAR).all()


@recorded
def the_kind_of_product_matters_less_than_the_seed(ends):
    """The medians of the six actors differ less than the seeds of one actor
    do, and the released formula does no worse."""
    medians = {name: np.median(end) for name, end in ends.items()}
    assert min(medians.values()) > -11
    spreads = [np.ptp(end) for end in ends.values()]
    assert np.ptp([*medians.values()]) < np.median(spreads)
    assert medians["4-released"] > min(medians.values())


@recorded
def with_the_papers_networks(at_full_size, plain):
    """With the paper's networks all thirty seeds return more than the
    demonstrations, and the difference from one Gaussian is probably below
    0.5."""
    noted = demonstrations.EXPERTS / "PointMazeLeft.json"
    shown = records.read_json(noted)["demonstrated"][-1]
    assert round(shown, 1) == -6.5
    assert sum(map(len, at_full_size.values())) == 30
    for end in at_full_size.values():
        assert end.min() > shown
        _, low, high = difference(end, plain)
        assert max(-low, high) < 0.5


@exact
def weights_of_the_actors(full_runs):
    """The composite actors have five and seven times the weights."""
    one, four, eight = (
        make_actor(run.config.learner, 3, 2).num_params
        for run in full_runs.values()
    )
    assert (round(four / one), round(eight / one)) == (5, 7)


# ---- What the primitives do ----


@recorded
def who_leads(most, least, size):
    """In every seed one primitive leads in a large part of the maze, and
    one hardly anywhere."""
    demo_scale_only(size)
    assert 0.4 < min(most) < max(most) < 0.8
    assert max(least) < 0.05


@recorded
def who_leads_above_the_barrier(parts, policy, places, size):
    """Above the barrier primitive 1 leads on the left and primitive 4 on
    the right."""
    demo_scale_only(size)
    x, y = places.view(-1, 3)[:, :2].T.numpy()
    leader = parts(policy, places)[1].argmax(1)
    assert (leader[(y > 0.35) & (x < 0.2)] == 0).mean() > 0.8
    assert (leader[(y > 0.35) & (x > 0.35)] == 3).mean() > 0.8


@live
def the_gate_rests(along, size):
    """The gate moves while the particle is on its way, and rests when the
    particle does."""
    demo_scale_only(size)
    moves = np.abs(np.diff(along, axis=0)).sum(1)
    assert moves[50:].sum() < 0.2 * moves[:50].sum()


@exact
def a_gate_only_chooses(policy, places):
    """Each component of the mean action lies between the smallest and the
    largest of the primitives'."""
    with torch.no_grad():
        obs = policy.normaliser(places.view(1, -1, 3))
        means, _, _ = policy.actor.parts(policy.params, obs)
        mu, _ = policy.actor.distribution(policy.params, obs)
    assert (mu <= means.amax(2) + 1e-5).all()
    assert (mu >= means.amin(2) - 1e-5).all()


@recorded
def chance_decides(shares, pushed, x, y, size):
    """Seeds 0 and 4 offer the push to the left in most places, seed 0 in
    the most; the others only in the right half of the maze."""
    demo_scale_only(size)
    assert [share > 0.5 for share in shares] == [True, *[False] * 3, True]
    assert np.argmax(shares) == 0
    for seed in (1, 2, 3):
        offers = np.reshape(pushed[seed], x.shape)
        assert not offers[(y < 0.25) & (x < 0.25)].any()


@recorded
def the_gate_alone():
    """After a short warm-up the gate alone arrives in none of the five
    seeds, and if an expert acts first in seed 0 alone."""
    runs = RECORDS / "maze-retraining-demo"
    led = records.read(runs / "4-gate-expert-starts").returns[:, -1]
    assert np.flatnonzero(led > BAR).tolist() == [0]
    assert (records.read(runs / "4-gate").returns[:, -1] < BAR).all()


# ---- Exercises ----


@exact
def twins(softmax, sigmoid):
    """Under a softmax copies are harmless; under a sigmoid the standard
    deviation shrinks by the square root of two."""
    assert np.allclose(softmax, [[0.3], [0.5]])
    assert np.allclose(sigmoid, [[0.3], [0.5 / np.sqrt(2)]])


@exact
def what_is_missing(missing):
    """The more the primitives disagree, the more is missing."""
    assert np.allclose(missing, [0, 0.5, 2], atol=1e-9)


@exact
def a_sum_has_no_gradient(added, multiplied):
    """The sample of a sum has no gradient for the gate, and that of a
    product has one."""
    assert not added.requires_grad
    assert multiplied.requires_grad
