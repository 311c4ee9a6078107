"""SAC, and what SAC and TD3 have in common (`both`)."""

import math

import pytest
import torch

from offairl_lite.ablations.released import ReleasedSACConfig
from offairl_lite.config import CORRECTED, SACConfig, TD3Config
from offairl_lite.core.absorbing import absorbing_state, is_absorbing
from offairl_lite.core.acceleration import PIECE
from offairl_lite.core.experience import with_analytic_return
from offairl_lite.core.learner import log_density
from offairl_lite.core.loop import Trainer
from offairl_lite.core.policies import gaussian_log_density
from offairl_lite.core.replay import Batch
from offairl_lite.core.rng import Rng
from offairl_lite.core.sac import (
    POLICY_DELAY,
    SAC,
    actor_loss,
    bellman_target,
    critic_loss,
    soft_value,
    temperature_loss,
)
from offairl_lite.core.shapes import Layout
from offairl_lite.core.td3 import TD3

OBS, ACT, B = 3, 2, 6
RATE = 1e-2
CONFIG = CORRECTED.change(hidden=(8, 8), reward="dac", learning_rate=RATE)
both = pytest.mark.parametrize("learner", [SAC, TD3])


def make(learner=SAC, seeds=(0, 1), absorbing="none", settings=None, **changes):
    """A learner whose targets differ from its critics."""
    kind = settings or {SAC: SACConfig, TD3: TD3Config}[learner]
    # What SAC alone has is left out for TD3; what no learner has is a slip in the test.
    assert changes.keys() <= SACConfig.__dataclass_fields__.keys()
    given = {name: x for name, x in changes.items() if name in kind.__dataclass_fields__}
    config = kind(**{"hidden": (8, 8), "learning_rate": RATE} | given)
    made = learner(config, Layout(len(seeds), OBS, ACT, absorbs=absorbing != "none"))
    made.init(Rng(seeds))
    made.analytic = absorbing == "analytic"
    made.target_params = made.critic.init(Rng([50 + seed for seed in seeds]))
    return made


def make_trainer(seeds=(0, 1), **changes):
    """A run at the end of a warm-up that is no longer than the batch."""
    changes = {"reward": "environment", "learning_starts": B, "hidden": (8, 8), **changes}
    trainer = Trainer(CORRECTED.change(learning_rate=RATE, **changes), seeds)
    for _ in range(B):
        trainer.collector.step(None)
    trainer.start()
    return trainer


def data(seeds=(0, 1)):
    """A batch, rewards, r(s_a) and noise: the arguments of `update`."""
    streams = Rng([100 + seed for seed in seeds])
    obs, u, next_obs = (streams.normal(B, n) for n in (OBS, ACT, OBS))
    reward = streams.normal(B)
    terminated = torch.zeros_like(reward)
    terminated[:, ::3] = 1
    noise = streams.normal(2, B, ACT).transpose(0, 1)
    return Batch(obs, u, next_obs, torch.zeros_like(reward), terminated), reward, noise


def paid(learner, batch, reward, absorbing_reward=0.0):
    """Transitions with this reward; where it is analytic, with R_T at the end."""
    batch = batch._replace(reward=reward)
    there = torch.full((len(reward), 1), absorbing_reward)
    return with_analytic_return(batch, there, 0.99) if learner.analytic else batch


def update(learner, batch, reward, noise, absorbing_reward=0.0, update_actor=True):
    return learner.update(paid(learner, batch, reward, absorbing_reward), noise, update_actor)


def log_prob(learner, batch):
    return learner.log_prob(learner.actor_params, batch.obs, batch.pre_tanh)


def weights(learner):
    """All that is learned, one row a member."""
    both = learner.critic_params, learner.target_params
    twins = [params.transpose(0, 1).flatten(1) for params in both]
    alpha = [learner.log_alpha] if isinstance(learner, SAC) else [learner.target_actor_params]
    return torch.cat([learner.actor_params, *twins, *alpha], 1).detach().clone()


