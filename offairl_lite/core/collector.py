"""Collecting experience: every member acts in its own environment, and replay keeps it all."""

import logging
import warnings
from collections.abc import Callable, Sequence

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from offairl_lite.config import Config
from offairl_lite.core import absorbing
from offairl_lite.core.policies import Policy, unsquash
from offairl_lite.core.replay import Batch, Replay
from offairl_lite.core.rng import Rng
from offairl_lite.core.rollouts import require_sound
from offairl_lite.envs import BatchedEnv, SerialEnv

log = logging.getLogger(__name__)


class Members:
    """Which members of the population are still training.

    One whose numbers are not finite is given up: zeros for weights, so that it harms no other.
    """

    def __init__(self, seeds: Sequence[int], weights: dict[str, Tensor]) -> None:
        self.seeds, self.weights = tuple(seeds), weights
        self.diverged: dict[int, str] = {}

    @property
    def left(self) -> list[int]:
        """Indices of the members that are still training."""
        return [i for i, seed in enumerate(self.seeds) if seed not in self.diverged]

    def give_up(self, lost: Bool[Tensor, "S"], step: int, problem: str) -> None:
        """Go on without the members in `lost`; FloatingPointError if none is left."""
        for i in lost.nonzero().flatten().tolist():
            seed = self.seeds[i]
            if seed not in self.diverged:
                cure = "lower learning_rate or reward_scale; set temperature, if a learned one rose"
                why = f"seed {seed} diverged by step {step}: its {problem}; {cure} (curve.csv)"
                self.diverged[seed] = why
                warnings.warn(why, stacklevel=4)
        # Members that were given up still receive updates, so they are zeroed again.
        gone = [i for i, seed in enumerate(self.seeds) if seed in self.diverged]
        for tensor in self.weights.values():
            if gone and tensor.ndim > 1:
                tensor[..., gone, :] = 0
        if len(gone) == len(self.seeds):
            raise FloatingPointError("; ".join(self.diverged.values()))

    def give_up_not_finite(self, step: int) -> None:
        """Give up the members with weights that are not finite."""
        for name, tensor in self.weights.items():
            if name.endswith(".params"):
                # Two critics are a stack of two populations.
                broken = ~tensor.isfinite().all(-1).view(-1, len(self.seeds)).all(0)
                self.give_up(broken, step, f"{name.split('.')[1]} is not finite")


