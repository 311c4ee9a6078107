import math
from dataclasses import replace

import pytest
import torch
from torch.nn.functional import softplus

from offairl_lite.config import CORRECTED, RELEASE
from offairl_lite.core.discriminator import (
    Discriminator,
    Reward,
    binary_cross_entropy,
    entropy,
    expected_cross_entropy,
    gauss_hermite,
    gradient_penalty,
    per_episode,
    shaped_reward,
)
from offairl_lite.core.networks import Normaliser
from offairl_lite.core.policies import SquashedGaussian
from offairl_lite.core.replay import Batch
from offairl_lite.core.rewards import OF_LOGIT
from offairl_lite.core.rng import Streams

OBS, ACT, B, HORIZON = 3, 2, 4, 2
SMALL = {"reward_hidden": (6, 5), "shaping_hidden": (4,), "batch_size": B}
CONFIGS = {
    "r(s)": replace(CORRECTED, **SMALL),
    "r(s, a)": replace(CORRECTED, reward="implementation-3", **SMALL),
    "dac": replace(CORRECTED, reward="dac", **SMALL),
    "released r(s)": replace(RELEASE, **SMALL),
    "released r(s, a)": replace(RELEASE, reward="implementation-3", **SMALL),
    "dac on probability": replace(CORRECTED, reward="dac", penalty_on="probability", **SMALL),
    "r(s) of one number": replace(CORRECTED, reward_sees=(1,), **SMALL),
    "r(s, a) of two numbers": replace(
        CORRECTED, reward="implementation-3", reward_sees=(0, 2), **SMALL
    ),
    "one-sided r(s)": replace(CORRECTED, penalty_sides="one", **SMALL),
    "spectral r(s, a)": replace(CORRECTED, reward="implementation-3", spectral_norm=True, **SMALL),
    "bottleneck r(s)": replace(CORRECTED, bottleneck=0.5, bottleneck_size=3, **SMALL),
    "bottleneck dac": replace(CORRECTED, reward="dac", bottleneck=0.5, **SMALL),
    "gan-gcl": replace(CORRECTED, reward="gan-gcl", generator="ppo", update_every=HORIZON, **SMALL),
}
AIRL = [name for name in CONFIGS if "r(s" in name]
LEARNS = {"discriminator_learning_rate": 0.05, "bottleneck_rate": 0.1}
every_config = pytest.mark.parametrize("name", CONFIGS)


def make(config, seeds=(0, 1), dtype=torch.float64):
    """A discriminator with random normaliser; double precision, unless it is to be trained."""
    normaliser = Normaliser(Streams(seeds).normal(1, OBS), 1 + Streams(seeds).uniform(1, OBS))
    horizon = HORIZON if config.reward == "gan-gcl" else 1
    made = Discriminator(config, OBS, ACT, Streams(seeds), normaliser, horizon)
    if dtype == torch.float64:
        made.normaliser = Normaliser(*(part.double() for part in normaliser))
        made.reward_params = made.reward_params.detach().double().requires_grad_()
        made.value_params = made.value_params.detach().double().requires_grad_()
        if made.vectors is not None:
            made.vectors = [vectors.double() for vectors in made.vectors]
        if made.multiplier is not None:
            # Not 0, at which the divergence would not be felt.
            made.multiplier = made.multiplier.double() + 0.7
            made.quadrature = made.quadrature.double()
    return made


def data(seeds=(0, 1), batch=B, dtype=torch.float64, pre_tanh=None):
    """Expert and policy transitions, log π of both, and the penalty's coefficients."""
    streams = Streams([100 + seed for seed in seeds])
    actor = SquashedGaussian(OBS, ACT, (5,), (-1.0, 1.0))
    params = actor.init(Streams(seeds)).to(dtype)
    sides, log_probs = [], []
    for _ in range(2):
        obs, noise, next_obs = (streams.normal(batch, n).to(dtype) for n in (OBS, ACT, OBS))
        u = actor.sample(params, obs, noise)[0]
        u = u if pre_tanh is None else torch.full_like(u, pre_tanh)
        zero = torch.zeros_like(obs[..., 0])
        sides.append(Batch(obs, u, next_obs, zero, zero))
        log_probs.append(actor.log_prob(params, obs, u))
    return *sides, *log_probs, streams.uniform(batch, 4).to(dtype)


