"""What every discriminator does, of the ablations as well; what each adds is in `ablations`."""

import math

import pytest
import torch
from discriminators import (
    ACT,
    AIRL,
    CONFIGS,
    OBS,
    SMALL,
    B,
    apart,
    data,
    frozen,
    loss_of,
    make,
    seen,
    update,
)

import other_bounds
from offairl_lite.ablations import released, state_pairs
from offairl_lite.config import CORRECTED
from offairl_lite.core.discriminator import (
    LEARNING_RATE,
    Discriminator,
    Transitions,
    airl_loss,
    diagnostics,
    entropy,
    shaped_reward,
)
from offairl_lite.core.replay import Batch
from offairl_lite.core.rewards import OF_LOGIT
from offairl_lite.core.rng import Rng

every_config = pytest.mark.parametrize("name", CONFIGS)


def cross_entropy_gradient(config, log_prob_shift):
    discriminator = make(config.change(gradient_penalty=0.0))
    expert, policy, expert_log_prob, policy_log_prob, coefficient = data()
    logs = (expert_log_prob + log_prob_shift, policy_log_prob - log_prob_shift)
    loss, _ = loss_of(discriminator, expert, policy, *logs, coefficient)
    return torch.autograd.grad(loss, discriminator.reward_params)[0]


@pytest.mark.parametrize("pre_tanh", [None, -20.0, -3.0, 8.0])
@every_config
def test_the_loss_has_the_gradient_of_finite_differences(name, pre_tanh):
    discriminator, batch = make(CONFIGS[name]), data(pre_tanh=pre_tanh)

    def loss(reward_params, value_params):
        discriminator.reward_params, discriminator.value_params = reward_params, value_params
        return loss_of(discriminator, *batch)[0]

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
    expert, policy = (Rng((i, i + 1)).normal(B).double() for i in (0, 5))
    d_expert, d_policy = torch.sigmoid(expert), torch.sigmoid(policy)
    expected = -(d_expert.log()).mean(1) - (1 - d_policy).log().mean(1)
    loss = airl_loss(expert, policy, torch.ones_like(expert), 10.0)
    torch.testing.assert_close(loss.cross_entropy, expected)
    torch.testing.assert_close(loss.total, expected)


def test_the_loss_by_hand():
    logit = torch.zeros(3, 2, dtype=torch.float64)
    grad_norm = torch.tensor([[1.0, 1.0], [2.0, 3.0], [0.0, 1.0]], dtype=torch.float64)
    loss = airl_loss(logit, logit, grad_norm, 10.0)
    assert loss.penalty.tolist() == [0, 2.5, 0.5]
    expected = 2 * math.log(2) + 10 * torch.tensor([0, 2.5, 0.5], dtype=torch.float64)
    torch.testing.assert_close(loss.total, expected)


@every_config
def test_where_f_is_flat_the_loss_has_a_slope_nevertheless(name):
    """The root in ‖∇f‖ has none at 0 by itself."""
    discriminator = make(CONFIGS[name])
    params = discriminator.reward_params, discriminator.value_params
    for weights in params:
        weights.detach().zero_()
    loss, _ = loss_of(discriminator, *data())
    gradients = torch.autograd.grad(loss, params, allow_unused=True, materialize_grads=True)
    assert loss.isfinite()
    assert all(gradient.isfinite().all() for gradient in gradients)


@pytest.mark.parametrize(
    ("kind", "names"),
    [
        (Discriminator, ["r(s)", "r(s, a)", "dac", "r(s) of one number"]),
        (other_bounds.OneSided, ["one-sided r(s)"]),
        (released.OnProbability, ["released r(s)", "dac on probability"]),
        (other_bounds.SpectralNorm, ["spectral r(s, a)"]),
        (other_bounds.Bottleneck, ["bottleneck r(s)", "bottleneck dac"]),
        (state_pairs.StatePairs, ["state pairs"]),
    ],
)
def test_a_configuration_chooses_the_discriminator(kind, names):
    assert {type(make(CONFIGS[name])) for name in names} == {kind}


