"""Experts are chosen, rounded and described."""

import json

import numpy as np
import pytest
import torch

import shipping
from offairl_lite import demonstrations
from offairl_lite.core.networks import Normaliser
from offairl_lite.core.policies import Policy
from offairl_lite.core.rng import Rng
from offairl_lite.core.rollouts import rollout
from offairl_lite.demonstrations import load

MAZE = "offairl/PointMazeLeft-v0"


@pytest.fixture
def maze_experts(tmp_path, monkeypatch):
    """The maze's experts, while those shipped are to be found elsewhere: nowhere yet."""
    policy = demonstrations.expert(MAZE)
    monkeypatch.setattr(demonstrations, "EXPERTS", tmp_path)
    return policy


def noted():
    return json.loads(demonstrations.expert_file(MAZE).with_suffix(".json").read_text())


def test_the_best_members_are_shipped_in_their_order(maze_experts, minari_folder, monkeypatch):
    experts = maze_experts.member(4, 0, 2)
    random = experts.actor.init(Rng((0,)))
    mixed = Policy(
        MAZE,
        experts.actor,
        torch.cat([random, experts.params]),
        Normaliser(*(torch.cat([part[:1], part]) for part in experts.normaliser)),
    )
    path = shipping.ship(mixed, range(4), count=3)
    assert path == demonstrations.expert_file(MAZE)
    returns = rollout(demonstrations.expert(MAZE), MAZE, range(3), 10).returns.mean(1)
    np.testing.assert_allclose(noted()["returns"], returns, atol=1e-3)
    assert returns.min() > -7
    alone = rollout(experts, MAZE, range(3), 10).returns.mean(1)
    np.testing.assert_allclose(returns, alone, atol=0.05)
    assert np.ptp(alone) > 0.1  # so that their order can be told
    # The demonstrations are those that were noted, each time that they are made.
    made, before = demonstrations.first_episodes(demonstrations.expert(MAZE), MAZE), noted()
    first = [of_one[0] for of_one in before["demonstrations"]]
    assert demonstrations.digests(made) == first
    one, *_ = load(MAZE, 3).transitions.obs.split(100)
    np.testing.assert_array_equal(one, made.obs[0, 0].astype(np.float32))
    shipping.write_reference(MAZE)
    assert noted() == before
    # Every episode is shipped: none is sampled.
    monkeypatch.setattr(demonstrations, "_say_that_they_differ", None)
    returns = load(MAZE, 150).returns.reshape(50, 3)
    np.testing.assert_allclose(noted()["mean_returns"], returns.mean(0), atol=1e-4)


@pytest.mark.parametrize("hurt", [0.0, 0.02])
def test_experts_are_shipped_in_half_precision_where_that_changes_no_return(
    maze_experts, monkeypatch, hurt
):
    measure = shipping._mode_returns

    def measure_with_loss(policy):
        """Rounded weights do worse, it seems, by a share of `hurt` for one of the members."""
        rounded = torch.equal(policy.params, policy.params.half().float())
        return measure(policy) * (1 + hurt * rounded * np.eye(len(policy))[1])

    monkeypatch.setattr(shipping, "_mode_returns", measure_with_loss)
    path = shipping.ship(maze_experts, range(5))
    half = path.stat().st_size < 3 * maze_experts.params.numel()
    assert half == (hurt == 0)
    shipped = demonstrations.expert(MAZE).params
    assert shipped.dtype == torch.float32
    assert torch.equal(shipped, shipped.half().float()) == half
