from dataclasses import replace

import pytest
import torch

from offairl_lite.config import CORRECTED
from offairl_lite.core.networks import Normaliser, StackedMLP
from offairl_lite.core.rewards import (
    IMPLEMENTATIONS,
    OF_LOGIT,
    Reward,
    dac,
    gail_survival,
    gail_termination,
    log_odds,
)
from offairl_lite.core.rng import Rng

LOGIT = torch.linspace(-20, 20, 41, dtype=torch.float64)
D = torch.sigmoid(LOGIT)


@pytest.mark.parametrize(
    ("number", "state_only", "reward_is_logit"),
    [(1, False, True), (2, True, True), (3, False, False), (4, True, False)],
)
def test_the_paper_s_implementations(number, state_only, reward_is_logit):
    reward = CORRECTED.change(reward=f"implementation-{number}").reward
    assert IMPLEMENTATIONS[reward] == (state_only, reward_is_logit)


def test_there_are_four():
    assert len(IMPLEMENTATIONS) == 4


def test_log_odds_are_those_of_the_airl_discriminator():
    f = torch.tensor([-2.0, 0.0, 3.0], dtype=torch.float64)
    density = torch.tensor([0.3, 1.0, 4.0], dtype=torch.float64)
    d = f.exp() / (f.exp() + density)
    torch.testing.assert_close(log_odds(f, density.log()), d.log() - (1 - d).log())


def test_dac_pays_log_odds_of_either_sign():
    torch.testing.assert_close(dac(LOGIT), D.log() - (1 - D).log())
    assert dac(LOGIT).min() < 0 < dac(LOGIT).max()


def test_gail_s_two_signs():
    torch.testing.assert_close(gail_survival(LOGIT), -(1 - D).log())
    torch.testing.assert_close(gail_termination(LOGIT), D.log())
    assert (gail_survival(LOGIT) > 0).all()
    assert (gail_termination(LOGIT) < 0).all()


@pytest.mark.parametrize("reward", OF_LOGIT.values(), ids=OF_LOGIT)
def test_rewards_of_a_certain_discriminator_are_finite_and_rise_with_the_logit(reward):
    values = reward(torch.tensor([-1000.0, -1.0, 1.0, 1000.0]))
    assert values.isfinite().all()
    assert (values.diff() >= 0).all()
    assert values[-1] > values[0]


# Frozen rewards.

OBS, ACT = 3, 2


def frozen(state_only=False, seeds=(0, 1)):
    net = StackedMLP((OBS if state_only else OBS + ACT, 6, 1), "tanh")
    normaliser = Normaliser(Rng(seeds).normal(1, OBS), 1 + Rng(seeds).uniform(1, OBS))
    return Reward("Task-v0", net, state_only, Rng(seeds).normal(net.num_params), normaliser)


def steps(seeds=(4, 5)):
    """Observations and actions of four steps."""
    streams = Rng(seeds)
    return streams.normal(4, OBS), torch.tanh(streams.normal(4, ACT))


@pytest.mark.parametrize("state_only", [True, False])
def test_a_frozen_reward_is_its_network_on_scaled_observations(state_only):
    reward, (obs, action) = frozen(state_only), steps()
    scaled = (obs - reward.normaliser.mean) / reward.normaliser.std
    x = scaled if state_only else torch.cat([scaled, action], -1)
    assert torch.equal(reward(obs, action), reward.net(reward.params, x).squeeze(-1))


def test_a_frozen_reward_comes_back_from_a_file(tmp_path):
    reward, (obs, action) = frozen(), steps()
    reward.save(tmp_path / "reward.safetensors")
    loaded = Reward.load(tmp_path / "reward.safetensors")
    assert torch.equal(loaded(obs, action), reward(obs, action))
    assert (loaded.env_id, loaded.state_only) == ("Task-v0", False)
    assert (loaded.net, len(loaded)) == (reward.net, 2)


def test_members_of_a_frozen_reward_are_rewards():
    reward, (obs, action) = frozen(), steps()
    expected = reward(obs, action)
    torch.testing.assert_close(reward.member(1)(obs[1:], action[1:]), expected[1:])
    swapped = reward.member(1, 0)(obs.flip(0), action.flip(0))
    torch.testing.assert_close(swapped, expected.flip(0))


def test_a_reward_takes_the_observations_of_the_task():
    """One that was learned with absorbing states, which here are told by the last number."""
    reward, (obs, action) = frozen(), steps()
    obs[..., -1] = 0
    assert torch.equal(reward(obs[..., :-1], action), reward(obs, action))
    with pytest.raises(ValueError, match=r"the reward of .* sees . numbers, .* it was given"):
        reward(obs[..., :-2], action)


def test_a_reward_of_state_and_action_needs_both():
    with pytest.raises(ValueError, match=r"is r\(s, a\): give it the actions, too"):
        frozen()(steps()[0])


def test_a_file_with_weights_of_another_shape_is_no_reward(tmp_path):
    reward = frozen()
    replace(reward, params=reward.params[:, 1:]).save(tmp_path / "cut")
    with pytest.raises(ValueError, match=r"cut .*: params is .* \(2, \d+\); expected "):
        Reward.load(tmp_path / "cut")
