"""What discriminator and learner are trained on: minibatches, scaled once, where they are drawn.

Beside each transition stands log π for the discriminator, and for the learner what it is paid.
Minibatches are drawn `CHUNK` at a time, so that log π and rewards are computed in one pass: both
stay as they are during a block.
"""

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch

from offairl_lite.config import Config
from offairl_lite.config.groups import Labels, OffPolicyConfig
from offairl_lite.core import absorbing
from offairl_lite.core.discriminator import Discriminator, Mixing, Transitions
from offairl_lite.core.networks import Normaliser
from offairl_lite.core.replay import Batch, LogDensity, Replay, chunks, sample, split
from offairl_lite.core.rng import Rng
from offairl_lite.core.shapes import Numbers, Vector


def scaling_of(config: Config, replay: Replay, demonstrations: Batch | None) -> Normaliser:
    """Return the scaling by what each member has seen and, half and half, what it was shown.

    The absorbing state is left out; a reading that would scale away all others is warned of.
    """
    population = len(replay.added)
    if not config.schedule.normalise:
        return Normaliser.identity(population, replay.obs_dim, replay.device)
    members = []
    for i in range(population):
        sources = [batch.obs for batch in (replay.held(i), demonstrations) if batch is not None]
        if config.schedule.absorbing != "none":
            sources = [obs[~absorbing.is_absorbing(obs)] for obs in sources]
        far = (sources[0] - sources[0].median(0).values).abs()
        # Beside 1, too: what hardly moves, such as a thing at rest, may well be pushed.
        for step, j in (far > 1e5 * far.median(0).values.clamp(min=1)).nonzero()[:1].tolist():
            reading = f"observation[{j}] of member {i} of {config.env_id} is"
            reading += f" {sources[0][step, j]:.6g} in step {step} of the warm-up"
            why = "half of the others differ by less than a 100,000th of that, and would look alike"
            warnings.warn(f"{reading}: {why}; mend the task", stacklevel=2)
        members.append(Normaliser.of(*(obs.unsqueeze(0) for obs in sources)))
    return Normaliser(*map(torch.cat, zip(*members, strict=True)))


def labelled(expert: Batch, policy: Batch, size: int) -> Batch:
    """Return minibatches `S B`, half expert, paid 1, half replay, paid 0 (Reddy et al. 2020)."""
    expert = expert._replace(reward=torch.ones_like(expert.reward))
    policy = policy._replace(reward=torch.zeros_like(policy.reward))
    pairs = zip(expert, policy, strict=True)
    halves = ([part.unflatten(1, (-1, size)) for part in pair] for pair in pairs)
    return Batch(*(torch.cat(pair, 2).flatten(1, 2) for pair in halves))


def analytic_return(reward: Numbers, absorbing_reward: Numbers, discount: float) -> Numbers:
    """Return R_T: the last reward, and the absorbing state's for ever after."""
    return reward + discount * absorbing_reward / (1 - discount)


def with_analytic_return(batch: Batch, absorbing_reward: Numbers, discount: float) -> Batch:
    """Return transitions, of which those to the absorbing state are paid R_T, and end there."""
    ends = absorbing.is_absorbing(batch.next_obs)
    total_return = analytic_return(batch.reward, absorbing_reward, discount)
    reward = batch.reward.where(~ends, total_return)
    return batch._replace(reward=reward, terminated=batch.terminated.where(~ends, 1))


@dataclass(frozen=True)
class Experience:
    """The demonstrations and the replay of a population, for one block of training."""

    config: Config
    replay: Replay
    demonstrations: Batch | None  #: The expert's transitions, axes `N`.
    normaliser: Normaliser  #: Scales every observation.
    rng: Rng  #: Draws the minibatches.
    discriminator: Discriminator | None  #: There if a reward is learned.
    log_density: LogDensity  #: log π of scaled transitions, as it was when the block began.
    reward: Callable[[Batch, Batch], Vector]  #: What the learner is paid (`Trainer.paid`).

    def scaled(self, batch: Batch) -> Batch:
        """Return transitions as networks see them."""
        obs, next_obs = self.normaliser(batch.obs), self.normaliser(batch.next_obs)
        return batch._replace(obs=obs, next_obs=next_obs)

    def discriminator_minibatches(
        self, steps: int
    ) -> Iterator[tuple[Transitions, Transitions, Mixing]]:
        """Yield minibatches of expert and policy, as many as are set or as the block has steps."""
        discriminator, rng = self.discriminator, self.rng
        if discriminator is None or self.demonstrations is None:
            return
        size = self.config.schedule.batch_size
        for minibatches in chunks(discriminator.config.updates or steps):
            count = minibatches * size
            drawn = sample(self.demonstrations, rng, count), self.replay.sample(rng, count)
            mixing = rng.uniform(count, 4)
            sides = []
            for batch in map(self.scaled, drawn):
                needed = discriminator.needs_log_prob
                log_prob = self.log_density(batch) if needed else torch.zeros_like(batch.reward)
                sides.append(split(discriminator.transitions(batch, log_prob), size))
            yield from zip(*sides, mixing.split(size, 1), strict=True)

    def paid(self, batch: Batch) -> Batch:
        """Return scaled transitions, and what they pay: with absorbing='analytic' the last, R_T."""
        learner, scaled = self.config.learner, self.scaled(batch)
        r = learner.reward_scale * self.reward(batch, scaled)
        centred = isinstance(learner, OffPolicyConfig) and learner.centre_reward
        mean = r.mean(1, keepdim=True) if centred else 0
        paid = scaled._replace(reward=r - mean)
        if self.config.schedule.absorbing != "analytic":
            return paid
        loop = absorbing.loop_of(batch)
        absorbing_reward = learner.reward_scale * self.reward(loop, self.scaled(loop)) - mean
        return with_analytic_return(paid, absorbing_reward, learner.discount)

    def minibatches(self, count: int) -> list[Batch]:
        """Draw so many minibatches for the learner; SQIL's and IQ-Learn's are twice as large."""
        size = self.config.schedule.batch_size
        batch = self.replay.sample(self.rng, count * size)
        if isinstance(self.config.discriminator, Labels) and self.demonstrations is not None:
            expert = sample(self.demonstrations, self.rng, count * size)
            batch, size = labelled(expert, batch, size), 2 * size
        return split(self.paid(batch), size)

    def last(self, count: int) -> Batch:
        """Return the last so many transitions of each member for the learner, in order."""
        return self.paid(self.replay.last(count))
