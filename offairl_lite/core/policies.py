"""Policies: the squashed Gaussian with its exact density, products of such, the deterministic one.

Actions lie in (-1, 1). A policy works with `pre_tanh`, the number whose tanh is the action: the
density of an action that has been rounded to ±1 is lost, that of its `pre_tanh` is not.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass
from functools import singledispatch
from os import PathLike
from typing import Any, ClassVar, Literal

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import softplus

from offairl_lite.config import PPOConfig, SACConfig, TD3Config
from offairl_lite.config.settings import Count, Interval, Sizes
from offairl_lite.core.absorbing import fit
from offairl_lite.core.networks import Normaliser, Population, StackedMLP, fields_of
from offairl_lite.core.rng import Rng
from offairl_lite.core.shapes import Action, AnyObs, Obs, OtherParams, Params, Vector

MAX_ACTION = 1 - 1e-6  #: Where `unsquash` clamps: an action closer to ±1 counts as this one.


def unsquash(action: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """Return `pre_tanh` of actions, clamped to ±`MAX_ACTION` (|pre_tanh| ≤ 7.25)."""
    return torch.atanh(action.clamp(-MAX_ACTION, MAX_ACTION))


def log_tanh_slope(pre_tanh: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """Return log(1 - tanh²(u)) without cancellation, for any u: 2 (log 2 - u - softplus(-2u))."""
    return 2 * (math.log(2) - pre_tanh - softplus(-2 * pre_tanh))


def gaussian_log_density(x: Action, mean: Action, log_std: Action) -> Vector:
    """Return the log-density of independent Gaussians, summed over the last axis."""
    z = (x - mean) * torch.exp(-log_std)
    return (-0.5 * z.square() - log_std - 0.5 * math.log(2 * math.pi)).sum(-1)


def defensive_log_density(log_prob: Vector, uniform_share: float, action_dim: int) -> Vector:
    """Return log((1 - w) π + w u), with a share w of uniform actions on [-1, 1]^A.

    No action has a density below w u: a defensive mixture (Hesterberg 1995).
    """
    share = log_prob.new_tensor(uniform_share)
    return torch.logaddexp(log_prob + (-share).log1p(), share.log() - action_dim * math.log(2))


@dataclass(frozen=True)
class Actor(ABC):
    """What all actors have in common: an architecture with `hidden` layers."""

    obs_dim: Count
    action_dim: Count
    hidden: Sizes

    outputs: ClassVar[int] = 1  #: Outputs of the network for each dimension of the action.

    @property
    def net(self) -> StackedMLP:
        """The network."""
        return StackedMLP((self.obs_dim, *self.hidden, self.outputs * self.action_dim))

    @property
    def num_params(self) -> int:
        """P."""
        return self.net.num_params

    def init(self, rng: Rng) -> Params:
        """Draw the weights of a population."""
        return self.net.init(rng)

    def mode(self, params: Params, obs: Obs) -> Action:
        """Return the action tanh(μ(s)), which evaluations use."""
        return torch.tanh(self.net(params, obs))

    @abstractmethod
    def explore(self, params: Params, obs: Obs, noise: Action) -> Action:
        """Return `pre_tanh` of what it does for standard normal `noise`."""


@dataclass(frozen=True)
class SquashedGaussian(Actor):
    """SAC's actor: a = tanh(u), u ~ N(μ(s), σ(s)²) (Haarnoja et al. 2018, appendix C)."""

    log_std_range: Interval = (-5.0, 2.0)  #: Bounds of log σ.

    outputs = 2

    def distribution(self, params: Params, obs: Obs) -> tuple[Action, Action]:
        """Return μ and log σ of `pre_tanh`."""
        mean, raw = self.net(params, obs).chunk(2, -1)
        return mean, self._log_std(raw)

    def _log_std(self, raw: Tensor) -> Tensor:
        """Return log σ, which approaches its bounds smoothly."""
        low, high = self.log_std_range
        return low + 0.5 * (high - low) * (torch.tanh(raw) + 1)

    def sample(self, params: Params, obs: Obs, noise: Action) -> tuple[Action, Vector]:
        """Return `pre_tanh` for standard normal `noise`, and the log-density of its action."""
        mean, log_std = self.distribution(params, obs)
        pre_tanh = mean + log_std.exp() * noise
        log_prob = gaussian_log_density(noise, torch.zeros_like(noise), torch.zeros_like(noise))
        return pre_tanh, log_prob - (log_std + log_tanh_slope(pre_tanh)).sum(-1)

    def explore(self, params: Params, obs: Obs, noise: Action) -> Action:
        """Return `pre_tanh` for standard normal `noise`: a sample."""
        mean, log_std = self.distribution(params, obs)
        return mean + log_std.exp() * noise

    def log_prob(self, params: Params, obs: Obs, pre_tanh: Action) -> Vector:
        """Return log π(a|s) of the actions tanh(`pre_tanh`)."""
        mean, log_std = self.distribution(params, obs)
        return gaussian_log_density(pre_tanh, mean, log_std) - log_tanh_slope(pre_tanh).sum(-1)

    def mode(self, params: Params, obs: Obs) -> Action:
        """Return the action tanh(μ(s)), which evaluations use."""
        return torch.tanh(self.distribution(params, obs)[0])