@pytest.mark.parametrize("name", AIRL)
def test_f_is_reward_plus_shaping_by_separate_networks(name):
    config, discriminator = CONFIGS[name], make(CONFIGS[name])
    batch = data()[0]
    s, s_next = batch.obs, batch.next_obs
    x = s if "r(s)" in name else torch.cat([s, batch.action], -1)
    reward_weights, value_weights = discriminator.weights
    r = discriminator.reward_net(reward_weights, x).squeeze(-1)
    v, v_next = (discriminator.value_net(value_weights, y).squeeze(-1) for y in (s, s_next))
    expected = r + config.discriminator.discount * v_next - v
    torch.testing.assert_close(discriminator.f(seen(discriminator, batch)), expected)


@every_config
def test_the_gradients_written_out_are_autograd_s(name):
    discriminator, batch = make(CONFIGS[name]), data()[0]
    *inputs, log_prob = (x.clone().requires_grad_() for x in seen(discriminator, batch))
    f, gradients = discriminator.f_and_gradients(Transitions(*inputs, log_prob))
    expected = discriminator.f(Transitions(*inputs, log_prob))
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
    discriminator = make(CONFIGS[name])
    expert, policy, expert_log_prob, policy_log_prob, c = data()
    metrics = loss_of(discriminator, expert, policy, expert_log_prob, policy_log_prob, c)[1]
    on_logit = "probability" not in name and "released" not in name
    c = c[..., :1].expand(-1, -1, 4) if on_logit else c

    def between(e, p, column):
        weight = c[..., column].view(*c.shape[:2], *(1,) * (e.ndim - 2))
        return (weight * e + (1 - weight) * p).requires_grad_()

    sides = zip(seen(discriminator, expert)[:3], seen(discriminator, policy)[:3], strict=True)
    mixed = [between(*pair, k) for k, pair in enumerate(sides)]
    logit = discriminator.f(Transitions(*mixed, c[..., 3]))
    if name in AIRL:
        logit = logit - between(expert_log_prob, policy_log_prob, 3)
    output = logit if on_logit else torch.sigmoid(logit)
    by = mixed if on_logit else mixed[:1]
    gradients = torch.autograd.grad(output.sum(), by, allow_unused=True, materialize_grads=True)
    norm = torch.cat(gradients, -1).norm(dim=-1)
    excess = (norm - 1).clamp(min=0) if name.startswith("one") else norm - 1
    torch.testing.assert_close(metrics["penalty"], excess.square().mean(1))


@pytest.mark.parametrize("name", [name for name in AIRL if "bottleneck" not in name])
def test_log_odds_of_the_discriminator_are_f_minus_log_prob(name):
    config = CONFIGS[name].change(gradient_penalty=0.0, loss="airl")
    discriminator, (expert, policy, *logs, c) = make(config), data()

    def d(batch, log_prob):
        f = discriminator.f(seen(discriminator, batch))
        return f.exp() / (f.exp() + log_prob.exp())

    d_expert, d_policy = d(expert, logs[0]), d(policy, logs[1])
    loss, metrics = loss_of(discriminator, expert, policy, *logs, c)
    expected = -d_expert.log().mean(1) - (1 - d_policy).log().mean(1)
    torch.testing.assert_close(metrics["cross_entropy"], expected.detach())
    torch.testing.assert_close(loss, expected.sum())
    odds = (d_policy.log() - (1 - d_policy).log()).mean(1)
    torch.testing.assert_close(metrics["policy_logit"], odds.detach())


def test_the_corrected_gradient_depends_on_the_policy_and_the_released_does_not():
    corrected, released = CONFIGS["r(s)"], CONFIGS["released r(s)"]
    for config in (corrected, released.change(loss="airl")):
        one, other = (cross_entropy_gradient(config, shift) for shift in (0.0, 1.0))
        assert (one - other).abs().max() > 1e-2
    one, other = (cross_entropy_gradient(released, shift) for shift in (0.0, 1.0))
    assert torch.equal(one, other)


@pytest.mark.parametrize("reward", ["logit-sa", "r-s"])
def test_log_prob_is_asked_for_where_the_loss_has_it(reward):
    config = CONFIGS["r(s)"].change(reward=reward)
    assert make(config).needs_log_prob
    released = make(config.change(loss="log-ratio"))
    assert not released.needs_log_prob
    expert, policy, *logs, c = data()
    with_it, without = (loss_of(released, expert, policy, *x, c)[0] for x in (logs, (None, None)))
    assert torch.equal(with_it, without)


