"""Shapes of tensors, for signatures: S members, B transitions; O, A: an observation, an action."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

Params = Float[Tensor, "S P"]  #: Weights: member i's are row i.
OtherParams = Float[Tensor, "S _"]  #: Weights of another network in the same signature.
TwinParams = Float[Tensor, "2 S P"]  #: Weights of two networks, the critics.
Obs = Float[Tensor, "S B O"]  #: Observations.
AnyObs = Float[Tensor, "#S B O"]  #: The same for all members, or those of each.
Action = Float[Tensor, "S B A"]  #: Actions in [-1, 1], their `pre_tanh`, or the noise for them.
Noises = Float[Tensor, "D S B A"]  #: Noise for the next actions, the actor's own, and more.
AnyAction = Float[Tensor, "#S B A"]  #: The same for all members, or those of each.
Vector = Float[Tensor, "S B"]  #: One number for each transition.
TwinQ = Float[Tensor, "2 S B"]  #: The values of both critics.
Numbers = Float[Tensor, "*#batch"]  #: Of any shapes that go together.
Column = Float[Tensor, "S 1"]  #: One number for each member, such as a temperature or r(s_a).
PerMember = Float[Tensor, "S"]  #: The same without the second axis.
Scalar = Float[Tensor, ""]  #: A loss, summed over the members.
Metrics = dict[str, PerMember]  #: Diagnostics by their names.


class Layout(NamedTuple):
    """What the networks of a run have in common."""

    members: int  #: S.
    obs_dim: int  #: O, the indicator of the absorbing state included.
    action_dim: int  #: A.
    device: torch.device | str = "cpu"  #: Where they live.
    absorbs: bool = False  #: Whether observations end with that indicator.