def cross_entropy_gradient(config, log_prob_shift):
    discriminator = make(replace(config, gradient_penalty=0.0))
    expert, policy, expert_log_prob, policy_log_prob, coefficient = data()
    logs = (expert_log_prob + log_prob_shift, policy_log_prob - log_prob_shift)
    loss, _ = discriminator.loss(expert, policy, *logs, coefficient)
    return torch.autograd.grad(loss, discriminator.reward_params)[0]


@pytest.mark.parametrize("pre_tanh", [None, -20.0, -3.0, 8.0])
@every_config
def test_the_loss_has_the_gradient_of_finite_differences(name, pre_tanh):
    discriminator, batch = make(CONFIGS[name]), data(pre_tanh=pre_tanh)

    def loss(reward_params, value_params):
        discriminator.reward_params, discriminator.value_params = reward_params, value_params
        return discriminator.loss(*batch)[0]

    assert torch.autograd.gradcheck(
        loss, (discriminator.reward_params, discriminator.value_params), rtol=1e-4
    )


def test_shaping_is_that_of_the_equation():
    assert shaped_reward(torch.tensor(1.0), torch.tensor(3.0), torch.tensor(5.0), 0.9) == 2.5


def test_entropy_is_that_of_the_verdict():
    logit = torch.tensor([-30.0, -2.0, 0.0, 0.7, 30.0], dtype=torch.float64)
    expected = torch.distributions.Bernoulli(logits=logit).entropy()
    torch.testing.assert_close(entropy(logit), expected)
    assert entropy(logit)[2] == pytest.approx(math.log(2))


def test_cross_entropy_labels_the_expert_one():
    expert, policy = (Streams((i, i + 1)).normal(B).double() for i in (0, 5))
    d_expert, d_policy = torch.sigmoid(expert), torch.sigmoid(policy)
    expected = -(d_expert.log()).mean(1) - (1 - d_policy).log().mean(1)
    torch.testing.assert_close(binary_cross_entropy(expert, policy), expected)


def test_the_penalty_vanishes_at_norm_one_and_has_a_slope_at_zero():
    square = torch.tensor([[1.0, 1.0], [4.0, 9.0], [0.0, 1.0]], dtype=torch.float64)
    square.requires_grad_()
    penalty = gradient_penalty(square)
    torch.testing.assert_close(
        penalty, torch.tensor([0, 2.5, 0.5], dtype=torch.float64), rtol=0, atol=2e-6
    )
    assert torch.autograd.grad(penalty.sum(), square)[0].isfinite().all()


def test_the_one_sided_penalty_forgives_what_is_flat():
    square = torch.tensor([[0.0, 0.25], [4.0, 9.0], [0.25, 4.0]], dtype=torch.float64)
    expected = torch.tensor([0, 2.5, 0.5], dtype=torch.float64)
    torch.testing.assert_close(gradient_penalty(square, "one"), expected)


@pytest.mark.parametrize("name", AIRL)
def test_f_is_reward_plus_shaping_by_separate_networks(name):
    config, discriminator = CONFIGS[name], make(CONFIGS[name])
    batch = data()[0]
    s, s_next = discriminator.normaliser(batch.obs), discriminator.normaliser(batch.next_obs)
    x = s if "r(s)" in name else torch.cat([s, batch.action], -1)
    r = discriminator.reward_net(discriminator.reward_weights, x).squeeze(-1)
    v, v_next = (
        discriminator.value_net(discriminator.value_weights, y).squeeze(-1) for y in (s, s_next)
    )
    expected = r + config.discriminator_discount * v_next - v
    torch.testing.assert_close(discriminator.f(s, batch.action, s_next), expected)


