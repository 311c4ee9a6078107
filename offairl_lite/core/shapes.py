"""Shapes of tensors, for signatures: S members, B transitions; O, A: an observation, an action."""

from jaxtyping import Float
from torch import Tensor

Params = Float[Tensor, "S P"]  #: Weights: member i's are row i.
TwinParams = Float[Tensor, "2 S P"]  #: Weights of two networks, the critics.
Obs = Float[Tensor, "S B O"]  #: Observations.
Action = Float[Tensor, "S B A"]  #: Actions in [-1, 1], their `pre_tanh`, or the noise for them.
Vector = Float[Tensor, "S B"]  #: One number for each transition.
TwinQ = Float[Tensor, "2 S B"]  #: The values of both critics.
Column = Float[Tensor, "S 1"]  #: One number for each member, such as a temperature or r(s_a).
PerMember = Float[Tensor, "S"]  #: The same without the second axis.
Scalar = Float[Tensor, ""]  #: A loss, summed over the members.
Metrics = dict[str, PerMember]  #: Diagnostics by their names.
