"""The mazes and ants on which the rewards of two worlds are tried, for chapter 12."""

import json
from contextlib import closing

import gymnasium
import numpy as np
import pytest
import torch

import rollouts
from grid_worlds import QUARTER, Player, turned
from offairl_lite import demonstrations, envs, tabular
from offairl_lite.core.rollouts import rollout
from offairl_lite.envs import TASKS
from offairl_lite.envs.models import GOAL
from offairl_lite.envs.tasks import in_marsh
from offairl_lite.plain import descend
from offairl_lite.runs import records
from rollouts import RECORDS, second_marsh, third_maze, two_bodies, two_mazes

IMAGE = "offairl/CustomAntImage-v0"


@pytest.fixture(autouse=True)
def forgotten():
    """No other test knows of these tasks."""
    known = {*TASKS}
    yield
    for env_id in {*TASKS} - known:
        del TASKS[env_id], gymnasium.registry[env_id]


def walk(env_id, actions, start=None):
    """The observations of a walk, from an ant's observed start."""
    with closing(envs.make(env_id, 1, 0)) as env:
        obs, _ = env.reset()
        if start is not None:
            env._qpos[0, 2:], env._qvel[0] = start[:13], start[13:27]
        return np.stack([obs[0], *(env.step(action[None])[0][0] for action in actions)])


def test_two_mirrors_change_nothing():
    for order, sign in (two_bodies.mirror(), two_bodies.mirrored_actions()):
        numbers = np.arange(len(order)) + 1.0
        image = numbers[order] * sign
        assert sorted(abs(image)) == sorted(numbers)
        assert (image[order] * sign == numbers).all()
    assert len(two_bodies.mirror()[0]) == 111


def test_customant_looks_the_same_in_the_mirror():
    """But for its eyes, which weigh little, so that steps differ a little."""
    two_bodies.in_the_mirror(two_bodies.ABLE, IMAGE)
    order, sign = two_bodies.mirror()
    actions = np.random.default_rng(0).uniform(-1, 1, (9, 8)).astype(np.float32)
    ant = walk(two_bodies.ABLE, actions)
    image = walk(IMAGE, actions, ant[0][order] * sign)[1:]
    assert np.abs(image - ant[1:])[:, :27].max() < 0.05
    others = actions[:, np.roll(np.arange(8), 2)]  # each leg moves as another should
    assert np.abs(walk(two_bodies.ABLE, others) - ant)[1:, :27].max() > 0.5


def test_the_mirror_image_of_disabledant_has_weak_left_legs():
    two_bodies.register()
    ant, image = (TASKS[name].model() for name in (two_bodies.WEAK, two_bodies.MIRRORED))
    strength = abs(ant.actuator_gear[:, 0]), abs(image.actuator_gear[:, 0])
    legs = [np.repeat(two_bodies.LEGS, 2)[force == 1].tolist() for force in strength]
    assert legs == [[4, 4, 3, 3], [1, 1, 2, 2]]


def text_of_the_page(name="12_two_worlds"):
    cells = json.loads((RECORDS.parent / f"{name}.ipynb").read_text("utf-8"))["cells"]
    return "".join("".join(cell["source"]) for cell in cells)


def test_the_page_counts_the_arrivals_in_the_third_maze():
    new, page = rollouts.read("third_maze")["new"], text_of_the_page()
    assert {len(ends) for ends in new.values()} == {5}

    def told(worlds):
        own, mirrored = (
            int((new[f"{worlds}, {maze}"] > -14).sum()) for maze in ("moved", "mirrored")
        )
        return f"{own}|{mirrored}"

    assert {name.rsplit(", ", 1)[0] for name in new} - {"r(s, a), weak"} == {
        f"{reward}, {second}" for reward in ("r(s)", "r(s, a)") for second in ("none", "turned")
    }
    for second, name in (("none", "Left alone"), ("turned", "+ turned controls")):
        assert f"|{name}|{told(f'r(s), {second}')}|{told(f'r(s, a), {second}')}|" in page
    assert f"|+ weak motors|–|–|{told('r(s, a), weak')}|" in page


def test_the_reward_of_one_world_gets_worse_once_the_agent_is_where_the_expert_is():
    """The correlation falls from nearly 0.8 to 0.4 in five rounds.

    At first the expert betrays itself by where it is: that alone tells most of the reward. If the
    agent is at the same places from the start, the correlation is low from the start.
    """
    page = json.loads((RECORDS.parent / "12_two_worlds.ipynb").read_text("utf-8"))["cells"]
    code = {cell["id"]: "".join(cell["source"]) for cell in page}
    names = {"np": np, "Generator": torch.Generator, "eye": torch.eye, "nn": torch.nn}
    names |= {"descend": descend, "Player": Player}
    for cell in ("two-t18", "two-t19", "two-t20"):
        exec(code[cell], names)
    small = tabular.maze(6, "Left", discount=0.9)
    reward = small.reward / 0.3
    pair = [small.mdp, turned(small.mdp, QUARTER)]
    one, two = (names["play"](worlds, reward) for worlds in (pair[:1], pair))
    assert 0.75 < one[0] < 0.8 < two[0] < 0.83
    assert np.abs(np.array(one[4:]) - 0.4).max() < 0.01
    assert two[-1] > 0.99

    def where(visits):
        return visits.reshape(reward.size, -1).sum(1).numpy()

    player = Player(small.mdp, reward)
    more_often = np.log(where(player.seen)) - np.log(where(player.visits))
    assert np.corrcoef(more_often, reward)[0, 1] > 0.85

    class SamePlaces(Player):
        def _become(self, log_policy):
            super()._become(log_policy)
            self.visits = torch.as_tensor(where(self.seen)[:, None] * np.exp(log_policy)).ravel()
            self.visits = self.visits.float()

    names["Player"] = SamePlaces
    assert max(names["play"](pair[:1], reward)) < 0.55
    assert (
        "if the agent is there from the start, the correlation stays below 0.55"
        in text_of_the_page()
    )


