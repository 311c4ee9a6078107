"""Settings: what makes no sense is refused by name, and types are checked as strictly as ranges."""

import math
from dataclasses import FrozenInstanceError, fields
from pathlib import Path

import numpy as np
import pytest

import other_bounds
from offairl_lite.ablations import released
from offairl_lite.ablations.released import RELEASE
from offairl_lite.config import (
    CORRECTED,
    PAPER,
    Config,
    DiscriminatorConfig,
    Frozen,
    Labels,
    PPOConfig,
    SACConfig,
    Schedule,
    TD3Config,
    differences,
    flat_settings,
    groups,
)
from offairl_lite.config.settings import SYNONYMS, wanted

PPO = {"learner": "ppo", "train_every": 100, "temperature": 0.2}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"reward": "airl"}, "reward is 'airl'; expected one of .*'logit-sa'.*'r-s'"),
        ({"learner": "trpo"}, "learner is 'trpo'; expected one of .*'sac'"),
        ({"ablation": "both"}, "ablation is 'both'; expected one of .*'one-sided'.*or None"),
        ({"absorbing": "yes"}, "absorbing is 'yes'.*bootstrap"),
        ({"loss": "f"}, "loss is 'f'; expected one of"),
        ({"log_prob_in_reward": False}, "'r-s' has no log π to leave out"),
        ({"reward_sees": ()}, r"reward_sees is \(\); expected a tuple, .*none twice"),
        ({"reward_sees": (0, 0)}, r"reward_sees is \(0, 0\); expected a tuple, .*none twice"),
        ({"reward_sees": (-1, 2)}, r"reward_sees is \(-1, 2\); expected a tuple"),
        ({"reward_sees": (1,), "ablation": "spectral-norm"}, "sees all of an"),
        ({"reward_sees": (1,), "ablation": "bottleneck"}, "sees all of an"),
        ({"ablation": "bottleneck", "bottleneck": 0.0}, "bottleneck is 0.0"),
        ({"bottleneck": 0.5}, "bottleneck has no use with learner='sac'"),
        ({"discount": 1.1}, r"discount is 1.1; expected a number in \[0, 1\]"),
        ({"discriminator_discount": -0.1}, "discriminator_discount is -0.1"),
        ({"target_rate": 2.0}, "target_rate is 2.0"),
        ({"random_hold": 0.5}, "random_hold is 0.5"),
        ({"train_every": 0}, "train_every is 0; expected a whole number of at least 1, or None"),
        ({"temperature": 0.0}, "temperature is 0.0; expected a number above 0, or None"),
        ({"total_steps": 100, "learning_starts": 101}, "learning_starts is 101, total_steps 100"),
        (
            {"train_every": 300, "total_steps": 200, "learning_starts": 100},
            "train_every is 300, tot",
        ),
        (PPO | {"total_steps": 200, "learning_starts": 150}, "train_every is 100, total_steps 200"),
        ({"gradient_penalty": -1.0}, "gradient_penalty is -1.0; expected a number of at least 0"),
        ({"hidden": (8, 0)}, r"hidden is \(8, 0\); expected a tuple"),
        ({"log_std_range": (2.0, -5.0)}, r"log_std_range is \(2.0, -5.0\); .* in ascending"),
        ({"learner": "td3"}, "needs log π"),
        ({"learner": "ppo"}, "train_every is None; learner ppo learns from the last"),
        (PPO | {"replay_size": 99}, r"train_every is 100; .* to replay_size \(99\) at most"),
        (PPO | {"temperature": None}, "temperature is None; expected a number above 0"),
        (PPO | {"absorbing": "bootstrap"}, "absorbing='bootstrap' is not for ppo"),
        (PPO | {"pretrained": "primitives"}, "pretrained is 'primitives'"),
        (PPO | {"centre_reward": True}, "centre_reward has no use with learner='ppo'"),
        (PPO | {"guide_steps": 5}, "guide_steps is 5, and ppo"),
        ({"discriminator_updates": 0}, "discriminator_updates is 0"),
        ({"primitives": 0}, "primitives is 0"),
        (
            {"primitives": 4, "learner": "td3", "reward": "dac"},
            "primitives has no use .*'td3'",
        ),
        ({"pretrained": "primitives"}, "pretrained='primitives', and there are none"),
        ({"pretrained": "policy", "learner": "td3", "reward": "dac"}, "pretrained has no use"),
        ({"guide_steps": -1}, "guide_steps is -1"),
        (
            {"guide_steps": 100, "learning_starts": 100},
            "guide_steps is 100; expected less than learning_starts, 100",
        ),
        (
            {"guide_steps": 5, "loss": "airl-mixture"},
            "loss='airl-mixture' counts the steps of a",
        ),
        ({"fixed_primitives": True}, "there are none: set primitives"),
        ({"absorbing": "bootstrap", "reward": "environment"}, "absorbing='bootstrap'"),
        ({"absorbing": "analytic", "discount": 1}, "discount below 1"),
        ({"reward": "frozen", "gradient_penalty": 1.0}, "gradient_penalty has no use .*'frozen'"),
        (
            {"reward": "frozen", "ablation": "one-sided"},
            "ablation has no use .*'frozen', ablation='one-sided': leave it out",
        ),
        ({"reward": "sqil", "learner": "td3"}, "reward 'sqil' is for SAC's critics: use .*'sac'"),
        (PPO | {"reward": "iq-learn"}, "reward 'iq-learn' is for SAC's critics: use .*'sac'"),
        ({"reward": "sqil", "absorbing": "analytic"}, "'sqil' gives .*: set absorbing='bootstrap'"),
        ({"reward": "sqil", "gradient_penalty": 1.0}, "gradient_penalty has no use .*'sqil'"),
        ({"reward": "iq-learn", "loss": "log-ratio"}, "loss has no use with .*'iq-learn'"),
        ({"reward": "iq-learn", "ablation": "one-sided"}, "ablation has no use with .*'iq-learn'"),
        ({"reward": "iq-learn", "reward_scale": 2.0}, "reward_scale is 2.0 and .* pays no reward"),
        ({"reward": "iq-learn", "centre_reward": True}, "centre_reward True, and iq-learn pays no"),
        (
            {"temprature": 1.0},
            "no setting 'temprature'; did you mean temperature.*; there are: .*temperature",
        ),
    ],
)
def test_what_makes_no_sense_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        CORRECTED.change(**change)


