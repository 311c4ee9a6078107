"""Policies: the squashed Gaussian with its exact density, and the deterministic one.

Actions lie in (-1, 1). A policy works with `pre_tanh`, the number whose tanh is the action: the
density of an action that has been rounded to ±1 is lost, that of its `pre_tanh` is not.
"""

import math
from dataclasses import asdict, dataclass
from os import PathLike
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import softplus

from offairl_lite.networks import Normaliser, StackedMLP, load_weights, save_weights
from offairl_lite.streams import Streams

MAX_ACTION = 1 - 1e-6
"""Where `unsquash` clamps: an action this close to ±1 counts as this action."""


def unsquash(action: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """Return `pre_tanh` of given actions, clamped to ±`MAX_ACTION` (|pre_tanh| ≤ 7.25)."""
    return torch.atanh(action.clamp(-MAX_ACTION, MAX_ACTION))


def log_tanh_slope(pre_tanh: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """Return log(1 - tanh²(u)) without cancellation, for any u: 2 (log 2 - u - softplus(-2u))."""
    return 2 * (math.log(2) - pre_tanh - softplus(-2 * pre_tanh))


def gaussian_log_density(
    x: Float[Tensor, "... A"], mean: Float[Tensor, "... A"], log_std: Float[Tensor, "... A"]
) -> Float[Tensor, "..."]:
    """Return the log-density of independent Gaussians, summed over the last axis."""
    z = (x - mean) * torch.exp(-log_std)
    return (-0.5 * z.square() - log_std - 0.5 * math.log(2 * math.pi)).sum(-1)


@dataclass(frozen=True)
class SquashedGaussian:
    """SAC's actor: a = tanh(u), u ~ N(μ(s), σ(s)²) (Haarnoja et al. 2018, appendix C).

    Args:
        obs_dim: O.
        action_dim: A.
        hidden: hidden layers of the network that gives μ and log σ.
        log_std_range: bounds of log σ.
    """

    obs_dim: int
    action_dim: int
    hidden: tuple[int, ...]
    log_std_range: tuple[float, float] = (-5.0, 2.0)

    @property
    def net(self) -> StackedMLP:
        """The network, with 2A outputs."""
        return StackedMLP((self.obs_dim, *self.hidden, 2 * self.action_dim))

    def init(self, streams: Streams) -> Float[Tensor, "S P"]:
        """Draw the weights of a population."""
        return self.net.init(streams)

    def distribution(
        self, params: Float[Tensor, "S P"], obs: Float[Tensor, "S B O"]
    ) -> tuple[Float[Tensor, "S B A"], Float[Tensor, "S B A"]]:
        """Return μ and log σ of `pre_tanh`."""
        mean, raw = self.net(params, obs).chunk(2, -1)
        low, high = self.log_std_range
        return mean, low + 0.5 * (high - low) * (torch.tanh(raw) + 1)

    def sample(
        self,
        params: Float[Tensor, "S P"],
        obs: Float[Tensor, "S B O"],
        noise: Float[Tensor, "S B A"],
    ) -> tuple[Float[Tensor, "S B A"], Float[Tensor, "S B"]]:
        """Return `pre_tanh` for standard normal `noise`, and the log-density of its action."""
        mean, log_std = self.distribution(params, obs)
        pre_tanh = mean + log_std.exp() * noise
        log_prob = gaussian_log_density(noise, torch.zeros_like(noise), torch.zeros_like(noise))
        return pre_tanh, log_prob - (log_std + log_tanh_slope(pre_tanh)).sum(-1)

    def explore(
        self,
        params: Float[Tensor, "S P"],
        obs: Float[Tensor, "S B O"],
        noise: Float[Tensor, "S B A"],
    ) -> Float[Tensor, "S B A"]:
        """Return `pre_tanh` for standard normal `noise`: a sample."""
        mean, log_std = self.distribution(params, obs)
        return mean + log_std.exp() * noise

    def log_prob(
        self,
        params: Float[Tensor, "S P"],
        obs: Float[Tensor, "S B O"],
        pre_tanh: Float[Tensor, "S B A"],
        density: Literal["exact", "released"] = "exact",
    ) -> Float[Tensor, "S B"]:
        """Return log π(a|s) of the actions tanh(`pre_tanh`).

        `released` is what the paper's code computes in its place: the Gaussian density at the
        squashed action, without the change of variables.
        """
        mean, log_std = self.distribution(params, obs)
        if density == "released":
            return gaussian_log_density(torch.tanh(pre_tanh), mean, log_std)
        return gaussian_log_density(pre_tanh, mean, log_std) - log_tanh_slope(pre_tanh).sum(-1)

    def mode(
        self, params: Float[Tensor, "S P"], obs: Float[Tensor, "S B O"]
    ) -> Float[Tensor, "S B A"]:
        """Return the action tanh(μ(s)), which evaluations use."""
        return torch.tanh(self.distribution(params, obs)[0])


@dataclass(frozen=True)
class Deterministic:
    """TD3's actor: a = tanh(μ(s)), and Gaussian noise on the action to explore.

    Args:
        obs_dim: O.
        action_dim: A.
        hidden: hidden layers.
        noise_std: standard deviation of the exploration noise, in units of the action.
    """

    obs_dim: int
    action_dim: int
    hidden: tuple[int, ...]
    noise_std: float = 0.1

    @property
    def net(self) -> StackedMLP:
        """The network, with A outputs."""
        return StackedMLP((self.obs_dim, *self.hidden, self.action_dim))

    def init(self, streams: Streams) -> Float[Tensor, "S P"]:
        """Draw the weights of a population."""
        return self.net.init(streams)

    def explore(
        self,
        params: Float[Tensor, "S P"],
        obs: Float[Tensor, "S B O"],
        noise: Float[Tensor, "S B A"],
    ) -> Float[Tensor, "S B A"]:
        """Return `pre_tanh` of the action with noise on it; clipped, it has no density."""
        return unsquash(self.mode(params, obs) + self.noise_std * noise)

    def mode(
        self, params: Float[Tensor, "S P"], obs: Float[Tensor, "S B O"]
    ) -> Float[Tensor, "S B A"]:
        """Return the action tanh(μ(s)), which evaluations use."""
        return torch.tanh(self.net(params, obs))


Actor = SquashedGaussian | Deterministic
_ACTORS = {kind.__name__: kind for kind in (SquashedGaussian, Deterministic)}


@dataclass(frozen=True)
class Policy:
    """A population of actors with their weights: all that is needed to act.

    Args:
        env_id: the task it was trained on.
        actor: the architecture.
        params: its weights.
        normaliser: how it scales observations.
    """

    env_id: str
    actor: Actor
    params: Float[Tensor, "S P"]
    normaliser: Normaliser

    def __len__(self) -> int:
        return len(self.params)

    def member(self, *index: int) -> "Policy":
        """Return the population of these members alone."""
        rows = list(index)
        normaliser = Normaliser(*(part[rows] for part in self.normaliser))
        return Policy(self.env_id, self.actor, self.params[rows], normaliser)

    @torch.no_grad()
    def act(
        self, obs: Float[Tensor, "S B O"], noise: Float[Tensor, "S B A"] | None = None
    ) -> Float[Tensor, "S B A"]:
        """Return actions in [-1, 1]: the mode, or a sample where `noise` is given."""
        obs = self.normaliser(obs)
        if noise is None:
            return self.actor.mode(self.params, obs)
        return torch.tanh(self.actor.explore(self.params, obs, noise))

    def save(self, path: str | PathLike, **notes: Any) -> None:
        """Write the population to a safetensors file, with notes (returns, seeds) beside it."""
        actor = {"name": type(self.actor).__name__, **asdict(self.actor)}
        save_weights(
            path,
            {"params": self.params, "mean": self.normaliser.mean, "std": self.normaliser.std},
            {"kind": "policy", "env_id": self.env_id, "actor": actor, **notes},
        )

    @classmethod
    def load(cls, path: str | PathLike) -> "Policy":
        """Read a population written by `save`.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: the file holds something else, or weights of another shape.
        """
        tensors, about = load_weights(path, "policy")
        shape = {k: tuple(v) if isinstance(v, list) else v for k, v in about["actor"].items()}
        actor = _ACTORS[shape.pop("name")](**shape)
        params = tensors["params"].float()  # Shipped experts' may be in half precision.
        if params.shape[1:] != (actor.net.num_params,):
            raise ValueError(
                f"{path}: weights {tuple(params.shape)}, expected (S, {actor.net.num_params})"
            )
        return cls(about["env_id"], actor, params, Normaliser(tensors["mean"], tensors["std"]))
