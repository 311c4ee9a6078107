"""The program of chapters 2 to 5: its mathematics, its training, and that `core` does the same."""

import math

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.spaces import Box

from offairl_lite import demonstrations, envs, plain
from offairl_lite.config import CORRECTED
from offairl_lite.core.discriminator import Discriminator as CoreDiscriminator
from offairl_lite.core.replay import Batch as CoreBatch
from offairl_lite.core.rng import Rng
from offairl_lite.core.sac import POLICY_DELAY
from offairl_lite.core.sac import SAC as CoreSAC
from offairl_lite.core.shapes import Layout

LEFT = "offairl/PointMazeLeft-v0"
OBS, ACT, B = 3, 2, 64


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def random_batch(rng, count=B):
    obs, u, next_obs = (torch.randn(count, n, generator=rng) for n in (OBS, ACT, OBS))
    reward = torch.randn(count, generator=rng)
    terminated = (torch.rand(count, generator=rng) < 0.25).float()
    return plain.Batch(obs, u, next_obs, reward, terminated)


@pytest.fixture
def double():
    """Numbers in double precision: Adam magnifies the rounding of gradients that are almost 0."""
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)


def test_networks_start_as_glorot_and_bengio_say():
    net = plain.mlp([30, 50, 2], torch.nn.Tanh, generator())
    assert [type(layer).__name__ for layer in net] == ["Linear", "Tanh", "Linear"]
    weights = net[0].weight.detach()
    limit = math.sqrt(6 / 80)
    assert 0.98 * limit < weights.abs().max() <= limit
    assert weights.std().item() == pytest.approx(limit / math.sqrt(3), rel=0.05)
    assert not net[0].bias.any()
    assert not net[2].bias.any()


def test_the_cross_entropy_by_hand_and_far_out():
    expert, policy = torch.tensor([0.0, 2.0]), torch.tensor([-1.0, 3.0])
    d_expert, d_policy = torch.sigmoid(expert), torch.sigmoid(policy)
    by_hand = -d_expert.log().mean() - (1 - d_policy).log().mean()
    torch.testing.assert_close(plain.cross_entropy(expert, policy), by_hand)
    # Here D rounds to 1 and its complement to 0.
    far = plain.cross_entropy(torch.tensor([-200.0]), torch.tensor([200.0]))
    assert far.item() == pytest.approx(400)


@pytest.mark.usefixtures("double")
def test_the_gradient_penalty_against_finite_differences():
    rng, h = generator(), 1e-5
    net = plain.mlp([4, 8, 1], torch.nn.Tanh, rng)
    x, y = (torch.randn(5, 2, generator=rng) for _ in range(2))

    def f(x, y):
        return net(torch.cat([x, y], -1)).squeeze(-1)

    def penalty_by_differences():
        slopes = []
        for step in h * torch.eye(4):
            dx, dy = step.split(2)
            slopes.append((f(x + dx, y + dy) - f(x - dx, y - dy)) / (2 * h))
        return (torch.stack(slopes, -1).norm(dim=-1) - 1).square().mean()

    penalty = plain.gradient_penalty(f, x, y)
    torch.testing.assert_close(penalty, penalty_by_differences())
    # It is itself differentiable, by the weights.
    gradient = torch.autograd.grad(penalty, net[0].weight)[0][3, 1]
    with torch.no_grad():
        net[0].weight[3, 1] += h
    above = plain.gradient_penalty(f, x, y)
    with torch.no_grad():
        net[0].weight[3, 1] -= 2 * h
    below = plain.gradient_penalty(f, x, y)
    torch.testing.assert_close((above - below) / (2 * h), gradient, rtol=1e-5, atol=1e-8)


def test_airl_s_loss_by_hand():
    rng = generator()
    expert, policy = random_batch(rng, 2), random_batch(rng, 2)
    log_probs = [torch.tensor([1.0, -1.0]), torch.tensor([0.0, 3.0])]

    def f(obs, next_obs):  # of slope 5 everywhere
        return 3 * obs[:, 0] - 4 * next_obs[:, 1]

    loss = plain.airl_loss(f, expert, policy, log_probs, torch.rand(2, 1, generator=rng), 0.5)
    logits = [
        f(b.obs, b.next_obs) - log_prob
        for b, log_prob in zip((expert, policy), log_probs, strict=True)
    ]
    by_hand = -torch.sigmoid(logits[0]).log() - torch.sigmoid(-logits[1]).log()
    torch.testing.assert_close(loss, by_hand.mean() + 0.5 * (5 - 1) ** 2)


