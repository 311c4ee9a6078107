"""Networks for a population: the weights of `S` members are one matrix, `(S, P)`.

A network here is only an architecture. Its weights are an ordinary tensor that is passed in, so a
loss is a function of tensors, a target network is a second tensor, averaging it is one call, and
member `i` is row `i`.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, TypeVar, get_type_hints

import torch
from jaxtyping import Float
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from offairl_lite.config.settings import Sizes, checked
from offairl_lite.core.rng import Rng
from offairl_lite.core.shapes import (
    Action,
    AnyObs,
    Layout,
    Obs,
    Params,
    Scalar,
    TwinParams,
    TwinQ,
    Vector,
)

TINY = 1e-12  #: What keeps roots and quotients of lengths finite at 0.


class Normaliser(NamedTuple):
    """Fixed affine map of observations: `(obs - mean) / std`, member by member."""

    mean: Float[Tensor, "S 1 O"]
    std: Float[Tensor, "S 1 O"]

    @classmethod
    def identity(cls, members: int, obs_dim: int, device: Any = "cpu") -> "Normaliser":
        """Return the map that changes nothing."""
        zeros = torch.zeros(members, 1, obs_dim, device=device)
        return cls(zeros, torch.ones_like(zeros))

    @classmethod
    def of(cls, *sources: Float[Tensor, "S _ O"]) -> "Normaliser":
        """Return the map that gives an even mixture of the sources mean 0 and standard deviation 1.

        A coordinate that hardly varies is only centred: its rounding would become signal.
        """
        mean = torch.stack([obs.mean(1, keepdim=True) for obs in sources]).mean(0)
        squares = [(obs - mean).square().mean(1, keepdim=True) for obs in sources]
        std = torch.stack(squares).mean(0).sqrt()
        return cls(mean, torch.where(std < 1e-8 + 1e-5 * mean.abs(), 1.0, std))

    def __call__(self, obs: AnyObs) -> Obs:
        """Scale observations; ValueError if they have not three axes."""
        # Two axes would be taken for every member's.
        if obs.ndim != 3:
            raise ValueError(f"observations have axes {tuple(obs.shape)}; expected (S, B, O)")
        return (obs - self.mean) / self.std


@dataclass(frozen=True)
class StackedMLP:
    """A multilayer perceptron for `S` sets of weights; `sizes` go from input to linear output."""

    sizes: Sizes
    activation: Literal["relu", "tanh"] = "relu"

    @property
    def num_params(self) -> int:
        """P: weights and biases of one member."""
        return sum((i + 1) * o for i, o in pairwise(self.sizes))

    def init(self, rng: Rng) -> Params:
        """Draw Glorot-uniform weights and zero biases (Glorot and Bengio, 2010)."""
        parts = []
        for i, o in pairwise(self.sizes):
            weight = (2 * rng.uniform(i * o) - 1) * (6 / (i + o)) ** 0.5
            parts += [torch.zeros(len(rng), o, device=rng.device), weight]
        return torch.cat(parts, 1)

    def layers(self, params: Params) -> list[tuple[Tensor, Tensor]]:
        """Cut the rows of `params` into biases `(S, 1, out)` and weights `(S, in, out)`."""
        shapes = list(pairwise(self.sizes))
        parts = params.split([n for i, o in shapes for n in (o, i * o)], 1)
        return [
            (bias.unsqueeze(1), weight.view(-1, i, o))
            for bias, weight, (i, o) in zip(parts[::2], parts[1::2], shapes, strict=True)
        ]

    def mask(self, inputs: Sequence[int]) -> Float[Tensor, "1 P"]:
        """Return what to multiply `params` with for an output that sees these inputs alone."""
        mask = torch.ones(1, self.num_params)
        _, weight = self.layers(mask)[0]
        weight.zero_()[:, list(inputs)] = 1
        return mask

    def __call__(self, params: Params, x: Float[Tensor, "S B in"]) -> Float[Tensor, "S B out"]:
        """Apply member `i`'s weights to member `i`'s inputs."""
        *hidden, (bias, weight) = self.layers(params)
        for b, w in hidden:
            x = self._activate(_affine(x, w, b))
        return _affine(x, weight, bias)

    def value_and_input_gradient(
        self, params: Params, x: Float[Tensor, "S B in"]
    ) -> tuple[Vector, Float[Tensor, "S B in"]]:
        """Return the scalar output and its gradient by the input.

        That is the chain rule as a forward pass: to train on it takes one backward pass, not two.
        """
        *hidden, (bias, weight) = self.layers(params)
        outputs = []
        for b, w in hidden:
            x = self._activate(_affine(x, w, b))
            outputs.append(x)
        value = _affine(x, weight, bias).squeeze(-1)
        gradient = weight.transpose(1, 2)
        for (_, w), h in zip(reversed(hidden), reversed(outputs), strict=True):
            slope = (h > 0).to(h) if self.activation == "relu" else 1 - h.square()
            gradient = (gradient * slope) @ w.transpose(1, 2)
        return value, gradient if hidden else gradient.expand(-1, x.shape[1], -1)

    def _activate(self, x: Tensor) -> Tensor:
        # tanh, as a sigmoid: PyTorch's tanh takes three times as long as that on a CPU.
        return torch.relu(x) if self.activation == "relu" else 2 * torch.sigmoid(2 * x) - 1


def _affine(x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """Return x W + b for each member."""
    if weight.shape[-1] == 1:
        # A stack of products with one column each is several times as slow as this.
        return (x * weight.transpose(1, 2)).sum(-1, keepdim=True) + bias
    return torch.baddbmm(bias, x, weight)


class TwinCritic:
    """Two Q-networks with the same hidden layers, which are `2S` entries of one stack."""

    def __init__(self, obs_dim: int, action_dim: int, hidden: tuple[int, ...]) -> None:
        self.net = StackedMLP((obs_dim + action_dim, *hidden, 1))

    def init(self, rng: Rng) -> TwinParams:
        """Draw the weights of both critics of a population."""
        return torch.stack([self.net.init(rng), self.net.init(rng)])

    def __call__(self, params: TwinParams, obs: Obs, action: Action) -> TwinQ:
        """Return both values of each action."""
        x = torch.cat([obs, action], -1)
        q = self.net(params.flatten(0, 1), x.expand(2, *x.shape).flatten(0, 1))
        return q.view(2, *x.shape[:2])


BETAS, EPSILON = (0.9, 0.999), 1e-8  #: Adam's own, never changed.


class Adam:
    """Adam over one tensor of weights (Kingma and Ba 2015), which starts to require gradients.

    Its state changes in place, so that a step can be compiled, or captured as a CUDA graph.
    """

    def __init__(self, params: Tensor, learning_rate: float) -> None:
        self.params, self.learning_rate = params.requires_grad_(), learning_rate
        self.mean, self.square = torch.zeros_like(params), torch.zeros_like(params)
        self.betas = torch.tensor(BETAS, device=params.device)
        self.decay = torch.ones_like(self.betas)
        # The step's length and ε, corrected for the bias: compiled, they are computed once.
        self.scale = torch.zeros_like(self.betas)

    @property
    def state(self) -> dict[str, Tensor]:
        """The weights and what is remembered of their gradients: the tensors themselves."""
        memory = {name: getattr(self, name) for name in ("mean", "square", "decay")}
        return {"params": self.params.detach(), **memory}

    @torch.no_grad()
    def step(self, gradient: Tensor) -> None:
        """Take one step down."""
        self.mean.lerp_(gradient, 1 - BETAS[0])
        self.square.lerp_(gradient.square(), 1 - BETAS[1])
        self.decay *= self.betas
        bias1, bias2 = (1 - self.decay).unbind()
        unbiased = torch.stack([self.learning_rate / bias1, torch.full_like(bias2, EPSILON)])
        self.scale.copy_(unbiased * bias2.sqrt())
        length, epsilon = self.scale.unbind()
        self.params -= length * self.mean / (self.square.sqrt() + epsilon)


def zeros(layout: Layout, num_params: int) -> Params:
    """Return room for the weights of a run's network, which are drawn when its warm-up is over."""
    return torch.zeros(layout.members, num_params, device=layout.device)


