import math
from itertools import pairwise

import numpy as np
import pytest
import scipy.integrate
import scipy.stats
import torch

from offairl_lite.ablations.released import ReleasedPolicy, ReleasedProduct
from offairl_lite.core import policies
from offairl_lite.core.networks import Normaliser
from offairl_lite.core.policies import (
    MAX_ACTION,
    Deterministic,
    MultiplicativeGaussian,
    Policy,
    SquashedGaussian,
    defensive_log_density,
    log_tanh_slope,
    product_of_gaussians,
    unsquash,
)
from offairl_lite.core.rng import Rng

RANGE = (-5.0, 2.0)
CASES = {"ordinary": (0.0, 0.5), "narrow": (0.3, 0.02), "wide": (0.0, 5.0), "off-centre": (3.0, 1)}
SATURATED = (-20.0, -8.0, -3.0, -0.5, 0.0, 1.0, 3.0, 8.0, 20.0)


def constant_actor(mean, std):
    """An actor of one state and one action with μ and σ as given, in float64."""
    actor = SquashedGaussian(1, 1, (), RANGE)
    raw = math.atanh(2 * (math.log(std) - RANGE[0]) / (RANGE[1] - RANGE[0]) - 1)
    params = torch.tensor([[mean, raw, 0.0, 0.0]], dtype=torch.float64)
    return actor, params


def log_prob(actor, params, pre_tanh):
    u = torch.as_tensor(pre_tanh, dtype=torch.float64).view(1, -1, 1)
    return actor.log_prob(params, torch.zeros_like(u), u)[0]


def integral(mean, std):
    """Integrate the density over the actions, a = tanh(u), piece by piece in u."""
    actor, params = constant_actor(mean, std)

    def density(u):
        slope = 1 / math.cosh(u) ** 2
        return log_prob(actor, params, [u]).exp().item() * slope

    edges = np.unique(np.clip([-18, mean - 8 * std, mean, 0, mean + 8 * std, 18], -18, 18))
    return sum(scipy.integrate.quad(density, a, b, limit=200)[0] for a, b in pairwise(edges))


@pytest.mark.parametrize(("mean", "std"), CASES.values(), ids=CASES)
def test_the_density_integrates_to_one_over_the_actions(mean, std):
    # Of the wide one, 3e-4 lies beyond |u| = 18, where actions are ±1 in float64.
    beyond = 2 * scipy.stats.norm.sf(18, 0, 5) if std == 5 else 0
    assert integral(mean, std) == pytest.approx(1 - beyond, abs=1e-7)


def test_the_density_integrates_to_one_in_the_action_itself():
    actor, params = constant_actor(0.2, 0.7)

    def density(a):
        return log_prob(actor, params, [math.atanh(a)]).exp().item()

    assert scipy.integrate.quad(density, -1, 1, limit=200)[0] == pytest.approx(1, abs=1e-7)


@pytest.mark.parametrize(("mean", "std"), CASES.values(), ids=CASES)
def test_log_prob_is_scipy_s_normal_and_the_change_of_variables(mean, std):
    actor, params = constant_actor(mean, std)
    u = np.array(SATURATED)
    # log(1 - tanh²u) = -2 log cosh u, of which numpy's logaddexp loses nothing.
    log_slope = -2 * (np.logaddexp(u, -u) - math.log(2))
    expected = scipy.stats.norm.logpdf(u, mean, std) - log_slope
    np.testing.assert_allclose(log_prob(actor, params, u), expected, rtol=1e-8)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 1.0])
def test_the_defensive_density_is_the_mixture_with_the_uniform_one(share):
    actor, params = constant_actor(0.2, 0.3)
    a = np.linspace(-0.999, 0.999, 41)
    log_pi = log_prob(actor, params, np.arctanh(a))
    found = defensive_log_density(log_pi, share, 1)
    expected = (1 - share) * log_pi.exp().numpy() + share * scipy.stats.uniform.pdf(a, -1, 2)
    np.testing.assert_allclose(found.exp(), expected, rtol=1e-9)

    def density(a):
        log_pi = log_prob(actor, params, [math.atanh(a)])
        return defensive_log_density(log_pi, share, 1).exp().item()

    assert scipy.integrate.quad(density, -1, 1, limit=200)[0] == pytest.approx(1, abs=1e-7)


