"""Behavioural cloning: its loss by hand, and what it learns where the answer is known."""

import pytest
import torch

from offairl_lite.cloning import clone, cloning_loss, held_out, set_noise
from offairl_lite.config import CORRECTED
from offairl_lite.core.loop import train
from offairl_lite.core.policies import SquashedGaussian
from offairl_lite.core.replay import Batch
from offairl_lite.core.rng import Rng
from offairl_lite.demonstrations import Demonstrations

ENV = "offairl/PointMazeLeft-v0"
SMALL = {"hidden": (32, 32), "batch_size": 64, "progress": False}


def linear(noise=0.0, episodes=10, length=100):
    """Demonstrations of u = (s₀ + s₁, -s₂), with noise, in states drawn at random."""
    rng = Rng([0])
    obs = rng.normal(episodes * length, 3)[0]
    u = torch.stack([obs[:, 0] + obs[:, 1], -obs[:, 2]], 1) / 2
    u = u + noise * rng.normal(*u.shape)[0]
    zero = torch.zeros(len(obs))
    return Demonstrations(ENV, Batch(obs, u, obs, zero, zero), (length,) * episodes)


def test_the_loss_by_hand():
    mean, u = torch.tensor([[[0.5, -1.0]]]), torch.tensor([[[0.0, 1.0]]])
    error = torch.tanh(torch.tensor(0.5)) ** 2 + 4 * torch.tanh(torch.tensor(1.0)) ** 2
    torch.testing.assert_close(cloning_loss(mean, u), error.view(1))


def test_the_noise_is_the_same_everywhere_and_that_of_the_actions():
    actor, rng = SquashedGaussian(3, 2, (8,)), Rng((0, 1))
    params, scatter = actor.init(rng), torch.tensor([0.05, 0.7])
    set_noise(actor, params, scatter * rng.normal(4000, 2))
    obs = Rng((0, 1)).normal(5, 3)
    _, log_std = actor.distribution(params, obs)
    torch.testing.assert_close(log_std.exp(), scatter.expand(2, 5, 2), rtol=0.1, atol=0)
    again = SquashedGaussian(3, 2, (8,)).init(Rng((0, 1)))
    assert torch.equal(actor.mode(params, obs), actor.mode(again, obs))
    set_noise(actor, params, torch.zeros(2, 10, 2))  # Demonstrations without noise.
    assert actor.distribution(params, obs)[1].isfinite().all()


def test_a_tenth_of_each_episode_is_held_out_in_one_piece():
    out = held_out((100, 40, 5))
    for mark, size in zip(out.split((100, 40, 5)), (10, 4, 0), strict=True):
        (at,) = mark.nonzero(as_tuple=True)
        assert len(at) == size
        assert size == 0 or at[-1] - at[0] == size - 1


def test_a_clone_finds_the_mode_and_the_scatter():
    demonstrations = linear(noise=0.2)
    policy = clone(demonstrations, (0, 1), steps=1500, **SMALL)
    obs = Rng([7]).normal(500, 3)
    expected = torch.tanh(torch.stack([obs[..., 0] + obs[..., 1], -obs[..., 2]], -1) / 2)
    assert (policy.act(obs) - expected).abs().mean() < 0.05
    _, log_std = policy.actor.distribution(policy.params, policy.normaliser(obs))
    assert (log_std.exp().mean((1, 2)) - 0.2).abs().max() < 0.05


def test_a_member_is_the_same_alone_and_among_others():
    demonstrations = linear()
    one = clone(demonstrations, (3,), steps=300, patience=100, **SMALL)
    three = clone(demonstrations, (1, 3, 5), steps=300, patience=100, **SMALL)
    torch.testing.assert_close(one.params[0], three.params[1], rtol=0, atol=1e-4)
    assert not torch.equal(three.params[0], three.params[1])


def test_it_stops_where_nothing_can_be_learned():
    """Actions have nothing to do with states: the longer it learns them, the worse it gets."""
    demonstrations, u = linear(episodes=2), Rng([1]).normal(200, 2)[0]
    transitions = demonstrations.transitions._replace(pre_tanh=u)
    noise = Demonstrations(ENV, transitions, demonstrations.lengths)
    policy = clone(noise, (0, 1), steps=1000, patience=200, **SMALL)
    assert policy.act(transitions.obs.expand(2, -1, -1)).abs().mean() < 0.4


def test_copies_in_thinned_demonstrations_are_not_held_out_from_themselves():
    thinned = linear(episodes=2).subsample(5)
    short = Demonstrations(ENV, Batch(*(p[::5] for p in thinned.transitions)), (20, 20))
    one, other = (clone(d, (0,), steps=100, **SMALL) for d in (thinned, short))
    torch.testing.assert_close(one.params, other.params)


def test_a_short_patience_keeps_what_the_first_look_saw():
    policies = [clone(linear(), (0,), steps=n, patience=50, **SMALL) for n in (100, 300)]
    torch.testing.assert_close(policies[0].params, policies[1].params)
    first = clone(linear(), (0,), steps=1, **SMALL)
    assert not torch.allclose(first.params, policies[0].params)


def test_a_run_goes_on_with_a_clone(tiny, random_demonstrations):
    """SAC begins with the clone, whose networks know of the absorbing state."""
    demonstrations = random_demonstrations(ENV)
    policy = clone(
        demonstrations, (0, 1), hidden=(16, 16), steps=20, absorbing_state=True, progress=False
    )
    config = tiny.change(absorbing="bootstrap", pretrained="policy", total_steps=100)
    run = train(config, (0, 1), demonstrations, pretrained_policy=policy, progress=False)
    assert run.policy.actor == policy.actor
    assert CORRECTED.change(pretrained="policy").pretrained == "policy"


@pytest.mark.parametrize("name", ["steps", "patience", "batch_size", "learning_rate"])
def test_what_is_no_number_above_zero_is_refused(name):
    with pytest.raises(ValueError, match=f"{name} is 0"):
        clone(linear(), (0,), **{name: 0})
