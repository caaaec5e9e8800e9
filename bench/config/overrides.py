"""What is asked for beside the defaults: a mapping from fields to the values to sweep over, and how it is written.

A command line and a call from Python become the same mapping; an experiment's file holds such mappings too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from bench.config.choices import GROUPS, check_choice, choices
from bench.config.suggest import did_you_mean
from bench.errors import InputError

OF_EXPERIMENTS = ("draw", "sweep", "also", "replicates_by_method", "table")
"""Fields that an experiment alone sets."""

Overrides = Mapping[str, list[Any]]
"""Fields such as ``snr`` or ``method.width``, each with its values: one, or several to sweep over."""


@cache
def settable() -> tuple[str, ...]:
    """The fields that can be set: groups first, then those of ``conf/config.yaml`` in their order."""
    lines = files("conf").joinpath("config.yaml").read_text(encoding="utf-8").splitlines()
    named = (line.partition(":")[0] for line in lines if line[:1].isalpha())
    plain = [name for name in named if name not in (*OF_EXPERIMENTS, "defaults")]
    return (*GROUPS[:-1], *plain, GROUPS[-1])


def of_launcher(text: str) -> bool:
    """Whether an override is one of Hydra's own: ``hydra/launcher=ray``, ``hydra.launcher.partition=debug``."""
    return text.lstrip("+~").startswith(("hydra/", "hydra."))


def overrides_of(*settings: Mapping[str, Any]) -> Overrides:
    """Settings from Python as overrides: a list, tuple, range or array is swept over, a mapping sets what is below it.

    None stands for what is not set. Raises InputError for an unknown field or choice, for nothing to sweep over, and
    for a field that is set twice.
    """
    found: dict[str, list[Any]] = {}
    for field, value in [item for part in settings for item in part.items() if item[1] is not None]:
        nested = isinstance(value, Mapping)
        for key, item in (
            {f"{field}.{key}": item for key, item in value.items()}.items() if nested else [(field, value)]
        ):
            check_field(key, item)
            if key in found:
                raise InputError(key, item, "given twice; give it once")
            found[key] = _values(item)
            if not found[key]:
                raise InputError(key, item, "sweeps over nothing")
            for choice in found[key] if key in GROUPS else []:
                check_choice(key, choice)
    return found


def _values(item: Any) -> list[Any]:
    """The values to sweep over, as Python's own numbers."""
    if hasattr(item, "tolist"):  # of numpy: an array, or one number
        item = item.tolist()
    if isinstance(item, list | tuple | range):
        return [value.item() if hasattr(value, "item") else value for value in item]
    return [str(item) if isinstance(item, Path) else item]


def check_field(field: str, value: Any) -> None:
    """Raise InputError for a field that cannot be set."""
    if field.split(".")[0] not in settable():
        near = did_you_mean(field, settable())
        raise InputError(field, value, f"not a field; {near}fields: {', '.join(settable())}")


def read_overrides(texts: Sequence[str]) -> Overrides:
    """The overrides of a command line, written in Hydra's grammar."""
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException

    parser = OverridesParser.create()
    of_record = any(text.startswith("data=") and text != "data=null" for text in texts)
    values: dict[str, list[Any]] = {}
    for text in texts:
        try:
            override = parser.parse_overrides([text])[0]
        except HydraException:
            raise InputError("argument", repr(text), _how_to_write(text)) from None
        key = override.get_key_element()
        check_field(key, _after_equals(text))
        if key in values:
            raise InputError(key, _after_equals(text), "given twice; give it once")
        values[key] = _swept(override, key, text)
        if key in GROUPS and not (of_record and (key == "system" or (key, values[key]) == ("method", ["all"]))):
            for value in values[key]:
                check_choice(key, value)
    return values


def _how_to_write(text: str) -> str:
    """What is wrong with an argument that is no ``field=value``."""
    groups = [group for group in GROUPS if text in choices(group)]
    if groups:
        return f"did you mean {groups[0]}={text}? write field=value, see --help"
    return "write field=value, without spaces or dashes, see --help"


def _after_equals(text: str) -> str:
    return text.partition("=")[2]


def _swept(override: Any, key: str, text: str) -> list[Any]:
    """The values of one argument: one, or those that its sweep stands for."""
    from hydra.core.override_parser.types import Glob, QuotedString

    if not override.is_sweep_override():
        value = override.value()
        return [value.text if isinstance(value, QuotedString) else value]
    if isinstance(override.value(), Glob):
        found = override.value().filter(choices(key)) if key in GROUPS else []
        if not found:
            raise InputError(key, _after_equals(text), "matches nothing")
        return list(found)
    found = [v.text if isinstance(v, QuotedString) else v for v in override.sweep_iterator()]
    if not found:
        raise InputError(key, _after_equals(text), "sweeps over nothing")
    return found