def test_shaping_has_the_form_that_changes_no_policy():
    discriminator, batch = plain.Discriminator(OBS, generator()), random_batch(generator(1))
    value = discriminator.value(batch.obs)[:, 0]
    expected = discriminator.r(batch.obs) + (0.99 - 1) * value
    torch.testing.assert_close(discriminator.f(batch.obs, batch.obs), expected)


def test_the_discriminator_learns_to_tell_two_sides_apart():
    rng = generator()
    discriminator = plain.Discriminator(OBS, rng)
    log_probs = [torch.zeros(B)] * 2

    def sides():
        for centre in (0.5, -0.5):
            batch = random_batch(rng)
            yield batch._replace(obs=batch.obs + centre, next_obs=batch.next_obs + centre)

    def cross_entropy():
        f = [discriminator.f(side.obs, side.next_obs).detach() for side in sides()]
        return plain.cross_entropy(*f)

    before = cross_entropy()
    for _ in range(150):
        mix = torch.rand(B, 1, generator=rng)
        loss = plain.airl_loss(discriminator.f, *sides(), log_probs, mix)
        plain.descend(loss, discriminator.optimizer)
    assert before > 1.2
    assert cross_entropy() < 0.9


@pytest.mark.parametrize(("mean", "std"), [(0.0, 0.5), (0.0, 1.5), (0.8, 0.8)])
def test_the_density_integrates_to_1(mean, std):
    u = torch.linspace(-20, 20, 400_001, dtype=torch.float64)
    a = torch.tanh(u)
    mean, log_std = torch.full((1,), mean), torch.full((1,), std).log()
    density = plain.log_density(u[:, None], mean, log_std).exp()
    assert torch.trapezoid(density, a).item() == pytest.approx(1, abs=1e-6)
    far = plain.log_density(torch.tensor([40.0, -40.0]), torch.zeros(2), torch.zeros(2))
    assert far.isfinite()


def test_a_sample_s_density_is_that_of_its_action():
    actor, batch = plain.Actor(OBS, ACT, generator()), random_batch(generator(1))
    u, log_prob = actor.sample(batch.obs, torch.randn(B, ACT, generator=generator(2)))
    torch.testing.assert_close(log_prob, plain.log_pi(actor, batch._replace(pre_tanh=u)))
    assert log_prob.requires_grad
    assert not plain.log_pi(actor, batch).requires_grad


def test_the_losses_by_hand():
    q = torch.tensor([[1.0, 4.0], [2.0, 3.0]])
    alpha, log_prob = torch.tensor(0.5), torch.tensor([-2.0, 4.0])
    value = plain.soft_value(log_prob, q, alpha)
    assert value.tolist() == [1 + 1, 3 - 2]
    reward, terminated = torch.tensor([10.0, 10.0]), torch.tensor([0.0, 1.0])
    # The entropy stands inside γ, and a termination cuts all of it.
    target = plain.critic_target(reward, terminated, value, 0.5)
    assert target.tolist() == [10 + 0.5 * 2, 10]
    assert plain.critic_loss(q, target).item() == (10**2 + 6**2) / 2 + (9**2 + 7**2) / 2
    assert plain.actor_loss(log_prob, q, alpha).item() == -(2 + 1) / 2
    assert plain.temperature_loss(alpha, log_prob, -2.0).item() == 0.5 * (2 + 2 - 4 + 2) / 2


def test_sac_finds_the_best_action_and_holds_the_entropy():
    rng = generator()
    sac = plain.SAC(OBS, 1, rng)
    sac.target_entropy = -0.5
    for _ in range(800):
        obs, noise = torch.randn(B, OBS, generator=rng), torch.randn(B, 1, generator=rng)
        u = sac.actor.sample(obs, noise)[0].detach()
        reward = -5 * (torch.tanh(u).squeeze(-1) - 0.5).square()
        plain.update_sac(sac, plain.Batch(obs, u, obs, reward, torch.ones(B)), reward, rng)
    u, log_prob = sac.actor.sample(obs, torch.randn(B, 1, generator=rng))
    assert torch.tanh(sac.actor(obs)[0]).mean().item() == pytest.approx(0.5, abs=0.15)
    assert -log_prob.mean().item() == pytest.approx(-0.5, abs=0.35)


def test_the_actor_s_loss_leaves_nothing_in_the_critics():
    rng = generator()
    sac, batch = plain.SAC(OBS, ACT, rng), random_batch(rng)
    noise = torch.randn(2, B, ACT, generator=rng)
    plain.update_critic(sac, batch, batch.reward, noise[0])
    critic, actor = (list(net.parameters()) for net in (sac.critic, sac.actor))
    before = [(p.clone(), p.grad.clone()) for p in critic]
    plain.update_actor(sac, batch.obs, noise[1])
    for p, (value, gradient) in zip(critic, before, strict=True):
        assert torch.equal(p, value)
        assert torch.equal(p.grad, gradient)
    assert all(p.grad.any() for p in actor)
    assert all(p.grad is None for p in sac.slow_critic.parameters())