def test_losses_by_hand():
    q = torch.tensor([[[1.0, 4.0]], [[2.0, 3.0]]])
    alpha, log_prob = torch.tensor([[0.5]]), torch.tensor([[-2.0, 4.0]])
    value = soft_value(q, alpha, log_prob)
    assert value.tolist() == [[1 + 1, 3 - 2]]
    reward, terminated = torch.tensor([[10.0, 10.0]]), torch.tensor([[0.0, 1.0]])
    # The entropy term stands inside γ, and a termination cuts all of it.
    target = bellman_target(reward, terminated, value, 0.5)
    assert target.tolist() == [[10 + 0.5 * 2, 10]]
    assert critic_loss(q, target).item() == (10**2 + 6**2) / 2 + (9**2 + 7**2) / 2
    # α log π - Q is -1 - 3 and 2 - 1.
    assert actor_loss(log_prob, torch.tensor([[3.0, 1.0]]), alpha).item() == (-4 + 1) / 2


def test_the_temperature_s_loss_by_hand():
    # α (H - H̄), averaged: entropies of 1 and -3, of which 1 is wanted.
    log_alpha, log_prob = torch.tensor([[math.log(0.5)]]), torch.tensor([[-1.0, 3.0]])
    loss = temperature_loss(log_alpha, log_prob, 1.0, torch.ones(1, 2))
    assert loss.item() == pytest.approx(0.5 * (0 - 4) / 2)
    # Where nothing is decided, the entropy does not count.
    loss = temperature_loss(log_alpha, log_prob, 3.0, torch.tensor([[1.0, 0.0]]))
    assert loss.item() == pytest.approx(0.5 * (-2 + 0) / 2)


# Networks without hidden layers and with weights of 0 but for some: all can be done on paper.
BY_HAND = {"hidden": (), "log_std_range": (-1.0, 1.0)}
LOG_NORMAL_0 = -0.9189385  # log N(0; 0, 1)


def constant_policy(learner, mean):
    """Weights of an actor that has μ (or, without a σ, tanh⁻¹ a) = mean, and σ = 1, everywhere."""
    params = torch.zeros_like(learner.actor_params)
    params[:, :ACT] = mean
    return params.requires_grad_()


def linear_critics(learner, biases, slopes):
    """Weights of critics with Q_j = biases[j] + slopes[j] (a_1 + a_2) everywhere."""
    params = torch.zeros_like(learner.critic_params)
    params[..., 0] = torch.tensor(biases).view(2, 1)
    params[..., -ACT:] = torch.tensor(slopes).view(2, 1, 1)
    return params


