"""What the tests of the core start from: demonstrations, rewards and policies of other runs."""

import pytest
import torch

from offairl_lite.core.networks import Normaliser
from offairl_lite.core.policies import Policy, make_actor
from offairl_lite.core.rng import Rng

MAZE = "offairl/PointMazeLeft-v0"


@pytest.fixture
def maze(random_demonstrations):
    return random_demonstrations(MAZE)


@pytest.fixture
def earlier_policy():
    """Make a random policy of the maze, as an earlier run with this configuration would."""

    def make(config, members, shift=0.0):
        actor = make_actor(config.learner, 3, 2)
        mean, std = torch.full((members, 1, 3), shift), torch.full((members, 1, 3), 2.0)
        params = actor.init(Rng(range(10, 10 + members)))
        return Policy(MAZE, actor, params, Normaliser(mean, std))

    return make


@pytest.fixture
def until():
    """Run a trainer until its state is as wanted, or to its end."""

    def run(trainer, reached):
        for _ in trainer.run():
            if reached(trainer):
                return

    return run


@pytest.fixture
def record(monkeypatch):
    """Keep the arguments of every call of a method, which does its work as before."""

    def kept(kind, name):
        calls, original = [], getattr(kind, name)

        def called(self, *args):
            calls.append(args)
            return original(self, *args)

        monkeypatch.setattr(kind, name, called)
        return calls

    return kept