def product_of_gaussians(
    mean: Float[Tensor, "... K A"],
    log_std: Float[Tensor, "... K A"],
    weight: Float[Tensor, "... K"],
) -> tuple[Float[Tensor, "... A"], Float[Tensor, "... A"]]:
    """Return μ and log σ of the density proportional to ∏ N(μ_i, σ_i²)^w_i.

    Precisions add up, each times its exponent: 1/σ² = Σ w_i/σ_i², μ = σ² Σ μ_i w_i/σ_i² (Peng et
    al. 2019, equation 8, where the letter σ stands for variances).
    """
    precision = weight.unsqueeze(-1) * torch.exp(-2 * log_std)
    total = precision.sum(-2)
    return (precision * mean).sum(-2) / total, -total.log() / 2


@dataclass(frozen=True)
class MultiplicativeGaussian(SquashedGaussian):
    """SAC-MCP's actor: K Gaussian primitives and a gate, which says how much each one counts.

    `pre_tanh` is of the density proportional to ∏ N(μ_i(s), σ_i(s)²)^w_i(s) (Peng et al. 2019), one
    Gaussian again. Primitives share a trunk of `hidden` layers; the gate is a network of its own.
    """

    primitives: Count = 4
    primitive_hidden: Sizes = (256,)
    gate_hidden: Sizes = (512, 256, 256)
    gating: Literal["softmax", "sigmoid", "softplus"] = "softmax"
    """How the gate's outputs become weights w > 0: adding up to 1, each below 1, or unbounded."""

    @property
    def trunk(self) -> StackedMLP:
        """What the primitives have in common."""
        return StackedMLP((self.obs_dim, *self.hidden))

    @property
    def primitive(self) -> StackedMLP:
        """One primitive, with 2A outputs."""
        return StackedMLP((self.hidden[-1], *self.primitive_hidden, 2 * self.action_dim))

    @property
    def gate(self) -> StackedMLP:
        """The gate's network, with K outputs."""
        return StackedMLP((self.obs_dim, *self.gate_hidden, self.primitives))

    @property
    def num_params(self) -> int:
        """P: the weights of the trunk, of each primitive, and of the gate."""
        primitives = self.primitives * self.primitive.num_params
        return self.trunk.num_params + primitives + self.gate.num_params

    def init(self, rng: Rng) -> Params:
        """Draw the weights of a population."""
        nets = self.trunk, *[self.primitive] * self.primitives, self.gate
        return torch.cat([net.init(rng) for net in nets], 1)

    def split(self, params: Params) -> tuple[OtherParams, Float[Tensor, "S K _"], OtherParams]:
        """Return the weights of the trunk, of each primitive, and of the gate."""
        of_trunk, of_gate = self.trunk.num_params, self.gate.num_params
        trunk, primitives, gate = params.tensor_split([of_trunk, self.num_params - of_gate], 1)
        return trunk, primitives.unflatten(1, (self.primitives, -1)), gate

    def with_fixed_primitives(self, params: Params) -> Params:
        """Return the same weights, of which only the gate's have a gradient."""
        *primitives, gate = self.split(params)
        return torch.cat([*(part.detach().flatten(1) for part in primitives), gate], 1)

    def parts(
        self, params: Params, obs: Obs
    ) -> tuple[Float[Tensor, "S B K A"], Float[Tensor, "S B K A"], Float[Tensor, "S B K"]]:
        """Return each primitive's μ and log σ, and its weight."""
        trunk, primitives, gate = self.split(params)
        features = torch.relu(self.trunk(trunk, obs))
        each = features.repeat_interleave(self.primitives, 0)  # S·K networks, one stack
        outputs = self.primitive(primitives.flatten(0, 1), each)
        outputs = outputs.unflatten(0, (-1, self.primitives)).transpose(1, 2)
        mean, raw = outputs.chunk(2, -1)
        logits = self.gate(gate, obs)
        gates = {"softmax": lambda x: x.softmax(-1), "sigmoid": torch.sigmoid, "softplus": softplus}
        return mean, self._log_std(raw), gates[self.gating](logits)

    def distribution(self, params: Params, obs: Obs) -> tuple[Action, Action]:
        """Return μ and log σ of `pre_tanh`, σ no wider or narrower than a primitive's may be."""
        mean, log_std = product_of_gaussians(*self.parts(params, obs))
        return mean, log_std.clamp(*self.log_std_range)