@pytest.mark.parametrize(
    ("action", "log_density"),
    [
        (0.0, LOG_NORMAL_0),
        # u = log(3) / 2 = 0.549306; u² / 2 = 0.150869; log(1 - a²) = log 0.75 = -0.287682
        (0.5, LOG_NORMAL_0 - 0.150869 + 0.287682),
        # u = log(19) / 2 = 1.472219; u² / 2 = 1.083715; log 0.19 = -1.660731
        (-0.9, LOG_NORMAL_0 - 1.083715 + 1.660731),
    ],
)
def test_the_squashed_density_by_hand(action, log_density):
    learner, (batch, *_) = make(**BY_HAND), data()
    learner.actor_params = constant_policy(learner, 0.0)
    batch = batch._replace(pre_tanh=torch.full((2, B, ACT), math.atanh(action)))
    # Two actions, independent of each other.
    expected = torch.full((2, B), 2 * log_density)
    torch.testing.assert_close(log_prob(learner, batch), expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize("mean", [0.0, 0.7])
def test_the_density_integrates_to_one(mean):
    learner = make(seeds=(0,), **BY_HAND)
    learner.actor_params = constant_policy(learner, mean)
    # Trapezoids over a grid of both actions, in the coordinates u with a = tanh u.
    u = torch.linspace(-9, 9, 401)
    pre_tanh = torch.cartesian_prod(u, u).unsqueeze(0)
    obs = torch.zeros(1, pre_tanh.shape[1], OBS)
    log_density = learner.log_prob(learner.actor_params, obs, pre_tanh).double()
    slope = 1 - torch.tanh(pre_tanh.double()).square()
    density = (log_density.exp() * slope.prod(-1)).view(401, 401)
    total = torch.trapezoid(torch.trapezoid(density, u.double()), u.double())
    assert total.item() == pytest.approx(1, abs=1e-4)


@pytest.mark.parametrize("kind", ["sac", "sac-released"])
def test_the_density_of_a_large_actor_is_taken_piece_by_piece(kind, monkeypatch):
    trainer, (batch, *_) = make_trainer(hidden=(160,), learner=kind), data()
    learner = trainer.learner
    many = batch._replace(
        **{name: getattr(batch, name).repeat_interleave(200, 1) for name in ("obs", "pre_tanh")}
    )
    expected = learner.actor.log_prob(learner.actor_params, many.obs, many.pre_tanh)
    actor, shapes = type(learner.actor), []
    whole = actor.log_prob

    def recorded(self, params, obs, pre_tanh):
        shapes.append(tuple(obs.shape[:2]))
        return whole(self, params, obs, pre_tanh)

    monkeypatch.setattr(actor, "log_prob", recorded)
    torch.testing.assert_close(
        log_density(trainer.config, trainer.learner, trainer.steps)(many), expected
    )
    assert shapes == [(1, PIECE), (1, PIECE), (1, 200 * B - 2 * PIECE)] * 2  # two members


def test_an_update_of_the_critics_by_hand():
    learner, (batch, _, noise) = make(**BY_HAND), data()
    learner.actor_params = constant_policy(learner, 0.0)
    learner.critic_params.detach().copy_(linear_critics(learner, [4.0, 1.0], [0.0, 0.0]))
    learner.target_params = linear_critics(learner, [3.0, 2.0], [0.0, 0.0])
    batch = batch._replace(terminated=torch.tensor([0.0, 1.0, 0.0] * 2).expand(2, B))
    loss = update(learner, batch, torch.ones(2, B), 0 * noise, update_actor=False)["critic_loss"]
    going_on = 1 + 0.99 * (2 - 0.2 * 2 * LOG_NORMAL_0)  # 3.343900
    assert going_on == pytest.approx(3.343900, abs=1e-6)
    by_hand = (2 * ((4 - going_on) ** 2 + (1 - going_on) ** 2) + (4 - 1) ** 2 + 0) / 3
    torch.testing.assert_close(loss, torch.full((2,), by_hand))


def test_the_actor_s_gradient_by_hand():
    """J_π = α log π - Q with log π = c - log σ - Σ log(1 - a²), a = tanh(μ + σε), Q = 2 (a₁ + a₂).

    So dJ/dμ = 2α a - 2 (1 - a²), and dJ/dlog σ = -α + σε dJ/dμ.
    """
    learner = make(seeds=(0,), **BY_HAND)
    params = constant_policy(learner, math.log(3) / 2 - 0.25)
    noise = torch.full((1, B, ACT), 0.25)  # hence a = 0.5, of which α = 0.2 and 1 - a² = 0.75
    pre_tanh, log_prob = learner.actor.sample(params, torch.zeros(1, B, OBS), noise)
    critics = linear_critics(learner, [0.0, 5.0], [2.0, 7.0])
    q = learner.critic(critics, torch.zeros(1, B, OBS), torch.tanh(pre_tanh))
    loss = actor_loss(log_prob, q.amin(0), torch.tensor([[0.2]]))
    gradient = torch.autograd.grad(loss, params)[0][0]
    by_mean = 2 * 0.2 * 0.5 - 2 * 0.75  # -1.3
    by_log_std = -0.2 + 0.25 * by_mean
    # log σ = tanh(raw) within (-1, 1), with slope 1 at raw = 0.
    expected = torch.tensor([by_mean] * ACT + [by_log_std] * ACT)
    torch.testing.assert_close(gradient[: 2 * ACT], expected)


@pytest.mark.parametrize(("learner", "sign"), [(SAC, -1), (TD3, 1)])
def test_sac_s_actor_climbs_the_smaller_critic_and_td3_s_the_first(learner, sign):
    learner = make(learner, temperature=1e-6, **BY_HAND)
    learner.critic_optimizer.learning_rate = 0.0
    learner.actor_params.detach().copy_(constant_policy(learner, 0.0))
    # The second is the smaller one, and falls with the action.
    critics = linear_critics(learner, [0.0, -9.0], [1.0, -1.0])
    learner.critic_params.detach().copy_(critics)
    batch, reward, noise = data()
    update(learner, batch, reward, 0 * noise)
    # A first step of Adam has the length of the learning rate.
    moved = torch.full((2, ACT), sign * RATE)
    torch.testing.assert_close(learner.actor_params.detach()[:, :ACT], moved, rtol=1e-4, atol=0)


def test_the_temperature_s_first_step_by_hand():
    """At σ = 1 and u = 0 the entropy is 0.919 an action: more than is wanted, so log α falls."""
    for wanted, sign in ((2 * 0.9, -1), (2 * 0.95, 1)):
        learner = make(temperature=None, target_entropy=wanted, **BY_HAND)
        learner.actor_params.detach().copy_(constant_policy(learner, 0.0))
        batch, reward, noise = data()
        update(learner, batch, reward, 0 * noise)
        expected = torch.full((2, 1), math.log(0.2) + sign * RATE)
        torch.testing.assert_close(learner.log_alpha.detach(), expected)


def test_losses_are_summed_over_members_and_averaged_over_the_batch():
    ones = torch.ones(3, 5)
    assert critic_loss(torch.zeros(2, 3, 5), ones).item() == 6
    assert critic_loss(torch.zeros(3, 5), 2 * ones).item() == 12
    assert actor_loss(ones, 2 * ones, torch.ones(3, 1)).item() == -3
    assert temperature_loss(torch.zeros(3, 1), ones, 1.0, ones).item() == -6


@pytest.mark.parametrize(("log_prob", "sign"), [(-5.0, 1), (5.0, -1)])
def test_temperature_falls_while_there_is_more_entropy_than_wanted(log_prob, sign):
    log_alpha = torch.tensor([[0.3]], requires_grad=True)
    loss = temperature_loss(log_alpha, torch.full((1, 4), log_prob), 2.0, torch.ones(1, 4))
    gradient = torch.autograd.grad(loss, log_alpha)[0]
    torch.testing.assert_close(gradient, -log_alpha.exp().detach() * (log_prob + 2.0))
    assert gradient.sign() == sign


def test_the_critic_s_target_is_that_of_the_equation():
    learner, (batch, reward, noise) = make(temperature=0.3), data()
    obs, next_obs = batch.obs, batch.next_obs
    u, log_prob = learner.actor.sample(learner.actor_params, next_obs, noise[0])
    q_1, q_2 = learner.critic(learner.target_params, next_obs, torch.tanh(u))
    next_value = torch.minimum(q_1, q_2) - 0.3 * log_prob
    target = reward + 0.99 * (1 - batch.terminated) * next_value
    q = learner.critic(learner.critic_params, obs, batch.action)
    expected = (q - target).square().mean(-1).sum(0).detach()
    torch.testing.assert_close(update(learner, batch, reward, noise)["critic_loss"], expected)


def test_the_actor_climbs_the_soft_value():
    learner, (batch, reward, noise) = make(learning_rate=1e-3), data()
    obs = batch.obs

    def value():
        u, log_prob = learner.actor.sample(learner.actor_params, obs, noise[1])
        q = learner.critic(learner.critic_params, obs, torch.tanh(u)).amin(0)
        return (q - 0.2 * log_prob).mean(1).detach()

    # With a critic that stands still, each step goes up.
    learner.critic_optimizer.learning_rate = 0.0
    before = value()
    update(learner, batch, reward, noise)
    assert (value() > before).all()


@both
def test_targets_begin_as_copies(learner):
    config = {SAC: SACConfig, TD3: TD3Config}[learner](hidden=(8,))
    made = learner(config, Layout(2, 3, 2))
    made.init(Rng((0, 1)))
    pairs = [(made.target_params, made.critic_params)]
    if learner is TD3:
        pairs.append((made.target_actor_params, made.actor_params))
    for target, trained in pairs:
        assert torch.equal(target, trained)
        assert target.data_ptr() != trained.data_ptr()


@both
def test_termination_cuts_the_bootstrap(learner):
    learner, (batch, reward, noise) = make(learner), data()
    batch = batch._replace(terminated=torch.ones(2, B))
    q = learner.critic(learner.critic_params, batch.obs, batch.action)
    expected = (q - reward).square().mean(-1).sum(0).detach()
    torch.testing.assert_close(update(learner, batch, reward, noise)["critic_loss"], expected)


@both
def test_actor_and_targets_move_when_it_is_their_turn(learner):
    learner = make(learner)
    for due in (False, True, False, False, True):
        actor, target = learner.actor_params.detach().clone(), learner.target_params.clone()
        critic = learner.critic_params.detach().clone()
        update(learner, *data(), update_actor=due)
        assert not torch.equal(critic, learner.critic_params)
        assert torch.equal(actor, learner.actor_params) != due
        assert torch.equal(target, learner.target_params) != due
        if due:
            expected = target + CONFIG.learner.target_rate * (learner.critic_params - target)
            torch.testing.assert_close(learner.target_params, expected.detach())


def test_the_temperature_moves_when_it_is_its_turn():
    learner = make(temperature=None)
    for due in (False, True, False):
        before = learner.log_alpha.detach().clone()
        update(learner, *data(), update_actor=due)
        assert torch.equal(before, learner.log_alpha) != due


@pytest.mark.parametrize("learner", ["sac", "td3"])
def test_every_second_update_is_the_actor_s_turn_from_one_block_to_the_next(learner):
    trainer = make_trainer(learner=learner)
    turns, learn = [], trainer.update_learner

    def recorded(*minibatch):
        turns.append(minibatch[-1])
        return learn(*minibatch)

    trainer.update_learner = recorded
    for steps in (3, 4, 1):
        trainer.block_start += steps
        trainer.train_on_block(steps)
    assert turns == [i % POLICY_DELAY == 0 for i in range(1, 9)]
    assert POLICY_DELAY == 2


@both
def test_the_actor_s_update_leaves_the_critics_alone(learner):
    with_actor, without = make(learner), make(learner)
    update(with_actor, *data(), update_actor=True)
    update(without, *data(), update_actor=False)
    assert not torch.equal(with_actor.actor_params, without.actor_params)
    assert torch.equal(with_actor.critic_params, without.critic_params)


def test_next_actions_and_the_actor_s_own_are_drawn_apart():
    batch, reward, noise = data()
    learners = []
    for changed in (None, 0, 1):
        drawn = noise.clone()
        if changed is not None:
            drawn[changed] = -drawn[changed]
        learners.append(make())
        update(learners[-1], batch, reward, drawn)
    same, next_actions, own = (learner.critic_params for learner in learners)
    assert not torch.equal(same, next_actions)
    assert torch.equal(same, own)
    assert not torch.equal(learners[0].actor_params, learners[2].actor_params)


@pytest.mark.parametrize(("target_entropy", "rises"), [(50.0, True), (-50.0, False)])
def test_a_learned_temperature_moves_towards_the_target_entropy(target_entropy, rises):
    learner = make(temperature=None, target_entropy=target_entropy)
    for _ in range(3):
        update(learner, *data())
    alpha = learner.log_alpha.exp()
    assert (alpha > 0.2).all() if rises else (alpha < 0.2).all()


def test_a_fixed_temperature_stays():
    learner = make(temperature=0.7, target_entropy=50.0)
    metrics = [update(learner, *data())["temperature"] for _ in range(3)]
    torch.testing.assert_close(torch.stack(metrics), torch.full((3, 2), 0.7))


def test_the_target_entropy_is_minus_the_number_of_actions():
    assert make(temperature=None).target_entropy == -ACT


@pytest.mark.parametrize("learner", ["sac", "td3"])
def test_a_policy_taken_out_is_not_trained_on(learner):
    trainer, (batch, reward, noise) = make_trainer(learner=learner), data()
    policy, obs = trainer.policy, batch.obs
    before = policy.act(obs)
    trainer.learner.update(batch._replace(reward=reward), noise, True)
    assert torch.equal(policy.act(obs), before)
    assert not torch.equal(trainer.policy.act(obs), before)


# Absorbing states.


def ending(batch, obs_too=False):
    """Half of the batch enters the absorbing state; with `obs_too` all of it is in there."""
    there = absorbing_state(batch.obs)
    every_second = (torch.arange(B) % 2 == 0).view(1, B, 1)
    return batch._replace(
        obs=there if obs_too else batch.obs,
        next_obs=torch.where(every_second, there, batch.next_obs),
        terminated=torch.zeros(2, B),
    )


def losses(learner, mode, constant, batch, reward, absorbing_reward):
    """The squared error of one update, where the targets say Q = constant everywhere."""
    learner = make(learner, absorbing=mode)
    learner.target_params.zero_()
    *_, (bias, _) = learner.critic.net.layers(learner.target_params.flatten(0, 1))
    bias.fill_(constant)
    return update(learner, batch, reward, data()[2], absorbing_reward)["critic_loss"]


@both
def test_bootstrap_at_its_fixed_point_is_the_analytic_return(learner):
    batch, reward, _ = data()
    batch = ending(batch)._replace(next_obs=absorbing_state(batch.obs))
    fixed_point = -0.7 / (1 - 0.99)
    bootstrap = losses(learner, "bootstrap", fixed_point, batch, reward, -0.7)
    analytic = losses(learner, "analytic", 123.0, batch, reward, -0.7)
    torch.testing.assert_close(bootstrap, analytic, rtol=1e-4, atol=0)


@both
@pytest.mark.parametrize("mode", ["bootstrap", "analytic"])
def test_targets_with_absorbing_states_by_hand(learner, mode):
    learner, (batch, reward, noise) = make(learner, absorbing=mode), data()
    batch, there = ending(batch), -0.7
    target = learner.target(paid(learner, batch, reward, there), noise[0])
    plain = make(type(learner)).target(batch._replace(reward=reward), noise[0])
    ended = is_absorbing(batch.next_obs)
    assert ended.any()
    assert torch.equal(target[~ended], plain[~ended])
    still = torch.zeros(2, B, ACT)
    next_obs = batch.next_obs
    # The next action is 0, and certain: no noise, no entropy.
    q = learner.critic(learner.target_params, next_obs, still).amin(0)
    next_value = q if mode == "bootstrap" else torch.tensor(there / (1 - 0.99))
    torch.testing.assert_close(target[ended], (reward + 0.99 * next_value)[ended])


@both
def test_the_actor_learns_nothing_in_the_absorbing_state(learner):
    batch, reward, noise = data()
    for all_of_it in (True, False):
        one = make(learner, absorbing="bootstrap")
        before = one.actor_params.detach().clone()
        update(one, ending(batch, obs_too=all_of_it), reward, noise)
        assert torch.equal(one.actor_params, before) == all_of_it


def test_log_prob_is_zero_in_the_absorbing_state_and_that_of_the_actor_elsewhere():
    learner, (batch, *_) = make(absorbing="bootstrap"), data()
    expected = log_prob(make(), batch)
    assert torch.equal(log_prob(learner, batch), expected)
    torch.testing.assert_close(
        expected, learner.actor.log_prob(learner.actor_params, batch.obs, batch.pre_tanh)
    )
    assert (log_prob(learner, ending(batch, obs_too=True)) == 0).all()


def test_log_prob_may_be_taken_under_other_weights_and_as_released():
    learner, (batch, *_) = make(), data()
    other = make(seeds=(5, 6)).actor_params
    learner_of_other = make()
    learner_of_other.actor_params = other
    under_other = learner.log_prob(other, batch.obs, batch.pre_tanh)
    assert torch.equal(under_other, log_prob(learner_of_other, batch))
    assert not torch.equal(under_other, log_prob(learner, batch))
    released = log_prob(make(settings=ReleasedSACConfig), batch)
    obs = batch.obs
    mean, log_std = learner.actor.distribution(learner.actor_params, obs)
    expected = gaussian_log_density(torch.tanh(batch.pre_tanh), mean, log_std)
    assert torch.equal(released, expected.detach())


def test_the_density_that_the_discriminator_sees_stays_while_the_actor_learns():
    trainer, (batch, reward, noise) = make_trainer(), data()
    density = log_density(trainer.config, trainer.learner, trainer.steps)
    before = density(batch)
    assert torch.equal(before, log_prob(trainer.learner, batch))
    trainer.learner.update(batch._replace(reward=reward), noise, True)
    assert torch.equal(density(batch), before)
    assert not torch.equal(
        log_density(trainer.config, trainer.learner, trainer.steps)(batch), before
    )


# The population axis.


def train(learner, seeds, batch, reward, noise, updates=4, **changes):
    made = make(learner, seeds, temperature=None, **changes)
    for i in range(updates):
        update(made, batch, reward, noise, update_actor=bool(i % 2))
    return weights(made)


@both
@pytest.mark.parametrize("mode", ["none", "bootstrap", "analytic"])
def test_training_together_is_training_alone(learner, mode):
    seeds = (0, 1, 2, 3, 4)
    batch, reward, noise = data(seeds)
    together = train(learner, seeds, batch, reward, noise, absorbing=mode)
    for i, seed in enumerate(seeds):
        own = Batch(*(part[[i]] for part in batch))
        alone = train(learner, (seed,), own, reward[[i]], noise[:, [i]], absorbing=mode)
        torch.testing.assert_close(together[[i]], alone, rtol=1e-4, atol=1e-5)


@both
def test_a_member_s_data_changes_no_other_member(learner):
    seeds = (0, 1, 2)
    batch, reward, noise = data(seeds)
    one = train(learner, seeds, batch, reward, noise)
    batch.obs[1] += 1
    reward[1] -= 1
    noise[:, 1] *= 2
    other = train(learner, seeds, batch, reward, noise)
    assert torch.equal(one[[0, 2]], other[[0, 2]])
    assert not torch.equal(one[1], other[1])


@pytest.mark.parametrize("there", [True, False])
def test_the_temperature_does_not_look_at_the_absorbing_state(there):
    streams, sac = (
        Rng((0,)),
        SAC(SACConfig(temperature=None, hidden=(8,)), Layout(1, 3, 2, absorbs=True)),
    )
    sac.init(streams)
    obs = streams.normal(6, 3)
    obs = absorbing_state(obs) if there else obs
    zero = torch.zeros(1, 6)
    batch = Batch(obs, streams.normal(6, 2), obs, zero, zero)
    before = sac.log_alpha.item()
    sac.update(batch, streams.normal(2, 6, 2).transpose(0, 1), True)
    assert (sac.log_alpha.item() == before) == there


MCP = {"primitives": 3, "trunk_hidden": (8,), "primitive_hidden": (6,), "gate_hidden": (8,)}


@pytest.mark.parametrize("fixed", [False, True])
def test_of_a_composite_actor_all_learns_or_only_the_gate(fixed):
    learner = make(**MCP, fixed_primitives=fixed)
    before = learner.actor_params.detach().clone()
    for _ in range(3):
        update(learner, *data())
    moved = learner.actor_params.detach() - before
    *others, of_gate = (part.flatten(1) for part in learner.actor.split(moved))
    assert of_gate.any(1).all()
    for part in others:
        assert part.any(1).all() != fixed
        assert not (fixed and part.any())


def test_composite_actors_are_trained_together_as_alone():
    together, alone = make(**MCP), [make(seeds=(seed,), **MCP) for seed in (0, 1)]
    for _ in range(4):
        update(together, *data())
        for seed, learner in enumerate(alone):
            update(learner, *data(seeds=(seed,)))
    expected = torch.cat([weights(learner) for learner in alone])
    torch.testing.assert_close(weights(together), expected, rtol=1e-4, atol=1e-6)


def test_q_by_hand():
    learner, (batch, reward, noise) = make(**BY_HAND), data()
    learner.critic_params.detach().copy_(linear_critics(learner, [4.0, 1.0], [0.0, 0.0]))
    q = update(learner, batch, reward, noise)["q"]
    torch.testing.assert_close(q, torch.full((2,), 2.5))
