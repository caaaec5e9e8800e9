"""What is asked for beside the defaults: a mapping from fields to the values to sweep over, and how it is written.

A command line and a call from Python become the same mapping; an experiment's file holds such mappings too.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from bench.config.choices import GROUPS, check_choice, choices
from bench.config.files import ENDING
from bench.config.suggest import did_you_mean
from bench.errors import InputError

TEXTS = ("data", "columns", "units", "picture", "store", "archive", "retry")
"""Fields whose values are taken as they are written, and are not swept over: paths may hold any letter."""
PATHS = ("store", "archive", "picture")
BRANCHED = (*GROUPS, "fixed", "nominal")
"""Fields that have others below them."""
OF_RECORDS = (
    "columns", "units", "rate", "from", "to", "decimate", "detrend", "force_gain", "hold", "fixed", "nominal", "start",
    "plot", "picture",
)  # fmt: skip
"""Fields that say something of a measured record alone."""
MOST_VALUES = 100_000
"""Of one field of a sweep."""
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
            _check_plain(key, found[key])
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
    group, _, below = field.partition(".")
    if group not in settable():
        near = did_you_mean(field, settable())
        raise InputError(field, value, f"not a field; {near}fields: {', '.join(settable())}")
    if below and group not in BRANCHED:
        raise InputError(field, value, f"{group} has no fields below it; write {group}=<value>")
    if below == "name" and group in GROUPS:
        raise InputError(field, value, f"a name stands for all that it brings; choose it by {group}=<name>")


def _check_plain(field: str, values: Sequence[Any]) -> None:
    """Raise InputError for a text that Hydra would take for something else than itself."""
    for value in values:
        if "${" in str(value):
            raise InputError(field, value, "write the value itself; ${...} is not looked up")


def read_overrides(texts: Sequence[str]) -> Overrides:
    """The overrides of a command line, written in Hydra's grammar."""
    from hydra.core.override_parser.overrides_parser import OverridesParser

    parser = OverridesParser.create()
    of_record = any(text.startswith("data=") and text != "data=null" for text in texts)
    values: dict[str, list[Any]] = {}
    for text in texts:
        key = text.partition("=")[0]
        if not key:
            raise InputError("argument", repr(text), _how_to_write(text))
        if key in TEXTS or (key == "system" and _is_path(_after_equals(text))):
            found = [_text(key, _after_equals(text))]
        else:
            key, found = _parsed(parser, text)
        if key in values:
            raise InputError(key, _after_equals(text), "given twice; give it once")
        _check_plain(key, found)
        values[key] = found
        if key in GROUPS and not (of_record and (key == "system" or (key, values[key]) == ("method", ["all"]))):
            for value in values[key]:
                check_choice(key, value)
    return values


def _parsed(parser: Any, text: str) -> tuple[str, list[Any]]:
    """The field of an argument and its values; raises InputError."""
    from hydra.errors import HydraException

    try:
        override = parser.parse_overrides([text])[0]
        key = override.get_key_element()
        check_field(key, _after_equals(text))
        return key, _swept(override, key, text)
    except InputError:
        raise
    except (HydraException, ValueError, TypeError, ArithmeticError, RecursionError):
        raise _not_understood(text) from None


def _is_path(text: str) -> bool:
    """Whether a value is the path of one file, whatever letters are in it."""
    return text.endswith(ENDING) and not set(text) & set(",()")


def _text(field: str, text: str) -> str | None:
    """The value of a field that is taken as it is written, without the quotes around it; raises InputError."""
    if len(text) > 1 and text[0] == text[-1] and text[0] in "'\"":
        text = text[1:-1]
    if not text:
        raise InputError(field, text, "name a folder" if field == "store" else "give a value, or leave the field out")
    return None if text == "null" else os.path.expanduser(text) if field in PATHS else text


def _not_understood(text: str) -> InputError:
    """What is wrong with an argument that Hydra's grammar has no place for."""
    field, equals, value = text.partition("=")
    if equals and field.split(".")[0] in settable():
        quoted = value.replace("'", "")
        remedy = f"""not understood; a text with signs in it is quoted: "{field}='{quoted}'\""""
        return InputError(field, value, remedy)
    return InputError("argument", repr(text), _how_to_write(text))


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
    from hydra.core.override_parser.types import Glob, IntervalSweep, QuotedString, RangeSweep

    if not override.is_sweep_override():
        value = override.value()
        return [value.text if isinstance(value, QuotedString) else value]
    if isinstance(override.value(), Glob):
        found = override.value().filter(choices(key)) if key in GROUPS else []
        if not found:
            raise InputError(key, _after_equals(text), "matches nothing")
        return list(found)
    if isinstance(override.value(), IntervalSweep):
        raise InputError(key, _after_equals(text), "an interval has no values to run; list some, or write range(1,10)")
    if isinstance(override.value(), RangeSweep):
        _check_range(key, _after_equals(text), override.value())
    found = [v.text if isinstance(v, QuotedString) else v for v in override.sweep_iterator()]
    if not found:
        raise InputError(key, _after_equals(text), "sweeps over nothing")
    return found


def _check_range(field: str, text: str, found: Any) -> None:
    """Raise InputError for a range without end, or with more values than anybody means."""
    start = found.start or 0.0
    if not found.step or not all(map(math.isfinite, (start, found.stop, found.step))):
        raise InputError(field, text, "range(start,stop,step) of finite numbers, with a step that is not 0")
    count = (found.stop - start) / found.step
    if count > MOST_VALUES:
        raise InputError(field, text, f"it stands for {count:.3g} values; at most {MOST_VALUES}")


def check_of_records(overrides: Overrides) -> None:
    """Raise InputError where something is said of a measured record, and there is none."""
    for field, values in overrides.items():
        if field.split(".")[0] in OF_RECORDS and values != [None]:
            raise InputError(field, values[0], "it is of a measured record; name one by data=, or leave it out")