def states_of(**optimizers: Adam) -> dict[str, Tensor]:
    """Return the states of optimizers, each name after its optimizer's."""
    return {f"{kind}.{name}": x for kind, it in optimizers.items() for name, x in it.state.items()}


def descend(loss: Scalar, *optimizers: Adam) -> None:
    """Step down the gradient of `loss` by the optimizers' tensors, and by nothing else."""
    gradients = torch.autograd.grad(loss, [optimizer.params for optimizer in optimizers])
    for optimizer, gradient in zip(optimizers, gradients, strict=True):
        optimizer.step(gradient)


def save_weights(path: str | PathLike, tensors: dict[str, Tensor], about: dict[str, Any]) -> None:
    """Write tensors to a safetensors file, with what they mean as JSON beside them."""
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    plain = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    Path(path).write_bytes(save(plain, {"about": json.dumps(about)}))


def load_weights(path: str | PathLike, kind: str) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read what `save_weights` wrote; ValueError if it is damaged, or of another kind."""
    if not Path(path).is_file():
        raise FileNotFoundError(f"no {kind} at {path}")
    try:
        with safe_open(path, "pt") as file:
            about = json.loads((file.metadata() or {}).get("about", "{}"))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, ValueError, RecursionError) as error:
        raise ValueError(f"{path} is no safetensors file of this package: {error}") from error
    stored = about.get("kind", "something unnamed") if isinstance(about, dict) else "no metadata"
    if stored != kind:
        raise ValueError(f"{path} holds {stored!r}, not a {kind}")
    return tensors, about


def fields_of(kind: type, about: dict[str, Any]) -> dict[str, Any]:
    """Return what metadata say of a dataclass; ValueError if a field is of another type."""
    hints = get_type_hints(kind, include_extras=True).items()
    return {name: checked(name, about[name], hint) for name, hint in hints if name in about}


P = TypeVar("P", bound="Population")


class Population:
    """Trained networks of `S` members: what a `Policy` and a `Reward` have in common."""

    _read: ClassVar[Any]
    """Returns P, O and the architecture, of a file's metadata and of the width of its scaling."""
    env_id: str
    params: Params
    normaliser: Normaliser

    def __len__(self) -> int:
        return len(self.params)

    def member(self: P, *index: int) -> P:
        """Return the population of these members alone; ValueError if there is none of a number."""
        valid = Annotated[int, f"in [0, {len(self) - 1}]", lambda i: 0 <= i < len(self)]
        chosen = [checked("member", i, valid) for i in index or (None,)]
        return self._each(lambda tensor: tensor[chosen])

    def to(self: P, device: str | torch.device) -> P:
        """Return the same population on a device."""
        return self._each(lambda tensor: tensor.to(device))

    def _each(self: P, change: Callable[[Tensor], Tensor]) -> P:
        """Return the population with each of its tensors changed."""
        normaliser = Normaliser(*map(change, self.normaliser))
        changed = {"params": change(self.params), "normaliser": normaliser}
        return type(self)(**(vars(self) | changed))

    def _write(self, path: str | PathLike, kind: str, **architecture: Any) -> None:
        """Write tensors and architecture to a safetensors file."""
        tensors = {"params": self.params, **self.normaliser._asdict()}
        save_weights(path, tensors, {"kind": kind, "env_id": self.env_id, **architecture})

    @classmethod
    def load(cls: type[P], path: str | PathLike) -> P:
        """Read what `save` wrote; ValueError if it is not whole, see `load_weights`.

        A file is data: its `env_id` loses the module, which only a user may name (`envs.spec`).
        """
        kind = cls.__name__.lower()
        tensors, about = load_weights(path, kind)
        try:
            members, obs_dim = max(1, len(tensors["params"])), tensors["mean"].shape[-1]
            num_params, sees, architecture = cls._read(about, obs_dim)
            scale = members, 1, sees
            for name, shape in (("params", (members, num_params)), ("mean", scale), ("std", scale)):
                tensor = tensors[name]
                # Shipped experts' weights may be in half precision.
                if tensor.shape != shape or tensor.dtype not in (torch.float32, torch.float16):
                    wrong = f"{tensor.dtype} of shape {tuple(tensor.shape)}"
                    raise ValueError(f"{name} is {wrong}; expected torch.float32 of shape {shape}")
                if not tensor.isfinite().all() or (name == "std" and tensor.min() <= 0):
                    raise ValueError(f"{name} must be finite, and std above 0")
            env_id = checked("env_id", about["env_id"], str).rpartition(":")[2]
        except (ValueError, LookupError, TypeError) as error:
            why = f"it has no {error}" if isinstance(error, KeyError) else error
            raise ValueError(f"{path} describes no {kind}: {why}") from error
        params, *normaliser = (tensors[name].float() for name in ("params", "mean", "std"))
        fields = {"env_id": env_id, "params": params, "normaliser": Normaliser(*normaliser)}
        return cls(**(architecture | fields))

    def _require(self, name: str, tensor: Tensor, *last: int) -> None:
        """Raise ValueError unless an argument is (S, B, ...), `last` axes as given, and float."""
        axes, dtype = tuple(getattr(tensor, "shape", ())), self.params.dtype
        like = isinstance(tensor, Tensor) and tensor.dtype == dtype and len(axes) == 3
        if not like or axes[0] not in (1, len(self)) or axes[3 - len(last) :] != last:
            actual = f"{getattr(tensor, 'dtype', type(tensor).__name__)} of shape {axes}"
            wanted = (len(self), "B", "O")[: 3 - len(last)] + last
            raise ValueError(f"{name} is {actual}; expected {dtype} of shape {wanted}")