def test_dac_sees_neither_the_next_state_nor_the_density():
    discriminator = make(CONFIGS["dac"])
    expert, policy, *_, c = data()
    assert not discriminator.needs_log_prob
    one = loss_of(discriminator, expert, policy, None, None, c)[0]
    other = [side._replace(next_obs=side.next_obs + 5) for side in (expert, policy)]
    assert torch.equal(one, loss_of(discriminator, *other, None, None, c)[0])


def test_the_loss_is_summed_over_members_with_the_penalty_s_weight():
    config = CONFIGS["r(s)"].change(gradient_penalty=3.0)
    loss, metrics = loss_of(make(config), *data())
    torch.testing.assert_close(loss, (metrics["cross_entropy"] + 3 * metrics["penalty"]).sum())


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_each_implementation_pays_what_it_says(number):
    config = CORRECTED.change(reward=f"implementation-{number}", **SMALL)
    discriminator = make(config)
    batch, _, log_prob, *_ = data()
    s = batch.obs
    x = s if number in (2, 4) else torch.cat([s, batch.action], -1)
    expected = discriminator.reward_net(discriminator.reward_params, x).squeeze(-1)
    if number in (1, 2):
        expected = discriminator.f(seen(discriminator, batch)) - log_prob
    torch.testing.assert_close(discriminator.reward(batch, lambda _: log_prob), expected.detach())


@pytest.mark.parametrize("number", [1, 2])
def test_log_prob_may_be_left_to_the_learner(number):
    config = CORRECTED.change(reward=f"implementation-{number}", **SMALL)
    batch, _, log_prob, *_ = data()
    with_it, without = (
        make(config.change(log_prob_in_reward=there)).reward(batch, lambda _: log_prob)
        for there in (True, False)
    )
    torch.testing.assert_close(with_it, without - log_prob.detach())


@pytest.mark.parametrize("name", OF_LOGIT)
def test_a_discriminator_without_the_policy_pays_what_its_logit_is_worth(name):
    discriminator, batch = make(CONFIGS["dac"].change(reward=name)), data()[0]
    logit = discriminator.f(seen(discriminator, batch))
    expected = OF_LOGIT[name](logit).detach()
    torch.testing.assert_close(discriminator.reward(batch, pytest.fail), expected)
    # What is kept of it is the logit, whatever is made of it.
    torch.testing.assert_close(frozen(discriminator)(batch.obs, batch.action), logit.detach())


@pytest.mark.parametrize("name", ["gail-survival", "gail-termination"])
def test_gail_s_discriminator_is_trained_as_dac_s(name):
    batches = data(dtype=torch.float32)
    one, other = (train(CONFIGS["dac"].change(reward=r), (0, 1), batches) for r in ("dac", name))
    assert torch.equal(one[0], other[0])


def train(config, seeds, batches, updates=5):
    discriminator = make(config, seeds, torch.float32)
    for _ in range(updates):
        update(discriminator, *batches)
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
    discriminator = make(CONFIGS["r(s)"], dtype=torch.float32, learning_rate=1e-2)
    expert, policy, _, _, c = apart(data(batch=64, dtype=torch.float32))
    same = torch.zeros(2, 64)
    for _ in range(200):
        metrics = update(discriminator, expert, policy, same, same, c)
    assert (metrics["accuracy"] > 0.9).all()
    # The expert's label is 1: its logits, and with them its rewards, are the higher ones.
    assert (metrics["expert_logit"] > 0.5).all()
    assert (metrics["policy_logit"] < -0.5).all()
    paid = [discriminator.reward(side, lambda _: same).mean(1) for side in (expert, policy)]
    assert (paid[0] > paid[1]).all()