@every_config
def test_the_gradients_written_out_are_autograd_s(name):
    discriminator, batch = make(CONFIGS[name]), data()[0]
    inputs = [x.clone().requires_grad_() for x in (batch.obs, batch.action, batch.next_obs)]
    f, *gradients = discriminator.f_and_gradients(*inputs)
    expected = discriminator.f(*inputs)
    torch.testing.assert_close(f, expected)
    automatic = torch.autograd.grad(
        expected.sum(), inputs, allow_unused=True, materialize_grads=True
    )
    for gradient, by_autograd in zip(gradients, automatic, strict=True):
        # r(s) has no gradient by the action: an empty tensor, whose square sums to 0.
        if gradient.shape[-1] == 0:
            assert (by_autograd == 0).all()
        else:
            torch.testing.assert_close(gradient.expand_as(by_autograd), by_autograd)


@every_config
def test_the_penalty_is_that_of_autograd_between_both_sides(name):
    config, discriminator = CONFIGS[name], make(CONFIGS[name])
    expert, policy, expert_log_prob, policy_log_prob, c = data()
    metrics = discriminator.loss(expert, policy, expert_log_prob, policy_log_prob, c)[1]
    on_logit = config.penalty_on == "logit"
    c = c[..., :1].expand(-1, -1, 4) if on_logit else c

    def between(e, p, column):
        weight = c[..., column].view(*c.shape[:2], *(1,) * (e.ndim - 2))
        return (weight * e + (1 - weight) * p).requires_grad_()

    def scaled(batch):
        normaliser = discriminator.normaliser
        return normaliser(batch.obs), batch.action, normaliser(batch.next_obs)

    mixed = [between(*pair, k) for k, pair in enumerate(zip(*map(scaled, (expert, policy))))]  # noqa: B905
    logit = discriminator.f(*mixed)
    if name in AIRL:
        logit = logit - between(expert_log_prob, policy_log_prob, 3)
    output = logit if on_logit else torch.sigmoid(logit)
    by = mixed if on_logit else mixed[:1]
    gradients = torch.autograd.grad(output.sum(), by, allow_unused=True, materialize_grads=True)
    norm = torch.cat(gradients, -1).norm(dim=-1)
    excess = (norm - 1).clamp(min=0) if config.penalty_sides == "one" else norm - 1
    torch.testing.assert_close(metrics["penalty"], excess.square().mean(1))


@pytest.mark.parametrize("name", [name for name in AIRL if "bottleneck" not in name])
def test_log_odds_of_the_discriminator_are_f_minus_log_prob(name):
    config = replace(CONFIGS[name], gradient_penalty=0.0, policy_in_logit=True)
    discriminator, (expert, policy, *logs, c) = make(config), data()

    def d(batch, log_prob):
        normaliser = discriminator.normaliser
        f = discriminator.f(normaliser(batch.obs), batch.action, normaliser(batch.next_obs))
        return f.exp() / (f.exp() + log_prob.exp())

    d_expert, d_policy = d(expert, logs[0]), d(policy, logs[1])
    loss, metrics = discriminator.loss(expert, policy, *logs, c)
    expected = -d_expert.log().mean(1) - (1 - d_policy).log().mean(1)
    torch.testing.assert_close(metrics["cross_entropy"], expected.detach())
    torch.testing.assert_close(loss, expected.sum())
    odds = (d_policy.log() - (1 - d_policy).log()).mean(1)
    torch.testing.assert_close(metrics["policy_logit"], odds.detach())


def test_the_corrected_gradient_depends_on_the_policy_and_the_released_does_not():
    corrected, released = CONFIGS["r(s)"], CONFIGS["released r(s)"]
    for config in (corrected, replace(released, policy_in_logit=True)):
        one, other = (cross_entropy_gradient(config, shift) for shift in (0.0, 1.0))
        assert (one - other).abs().max() > 1e-2
    one, other = (cross_entropy_gradient(released, shift) for shift in (0.0, 1.0))
    assert torch.equal(one, other)


def test_in_the_released_loss_the_policy_enters_through_the_penalty():
    discriminator = make(CONFIGS["released r(s)"])
    expert, policy, *logs, c = data()
    for move in ([1.0, 0.0], [0.0, 1.0]):
        moved = [log + shift for log, shift in zip(logs, move, strict=True)]
        one = discriminator.loss(expert, policy, *logs, c)[1]
        other = discriminator.loss(expert, policy, *moved, c)[1]
        assert torch.equal(one["cross_entropy"], other["cross_entropy"])
        assert (one["penalty"] - other["penalty"]).abs().min() > 1e-6


