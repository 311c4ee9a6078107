import pytest
import torch

from offairl_lite.core import absorbing
from offairl_lite.core.experience import analytic_return
from offairl_lite.core.replay import Batch

# Two episodes: the first terminates at its third step, the second is cut by a time limit.
TERMINATED = torch.tensor([0.0, 0.0, 1.0, 0.0, 0.0])
EPISODES = Batch(
    obs=torch.arange(10.0).view(5, 2),
    pre_tanh=torch.arange(5.0).view(5, 1),
    next_obs=torch.arange(10.0).view(5, 2) + 2,
    reward=torch.arange(5.0),
    terminated=TERMINATED,
)
ABSORBING = [0.0, 0.0, 1.0]


def test_only_a_termination_leads_to_the_absorbing_state():
    batch = absorbing.rewrite(EPISODES)
    assert batch.next_obs[2].tolist() == ABSORBING
    assert absorbing.is_absorbing(batch.next_obs).tolist() == [False, False, True, False, False]
    others = TERMINATED == 0
    assert torch.equal(batch.next_obs[others], absorbing.extend(EPISODES.next_obs)[others])


def test_the_rest_of_a_transition_stays():
    batch = absorbing.rewrite(EPISODES)
    assert torch.equal(batch.obs, absorbing.extend(EPISODES.obs))
    assert not absorbing.is_absorbing(batch.obs).any()
    assert torch.equal(batch.pre_tanh, EPISODES.pre_tanh)
    assert torch.equal(batch.reward, EPISODES.reward)
    # The episode goes on in the absorbing state.
    assert (batch.terminated == 0).all()


def test_one_loop_for_each_termination_and_none_for_a_time_limit():
    loops = absorbing.loops(absorbing.rewrite(EPISODES))
    assert loops.obs.tolist() == loops.next_obs.tolist() == [ABSORBING]
    assert loops.pre_tanh.tolist() == [[0.0]]
    assert loops.reward.tolist() == loops.terminated.tolist() == [0.0]
    cut = EPISODES._replace(terminated=torch.zeros(5))
    assert len(absorbing.loops(absorbing.rewrite(cut)).obs) == 0


@pytest.mark.parametrize("shape", [(3,), (4, 3), (2, 4, 3)])
def test_the_absorbing_state_has_the_shape_and_type_asked_for(shape):
    like = torch.full(shape, 7.0, dtype=torch.float64)
    there = absorbing.absorbing_state(like)
    assert there.dtype == torch.float64
    assert torch.equal(there, torch.tensor(ABSORBING, dtype=torch.float64).expand(shape))
    assert absorbing.is_absorbing(there).all()


def test_the_analytic_return_is_the_sum_of_the_series():
    reward, there, discount = torch.tensor([2.0, -1.0]), torch.tensor([0.5, -3.0]), 0.9
    series = reward + sum(discount**k * there for k in range(1, 400))
    torch.testing.assert_close(analytic_return(reward, there, discount), series)


def test_the_loop_s_fixed_point_makes_bootstrap_and_analytic_agree():
    reward, there, discount = torch.tensor(2.0), torch.tensor(-0.7), 0.9
    q = torch.tensor(0.0)
    for _ in range(500):
        q = there + discount * q
    expected = analytic_return(reward, there, discount)
    torch.testing.assert_close(reward + discount * q, expected)
    # The loop's own analytic return is that fixed point.
    torch.testing.assert_close(analytic_return(there, there, discount), q)


def test_a_constant_adds_as_much_to_a_last_step_as_to_a_life_without_end():
    """What the absorbing state is for: with it, a constant prefers no policy to another."""
    reward, there, discount, c = torch.tensor([2.0, -1.0]), torch.tensor(0.5), 0.9, 3.0
    before = analytic_return(reward, there, discount)
    after = analytic_return(reward + c, there + c, discount)
    torch.testing.assert_close(after - before, torch.full((2,), c / (1 - discount)))
