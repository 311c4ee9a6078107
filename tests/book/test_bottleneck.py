"""The bottleneck: its code by sampling, its loss by quadrature, its multiplier by hand."""

import math

import pytest
import torch
from discriminators import CONFIGS, B, apart, data, loss_of, make, minibatch, seen, update
from torch.nn.functional import softplus

from offairl_lite.core.discriminator import airl_loss, both_sides
from offairl_lite.core.networks import StackedMLP
from offairl_lite.core.rng import Rng
from other_bounds import Code, expected_cross_entropy, gauss_hermite

S, ROWS = 3, 5


def inputs(width):
    return Rng(range(10, 10 + S)).normal(ROWS, width).double()


def cross_entropy(expert_logit, policy_logit):
    return airl_loss(expert_logit, policy_logit, torch.ones_like(expert_logit), 0.0).cross_entropy


@pytest.mark.parametrize("sizes", [(4, 1), (4, 6, 7, 1)])
def test_a_bottleneck_at_its_mean_is_a_network(sizes):
    code, x = Code(StackedMLP(sizes, "tanh"), 3), inputs(4)
    count = code.encoder.num_params + code.head.num_params
    params = Rng(range(S)).normal(count).double()  # biases too, which begin at zero
    encoder, head = params.split([code.encoder.num_params, code.head.num_params], 1)
    mean, log_std = code.encoder(encoder, x).chunk(2, -1)
    torch.testing.assert_close(code.net(code.at_mean(params), x), code.head(head, mean))
    assert log_std.shape == (S, ROWS, 3)


def test_the_spread_of_a_bottleneck_is_that_of_its_samples():
    code, x = Code(StackedMLP((4, 6, 1), "tanh"), 3), inputs(4)
    params = Rng(range(S)).normal(code.encoder.num_params + code.head.num_params).double() / 2
    encoder, head = params.split([code.encoder.num_params, code.head.num_params], 1)
    mean, log_std = code.encoder(encoder, x).chunk(2, -1)
    z = torch.distributions.Normal(mean, log_std.exp())
    variance, divergence = code.spread(params, x)
    noise = Rng(range(20, 20 + S)).normal(ROWS, 100_000, 3).double()
    samples = mean.unsqueeze(2) + log_std.exp().unsqueeze(2) * noise
    sampled = code.head(head, samples.flatten(1, 2)).view(S, ROWS, -1).var(-1)
    torch.testing.assert_close(variance, sampled, rtol=0.03, atol=0)
    prior = torch.distributions.Normal(torch.zeros_like(mean), 1.0)
    expected = torch.distributions.kl_divergence(z, prior).sum(-1)
    torch.testing.assert_close(divergence, expected)


def test_the_expected_cross_entropy_is_that_of_samples():
    means, variances = (Rng((i, i + 1)).normal(B).double() for i in (0, 5)), (4.0, 0.01)
    expert, policy = (3 * mean for mean in means)
    variances = [torch.full_like(expert, v) for v in variances]
    noise = Rng((7, 8)).normal(2, 200_000, B).double()
    logits = [m.unsqueeze(1) + v.sqrt().unsqueeze(1) * noise[:, i] for i, (m, v) in
              enumerate(zip((expert, policy), variances, strict=True))]  # fmt: skip
    sampled = cross_entropy(*logits).mean(1)
    expected = expected_cross_entropy(expert, policy, *variances, gauss_hermite().double())
    torch.testing.assert_close(expected, sampled, rtol=0, atol=1e-2)
    certain = [torch.zeros_like(v) for v in variances]
    torch.testing.assert_close(
        expected_cross_entropy(expert, policy, *certain, gauss_hermite().double()),
        cross_entropy(expert, policy),
        rtol=0,
        atol=1e-5,
    )


@pytest.mark.parametrize("spread", [0.1, 1.0, 5.0])
def test_quadrature_is_exact_as_far_as_it_says(spread):
    nodes, weights = gauss_hermite().double()
    mean = torch.linspace(-20, 20, 21, dtype=torch.float64).unsqueeze(1)
    x = torch.linspace(-12, 12, 100_001, dtype=torch.float64)
    density = torch.exp(-x.square() / 2) / math.sqrt(2 * math.pi)
    expected = torch.trapezoid(softplus(mean + spread * x) * density, x)
    quadrature = softplus(mean + spread * nodes) @ weights
    torch.testing.assert_close(quadrature, expected, rtol=0, atol=1e-3)


@pytest.mark.parametrize("name", ["bottleneck r(s)", "bottleneck dac"])
def test_the_spread_of_f_is_that_of_sampled_codes(name):
    config, discriminator, batch = CONFIGS[name], make(CONFIGS[name]), data()[0]
    transitions = seen(discriminator, batch)
    x = transitions.obs if "r(s)" in name else torch.cat([transitions.obs, transitions.action], -1)
    terms = [(discriminator.trained[0], discriminator.reward_params, x, 1.0)]
    if "r(s)" in name:
        gamma = config.discriminator.discount
        code, params = discriminator.trained[1], discriminator.value_params
        terms += [
            (code, params, transitions.obs, -1.0),
            (code, params, transitions.next_obs, gamma),
        ]
    variance = divergence = 0
    for code, params, y, sign in terms:
        own, kl = code.spread(params, y)
        variance, divergence = variance + sign**2 * own, divergence + kl
    torch.testing.assert_close(discriminator.spread(transitions), (variance, divergence))


def test_the_price_of_a_nat_is_the_multiplier():
    discriminator = make(CONFIGS["bottleneck r(s)"])
    losses, excess = [], None
    for price in (0.0, 1.0, 3.0):
        discriminator.multiplier.fill_(price)
        loss, metrics = loss_of(discriminator, *data())
        losses.append(loss.detach())
        excess = metrics["excess"]
    expert, policy, _ = minibatch(discriminator, *data())
    nats = discriminator.spread(both_sides(expert, policy))[1].mean(1).detach()
    torch.testing.assert_close(excess, nats - 0.5)
    torch.testing.assert_close(losses[1] - losses[0], excess.sum())
    torch.testing.assert_close(losses[2] - losses[0], 3 * excess.sum())


def test_the_multiplier_rises_with_the_divergence_and_never_falls_below_zero():
    batches = data(dtype=torch.float32)
    for limit, rises in ((1e-6, True), (1e6, False)):
        config = CONFIGS["bottleneck r(s)"].change(bottleneck=limit, bottleneck_rate=0.1)
        discriminator = make(config, dtype=torch.float32)
        metrics = update(discriminator, *batches)
        assert (metrics["multiplier"] == 0).all()
        expected = (0.1 * metrics["excess"]).clamp(min=0).unsqueeze(1)
        torch.testing.assert_close(discriminator.multiplier, expected)
        assert (discriminator.multiplier > 0).all() == rises


def test_the_bottleneck_holds_the_divergence_at_its_limit():
    config = CONFIGS["bottleneck r(s)"].change(bottleneck_rate=1e-2, gradient_penalty=0.0)
    batches = apart(data(batch=64, dtype=torch.float32))
    held, free = (
        make(config.change(bottleneck=limit), dtype=torch.float32, learning_rate=1e-2)
        for limit in (0.5, 1e6)
    )
    for _ in range(1000):
        metrics, unbounded = (update(d, *batches) for d in (held, free))
    assert (metrics["excess"].abs() < 0.25).all()
    assert (unbounded["excess"] + 1e6 > 2).all()
    assert (metrics["accuracy"] > 0.7).all()