class Corridor(gymnasium.Env):
    """Whoever pushes right terminates in the third step; the clock runs out after five."""

    observation_space, action_space = Box(-9, 9, (1,)), Box(-1, 1, (1,))

    def reset(self, seed=None, options=None):
        self.position, self.steps = 0.0, 0
        return np.array([0.0]), {}

    def step(self, action):
        self.position, self.steps = self.position + action[0], self.steps + 1
        end = bool(self.position > 2.5), self.steps == 5
        return np.array([self.position]), -1.0, *end, {}


def test_a_time_limit_is_no_termination():
    right = plain.run_episode(Corridor(), lambda obs: torch.full((1,), 30.0))
    assert right.terminated.tolist() == [0, 0, 1]
    left = plain.run_episode(Corridor(), lambda obs: torch.full((1,), -30.0))
    assert left.terminated.tolist() == [0, 0, 0, 0, 0]
    assert left.reward.tolist() == [-1.0] * 5
    # What is kept is u, not the action, which rounds to -1.
    assert left.pre_tanh.tolist() == [[-30.0]] * 5
    assert left.obs[1:].tolist() == left.next_obs[:-1].tolist() == [[-1.0], [-2.0], [-3.0], [-4.0]]
    both = plain.join([right, left])
    assert both.terminated.tolist() == [0, 0, 1, 0, 0, 0, 0, 0]
    # Every transition is drawn equally often.
    rng = generator()
    drawn = torch.cat([plain.draw(both, lambda obs: obs, rng).next_obs for _ in range(100)])
    assert (drawn == -5).float().mean().item() == pytest.approx(1 / 8, abs=0.02)


def test_the_scaling_weighs_both_sources_alike():
    rng = generator()
    few, many = torch.randn(10, 3, generator=rng) + 2, 3 * torch.randn(90, 3, generator=rng)
    few[:, 2] = many[:, 2] = 7.0
    scaled = [plain.normaliser(few, many)(obs) for obs in (few, many)]
    mean = (scaled[0].mean(0) + scaled[1].mean(0)) / 2
    variance = (scaled[0].square().mean(0) + scaled[1].square().mean(0)) / 2
    torch.testing.assert_close(mean, torch.zeros(3), rtol=0, atol=1e-5)
    torch.testing.assert_close(variance, torch.tensor([1.0, 1.0, 0.0]))


def test_warm_up_actions_are_uniform_and_held():
    actions = plain.sticky_actions(2, generator())
    a = torch.tanh(torch.stack([next(actions) for _ in range(20_000)]))
    held = (a[1:] == a[:-1]).all(1).float().mean().item()
    assert held == pytest.approx(0.9, abs=0.01)
    fresh = a[1:][(a[1:] != a[:-1]).any(1)]
    quarters = torch.histc(fresh, 4, -1, 1) / fresh.numel()
    torch.testing.assert_close(quarters, torch.full((4,), 0.25), rtol=0, atol=0.03)


def short_run(demos, seed=0):
    """Yield what `train` does, with the return of each policy in front."""
    env = gymnasium.make(envs.spec(LEFT))
    for row in plain.train(env, demos, generator(seed), num_episodes=2, warmup=1):
        _, sac, _, scale = row
        yield plain.evaluate(env, plain.policy_of(sac.actor, scale)), *row


def test_a_seed_gives_the_same_run_whatever_the_global_state(random_demonstrations):
    demos = random_demonstrations(LEFT).transitions
    run = list(short_run(demos))
    returns, steps, sac, airl, scale = zip(*run, strict=True)
    assert steps == (100, 200)
    assert all(-80 < x < -2 for x in returns)
    assert sac[-1].updates == 200
    torch.rand(1)
    again = list(short_run(demos))
    assert [row[:2] for row in again] == [row[:2] for row in run]
    obs = scale[-1](demos.obs)
    assert torch.equal(airl[-1].r(obs), again[-1][3].r(obs))
    assert torch.equal(sac[-1].actor(obs)[0], again[-1][2].actor(obs)[0])
    assert run[0][0] != next(short_run(demos, seed=1))[0]


# What the comparison needs of `core` is in these four functions.

CORE_CONFIG = CORRECTED.change(hidden=(64, 64), reward_hidden=(64, 64), shaping_hidden=(64, 64),
    temperature=None, target_entropy=-1.0, target_rate=0.01,
)  # fmt: skip


