"""Configurations from texts: the points of a grid, and the options of the command line."""

import itertools
from collections.abc import Iterable
from dataclasses import fields
from types import UnionType
from typing import Any, get_args, get_origin

from offairl_lite.config import Config


def field_types() -> dict[str, Any]:
    """Return the type of every field of a flat configuration."""
    return {field.name: field.type for field in fields(Config)}


def options(config: Config) -> tuple[type, Any]:
    """Return a dataclass whose fields are the options of a configuration, and its defaults."""
    return Config, config


def configuration(chosen: Any) -> Config:
    """Return the configuration of chosen `options`."""
    return Config.of(**{name: getattr(chosen, name) for name in field_types()})


def grid(config: Config, **values: Iterable[Any]) -> dict[str, Config]:
    """Return the configurations of a grid, by names such as `reward=dac,temperature=0.1`.

    Args:
        config: what all have in common.
        values: for each field to vary, its values or their texts: `none`, `true`, `false`; the
            numbers of a tuple are separated by `x`, as in `hidden=400x300`.

    Raises:
        ValueError: there is no such field, or it cannot have such a value, or a value is given
            twice.
    """
    kinds = field_types()
    for name in values.keys() - kinds.keys():
        raise ValueError(f"no field {name!r} to vary; there are: {', '.join(kinds)}")
    axes = [
        [(name, parse(name, text(v), kinds[name])) for v in some] for name, some in values.items()
    ]
    points: dict[str, Config] = {}
    for point in itertools.product(*axes):
        name = ",".join(f"{field}={text(value)}" for field, value in point).replace("/", "-")
        if name in points:
            raise ValueError(f"{name} is in the grid twice: give every value once")
        try:
            points[name] = config.change(**dict(point))
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from error
    if not points or not values:
        raise ValueError("the grid is empty: give a field and at least one value")
    return points


def axes(given: Iterable[str]) -> dict[str, list[str]]:
    """Return the fields and texts of options such as `temperature=0.1,none`.

    Raises:
        ValueError: an option has another form, or a field is given twice.
    """
    values: dict[str, list[str]] = {}
    for axis in given:
        name, equals, texts = axis.partition("=")
        name = name.replace("-", "_")
        if not equals or name in values:
            raise ValueError(f"--grid {axis}: expected FIELD=VALUE,VALUE, and each field once")
        values[name] = texts.split(",")
    return values


def text(value: Any) -> str:
    """Return a value as it is written in a grid and in the names of folders."""
    if isinstance(value, tuple | list):
        return "x".join(map(text, value))
    return str(value).lower() if value is None or isinstance(value, bool) else str(value)


def parse(name: str, written: str, kind: Any) -> Any:
    """Return the value that a text stands for in a field of some type.

    Raises:
        ValueError: the text is not of this type.
    """
    try:
        if get_origin(kind) is UnionType:  # of something and None
            return None if written == "none" else parse(name, written, get_args(kind)[0])
        if get_origin(kind) is tuple:
            one, *more = get_args(kind)
            parts = tuple(parse(name, part, one) for part in written.split("x"))
            if more != [...] and len(parts) != 1 + len(more):
                raise ValueError
            return parts
        if kind is bool:
            return {"true": True, "false": False}[written.lower()]
        return kind(written) if kind in (int, float) else written  # Config knows the choices
    except (KeyError, ValueError):
        kind = kind.__name__ if isinstance(kind, type) else kind
        raise ValueError(f"{name} is {written!r}; expected {kind}") from None