def test_two_worlds_are_not_always_ahead_of_one():
    """From one start and for r(s, a): behind at ten thousand and at a million steps."""
    kept = rollouts.read("12_two_worlds")
    one, two = (
        np.median(np.array(kept[f"careful, one start, {worlds}, r(s, a)"])[..., 0], 1)
        for worlds in ("dry", "dry and wet")
    )
    behind = np.array(kept["steps"])[[1, 3]]
    assert behind.tolist() == [10_000, 1_000_000]
    assert (two[[1, 3]] < one[[1, 3]]).all()
    assert "and with fewer steps two worlds were not always better" in text_of_the_page()


@pytest.mark.parametrize("form", third_maze.FORMS)
def test_rewards_beside_each_other_say_what_they_say_alone(form):
    one = records.read(RECORDS / two_mazes.RECORDED[form]).reward
    both = third_maze.beside([one, one.member(2, 0)])
    rng = torch.Generator().manual_seed(0)
    obs, action = (torch.randn(7, 4, n, generator=rng) for n in (3, 2))
    members = [both(obs, action)[i] for i in (4, 5, 6)]
    alone = [
        one.member(k)(obs[i : i + 1], action[i : i + 1])[0] for i, k in ((4, 4), (5, 2), (6, 0))
    ]
    torch.testing.assert_close(members, alone)


def test_the_third_maze_asks_for_another_way_and_its_mirror_for_other_pushes():
    third_maze.register()
    left = demonstrations.expert(two_mazes.LEFT).member(0)
    for maze in third_maze.NEW.values():
        assert rollout(left, maze, (0,), 1).returns.mean() < -25
    pushes = np.random.default_rng(0).uniform(-1, 1, (20, 2)).astype(np.float32)
    way = walk(two_mazes.RIGHT, pushes)
    assert np.allclose(walk(third_maze.MIRRORED, pushes * np.float32([-1, 1])), way)
    assert not np.allclose(walk(third_maze.MIRRORED, pushes), way, atol=0.01)


def test_in_the_low_maze_both_experts_are_stuck_at_the_barrier():
    third_maze.register()
    for side in (two_mazes.LEFT, two_mazes.RIGHT):
        ways = rollout(demonstrations.expert(side), third_maze.LOW, range(5), 1)
        assert ways.returns.max() < -40
        ends = ways.obs[:, 0, -1]
        assert ((ends[:, 0] > 0.1) & (ends[:, 1] < 0.11)).all()


def test_rewards_from_both_sides_lead_more_agents_round_the_low_barrier():
    """Of each reward five agents: 8 of 10 against 3 of 10. In the mirrored maze all arrive."""
    kept = rollouts.read("third_maze")
    sides = kept["sides"]
    arrived = {name: int((ends > -16).sum()) for name, ends in sides.items()}
    assert arrived == {
        "r(s, a), sides, mirrored": 5,
        "r(s, a), none, low": 0,
        "r(s, a), sides, low": 3,
        "r(s), sides, mirrored": 5,
        "r(s), none, low": 3,
        "r(s), sides, low": 5,
        "true, low": 4,
    }
    for form in third_maze.FORMS:
        assert (kept["new"][f"{form}, none, mirrored"] > -16).all()
    # The west, where the low barrier leaves a gap, is seen in demonstrations of Right alone.
    left, right = (
        demonstrations.load(maze, count).transitions.obs[:, 0].min()
        for maze, count in ((two_mazes.LEFT, 50), (two_mazes.RIGHT, 25))
    )
    assert right < 0.1 < 0.2 < left


def test_the_wind_blows_east_with_a_third_of_a_motor_s_force():
    two_mazes.make_known(second_marsh.WINDY, TASKS[second_marsh.MARSH], second_marsh._windy)
    blown = walk(second_marsh.WINDY, np.zeros((5, 2), np.float32))
    pushed = walk(second_marsh.MARSH, np.tile(np.float32([second_marsh.WIND, 0]), (5, 1)))
    np.testing.assert_allclose(blown - blown[0], pushed - pushed[0], atol=1e-6)
    assert blown[-1, 0] > blown[0, 0] + 1e-3


def test_which_imitators_walk_through_the_marsh():
    """The straight way crosses it in five steps."""
    kept = rollouts.read("10_where_rewards_fail")["marsh"]
    wet = {folder: np.array(of["wet"]) for folder, of in kept.items()}
    with_airl = wet["marsh-imitation-long-demo/implementation-4"]
    few, many = (
        wet[f"decides-marsh-demo/{name}/implementation-4"] for name in ("released", "released-50")
    )
    for group in (with_airl, few):
        assert (group > 3).sum() >= 4
    assert (many == 0).all()
    assert "most imitators walk through the marsh; after 50,000 none does." in (
        text_of_the_page("10_where_rewards_fail")
    )


def test_the_fit_finds_hill_and_marsh():
    """Of a reward that is both, whatever its unit: the depth is 2 m."""

    class Both:
        def __len__(self):
            return 2

        def __call__(self, obs):
            distance = (obs[..., :2] - torch.tensor(GOAL)).norm(dim=-1)
            # Some places are on its edge, where rounding decides.
            marsh = torch.from_numpy(in_marsh(obs[0].double().numpy() - 1e-6))
            return (5 - distance - 2 * marsh) * torch.tensor([[1], [7]])

    found = second_marsh.fitted(Both())
    np.testing.assert_allclose(np.divide(found["c"], found["b"]), 2, rtol=1e-5)
    np.testing.assert_allclose(found["fit"], 1, atol=1e-9)
