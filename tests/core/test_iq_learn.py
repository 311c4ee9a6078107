"""IQ-Learn: its loss by hand, what it learns where everything can be counted, and its updates."""

import math

import numpy as np
import pytest
import torch

from offairl_lite.config import SACConfig
from offairl_lite.core.absorbing import absorbing_state, is_absorbing
from offairl_lite.core.iq_learn import REGULARISER, IQLearn, iq_loss
from offairl_lite.core.loop import train
from offairl_lite.core.replay import Batch
from offairl_lite.core.rng import Rng
from offairl_lite.core.sac import SAC
from offairl_lite.core.shapes import Layout
from offairl_lite.tabular import MDP
from offairl_lite.tabular.planning import soft_value_iteration
from offairl_lite.tabular.sampling import sample

OBS, ACT, B, DISCOUNT = 3, 2, 8, 0.9


def make(absorbing="none", **changes):
    config = SACConfig(hidden=(8, 8), discount=DISCOUNT, **changes)
    made = IQLearn(config, Layout(2, OBS, ACT, absorbs=absorbing != "none"))
    made.init(Rng((0, 1)))
    made.target_params = made.critic.init(Rng((50, 51)))
    return made


def data(absorbing=False):
    """A minibatch of two halves, with terminations or with the absorbing state, and noise."""
    streams = Rng((100, 101))
    obs, u, next_obs = (streams.normal(B, n) for n in (OBS, ACT, OBS))
    ended = torch.zeros(2, B)
    ended[:, ::3] = 1
    if absorbing:
        obs[:, 1], next_obs[:, :2], u[:, 1] = (
            absorbing_state(obs[:, 1]),
            absorbing_state(next_obs[:, :2]),
            0,
        )
        ended = 0 * ended
    labels = torch.cat([torch.ones(2, B // 2), torch.zeros(2, B // 2)], 1)
    return Batch(obs, u, next_obs, labels, ended), streams.normal(3, B, ACT).transpose(0, 1)


def update(learner, batch, noise, update_actor=True):
    return learner.update(batch, noise, update_actor)


def test_the_loss_by_hand():
    q = torch.tensor([[[5.0, 2.0]], [[4.0, 1.0]]])
    value = torch.tensor([[[3.0, 1.0]], [[2.0, 0.0]]])
    next_value = torch.tensor([[2.0, 3.0]])
    # Rewards 3 and -1 by the first critic, 2 and -2 by the second; the first of each is expert's.
    first = -3 + (1 - 2) / 2 + 0.5 * (9 + 1) / 2
    second = -2 + (0 - 3) / 2 + 0.5 * (4 + 4) / 2
    assert REGULARISER == 0.5
    assert iq_loss(q, value, next_value).item() == first + second


def test_the_gradient_by_hand():
    streams = Rng((0, 1))
    q, value = (streams.normal(2, B).transpose(0, 1).requires_grad_() for _ in range(2))
    next_value = streams.normal(B)
    by_q, by_value = torch.autograd.grad(iq_loss(q, value, next_value), [q, value])
    expert = torch.arange(B) < B // 2
    reward = (q - next_value).detach()
    torch.testing.assert_close(by_q, 2 * REGULARISER * reward / B - expert / (B / 2))
    torch.testing.assert_close(by_value, torch.full_like(value, 1 / B))


TEMPERATURE = 0.1


def solved(mdp, shown, replayed, steps):
    """Both critics' π = softmax(Q/α), of tables that descend the loss of all transitions."""
    both = np.concatenate([shown, replayed])
    s, a, next_s = torch.as_tensor(both).T
    q = torch.zeros(2, mdp.num_states, mdp.num_actions, requires_grad=True)
    slow = torch.zeros(mdp.num_states)
    for _ in range(steps):
        v = TEMPERATURE * (q / TEMPERATURE).logsumexp(-1)
        next_value = mdp.discount * slow[next_s].unsqueeze(0)
        loss = iq_loss(q[:, s, a].unsqueeze(1), v[:, s].unsqueeze(1), next_value)
        (slope,) = torch.autograd.grad(loss, q)
        with torch.no_grad():
            q -= 0.2 * slope
            slow.lerp_(v.amin(0), 0.05)
    return (q.detach() / TEMPERATURE).softmax(-1)


def steps_of(mdp, policy, episodes, seed):
    states, actions = sample(mdp, policy, episodes, np.random.default_rng(seed), 20)
    return np.stack([states[:, :-1], actions, states[:, 1:]], -1).reshape(-1, 3)


@pytest.mark.parametrize("states", [1, 5])
def test_its_critics_recover_the_expert_s_policy(states):
    """In a bandit and in a random process, from replay of random actions alone."""
    rng = np.random.default_rng(0)
    moves = rng.dirichlet(np.full(states, 0.3), (states, 3))
    mdp = MDP(moves, np.full(states, 1 / states), DISCOUNT)
    expert = soft_value_iteration(mdp, 0.1 * rng.normal(size=(states, 3)), TEMPERATURE).policy
    random = np.full_like(expert, 1 / mdp.num_actions)
    shown, replayed = steps_of(mdp, expert, 100, 0), steps_of(mdp, random, 100, 1)
    for found in solved(mdp, shown, replayed, 1_000):
        far = np.abs(found.numpy() - expert).sum(-1) / 2
        assert far.max() < 0.1
        assert far.max() < 0.5 * (np.abs(random - expert).sum(-1) / 2).max()


def test_an_update_takes_the_critics_down_the_loss_of_the_equation():
    learner, (batch, noise) = make(), data()
    q = learner.critic(learner.critic_params, batch.obs, batch.action)
    u, log_prob = learner.actor.sample(learner.actor_params, batch.obs, noise[2])
    own = learner.critic(learner.critic_params, batch.obs, torch.tanh(u))
    alpha = 0.2
    next_u, next_log_prob = learner.actor.sample(learner.actor_params, batch.next_obs, noise[0])
    slow = learner.critic(learner.target_params, batch.next_obs, torch.tanh(next_u)).amin(0)
    y = (DISCOUNT * (1 - batch.terminated) * (slow - alpha * next_log_prob)).detach()
    loss = iq_loss(q, own - alpha * log_prob.detach(), y)
    (slope,) = torch.autograd.grad(loss, learner.critic_params)
    before, actor = learner.critic_params.detach().clone(), learner.actor_params.detach().clone()
    update(learner, batch, noise, update_actor=False)
    moved = learner.critic_params.detach() - before
    torch.testing.assert_close(
        moved, -learner.config.learning_rate * slope.sign() * (slope.abs() > 0), atol=1e-5, rtol=0.1
    )
    assert torch.equal(actor, learner.actor_params)


def test_actor_and_targets_are_those_of_sac():
    """They have the same step from the same critics, but for those critics' own step."""
    learner, (batch, noise) = make(learning_rate=1e-3), data()
    sac = SAC(learner.config, Layout(2, OBS, ACT))
    sac.init(Rng((0, 1)))
    learner.critic_optimizer.learning_rate = sac.critic_optimizer.learning_rate = 0.0
    for each in (learner, sac):
        update(each, batch, noise)
    assert torch.equal(learner.actor_params, sac.actor_params)


def test_rewards_are_not_looked_at_and_labels_are_places():
    batch, noise = data()
    one, other = make(), make()
    update(one, batch, noise)
    update(other, batch._replace(reward=batch.reward + 5), noise)
    assert torch.equal(one.critic_params, other.critic_params)
    swapped = Batch(*(torch.cat(part.chunk(2, 1)[::-1], 1) for part in batch))
    third = make()
    update(third, swapped, torch.cat(noise.chunk(2, 2)[::-1], 2))
    assert not torch.allclose(one.critic_params, third.critic_params)


def test_the_absorbing_state_has_no_entropy_and_no_action():
    learner, (batch, noise) = make(absorbing="bootstrap"), data(absorbing=True)
    there = is_absorbing(batch.obs)
    assert there.any()
    seen = []
    critic = learner.critic
    learner.critic = lambda params, obs, action: (
        seen.append((obs, action)) or critic(params, obs, action)
    )
    update(learner, batch, noise, update_actor=False)
    for obs, action in seen:
        assert (action[is_absorbing(obs)] == 0).all()
    # V of the absorbing state has no log π in it, so no noise changes it.
    y = learner.target(batch, noise[0])
    to = is_absorbing(batch.next_obs)
    again = learner.target(batch, noise[1])
    assert torch.equal(y[to], again[to])
    assert not torch.equal(y[~to], again[~to])


@pytest.mark.parametrize("changes", [{}, {"temperature": None}, {"primitives": 2}])
def test_it_trains_and_leaves_a_policy_and_no_reward(tiny, random_demonstrations, changes):
    config = tiny.change(reward="iq-learn", **changes)
    run = train(config, (0, 1), random_demonstrations(config.env_id), progress=False)
    assert len(run.policy) == 2
    assert run.reward is None
    assert len(run.rows) == 2 * 2
    assert all(math.isfinite(row.mean_return) for row in run.rows)


def test_members_do_not_influence_one_another(tiny, random_demonstrations):
    config = tiny.change(reward="iq-learn")
    shown = random_demonstrations(config.env_id)
    alone, among = (train(config, seeds, shown, progress=False) for seeds in ((1,), (0, 1)))
    torch.testing.assert_close(alone.policy.params[0], among.policy.params[1])
