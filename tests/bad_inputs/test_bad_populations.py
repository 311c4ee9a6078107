"""Bad inputs of policies and rewards: each one is refused with a message that names it."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box

from offairl_lite.analysis import films
from offairl_lite.core.networks import Normaliser, StackedMLP
from offairl_lite.core.policies import Policy, SquashedGaussian
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rng import Rng
from offairl_lite.core.rollouts import action, rollout

MAZE = "offairl/PointMazeLeft-v0"
WHOLE = "expected a whole number"
BOX = Box(np.float32([-1, -1]), np.float32([1, 3]))
ACTOR = SquashedGaussian(3, 2, (8,))
TWO = Policy(MAZE, ACTOR, ACTOR.init(Rng((0, 1))), Normaliser.identity(2, 3))
ONE = TWO.member(0)
NET = StackedMLP((5, 4, 1), "tanh")
OF_ACTIONS = Reward(MAZE, NET, False, NET.init(Rng((0, 1))), Normaliser.identity(2, 3))
GOOD = np.array([0.1, 0.2, 0.0])


def changed(index, value):
    """A good observation with one number changed."""
    obs = GOOD.copy()
    obs[index] = value
    return obs


@pytest.mark.parametrize(
    ("obs", "words"),
    [
        (changed(0, np.nan), "obs is [nan 0.2 0. ], and the action [nan nan]; expected finite"),
        (changed(1, np.inf), "obs is [0.1 inf 0. ], and the action ...expected finite numbers"),
        (changed(2, -np.inf), "obs is [ 0.1  0.2 -inf], and the action ...expected finite"),
        (changed(0, 1e300), "obs is [1.e+300 2.e-001 0.e+000], and the action"),
        (np.full(3, np.nan, np.float32), "obs is [nan nan nan], and the action [nan nan]"),
        ([0.1, np.nan, 0.0], "obs is [0.1, nan, 0.0], and the action [nan nan]"),
        (torch.tensor([0.1, torch.nan, 0.0]), "and the action [nan nan]; expected finite"),
        (None, "obs is None; expected numbers of shape (3,)"),
        (0.5, "obs is 0.5; expected numbers of shape (3,)"),
        (GOOD[None, None], "obs is array([[[0.1, 0.2, 0. ]]]); expected numbers of shape (3,)"),
        (GOOD.astype(str), "expected numbers of shape (3,)"),
        (GOOD + 1j, "expected numbers of shape (3,)"),
        (GOOD.astype(object), "expected numbers of shape (3,)"),
        ("now", "obs is 'now'; expected numbers of shape (3,)"),
        (GOOD[:1], f"the policy of {MAZE} sees 3 numbers, ...it was given 1"),
        (np.zeros(0), f"the policy of {MAZE} sees 3 numbers, ...it was given 0"),
        (np.zeros(4), f"the policy of {MAZE} sees 3 numbers, ...it was given 4"),
    ],
)
def test_no_action_is_returned_for(refused, obs, words):
    refused(lambda: action(ONE, obs, BOX), words)


@pytest.mark.parametrize(
    ("policy", "space", "words"),
    [
        (TWO, BOX, "2 members for one action; choose one: policy.member(0)"),
        (replace(ONE, params=ONE.params * np.nan), BOX, "the action [nan nan]; expected finite"),
        (ONE, Box(-np.inf, np.inf, (2,)), "and the action ...expected finite numbers"),
        (ONE, Box(-1, np.inf, (2,)), "and the action ...expected finite numbers"),
        (ONE, Box(-1, 1, (3,)), "gives 2 numbers, and actions have the shape (3,)"),
        (ONE, Box(-1, 1, (1, 2)), "gives 2 numbers, and actions have the shape (1, 2)"),
    ],
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_no_action_is_returned_by(refused, policy, space, words):
    refused(lambda: action(policy, GOOD, space), words)


@pytest.mark.parametrize("obs", [GOOD, list(GOOD), GOOD.astype(np.float16), torch.tensor(GOOD)])
def test_an_observation_may_come_in_any_form_of_numbers(obs):
    np.testing.assert_allclose(action(ONE, obs, BOX), action(ONE, GOOD, BOX), atol=1e-3)
    assert action(ONE, [0, 1, 0], BOX).dtype == np.float32


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"episodes": 0}, f"episodes is 0; {WHOLE} of at least 1"),
        ({"episodes": -1}, f"episodes is -1; {WHOLE} of at least 1"),
        ({"episodes": 1.0}, f"episodes is 1.0; {WHOLE} of at least 1"),
        ({"episodes": True}, f"episodes is True; {WHOLE} of at least 1"),
        ({"episodes": "2"}, f"episodes is '2'; {WHOLE} of at least 1"),
        ({"episodes": None}, f"episodes is None; {WHOLE} of at least 1"),
        ({"seeds": 2}, "seeds is 2; expected a tuple, each part a whole number of at least 0"),
        ({"seeds": None}, "seeds is None; expected a tuple"),
        ({"seeds": "01"}, "seeds is '01'; expected a tuple"),
        ({"seeds": ["0", "1"]}, "seeds is ['0', '1']; expected a tuple"),
        ({"seeds": [0, True]}, "seeds is [0, True]; expected a tuple"),
        ({"seeds": [0, -1]}, "seeds is [0, -1]; expected a tuple"),
        ({"seeds": [0, 1.5]}, "seeds is [0, 1.5]; expected a tuple"),
        ({"seeds": [0, None]}, "seeds is [0, None]; expected a tuple"),
        ({"seeds": []}, "0 seeds for a policy of 2 members"),
        ({"seeds": range(3)}, "3 seeds for a policy of 2 members"),
        ({"env_id": None}, "env_id is None; expected a text"),
        ({"env_id": "Hopper-v5"}, "sees 3 numbers, ...it was given 11"),
        ({"env_id": "Nowhere-v0"}, "unknown environment 'Nowhere-v0'"),
        ({"num_threads": 0}, f"num_threads is 0; {WHOLE} of at least 1"),
        ({"num_threads": 1.5}, f"num_threads is 1.5; {WHOLE} of at least 1"),
        ({"purpose": -1}, f"purpose is -1; {WHOLE} of at least 0"),
        ({"purpose": "demos"}, f"purpose is 'demos'; {WHOLE} of at least 0"),
        ({"purpose": None}, f"purpose is None; {WHOLE} of at least 0"),
        ({"purpose": 1.0}, f"purpose is 1.0; {WHOLE} of at least 0"),
        ({"purpose": True}, f"purpose is True; {WHOLE} of at least 0"),
        ({"first": -1}, f"first is -1; {WHOLE} of at least 0"),
        ({"first": "0"}, f"first is '0'; {WHOLE} of at least 0"),
        ({"first": None}, f"first is None; {WHOLE} of at least 0"),
        ({"first": 2.5}, f"first is 2.5; {WHOLE} of at least 0"),
        ({"first": False}, f"first is False; {WHOLE} of at least 0"),
    ],
)
def test_no_episodes_are_run_with(refused, given, words):
    good = {"env_id": MAZE, "seeds": (0, 1), "episodes": 1}
    refused(lambda: rollout(TWO, **(good | given)), words)


def test_seeds_and_episodes_may_be_numpy_s():
    one, other = rollout(TWO, MAZE, np.array([3, 4]), np.int64(1)), rollout(TWO, MAZE, (3, 4), 1)
    np.testing.assert_array_equal(one.obs, other.obs)


@pytest.mark.parametrize("population", [TWO, OF_ACTIONS])
@pytest.mark.parametrize(
    ("index", "words"),
    [
        ((9,), f"member is 9; {WHOLE} in [0, 1]"),
        ((2,), f"member is 2; {WHOLE} in [0, 1]"),
        ((-1,), f"member is -1; {WHOLE} in [0, 1]"),
        ((0, 5), f"member is 5; {WHOLE} in [0, 1]"),
        ((True,), f"member is True; {WHOLE} in [0, 1]"),
        ((0.0,), f"member is 0.0; {WHOLE} in [0, 1]"),
        (("0",), f"member is '0'; {WHOLE} in [0, 1]"),
        (([0, 1],), f"member is [0, 1]; {WHOLE} in [0, 1]"),
        ((None,), f"member is None; {WHOLE} in [0, 1]"),
        ((), f"member is None; {WHOLE} in [0, 1]"),
    ],
)
def test_there_is_no_member(refused, population, index, words):
    refused(lambda: population.member(*index), words)


def test_a_member_s_number_may_be_numpy_s():
    assert torch.equal(TWO.member(np.argmax([0, 1])).params, TWO.params[1:])


OBS, ACT = torch.zeros(2, 5, 3), torch.zeros(2, 5, 2)
OBSERVATIONS = [
    (OBS.double(), "obs is torch.float64 of shape (2, 5, 3); expected torch.float32 of shape (2,"),
    (OBS.half(), "obs is torch.float16 of shape (2, 5, 3); expected torch.float32"),
    (OBS.long(), "obs is torch.int64 of shape (2, 5, 3); expected torch.float32"),
    (OBS[0], "obs is torch.float32 of shape (5, 3); expected torch.float32 of shape (2, 'B', "),
    (OBS[0, 0], "obs is torch.float32 of shape (3,); expected torch.float32 of shape (2, 'B', "),
    (OBS[None], "obs is torch.float32 of shape (1, 2, 5, 3); expected torch.float32 of shape (2"),
    (torch.zeros(3, 5, 3), "obs is torch.float32 of shape (3, 5, 3); expected torch.float32"),
    (torch.zeros(0, 5, 3), "obs is torch.float32 of shape (0, 5, 3); expected torch.float32"),
    (OBS.numpy(), "obs is float32 of shape (2, 5, 3); expected torch.float32 of shape"),
    (OBS.tolist(), "obs is list of shape (); expected torch.float32 of shape"),
    (None, "obs is NoneType of shape (); expected torch.float32 of shape"),
]


@pytest.mark.parametrize("see", [TWO.act, lambda obs: OF_ACTIONS(obs, ACT)])
@pytest.mark.parametrize(("obs", "words"), OBSERVATIONS)
def test_neither_policies_nor_rewards_see(refused, see, obs, words):
    refused(lambda: see(obs), words)


def test_a_policy_does_not_see_observations_of_another_size(refused):
    refused(lambda: TWO.act(torch.zeros(2, 5, 4)), "sees 3 numbers, ...it was given 4")
    assert TWO.act(OBS[:1]).shape == (2, 5, 2)  # The same ones for all members.


@pytest.mark.parametrize(
    ("acts", "words"),
    [
        (None, "is r(s, a): give it the actions, too"),
        (ACT.double(), "action is torch.float64 of shape (2, 5, 2); expected torch.float32"),
        (ACT.numpy(), "action is float32 of shape (2, 5, 2); expected torch.float32"),
        (ACT[:, :4], "action is torch.float32 of shape (2, 4, 2); expected ...(2, 5, 2)"),
        (ACT[..., :1], "action is torch.float32 of shape (2, 5, 1); expected ...(2, 5, 2)"),
        (ACT[0], "action is torch.float32 of shape (5, 2); expected ...(2, 5, 2)"),
        (torch.zeros(3, 5, 2), "action is torch.float32 of shape (3, 5, 2); expected ...(2, 5, 2)"),
    ],
)
def test_no_reward_is_paid_for(refused, acts, words):
    refused(lambda: OF_ACTIONS(OBS, acts), words)


@pytest.mark.parametrize(
    ("policy", "given", "words"),
    [
        (TWO, {}, "the policy has 2 members; choose one"),
        (ONE, {"max_steps": 0}, f"max_steps is 0; {WHOLE} of at least 1"),
        (ONE, {"max_steps": -3}, f"max_steps is -3; {WHOLE} of at least 1"),
        (ONE, {"max_steps": 2.5}, f"max_steps is 2.5; {WHOLE} of at least 1"),
        (ONE, {"max_steps": None}, f"max_steps is None; {WHOLE} of at least 1"),
        (ONE, {"every": 0}, f"every is 0; {WHOLE} of at least 1"),
        (ONE, {"every": True}, f"every is True; {WHOLE} of at least 1"),
        (ONE, {"every": "2"}, f"every is '2'; {WHOLE} of at least 1"),
        (ONE, {"seed": None}, "seed is None; expected a number"),
        (ONE, {"seed": -1}, f"seed is -1; {WHOLE} of at least 0"),
        (ONE, {"seed": "0"}, "seed is '0'"),
        (ONE, {"env_id": None}, "env_id is None; expected a text"),
        (ONE, {"env_id": "Hopper-v5"}, "sees 3 numbers, ...it was given 11"),
    ],
)
def test_nothing_is_filmed_with(refused, policy, given, words):
    refused(lambda: films.frames(policy, **({"env_id": MAZE} | given)), words)


FILM = np.zeros((2, 16, 16, 3), np.uint8)


@pytest.mark.parametrize("make", [films.mp4, lambda pictures: films.show(pictures, "A film.")])
@pytest.mark.parametrize(
    ("pictures", "words"),
    [
        (FILM[0], "pictures is uint8 of shape (16, 16, 3); expected uint8 of shape (T, H, W, 3)"),
        (FILM[:0], "pictures is uint8 of shape (0, 16, 16, 3); expected ...not empty"),
        (FILM[:, :0], "pictures is uint8 of shape (2, 0, 16, 3); expected ...not empty"),
        (FILM[..., :1], "pictures is uint8 of shape (2, 16, 16, 1); expected"),
        (FILM[..., 0], "pictures is uint8 of shape (2, 16, 16); expected"),
        (FILM[None], "pictures is uint8 of shape (1, 2, 16, 16, 3); expected"),
        (FILM / 255, "pictures is float64 of shape (2, 16, 16, 3); expected uint8"),
        (FILM.astype(np.int64), "pictures is int64 of shape (2, 16, 16, 3); expected uint8"),
        (FILM > 0, "pictures is bool of shape (2, 16, 16, 3); expected uint8"),
        (FILM.astype(str), "pictures is <U3 of shape (2, 16, 16, 3); expected uint8"),
        ([], "pictures is float64 of shape (0,); expected uint8"),
        (None, "pictures is object of shape (); expected uint8"),
    ],
)
def test_no_film_is_made_of(refused, make, pictures, words):
    refused(lambda: make(pictures), words)


@pytest.mark.parametrize("fps", [0, -1, 2.5, "20", None, True, np.nan])
def test_no_film_has_as_many_frames_a_second_as(refused, fps):
    refused(lambda: films.mp4(FILM, fps), f"fps is {fps!r}; {WHOLE} of at least 1")


def test_a_read_only_observation_is_seen_without_a_warning():
    obs = GOOD.copy()
    obs.flags.writeable = False
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert action(ONE, obs, BOX).shape == (2,)