def test_dac_sees_neither_the_next_state_nor_the_density():
    discriminator = make(CONFIGS["dac"])
    expert, policy, *_, c = data()
    one = discriminator.loss(expert, policy, None, None, c)[0]
    other = [side._replace(next_obs=side.next_obs + 5) for side in (expert, policy)]
    assert torch.equal(one, discriminator.loss(*other, None, None, c)[0])


def test_the_loss_is_summed_over_members_with_the_penalty_s_weight():
    config = replace(CONFIGS["r(s)"], gradient_penalty=3.0)
    loss, metrics = make(config).loss(*data())
    torch.testing.assert_close(loss, (metrics["cross_entropy"] + 3 * metrics["penalty"]).sum())


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_each_implementation_pays_what_it_says(number):
    config = replace(CORRECTED, reward=f"implementation-{number}", **SMALL)
    discriminator = make(config)
    batch, _, log_prob, *_ = data()
    s, s_next = discriminator.normaliser(batch.obs), discriminator.normaliser(batch.next_obs)
    x = s if number in (2, 4) else torch.cat([s, batch.action], -1)
    expected = discriminator.reward_net(discriminator.reward_params, x).squeeze(-1)
    if number in (1, 2):
        expected = discriminator.f(s, batch.action, s_next) - log_prob
    torch.testing.assert_close(discriminator.reward(batch, log_prob), expected.detach())


@pytest.mark.parametrize("number", [1, 2])
def test_log_prob_may_be_left_to_the_generator(number):
    config = replace(CORRECTED, reward=f"implementation-{number}", **SMALL)
    batch, _, log_prob, *_ = data()
    with_it, without = (
        make(replace(config, log_prob_in_reward=there)).reward(batch, log_prob)
        for there in (True, False)
    )
    torch.testing.assert_close(with_it, without - log_prob.detach())


@pytest.mark.parametrize("name", OF_LOGIT)
def test_a_discriminator_without_the_policy_pays_what_its_logit_is_worth(name):
    discriminator, batch = make(replace(CONFIGS["dac"], reward=name)), data()[0]
    logit = discriminator.f(
        discriminator.normaliser(batch.obs), batch.action, discriminator.normaliser(batch.next_obs)
    )
    expected = OF_LOGIT[name](logit).detach()
    torch.testing.assert_close(discriminator.reward(batch, None), expected)
    # What is kept of it is the logit, whatever is made of it.
    torch.testing.assert_close(discriminator.frozen(batch.obs, batch.action), logit.detach())


@pytest.mark.parametrize("name", ["gail-survival", "gail-termination"])
def test_gail_s_discriminator_is_trained_as_dac_s(name):
    batches = data(dtype=torch.float32)
    one, other = (train(replace(CONFIGS["dac"], reward=r), (0, 1), batches) for r in ("dac", name))
    assert torch.equal(one[0], other[0])


# GAN-GCL's discriminator, of whole episodes.


def test_a_trajectory_s_logit_is_the_sum_of_its_steps():
    logit = torch.tensor([[1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0, 8.0]])
    assert per_episode(logit, 2).tolist() == [[3, 7], [11, 15]]
    assert torch.equal(per_episode(logit, 1), logit)


def test_log_odds_of_a_trajectory_are_those_of_its_density():
    """D(τ) = exp Σ r / (exp Σ r + Π π), with what the dynamics contribute cancelled."""
    discriminator, (expert, policy, *logs, c) = make(CONFIGS["gan-gcl"]), data()

    def d(batch, log_prob):
        x = torch.cat([discriminator.normaliser(batch.obs), batch.action], -1)
        r = discriminator.reward_net(discriminator.reward_params, x).squeeze(-1)
        weight = r.view(2, -1, HORIZON).exp().prod(-1)
        return weight / (weight + log_prob.view(2, -1, HORIZON).exp().prod(-1))

    d_expert, d_policy = d(expert, logs[0]), d(policy, logs[1])
    metrics = discriminator.loss(expert, policy, *logs, c)[1]
    expected = -d_expert.log().mean(1) - (1 - d_policy).log().mean(1)
    torch.testing.assert_close(metrics["cross_entropy"], expected.detach())


