from dataclasses import FrozenInstanceError, fields, replace
from pathlib import Path

import pytest

from offairl_lite import config
from offairl_lite.ablations.released import RELEASE
from offairl_lite.config import CORRECTED, PAPER, Config, Config, differences

PPO = {"learner": "ppo", "update_every": 100}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"reward": "airl"}, "reward is 'airl'.*implementation-4"),
        ({"generator": "trpo"}, "generator is 'trpo'.*'sac', 'td3', 'ppo'"),
        ({"absorbing": "yes"}, "absorbing is 'yes'.*bootstrap"),
        ({"penalty_on": "f"}, "penalty_on is 'f'"),
        ({"penalty_sides": "both"}, "penalty_sides is 'both'"),
        ({"log_prob_in_reward": False}, "'implementation-4' has no log π to leave out"),
        ({"loss": "mixture", "log_density": "released"}, "set log_density='exact'"),
        ({"reward_sees": ()}, r"reward_sees is \(\); expected indices"),
        ({"reward_sees": (-1, 2)}, r"reward_sees is \(-1, 2\); expected indices"),
        ({"reward_sees": (1,), "ablation": "spectral-norm"}, "for plain networks"),
        ({"reward_sees": (1,), "absorbing": "bootstrap"}, "without the absorbing state"),
        ({"ablation": "bottleneck", "bottleneck": 0.0}, "bottleneck is 0.0"),
        ({"ablation": "bottleneck", "bottleneck": 0.5, "ablation": "spectral-norm"}, "ablation="bottleneck", bottleneck=0.5 and ablation="spectral-norm""),
        (PPO | {"ablation": "bottleneck", "bottleneck": 0.5, "reward": "gan-gcl"}, "gan-gcl judges whole episodes"),
        ({"discount": 1.1}, "discount is 1.1"),
        ({"discriminator_discount": -0.1}, "discriminator_discount is -0.1"),
        ({"target_rate": 2.0}, "target_rate is 2.0"),
        ({"warmup_hold": 0.5}, "warmup_hold is 0.5"),
        ({"update_every": 0}, "update_every is 0"),
        ({"temperature": 0.0}, "temperature is 0.0"),
        ({"total_steps": 100, "warmup_steps": 101}, "warmup_steps is 101, total_steps 100"),
        (
            {"update_every": 300, "total_steps": 200, "warmup_steps": 100},
            "update_every is 300, tot",
        ),
        (PPO | {"total_steps": 200, "warmup_steps": 150}, "update_every is 100, total_steps 200"),
        ({"gradient_penalty": -1.0}, "gradient_penalty is -1.0"),
        ({"hidden": (8, 0)}, r"hidden is \(8, 0\); expected positive"),
        ({"log_std_range": (2.0, -5.0)}, r"log_std_range is \(2.0, -5.0\); expected a lower"),
        ({"learner": "td3"}, "needs log π"),
        ({"learner": "td3", "reward": "gan-gcl"}, "needs log π"),
        ({"reward": "gan-gcl"}, "use learner='ppo'"),
        ({"learner": "ppo"}, "update_every is None; ppo learns from the last"),
        (PPO | {"replay_size": 99}, r"update_every is 100; .* to replay_size \(99\) at most"),
        (PPO | {"temperature": None}, "temperature is None, and ppo"),
        (PPO | {"absorbing": "bootstrap"}, "absorbing='bootstrap' is not for ppo"),
        ({"discriminator_updates": 0}, "discriminator_updates is 0"),
        ({"primitives": 0}, "primitives is 0"),
        ({"primitives": 4, "learner": "td3", "reward": "dac"}, "primitives=4.*'td3'"),
        ({"pretrained": "primitives"}, "carry='primitives', and there are none"),
        ({"pretrained": "policy", "learner": "td3", "reward": "dac"}, "carry='policy' is not for td3"),
        ({"start_steps": -1}, "start_steps is -1"),
        ({"start_steps": 100, "warmup_steps": 100}, "start_steps is 100; expected .* the 100 warm"),
        (PPO | {"start_steps": 5}, "start_steps is 5, and ppo"),
        (
            {"start_steps": 5, "loss": "mixture"},
            "start_steps is 5, and loss='mixture' counts the steps of a guide",
        ),
        (PPO | {"centre_reward": True}, "centre_reward=True is for replay"),
        ({"fixed_primitives": True}, "there are none: set primitives"),
        ({"absorbing": "bootstrap", "reward": "environment"}, "absorbing='bootstrap'"),
        ({"absorbing": "analytic", "discount": 1}, "discount below 1"),
    ]
    + [({name: bad}, name) for name in config._POSITIVE for bad in (0, -1, float("nan"))],
)
def test_what_makes_no_sense_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        CORRECTED.change(**change)


@pytest.mark.parametrize(
    "reward", ["dac", "gail-survival", "gail-termination", "environment", "frozen"]
)
def test_td3_serves_the_rewards_without_log_prob(reward):
    assert CORRECTED.change(learner="td3", reward=reward).learner.kind == "td3"


@pytest.mark.parametrize(
    ("reward", "learned"),
    [
        ("implementation-1", True),
        ("dac", True),
        ("gail-survival", True),
        ("environment", False),
        ("frozen", False),
    ],
)
def test_which_rewards_are_learned(reward, learned):
    assert Config.of(reward=reward).learns_reward is learned


def test_a_configuration_cannot_be_changed():
    with pytest.raises(FrozenInstanceError):
        CORRECTED.discount = 0.5


def test_differences_are_the_fields_that_differ_with_both_values():
    assert differences(CORRECTED, CORRECTED) == {}
    changed = CORRECTED.change(discount=0.5, hidden=(8,))
    assert differences(CORRECTED, changed) == {
        "hidden": ((400, 300), (8,)),
        "discount": (0.99, 0.5),
    }


def test_presets_are_those_of_the_paper_and_its_code():
    assert differences(CORRECTED, PAPER) == {"normalise": (True, False)}
    assert PAPER.learner.hidden == (400, 300)
    assert PAPER.discriminator.reward_hidden == PAPER.discriminator.shaping_hidden == (100, 100)
    assert PAPER.discriminator.activation == "tanh"
    released = {name: pair[1] for name, pair in differences(PAPER, RELEASE).items()}
    assert released == {
        "hidden": (256, 256),
        "temperature": None,
        "log_std_range": (-20.0, 2.0),
        "log_density": "released",
        "composition": "released",
        "loss": "released",
        "discriminator_discount": 0.9,
        "reward_hidden": (256, 256),
        "discriminator_activation": "relu",
        "ablation": "penalty-on-probability",
    }


def test_every_field_is_explained():
    # dataclasses drop the docstrings of fields; the source has them.
    source = Path(config.__file__).read_text("utf-8")
    for field in fields(Config):
        after = source.split(f"\n    {field.name}: ", 1)[1].split("\n    ", 2)
        assert after[1].startswith('"""'), field.name
