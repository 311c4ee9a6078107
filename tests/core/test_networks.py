from itertools import pairwise

import pytest
import torch
from torch import nn

from offairl_lite.core.networks import (
    Adam,
    Normaliser,
    StackedMLP,
    TwinCritic,
    descend,
    load_weights,
    save_weights,
)
from offairl_lite.core.rng import Rng

S, B = 3, 5
ACTIVATIONS = {"relu": nn.ReLU, "tanh": nn.Tanh}


def random_params(net, members=S):
    return Rng(range(members)).normal(net.num_params).double()


def inputs(width):
    return Rng(range(10, 10 + S)).normal(B, width).double()


def sequential(net, row):
    """Build the same network from torch.nn, reading a row as biases, then weights, by layer."""
    layers = []
    for i, o in pairwise(net.sizes):
        linear = nn.Linear(i, o, dtype=torch.float64)
        linear.bias.data, row = row[:o], row[o:]
        linear.weight.data, row = row[: i * o].reshape(i, o).T, row[i * o :]
        layers += [linear, ACTIVATIONS[net.activation]()]
    assert row.numel() == 0
    return nn.Sequential(*layers[:-1])


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("sizes", [(4, 3), (4, 6, 7, 2)])
def test_a_stack_is_as_many_separate_networks(activation, sizes):
    net = StackedMLP(sizes, activation)
    params, x = random_params(net), inputs(4)
    expected = torch.stack([sequential(net, p)(rows) for p, rows in zip(params, x, strict=True)])
    torch.testing.assert_close(net(params, x), expected)


def test_observations_of_two_axes_are_not_taken_for_every_member_s():
    with pytest.raises(ValueError, match=r"axes \(2, 3\); expected \(S, B, O\)"):
        Normaliser.identity(2, 3)(torch.zeros(2, 3))


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("sizes", [(4, 1), (4, 6, 7, 1)])
def test_value_and_input_gradient_are_autograd_s(activation, sizes):
    net = StackedMLP(sizes, activation)
    params, x = random_params(net), inputs(4).requires_grad_()
    value, gradient = net.value_and_input_gradient(params, x)
    expected = net(params, x).squeeze(-1)
    torch.testing.assert_close(value, expected)
    by_autograd = torch.autograd.grad(expected.sum(), x)[0]
    torch.testing.assert_close(gradient, by_autograd)


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_training_on_the_input_gradient_is_double_backward(activation):
    net = StackedMLP((4, 6, 7, 1), activation)
    params, x = random_params(net).requires_grad_(), inputs(4).requires_grad_()

    def penalty(gradient):
        return (gradient.norm(dim=-1) - 1).square().mean()

    written_out = penalty(net.value_and_input_gradient(params, x)[1])
    automatic = penalty(torch.autograd.grad(net(params, x).sum(), x, create_graph=True)[0])
    torch.testing.assert_close(
        torch.autograd.grad(written_out, params), torch.autograd.grad(automatic, params)
    )


def test_initial_weights_are_glorot_uniform_and_biases_zero():
    net = StackedMLP((50, 100, 2))
    for (bias, weight), fans in zip(net.layers(net.init(Rng((0, 1)))), (150, 102), strict=True):
        assert (bias == 0).all()
        bound = (6 / fans) ** 0.5
        assert weight.abs().max() <= bound
        assert weight.abs().max() > 0.95 * bound
        assert weight.mean().abs() < 0.1 * bound


def test_the_twin_critics_are_two_networks():
    critic = TwinCritic(3, 2, (6,))
    params = critic.init(Rng(range(S))).double()
    assert not torch.equal(params[0], params[1])
    obs, action = inputs(3), inputs(2)
    x = torch.cat([obs, action], -1)
    expected = torch.stack([critic.net(params[k], x).squeeze(-1) for k in (0, 1)])
    torch.testing.assert_close(critic(params, obs, action), expected)