def test_a_first_step_is_as_long_as_the_learning_rate():
    discriminator = make(CONFIGS["r(s)"], dtype=torch.float32)
    nets = discriminator.reward_params, discriminator.value_params
    before = [params.detach().clone() for params in nets]
    update(discriminator, *data(dtype=torch.float32))
    for params, was in zip(nets, before, strict=True):
        longest = (params.detach() - was).abs().max().item()
        assert longest == pytest.approx(LEARNING_RATE, rel=1e-2)


def test_a_frozen_reward_stays_while_the_discriminator_learns():
    discriminator = make(CONFIGS["r(s, a)"], dtype=torch.float32)
    batches = data(dtype=torch.float32)
    obs, action = batches[0].obs, batches[0].action
    kept = frozen(discriminator)
    before = kept(obs, action)
    update(discriminator, *batches)
    assert torch.equal(kept(obs, action), before)
    assert not torch.equal(frozen(discriminator)(obs, action), before)


@pytest.mark.parametrize("name", sorted(CONFIGS.keys() - {"state pairs"}))
def test_what_is_frozen_is_the_reward_that_the_discriminator_has(name):
    discriminator, batches = make(CONFIGS[name], dtype=torch.float32), data(dtype=torch.float32)
    update(discriminator, *batches)
    batch, _, log_prob, *_ = batches
    paid = discriminator.reward(batch, lambda _: log_prob)
    paid = paid + log_prob if discriminator.reward_is_logit else paid
    torch.testing.assert_close(frozen(discriminator)(batch.obs, batch.action), paid)


@every_config
def test_training_goes_on_from_a_state_exactly(name):
    batches, config = data(dtype=torch.float32), CONFIGS[name]
    if "bottleneck" in name:
        config = config.change(bottleneck_rate=0.1)
    one, other = (make(config, dtype=torch.float32, learning_rate=0.05) for _ in range(2))
    for _ in range(3):
        update(one, *batches)
    for key, tensor in other.state.items():
        tensor.copy_(one.state[key])
    for _ in range(3):
        for discriminator in (one, other):
            update(discriminator, *batches)
    assert all(torch.equal(x, other.state[key]) for key, x in one.state.items())


@pytest.mark.parametrize(
    ("name", "seen"), [("r(s) of one number", [1]), ("r(s, a) of two numbers", [0, 2, 3, 4])]
)
def test_what_r_is_not_to_see_changes_nothing_in_it_whatever_is_learned(name, seen):
    discriminator = make(CONFIGS[name], dtype=torch.float32, learning_rate=0.05)
    for _ in range(20):
        update(discriminator, *data(dtype=torch.float32))
    reward = frozen(discriminator)
    x = Rng((3, 4)).normal(1, OBS + ACT)
    for i in range(OBS + (0 if discriminator.state_only else ACT)):
        other = x.clone()
        other[..., i] += 1
        before, after = (reward(y[..., :OBS], y[..., OBS:]) for y in (x, other))
        assert bool((before != after).all()) == (i in seen), i
        assert bool((before == after).all()) == (i not in seen), i
    # V sees everything.
    state = Batch(*(part.float() for part in data()[0])).obs
    f = [
        discriminator.f(
            Transitions(
                state, state[..., :ACT], state + shift * torch.eye(OBS)[0], torch.zeros(2, B)
            )
        )
        for shift in (0, 1)
    ]
    assert (f[0] != f[1]).all()


def test_a_reward_of_the_state_needs_no_action():
    discriminator, batch = make(CONFIGS["r(s)"]), data()[0]
    expected = discriminator.reward(batch, pytest.fail)
    torch.testing.assert_close(frozen(discriminator)(batch.obs), expected)


def test_diagnostics_by_hand():
    expert, policy = torch.tensor([[2.0, -1.0, 3.0, 0.5]]), torch.tensor([[-4.0, 1.0, 2.0, -0.5]])
    found = diagnostics(airl_loss(expert, policy, torch.ones(1, 4), 10.0), expert, policy)
    assert found["accuracy"].item() == (3 / 4 + 2 / 4) / 2
    assert (found["expert_logit"].item(), found["policy_logit"].item()) == (4.5 / 4, -1.5 / 4)
    both = torch.distributions.Bernoulli(logits=torch.cat([expert, policy], 1)).entropy()
    torch.testing.assert_close(found["entropy"], both.mean(1))
