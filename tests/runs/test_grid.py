from dataclasses import replace

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
    assert points["reward=dac,temperature=0.1"] == replace(CORRECTED, reward="dac", temperature=0.1)


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
    ],
)
def test_a_value_and_its_text_are_the_same(field, value, text):
    expected = {f"{field}={text}": replace(CORRECTED, **{field: value})}
    assert grid(CORRECTED, **{field: [value]}) == expected
    assert grid(CORRECTED, **{field: [text]}) == expected


def test_names_are_those_of_folders():
    assert list(grid(CORRECTED, env_id=["offairl/PointMazeLeft-v0"])) == [
        "env_id=offairl-PointMazeLeft-v0"
    ]


def test_numbers_are_of_the_type_of_their_field():
    (config,) = grid(CORRECTED, temperature=["1"], hidden=[[8, 8]]).values()
    assert (repr(config.temperature), config.hidden) == ("1.0", (8, 8))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"heat": [1]}, r"no field 'heat' to vary; there are: env_id, reward, .*, eval_episodes$"),
        ({"temperature": ["hot"]}, r"temperature is 'hot'; expected float \| None"),
        ({"batch_size": [1.5]}, "batch_size is '1.5'; expected int"),
        ({"normalise": [1]}, "normalise is '1'; expected bool"),
        ({"hidden": ["8,8"]}, r"hidden is '8,8'; expected tuple\[int, ...\]"),
        ({"log_std_range": [(1, 2, 3)]}, r"'1x2x3'; expected tuple\[float, float\]"),
        ({"reward": ["gail"]}, r"^reward=gail: reward is 'gail'; expected one of"),
        ({"generator": ["sac", "td3"]}, "^generator=td3: reward 'implementation-4' needs log π"),
        ({"temperature": [1, 1.0]}, "temperature=1.0 is in the grid twice"),
        ({"temperature": []}, "the grid is empty"),
        ({}, "the grid is empty"),
    ],
)
def test_what_makes_no_grid_is_named(values, message):
    with pytest.raises(ValueError, match=message):
        grid(CORRECTED, **values)
