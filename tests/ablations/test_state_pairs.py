"""State-only DAC judges (s, s'), and nothing else."""

import pytest
import torch
from discriminators import CONFIGS, data, make, seen

from offairl_lite.core.loop import train
from offairl_lite.core.rewards import dac, gail_survival


def test_its_logit_is_a_function_of_both_states_alone():
    discriminator, (batch, other, *_) = make(CONFIGS["state pairs"]), data()
    logit = discriminator.f(seen(discriminator, batch))
    moved = batch._replace(pre_tanh=other.pre_tanh)
    torch.testing.assert_close(discriminator.f(seen(discriminator, moved)), logit, rtol=0, atol=0)
    for part in ("obs", "next_obs"):
        changed = batch._replace(**{part: getattr(other, part)})
        assert (discriminator.f(seen(discriminator, changed)) != logit).all()
    scaled = batch.obs, batch.next_obs
    x = torch.cat(scaled, -1)
    expected = discriminator.reward_net(discriminator.reward_params, x).squeeze(-1)
    torch.testing.assert_close(logit, expected)


@pytest.mark.parametrize(("name", "form"), [("dac", dac), ("gail-survival", gail_survival)])
def test_its_reward_is_that_of_its_logit(name, form):
    discriminator, batch = make(CONFIGS["state pairs"].change(reward=name)), data()[0]
    logit = discriminator.f(seen(discriminator, batch)).detach()
    torch.testing.assert_close(discriminator.reward(batch, None), form(logit))


def test_rewards_with_a_form_of_their_own_are_refused():
    with pytest.raises(ValueError, match="reward 'r-s' has a form of its own"):
        CONFIGS["state pairs"].change(reward="r-s")


def test_it_trains_and_leaves_a_policy_and_no_reward(tiny, random_demonstrations):
    config = tiny.change(reward="dac", ablation="state-pairs", absorbing="bootstrap")
    run = train(config, (0, 1), random_demonstrations(config.env_id), progress=False)
    assert len(run.policy) == 2
    assert run.reward is None
    assert len(run.rows) == 2 * 2
    with pytest.raises(ValueError, match=r"reward_sees is \(0,\), .*sees all of an observation"):
        config.change(absorbing="none", reward_sees=(0,))
