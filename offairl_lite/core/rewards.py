r"""The generator's reward: one function a variant, with the expert labelled 1.

A discriminator is a logit $\ell$ with $D = \sigma(\ell)$, so $\log D - \log(1 - D) = \ell$.
AIRL's is $\ell = f - \log \pi$, with $f(s, a, s') = r + \gamma V(s') - V(s)$. GAN-GCL's, of a whole
episode, is the sum of its steps' $r(s, a) - \log \pi$, so that each step's share of it is log odds,
too.
"""

from dataclasses import dataclass, replace
from os import PathLike
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import logsigmoid

from offairl_lite.core.absorbing import fit
from offairl_lite.core.networks import Normaliser, StackedMLP, load_weights, save_weights


class Implementation(NamedTuple):
    """A row of the paper's comparison: what r sees, and whether the reward is r or the logit."""

    state_only: bool
    reward_is_logit: bool


IMPLEMENTATIONS = {
    "implementation-1": Implementation(state_only=False, reward_is_logit=True),
    "implementation-2": Implementation(state_only=True, reward_is_logit=True),
    "implementation-3": Implementation(state_only=False, reward_is_logit=False),
    "implementation-4": Implementation(state_only=True, reward_is_logit=False),
}
"""1: log D - log(1 - D) with r(s, a); 2: the same with r(s); 3: r(s, a) itself; 4: r(s) itself."""


def log_odds(
    f: Float[Tensor, "*batch"], log_prob: Float[Tensor, "*batch"]
) -> Float[Tensor, "*batch"]:
    """Return log D - log(1 - D) = f - log π: Implementations 1 and 2, and GAN-GCL."""
    return f - log_prob


def dac(logit: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Return DAC's reward log D - log(1 - D), of either sign."""
    return logit


def gail_survival(logit: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Return -log(1 - D) ≥ 0: every step pays, so to go on is rewarded in itself."""
    return -logsigmoid(-logit)


def gail_termination(logit: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Return log D ≤ 0: every step costs, so to stop is rewarded in itself."""
    return logsigmoid(logit)


OF_LOGIT = {"dac": dac, "gail-survival": gail_survival, "gail-termination": gail_termination}
"""The rewards of a discriminator without log π, by their names in a configuration."""


@dataclass(frozen=True)
class Reward:
    """A population of learned rewards, frozen: r(s) or r(s, a).

    Args:
        env_id: the task it was learned on.
        net: the architecture.
        state_only: whether it sees the state alone.
        params: its weights.
        normaliser: how it scales observations.
    """

    env_id: str
    net: StackedMLP
    state_only: bool
    params: Float[Tensor, "S P"]
    normaliser: Normaliser

    def __len__(self) -> int:
        return len(self.params)

    def member(self, *index: int) -> "Reward":
        """Return the population of these members alone."""
        params, normaliser = self.params[list(index)], self.normaliser.member(*index)
        return replace(self, params=params, normaliser=normaliser)

    def to(self, device: str | torch.device) -> "Reward":
        """Return the same rewards on a device."""
        params, normaliser = self.params.to(device), self.normaliser.to(device)
        return replace(self, params=params, normaliser=normaliser)

    @torch.no_grad()
    def __call__(
        self, obs: Float[Tensor, "S B O"], action: Float[Tensor, "S B A"] | None = None
    ) -> Float[Tensor, "S B"]:
        """Return r of each member; `action` may be left out of a reward of the state alone.

        Args:
            obs: float32, as the task gives them; the indicator of an absorbing state may be there.
            action: float32, scaled to [-1, 1].

        Raises:
            ValueError: it is left out of a reward of state and action, or the observations are of
                another size.
        """
        if not self.state_only and action is None:
            raise ValueError(f"the reward of {self.env_id} is r(s, a): give it the actions, too")
        size = self.normaliser.mean.shape[-1]
        obs = self.normaliser(fit(obs, size, f"the reward of {self.env_id}"))
        x = obs if self.state_only else torch.cat([obs, action], -1)
        return self.net(self.params, x).squeeze(-1)

    def save(self, path: str | PathLike) -> None:
        """Write the population to a safetensors file."""
        save_weights(
            path,
            {"params": self.params, "mean": self.normaliser.mean, "std": self.normaliser.std},
            {
                "kind": "reward",
                "env_id": self.env_id,
                "state_only": self.state_only,
                "sizes": self.net.sizes,
                "activation": self.net.activation,
            },
        )

    @classmethod
    def load(cls, path: str | PathLike) -> "Reward":
        """Read a population written by `save`.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: the file holds something else, or weights of another shape.
        """
        tensors, about = load_weights(path, "reward")
        net = StackedMLP(tuple(about["sizes"]), about["activation"])
        params, normaliser = tensors["params"], Normaliser(tensors["mean"], tensors["std"])
        if params.shape[1:] != (net.num_params,):
            raise ValueError(
                f"{path}: weights {tuple(params.shape)}, expected (S, {net.num_params})"
            )
        return cls(about["env_id"], net, about["state_only"], params, normaliser)
