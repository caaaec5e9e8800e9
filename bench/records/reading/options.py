"""What the user says of a file: roles of columns, units, the sampling rate and the part to keep."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from bench.errors import InputError
from bench.records.reading.units import Measures, Quantity

MEASURES: dict[str, Measures] = {"x": "displacement", "v": "velocity", "a": "acceleration", "f": "force"}
LETTERS: dict[str, Quantity] = {"t": "time", **MEASURES}
"""Roles of columns; all but the time's may have the number of a DOF."""
ROLE = re.compile(r"t|[xvaf](?:[1-9]\d?)?")
ROLES = "t, x, v, a, f and x1, x2, …, v1, … with the number of a DOF"


@dataclass(frozen=True)
class ReadOptions:
    """What the user says of a file, where it does not say so itself or holds more than is wanted.

    Args:
        columns: number (from 0) or header of the column of each role, as ``{"t": 0, "x": 3}``; no other is then read
        units: unit of a role, as ``{"t": "ms", "x": "mm"}``
        rate: samples a second, where no column is the time
        start: keep from here, in seconds of the record's own clock
        end: keep up to here
        decimate: keep every n-th sample, after a low-pass filter
        detrend: take the drift of the sensors away; by default where it is significant

    Raises:
        InputError: a role that does not exist or is given twice, or a number that cannot be meant.
    """

    columns: Mapping[str, int | str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    rate: float | None = None
    start: float | None = None
    end: float | None = None
    decimate: int = 1
    detrend: bool | None = None

    def __post_init__(self) -> None:
        for name, roles in (("columns", list(self.columns)), ("units", list(self.units))):
            if bad := [role for role in roles if not ROLE.fullmatch(role)]:
                raise InputError(name, bad[0], f"roles are {ROLES}")
            slots = [slot(role) for role in roles]
            if twice := [role for role in roles if slots.count(slot(role)) > 1]:
                raise InputError(name, ", ".join(twice), "they are the same role; give one")
        if self.rate is not None and not (math.isfinite(self.rate) and self.rate > 0):
            raise InputError("rate", self.rate, "a positive number of samples a second is needed")
        for name, value in (("from", self.start), ("to", self.end)):
            if value is not None and not math.isfinite(value):
                raise InputError(name, value, "a time in seconds is needed")
        if self.decimate < 1:
            raise InputError("decimate", self.decimate, "a whole number from 1 on: every n-th sample is kept")
        if self.start is not None and self.end is not None and self.start >= self.end:
            raise InputError("from", self.start, f"it must be before to={self.end:g}")

    def unit(self, role: str) -> str:
        """Return the unit given for a role, "" without one."""
        return next((unit for other, unit in self.units.items() if slot(other) == slot(role)), "")


def slot(role: str) -> tuple[str, int]:
    """Return letter and DOF (from 0) of a role; x and x1 are the same."""
    return role[0], int(role[1:] or 1) - 1
