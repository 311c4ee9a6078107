"""Configurations from texts: the points of a grid, and the options of the command line."""

import itertools
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Annotated, Any, TypedDict, get_type_hints

from docstring_parser import parse_from_object
from tyro.conf import OmitArgPrefixes, arg

from offairl_lite.config import GROUPS, Config, flat_settings, used_settings
from offairl_lite.config.settings import checked, current, kinds
from offairl_lite.experiments import Experiment
from offairl_lite.scale import Scale

HELP = {
    "reward": "What the learner maximises: a variant of the paper's reward, DAC's, or GAIL's of "
    "either sign; the task's own (environment); one that was learned before (frozen); or, with "
    "SAC, labels instead of a reward (sqil, iq-learn). gan-gcl is in records alone.",
    "learner": "What trains the policy. sac-released is SAC as in the paper's released code.",
    "ablation": "DAC without actions (state-pairs), or the penalty of the paper's released code.",
}
"""What an option is for, where no group has it as a field."""


def options(config: Config) -> dict[str, Any]:
    """Return types from which tyro makes options of all settings: one for each group.

    They are TypedDicts, which hold only the settings that are given; `config` has the defaults that
    are shown.
    """
    flat, texts, known = config.flat(), docstrings(), flat_settings()
    # Types without their ranges, which the configuration knows.
    annotations = {name: hint for name, (hint, _, _) in known.items()}
    plain = get_type_hints(type("Plain", (), {"__annotations__": annotations}))
    fields: dict[str, dict[str, Any]] = {group: {} for group in GROUPS}
    for name, (_, default, group) in known.items():
        value = flat.get(name, default)
        text = " ".join(map(str, value)) if isinstance(value, tuple) else str(value)
        note = f"(default: {text})" if name in flat else f"(default, where it has a use: {text})"
        help_text = arg(help=texts[name], help_behavior_hint=note)
        fields[group][name] = Annotated[plain[name], help_text]
    typed_dict: Any = TypedDict
    return {
        group: Annotated[typed_dict(group, settings, total=False), OmitArgPrefixes]
        for group, settings in fields.items()
    }


def docstrings() -> dict[str, str]:
    """Return what the settings are for, by their flat names."""
    texts = dict(HELP)
    for base in GROUPS.values():
        for kind in kinds(base).values():
            bases = [parent for parent in kind.__mro__ if parent.__module__ != "builtins"]
            for field in (field for parent in bases for field in parse_from_object(parent).params):
                name = kind.renamed.get(field.arg_name, field.arg_name)
                texts.setdefault(name, " ".join((field.description or "").split()))
    return {name: texts[name] for name in flat_settings()}


def points(
    experiment: Experiment,
    scale: Scale,
    chosen: Mapping[str, Any],
    axes: Sequence[str] = (),
    only: Sequence[str] = (),
) -> dict[str, Config]:
    """Return the configurations of an experiment's own runs, or of some, times a grid.

    Settings that are `chosen` for all runs are left out of those that have no use for them.
    ValueError: a run sets something else itself, or no run has a use for a setting.
    """
    base, variants = experiment.configs[scale], experiment.variants or {"": {}}
    if unknown := set(only) - set(variants):
        known = ", ".join(variants) or "none, since the experiment is one run"
        raise ValueError(f"no runs {sorted(unknown)}; there are: {known}")
    selected = {}
    for variant in only or variants:
        changes = variants[variant]
        conflicts = sorted(n for n in changes.keys() & chosen.keys() if changes[n] != chosen[n])
        if conflicts:
            raise ValueError(
                f"{variant} sets {' and '.join(conflicts)} itself: vary that with grid=, which "
                "comes last, or choose other runs with only="
            )
        settings = {**changes, **chosen}
        used = used_settings(base.flat() | settings)
        config = base.change(**{name: value for name, value in settings.items() if name in used})
        for name, point in grid(config, axes).items():
            selected[",".join(filter(None, (variant, name)))] = point
    for name, value in chosen.items():
        if not any(name in point.flat() for point in selected.values()):
            next(iter(selected.values())).change(**{name: value})  # It says why that has no use.
    return selected


def grid(config: Config, axes: Sequence[str]) -> dict[str, Config]:
    """Return the configurations of a grid, by names such as `reward=dac,temperature=0.1`.

    Each of `axes` has a setting and its values, such as `temperature=0.1,none`; the numbers of a
    tuple are separated by `x`, as in `hidden=400x300`. Without any the only name is empty.
    """
    known, values = flat_settings(), {}
    for axis in axes:
        name, equals, texts = axis.partition("=")
        (name,) = current({name.replace("-", "_"): None})
        if not equals or name in values:
            raise ValueError(f"grid={axis}: expected SETTING=VALUE,VALUE, and each setting once")
        if name not in known:
            names = ", ".join(known).replace("_", "-")
            raise ValueError(f"no setting {name!r} to vary; there are: {names}")
        values[name] = [(name, _value(name, text, known[name][0])) for text in texts.split(",")]
    configs: dict[str, Config] = {}
    for point in itertools.product(*values.values()):
        title = ",".join(f"{name}={_text(value)}" for name, value in point).replace("/", "-")
        if title in configs:
            raise ValueError(f"{title} is in the grid twice: give every value once")
        try:
            configs[title] = config.change(**dict(point))
        except ValueError as error:
            raise ValueError(f"{title}: {error}" if title else str(error)) from error
    return configs


def _text(value: Any) -> str:
    """Return a value as it is written in a grid and in the names of folders."""
    if isinstance(value, tuple):
        return "x".join(map(_text, value))
    return str(value).lower() if value is None or isinstance(value, bool) else str(value)


def _value(name: str, text: str, hint: Any) -> Any:
    """Return the value that a text stands for: the first of its readings that the setting takes."""
    for reading in (text, _literal(text), tuple(map(_literal, text.split("x")))):
        with suppress(ValueError):
            return checked(name, reading, hint)
    return checked(name, _literal(text), hint)  # It says what is expected.


def _literal(text: str) -> Any:
    """Return the None, the truth value or the number that a text is, or the text."""
    for reading in ({"none": None, "true": True, "false": False}.__getitem__, int, float):
        with suppress(KeyError, ValueError):
            return reading(text)
    return text
