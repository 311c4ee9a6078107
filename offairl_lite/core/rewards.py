r"""The generator's reward: one function a variant, with the expert labelled 1.

A discriminator is a logit $\ell$ with $D = \sigma(\ell)$, so $\log D - \log(1 - D) = \ell$.
AIRL's is $\ell = f - \log \pi$.
"""

from dataclasses import asdict, dataclass
from os import PathLike
from typing import Any, NamedTuple

import torch
from torch.nn.functional import logsigmoid

from offairl_lite.config.settings import checked
from offairl_lite.core.absorbing import fit
from offairl_lite.core.networks import Normaliser, Population, StackedMLP, fields_of
from offairl_lite.core.shapes import AnyAction, AnyObs, Params, Vector


class Implementation(NamedTuple):
    """A row of the paper's comparison: what r sees, and whether the reward is r or the logit."""

    state_only: bool
    reward_is_logit: bool


IMPLEMENTATIONS = {
    "logit-sa": Implementation(state_only=False, reward_is_logit=True),
    "logit-s": Implementation(state_only=True, reward_is_logit=True),
    "r-sa": Implementation(state_only=False, reward_is_logit=False),
    "r-s": Implementation(state_only=True, reward_is_logit=False),
}
"""1: log D - log(1 - D) with r(s, a); 2: the same with r(s); 3: r(s, a) itself; 4: r(s) itself."""


def log_odds(f: Vector, log_prob: Vector) -> Vector:
    """Return log D - log(1 - D) = f - log π: Implementations 1 and 2."""
    return f - log_prob


def dac(logit: Vector) -> Vector:
    """Return DAC's reward log D - log(1 - D), of either sign."""
    return logit


def gail_survival(logit: Vector) -> Vector:
    """Return -log(1 - D) ≥ 0: every step pays, so to go on is rewarded in itself."""
    return -logsigmoid(-logit)


def gail_termination(logit: Vector) -> Vector:
    """Return log D ≤ 0: every step costs, so to stop is rewarded in itself."""
    return logsigmoid(logit)


OF_LOGIT = {"dac": dac, "gail-survival": gail_survival, "gail-termination": gail_termination}
"""The rewards of a discriminator without log π, by their names in a configuration."""


@dataclass(frozen=True)
class Reward(Population):
    """A population of rewards that were learned on the task `env_id`, frozen: r(s) or r(s, a)."""

    env_id: str
    net: StackedMLP
    state_only: bool
    params: Params
    normaliser: Normaliser

    @property
    def sees(self) -> tuple[int, int]:
        """How many numbers of an observation, as networks see it, and of an action, r sees."""
        obs_dim = self.normaliser.mean.shape[-1]
        return obs_dim, self.net.sizes[0] - obs_dim

    @torch.no_grad()
    def __call__(self, obs: AnyObs, action: AnyAction | None = None) -> Vector:
        """Return r of the task's observations, also without the absorbing state's indicator.

        r(s) needs no actions; they are in [-1, 1]. ValueError if they are missing or do not fit.
        """
        self._require("obs", obs)
        obs_dim, action_dim = self.sees
        x = self.normaliser(fit(obs, obs_dim, f"the reward of {self.env_id}"))
        if not self.state_only:
            if action is None:
                raise ValueError(f"reward of {self.env_id} is r(s, a): give it the actions, too")
            self._require("action", action, x.shape[1], action_dim)
            x = torch.cat([x, action], -1)
        return self.net(self.params, x).squeeze(-1)

    def save(self, path: str | PathLike) -> None:
        """Write the population to a safetensors file."""
        self._write(path, "reward", state_only=self.state_only, **asdict(self.net))

    @staticmethod
    def _read(about: dict[str, Any], obs_dim: int) -> tuple[int, int, dict[str, Any]]:
        net = StackedMLP(**fields_of(StackedMLP, about))
        state_only = checked("state_only", about["state_only"], bool)
        fits = net.sizes[0] == obs_dim if state_only else net.sizes[0] > obs_dim
        if len(net.sizes) < 2 or net.sizes[-1] != 1 or not fits:
            raise ValueError(f"{net.sizes=} and {state_only=}, for observations of {obs_dim}")
        return net.num_params, obs_dim, {"net": net, "state_only": state_only}
