"""What is written is what is read, for any recordings; and no single corruption goes unnoticed."""

import itertools
import re

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from offairl_lite import demonstrations
from offairl_lite.demonstrations import Recording, load

ARM = "ownbot/Arm-v0"
LOW, HIGH = np.float32([-2, 0]), np.float32([4, 1])  # of its actions; observations are within ±9
NAMES = (f"own/drawn{i}-v0" for i in itertools.count())
FEW = settings(
    max_examples=25,
    deadline=None,
    database=None,
    derandomize=True,
    # The folder and the task are the same for all examples, and the names of data sets new.
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


@pytest.fixture
def arm(own, minari_folder):
    return own(ARM)


def numbers(low, high, *shape, dtype=np.float32):
    width = 32 if dtype == np.float32 else 64
    return arrays(dtype, shape, elements=st.floats(float(low), float(high), width=width))


@st.composite
def recording(draw):
    """Any valid recording of the arm, of up to six steps."""
    steps, dtype = draw(st.integers(1, 6)), draw(st.sampled_from([np.float32, np.float64]))
    action = np.stack([draw(numbers(*ends, steps)) for ends in zip(LOW, HIGH, strict=True)], 1)
    rewards = numbers(-1e6, 1e6, steps, dtype=np.float64)
    obs = draw(numbers(-9, 9, steps + 1, 2, dtype=dtype))
    return Recording(obs, action.astype(dtype), draw(st.booleans()), draw(st.none() | rewards))


recordings = st.lists(recording(), min_size=1, max_size=4)


@FEW
@given(recordings)
def test_what_is_written_is_what_is_read(arm, shown):
    name = next(NAMES)
    demonstrations.write(shown, arm, name)
    data = load(arm, len(shown), name)
    assert data.lengths == tuple(len(one.action) for one in shown)
    for one, obs, action, next_obs, reward, ended in zip(
        shown, *(part.split(data.lengths) for part in data.transitions), strict=True
    ):
        np.testing.assert_array_equal(obs, one.obs[:-1].astype(np.float32))
        np.testing.assert_array_equal(next_obs, one.obs[1:].astype(np.float32))
        np.testing.assert_allclose(
            (action.tanh().numpy() + 1) / 2 * (HIGH - LOW) + LOW, one.action, atol=1e-5
        )
        paid = np.zeros(len(reward)) if one.reward is None else one.reward
        np.testing.assert_array_equal(reward, paid.astype(np.float32))
        assert ended.tolist() == [0] * (len(ended) - 1) + [one.terminated]


BAD_NUMBERS = st.sampled_from([np.nan, np.inf, -np.inf, 1e300, -1e39])


@st.composite
def corrupted(draw):
    """Valid recordings, of which one is corrupted in one place; and its number."""
    shown = draw(recordings)
    i = draw(st.integers(0, len(shown) - 1))
    one = shown[i]
    parts = {
        "obs": one.obs.astype(float),
        "action": one.action.astype(float),
        "reward": np.zeros(len(one.action)) if one.reward is None else one.reward,
    }
    name = draw(st.sampled_from([*parts]))
    array = parts[name].copy()
    how = draw(st.sampled_from(["number", "bound", "short", "long", "wide", "type", "end"]))
    if how == "bound" and name != "reward":
        array[draw(st.integers(0, len(array) - 1)), draw(st.integers(0, 1))] = draw(
            st.sampled_from([-9.01, 9.01, -1e6, 1e6])
        )
    elif how in ("number", "bound"):
        array[draw(st.integers(0, len(array) - 1))] = draw(BAD_NUMBERS)
    elif how == "short":
        array = array[:-1]
    elif how == "long":
        array = np.concatenate([array, array[-1:]])
    elif how == "wide":
        array = np.concatenate([array, array], -1) if array.ndim > 1 else array[:, None]
    elif how == "type":
        array = draw(st.sampled_from([array + 1j, array.astype(str), array.astype(object)]))
    if how == "end":
        one = one._replace(terminated=draw(st.sampled_from([None, 1, "yes", [True]])))
    else:
        one = one._replace(**{name: array})
    return [*shown[:i], one, *shown[i + 1 :]], i


@FEW
@given(corrupted())
def test_any_corrupt_recording_is_refused_by_its_number(arm, minari_folder, drawn):
    shown, i = drawn
    name = next(NAMES)
    with pytest.raises(ValueError, match=f"^recording {i}, for the task {ARM}"):
        demonstrations.write(shown, arm, name)
    assert not (minari_folder / name).exists()


@FEW
@given(recordings, st.data())
def test_any_corrupt_episode_of_a_file_is_refused_by_its_number(arm, minari_folder, shown, data):
    name = next(NAMES)
    demonstrations.write(shown, arm, name)
    i = data.draw(st.integers(0, len(shown) - 1))
    parts = ("observations", "actions", "rewards", "terminations", "truncations")
    part = data.draw(st.sampled_from(parts))
    with h5py.File(minari_folder / name / "data/main_data.hdf5", "r+") as file:
        place = f"episode_{i}/{part}"
        array = file[place][:]
        if array.dtype == bool and (len(array) > 1 or array.any()):
            file[place][:] = ~array
        elif array.dtype == bool:  # A single step may be both terminated and cut.
            del file[place]
        elif data.draw(st.booleans()):
            array[data.draw(st.integers(0, len(array) - 1))] = data.draw(
                st.sampled_from([np.nan, np.inf, -np.inf])
            )
            file[place][:] = array
        else:
            del file[place]
            if data.draw(st.booleans()):
                file[place] = data.draw(st.sampled_from([array[:-1], array + 1j, array[None]]))
    where = re.escape(f"data set {name}, episode {i}, for the task {ARM}")
    with pytest.raises(ValueError, match=where):
        load(arm, len(shown), name)
    if i:
        assert len(load(arm, i, name)) == i  # Those before it are as they were.
