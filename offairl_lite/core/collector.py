"""Collecting experience: every member acts in its own environment, and replay keeps it all."""

import logging
import warnings
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
import torch
from gymnasium.vector import VectorEnv
from jaxtyping import Bool, Float, Int
from torch import Tensor

from offairl_lite.config import Config, PPOConfig
from offairl_lite.core import absorbing
from offairl_lite.core.policies import Policy, unsquash
from offairl_lite.core.replay import Batch, Replay
from offairl_lite.core.rng import Rng

log = logging.getLogger(__name__)


class Members:
    """Which members of the population are still training.

    A member whose numbers are no longer finite is given up. Its weights become zeros, so that it
    does no harm to the others, with which it goes on being computed.

    Args:
        seeds: one for each member.
    """

    def __init__(self, seeds: Sequence[int]) -> None:
        self.seeds = tuple(seeds)
        self.diverged: dict[int, str] = {}
        self.weights: Callable[[], dict[str, Tensor]] = dict
        """Returns the tensors that training changes, once there are some."""

    @property
    def lost(self) -> Bool[Tensor, "S"]:
        """Which members have been given up."""
        return torch.tensor([seed in self.diverged for seed in self.seeds])

    @property
    def left(self) -> list[int]:
        """Indices of the members that are still training."""
        return [i for i, seed in enumerate(self.seeds) if seed not in self.diverged]

    def give_up(self, lost: Bool[Tensor, "S"], step: int, what: str, cure: str) -> None:
        """Go on without some members.

        Args:
            lost: which; to name a member twice does no harm.
            step: environment steps so far.
            what: is not finite.
            cure: what a user can do about it.

        Raises:
            FloatingPointError: no member is left.
        """
        for member in lost.nonzero().flatten().tolist():
            for tensor in self.weights().values():
                if tensor.ndim > 1:
                    tensor[..., member, :] = 0
            seed = self.seeds[member]
            if seed not in self.diverged:
                self.diverged[seed] = (
                    f"seed {seed} diverged by step {step}: its {what} is not finite; {cure}"
                )
                warnings.warn(self.diverged[seed], stacklevel=4)
        if len(self.diverged) == len(self.seeds):
            raise FloatingPointError("; ".join(self.diverged.values()))


@cache
def _say_that_ends_matter(env_id: str) -> None:
    """Log, once, that nothing says what the end of an episode is worth."""
    log.warning(
        "An episode of %s has terminated, and absorbing is 'none': the constant of the learned "
        "reward, which nobody chose, then decides between a long life and a short one. Set "
        "absorbing='bootstrap' (chapter 7).",
        env_id,
    )


