"""Configurations from texts: the points of a grid, and the options of the command line."""

import ast
import inspect
import itertools
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypedDict, Union, get_args, get_origin

from tyro.conf import OmitArgPrefixes, arg

from offairl_lite.config import (
    Config,
    DiscriminatorConfig,
    LearnerConfig,
    Schedule,
    flat_settings,
    used_settings,
)
from offairl_lite.config.settings import kinds, settings, wanted

HELP = {
    "reward": "What the learner maximises: a variant of the paper's reward, DAC's, GAIL's of "
    "either sign, or GAN-GCL's; the task's own (environment); or one that was learned before "
    "(frozen).",
    "learner": "What trains the policy. sac-released is SAC as in the paper's released code.",
    "ablation": "Another bound on the discriminator, from chapter 6. None: the gradient penalty.",
}
"""What an option is for, where no group has it as a field."""


def options(config: Config) -> dict[str, Any]:
    """Return types from which tyro makes options of all settings: one for each group.

    They are TypedDicts, which hold only the settings that are given.

    Args:
        config: whose settings are shown as the defaults.
    """
    flat, texts = config.flat(), docstrings()
    fields: dict[str, dict[str, Any]] = {"schedule": {}, "learner": {}, "discriminator": {}}
    for name, (hint, default, group) in flat_settings().items():
        value = flat.get(name, default)
        shown = " ".join(map(str, value)) if isinstance(value, tuple) else str(value)
        note = f"(default: {shown})" if name in flat else f"(default, where it has a use: {shown})"
        about = arg(help=texts[name], help_behavior_hint=note)
        fields[group][name] = Annotated[_plain(hint), about]
    return {
        group: Annotated[TypedDict(group, own, total=False), OmitArgPrefixes]
        for group, own in fields.items()
    }


def docstrings() -> dict[str, str]:
    """Return what the settings are for, by their flat names."""
    texts = dict(HELP)
    for base in (Schedule, LearnerConfig, DiscriminatorConfig):
        for kind in kinds(base).values():
            for parent in kind.__mro__:
                for name, text in _docstrings_of(parent):
                    if name in settings(kind):
                        texts.setdefault(kind.renamed.get(name, name), text)
    return texts


def _docstrings_of(group: type) -> Iterable[tuple[str, str]]:
    """Yield the fields of a class with the docstrings below them, which only its source has."""
    if group.__module__.startswith("offairl_lite."):
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(group))).body
        for field, below in itertools.pairwise(tree.body):
            if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr):
                yield field.target.id, " ".join(below.value.value.split())


def _plain(hint: Any) -> Any:
    """Return a type without ranges, and with one literal in the place of several."""
    origin, args = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _plain(args[0])
    if origin in (Union, UnionType):
        if all(get_origin(arg) is Literal for arg in args):
            return Literal[tuple(choice for arg in args for choice in get_args(arg))]
        return Union[tuple(map(_plain, args))]  # noqa: UP007
    return tuple[tuple(map(_plain, args))] if origin is tuple else hint


def point(run: str, base: Config, changes: Mapping[str, Any], given: Mapping[str, Any]) -> Config:
    """Return the configuration of one run of an experiment, with what was given for all its runs.

    Of what was given, settings for which this run has no use are left out.

    Args:
        run: its name.
        base: the configuration of the experiment.
        changes: what the run has otherwise.
        given: what was given for all runs.

    Raises:
        ValueError: the run itself sets to something else what was given.
    """
    if lost := [name for name in changes.keys() & given.keys() if changes[name] != given[name]]:
        raise ValueError(
            f"{run} sets {' and '.join(sorted(lost))} itself: vary that with --grid, which comes "
            "last, or choose other runs with --only"
        )
    asked, flat = {**changes, **given}, base.flat()
    chosen = (asked.get(name, flat.get(name)) for name in ("learner", "reward", "ablation"))
    used = used_settings(*chosen)
    return base.change(**{name: value for name, value in asked.items() if name in used})


