"""The density and the product of primitives that the released code computes."""

import math

import numpy as np
import pytest
import scipy.integrate
import scipy.stats
import torch

from offairl_lite.ablations.released import (
    ReleasedDensityOfProduct,
    ReleasedGaussian,
    ReleasedPolicy,
    ReleasedProduct,
    ReleasedSACConfig,
)
from offairl_lite.core.policies import (
    MultiplicativeGaussian,
    SquashedGaussian,
    gaussian_log_density,
    make_actor,
)
from offairl_lite.core.rng import Rng

RANGE = (-5.0, 2.0)


@pytest.mark.parametrize(("mean", "std"), [(0.0, 0.5), (0.3, 0.02), (0.0, 5.0), (3.0, 1.0)])
def test_the_released_density_is_a_gaussian_at_the_action_and_no_density(mean, std):
    actor = ReleasedGaussian(1, 1, (), RANGE)
    raw = math.atanh(2 * (math.log(std) - RANGE[0]) / (RANGE[1] - RANGE[0]) - 1)
    params = torch.tensor([[mean, raw, 0.0, 0.0]], dtype=torch.float64)

    def log_prob(pre_tanh):
        u = torch.as_tensor(pre_tanh, dtype=torch.float64).view(1, -1, 1)
        return actor.log_prob(params, torch.zeros_like(u), u)[0]

    u = np.array([-20.0, -8.0, -3.0, -0.5, 0.0, 1.0, 3.0, 8.0, 20.0])
    expected = scipy.stats.norm.logpdf(np.tanh(u), mean, std)
    np.testing.assert_allclose(log_prob(u), expected, rtol=1e-9)
    # Over the actions it does not integrate to 1, but to what the Gaussian has between -1 and 1.
    inside = np.diff(scipy.stats.norm.cdf([-1, 1], mean, std)).item()
    total = scipy.integrate.quad(
        lambda a: log_prob([math.atanh(a)]).exp().item(), -1, 1, points=[min(mean, 0.9)]
    )[0]
    assert total == pytest.approx(inside, abs=1e-6)
    # Only where σ is small and μ well inside does it come near a density.
    assert (inside < 0.96) == (std >= 0.5)


@pytest.mark.parametrize("kind", [ReleasedProduct, ReleasedPolicy])
def test_the_released_product_by_hand(kind, monkeypatch):
    mean, std = torch.tensor([[0.0], [1.0]]), torch.tensor([[1.0], [0.5]])
    parts = mean, std.log(), torch.tensor([1.0, 0.5])
    monkeypatch.setattr(kind, "parts", lambda self, params, obs: parts)
    # The inverse standard deviations take the place of precisions: 1 and 0.5 · 2.
    mu, log_sigma = kind(3, 1, (7,), RANGE, 2).distribution(None, None)
    assert mu.item() == pytest.approx(1 / 2)
    assert log_sigma.exp().item() == pytest.approx(1 / 2)


@pytest.mark.parametrize("kind", [ReleasedDensityOfProduct, ReleasedPolicy])
def test_the_density_of_a_released_product_is_a_gaussian_at_the_action(kind):
    actor = kind(3, 2, (7,), RANGE, 3, (5,), (6,))
    params = actor.init(Rng((0, 1)))
    obs, u = (Rng((4, 5)).normal(6, n) for n in (3, 2))
    expected = gaussian_log_density(torch.tanh(u), *actor.distribution(params, obs))
    assert torch.equal(actor.log_prob(params, obs, u), expected)


@pytest.mark.parametrize(
    ("settings", "kind"),
    [
        ({}, ReleasedGaussian),
        ({"log_density": "exact"}, SquashedGaussian),
        ({"primitives": 2}, ReleasedPolicy),
        ({"primitives": 2, "log_density": "exact"}, ReleasedProduct),
        ({"primitives": 2, "composition": "exact"}, ReleasedDensityOfProduct),
        (
            {"primitives": 2, "composition": "exact", "log_density": "exact"},
            MultiplicativeGaussian,
        ),
    ],
)
def test_the_settings_choose_the_actor(settings, kind):
    assert type(make_actor(ReleasedSACConfig(**settings), 3, 2)) is kind
