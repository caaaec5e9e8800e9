"""What the user says of a file, and what reading makes of it: a table of columns first, then signals over time."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from bench.errors import InputError
from bench.records.reading.headings import Column
from bench.records.reading.units import Measures

MAX_ROWS, MAX_COLUMNS, MAX_VALUES = 1_000_000, 64, 20_000_000
"""Of a table; a matrix wider than that is a picture, no set of signals. All values together take 160 MB."""
PREAMBLE = 10_000
"""Rows of a text or a sheet that need not be of the table."""
LISTED = 24
"""Columns that an error names."""
ROLE = re.compile(r"t|b|[xvaf](?:[1-9]\d?)?")
ROLES = "t, x, v, a, f, b (the base) and x1, x2, …, v1, … with the number of a DOF"


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
        sensors: several columns of one quantity are sensors of one motion, and in any unit or none

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
    sensors: bool = False

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
        """Return the unit given for a role, or for all of its letter; "" without one."""
        given = (unit for other, unit in self.units.items() if slot(other) == slot(role))
        return next(given, self.units.get(role[0], ""))


def slot(role: str) -> tuple[str, int]:
    """Return letter and DOF (from 0) of a role; x and x1 are the same."""
    return role[0], int(role[1:] or 1) - 1


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Frequency response in a file.

    Attributes:
        response: Complex values; its ``times`` are frequencies (Hz).
        force: Header and unit of the force, without values.
        force_point: Point at which the force acts.
    """

    response: Column
    force: Column
    force_point: str


@dataclass(frozen=True, eq=False)
class Table:
    """Columns, what was done to get them, the row of the file of each sample, and what else the file holds.

    ``spectra`` are no columns in time.
    """

    columns: tuple[Column, ...]
    notes: tuple[str, ...] = ()
    rows: np.ndarray | None = None
    contents: str = ""
    spectra: tuple[Spectrum, ...] = ()

    def listing(self) -> str:
        """The columns by number and header, or the variables and their shapes, for an error."""
        n = len(self.columns)
        if self.contents:
            return self.contents
        if not any(column.header for column in self.columns):
            return "one column, 0, without a header" if n == 1 else f"columns 0 to {n - 1}, without headers"
        names = [f"{i} '{c.header}'" + (f" ({c.flaw})" if c.flaw else "") for i, c in enumerate(self.columns[:LISTED])]
        return f"columns {', '.join(names)}{f' and {n - LISTED} more' if n > LISTED else ''}"


@dataclass(frozen=True, eq=False)
class Signal:
    """One measured quantity over time.

    ``dof`` counts from 0; ``unit`` is in SI ("rad", "N·m" and so on where it turns), or the label as written where it
    is no known unit; ``written`` is the unit in the file, and ``size`` one of it in SI. ``times`` (s) count from the
    first kept sample of the recording; a signal with missing values has fewer samples than others.
    """

    role: str
    measures: Measures
    dof: int
    values: np.ndarray
    unit: str
    times: np.ndarray
    written: str = ""
    size: float = 1.0


@dataclass(frozen=True, eq=False)
class Recording:
    """The signals of a file, what was done to it beyond reading it, where it is from, and the sha256 of its bytes.

    ``rate_error`` is the relative standard uncertainty of the sampling rate that coarse time stamps leave.
    """

    signals: tuple[Signal, ...]
    notes: tuple[str, ...]
    source: str
    sha256: str
    rate_error: float = 0.0


def check_size(rows: int, source: object, values: int = 0) -> None:
    """Raise InputError where a file has more rows, or more numbers in all, than are read."""
    if rows > MAX_ROWS:
        raise InputError("data", source, f"{rows} rows; at most {MAX_ROWS}, thin the record or cut a part out of it")
    if values > MAX_VALUES:
        remedy = f"{values} numbers in all; at most {MAX_VALUES}, keep the columns that matter or thin the record"
        raise InputError("data", source, remedy)
