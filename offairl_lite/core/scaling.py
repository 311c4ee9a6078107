"""How observations are scaled: by the warm-up and the demonstrations."""

import warnings

import torch
from jaxtyping import Float
from torch import Tensor

from offairl_lite.config import Config
from offairl_lite.core import absorbing
from offairl_lite.core.networks import Normaliser
from offairl_lite.core.policies import Policy
from offairl_lite.core.replay import Batch, Replay
from offairl_lite.core.rewards import Reward


def scaling_of(
    config: Config, replay: Replay, demonstrations: Batch | None, pretrained: Policy | Reward | None
) -> Normaliser:
    """Return the scaling by what each member has seen and, half and half, what it was shown.

    The absorbing state, which is no place on the map, is left out. A pretrained policy, or reward,
    keeps its own scaling.
    """
    if pretrained is not None:
        return pretrained.normaliser
    population = len(replay.added)
    if not config.schedule.normalise:
        return Normaliser.identity(population, replay.obs_dim, replay.device)
    members = []
    for i in range(population):
        sources = [batch.obs for batch in (replay.held(i), demonstrations) if batch is not None]
        if config.schedule.absorbing != "none":
            sources = [obs[~absorbing.is_absorbing(obs)] for obs in sources]
        _warn_of_outliers(sources[0], f"member {i} of {config.env_id}")
        members.append(Normaliser.of(*(obs.unsqueeze(0) for obs in sources)))
    return Normaliser(*map(torch.cat, zip(*members, strict=True)))


def _warn_of_outliers(obs: Float[Tensor, "N O"], whose: str) -> None:
    """Warn of a reading that scales all others of the warm-up to almost nothing."""
    far = (obs - obs.median(0).values).abs()
    # Beside 1, too: what hardly moves, such as a thing at rest, may well be pushed.
    for step, j in (far > 1e5 * far.median(0).values.clamp(min=1)).nonzero()[:1].tolist():
        reading = f"observation[{j}] of {whose} is {obs[step, j]:.6g} in step {step} of the warm-up"
        why = "half of the others differ by less than a 100,000th of that, and would look alike"
        warnings.warn(f"{reading}: {why}; mend the task", stacklevel=2)