def test_each_step_of_a_trajectory_is_paid_its_share_of_the_log_odds():
    discriminator, (batch, _, log_prob, *_) = make(CONFIGS["gan-gcl"]), data()
    paid = discriminator.reward(batch, log_prob)
    r = discriminator.frozen(batch.obs, batch.action)
    torch.testing.assert_close(paid, r - log_prob.detach())


def train(config, seeds, batches, updates=5):
    discriminator = make(config, seeds, torch.float32)
    for _ in range(updates):
        discriminator.update(*batches)
    return discriminator.reward_params.detach(), discriminator.value_params.detach()


def select(batches, members):
    expert, policy, *rest = batches
    sides = [Batch(*(part[members] for part in side)) for side in (expert, policy)]
    return *sides, *(part[members] for part in rest)


@every_config
def test_training_together_is_training_alone(name):
    seeds = (0, 1, 2, 3, 4)
    batches = data(seeds, dtype=torch.float32)
    together = train(CONFIGS[name], seeds, batches)
    for i, seed in enumerate(seeds):
        alone = train(CONFIGS[name], (seed,), select(batches, [i]))
        for a, b in zip(together, alone, strict=True):
            torch.testing.assert_close(a[i : i + 1], b, rtol=1e-4, atol=1e-5)


@every_config
def test_a_member_s_data_changes_no_other_member(name):
    seeds = (0, 1, 2)
    expert, policy, *rest = data(seeds, dtype=torch.float32)
    one = train(CONFIGS[name], seeds, (expert, policy, *rest))
    policy.obs[1] += 1
    policy.pre_tanh[1] -= 1
    other = train(CONFIGS[name], seeds, (expert, policy, *rest))
    assert not torch.equal(one[0][1], other[0][1])
    for a, b in zip(one, other, strict=True):
        assert torch.equal(a[[0, 2]], b[[0, 2]])


def test_training_tells_the_sides_apart():
    config = replace(CONFIGS["r(s)"], discriminator_learning_rate=1e-2)
    discriminator = make(config, dtype=torch.float32)
    expert, policy, _, _, c = data(batch=64, dtype=torch.float32)
    expert = expert._replace(obs=expert.obs + 2, next_obs=expert.next_obs + 2)
    same = torch.zeros(2, 64)
    for _ in range(200):
        metrics = discriminator.update(expert, policy, same, same, c)
    assert (metrics["accuracy"] > 0.9).all()
    # The expert's label is 1: its logits, and with them its rewards, are the higher ones.
    assert (metrics["expert_logit"] > 0.5).all()
    assert (metrics["policy_logit"] < -0.5).all()
    paid = [discriminator.reward(side, same).mean(1) for side in (expert, policy)]
    assert (paid[0] > paid[1]).all()


def test_a_frozen_reward_stays_and_comes_back_from_a_file(tmp_path):
    discriminator = make(CONFIGS["r(s, a)"], dtype=torch.float32)
    batches = data(dtype=torch.float32)
    obs, action = batches[0].obs, batches[0].action
    frozen = discriminator.frozen
    before = frozen(obs, action)
    discriminator.update(*batches)
    assert torch.equal(frozen(obs, action), before)
    assert not torch.equal(discriminator.frozen(obs, action), before)

    frozen.save(tmp_path / "reward.safetensors")
    loaded = Reward.load(tmp_path / "reward.safetensors")
    assert torch.equal(loaded(obs, action), before)
    assert (loaded.env_id, loaded.state_only) == (frozen.env_id, False)
    assert (loaded.net, len(loaded)) == (frozen.net, 2)
    torch.testing.assert_close(loaded.member(1)(obs[1:], action[1:]), before[1:])


