"""The shape of a stored cell: of each key that readers rely on, what kind of value it has.

A checksum says that a file is as it was written, not that it was written by this benchmark. What passes here can be
read by every command; keys that are not named here may hold anything.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from bench.contract.estimate import Status

Check = Callable[[Any], bool]
OTHERS = frozenset({"inf", "-inf", "nan"})
"""How a file has the numbers that JSON lacks."""
STATUSES = frozenset(status.value for status in Status)


def is_text(value: Any) -> bool:
    """Whether a value is a text."""
    return isinstance(value, str)


def is_truth(value: Any) -> bool:
    """Whether a value is true or false."""
    return isinstance(value, bool)


def is_whole(value: Any) -> bool:
    """Whether a value is a whole number that 64 bits hold."""
    return type(value) is int and abs(value) < 2**63


def is_number(value: Any) -> bool:
    """Whether a value is a number as a file has it, or the name of one that JSON lacks."""
    return type(value) is float or is_whole(value) or (isinstance(value, str) and value in OTHERS)


def is_mapping(value: Any) -> bool:
    """Whether a value is a mapping, of whatever is in it."""
    return isinstance(value, dict)


def no_more_than(check: Check) -> Check:
    """That or nothing."""
    return lambda value: value is None or check(value)


def list_of(check: Check) -> Check:
    """A list of such values; one of floats, the usual long one, is seen at once."""
    numeric = check(0.0)

    def holds(value: Any) -> bool:
        if not isinstance(value, list):
            return False
        return (numeric and set(map(type, value)) == {float}) or all(map(check, value))

    return holds


def mapping_of(check: Check) -> Check:
    """A mapping from names to such values."""
    return lambda value: isinstance(value, dict) and all(map(check, value.values()))


def keys(needed: Mapping[str, Check], optional: Mapping[str, Check] | None = None) -> Check:
    """A mapping that has some keys, and perhaps others, with such values."""
    known = {**needed, **(optional or {})}

    def holds(value: Any) -> bool:
        return (
            isinstance(value, dict)
            and needed.keys() <= value.keys()
            and all(check(value[key]) for key, check in known.items() if key in value)
        )

    return holds


def is_start(value: Any) -> bool:
    """Whether a value is a displacement and a velocity of each of some masses."""
    return list_of(list_of(is_number))(value) and len(value) == 2 and len(value[0]) == len(value[1]) > 0


_NUMBER_OR_NONE = no_more_than(is_number)
_NUMBERS_BY_NAME = mapping_of(is_number)

DATA = keys(
    {},
    {
        "system": is_text, "options": is_mapping, "parameters": _NUMBERS_BY_NAME,
        "initial": is_start, "snr_db": is_number, "duration": is_number, "samples": is_whole,
        "force": no_more_than(is_mapping), "disturbance": no_more_than(keys({}, {"kind": is_text})),
        "added_mass": no_more_than(list_of(is_number)), "measured": no_more_than(list_of(is_whole)), "truth": is_text,
    },
)  # fmt: skip
WIDTHS = mapping_of(lambda value: is_number(value) or is_truth(value) or is_text(value))
DESCRIPTION = keys(
    {},
    {
        "method": is_text, "label": is_text, "system": is_text, "settings": is_mapping, "replicates": is_whole,
        "seed": is_whole, "snr_db": is_number, "initial_state": is_text, "data": DATA, "sigma": list_of(is_number),
        "told": keys({}, {"initial_state": is_text, "prior": no_more_than(WIDTHS)}), "sigma_over_peak": is_number,
    },
)  # fmt: skip
PROVENANCE = keys(
    {},
    {
        **dict.fromkeys(("commit", "started", "finished", "python", "system", "processor"), no_more_than(is_text)),
        "data": is_text, "packages": mapping_of(no_more_than(is_text)), "limits": _NUMBERS_BY_NAME,
        "rechecked": list_of(keys({"replicates": lambda value: is_whole(value) or list_of(is_whole)(value)})),
    },
)  # fmt: skip
VERSION = keys({}, {"digest": is_text, "modules": mapping_of(is_text), "packages": mapping_of(is_text)})
LISTS = {
    "status": list_of(lambda value: is_text(value) and value in STATUSES), "replicate": list_of(is_whole),
    "message": list_of(is_text), "data": list_of(is_text), "evaluations": list_of(is_whole),
    **dict.fromkeys(("wall_s", "cpu_s", "peak_memory_mb"), list_of(_NUMBER_OR_NONE)),
}  # fmt: skip
COLUMNS = keys({**LISTS, "scores": mapping_of(list_of(_NUMBER_OR_NONE))})
CELL = keys(
    {
        "identity": is_text, "cell": DESCRIPTION, "rows": COLUMNS, "summary": mapping_of(mapping_of(_NUMBER_OR_NONE)),
        "prior_share": _NUMBERS_BY_NAME, "identifiable": mapping_of(is_truth), "wall_s": _NUMBER_OR_NONE,
        "provenance": PROVENANCE, "version": VERSION, "arrays": is_text,
    }
)  # fmt: skip


def is_cell(content: Any) -> bool:
    """Whether a file's content is a cell's: of the right kinds, its columns of one length and not empty."""
    if not CELL(content):
        return False
    rows = content["rows"]
    lengths = {len(column) for column in (*(rows[name] for name in LISTS), *rows["scores"].values())}
    return len(lengths) == 1 and 0 not in lengths