def require_use(points: Iterable[Config], given: Mapping[str, Any]) -> None:
    """Refuse what was given and is of no use in any of these configurations.

    Raises:
        ValueError: there is such a setting.
    """
    first, *others = points
    for name, value in given.items():
        if not any(name in config.flat() for config in (first, *others)):
            first.change(**{name: value})  # It says why.


def written(given: Mapping[str, Any], names: Iterable[str]) -> str:
    """Return options as they are written on the command line."""
    words = []
    for name in names:
        option, value = name.replace("_", "-"), given[name]
        if isinstance(value, bool):
            words.append(f"--{option}" if value else f"--no-{option}")
        else:
            values = value if isinstance(value, tuple) else (value,)
            words += [f"--{option}", *map(str, values)]
    return " ".join(words)


@contextmanager
def options_named(given: Mapping[str, Any]) -> Iterator[None]:
    """Name the options that an error in the settings is about.

    Raises:
        ValueError: a setting makes no sense.
    """
    try:
        yield
    except ValueError as error:
        found = [name for name in given if re.search(rf"\b{name}\b", str(error))]
        raise ValueError(f"{written(given, found)}: {error}" if found else str(error)) from error


def grid(config: Config, **values: Iterable[Any]) -> dict[str, Config]:
    """Return the configurations of a grid, by names such as `reward=dac,temperature=0.1`.

    Args:
        config: what all have in common.
        values: for each setting to vary, its values or their texts: `none`, `true`, `false`; the
            numbers of a tuple are separated by `x`, as in `hidden=400x300`.

    Raises:
        ValueError: there is no such setting, or it cannot have such a value, or a value is given
            twice.
    """
    known = flat_settings()
    for name in values.keys() - known.keys():
        raise ValueError(f"no setting {name!r} to vary; there are: {', '.join(known)}")
    axes = [
        [(name, parse(name, text(v), known[name][0])) for v in some]
        for name, some in values.items()
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
        raise ValueError("the grid is empty: give a setting and at least one value")
    return points


def axes(given: Iterable[str]) -> dict[str, list[str]]:
    """Return the settings and texts of options such as `temperature=0.1,none`.

    Raises:
        ValueError: an option has another form, or a setting is given twice.
    """
    values: dict[str, list[str]] = {}
    for axis in given:
        name, equals, texts = axis.partition("=")
        name = name.replace("-", "_")
        if not equals or name in values:
            raise ValueError(f"--grid {axis}: expected SETTING=VALUE,VALUE, and each setting once")
        values[name] = texts.split(",")
    return values


def text(value: Any) -> str:
    """Return a value as it is written in a grid and in the names of folders."""
    if isinstance(value, tuple | list):
        return "x".join(map(text, value))
    return str(value).lower() if value is None or isinstance(value, bool) else str(value)


def parse(name: str, written: str, hint: Any) -> Any:
    """Return the value that a text stands for in a setting of some type.

    Raises:
        ValueError: the text is not of this type.
    """
    try:
        return _parsed(written, hint)
    except (KeyError, ValueError):
        raise ValueError(f"{name} is {written!r}; expected {wanted(hint)}") from None


def _parsed(written: str, hint: Any) -> Any:
    """Return a value of some type; whether it is in range, the configuration knows."""
    origin, args = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _parsed(written, args[0])
    if origin in (Union, UnionType):
        return None if written == "none" and NoneType in args else _parsed(written, args[0])
    if origin is tuple:
        parts = written.split("x")
        kinds_of_parts = args[:1] * len(parts) if args[-1] is ... else args
        if len(parts) != len(kinds_of_parts):
            raise ValueError
        return tuple(map(_parsed, parts, kinds_of_parts))
    if hint is bool:
        return {"true": True, "false": False}[written.lower()]
    return hint(written) if hint in (int, float) else written