def test_a_reward_takes_the_observations_of_the_task():
    """One that was learned with absorbing states, which here are told by the last number."""
    frozen = make(CONFIGS["r(s, a)"], dtype=torch.float32).frozen
    batch, *_ = data(dtype=torch.float32)
    obs = batch.obs.index_fill(-1, torch.tensor([batch.obs.shape[-1] - 1]), 0)
    assert torch.equal(frozen(obs[..., :-1], batch.action), frozen(obs, batch.action))
    with pytest.raises(ValueError, match=r"the reward of .* sees . numbers, and the task gives"):
        frozen(obs[..., :-2], batch.action)


# Spectral normalisation, and the bottleneck.


@pytest.mark.parametrize("name", ["spectral r(s, a)", "bottleneck r(s)", "bottleneck dac"])
def test_what_is_frozen_is_the_reward_that_the_discriminator_has(name):
    discriminator, batches = make(CONFIGS[name], dtype=torch.float32), data(dtype=torch.float32)
    discriminator.update(*batches)
    batch, _, log_prob, *_ = batches
    paid = discriminator.reward(batch, log_prob)
    torch.testing.assert_close(discriminator.frozen(batch.obs, batch.action), paid)


@pytest.mark.parametrize("name", ["spectral r(s, a)", "bottleneck r(s)"])
def test_training_goes_on_from_a_state_exactly(name):
    batches = data(dtype=torch.float32)
    config = replace(CONFIGS[name], **LEARNS)
    one, other = (make(config, dtype=torch.float32) for _ in range(2))
    for _ in range(3):
        one.update(*batches)
    for key, tensor in other.state.items():
        tensor.copy_(one.state[key])
    for _ in range(3):
        for discriminator in (one, other):
            discriminator.update(*batches)
    assert all(torch.equal(x, other.state[key]) for key, x in one.state.items())


def test_spectral_normalisation_bounds_the_slopes_of_reward_and_shaping():
    config = replace(CONFIGS["spectral r(s, a)"], gradient_penalty=0.0, **LEARNS)
    discriminator, batches = make(config, dtype=torch.float32), data(batch=64, dtype=torch.float32)
    free = make(replace(config, spectral_norm=False), dtype=torch.float32)
    for _ in range(200):
        free.update(*batches)
        discriminator.update(*batches)
    inputs = [batches[0].obs, batches[0].action, batches[0].next_obs]
    steepest = []
    for made in (discriminator, free):
        _, by_obs, by_action, by_next_obs = made.f_and_gradients(*inputs)
        r_slope = torch.cat([by_obs, by_action], -1)
        steepest.append((by_action.norm(dim=-1).max(), by_next_obs.norm(dim=-1).max(), r_slope))
    # Of f by (s, a): r's slope and V's, 1 at most each.
    assert steepest[0][0] <= 1.01
    assert steepest[0][1] <= 1.01
    assert steepest[0][2].norm(dim=-1).max() <= 2.02
    assert steepest[1][0] > 1.5
    assert steepest[1][1] > 1.5


