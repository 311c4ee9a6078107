"""Behavioural cloning (Pomerleau 1991): it needs actions, and takes no step of the task."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor
from tqdm.auto import trange

from offairl_lite.config.settings import Count, Positive, Sizes, checked
from offairl_lite.core import absorbing
from offairl_lite.core.networks import Adam, Normaliser, descend
from offairl_lite.core.policies import Policy, SquashedGaussian
from offairl_lite.core.rng import Rng
from offairl_lite.core.shapes import Action, Params, PerMember
from offairl_lite.demonstrations import Demonstrations

CHECK_EVERY = 100  #: Minibatches between two looks at the transitions that are held out.


def cloning_loss(mean: Action, pre_tanh: Action) -> PerMember:
    """Return E ‖tanh μ(s) - a‖², where a = tanh(u) was demonstrated: what the mode is off by.

    With a likelihood, σ(s) would compete with the mode for layers, and actions near ±1 decide.
    """
    return (torch.tanh(mean) - torch.tanh(pre_tanh)).square().sum(-1).mean(-1)


def set_noise(actor: SquashedGaussian, params: Params, noise: Action) -> None:
    """Give the actor the same σ everywhere, in place: that of typical `noise`, u - μ(s)."""
    low, high = actor.log_std_range
    # A median, since of actions near ±1 u says little.
    log_std = (1.48 * noise.abs().median(1).values).log().clamp(low + 0.01, high - 0.01)
    bias, weight = actor.net.layers(params)[-1]
    bias[:, 0, actor.action_dim :] = torch.atanh(2 * (log_std - low) / (high - low) - 1)
    weight[..., actor.action_dim :] = 0


def held_out(lengths: Sequence[int]) -> Bool[Tensor, "N"]:
    """Tell which say when to stop: a tenth of every episode, in one piece: neighbours are alike."""
    marks = []
    for i, length in enumerate(lengths):
        mark, size = np.zeros(length, bool), length // 10
        start = np.random.default_rng((0, i)).integers(length - size + 1)
        mark[start : start + size] = True
        marks.append(mark)
    return torch.from_numpy(np.concatenate(marks))


def clone(
    demonstrations: Demonstrations,
    seeds: Sequence[int],
    *,
    hidden: Sizes = (256, 256),
    steps: int = 5_000,
    patience: int = 1_000,
    batch_size: int = 256,
    learning_rate: float = 1e-3,
    absorbing_state: bool = False,
    progress: bool = True,
) -> Policy:
    """Return a population of policies that imitate demonstrated actions.

    Args:
        demonstrations: what to imitate, with actions.
        seeds: of the members.
        hidden: layers of the actor, ReLU; as those of a run that is to go on with it.
        steps: the most minibatches.
        patience: a member stops when its loss on held-out transitions has not fallen for so many
            minibatches, and keeps the weights with which it was lowest.
        batch_size: transitions of a minibatch.
        learning_rate: Adam's.
        absorbing_state: whether the policy sees the absorbing state's indicator, for a run with
            `absorbing` that goes on with it (`pretrained="policy"`).
        progress: whether a bar is shown.

    Raises:
        ValueError: an argument is not valid.
    """
    for name, count in (("steps", steps), ("patience", patience), ("batch_size", batch_size)):
        checked(name, count, Count)
    population = len(seeds)
    obs, pre_tanh, *_ = demonstrations.transitions
    # Thinned demonstrations have each transition several times, of which one is enough here.
    distinct = torch.cat([torch.ones(1, dtype=torch.bool), (obs[1:] != obs[:-1]).any(1)])
    lengths = [int(episode.sum()) for episode in distinct.split(demonstrations.lengths)]
    obs, pre_tanh = obs[distinct], pre_tanh[distinct]
    obs = absorbing.extend(obs) if absorbing_state else obs
    scaling = Normaliser(*(part.repeat(population, 1, 1) for part in Normaliser.of(obs[None])))
    obs, out = scaling(obs.expand(population, -1, -1)), held_out(lengths)
    learned, rng = (~out).nonzero().squeeze(1), Rng(seeds)
    actor = SquashedGaussian(obs.shape[-1], pre_tanh.shape[-1], checked("hidden", hidden, Sizes))
    optimizer = Adam(actor.init(rng), checked("learning_rate", learning_rate, Positive))
    lowest, best = torch.full((population,), torch.inf), optimizer.params.detach().clone()
    at = torch.zeros(population, dtype=torch.long)  # where it was lowest

    def loss(rows: Tensor) -> PerMember:
        index = torch.arange(population).unsqueeze(1), rows
        mean, _ = actor.distribution(optimizer.params, obs[index])
        return cloning_loss(mean, pre_tanh[rows])

    for step in trange(1, steps + 1, desc="cloning", disable=not progress):
        rows = learned[rng.integers([len(learned)] * population, batch_size)]
        descend(loss(rows).sum(), optimizer)
        if step % CHECK_EVERY and step < steps:
            continue
        with torch.no_grad():
            now = loss((out if out.any() else ~out).nonzero().T.expand(population, -1))
            better = (now < lowest) & (lowest.isinf() | (step - at <= patience))
            lowest[better], best[better], at[better] = now[better], optimizer.params[better], step
        if (step - at >= patience).all():
            break
    set_noise(actor, best, pre_tanh - actor.distribution(best, obs)[0])
    return Policy(demonstrations.env_id, actor, best, scaling)
