"""What the note on the paper's text and its released code says."""

import numpy as np
import torch

from checks import exact, live, recorded
from offairl_lite.ablations.released import RELEASE


@live
def unscaled_agents_rest_in_a_corner(resting):
    """Without scaling of observations all five go round the barrier, which
    is at 0.3, and rest in a corner behind it."""
    assert resting[..., 0].min() > 0.43
    assert resting[..., 1].min() > 0.47


@recorded
def none_arrives(unscaled):
    """Without scaling none of five seeds arrives in 6,000 steps."""
    assert len(unscaled.seeds) == 5
    assert unscaled.steps[-1] == 6_000
    assert unscaled.returns[:, -1].max() < -14


@exact
def log_pi_has_no_gradient_in_the_released_loss(change):
    """A shift of log π changes the gradient but under the released loss."""
    assert change["RELEASE"] < 1e-6
    assert min(change["PAPER"], change["CORRECTED"]) > 0.01


@exact
def two_discounts_are_one_function():
    """On random deterministic steps f can be written with the inner
    discount, and then r holds a tenth of V."""
    gamma = RELEASE.learner.discount
    inner = RELEASE.discriminator.discount
    rng = torch.Generator().manual_seed(0)
    r, v, v_next = torch.randn(3, 100, generator=rng, dtype=torch.float64)
    factor = gamma / inner
    f = r + gamma * v_next - v
    moved = r + (factor - 1) * v
    again = moved + inner * factor * v_next - factor * v
    assert torch.allclose(f, again)
    assert np.isclose(factor - 1, 0.1)


@exact
def discounts_of_the_release():
    """The released code has 0.9 in f and 0.99 in the critics."""
    assert RELEASE.discriminator.discount == 0.9
    assert RELEASE.learner.discount == 0.99