def test_the_expected_cross_entropy_is_that_of_samples():
    means, variances = (Streams((i, i + 1)).normal(B).double() for i in (0, 5)), (4.0, 0.01)
    expert, policy = (3 * mean for mean in means)
    variances = [torch.full_like(expert, v) for v in variances]
    noise = Streams((7, 8)).normal(2, 200_000, B).double()
    logits = [m.unsqueeze(1) + v.sqrt().unsqueeze(1) * noise[:, i] for i, (m, v) in
              enumerate(zip((expert, policy), variances, strict=True))]  # fmt: skip
    sampled = binary_cross_entropy(*logits).mean(1)
    expected = expected_cross_entropy(expert, policy, *variances, gauss_hermite().double())
    torch.testing.assert_close(expected, sampled, rtol=0, atol=1e-2)
    certain = [torch.zeros_like(v) for v in variances]
    torch.testing.assert_close(
        expected_cross_entropy(expert, policy, *certain, gauss_hermite().double()),
        binary_cross_entropy(expert, policy),
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
    inputs = batch.obs, batch.action, batch.next_obs
    x = batch.obs if "r(s)" in name else torch.cat(inputs[:2], -1)
    terms = [(discriminator.reward_form, discriminator.reward_params, x, 1.0)]
    if "r(s)" in name:
        gamma = config.discriminator_discount
        form, params = discriminator.value_form, discriminator.value_params
        terms += [(form, params, batch.obs, -1.0), (form, params, batch.next_obs, gamma)]
    variance = divergence = 0
    for form, params, y, sign in terms:
        own, kl = form.spread(params, y)
        variance, divergence = variance + sign**2 * own, divergence + kl
    torch.testing.assert_close(discriminator.spread(*inputs), (variance, divergence))


def test_the_multiplier_rises_with_the_divergence_and_never_falls_below_zero():
    batches = data(dtype=torch.float32)
    for limit, rises in ((1e-6, True), (1e6, False)):
        config = replace(CONFIGS["bottleneck r(s)"], bottleneck=limit, bottleneck_rate=0.1)
        discriminator = make(config, dtype=torch.float32)
        metrics = discriminator.update(*batches)
        assert (metrics["multiplier"] == 0).all()
        expected = (0.1 * metrics["excess"]).clamp(min=0).unsqueeze(1)
        torch.testing.assert_close(discriminator.multiplier, expected)
        assert (discriminator.multiplier > 0).all() == rises


def test_the_bottleneck_holds_the_divergence_at_its_limit():
    config = replace(CONFIGS["bottleneck r(s)"], discriminator_learning_rate=1e-2)
    config = replace(config, bottleneck_rate=1e-2, gradient_penalty=0.0)
    expert, policy, *logs, c = data(batch=64, dtype=torch.float32)
    expert = expert._replace(obs=expert.obs + 2, next_obs=expert.next_obs + 2)
    held, free = (
        make(replace(config, bottleneck=limit), dtype=torch.float32) for limit in (0.5, 1e6)
    )
    for _ in range(1000):
        metrics, unbounded = (d.update(expert, policy, *logs, c) for d in (held, free))
    assert (metrics["excess"].abs() < 0.25).all()
    assert (unbounded["excess"] + 1e6 > 2).all()
    assert (metrics["accuracy"] > 0.7).all()


@pytest.mark.parametrize(
    ("name", "seen"), [("r(s) of one number", [1]), ("r(s, a) of two numbers", [0, 2, 3, 4])]
)
def test_what_r_is_not_to_see_changes_nothing_in_it_whatever_is_learned(name, seen):
    discriminator = make(replace(CONFIGS[name], **LEARNS), dtype=torch.float32)
    for _ in range(20):
        discriminator.update(*data(dtype=torch.float32))
    reward = discriminator.frozen
    x = Streams((3, 4)).normal(1, OBS + ACT)
    for i in range(OBS + (0 if discriminator.state_only else ACT)):
        other = x.clone()
        other[..., i] += 1
        before, after = (reward(y[..., :OBS], y[..., OBS:]) for y in (x, other))
        assert bool((before != after).all()) == (i in seen), i
        assert bool((before == after).all()) == (i not in seen), i
    # V sees everything.
    state = Batch(*(part.float() for part in data()[0])).obs
    f = [
        discriminator.f(state, state[..., :ACT], state + shift * torch.eye(OBS)[0])
        for shift in (0, 1)
    ]
    assert (f[0] != f[1]).all()


def test_a_reward_of_state_and_action_needs_both():
    with pytest.raises(ValueError, match=r"is r\(s, a\): give it the actions, too"):
        make(CONFIGS["r(s, a)"]).frozen(data()[0].obs)


def test_a_file_with_weights_of_another_shape_is_no_reward(tmp_path):
    reward = make(CONFIGS["r(s)"]).frozen
    replace(reward, params=reward.params[:, 1:]).save(tmp_path / "cut")
    with pytest.raises(ValueError, match=r"cut: weights \(2, \d+\), expected \(S, \d+\)"):
        Reward.load(tmp_path / "cut")


def test_a_reward_of_the_state_needs_no_action():
    discriminator, batch = make(CONFIGS["r(s)"]), data()[0]
    expected = discriminator.reward(batch, None)
    torch.testing.assert_close(discriminator.frozen(batch.obs), expected)
