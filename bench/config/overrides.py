"""What is set beside the defaults: a mapping from fields to the values to sweep over, and how it is written.

A command line, in Hydra's grammar, and a call from Python become the same mapping; an experiment holds such mappings.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from bench.config.choices import GROUPS, check_choice, choices
from bench.config.fields import RECORD, choices_of, declared, taken_as_written
from bench.config.files import ENDING
from bench.config.suggest import did_you_mean
from bench.errors import InputError

BRANCHED = (*GROUPS, "fixed", "nominal")
"""Fields that have others below them."""
MOST_VALUES = 100_000
"""Most values of one field in a sweep."""
DELETED: Final = object()
"""Value of a field below a group that ``~`` removes."""
NONE: Mapping[str, str | None] = {"prior": "none", "disturbance": "none", "experiment": None}
"""Groups that ``~`` removes, by the choice that stands for nothing."""

Overrides = Mapping[str, list[Any]]
"""Fields such as ``snr`` or ``method.width``, each with its values: one, or several to sweep over."""


def settable() -> tuple[str, ...]:
    """Return the fields that can be set."""
    return (*declared(), "experiment")


def overrides_of(*settings: Mapping[str, Any]) -> Overrides:
    """Return settings from Python as overrides.

    Args:
        *settings: values by field: a list, tuple, range or array is swept over, a mapping sets what is below its field,
            None stands for what is not set.

    Raises:
        InputError: for an unknown field or choice, for nothing to sweep over, and for a field that is set twice.
    """
    overrides: dict[str, list[Any]] = {}
    for field, value in [item for part in settings for item in part.items() if item[1] is not None]:
        below = {f"{field}.{key}": item for key, item in value.items()} if isinstance(value, Mapping) else None
        for key, item in (below or {field: value}).items() if below != {} else ():
            check_field(key, item)
            _add(overrides, key, _listed(item), str(item))
            if key.partition(".")[0] in GROUPS and "." not in key:
                for choice in overrides[key]:
                    check_choice(key, choice)
    return overrides


def _listed(item: Any) -> list[Any]:
    """Return the values to sweep over, as Python's own numbers."""
    if hasattr(item, "tolist"):  # of numpy: an array, or one number
        item = item.tolist()
    if isinstance(item, list | tuple | range):
        return [value.item() if hasattr(value, "item") else value for value in item]
    return [str(item) if isinstance(item, Path) else item]


def _add(overrides: dict[str, list[Any]], field: str, values: list[Any], written: str) -> None:
    if field in overrides:
        raise InputError(field, written, "given twice; give it once")
    if not values:
        raise InputError(field, written, "sweeps over nothing")
    if any("${" in str(value) for value in values):
        raise InputError(field, written, "write the value itself; ${...} is not looked up")
    overrides[field] = values


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


def read_overrides(texts: Sequence[str]) -> Overrides:
    """Read a command line: ``field=value`` in Hydra's grammar, where ``+`` and ``++`` change nothing.

    Every field is declared, so there is none to append. Texts and paths are taken as they are written. Raises
    InputError.
    """
    of_record = any(text.startswith("data=") and text != "data=null" for text in texts)
    overrides: dict[str, list[Any]] = {}
    for text in texts:
        key, values = _deleted(text) if text.startswith("~") else _assigned(text.removeprefix("+").removeprefix("+"))
        _add(overrides, key, values, text.partition("=")[2])
        if key in GROUPS and not (of_record and (key == "system" or (key, values) == ("method", ["all"]))):
            for value in values:
                check_choice(key, value)
    return overrides


def _assigned(text: str) -> tuple[str, list[Any]]:
    key, equals, value = text.partition("=")
    if not key:
        raise InputError("argument", repr(text), _how_to_write(text))
    if equals and (key in taken_as_written() or (key == "system" and _is_path(value))):
        return key, [_unquoted(key, value)]
    return _parsed(text)


