"""What TD3 does otherwise than SAC; the rest is in `test_sac.py`."""

import math

import pytest
import torch
from test_sac import BY_HAND, B, constant_policy, data, linear_critics, make, update

from offairl_lite.core.networks import BETAS
from offairl_lite.core.rng import Rng
from offairl_lite.core.td3 import TD3, smoothed_action


@pytest.mark.parametrize(
    ("action", "noise", "expected"),
    [
        (0.0, 1.0, 0.2),  # ε has standard deviation 0.2,
        (0.0, 10.0, 0.5),  # is clipped to ±0.5,
        (0.1, -10.0, -0.4),
        (0.9, 10.0, 1.0),  # and so is the action, to ±1.
        (-0.9, -10.0, -1.0),
    ],
)
def test_smoothing_clips_the_noise_and_then_the_action(action, noise, expected):
    smoothed = smoothed_action(torch.tensor([[[action]]]), torch.tensor([[[noise]]]))
    torch.testing.assert_close(smoothed.item(), expected)


@pytest.mark.parametrize(
    ("noise", "next_value"),
    [
        (0.0, 2 * (0.8 + 0.8)),  # tanh of the target actor, and Q₂ is the smaller,
        (1.0, 2 * (1.0 + 1.0)),  # the action is 0.8 + 0.2 = 1,
        (9.0, 2 * (1.0 + 1.0)),  # and never more;
        (-9.0, 2 * (0.3 + 0.3)),  # the noise is never below -0.5.
    ],
)
def test_an_update_of_the_critics_by_hand(noise, next_value):
    learner, (batch, *_) = make(TD3, **BY_HAND), data()
    learner.target_actor_params = constant_policy(learner, math.atanh(0.8)).detach()
    learner.actor_params.detach().copy_(constant_policy(learner, -3.0))  # not asked
    learner.target_params = linear_critics(learner, [5.0, 0.0], [1.0, 2.0])
    learner.critic_params.detach().copy_(linear_critics(learner, [4.0, 1.0], [0.0, 0.0]))
    batch = batch._replace(terminated=torch.tensor([0.0, 1.0, 0.0] * 2).expand(2, B))
    noises = torch.full((2, 2, B, 2), noise)
    loss = update(learner, batch, torch.ones(2, B), noises)["critic_loss"]
    going_on = 1 + 0.99 * next_value
    by_hand = (2 * ((4 - going_on) ** 2 + (1 - going_on) ** 2) + (4 - 1) ** 2 + 0) / 3
    torch.testing.assert_close(loss, torch.full((2,), by_hand))


def test_the_actor_s_gradient_by_hand():
    """J_π = -Q₁ with Q₁ = 2 (a₁ + a₂) and a = tanh μ = 0.5: dJ/dμ = -2 (1 - a²) = -1.5."""
    learner, (batch, reward, noise) = make(TD3, **BY_HAND), data()
    learner.critic_optimizer.learning_rate = 0.0
    learner.actor_params.detach().copy_(constant_policy(learner, math.log(3) / 2))
    learner.critic_params.detach().copy_(linear_critics(learner, [0.0, -5.0], [2.0, 7.0]))
    update(learner, batch, reward, noise)
    # Adam remembers so much of its first gradient.
    gradient = learner.actor_optimizer.mean / (1 - BETAS[0])
    torch.testing.assert_close(gradient[:, :2], torch.full((2, 2), -1.5))


def test_the_critic_s_target_is_that_of_the_equation():
    learner, (batch, reward, noise) = make(TD3), data()
    learner.target_actor_params = learner.actor.init(Rng((8, 9)))
    obs, next_obs = batch.obs, batch.next_obs
    mode = torch.tanh(learner.actor.net(learner.target_actor_params, next_obs))
    action = (mode + (0.2 * noise[0]).clamp(-0.5, 0.5)).clamp(-1, 1)
    q_1, q_2 = learner.critic(learner.target_params, next_obs, action)
    target = reward + 0.99 * (1 - batch.terminated) * torch.minimum(q_1, q_2)
    q = learner.critic(learner.critic_params, obs, batch.action)
    expected = (q - target).square().mean(-1).sum(0).detach()
    torch.testing.assert_close(update(learner, batch, reward, noise)["critic_loss"], expected)


def test_the_actor_climbs_the_first_critic():
    learner, (batch, reward, noise) = make(TD3, learning_rate=1e-3), data()
    learner.critic_optimizer.learning_rate = 0.0
    obs = batch.obs

    def value():
        action = learner.actor.mode(learner.actor_params, obs)
        return learner.critic(learner.critic_params, obs, action)[0].mean(1).detach()

    before = value()
    update(learner, batch, reward, noise)
    assert (value() > before).all()


def test_the_actor_s_target_follows_the_actor():
    learner = make(TD3)
    before = learner.target_actor_params.clone()
    update(learner, *data())
    expected = before + 0.005 * (learner.actor_params.detach() - before)
    torch.testing.assert_close(learner.target_actor_params, expected)


def test_td3_explores_with_a_standard_deviation_of_a_tenth():
    learner, (batch, *_) = make(TD3), data()
    mode = learner.actor.mode(learner.actor_params, batch.obs)
    u = learner.actor.explore(learner.actor_params, batch.obs, torch.ones_like(mode))
    torch.testing.assert_close(torch.tanh(u), (mode + 0.1).clamp(max=1), rtol=0, atol=1e-5)
