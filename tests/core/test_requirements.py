"""What a run needs to be given, and what is refused."""

from functools import partial

import numpy as np
import pytest

from offairl_lite.core.loop import Trainer, train

HOPPER = "Hopper-v5"
ON_POLICY = {"learner": "ppo", "train_every": 50, "replay_size": 50}
MCP = {"primitives": 3, "trunk_hidden": (8,), "primitive_hidden": (6,), "gate_hidden": (8,)}
run = partial(train, progress=False)


@pytest.mark.parametrize("seeds", [(), np.arange(0)], ids=["tuple", "array"])
def test_no_seeds_no_run(tiny, maze, seeds):
    with pytest.raises(ValueError, match="no seeds"):
        Trainer(tiny, seeds, maze)


def test_no_seed_twice(tiny, maze):
    with pytest.raises(ValueError, match=r"seeds are \(1, 1\)"):
        Trainer(tiny, (1, 1), maze)


def test_an_unknown_task_is_refused(tiny):
    with pytest.raises(ValueError, match="unknown environment 'Nowhere-v0'"):
        Trainer(tiny.change(env_id="Nowhere-v0", reward="environment"), (0,))


def test_demonstrations_must_be_given_and_of_the_task(tiny, maze):
    with pytest.raises(ValueError, match="'r-s' is learned from demonstrations"):
        Trainer(tiny, (0,))
    right = tiny.change(env_id="offairl/PointMazeRight-v0")
    with pytest.raises(ValueError, match=r"demonstrations of .*Left-v0 for a run on .*Right-v0"):
        Trainer(right, (0,), maze)


def test_gan_gcl_is_read_and_no_longer_trained(tiny, maze):
    config = tiny.change(**ON_POLICY, reward="gan-gcl")
    with pytest.raises(ValueError, match=r"GAN-GCL is a page now.*choose another reward"):
        Trainer(config, (0,), maze)


def test_before_anything_is_done_r_is_refused_what_it_cannot_see(tiny, maze):
    with pytest.raises(ValueError, match=r"reward_sees is \(0, 3\); .* have 3 numbers"):
        Trainer(tiny.change(reward_sees=(0, 3)), (0,), maze)


CURE = ": set absorbing as the reward's run did, or give the reward of a task like this one"


@pytest.mark.parametrize(
    ("kind", "obs_dim", "gives"),
    [("none", 5, 3), ("none", 2, 3), ("none", 4, 3), ("bootstrap", 3, 4), ("analytic", 5, 4)],
)
def test_a_frozen_reward_of_other_observations_is_refused(
    tiny, frozen_reward, kind, obs_dim, gives
):
    frozen = tiny.change(reward="frozen", absorbing=kind)
    message = f"of Hopper-v5, sees {obs_dim} numbers and none of an action; with "
    message += f"absorbing='{kind}', offairl/PointMazeLeft-v0 gives {gives} and 2{CURE}"
    with pytest.raises(ValueError, match=message):
        Trainer(frozen, (0,), None, frozen_reward(1, HOPPER, obs_dim))


@pytest.mark.parametrize("kind", ["none", "bootstrap"])
def test_a_frozen_reward_of_other_actions_is_refused(tiny, frozen_reward, kind):
    frozen, obs_dim = tiny.change(reward="frozen", absorbing=kind), 3 + (kind != "none")
    message = rf"{obs_dim} numbers and 3 of an action; .*Left-v0 gives {obs_dim} and 2{CURE}"
    with pytest.raises(ValueError, match=message):
        Trainer(frozen, (0,), None, frozen_reward(1, HOPPER, obs_dim, action_dim=3))
    assert len(run(frozen, (0,), None, frozen_reward(1, obs_dim=obs_dim, action_dim=2)).rows) == 2


def test_a_frozen_reward_must_be_given_for_every_seed_and_only_then(tiny, maze, frozen_reward):
    frozen = tiny.change(reward="frozen")
    with pytest.raises(ValueError, match=r"reward of 3 members for 2 seeds: .* seeds=\(0, 1, 2\)$"):
        Trainer(frozen, (0, 1), None, frozen_reward(3))
    with pytest.raises(ValueError, match="go together"):
        Trainer(frozen, (0, 1))
    with pytest.raises(ValueError, match="go together"):
        Trainer(tiny, (0,), maze, frozen_reward(1))


@pytest.mark.parametrize(
    ("change", "given", "message"),
    [
        ({"pretrained": "policy"}, (), "pretrained='policy' and a pretrained policy"),
        ({}, ("pretrained_policy",), "pretrained='nothing' and a pretrained policy"),
        ({"guide_steps": 5}, (), "guide_steps=5 and a guide"),
        ({}, ("guide",), "guide_steps=0 and a guide"),
    ],
)
def test_what_comes_from_other_runs_is_needed_and_not_more(
    tiny, earlier_policy, change, given, message
):
    config = tiny.change(reward="environment", **change)
    with pytest.raises(ValueError, match=message):
        Trainer(config, (0,), **{name: earlier_policy(config, 1) for name in given})


def test_policies_must_be_as_many_and_of_the_architecture(tiny, maze, earlier_policy):
    config = tiny.change(reward="environment", pretrained="policy")
    with pytest.raises(ValueError, match="a pretrained policy of 3 members for 2 seeds"):
        Trainer(config, range(2), pretrained_policy=earlier_policy(config, 3))
    with pytest.raises(ValueError, match=r"is a SquashedGaussian\(.*MultiplicativeGaussian\("):
        Trainer(config.change(**MCP), range(2), pretrained_policy=earlier_policy(config, 2))
    seeing = config.change(pretrained="nothing", guide_steps=5, reward="dac", absorbing="bootstrap")
    with pytest.raises(ValueError, match="sees 3 numbers and gives 2; this run has 4 and 2"):
        Trainer(seeing, range(2), maze, guide=earlier_policy(config, 2))
