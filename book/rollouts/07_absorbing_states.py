"""Hoppers with and without an absorbing state: short trainings, how long
the policies stay up, what their rewards say of the end, and a film.
"""

from contextlib import closing

import torch

from offairl_lite import demonstrations, envs, experiments
from offairl_lite.core import absorbing
from offairl_lite.core.loop import train
from offairl_lite.core.rollouts import rollout
from offairl_lite.runs import records
from rollouts import RECORDS

TASK, SEEDS = "Hopper-v5", (0, 1, 2, 3, 4)
SPEED, SECONDS = 5, 0.008
"""Where observations have the torso's speed, and how long a step takes."""
FALLING = "hopper-none-demo/Hopper-released-fixed-short"


def record():
    """Return curves, lengths of episodes, rewards, and a film's poses."""
    shown = demonstrations.load(TASK, experts=1)
    runs = {
        "with": _short("bootstrap", shown),
        "without": _short("none", shown),
    }
    falling = records.read(RECORDS / FALLING)
    episodes = rollout(falling.policy, TASK, falling.seeds, 10)
    return {
        "short": {
            name: {"steps": run.steps, "returns": run.returns}
            for name, run in runs.items()
        },
        "lengths": episodes.lengths,
        "pays": {
            name: _against_the_end(run, shown) for name, run in runs.items()
        },
        "film": {
            "expert": _poses(demonstrations.expert(TASK).member(0)),
            **{name: _poses(_median(run)) for name, run in runs.items()},
        },
        "demonstrations_that_fall": sum(n < 1_000 for n in shown.lengths),
    }


def _short(absorbing_state, shown):
    """Return hoppers after 8,000 steps."""
    recipe = experiments.find("imitate").configs["demo"]
    config = recipe.change(
        env_id=TASK,
        absorbing=absorbing_state,
        train_every=1_000,
        total_steps=8_000,
        eval_every=1_000,
        eval_episodes=3,
    )
    return train(config, SEEDS, shown, progress=False)


def _median(run):
    """Return the policy of the median seed of five."""
    return run.policy.member(int(run.returns[:, -1].argsort()[2]))


def _against_the_end(run, shown):
    """Return mean r of demonstrated and of own steps, minus the end's."""
    S = len(run.seeds)
    known = run.config.schedule.absorbing != "none"
    episodes = rollout(run.policy, TASK, run.seeds, 3)
    own = torch.tensor(episodes.obs, dtype=torch.float32).flatten(1, 2)
    alive = torch.tensor(episodes.running).flatten(1, 2)
    theirs, end = shown.transitions.obs.expand(S, -1, -1), torch.zeros(S, 1)
    if known:
        own, theirs = absorbing.extend(own), absorbing.extend(theirs)
        s_a = absorbing.absorbing_state(torch.zeros(S, 1, 12))
        end = run.reward(s_a)
    own = (run.reward(own) * alive).sum(1) / alive.sum(1)
    demonstrated = run.reward(theirs).mean(1)
    return {
        "demonstrated": demonstrated - end[:, 0],
        "own": own - end[:, 0],
    }


def _poses(policy, steps=400, every=12):
    """Return poses of a policy without noise, its farthest metre so far,
    and its falls; each fall begins a new episode."""
    found = {"pose": [], "farthest": [], "falls": []}
    with closing(envs.make(TASK, 1, 0)) as env:
        obs, _ = env.reset()
        metres, farthest, falls = 0.0, 0.0, 0
        for step in range(steps):
            if step % every == 0:
                found["pose"].append(env.get_state()["physics"][0])
                found["farthest"].append(round(farthest, 2))
                found["falls"].append(falls)
            x = torch.as_tensor(obs, dtype=torch.float32)
            act = policy.act(x.unsqueeze(1)).squeeze(1)
            obs, _, terminated, _, _ = env.step(act.numpy())
            metres += SECONDS * float(obs[0, SPEED])
            farthest = max(farthest, metres)
            if terminated[0]:
                metres, falls = 0.0, falls + 1
                obs, _ = env.reset(options={"reset_mask": terminated})
    return found