class Collector:
    """Acts with all members at once, after a guide if there is one, and fills the replay."""

    def __init__(
        self,
        config: Config,
        env: BatchedEnv | SerialEnv,
        replay: Replay,
        rng: Rng,
        members: Members,
        guide: Policy | None = None,
    ) -> None:
        self.config, self.env, self.replay = config, env, replay
        self.rng, self.members, self.guide = rng, members, guide
        self.absorbing = config.schedule.absorbing != "none"
        self.ends_matter = config.imitates and not config.learner.on_policy
        population, action_dim = len(members.seeds), env.single_action_space.shape[0]
        self.steps = 0
        self.episodes = torch.zeros(population, dtype=torch.long)
        self.held_action = torch.zeros(population, action_dim, device=rng.device)
        # For how many more steps the guide acts.
        self.guided = torch.zeros(population, dtype=torch.long)
        self._draw_guided_steps(np.ones(population, bool))
        self.obs = self._reset(np.ones(population, bool))

    @torch.no_grad()
    def step(
        self, explore: Callable[[Float[Tensor, "S O"]], Float[Tensor, "S A"]] | None
    ) -> Bool[np.ndarray, "S"]:
        """Act once, by `explore` (obs to `pre_tanh`) or at random; tell whose episodes ended."""
        obs = _float(self.obs).to(self.rng.device)
        obs = absorbing.extend(obs) if self.absorbing else obs
        if explore is None:  # Uniform actions, each held for `random_hold` steps on average.
            fresh = 2 * self.rng.uniform(self.held_action.shape[1]) - 1
            redraw = self.rng.uniform(1) < 1 / self.config.schedule.random_hold
            self.held_action = torch.where(redraw | (self.steps == 0), fresh, self.held_action)
            pre_tanh = unsquash(self.held_action)
        else:
            pre_tanh = explore(obs)
        finite = pre_tanh.isfinite()
        if not finite.all():
            self.members.give_up(~finite.all(-1), self.steps, "actions are not finite")
            pre_tanh = pre_tanh.where(finite, 0)
        action = torch.tanh(pre_tanh)
        if self.guide is not None and self.guided.any():
            guided = (self.guided > 0).to(action.device).unsqueeze(1)
            action = torch.where(guided, self.guide.act(obs.unsqueeze(1)).squeeze(1), action)
        next_obs, reward, terminated, truncated, _ = self.env.step(action.cpu().numpy())
        self._require_sound(observation=next_obs, reward=reward)
        parts = _float(self.obs), pre_tanh.cpu(), *map(_float, (next_obs, reward, terminated))
        # The guide's steps count, and are not learned from.
        unguided = (self.guided == 0).nonzero().squeeze(1)
        batch = Batch(*(part[unguided] for part in parts))
        ended = batch.terminated == 1
        if self.absorbing:
            batch = absorbing.rewrite(batch)
        elif self.ends_matter and ended.any():
            self.ends_matter = False  # It is said once.
            log.warning(
                f"An episode of {self.config.env_id} has terminated, and absorbing is 'none': the "
                "constant of the learned reward, which nobody chose, then decides between a long "
                "life and a short one. Set absorbing='bootstrap'."
            )
        self.replay.add(batch, unguided)
        if self.absorbing and ended.any():
            self.replay.add(absorbing.loops(batch), unguided[ended])
        self.guided = (self.guided - 1).clamp(min=0)
        done = terminated | truncated
        self._draw_guided_steps(done)
        self.obs = self._reset(done) if done.any() else next_obs
        self.steps += 1
        self.episodes += torch.from_numpy(done)
        return done

    def _reset(self, done: Bool[np.ndarray, "S"]) -> Float[np.ndarray, "S O"]:
        """Begin new episodes where one is done; return all observations."""
        obs, _ = self.env.reset(options={"reset_mask": done})
        self._require_sound(observation=obs)
        return obs

    def _require_sound(self, **readings: np.ndarray) -> None:
        """Raise ValueError if the task of a member that still trains gives a faulty number."""
        left = self.members.left
        seeds = [self.members.seeds[i] for i in left]
        sound = {name: reading[left] for name, reading in readings.items()}
        require_sound(self.config.env_id, f"step {self.steps}", seeds, **sound)

    def _draw_guided_steps(self, begins: Bool[np.ndarray, "S"]) -> None:
        """Draw for how long the guide acts in the episodes that begin."""
        if most := self.config.schedule.guide_steps:
            for i in np.flatnonzero(begins).tolist():
                self.guided[i] = self.rng.integer(i, most + 1)

    def state(self) -> dict[str, Tensor]:
        """Return what the next step depends on, the rows of the replay apart."""
        env = {f"env.{name}": torch.as_tensor(x) for name, x in self.env.get_state().items()}
        counts = {"episodes": self.episodes, "held_action": self.held_action, "guided": self.guided}
        return {**counts, "obs": torch.as_tensor(self.obs), "added": self.replay.added, **env}

    def restore(self, steps: int, state: dict[str, Tensor]) -> None:
        """Go on after `steps` steps from a state."""
        self.steps, self.obs = steps, state["obs"].numpy()
        for name in ("episodes", "held_action", "guided"):
            getattr(self, name).copy_(state[name])
        self.replay.added.copy_(state["added"])
        self.env.set_state({name: x.numpy() for name, x in part_of(state, "env").items()})


def part_of(state: dict[str, Tensor], name: str) -> dict[str, Tensor]:
    """Return the part of a state whose names begin with `name.`, without that."""
    prefix = f"{name}."
    return {key.removeprefix(prefix): x for key, x in state.items() if key.startswith(prefix)}


def _float(array: np.ndarray) -> Tensor:
    return torch.from_numpy(array.astype(np.float32))
