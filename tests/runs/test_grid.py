import pytest

from offairl_lite.config import CORRECTED
from offairl_lite.runs.grid import grid


def test_a_grid_is_the_product_of_its_values():
    points = grid(CORRECTED, ["reward=r-sa,dac", "temperature=0.1,none"])
    assert list(points) == [
        "reward=r-sa,temperature=0.1",
        "reward=r-sa,temperature=none",
        "reward=dac,temperature=0.1",
        "reward=dac,temperature=none",
    ]
    assert points["reward=dac,temperature=0.1"] == CORRECTED.change(reward="dac", temperature=0.1)
    assert grid(CORRECTED, []) == {"": CORRECTED}


@pytest.mark.parametrize(
    ("field", "value", "text"),
    [
        ("hidden", (400, 300), "400x300"),
        ("hidden", (64,), "64"),
        ("log_std_range", (-5.0, 2.0), "-5.0x2.0"),
        ("learning_rate", 1e-05, "1e-05"),
        ("normalise", False, "false"),
        ("train_every", None, "none"),
        ("train_every", 1000, "1000"),
        ("absorbing", "none", "none"),
        ("env_id", "Pendulum-v1", "Pendulum-v1"),
        ("loss", "released", "log-ratio"),
        ("ablation", "penalty-on-probability", "penalty-on-probability"),
        ("ablation", None, "none"),
        ("reward_sees", (0, 1), "0x1"),
    ],
)
def test_a_value_is_written_as_it_was_given(field, value, text):
    axis = f"{field}={text}"
    assert grid(CORRECTED, [axis]) == {axis: CORRECTED.change(**{field: value})}
    assert list(grid(CORRECTED, [axis.replace("_", "-", 1)])) == [axis]


def test_names_are_those_of_folders():
    (name,) = grid(CORRECTED, ["env_id=offairl/PointMazeLeft-v0"])
    assert name == "env_id=offairl-PointMazeLeft-v0"


def test_numbers_are_of_the_type_of_their_field():
    (config,) = grid(CORRECTED, ["temperature=1"]).values()
    assert repr(config.learner.temperature) == "1.0"


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        ("heat=1", r"no setting 'heat' to vary; there are: reward, .*env-id, .*reward-sees"),
        ("temperature=hot", "temperature is 'hot'; expected a number above 0, or None"),
        ("batch_size=1.5", "batch_size is 1.5; expected a whole number of at least 1"),
        ("normalise=1", "normalise is 1; expected True or False"),
        ("hidden=8;8", "hidden is '8;8'; expected a tuple, each part a whole number"),
        ("log_std_range=1x2x3", "log_std_range is '1x2x3'; expected 2 numbers"),
        ("reward=gail", "^reward is 'gail'; expected one of"),
        ("learner=sac,td3", "^learner=td3: reward 'r-s' needs log π"),
        (
            "reward=dac learner=td3 temperature=0.1",
            "^reward=dac,learner=td3,temperature=0.1: temperature has no use with learner='td3'",
        ),
        ("ablation=none composition=exact", "composition has no use with learner='sac'"),
        ("discount=2", r"discount is 2; expected a number in \[0, 1\]"),
        ("temperature=1,1.0", "temperature=1.0 is in the grid twice"),
        ("temperature=", "temperature is ''; expected a number"),
        ("temperature", "grid=temperature: expected SETTING=VALUE,VALUE, and each setting once"),
        ("discount=0.1 discount=0.2", "grid=discount=0.2: expected SETTING=VALUE,VALUE, and"),
    ],
)
def test_what_makes_no_grid_is_named(axes, message):
    with pytest.raises(ValueError, match=message):
        grid(CORRECTED, axes.split())
