"""Settings that are checked: against the types of their fields, against ranges, and together."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from numbers import Integral, Real
from types import UnionType
from typing import Annotated, Any, ClassVar, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

# A type, the values of it that are allowed in words, and the test for them.
Count = Annotated[int, "of at least 1", lambda n: n >= 1]
Natural = Annotated[int, "of at least 0", lambda n: n >= 0]
AtLeastOne = Annotated[float, "of at least 1", lambda x: x >= 1]
NonNegative = Annotated[float, "of at least 0", lambda x: x >= 0]
Positive = Annotated[float, "above 0", lambda x: x > 0]
Fraction = Annotated[float, "in [0, 1]", lambda x: 0 <= x <= 1]
Sizes = tuple[Count, ...]
Interval = Annotated[tuple[float, float], "in ascending order", lambda x: x[0] < x[1]]
Indices = Annotated[tuple[Natural, ...], "and none twice", lambda x: 0 < len(x) == len({*x})]

PLAIN: dict[type, tuple[Any, str]] = {
    bool: (bool | np.bool_, "True or False"),
    int: (Integral, "a whole number"),
    float: (Real, "a number"),
    str: (str, "a text"),
}
"""The types of single settings: what is taken for one, and what it is called in messages."""
EARLIER = {
    "warmup_steps": "learning_starts",
    "warmup_hold": "random_hold",
    "start_steps": "guide_steps",
    "update_every": "train_every",
}
"""Names that settings had before, which are still understood."""
_FOUR = "logit-sa", "logit-s", "r-sa", "r-s"
SYNONYMS = {
    "reward": {
        **{f"implementation-{n}": name for n, name in enumerate(_FOUR, 1)},
        **{name.replace("-", "(").replace("sa", "s,a") + ")": name for name in _FOUR},
    },
    "loss": {"exact": "airl", "mixture": "airl-mixture", "released": "log-ratio"},
}
"""Other spellings of values: the paper's, those that a shell needs quotes for, and earlier ones."""


def current(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings by the names that they have now."""
    return {EARLIER.get(name, name): value for name, value in settings.items()}


@dataclass(frozen=True)
class Checked:
    """A group of settings, checked one by one and then together."""

    kind: ClassVar[str] = ""
    renamed: ClassVar[dict[str, str]] = {}  #: Flat names of fields that another group has as well.
    settings: ClassVar[dict[str, tuple[str, Any]]] = {}
    """The names and types of the fields, by their flat names."""

    def __init_subclass__(cls) -> None:
        hints = get_type_hints(cls, include_extras=True).items()
        own = {name: hint for name, hint in hints if get_origin(hint) is not ClassVar}
        cls.settings = {cls.renamed.get(name, name): (name, hint) for name, hint in own.items()}

    def __post_init__(self) -> None:
        for flat, (name, hint) in self.settings.items():
            object.__setattr__(self, name, checked(flat, getattr(self, name), hint))
        for message in self.conflicts():
            raise ValueError(message)

    def __getattr__(self, name: str) -> Any:
        if name in EARLIER:
            return getattr(self, EARLIER[name])
        raise AttributeError(f"{type(self).__name__} has no {name}")

    def conflicts(self) -> Iterator[str]:
        """Yield what does not fit together, and what to do about it."""
        yield from ()


def kinds(base: type[Checked]) -> dict[str, type[Checked]]:
    """Return the types of a group, by their kinds; an ablation's once its module is imported."""
    types = {base.kind: base}
    for kind in base.__subclasses__():
        types |= kinds(kind)
    return types


def checked(name: str, value: Any, hint: Any) -> Any:
    """Return a value as a plain one of the type that is wanted, in its usual spelling.

    ValueError names the setting if it is of another type, not finite, or out of range.
    """
    if isinstance(value, str):
        value = SYNONYMS.get(name, {}).get(value, value)
    try:
        return _plain(value, hint)
    except ValueError:
        raise ValueError(f"{name} is {value!r}; expected {wanted(hint)}") from None


def _plain(value: Any, hint: Any) -> Any:
    origin, args = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return None if value is None else _plain(value, args[0])
    if origin is Annotated:
        plain, is_allowed = _plain(value, args[0]), args[2]
        if is_allowed(plain):
            return plain
    elif origin is tuple and isinstance(value, tuple | list):
        hints = args[:1] * len(value) if args[-1] is ... else args
        return tuple(_plain(part, own) for part, own in zip(value, hints, strict=True))
    elif origin is Literal and isinstance(value, str) and value in args:
        return str(value)
    elif hint in PLAIN and isinstance(value, PLAIN[hint][0]):
        # True is no number, though Python counts it among them.
        is_bool = isinstance(value, bool | np.bool_)
        if is_bool == (hint is bool) and (hint is not float or math.isfinite(value)):
            return hint(value)
    raise ValueError


def wanted(hint: Any) -> str:
    """Return what a setting's type asks for, in words."""
    origin, args = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return f"{wanted(args[0])} {args[1]}"
    if origin in (Union, UnionType):
        return f"{wanted(args[0])}, or None"
    if origin is Literal:
        return f"one of {args}"
    if origin is tuple and args[-1] is ...:
        return f"a tuple, each part {wanted(args[0])}"
    return f"{len(args)} numbers" if origin is tuple else PLAIN[hint][1]
