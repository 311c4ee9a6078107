"""Discriminators of every kind, small ones, and something to show them."""

import torch

from offairl_lite.ablations.released import RELEASE
from offairl_lite.config import CORRECTED
from offairl_lite.core.discriminator import make_discriminator
from offairl_lite.core.networks import Normaliser
from offairl_lite.core.policies import SquashedGaussian
from offairl_lite.core.replay import Batch
from offairl_lite.core.rng import Rng
from offairl_lite.core.shapes import Layout
from other_bounds import Bottleneck, SpectralNorm

OBS, ACT, B = 3, 2, 4
SMALL = {"reward_hidden": (6, 5), "shaping_hidden": (4,), "batch_size": B}
CONFIGS = {
    "r(s)": CORRECTED.change(**SMALL),
    "r(s, a)": CORRECTED.change(reward="r-sa", **SMALL),
    "dac": CORRECTED.change(reward="dac", **SMALL),
    "released r(s)": RELEASE.change(**SMALL),
    "released r(s, a)": RELEASE.change(reward="r-sa", **SMALL),
    "dac on probability": CORRECTED.change(
        reward="dac", ablation="penalty-on-probability", **SMALL
    ),
    "r(s) of one number": CORRECTED.change(reward_sees=(1,), **SMALL),
    "r(s, a) of two numbers": CORRECTED.change(reward="r-sa", reward_sees=(0, 2), **SMALL),
    "one-sided r(s)": CORRECTED.change(ablation="one-sided", **SMALL),
    "spectral r(s, a)": CORRECTED.change(reward="r-sa", ablation="spectral-norm", **SMALL),
    "bottleneck r(s)": CORRECTED.change(
        ablation="bottleneck", bottleneck=0.5, bottleneck_size=3, **SMALL
    ),
    "bottleneck dac": CORRECTED.change(
        reward="dac", ablation="bottleneck", bottleneck=0.5, **SMALL
    ),
    "state pairs": CORRECTED.change(reward="dac", ablation="state-pairs", **SMALL),
}
AIRL = [name for name in CONFIGS if "r(s" in name]


def make(config, seeds=(0, 1), dtype=torch.float64, learning_rate=None):
    """A discriminator with random weights; double precision, unless it is to be trained."""
    made = make_discriminator(config.discriminator, Layout(len(seeds), OBS, ACT))
    made.init(Rng(seeds))
    if learning_rate is not None:
        made.reward_optimizer.learning_rate = made.value_optimizer.learning_rate = learning_rate
    if dtype == torch.float64:
        made.reward_params = made.reward_params.detach().double().requires_grad_()
        made.value_params = made.value_params.detach().double().requires_grad_()
        if isinstance(made, SpectralNorm):
            made.vectors = [vectors.double() for vectors in made.vectors]
        if isinstance(made, Bottleneck):
            # Not 0, at which the divergence would not be felt.
            made.multiplier = made.multiplier.double() + 0.7
            made.quadrature = made.quadrature.double()
    return made


def data(seeds=(0, 1), batch=B, dtype=torch.float64, pre_tanh=None):
    """Expert and policy transitions, log π of both, and the penalty's coefficients."""
    streams = Rng([100 + seed for seed in seeds])
    actor = SquashedGaussian(OBS, ACT, (5,), (-1.0, 1.0))
    params = actor.init(Rng(seeds)).to(dtype)
    sides, log_probs = [], []
    for _ in range(2):
        obs, noise, next_obs = (streams.normal(batch, n).to(dtype) for n in (OBS, ACT, OBS))
        u = actor.sample(params, obs, noise)[0]
        u = u if pre_tanh is None else torch.full_like(u, pre_tanh)
        zero = torch.zeros_like(obs[..., 0])
        sides.append(Batch(obs, u, next_obs, zero, zero))
        log_probs.append(actor.log_prob(params, obs, u))
    return *sides, *log_probs, streams.uniform(batch, 4).to(dtype)


def apart(batches, shift=2.0):
    """The same, with the expert somewhere else than the policy."""
    expert, *rest = batches
    return expert._replace(obs=expert.obs + shift, next_obs=expert.next_obs + shift), *rest


def seen(discriminator, batch, log_prob=None):
    """Transitions as a discriminator looks at them; without log π where it needs none."""
    if log_prob is None or not discriminator.needs_log_prob:
        log_prob = torch.zeros_like(batch.reward)
    return discriminator.transitions(batch, log_prob)


def minibatch(discriminator, expert, policy, expert_log_prob, policy_log_prob, mixing):
    """The arguments of an update."""
    sides = (expert, expert_log_prob), (policy, policy_log_prob)
    return *(seen(discriminator, *side) for side in sides), mixing


def loss_of(discriminator, *batches):
    """The loss, and diagnostics."""
    return discriminator.loss(*minibatch(discriminator, *batches))


def update(discriminator, *batches):
    """Make one update."""
    return discriminator.update(*minibatch(discriminator, *batches))


def frozen(discriminator):
    """The reward as it is now."""
    members, dtype = len(discriminator.reward_params), discriminator.reward_params.dtype
    scaling = Normaliser(*(x.to(dtype) for x in Normaliser.identity(members, OBS)))
    return discriminator.snapshot("", scaling)
