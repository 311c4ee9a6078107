"""Whatever settings are given, they make a configuration, or an error that names one of them."""

import json
import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from offairl_lite import ablations  # noqa: F401  (its settings are settings too)
from offairl_lite.config import CORRECTED, Config, flat_settings
from offairl_lite.config.settings import wanted

KNOWN = flat_settings()
MANY = settings(max_examples=500, deadline=None, database=None, derandomize=True)

WORDS = [
    "",
    "none",
    "None",
    "nan",
    "0",
    "True",
    "sac",
    "sac-released",
    "ppo",
    "td3",
    "dac",
    "gan-gcl",
]
WORDS += [
    "environment",
    "frozen",
    "logit-s",
    "bootstrap",
    "analytic",
    "bottleneck",
    "policy",
]
single = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 5) | st.integers(),
    st.floats() | st.sampled_from([0.0, 0.5, 1.0, 1e400, -1e-300]),
    st.sampled_from(WORDS) | st.text(max_size=5),
    st.sampled_from([np.float32(0.5), np.int64(3), np.bool_(True), np.float64("nan"), 1j, b"sac"]),
)
junk = single | st.lists(single, max_size=3) | st.lists(single, max_size=3).map(tuple)
junk |= st.dictionaries(st.sampled_from(["a", 0]), single, max_size=1) | st.just(object())
junk |= st.sampled_from([Config, np.zeros(2), np.zeros(0), np.ones((2, 2)), {1, 2}, range(2), len])


def proper(name):
    """Values of the kind that a setting takes, within its range or just beyond."""
    hint, default, _ = KNOWN[name]
    words = wanted(hint)
    some = st.just(default)
    if words.endswith("or None"):
        some |= st.none()
    if words.startswith("one of"):
        return some | st.sampled_from(WORDS)
    if words.startswith("a whole number"):
        return some | st.integers(0, 20_000)
    if words.startswith("a number"):
        return some | st.floats(-0.5, 2)
    if words.startswith("True"):
        return some | st.booleans()
    if words.startswith("2 numbers"):
        return some | st.tuples(st.floats(-5, 2), st.floats(-5, 2))
    return some | st.lists(st.integers(0, 9), max_size=3).map(tuple)


def some_settings(value):
    """A few settings, each with a value of its own."""
    names = st.lists(st.sampled_from(sorted(KNOWN)), unique=True, max_size=4)
    return names.flatmap(lambda names: st.fixed_dictionaries({n: value(n) for n in names}))


def holds(make, given):
    """A configuration that comes back from its flat view and from JSON, or a named error."""
    config, said = None, ""
    try:
        config = make(**given)
    except ValueError as error:
        said = str(error)
    if config is None:
        assert set(given) & set(re.findall(r"[a-z_]+", said)), f"{said} names none of {given}"
        return
    for flat in (config.flat(), json.loads(json.dumps(config.flat()))):
        assert Config.of(**flat) == config
    assert config.change() == config
    for name, value in given.items():
        if name in config.flat() and isinstance(value, float | str | None):
            assert config.flat()[name] == value
    numbers = [x for x in config.flat().values() if isinstance(x, float)]
    assert all(map(math.isfinite, numbers))
    assert {type(x) for x in config.flat().values()} <= {int, float, bool, str, tuple, type(None)}


@pytest.mark.parametrize("name", sorted(KNOWN))
@settings(MANY, max_examples=60)
@given(value=junk)
def test_any_value_of_any_setting(name, value):
    holds(CORRECTED.change, {name: value})


@MANY
@given(given=some_settings(proper))
def test_any_settings_together(given):
    holds(Config.of, given)


@MANY
@given(given=some_settings(lambda name: junk))
def test_any_settings_together_of_any_value(given):
    holds(Config.of, given)


@MANY
@given(name=st.text(max_size=8), value=junk)
def test_a_setting_that_there_is_none(name, value):
    if name not in KNOWN:
        with pytest.raises(ValueError, match=r"^no setting "):
            Config.of(**{name: value})
