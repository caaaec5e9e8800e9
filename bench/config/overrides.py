"""Overrides: a mapping from fields to the values to sweep over, read from a command line or a call from Python.

Command lines use Hydra's override grammar.
"""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from bench.config.choices import GROUPS, check_choice, choices
from bench.config.fields import RECORD, declared, taken_as_written
from bench.config.files import ENDING
from bench.errors import InputError, did_you_mean

BRANCHED = (*GROUPS, "fixed", "nominal")
"""Fields with fields below them."""
MOST_VALUES = 100_000
"""Largest number of values of a field in a sweep."""
DELETED: Final = object()
"""Marks a field below a group that ``~`` removes."""
NONE: Mapping[str, str | None] = {"prior": "none", "disturbance": "none", "experiment": None}
"""Groups that ``~`` removes, with the choice that this means."""

UNITS = {"snr": "dB", "rate": "Hz"}
"""Units that may follow the value of a field: ``snr=20dB``."""

WORDS = ("null", "true", "false", "nan", "inf")
"""Words that Hydra reads as text only in quotes."""
Overrides = Mapping[str, list[Any]]
"""Values by field, such as ``snr`` or ``method.width``; several values are swept over."""


def settable() -> tuple[str, ...]:
    """Return the names of all fields that can be set."""
    return (*declared(), "experiment")


def overrides_of(*settings: Mapping[str, Any]) -> Overrides:
    """Convert settings from Python to overrides.

    Args:
        *settings: Values by field. A list, tuple, range or array is swept over, a mapping sets the fields below its
            field, and None leaves a field unset.

    Raises:
        InputError: A field or choice is unknown, a sweep is empty, or a field is set twice.
    """
    overrides: dict[str, list[Any]] = {}
    for field, value in [item for part in settings for item in part.items() if item[1] is not None]:
        below = (
            {f"{field}.{key}": item for key, item in value.items()} if isinstance(value, Mapping) else {field: value}
        )
        for key, item in below.items():
            check_field(key, item)
            _add(overrides, key, _values(item), str(item))
    return overrides


def _values(item: Any) -> list[Any]:
    """Return the values to sweep over, as plain Python numbers."""
    if hasattr(item, "tolist"):  # a numpy array or scalar
        item = item.tolist()
    if isinstance(item, list | tuple | range):
        return [value.item() if hasattr(value, "item") else value for value in item]
    return [str(item) if isinstance(item, Path) else item]


def _add(
    overrides: dict[str, list[Any]], field: str, values: list[Any], text: str, unchecked: Sequence[str] = ()
) -> None:
    """Add a field with its values; the choices of ``unchecked`` groups are checked later, when records are read."""
    if field in overrides:
        raise InputError(field, text, "given twice; give it once")
    if not values:
        raise InputError(field, text, "give at least one value")
    if len(values) > MOST_VALUES:
        raise InputError(field, text, f"more than {MOST_VALUES} values")
    if any("${" in str(value) for value in values):
        raise InputError(field, text, "write the value itself; ${...} is not supported")
    if field in GROUPS and field not in unchecked and not (unchecked and values == ["all"]):
        for value in values:
            check_choice(field, value)
    overrides[field] = values


def check_field(field: str, value: Any) -> None:
    """Raise InputError for an unknown field."""
    group, _, below = field.partition(".")
    if group not in settable():
        near = did_you_mean(field, settable())
        raise InputError(field, value, f"not a field; {near}fields: {', '.join(settable())}")
    if below and group not in BRANCHED:
        raise InputError(field, value, f"{group} has no fields below it; write {group}=<value>")
    if below == "name" and group in GROUPS:
        raise InputError(field, value, f"cannot be changed alone; select another by {group}=<name>")


def read_overrides(texts: Sequence[str]) -> Overrides:
    """Parse a command line of ``field=value`` in Hydra's grammar; raises InputError.

    The prefixes ``+`` and ``++`` have no effect, since all fields are declared. Texts and paths are not parsed.
    """
    of_record = any(text.startswith("data=") and text != "data=null" for text in texts)
    unchecked = ("system", *(("method",) if any(text.startswith("modes=") for text in texts) else ()))
    overrides: dict[str, list[Any]] = {}
    for text in texts:
        key, values = _deleted(text) if text.startswith("~") else _assigned(text.lstrip("+"))
        _add(overrides, key, values, text.partition("=")[2], unchecked if of_record else ())
    return overrides


