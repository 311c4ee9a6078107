"""Settings that are checked: against the types of their fields, and against ranges."""

import math
from dataclasses import fields
from functools import cache
from numbers import Integral, Real
from types import UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    NamedTuple,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)


class Range(NamedTuple):
    """Where a number has to be; `above` says that `low` itself is too low."""

    low: float = -math.inf
    high: float = math.inf
    above: bool = False

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high and not (self.above and value == self.low)

    def __str__(self) -> str:
        if self.high < math.inf:
            return f"in [{self.low:g}, {self.high:g}]"
        return f"above {self.low:g}" if self.above else f"of at least {self.low:g}"


Count = Annotated[int, Range(1)]
NonNegativeInt = Annotated[int, Range(0)]
Positive = Annotated[float, Range(0, above=True)]
Fraction = Annotated[float, Range(0, 1)]
Sizes = tuple[Count, ...]


class Checked:
    """Settings whose values are checked against the types of their fields."""

    kind: ClassVar[str] = ""
    renamed: ClassVar[dict[str, str]] = {}
    """Flat names of fields that another group has as well."""

    def __post_init__(self) -> None:
        for name, hint in settings(type(self)).items():
            flat = self.renamed.get(name, name)
            object.__setattr__(self, name, checked(flat, getattr(self, name), hint))


@cache
def settings(group: type) -> dict[str, Any]:
    """Return the names and types of a group's settings."""
    hints = get_type_hints(group, include_extras=True)
    return {field.name: hints[field.name] for field in fields(group)}


def kinds(base: type[Checked]) -> dict[str, type[Checked]]:
    """Return the types of a group, by their kinds; an ablation's once its module is imported."""
    found = {base.kind: base}
    for kind in base.__subclasses__():
        found |= kinds(kind)
    return found


def checked(name: str, value: Any, hint: Any) -> Any:
    """Return a value as a plain one of the type that is wanted.

    Raises:
        ValueError: it is of another type, not finite, or out of range; names the setting.
    """
    try:
        return _checked(value, hint)
    except ValueError:
        raise ValueError(f"{name} is {value!r}; expected {wanted(hint)}") from None


def _checked(value: Any, hint: Any) -> Any:
    origin, args = get_origin(hint), get_args(hint)
    if origin is Annotated:
        value = _checked(value, args[0])
        if value not in args[1]:
            raise ValueError
        return value
    if origin in (Union, UnionType):
        if all(get_origin(arg) is Literal for arg in args):
            hint, origin, args = None, Literal, sum((get_args(arg) for arg in args), ())
        else:
            return None if value is None else _checked(value, args[0])
    if origin is Literal:
        if not isinstance(value, str) or value not in args:
            raise ValueError
        return str(value)
    if origin is tuple:
        if not isinstance(value, tuple | list):
            raise ValueError
        kinds = [args[0]] * len(value) if args[-1] is ... else args
        if len(kinds) != len(value):
            raise ValueError
        return tuple(_checked(part, kind) for part, kind in zip(value, kinds, strict=True))
    is_bool = type(value).__name__ in ("bool", "bool_")  # Python's and NumPy's
    if hint is bool and is_bool:
        return bool(value)
    if hint is int and isinstance(value, Integral) and not is_bool:
        return int(value)
    if hint is float and isinstance(value, Real) and not is_bool and math.isfinite(value):
        return float(value)
    if hint is str and isinstance(value, str):
        return value
    raise ValueError


def wanted(hint: Any) -> str:
    """Return what a setting's type asks for, in words."""
    origin, args = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return f"{wanted(args[0])} {args[1]}"
    if origin in (Union, UnionType):
        if all(get_origin(arg) is Literal for arg in args):
            return f"one of {sum((get_args(arg) for arg in args), ())}"
        return f"{wanted(args[0])}, or None"
    if origin is Literal:
        return f"one of {args}"
    if origin is tuple:
        return (
            f"a tuple, each part {wanted(args[0])}" if args[-1] is ... else f"{len(args)} numbers"
        )
    names = {bool: "True or False", int: "a whole number", float: "a number", str: "a text"}
    return names[hint]
