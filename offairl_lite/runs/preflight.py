"""What can be known of a run before its first step: what does not fit, and what will go wrong.

A task is made once for that, however many seeds there are.
"""

from collections.abc import Mapping, Sequence
from contextlib import closing
from types import SimpleNamespace
from typing import Any

import numpy as np
from gymnasium.spaces import Box

from offairl_lite import envs
from offairl_lite.config import Config, DiscriminatorConfig
from offairl_lite.core.requirements import Inputs, require_inputs, require_match
from offairl_lite.core.rewards import IMPLEMENTATIONS
from offairl_lite.core.rollouts import LONGEST, require_end
from offairl_lite.demonstrations import Demonstrations


def try_out(env_id: str, seed: int) -> list[str]:
    """Return what a user should know of a task, after it was made and stepped.

    Raises:
        ValueError: an episode of random actions never ends.
        envs.TaskError: the task itself fails.
    """
    notes = []
    with closing(envs.make(env_id, 1, [seed])) as env:
        if names := envs.parts(env_id):
            order = f"flattened in the order {', '.join(names)}"
            notes.append(f"{env_id}: observations are dictionaries, {order}")
        env.reset()
        width, rng, steps = env.single_action_space.shape, np.random.default_rng(seed), 0
        *_, terminated, truncated, _ = env.step(np.full((1, *width), 0.5, np.float32))
        try:
            if not (terminated[0] or truncated[0]):
                env.set_state(env.get_state())
        except ValueError as error:  # It trains nevertheless.
            notes.append(str(error))
        if envs.spec(env_id).max_episode_steps is None:
            notes.append(
                f"{env_id} has no time limit: an episode that does not end is an error after "
                f"{LONGEST:,} steps, which one of random actions has not reached"
            )
            env.reset(seed=seed)
            ended = False
            while not ended:
                require_end(env_id, steps, LONGEST)
                action = rng.uniform(-1, 1, width).astype(np.float32)
                *_, terminated, truncated, _ = env.step(action[None])
                ended, steps = bool(terminated[0] or truncated[0]), steps + 1
    return notes


def check(
    config: Config, seeds: Sequence[int], demos: Demonstrations | None, networks: Mapping[str, Any]
) -> list[str]:
    """Return what a user should know of a run on `demos` and `networks` of other runs.

    The task is not made for that, if it was tried out. ValueError says what does not fit.
    """
    seen, units = envs.spaces(config.env_id)
    scaled = Box(-np.ones_like(units.low), np.ones_like(units.low))
    env: Any = SimpleNamespace(single_observation_space=seen, single_action_space=scaled)
    inputs = Inputs(demos, **networks)
    require_inputs(config, seeds, inputs)
    require_match(config, env, inputs)
    if demos is None:
        return []
    notes, ends = [], int(demos.transitions.terminated.sum())
    own_data = (demos.source or {"dataset": ""})["dataset"] is not None
    if ends and own_data and config.schedule.absorbing == "none":
        notes.append(
            f"{ends} of {len(demos)} demonstrations terminate; to learn that something comes after "
            "the end, set absorbing='bootstrap' (\"Can an episode end early?\" in book/recipe.md)"
        )
    if sees_actions(config) and (np.ptp(demos.transitions.action.numpy(), axis=0) == 0).all():
        notes.append(
            f"all demonstrated actions are the same, and with reward={config.reward!r} they tell "
            "the expert from the policy: where actions are not known, use the recipe "
            "(reward='r-s', loss='log-ratio') or ablation='state-pairs'"
        )
    return notes


def sees_actions(config: Config) -> bool:
    """Tell whether demonstrated actions matter to a run."""
    if not isinstance(config.discriminator, DiscriminatorConfig):
        return config.imitates
    if config.discriminator.kind == "state-pairs":
        return False
    kind = IMPLEMENTATIONS.get(config.reward)
    return kind is None or not kind.state_only or config.discriminator.loss != "log-ratio"