def test_the_defensive_density_has_no_tail_however_foreign_the_action():
    log_pi = torch.tensor([-1e6, -1e3, -10.0])
    found = defensive_log_density(log_pi, 0.01, 6)
    torch.testing.assert_close(found[:2], torch.full((2,), math.log(0.01 / 2**6)))
    assert (found >= math.log(0.01 / 2**6)).all()
    assert torch.equal(defensive_log_density(log_pi, 0.0, 6), log_pi)


def test_log_prob_is_summed_over_actions_and_follows_the_state():
    actor = SquashedGaussian(3, 2, (7,))
    params = actor.init(Rng((0, 1))).double()
    obs, u = (Rng((4, 5)).normal(6, n).double() for n in (3, 2))
    mean, log_std = actor.distribution(params, obs)
    normal = scipy.stats.norm.logpdf(u, mean, log_std.exp())
    expected = (normal - np.log(1 - np.tanh(u.numpy()) ** 2)).sum(-1)
    np.testing.assert_allclose(actor.log_prob(params, obs, u), expected, rtol=1e-8)


@pytest.mark.parametrize("pre_tanh", SATURATED)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_saturated_actions_have_finite_densities_and_gradients(pre_tanh, dtype):
    actor, params = constant_actor(0.3, 0.5)
    u = torch.full((1, 1, 1), pre_tanh, dtype=dtype, requires_grad=True)
    params = params.to(dtype).requires_grad_()
    value = actor.log_prob(params, torch.zeros_like(u), u)
    gradients = torch.autograd.grad(value.sum(), [params, u])
    assert value.isfinite().all()
    assert all(gradient.isfinite().all() for gradient in gradients)


@pytest.mark.parametrize("pre_tanh", SATURATED)
def test_gradients_are_finite_differences(pre_tanh):
    actor = SquashedGaussian(2, 2, (5,))
    params = actor.init(Rng((0,))).double().requires_grad_()
    obs = Rng((1,)).normal(3, 2).double()
    u = torch.full((1, 3, 2), pre_tanh, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda p, u: actor.log_prob(p, obs, u).tanh() + actor.log_prob(p, obs, u) / 1e3,
        (params, u),
        rtol=1e-4,
    )


GATINGS = ("softmax", "sigmoid", "softplus")
PRODUCTS = [
    MultiplicativeGaussian(3, 2, (7, 5), RANGE, 4, (5,), (6,), gating) for gating in GATINGS
]


@pytest.mark.parametrize("actor", [SquashedGaussian(3, 2, (7,)), *PRODUCTS])
def test_a_sample_comes_with_its_own_log_prob(actor):
    params = actor.init(Rng((0, 1))).double()
    obs, noise = (Rng((4, 5)).normal(6, n).double() for n in (3, 2))
    # Far out as well: 30 σ.
    noise[:, 0] = 30
    pre_tanh, log_prob = actor.sample(params, obs, noise)
    mean, log_std = actor.distribution(params, obs)
    torch.testing.assert_close(pre_tanh, mean + log_std.exp() * noise)
    assert torch.equal(actor.explore(params, obs, noise), pre_tanh)
    torch.testing.assert_close(log_prob, actor.log_prob(params, obs, pre_tanh))


def test_log_std_stays_in_its_range():
    actor = SquashedGaussian(1, 1, (), (-3.0, 1.0))
    obs = torch.zeros(1, 1, 1)
    for raw, expected in ((-50.0, -3.0), (0.0, -1.0), (50.0, 1.0)):
        params = torch.tensor([[0.0, raw, 0.0, 0.0]])
        assert actor.distribution(params, obs)[1].item() == pytest.approx(expected)


@pytest.mark.parametrize("action", [-1.0, -0.99999999, 0.0, 0.5, 1.0])
def test_unsquash_inverts_up_to_its_clamp(action):
    u = unsquash(torch.tensor(action, dtype=torch.float64))
    assert torch.tanh(u).item() == pytest.approx(min(max(action, -MAX_ACTION), MAX_ACTION))
    assert abs(u.item()) <= 7.2544


def test_unsquash_is_finite_in_float32_too():
    u = unsquash(torch.tensor([-1.0, 1.0]))
    assert u.isfinite().all()
    assert u.abs().max() < 7.3


def test_the_slope_of_tanh_is_exact_where_it_vanishes():
    u = torch.tensor([0.0, 1.0, -1.0, 30.0, -30.0], dtype=torch.float64)
    expected = -2 * (torch.logaddexp(u, -u) - math.log(2))
    torch.testing.assert_close(log_tanh_slope(u), expected)


