"""The types of what a cell's file states, as far as readers rely on them.

A checksum shows that a file is as it was written, not that this benchmark wrote it. What fits :data:`HEAD` can be read
by every command.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

REST = "*"


def fits(value: Any, shape: Any) -> bool:
    """Return whether a JSON value has a shape.

    A shape is a function of the value; a list with the shape of all items; or a dictionary with those of some keys,
    each of which may be absent. Other keys have that of :data:`REST`, or may hold anything.
    """
    if isinstance(shape, dict):
        rest = shape.get(REST, _anything)
        return isinstance(value, dict) and all(fits(item, shape.get(key, rest)) for key, item in value.items())
    if isinstance(shape, list):
        return isinstance(value, list) and all(fits(item, shape[0]) for item in value)
    return bool(shape(value))


def _anything(value: Any) -> bool:
    return True


def _text(value: Any) -> bool:
    return isinstance(value, str)


def _flag(value: Any) -> bool:
    return isinstance(value, bool)


def _whole(value: Any) -> bool:
    return type(value) is int and -(2**63) <= value < 2**63


def _finite(value: Any) -> bool:
    return _whole(value) or (isinstance(value, float) and math.isfinite(value))


def _number(value: Any) -> bool:
    return _finite(value) or value in ("inf", "-inf", "nan")  # which JSON lacks


def _or_null(shape: Any) -> Callable[[Any], bool]:
    return lambda value: value is None or fits(value, shape)


def _state(value: Any) -> bool:
    """Positions and velocities."""
    return fits(value, [[_finite]]) and len(value) == 2 and all(map(len, value)) and len(set(map(len, value))) == 1


DESCRIPTION = {
    "method": _text, "label": _text, "system": _text, "settings": {}, "replicates": _whole, "seed": _whole,
    "snr_db": _number, "initial_state": _text, "sigma": [_number], "sigma_over_peak": _number,
    "told": {"initial_state": _text, "prior": _or_null({REST: lambda v: _flag(v) or _number(v) or _text(v)})},
    "data": {
        "system": _text, "options": {}, "parameters": {REST: _number}, "initial": _state, "snr_db": _number,
        "duration": _number, "samples": _whole, "force": _or_null({}), "disturbance": _or_null({"kind": _text}),
        "added_mass": _or_null([_number]), "measured": _or_null([_whole]), "truth": _text,
    },
}  # fmt: skip
HEAD = {
    "identity": _text, "cell": DESCRIPTION, "statuses": {REST: _whole}, "wall_s": _number,
    "prior_share": {REST: _number}, "identifiable": {REST: _flag}, "version": {REST: _whole}, "body": _text,
    "provenance": {
        **dict.fromkeys(("commit", "started", "finished", "python", "system", "processor"), _or_null(_text)),
        "data": _text, "packages": {REST: _or_null(_text)}, "limits": {REST: _number},
    },
}  # fmt: skip
