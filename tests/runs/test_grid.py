import pytest

from offairl_lite.config import CORRECTED
from offairl_lite.runs.grid import grid


def test_a_grid_is_the_product_of_its_values():
    points = grid(CORRECTED, reward=["implementation-3", "dac"], temperature=[0.1, None])
    assert list(points) == [
        "reward=implementation-3,temperature=0.1",
        "reward=implementation-3,temperature=none",
        "reward=dac,temperature=0.1",
        "reward=dac,temperature=none",
    ]
    assert points["reward=dac,temperature=0.1"] == CORRECTED.change(reward="dac", temperature=0.1)


@pytest.mark.parametrize(
    ("field", "value", "text"),
    [
        ("hidden", (400, 300), "400x300"),
        ("hidden", (64,), "64"),
        ("log_std_range", (-5.0, 2.0), "-5.0x2.0"),
        ("learning_rate", 1e-05, "1e-05"),
        ("normalise", False, "false"),
        ("update_every", None, "none"),
        ("update_every", 1000, "1000"),
        ("absorbing", "none", "none"),
        ("env_id", "Pendulum-v1", "Pendulum-v1"),
        ("loss", "released", "released"),
        ("ablation", "one-sided", "one-sided"),
        ("ablation", None, "none"),
        ("reward_sees", (0, 1), "0x1"),
    ],
)
def test_a_value_and_its_text_are_the_same(field, value, text):
    expected = {f"{field}={text}": CORRECTED.change(**{field: value})}
    assert grid(CORRECTED, **{field: [value]}) == expected
    assert grid(CORRECTED, **{field: [text]}) == expected


def test_names_are_those_of_folders():
    assert list(grid(CORRECTED, env_id=["offairl/PointMazeLeft-v0"])) == [
        "env_id=offairl-PointMazeLeft-v0"
    ]


def test_numbers_are_of_the_type_of_their_field():
    (config,) = grid(CORRECTED, temperature=["1"], hidden=[[8, 8]]).values()
    assert (repr(config.learner.temperature), config.learner.hidden) == ("1.0", (8, 8))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"heat": [1]}, r"no setting 'heat' to vary; there are: reward, .*env_id, .*bottleneck"),
        ({"temperature": ["hot"]}, "temperature is 'hot'; expected a number above 0, or None"),
        ({"batch_size": [1.5]}, "batch_size is '1.5'; expected a whole number of at least 1"),
        ({"normalise": [1]}, "normalise is '1'; expected True or False"),
        ({"hidden": ["8,8"]}, "hidden is '8,8'; expected a tuple, each part a whole number"),
        ({"log_std_range": [(1, 2, 3)]}, "log_std_range is '1x2x3'; expected 2 numbers"),
        ({"reward": ["gail"]}, r"^reward=gail: reward is 'gail'; expected one of"),
        ({"learner": ["sac", "td3"]}, "^learner=td3: reward 'implementation-4' needs log π"),
        (
            {"reward": ["dac"], "learner": ["td3"], "temperature": [0.1]},
            "^reward=dac,learner=td3,temperature=0.1: temperature has no use with learner='td3'",
        ),
        ({"ablation": ["none"], "bottleneck": [0.1]}, "bottleneck has no use with learner='sac'"),
        ({"discount": [2]}, r"^discount=2.0: discount is 2.0; expected a number in \[0, 1\]"),
        ({"temperature": [1, 1.0]}, "temperature=1.0 is in the grid twice"),
        ({"temperature": []}, "the grid is empty"),
        ({}, "the grid is empty"),
    ],
)
def test_what_makes_no_grid_is_named(values, message):
    with pytest.raises(ValueError, match=message):
        grid(CORRECTED, **values)