def _deleted(text: str) -> tuple[str, list[Any]]:
    field = text[1:].partition("=")[0]
    group, _, below = field.partition(".")
    if below and group in GROUPS:
        return field, [DELETED]
    if field not in NONE:
        raise InputError(f"~{field}", "", f"only {', '.join(NONE)} and fields below a group can be left out")
    return field, [NONE[field]]


def _parsed(text: str) -> tuple[str, list[Any]]:
    """Return the field of an argument and its values by Hydra's own parser; raises InputError."""
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException

    try:
        override = OverridesParser.create().parse_override(text)
        key = override.get_key_element()
        check_field(key, text.partition("=")[2])
        return key, _swept(override, key, text.partition("=")[2])
    except InputError:
        raise
    except (HydraException, ValueError, TypeError, ArithmeticError, RecursionError):
        raise _not_understood(text) from None


def _is_path(text: str) -> bool:
    """Return whether a value is the path of one file, whatever letters are in it."""
    return text.endswith(ENDING) and not set(text) & set(",()")


def _unquoted(field: str, text: str) -> str | None:
    """Return a text without the quotes around it, ``~`` as the home folder; None for null. Raises InputError."""
    if len(text) > 1 and text[0] == text[-1] and text[0] in "'\"":
        text = text[1:-1]
    if not text:
        raise InputError(field, text, "name a folder" if field == "store" else "give a value, or leave the field out")
    return None if text == "null" else os.path.expanduser(text)


def _not_understood(text: str) -> InputError:
    """Return what is wrong with an argument that Hydra's grammar does not accept."""
    field, equals, value = text.partition("=")
    if equals and field.split(".")[0] in settable():
        quoted = value.replace("'", "")
        remedy = f"""not understood; a text with signs in it is quoted: "{field}='{quoted}'\""""
        return InputError(field, value, remedy)
    return InputError("argument", repr(text), _how_to_write(text))


def _how_to_write(text: str) -> str:
    """Return what is wrong with an argument that is no ``field=value``."""
    fitting = [name for name in settable() if text in (choices(name) if name in GROUPS else choices_of(name))]
    if fitting:
        return f"did you mean {fitting[0]}={text}? write field=value, see --help"
    return "write field=value, without spaces or dashes, see --help"


def _swept(override: Any, key: str, text: str) -> list[Any]:
    """Return the values of one argument: one, or those of its sweep."""
    from hydra.core.override_parser.types import Glob, IntervalSweep, QuotedString, RangeSweep

    if not override.is_sweep_override():
        value = override.value()
        return [value.text if isinstance(value, QuotedString) else value]
    if isinstance(override.value(), Glob):
        matches = override.value().filter(choices(key)) if key in GROUPS else []
        if not matches:
            raise InputError(key, text, "matches nothing")
        return list(matches)
    if isinstance(override.value(), IntervalSweep):
        raise InputError(key, text, "an interval has no values to run; list some, or write range(1,10)")
    if isinstance(override.value(), RangeSweep):
        _check_range(key, text, override.value())
    return [v.text if isinstance(v, QuotedString) else v for v in override.sweep_iterator()]


def _check_range(field: str, text: str, sweep: Any) -> None:
    """Raise InputError for a range without end, or with too many values."""
    start = sweep.start or 0.0
    if not sweep.step or not all(map(math.isfinite, (start, sweep.stop, sweep.step))):
        raise InputError(field, text, "range(start,stop,step) of finite numbers, with a step that is not 0")
    count = (sweep.stop - start) / sweep.step
    if count > MOST_VALUES:
        raise InputError(field, text, f"it stands for {count:.3g} values; at most {MOST_VALUES}")


def written(values: Sequence[Any]) -> str:
    """Return values as a command line has them."""
    return ",".join(str(value).lower() if isinstance(value, bool) else str(value) for value in values)


def check_of_records(overrides: Overrides) -> None:
    """Raise InputError where a field of a measured record is set, and there is none."""
    for field, values in overrides.items():
        if field.split(".")[0] in RECORD and values != [None]:
            raise InputError(field, values[0], "it is of a measured record; name one by data=, or leave it out")