@dataclass(frozen=True)
class Deterministic(Actor):
    """TD3's actor: a = tanh(μ(s)), and Gaussian noise on the action to explore."""

    noise_std: float = 0.1  #: Standard deviation of the exploration noise, in units of the action.

    def explore(self, params: Params, obs: Obs, noise: Action) -> Action:
        """Return `pre_tanh` of the action with noise on it; clipped, it has no density."""
        return unsquash(self.mode(params, obs) + self.noise_std * noise)


def _actors(base: type[Actor] = Actor) -> dict[str, type[Actor]]:
    """Return the types of actors by their names, those of ablations included."""
    kinds = base.__subclasses__()
    return {k: v for kind in kinds for k, v in {kind.__name__: kind, **_actors(kind)}.items()}


@singledispatch
def make_actor(config: SACConfig | PPOConfig | TD3Config, obs_dim: int, action_dim: int) -> Any:
    """Return the actor that a learner's settings ask for; an ablation has settings of its own."""
    dims = obs_dim, action_dim
    if isinstance(config, TD3Config):
        return Deterministic(*dims, config.hidden)
    if isinstance(config, PPOConfig) or config.primitives is None:
        return SquashedGaussian(*dims, config.hidden, config.log_std_range)
    trunk = config.trunk_hidden, config.log_std_range
    layers: Any = config.primitives, config.primitive_hidden, config.gate_hidden, config.gating
    return MultiplicativeGaussian(*dims, *trunk, *layers)


@dataclass(frozen=True)
class Policy(Population):
    """A population of actors with their weights: all that is needed to act on the task `env_id`."""

    env_id: str
    actor: Actor
    params: Params
    normaliser: Normaliser

    @torch.no_grad()
    def act(self, obs: AnyObs, noise: Action | None = None) -> Action:
        """Return actions in [-1, 1]: the mode, or a sample where `noise` is given.

        Raises:
            ValueError: `obs`, the task's own of shape (S, B, O) or (1, B, O), has another size.
        """
        self._require("obs", obs)
        obs = self.normaliser(fit(obs, self.actor.obs_dim, f"the policy of {self.env_id}"))
        if noise is None:
            return self.actor.mode(self.params, obs)
        return torch.tanh(self.actor.explore(self.params, obs, noise))

    def save(self, path: str | PathLike) -> None:
        """Write the population to a safetensors file."""
        self._write(path, "policy", actor={"name": type(self.actor).__name__, **asdict(self.actor)})

    @staticmethod
    def _read(about: dict[str, Any], obs_dim: int) -> tuple[int, int, dict[str, Any]]:
        shape, kinds = dict(about["actor"]), _actors()
        if shape.get("composition") == "exact":
            del shape["composition"]  # Files from before it was an actor of its own.
        name = shape.pop("name")
        if name not in kinds:
            raise ValueError(f"the actor is {name!r}; expected one of {', '.join(kinds)}")
        actor = kinds[name](**(shape | fields_of(kinds[name], shape)))
        return actor.num_params, actor.obs_dim, {"actor": actor}