def test_it_crosses_the_maze():
    """In 6,000 steps at least four of five seeds return more than −13; the trap is at −26.5."""
    task = "offairl/PointMazeLeft-v0"
    expert = demonstrations.load(task, trajectories=50)
    last = []
    for seed in range(5):
        env, demos = gymnasium.make(task), plain.Batch(*expert.transitions)
        *_, (steps, sac, _, scale) = plain.train(env, demos, generator(seed), 60, 30)
        assert steps == 6_000
        last.append(plain.evaluate(env, plain.policy_of(sac.actor, scale)))
    assert sum(value > -13 for value in last) >= 4, last


def core_learners():
    """Return SAC and a discriminator of one member, whose observations are scaled already."""
    streams, layout = Rng([0]), Layout(1, OBS, ACT)
    learners = (
        CoreSAC(CORE_CONFIG.learner, layout),
        CoreDiscriminator(CORE_CONFIG.discriminator, layout),
    )
    for learner in learners:
        learner.init(streams)
    return learners


def core_networks(sac, discriminator):
    """Return architecture and weights, shape (1, P), of each network, by its name in `plain`."""
    critic, discriminating = sac.critic.net, (discriminator.reward_net, discriminator.value_net)
    return {
        "actor": (sac.actor.net, sac.actor_params),
        "critic 1": (critic, sac.critic_params[0]),
        "critic 2": (critic, sac.critic_params[1]),
        "slow critic 1": (critic, sac.target_params[0]),
        "slow critic 2": (critic, sac.target_params[1]),
        "reward": (discriminating[0], discriminator.reward_params),
        "value": (discriminating[1], discriminator.value_params),
    }


def core_weights(net, params):
    """Return bias (out,) and weight (out, in) of each layer."""
    return [(bias[0, 0], weight[0].T) for bias, weight in net.layers(params.detach())]


def core_update(sac, discriminator, expert, policy, mix, noise, update_actor):
    """Update the discriminator, then SAC on its reward."""
    expert, policy = (CoreBatch(*(x[None] for x in side)) for side in (expert, policy))
    sides = (
        discriminator.transitions(x, sac.log_prob(sac.actor_params, x.obs, x.pre_tanh))
        for x in (expert, policy)
    )
    discriminator.update(*sides, mix[None].expand(1, B, 4))
    paid = policy._replace(reward=discriminator.reward(policy, None))
    sac.update(paid, noise[:, None], update_actor)


def plain_networks(sac, discriminator):
    nets = sac.actor.net, *sac.critic.nets, *sac.slow_critic.nets
    names = "actor", "critic 1", "critic 2", "slow critic 1", "slow critic 2", "reward", "value"
    return dict(zip(names, (*nets, discriminator.reward, discriminator.value), strict=True))


def linear(net):
    return [layer for layer in net if isinstance(layer, torch.nn.Linear)]


@pytest.mark.usefixtures("double")
def test_core_with_one_member_takes_the_same_steps():
    rng = generator()
    sac, discriminator = plain.SAC(OBS, ACT, rng), plain.Discriminator(OBS, rng)
    core = core_learners()
    ours = plain_networks(sac, discriminator)
    with torch.no_grad():
        for name, network in core_networks(*core).items():
            pairs = zip(linear(ours[name]), core_weights(*network), strict=True)
            for layer, (bias, weight) in pairs:
                layer.bias.copy_(bias)
                layer.weight.copy_(weight)
    start = {name: [layer.weight.clone() for layer in linear(net)] for name, net in ours.items()}

    for step in range(50):
        expert, policy = random_batch(rng), random_batch(rng)
        same = rng.clone_state()
        mix = torch.rand(B, 1, generator=same)
        noise = torch.randn(2, B, ACT, generator=same)
        update_actor = (step + 1) % POLICY_DELAY == 0
        core_update(*core, expert, policy, mix, noise, update_actor)
        plain.update_discriminator(discriminator, sac.actor, expert, policy, rng)
        plain.update_sac(sac, policy, discriminator.r(policy.obs), rng)

    for name, network in core_networks(*core).items():
        pairs = zip(linear(ours[name]), core_weights(*network), start[name], strict=True)
        for layer, (bias, weight), before in pairs:
            torch.testing.assert_close(layer.bias, bias, rtol=0, atol=1e-8)
            torch.testing.assert_close(layer.weight, weight, rtol=0, atol=1e-8)
            assert (layer.weight - before).abs().max() > 1e-3, name
    torch.testing.assert_close(sac.log_alpha, core[0].log_alpha[0, 0])
