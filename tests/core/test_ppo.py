"""PPO: its losses by hand and by brute force, and that members do not influence one another."""

import pytest
import torch

from offairl_lite.config import CORRECTED
from offairl_lite.core.ppo import PPO, Rollout, clipped_surrogate, episode_ends, gae
from offairl_lite.core.replay import Batch
from offairl_lite.core.rng import Rng
from offairl_lite.core.shapes import Layout

OBS, ACT, T = 3, 2, 12
CONFIG = CORRECTED.change(
    learner="ppo",
    reward="environment",
    train_every=T,
    temperature=0.01,
    hidden=(8, 8),
    learning_rate=1e-2,
)


def make(seeds=(0, 1), **changes):
    """A learner whose observations are scaled."""
    learner = PPO(CONFIG.change(**changes).learner, Layout(len(seeds), OBS, ACT))
    learner.init(Rng(seeds))
    return learner


def log_prob(learner, block):
    return learner.log_prob(learner.actor_params, block.obs, block.pre_tanh)


def data(learner, seeds=(0, 1)):
    """A block of the learner's own actions, with an end in the middle; rewards; noise."""
    streams = Rng([100 + seed for seed in seeds])
    path = streams.normal(T + 1, OBS)
    obs, next_obs = path[:, :-1], path[:, 1:].clone()
    next_obs[:, T // 2] += 1
    noise, reward = streams.normal(T, ACT), streams.normal(T)
    u = learner.actor.sample(learner.actor_params, obs, noise)[0].detach()
    block = Batch(obs, u, next_obs, torch.zeros_like(reward), torch.zeros_like(reward))
    return block, reward, streams.normal(T, ACT)


def row(*values):
    return torch.tensor([values], dtype=torch.float64)


# Generalised advantage estimation.


def brute_force(reward, value, next_value, terminated, ends, discount, decay):
    """The definition, for one member: an average of k-step advantages, geometrically weighted.

    A_t = (1 - λ) Σ_k λ^(k-1) A_t^(k), where all weight that is left is on the last step known.
    """
    advantages = []
    for t in range(len(reward)):
        total, weight, paid, factor, k = 0.0, 1.0, 0.0, 1.0, t
        while True:
            paid += factor * reward[k]
            factor *= discount
            k_step = paid + factor * (1 - terminated[k]) * next_value[k] - value[t]
            last = ends[k] or terminated[k]
            share = weight if last else weight * (1 - decay)
            total, weight, k = total + share * k_step, weight * decay, k + 1
            if last:
                break
        advantages.append(total)
    return torch.stack(advantages)


@pytest.mark.parametrize(("discount", "decay"), [(0.9, 0.0), (0.9, 0.7), (1.0, 0.95), (0.99, 1.0)])
def test_advantages_are_the_weighted_k_step_advantages(discount, decay):
    streams = Rng((0, 1, 2))
    reward, value, next_value = (streams.normal(T).double() for _ in range(3))
    # Within an episode the next state is the next step's.
    next_value[:, :-1] = value[:, 1:]
    ends = streams.uniform(T) < 0.2
    terminated = (ends & (streams.uniform(T) < 0.5)).double()
    next_value = torch.where(ends, streams.normal(T).double(), next_value)
    ends[:, -1] = True
    assert ends[:, :-1].any()
    assert terminated.any()
    advantage = gae(reward, value, next_value, terminated, ends, discount, decay)
    for i in range(3):
        given = (x[i] for x in (reward, value, next_value, terminated, ends))
        torch.testing.assert_close(advantage[i], brute_force(*given, discount, decay))


def test_advantages_by_hand_a_termination_has_no_next_value_and_a_time_limit_has():
    reward, value, next_value = row(1.0, 1.0), row(0.0, 10.0), row(10.0, 20.0)
    never, ends = row(0.0, 0.0), torch.tensor([[False, True]])

    def of(terminated, ends):
        return gae(reward, value, next_value, terminated, ends, 0.5, 0.5).tolist()

    # δ = 1 + 5 - 0 and 1 + 10 - 10; γ λ = 1/4.
    assert of(never, ends) == [[6 + 0.25 * 1, 1]]
    assert of(row(0.0, 1.0), ends) == [[6 + 0.25 * -9, -9]]
    # Two episodes: the first is cut off, its next state still has its value.
    assert of(never, torch.tensor([[True, True]])) == [[6, 1]]
    # The first is over for good.
    assert of(row(1.0, 0.0), ends) == [[1, 1]]


def test_an_episode_ends_where_the_next_step_begins_somewhere_else():
    obs = torch.tensor([[[0.0, 0.0], [1.0, 0.0], [0.0, 0.0]]])
    next_obs = torch.tensor([[[1.0, 0.0], [1.0, 1.0], [1.0, 0.0]]])
    # The block's end is an end as well.
    assert episode_ends(obs, next_obs).tolist() == [[False, True, True]]


# Losses.


def test_the_surrogate_by_hand():
    old = torch.zeros(1, 4, dtype=torch.float64)
    ratio, advantage = row(2.0, 2.0, 0.5, 0.5), row(1.0, -1.0, 1.0, -1.0)
    # Gains stop at 1 ± 0.2; losses do not.
    expected = -(1.2 - 2.0 + 0.5 - 0.8) / 4
    loss = clipped_surrogate(ratio.log(), old, advantage, 0.2)
    torch.testing.assert_close(loss.item(), expected)


def test_the_surrogate_is_summed_over_members_and_averaged_over_the_batch():
    ones, zeros = torch.ones(3, 5), torch.zeros(3, 5)
    assert clipped_surrogate(zeros, zeros, ones, 0.2).item() == -3


def test_the_surrogate_has_the_gradient_of_finite_differences():
    streams = Rng((0, 1))
    log_prob, old, advantage = (streams.normal(6).double() for _ in range(3))
    log_prob.requires_grad_()
    assert torch.autograd.gradcheck(
        lambda x: clipped_surrogate(x, old, advantage, 0.2), (log_prob,)
    )


def test_at_the_old_policy_the_surrogate_s_gradient_is_the_policy_gradient():
    streams = Rng((0, 1))
    old, advantage = streams.normal(6).double(), streams.normal(6).double()
    log_prob = old.clone().requires_grad_()
    gradient = torch.autograd.grad(clipped_surrogate(log_prob, old, advantage, 0.2), log_prob)[0]
    torch.testing.assert_close(gradient, -advantage / 6)


def test_beyond_the_clip_there_is_nothing_to_gain():
    advantage = row(1.0, 1.0, -1.0, -1.0)
    log_prob = row(0.3, -0.3, 0.3, -0.3).requires_grad_()
    loss = clipped_surrogate(log_prob, torch.zeros_like(advantage), advantage, 0.2)
    gradient = torch.autograd.grad(loss, log_prob)[0]
    assert (gradient != 0).tolist() == [[False, True, True, False]]


# The learner.


def test_what_a_block_teaches_is_that_of_the_equations():
    learner = make()
    block, reward, _ = data(learner)
    block.terminated[0, T // 2] = 1
    rollout = learner.rollout(block._replace(reward=reward))
    obs, next_obs = block.obs, block.next_obs
    value, next_value = (
        learner.critic(learner.critic_params, x).squeeze(-1).detach() for x in (obs, next_obs)
    )
    ends = torch.zeros(2, T, dtype=torch.bool)
    ends[:, [T // 2, T - 1]] = True
    advantage = gae(reward, value, next_value, block.terminated, ends, 0.99, 0.95)
    torch.testing.assert_close(rollout.target, advantage + value)
    torch.testing.assert_close(rollout.advantage.mean(1), torch.zeros(2), rtol=0, atol=1e-6)
    torch.testing.assert_close(rollout.advantage.std(1), torch.ones(2))
    order = [x.argsort(1) for x in (rollout.advantage, advantage)]
    assert torch.equal(*order)
    torch.testing.assert_close(rollout.log_prob, log_prob(learner, block))
    assert torch.equal(rollout.obs, obs)
    assert not any(x.requires_grad for x in rollout)


def test_minibatches_take_the_same_steps_of_everything():
    steps = torch.arange(5.0).expand(2, 5) + torch.tensor([[0.0], [10.0]])
    rollout = Rollout(*(2 * [steps.unsqueeze(-1)] + 3 * [steps]))
    some = rollout.rows(torch.tensor([[4, 0], [1, 1]]))
    for part in some:
        assert part.flatten(1).tolist() == [[4, 0], [11, 11]]


def test_an_update_raises_the_probability_of_what_went_well():
    learner = make(learning_rate=1e-3)
    block, reward, noise = data(learner)
    rollout = learner.rollout(block._replace(reward=reward))
    learner.update(rollout, noise)
    change = log_prob(learner, block) - rollout.log_prob
    assert ((change * rollout.advantage).mean(1) > 0).all()


def test_the_value_network_learns_its_targets():
    learner = make()
    block, reward, noise = data(learner)
    rollout = learner.rollout(block._replace(reward=reward))
    losses = [learner.update(rollout, noise)["critic_loss"] for _ in range(300)]
    assert (losses[-1] < 0.1 * losses[0]).all()


def test_where_nothing_else_is_to_gain_the_entropy_rises():
    learner = make(temperature=0.1)
    block, reward, noise = data(learner)
    rollout = learner.rollout(block._replace(reward=reward))._replace(advantage=torch.zeros(2, T))

    def entropy():
        return -learner.actor.sample(learner.actor_params, rollout.obs, noise)[1].mean(1).detach()

    before = entropy()
    for _ in range(50):
        learner.update(rollout, noise)
    assert (entropy() > before + 0.1).all()


def test_the_first_policy_prefers_no_direction():
    learner = make()
    obs = data(learner)[0].obs
    mean, log_std = learner.actor.distribution(learner.actor_params, obs)
    assert mean.abs().max() < 0.05
    low, high = CONFIG.learner.log_std_range
    torch.testing.assert_close(log_std, torch.full_like(mean, (low + high) / 2), rtol=0, atol=0.2)


def test_a_reward_that_comes_later_is_credited_to_what_led_to_it():
    """Two steps: the first action decides what the second is paid.

    Over seeds 0-9, after 40 blocks, the first action was 0.97 at least.
    """
    seeds, episodes = (0, 1, 2), 50
    learner, streams = make(seeds, log_std_range=(-2.0, 1.0), learning_rate=3e-3), Rng(seeds)
    clock = torch.tensor([0.0, 1.0]).repeat(episodes)
    for _ in range(40):
        obs = torch.zeros(3, 2 * episodes, OBS)
        obs[..., 0] = clock
        next_obs = obs.clone()
        next_obs[..., 0] += 1
        noise = streams.normal(2 * episodes, ACT)
        u = learner.actor.sample(learner.actor_params, obs, noise)[0].detach()
        reward = torch.zeros(3, 2 * episodes)
        reward[:, 1::2] = torch.tanh(u[:, ::2, 0])
        ended = clock.expand_as(reward)
        rollout = learner.rollout(Batch(obs, u, next_obs, reward, ended))
        for _ in range(5):
            learner.update(rollout, streams.normal(2 * episodes, ACT))
    mode = learner.actor.mode(learner.actor_params, obs[:, :1])
    assert (mode[..., 0] > 0.9).all()


def train(seeds, change=lambda block, reward: None):
    learner = make(seeds)
    block, reward, noise = data(learner, seeds)
    change(block, reward)
    for _ in range(3):
        rollout = learner.rollout(block._replace(reward=reward))
        for half in (slice(0, T // 2), slice(T // 2, T)):
            index = torch.arange(T)[half].expand(len(seeds), -1)
            learner.update(rollout.rows(index), noise[:, half])
    return torch.cat([learner.actor_params, learner.critic_params], 1).detach()


def test_training_together_is_training_alone():
    seeds = (0, 1, 2, 3, 4)
    together = train(seeds)
    for i, seed in enumerate(seeds):
        torch.testing.assert_close(together[i : i + 1], train((seed,)), rtol=1e-4, atol=1e-5)


def test_a_member_s_data_changes_no_other_member():
    def change(block, reward):
        reward[1, ::2] -= 3
        block.pre_tanh[1] += 0.5

    one, other = train((0, 1, 2)), train((0, 1, 2), change=change)
    assert not torch.equal(one[1], other[1])
    assert torch.equal(one[[0, 2]], other[[0, 2]])