WRONG = {
    "a whole number": [2.5, 0.0, "3", True, math.nan, math.inf, [1], np.float64(1.0)],
    "a number": ["1", True, math.nan, math.inf, -math.inf, [0.5], 1j],
    "True or False": ["no", 0, 1, "True", None],
    "a text": [None, 3, ("a",)],
    "one of": [0, None, True, "", "nothing of the kind", ("none",)],
    "a tuple": [64, "64", (64.5,), (True,), ("64",), {64}],
    "2 numbers": [(1.0,), (0, 1, 2), -5.0, ("a", "b")],
}


def wrong_values():
    for name, (hint, *_) in flat_settings().items():
        words = wanted(hint)
        for start, values in WRONG.items():
            if words.startswith(start):
                optional = words.endswith("or None")
                for value in values:
                    if not (value is None and optional):
                        yield name, value


@pytest.mark.parametrize(("name", "value"), list(wrong_values()))
def test_a_value_of_another_type_is_refused_by_name(name, value):
    of = {"ablation": "bottleneck"} if name.startswith("bottleneck") else {}
    if name in ("log_density", "composition"):
        of = {"learner": "sac-released"}
    with pytest.raises(ValueError, match=f"^{name} is .*; expected "):
        Config.of(**{**of, name: value})


def test_numpy_s_numbers_are_numbers():
    config = Config.of(
        total_steps=np.int64(20_000),
        discount=np.float32(0.5),
        hidden=[np.int32(8)],
        normalise=np.True_,
    )
    assert (config.total_steps, config.learner.discount, config.learner.hidden) == (
        20_000,
        0.5,
        (8,),
    )
    assert [type(x) for x in (config.total_steps, config.learner.discount)] == [int, float]
    assert config.schedule.normalise is True


@pytest.mark.parametrize(
    "reward", ["dac", "gail-survival", "gail-termination", "environment", "frozen"]
)
def test_td3_serves_the_rewards_without_log_prob(reward):
    assert CORRECTED.change(learner="td3", reward=reward).learner == TD3Config()


def test_earlier_names_and_the_paper_s_are_understood():
    now = Config.of(learning_starts=50, random_hold=3.0, train_every=20, guide_steps=0)
    old = {"warmup_steps": 50, "warmup_hold": 3.0, "update_every": 20, "start_steps": 0}
    assert Config.of(**old) == CORRECTED.change(**old) == now
    assert set(now.flat()).isdisjoint(old)
    assert [getattr(now.schedule, name) for name in old] == [*old.values()]
    for loss, meant in SYNONYMS["loss"].items():
        assert Config.of(loss=loss) == Config.of(loss=meant)
    for reward, meant in SYNONYMS["reward"].items():
        assert Config.of(reward=reward).reward == meant
    with pytest.raises(ValueError, match="learning_starts is -1; expected a whole number"):
        Config.of(warmup_steps=-1)
    with pytest.raises(AttributeError, match=r"Schedule has no warmup$"):
        _ = now.schedule.warmup


