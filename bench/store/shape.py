"""Schema of the head of a cell's file.

A checksum does not show that this benchmark wrote a file. Every command can process a head that fits :data:`HEAD`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

REST = "*"


def fits(value: Any, shape: Any) -> bool:
    """Return whether a JSON value conforms to a schema.

    A schema is a type; a predicate; a list with the schema of all items; or a dictionary of the schemas of some keys,
    each of which may be absent. The schema of other keys is that of :data:`REST`, or any value is allowed.
    """
    if isinstance(shape, dict):
        rest = shape.get(REST, object)
        return isinstance(value, dict) and all(fits(item, shape.get(key, rest)) for key, item in value.items())
    if isinstance(shape, list):
        return isinstance(value, list) and all(fits(item, shape[0]) for item in value)
    return isinstance(value, shape) if isinstance(shape, type) else bool(shape(value))


def _whole(value: Any) -> bool:
    return type(value) is int and -(2**63) <= value < 2**63


def _finite(value: Any) -> bool:
    return _whole(value) or (isinstance(value, float) and math.isfinite(value))


def _number(value: Any) -> bool:
    return _finite(value) or value in ("inf", "-inf", "nan")  # JSON lacks non-finite numbers


def _or_null(shape: Any) -> Callable[[Any], bool]:
    return lambda value: value is None or fits(value, shape)


def _state(value: Any) -> bool:
    """Return whether a value is a list of displacements and a list of velocities of equal length."""
    return fits(value, [[_finite]]) and len(value) == 2 and all(map(len, value)) and len(set(map(len, value))) == 1


DESCRIPTION = {
    "method": str, "label": str, "system": str, "settings": {}, "replicates": _whole, "seed": _whole,
    "snr_db": _number, "initial_state": str, "sigma": [_number], "sigma_over_peak": _number,
    "told": {"initial_state": str, "prior": _or_null({REST: lambda v: isinstance(v, bool | str) or _number(v)})},
    "data": {
        "system": str, "options": {}, "parameters": {REST: _number}, "initial": _state, "snr_db": _number,
        "duration": _number, "samples": _whole, "force": _or_null({}), "disturbance": _or_null({"kind": str}),
        "added_mass": _or_null([_number]), "measured": _or_null([_whole]), "truth": str,
    },
}  # fmt: skip
HEAD = {
    "identity": str, "cell": DESCRIPTION, "statuses": {REST: _whole}, "wall_s": _number,
    "prior_share": {REST: _number}, "identifiable": {REST: bool}, "version": {REST: _whole}, "body": str,
    "provenance": {
        **dict.fromkeys(("commit", "started", "finished", "python", "system", "processor"), _or_null(str)),
        "data": str, "packages": {REST: _or_null(str)}, "limits": {REST: _number},
    },
}  # fmt: skip