class Collector:
    """Acts with all members at once and fills the replay.

    Args:
        config: of the run.
        env: as many environments as members.
        replay: where transitions go.
        rng: for warm-up actions, exploration noise and the guide.
        members: those whose task gives numbers that are not finite are given up.
        guide: a policy that acts first in each episode, where `start_steps` is not 0.
    """

    def __init__(
        self,
        config: Config,
        env: VectorEnv,
        replay: Replay,
        rng: Rng,
        members: Members,
        guide: Policy | None = None,
    ) -> None:
        self.config, self.schedule = config, config.schedule
        self.env, self.replay, self.rng, self.members = env, replay, rng, members
        self.guide = guide
        population = len(members.seeds)
        self.action_dim = env.single_action_space.shape[0]
        self.steps = 0
        self.episodes = torch.zeros(population, dtype=torch.long)
        self.held_action = torch.zeros(population, self.action_dim, device=rng.device)
        # For how many more steps the guide acts.
        self.guided = torch.zeros(population, dtype=torch.long)
        self._draw_guided_steps(np.ones(population, bool))
        (self.obs,) = self._finite(env.reset()[0])

    @torch.no_grad()
    def step(self, explore: Callable[[Float[Tensor, "S O"]], Float[Tensor, "S A"]] | None):
        """Act once with every member and store the transitions.

        Args:
            explore: from observations, as networks see them, to `pre_tanh`; None during the
                warm-up, whose actions are uniform.

        Returns:
            Whose episode has ended, a boolean array `(S,)`.
        """
        obs = self.seen(self.obs)
        pre_tanh = self._warmup_action() if explore is None else explore(obs)
        action = torch.tanh(pre_tanh)
        if self.guided.any():
            guided = (self.guided > 0).to(action.device).unsqueeze(1)
            action = torch.where(guided, self.guide.act(obs.unsqueeze(1)).squeeze(1), action)
        next_obs, reward, terminated, truncated, _ = self.env.step(action.cpu().numpy())
        next_obs, reward = self._finite(next_obs, reward)
        batch = Batch(
            _float(self.obs), pre_tanh.cpu(), _float(next_obs), _float(reward), _float(terminated)
        )
        # The guide's steps count, and are not learned from.
        own = (self.guided == 0).nonzero().squeeze(1)
        self._store(Batch(*(part[own] for part in batch)), own)
        self.guided = (self.guided - 1).clamp(min=0)
        done = terminated | truncated
        self._draw_guided_steps(done)
        self.obs = next_obs
        if done.any():
            (self.obs,) = self._finite(self.env.reset(options={"reset_mask": done})[0])
        self.steps += 1
        self.episodes += torch.from_numpy(done)
        return done

    def _warmup_action(self) -> Float[Tensor, "S A"]:
        """Return uniform actions, each held for `warmup_hold` steps on average."""
        fresh = 2 * self.rng.uniform(self.action_dim) - 1
        redraw = self.rng.uniform(1) < 1 / self.schedule.warmup_hold
        self.held_action = torch.where(redraw | (self.steps == 0), fresh, self.held_action)
        return unsquash(self.held_action)

    def seen(self, obs: np.ndarray) -> Float[Tensor, "S O"]:
        """Return observations as networks see them, with the absorbing indicator if any."""
        seen = _float(obs).to(self.rng.device)
        return seen if self.schedule.absorbing == "none" else absorbing.extend(seen)

    def _finite(self, *given: np.ndarray) -> Sequence[np.ndarray]:
        """Return what the task gives with NaN replaced; the members concerned are given up."""
        finite = np.all([np.isfinite(x).reshape(len(x), -1).all(1) for x in given], axis=0)
        if finite.all():
            return given
        lost, cure = torch.from_numpy(~finite), f"mend {self.config.env_id}"
        self.members.give_up(lost, self.steps, "observation or reward", cure)
        return [np.nan_to_num(x) for x in given]

    def _draw_guided_steps(self, begins: Bool[np.ndarray, "S"]) -> None:
        """Draw for how long the guide acts in the episodes that begin."""
        if self.schedule.start_steps:
            for i in np.flatnonzero(begins):
                self.guided[i] = self.rng.integer(i, self.schedule.start_steps + 1)

    def _store(self, batch: Batch, members: Int[Tensor, "M"]) -> None:
        if self.schedule.absorbing != "none":
            batch = absorbing.rewrite(batch)
            self.replay.add(batch, members)
            ended = absorbing.is_absorbing(batch.next_obs).nonzero().squeeze(1)
            if len(ended):
                self.replay.add(absorbing.loops(batch), members[ended])
            return
        off_policy = not isinstance(self.config.learner, PPOConfig)
        if off_policy and self.config.learns_reward and batch.terminated.any():
            _say_that_ends_matter(self.config.env_id)
        self.replay.add(batch, members)

    def state(self) -> dict[str, Tensor]:
        """Return what the next step depends on, the rows of the replay apart."""
        return {
            "episodes": self.episodes,
            "held_action": self.held_action,
            "guided": self.guided,
            "obs": torch.as_tensor(self.obs),
            "added": self.replay.added,
            **{f"env.{name}": torch.as_tensor(x) for name, x in self.env.get_state().items()},
        }

    def restore(self, steps: int, state: dict[str, Tensor]) -> None:
        """Go on after `steps` steps from a state."""
        self.steps, self.obs = steps, state["obs"].numpy()
        for name in ("episodes", "held_action", "guided"):
            getattr(self, name).copy_(state[name])
        self.replay.added.copy_(state["added"])
        prefix = "env."
        env = {k.removeprefix(prefix): x.numpy() for k, x in state.items() if k.startswith(prefix)}
        self.env.set_state(env)


def _float(array: np.ndarray) -> Tensor:
    return torch.from_numpy(array.astype(np.float32))