def test_a_normaliser_gives_the_even_mixture_mean_0_and_spread_1():
    # As many rows of the one as of ten others: each source counts as a half.
    shift = torch.tensor([0.0, -3.0, 5_000.0])
    one = Rng(range(S)).normal(4_000, 3) * torch.tensor([1.0, 20.0, 0.5]) + shift
    other = 3 * Rng(range(5, 5 + S)).normal(400, 3) + shift + 1
    normaliser = Normaliser.of(one, other)
    first, second = normaliser(one).double(), normaliser(other).double()
    mean = (first.mean(1) + second.mean(1)) / 2
    square = (first.square().mean(1) + second.square().mean(1)) / 2
    torch.testing.assert_close(mean, torch.zeros_like(mean), atol=1e-3, rtol=0)
    torch.testing.assert_close(square, torch.ones_like(square), atol=1e-3, rtol=0)


def test_a_coordinate_that_hardly_varies_is_only_centred():
    obs = Rng((0,)).normal(100, 2) * torch.tensor([1e-5, 1.0]) + 7
    normaliser = Normaliser.of(obs)
    assert normaliser.std[0, 0, 0] == 1
    torch.testing.assert_close(normaliser(obs)[..., 0], obs[..., 0] - obs[..., 0].mean())


def test_small_units_are_scaled_like_any_other():
    obs = Rng((0,)).normal(100, 2)
    scaled, small = Normaliser.of(obs), Normaliser.of(1e-4 * obs)
    torch.testing.assert_close(small(1e-4 * obs), scaled(obs))


def test_members_are_normalised_by_their_own_statistics():
    obs = Rng(range(S)).normal(50, 2) * torch.arange(1.0, S + 1).view(S, 1, 1)
    for i in range(S):
        alone = Normaliser.of(obs[i : i + 1])
        torch.testing.assert_close(Normaliser.of(obs)(obs)[i : i + 1], alone(obs[i : i + 1]))


def test_the_identity_changes_nothing():
    obs = inputs(4).float()
    assert torch.equal(Normaliser.identity(S, 4)(obs), obs)


def test_descend_is_adam_also_for_a_gradient_in_another_order():
    weights = Rng((0, 1, 2)).normal(40)
    slopes = Rng(range(40)).normal(3)
    params, reference = weights.clone(), weights.clone().requires_grad_()
    optimizer = Adam(params, 0.1)
    plain = torch.optim.Adam([reference], lr=0.1, foreach=True)

    def loss(x):
        return (x.t() * slopes).sum()

    assert not torch.autograd.grad(loss(params), params)[0].is_contiguous()
    for _ in range(3):
        descend(loss(params), optimizer)
        plain.zero_grad()
        loss(reference).backward()
        plain.step()
    torch.testing.assert_close(params, reference)


def test_descend_moves_only_what_it_is_told_to():
    moved, kept = torch.ones(2, 3), torch.ones(2, 3)
    optimizer, _ = Adam(moved, 0.1), Adam(kept, 0.1)
    descend((moved * kept).sum(), optimizer)
    torch.testing.assert_close(moved.detach(), torch.full((2, 3), 0.9))
    assert torch.equal(kept.detach(), torch.ones(2, 3))
    assert kept.grad is None


def test_weights_come_back_from_a_file(tmp_path):
    tensors = {"a": torch.randn(2, 3, generator=torch.Generator()).t()}
    save_weights(tmp_path / "new" / "x.safetensors", tensors, {"kind": "thing", "n": [1, 2]})
    loaded, about = load_weights(tmp_path / "new" / "x.safetensors", "thing")
    assert torch.equal(loaded["a"], tensors["a"])
    assert about == {"kind": "thing", "n": [1, 2]}


def test_descend_remembers_earlier_gradients_as_adam_does():
    params = Rng((0, 1)).normal(5)
    reference = params.clone().requires_grad_()
    optimizer, plain = Adam(params, 0.1), torch.optim.Adam([reference], lr=0.1)
    for k in range(20):
        descend((params - k % 3).square().sum(), optimizer)
        plain.zero_grad()
        (reference - k % 3).square().sum().backward()
        plain.step()
    torch.testing.assert_close(params, reference, rtol=1e-4, atol=1e-5)
