"""One reward for several worlds: against one world, exact solutions, and bad inputs."""

import torch

from offairl_lite import worlds
from offairl_lite.core import loop

MAZE = "offairl/PointMazeLeft-v0"


def test_twice_the_same_world_is_that_world(tiny, random_demonstrations):
    shown = random_demonstrations(MAZE)
    config = tiny.change(reward="r-sa")
    alone = loop.train(config, (0, 1), shown, progress=False)
    pair = worlds.train(config, (0, 1), [shown, shown], progress=False)
    for run in pair:
        assert torch.equal(run.reward.params, alone.reward.params)
        assert torch.equal(run.policy.params, alone.policy.params)
        assert run.rows == alone.rows
