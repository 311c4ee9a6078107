"""Episodes of the recorded policies of the maze: the film's paths, where
they come to rest, and log π of what experts and policies do there. And what
the page's `retrain` gives, on the reward of its training.
"""

import json
from pathlib import Path

import gymnasium
import numpy as np
import torch

from offairl_lite import demonstrations, plain
from offairl_lite.core.rollouts import rollout
from offairl_lite.runs import records
from rollouts import RECORDS

LEFT, RIGHT = "offairl/PointMazeLeft-v0", "offairl/PointMazeRight-v0"
LAST = 20
"""Steps at the end of an episode of 100, when it has come to rest."""
EVERY = {"star": 20, "wall": 10}
"""One in so many of these steps is drawn."""


def record():
    """Return paths, places of rest, returns, and log π."""
    imitation = records.read(RECORDS / "maze-imitation-demo")
    transfer = records.read(RECORDS / "maze-transfer-demo")
    released = records.read(RECORDS / "maze-imitation-released-loss-demo")
    carried = _episodes(imitation, RIGHT, 10)
    paths = {
        "learned": _episodes(imitation, LEFT, 1),
        "old": _episodes(imitation, RIGHT, 1),
        "new": _episodes(transfer, RIGHT, 1),
    }
    return {
        "paths": {
            name: _rounded(episodes.obs[0, 0, :, :2])
            for name, episodes in paths.items()
        },
        "rest": {
            "exact": _rest(_episodes(imitation, LEFT, 10)),
            "released": _rest(_episodes(released, LEFT, 5)),
        },
        "carried": carried.returns.mean(1),
        "log_pi": _log_pi(imitation),
        "retrained": _retrained(),
    }


def _episodes(run, task, count, sample=False):
    return rollout(run.policy, task, run.seeds, count, sample=sample)


def _rounded(x):
    return np.asarray(x, float).round(3)


def _rest(episodes):
    """Return where each seed's episodes come to rest, (S, 2)."""
    return episodes.next_obs[..., -LAST:, :2].mean((1, 2))


def _log_pi(run):
    """Return log π of each seed for the last steps of experts, at the star,
    and of its own episodes, at the wall; and y of these steps."""
    policy, seeds = run.policy, len(run.seeds)
    steps = demonstrations.load(LEFT, trajectories=50).transitions
    obs = steps.obs.view(50, 100, 3)[:, -LAST:].flatten(0, 1)
    u = steps.pre_tanh.view(50, 100, 2)[:, -LAST:].flatten(0, 1)
    own = _episodes(run, LEFT, 5, sample=True)
    own_obs = torch.tensor(own.obs[:, :, -LAST:]).float().flatten(1, 2)
    act = torch.tensor(own.action[:, :, -LAST:]).float().flatten(1, 2)
    own_u = torch.atanh(act.clamp(-0.999999, 0.999999))
    sides = {
        "star": (obs.expand(seeds, -1, -1), u.expand(seeds, -1, -1)),
        "wall": (own_obs, own_u),
    }
    found = {}
    for name, (at, pre_tanh) in sides.items():
        with torch.no_grad():
            value = policy.actor.log_prob(
                policy.params, policy.normaliser(at), pre_tanh
            )
        some = slice(None, None, EVERY[name])
        found[name] = {
            "mean": value.mean(1),
            "y": _rounded(at[:, some, 1]),
            "log_pi": value[:, some].numpy().astype(float).round(2),
        }
    return found


def _retrained():
    """Run the page's two trainings; return what the second one gives."""
    left, right = gymnasium.make(LEFT), gymnasium.make(RIGHT)
    demos = plain.Batch(
        *demonstrations.load(LEFT, trajectories=50).transitions
    )
    rng = torch.Generator().manual_seed(0)
    trained = plain.train(left, demos, rng, num_episodes=50, warmup=20)
    *_, (_, sac, airl, scale) = trained
    old = plain.policy_of(sac.actor, scale)
    rng = torch.Generator().manual_seed(0)
    new = _code_of("retrain")(right, airl.r, scale, rng)
    right.reset(seed=0)
    found = {}
    for name, policy in ("old", old), ("new", new):
        found[f"{name}_return"] = plain.evaluate(right, policy)
        found[f"{name}_paths"] = [
            _rounded(plain.run_episode(right, policy).obs[:, :2])
            for _ in range(3)
        ]
    return found


def _code_of(name):
    """Return a function that a visible cell of the page defines."""
    page = Path(__file__).parents[1] / "05_off_policy_airl.ipynb"
    cells = json.loads(page.read_text("utf-8"))["cells"]
    sources = ["".join(cell["source"]) for cell in cells]
    (source,) = [x for x in sources if x.startswith(f"def {name}(")]
    names = dict(vars(plain))
    exec(source, names)
    return names[name]
