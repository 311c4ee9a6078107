import pytest
import torch

from offairl_lite.core.rewards import (
    IMPLEMENTATIONS,
    OF_LOGIT,
    dac,
    gail_survival,
    gail_termination,
    log_odds,
)

LOGIT = torch.linspace(-20, 20, 41, dtype=torch.float64)
D = torch.sigmoid(LOGIT)


@pytest.mark.parametrize(
    ("number", "state_only", "reward_is_logit"),
    [(1, False, True), (2, True, True), (3, False, False), (4, True, False)],
)
def test_the_paper_s_implementations(number, state_only, reward_is_logit):
    assert IMPLEMENTATIONS[f"implementation-{number}"] == (state_only, reward_is_logit)


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
