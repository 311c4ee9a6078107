"""Other penalties, and spectral normalisation; what all discriminators do is in `core`."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from discriminators import CONFIGS, B, data, loss_of, make, minibatch, seen, update

from offairl_lite.config import differences
from offairl_lite.core.networks import StackedMLP
from offairl_lite.core.rng import Rng
from offairl_lite.experiments import find
from offairl_lite.runs import records
from other_bounds import (
    VARIANTS,
    OneSided,
    SpectralNormConfig,
    configure,
    init_vectors,
    power_iteration,
    spectrally_normalised,
)

ROOT = Path(__file__).parents[2]
S = 3


def random_params(net):
    return Rng(range(S)).normal(net.num_params).double()


def inputs(width):
    return Rng(range(10, 10 + S)).normal(B, width).double()


# Penalties.


def test_the_one_sided_penalty_forgives_what_is_flat():
    steep, flat = make(CONFIGS["one-sided r(s)"]), make(CONFIGS["one-sided r(s)"])
    for params in (flat.reward_params, flat.value_params):
        params.detach().zero_()
    steep.reward_params.detach().mul_(20)
    plain = make(CONFIGS["r(s)"])
    for discriminator, forgiven in ((steep, False), (flat, True)):
        plain.reward_params, plain.value_params = (
            discriminator.reward_params,
            discriminator.value_params,
        )
        own, two_sided = (loss_of(d, *data())[1]["penalty"] for d in (discriminator, plain))
        norm = plain.gradient_norm(*minibatch(plain, *data()))
        torch.testing.assert_close(own, (norm - 1).clamp(min=0).square().mean(1).detach())
        assert bool((own == 0).all()) == forgiven
        assert (two_sided > 0.5).all()
    assert isinstance(steep, OneSided)


@pytest.mark.parametrize(
    ("name", "needs"), [("released r(s)", True), ("dac on probability", False)]
)
def test_a_penalty_on_the_probability_needs_the_policy_where_there_is_one(name, needs):
    assert make(CONFIGS[name]).needs_log_prob == needs


def test_where_the_verdict_is_certain_the_probability_is_flat():
    """‖∇D‖ = D (1 - D) ‖∇ℓ‖, which is all but 0, so that the penalty is all but 1."""
    discriminator = make(CONFIGS["released r(s)"])
    expert, policy, *logs, c = data()
    certain = [log_prob + 40 for log_prob in logs]
    penalty = loss_of(discriminator, expert, policy, *certain, c)[1]["penalty"]
    torch.testing.assert_close(penalty, torch.ones(2).double(), rtol=0, atol=1e-5)


def test_in_the_released_loss_the_policy_enters_through_the_penalty():
    discriminator = make(CONFIGS["released r(s)"])
    expert, policy, *logs, c = data()
    for move in ([1.0, 0.0], [0.0, 1.0]):
        moved = [log + shift for log, shift in zip(logs, move, strict=True)]
        one = loss_of(discriminator, expert, policy, *logs, c)[1]
        other = loss_of(discriminator, expert, policy, *moved, c)[1]
        assert torch.equal(one["cross_entropy"], other["cross_entropy"])
        assert (one["penalty"] - other["penalty"]).abs().min() > 1e-6


# Spectral normalisation.


def test_spectral_normalisation_makes_every_weight_s_largest_singular_value_one():
    net = StackedMLP((4, 6, 7, 1), "tanh")
    params = random_params(net)
    vectors = init_vectors(net, Rng(range(S))).double()
    for _ in range(300):
        vectors = power_iteration(net, params, vectors)
    normalised = spectrally_normalised(net, params, vectors)
    pairs = zip(net.layers(params), net.layers(normalised), strict=True)
    for (bias, weight), (same, scaled) in pairs:
        norm = torch.linalg.matrix_norm(weight, ord=2).view(-1, 1, 1)
        torch.testing.assert_close(scaled, weight / norm)
        assert torch.equal(same, bias)
    # So the slope of the whole is 1 at most.
    slope = net.value_and_input_gradient(normalised, 3 * inputs(4))[1].norm(dim=-1)
    assert slope.max() <= 1


def test_the_gradient_through_spectral_normalisation_is_the_singular_value_s():
    net = StackedMLP((4, 6, 1), "tanh")
    params = random_params(net).requires_grad_()
    vectors = init_vectors(net, Rng(range(S))).double()
    for _ in range(300):
        vectors = power_iteration(net, params, vectors)
    direction = inputs(net.num_params)[:, 0]
    exact = torch.cat(
        [
            part
            for bias, weight in net.layers(params)
            for part in (
                bias.squeeze(1),
                (weight / torch.linalg.matrix_norm(weight, ord=2).view(-1, 1, 1)).flatten(1),
            )
        ],
        1,
    )
    ours = spectrally_normalised(net, params, vectors)
    by_ours, by_exact = (
        torch.autograd.grad((x * direction).sum(), params)[0] for x in (ours, exact)
    )
    torch.testing.assert_close(by_ours, by_exact)


def test_weights_of_zero_survive_spectral_normalisation():
    net = StackedMLP((4, 6, 1))
    params = torch.zeros(S, net.num_params)
    vectors = power_iteration(net, params, init_vectors(net, Rng(range(S))))
    assert (spectrally_normalised(net, params, vectors) == 0).all()


def test_spectral_normalisation_bounds_the_slopes_of_reward_and_shaping():
    config = CONFIGS["spectral r(s, a)"].change(gradient_penalty=0.0)
    batches = data(batch=64, dtype=torch.float32)
    bounded, free = (
        make(config.change(ablation=ablation), dtype=torch.float32, learning_rate=0.05)
        for ablation in ("spectral-norm", None)
    )
    for _ in range(200):
        update(free, *batches)
        update(bounded, *batches)
    steepest = []
    for made in (bounded, free):
        _, gradients = made.f_and_gradients(seen(made, batches[0]))
        slope = torch.cat(gradients[:2], -1)
        steepest.append([x.norm(dim=-1).max() for x in (*gradients[1:], slope)])
    # Of f by (s, a): r's slope and V's, 1 at most each.
    assert steepest[0][0] <= 1.01
    assert steepest[0][1] <= 1.01
    assert steepest[0][2] <= 2.02
    assert steepest[1][0] > 1.5
    assert steepest[1][1] > 1.5


# What the note trains.


@pytest.mark.parametrize("scale", ["demo", "full"])
def test_variants_differ_in_what_bounds_the_discriminator_and_in_nothing_else(scale):
    bounds = {"gradient_penalty", "ablation", "bottleneck", "bottleneck_size", "bottleneck_rate"}
    imitation = configure("logit", scale)
    assert differences(imitation, find("maze-imitation").configs[scale]) == {}
    for variant in VARIANTS:
        assert set(differences(imitation, configure(variant, scale))) <= bounds


def test_the_command_line_knows_the_bounds(tmp_path):
    steps = "--total-steps 1100 --learning-starts 1000 --eval-every 1100 --eval-episodes 1"
    choice = "--gradient-penalty 0 --ablation spectral-norm --seeds 0 1 --out run"
    command = [
        sys.executable,
        "-m",
        "other_bounds",
        *f"run maze-imitation {steps} {choice}".split(),
    ]
    path = {"PYTHONPATH": os.pathsep.join([str(ROOT / "book"), str(ROOT)])}
    subprocess.run(command, cwd=tmp_path, check=True, env=os.environ | path)
    run = records.read(tmp_path / "run")
    assert isinstance(run.config.discriminator, SpectralNormConfig)