def _deleted(text: str) -> tuple[str, list[Any]]:
    field = text[1:].partition("=")[0]
    group, _, below = field.partition(".")
    if below and group in GROUPS:
        return field, [DELETED]
    if field not in NONE:
        raise InputError(f"~{field}", "", f"only {', '.join(NONE)} and fields below a group can be removed")
    return field, [NONE[field]]


def _assigned(text: str) -> tuple[str, list[Any]]:
    key, equals, value = text.partition("=")
    if not key or not equals:
        fields = [
            name for name in settable() if text in (choices(name) if name in GROUPS else declared()[name].choices)
        ]
        near = f"did you mean {fields[0]}={text}? " if fields else ""
        raise InputError("argument", repr(text), f"{near}write field=value, without spaces or dashes, see --help")
    if key in taken_as_written() or (key == "system" and value.endswith(ENDING) and not set(value) & set(",()")):
        return key, [_unquoted(key, value)]
    check_field(key, value)
    return key, values_of(key, value)


def _unquoted(field: str, text: str) -> str | None:
    """Remove surrounding quotes and expand ``~``; None for null. Raises InputError for an empty text."""
    if len(text) > 1 and text[0] == text[-1] and text[0] in "'\"":
        text = text[1:-1]
    if not text:
        raise InputError(field, text, "name a folder" if field == "store" else "give a value, or leave the field out")
    return None if text == "null" else os.path.expanduser(text)


def values_of(field: str, text: str) -> list[Any]:
    """Parse one value, or the values of a sweep, with Hydra's parser; raises InputError."""
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.core.override_parser.types import Glob, IntervalSweep, QuotedString
    from hydra.errors import HydraException

    try:
        override = OverridesParser.create().parse_override(f"x={text}")
        value = override.value()
        values: list[Any] = [value]
        if isinstance(value, Glob):
            values = value.filter(choices(field)) if field in GROUPS else []
        elif isinstance(value, IntervalSweep):
            raise InputError(field, text, "an interval has no values to run; list some, or write range(1,10)")
        elif override.is_sweep_override():
            values = list(itertools.islice(override.sweep_iterator(), MOST_VALUES + 1))
    except InputError:
        raise
    except (HydraException, ValueError, TypeError, ArithmeticError, RecursionError):
        remedy = f"""not understood; quote a text with special characters: "{field}='{text.replace("'", "")}'\""""
        raise InputError(field, text, remedy) from None
    if not values:
        raise InputError(field, text, "matches no value")
    return [_without_unit(field, item.text if isinstance(item, QuotedString) else item) for item in values]


def literal(value: Any) -> str:
    """Return a value in Hydra's override grammar."""
    if isinstance(value, list | tuple):
        return f"[{','.join(map(literal, value))}]"
    if isinstance(value, Mapping):
        return f"{{{','.join(f'{key}:{literal(item)}' for key, item in value.items())}}}"
    if value is None or isinstance(value, bool):
        return json.dumps(value)
    if not isinstance(value, str) or (value.isidentifier() and value.lower() not in WORDS):
        return str(value)
    from hydra.core.override_parser.types import Quote, QuotedString

    return QuotedString(value, Quote.single).with_quotes()


def _without_unit(field: str, value: Any) -> Any:
    """Convert a text such as ``20dB`` to a number; other values are returned unchanged."""
    unit = UNITS.get(field)
    if unit is None or not isinstance(value, str) or not value.endswith(unit):
        return value
    try:
        return float(value.removesuffix(unit))
    except ValueError:
        return value


def check_record_fields(overrides: Overrides) -> None:
    """Raise InputError if a field of a measured record is set without a record."""
    for field, values in overrides.items():
        if field.split(".")[0] in RECORD and values != [None]:
            raise InputError(field, values[0], "requires a measured record; add data=<file>, or leave it out")