@pytest.mark.parametrize(
    ("reward", "discriminator"),
    [
        ("logit-sa", DiscriminatorConfig("logit-sa")),
        ("dac", DiscriminatorConfig("dac")),
        ("gail-survival", DiscriminatorConfig("gail-survival")),
        ("environment", None),
        ("frozen", Frozen()),
        ("sqil", Labels("sqil")),
        ("iq-learn", Labels("iq-learn")),
    ],
)
def test_a_reward_has_a_discriminator_if_it_is_learned(reward, discriminator):
    config = Config.of(reward=reward)
    assert config.discriminator == discriminator
    assert config.reward == reward
    assert config.imitates is (reward not in ("environment", "frozen"))


def test_a_configuration_cannot_be_changed():
    with pytest.raises(FrozenInstanceError):
        CORRECTED.learner.discount = 0.5


@pytest.mark.parametrize(
    "flat",
    [
        {},
        PPO,
        {"learner": "td3", "reward": "dac"},
        {"reward": "environment"},
        {"reward": "frozen", "pretrained": "policy"},
        {"reward": "sqil", "absorbing": "bootstrap", "reward_scale": 2.0},
        {"reward": "iq-learn", "primitives": 4},
        {"ablation": "bottleneck", "bottleneck": 0.25},
        {"ablation": "spectral-norm"},
        {"learner": "sac-released", "primitives": 4},
    ],
)
def test_the_flat_view_has_everything(flat):
    config = Config.of(**flat)
    assert Config.of(**config.flat()) == config
    assert flat.items() <= config.flat().items()
    assert config.change() == config


def test_groups_and_flat_names_mean_the_same():
    assert Config.of(env_id="Hopper-v5", hidden=(8,), discriminator_discount=0.5) == Config(
        Schedule(env_id="Hopper-v5"), SACConfig(hidden=(8,)), DiscriminatorConfig(discount=0.5)
    )


def test_another_learner_or_reward_keeps_what_it_has_a_use_for():
    config = CORRECTED.change(hidden=(8,), temperature=None, gradient_penalty=1.0)
    td3 = config.change(learner="td3", reward="dac")
    assert td3.learner == TD3Config(hidden=(8,))
    assert td3.discriminator.gradient_penalty == 1.0
    assert config.change(reward="environment").learner == config.learner
    assert config.change(**PPO).learner == PPOConfig(hidden=(8,), temperature=0.2)


def test_differences_are_the_settings_that_differ_with_both_values():
    assert differences(CORRECTED, CORRECTED) == {}
    changed = CORRECTED.change(discount=0.5, hidden=(8,))
    assert differences(CORRECTED, changed) == {
        "hidden": ((400, 300), (8,)),
        "discount": (0.99, 0.5),
        "discriminator_discount": (0.99, 0.5),
    }
    frozen = differences(CORRECTED, CORRECTED.change(reward="frozen"))
    assert frozen["reward"] == ("r-s", "frozen")
    assert frozen["gradient_penalty"] == (10.0, None)


def test_presets_are_those_of_the_paper_and_its_code():
    assert differences(CORRECTED, PAPER) == {"normalise": (True, False)}
    assert PAPER.learner.hidden == (400, 300)
    assert PAPER.discriminator.reward_hidden == PAPER.discriminator.shaping_hidden == (100, 100)
    assert PAPER.discriminator.activation == "tanh"
    changed = {name: pair[1] for name, pair in differences(PAPER, RELEASE).items()}
    assert changed == {
        "learner": "sac-released",
        "hidden": (256, 256),
        "temperature": None,
        "log_std_range": (-20.0, 2.0),
        "log_density": "released",
        "composition": "released",
        "loss": "log-ratio",
        "discriminator_discount": 0.9,
        "reward_hidden": (256, 256),
        "discriminator_activation": "relu",
        "ablation": "penalty-on-probability",
    }


@pytest.mark.parametrize(
    ("module", "kind"),
    [
        *(
            (groups, kind)
            for kind in (Schedule, SACConfig, TD3Config, PPOConfig, DiscriminatorConfig)
        ),
        (other_bounds, other_bounds.BottleneckConfig),
        (other_bounds, other_bounds.OneSidedConfig),
        (released, released.ReleasedSACConfig),
    ],
)
def test_every_setting_is_explained(module, kind):
    # dataclasses drop the docstrings of fields; the source has them.
    source = "\n".join(Path(m.__file__).read_text("utf-8") for m in (groups, module))
    for field in fields(kind):
        after = source.split(f"\n    {field.name}: ", 1)[1].split("\n    ", 2)
        assert after[1].startswith('"""'), field.name