def test_the_deterministic_actor_adds_noise_to_the_action():
    actor = Deterministic(3, 2, (7,), noise_std=0.1)
    params = actor.init(Rng((0, 1)))
    obs, noise = (Rng((4, 5)).normal(6, n) for n in (3, 2))
    noise[0, 0] = 1e3
    pre_tanh = actor.explore(params, obs, noise)
    expected = (actor.mode(params, obs) + 0.1 * noise).clamp(-MAX_ACTION, MAX_ACTION)
    torch.testing.assert_close(torch.tanh(pre_tanh), expected, atol=1e-6, rtol=0)


ACTORS = [
    SquashedGaussian(3, 2, (7, 5), (-4.0, 1.0)),
    Deterministic(3, 2, (7,), 0.2),
    MultiplicativeGaussian(3, 2, (7,), (-4.0, 1.0), 3, (5,), (6, 5), "sigmoid"),
    ReleasedPolicy(3, 2, (7,), (-4.0, 1.0), 3, (5,), (6, 5)),
]


def population(actor):
    normaliser = Normaliser(Rng((5, 6)).normal(1, 3), 1 + Rng((5, 6)).uniform(1, 3))
    return Policy("some/Task-v0", actor, actor.init(Rng((0, 1))), normaliser)


@pytest.mark.parametrize("actor", ACTORS)
def test_a_policy_acts_by_mode_or_by_sample_on_scaled_observations(actor):
    policy, obs, noise = population(actor), *(Rng((4, 5)).normal(6, n) for n in (3, 2))
    scaled = (obs - policy.normaliser.mean) / policy.normaliser.std
    assert torch.equal(policy.act(obs), actor.mode(policy.params, scaled))
    sampled = torch.tanh(actor.explore(policy.params, scaled, noise))
    assert torch.equal(policy.act(obs, noise), sampled)
    assert not torch.equal(policy.act(obs, noise), policy.act(obs))


@pytest.mark.parametrize("actor", ACTORS)
def test_a_policy_comes_back_from_a_file(actor, tmp_path):
    policy, path = population(actor), tmp_path / "policy.safetensors"
    policy.save(path)
    loaded = Policy.load(path)
    assert (loaded.env_id, loaded.actor) == (policy.env_id, policy.actor)
    obs = Rng((4, 5)).normal(6, 3)
    assert torch.equal(loaded.act(obs), policy.act(obs))


def test_an_actor_of_no_known_type_is_refused(tmp_path, monkeypatch):
    path, known = tmp_path / "policy.safetensors", policies._actors()
    population(ReleasedPolicy(3, 2, (7,))).save(path)
    del known["ReleasedPolicy"]
    monkeypatch.setattr(policies, "_actors", lambda: known)
    with pytest.raises(ValueError, match="is 'ReleasedPolicy'; expected one of SquashedGaussian, "):
        Policy.load(path)


def test_members_can_be_taken_out():
    policy, obs = population(ACTORS[0]), Rng((4, 5)).normal(6, 3)
    alone = policy.member(1)
    assert len(alone) == 1
    torch.testing.assert_close(alone.act(obs[1:]), policy.act(obs)[1:])
    torch.testing.assert_close(policy.member(1, 0).act(obs.flip(0)), policy.act(obs).flip(0))


def primitives(count, seed, actions=1):
    """μ, log σ and weights of one state."""
    rng = torch.Generator().manual_seed(seed)
    shape = count, actions
    mean, log_std = (torch.randn(shape, generator=rng, dtype=torch.float64) for _ in range(2))
    return mean, log_std / 2, 2 * torch.rand(count, generator=rng, dtype=torch.float64)


@pytest.mark.parametrize("count", [1, 2, 4, 8])
def test_the_composition_is_the_normalised_product_of_the_primitives(count):
    mean, log_std, weight = primitives(count, seed=count)
    mu, log_sigma = product_of_gaussians(mean, log_std, weight)
    sigma = log_sigma.exp().item()

    def log_product(u):
        parts = scipy.stats.norm.logpdf(u, mean[:, 0], log_std[:, 0].exp())
        return (weight.numpy() * parts).sum()

    reach = mu.item() - 12 * sigma, mu.item() + 12 * sigma
    at_mean = log_product(mu.item())
    total = scipy.integrate.quad(lambda u: math.exp(log_product(u) - at_mean), *reach)[0]
    for u in np.linspace(mu.item() - 4 * sigma, mu.item() + 4 * sigma, 9):
        expected = math.exp(log_product(u) - at_mean) / total
        assert scipy.stats.norm.pdf(u, mu.item(), sigma) == pytest.approx(expected, rel=1e-9)


