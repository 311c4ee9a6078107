"""What `train` is given is checked before anything is made of it."""

from dataclasses import replace

import pytest
import torch

from offairl_lite.core.loop import train


def with_column(demos, name, change):
    """The same demonstrations but for one column."""
    column = change(getattr(demos.transitions, name).clone())
    return replace(demos, transitions=demos.transitions._replace(**{name: column}))


def put(value, row=3):
    def change(column):
        column[row] = value
        return column

    return change


ARGUMENTS = [
    ({"config": "maze"}, "config is 'maze'; expected a Config"),
    ({"config": None}, "config is None; expected a Config"),
    ({"seeds": [True]}, r"seeds is \(True,\); expected a tuple, each part a whole number"),
    ({"seeds": [1.0]}, r"seeds is \(1.0,\)"),
    ({"seeds": ["0"]}, r"seeds is \('0',\)"),
    ({"seeds": [-1]}, r"seeds is \(-1,\)"),
    ({"seeds": []}, "no seeds"),
    ({"seeds": [3, 3]}, "two members with one seed"),
    ({"demonstrations": []}, r"demonstrations is \[\]; expected a Demonstrations"),
    ({"demonstrations": "expert"}, "demonstrations is 'expert'"),
    ({"frozen_reward": "runs/left"}, "frozen_reward is 'runs/left'; expected a Reward"),
    ({"pretrained_policy": 1}, "pretrained_policy is 1; expected a Policy"),
    ({"guide": "expert"}, "guide is 'expert'; expected a Policy"),
]

COLUMNS = [
    ("obs", put(torch.nan)),
    ("obs", put(torch.inf)),
    ("obs", put(1e30)),
    ("reward", put(1e30)),
    ("pre_tanh", put(torch.nan)),
    ("next_obs", put(torch.nan)),
    ("reward", put(-torch.inf)),
    ("terminated", put(0.5)),
    ("terminated", put(1.0)),
    ("obs", torch.Tensor.double),
    ("pre_tanh", torch.Tensor.long),
    ("obs", lambda column: column[:, :2]),
    ("pre_tanh", lambda column: column[:, :1]),
    ("next_obs", lambda column: column[1:]),
    ("reward", lambda column: column[:, None]),
    ("obs", lambda column: column.numpy()),
]


@pytest.mark.parametrize(("given", "message"), ARGUMENTS)
def test_an_argument_of_the_wrong_kind_is_named(tiny, random_demonstrations, given, message):
    right = {
        "config": tiny,
        "seeds": [0],
        "demonstrations": random_demonstrations(tiny.env_id),
    }
    with pytest.raises(ValueError, match=message):
        train(**{**right, **given}, progress=False)


@pytest.mark.parametrize(("name", "change"), COLUMNS)
def test_demonstrations_that_are_not_whole_are_refused(tiny, random_demonstrations, name, change):
    demos = with_column(random_demonstrations(tiny.env_id), name, change)
    with pytest.raises(ValueError, match=r"demonstrations.*(episode \d|" + name + " is)"):
        train(tiny, [0], demos, progress=False)
