"""The program of chapters 2 to 5: its mathematics, its training, and that `core` does the same."""

import math
from dataclasses import replace

import gymnasium
import pytest
import torch

from offairl_lite import envs, plain
from offairl_lite.config import CORRECTED
from offairl_lite.core import replay as core_replay
from offairl_lite.core.discriminator import Discriminator as CoreDiscriminator
from offairl_lite.core.networks import Normaliser as CoreNormaliser
from offairl_lite.core.rng import Streams
from offairl_lite.core.sac import SAC as CoreSAC

OBS, ACT, B = 3, 2, 64


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def random_batch(rng, count=B):
    obs, u, next_obs = (torch.randn(count, n, generator=rng) for n in (OBS, ACT, OBS))
    reward = torch.randn(count, generator=rng)
    terminated = (torch.rand(count, generator=rng) < 0.25).float()
    return plain.Batch(obs, u, next_obs, reward, terminated)


# What the comparison needs of `core` is in these four functions.

CORE_CONFIG = replace(
    CORRECTED, hidden=(64, 64), reward_hidden=(64, 64), shaping_hidden=(64, 64),
    temperature=None, target_entropy=-1.0, target_rate=0.01,
)  # fmt: skip


def core_learners():
    """Return SAC and a discriminator of one member, whose observations are scaled already."""
    streams, scale = Streams([0]), CoreNormaliser.identity(1, OBS)
    return (kind(CORE_CONFIG, OBS, ACT, streams, scale) for kind in (CoreSAC, CoreDiscriminator))


def core_networks(sac, discriminator):
    """Return architecture and weights, shape (1, P), of each network, by its name in `plain`."""
    critic, discriminating = sac.critic.net, (discriminator.reward_net, discriminator.value_net)
    return {
        "actor": (sac.actor.net, sac.actor_params),
        "critic 1": (critic, sac.critic_params[0]),
        "critic 2": (critic, sac.critic_params[1]),
        "slow critic 1": (critic, sac.target_params[0]),
        "slow critic 2": (critic, sac.target_params[1]),
        "reward": (discriminating[0], discriminator.reward_params),
        "value": (discriminating[1], discriminator.value_params),
    }


def core_weights(net, params):
    """Return bias (out,) and weight (out, in) of each layer."""
    return [(bias[0, 0], weight[0].T) for bias, weight in net.layers(params.detach())]


def core_update(sac, discriminator, expert, policy, mix, noise):
    """Update the discriminator, then SAC on its reward."""
    expert, policy = (core_replay.Batch(*(x[None] for x in side)) for side in (expert, policy))
    log_probs = sac.log_prob(expert), sac.log_prob(policy)
    discriminator.update(expert, policy, *log_probs, mix[None].expand(1, B, 4))
    reward = discriminator.reward(policy, None)
    sac.update(policy, reward, torch.zeros(1, 1), noise[:, None])


def plain_networks(sac, discriminator):
    nets = sac.actor.net, *sac.critic.nets, *sac.slow_critic.nets
    names = "actor", "critic 1", "critic 2", "slow critic 1", "slow critic 2", "reward", "value"
    return dict(zip(names, (*nets, discriminator.reward, discriminator.value), strict=True))


def linear(net):
    return [layer for layer in net if isinstance(layer, torch.nn.Linear)]


@pytest.fixture
def double():
    """Numbers in double precision: Adam magnifies the rounding of gradients that are almost 0."""
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)


@pytest.mark.usefixtures("double")
def test_core_with_one_member_takes_the_same_steps():
    rng = generator()
    sac, discriminator = plain.SAC(OBS, ACT, rng), plain.Discriminator(OBS, rng)
    optimizer = discriminator.optimizer
    core = tuple(core_learners())
    ours = plain_networks(sac, discriminator)
    with torch.no_grad():
        for name, network in core_networks(*core).items():
            pairs = zip(linear(ours[name]), core_weights(*network), strict=True)
            for layer, (bias, weight) in pairs:
                layer.bias.copy_(bias)
                layer.weight.copy_(weight)
    start = {name: [layer.weight.clone() for layer in linear(net)] for name, net in ours.items()}

    for _ in range(50):
        expert, policy = random_batch(rng), random_batch(rng)
        mix = torch.rand(B, 1, generator=rng)
        noise = torch.randn(2, B, ACT, generator=rng)
        core_update(*core, expert, policy, mix, noise)
        log_probs = sac.actor.log_prob(expert), sac.actor.log_prob(policy)
        loss = plain.airl_loss(discriminator.f, expert, policy, log_probs, mix)
        plain.descend(loss, optimizer)
        sac.update(policy, discriminator.r(policy.obs).detach(), noise)

    for name, network in core_networks(*core).items():
        pairs = zip(linear(ours[name]), core_weights(*network), start[name], strict=True)
        for layer, (bias, weight), before in pairs:
            torch.testing.assert_close(layer.bias, bias, rtol=0, atol=1e-8)
            torch.testing.assert_close(layer.weight, weight, rtol=0, atol=1e-8)
            assert (layer.weight - before).abs().max() > 1e-3, name
    torch.testing.assert_close(sac.log_alpha, core[0].log_alpha[0, 0])