def test_the_composition_by_hand():
    mean, std = torch.tensor([[0.0], [1.0]]), torch.tensor([[1.0], [0.5]])
    weight = torch.tensor([1.0, 0.5])
    # Precisions 1 and 0.5 · 4.
    mu, log_sigma = product_of_gaussians(mean, std.log(), weight)
    assert mu.item() == pytest.approx(2 / 3)
    assert log_sigma.exp().item() == pytest.approx(3**-0.5)


def test_one_primitive_is_the_plain_actor():
    plain = SquashedGaussian(3, 2, (7, 5, 4), RANGE)
    actor = MultiplicativeGaussian(3, 2, (7, 5), RANGE, 1, (4,), gate_hidden=(6,))
    params = actor.init(Rng((0, 1)))
    trunk, primitive, _ = actor.split(params)
    obs, noise = (Rng((4, 5)).normal(6, n) for n in (3, 2))
    ours = actor.sample(params, obs, noise)
    theirs = plain.sample(torch.cat([trunk, primitive[:, 0]], 1), obs, noise)
    torch.testing.assert_close(ours, theirs)


@pytest.mark.parametrize("gating", GATINGS)
def test_weights_are_as_the_gating_says(gating):
    actor = MultiplicativeGaussian(3, 2, (7,), RANGE, 5, (5,), (6,), gating)
    params, obs = 3 * actor.init(Rng((0, 1))), Rng((4, 5)).normal(100, 3)
    *_, weight = actor.parts(params, obs)
    assert weight.shape == (2, 100, 5)
    assert (weight > 0).all()
    sums = weight.sum(-1)
    assert (gating == "softmax") == bool(((sums - 1).abs() < 1e-5).all())
    assert (weight.max() > 1) == (gating == "softplus")


def test_each_primitive_is_the_plain_actor_with_its_weights():
    actor = MultiplicativeGaussian(3, 2, (7,), RANGE, 4, (5,), (6,))
    params, obs = actor.init(Rng((0, 1))), Rng((4, 5)).normal(6, 3)
    mean, log_std, _ = actor.parts(params, obs)
    plain = SquashedGaussian(3, 2, (7, 5), RANGE)
    trunk, primitives, _ = actor.split(params)
    for k in range(4):
        alone = plain.distribution(torch.cat([trunk, primitives[:, k]], 1), obs)
        torch.testing.assert_close((mean[..., k, :], log_std[..., k, :]), alone)


def test_the_composite_keeps_within_the_bounds_of_a_primitive():
    """Weights near zero would flatten it out, and make it produce anything at all."""
    actor = MultiplicativeGaussian(1, 1, (1,), RANGE, 2, (), (), "sigmoid")
    for bias in (-200.0, 200.0):
        params = torch.zeros(1, actor.num_params)
        params[:, -4:-2] = bias
        _, log_std = actor.distribution(params, torch.zeros(1, 1, 1))
        assert log_std.isfinite().all()
        assert RANGE[0] <= log_std.item() <= RANGE[1]


@pytest.mark.parametrize("fixed", [False, True])
def test_gradients_reach_the_gate_and_the_primitives_unless_these_are_fixed(fixed):
    actor = PRODUCTS[0]
    params = actor.init(Rng((0, 1))).requires_grad_()
    used = actor.with_fixed_primitives(params) if fixed else params
    assert torch.equal(used, params)
    pre_tanh, log_prob = actor.sample(used, *(Rng((4, 5)).normal(6, n) for n in (3, 2)))
    (gradient,) = torch.autograd.grad(pre_tanh.sum() + log_prob.sum(), params)
    *others, of_gate = actor.split(gradient)
    assert (of_gate != 0).float().mean() > 0.4
    for part in others:
        assert ((part != 0).float().mean() > 0.4) != fixed
        assert not (fixed and part.any())


@pytest.mark.parametrize("kind", [MultiplicativeGaussian, ReleasedProduct, ReleasedPolicy])
@pytest.mark.parametrize("gating", GATINGS)
def test_gradients_of_compositions_are_finite_differences(gating, kind):
    actor = kind(2, 2, (3,), RANGE, 3, (3,), (3,), gating)
    params = actor.init(Rng((0, 1))).double().requires_grad_()
    obs, u = (Rng((4, 5)).normal(3, 2).double() for _ in range(2))
    assert torch.autograd.gradcheck(
        lambda p, u: actor.log_prob(p, obs, u), (params, u.requires_grad_()), rtol=1e-4
    )
