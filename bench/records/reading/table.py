"""Reading options, and the results of reading: a table of columns, and a recording of signals."""

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
"""Limits of a table; a wider matrix is not a set of signals. The values need 160 MB at most."""
PREAMBLE = 10_000
"""Rows of a text or sheet in addition to the table."""
LISTED = 24
"""Largest number of columns that an error lists."""
ROLE = re.compile(r"t|b|[xvaf](?:[1-9]\d?)?")
ROLES = "t, x, v, a, f, b (the base) and x1, x2, …, v1, … with the number of a DOF"


@dataclass(frozen=True)
class ReadOptions:
    """Properties of a file that it does not state, and its preparation.

    Args:
        columns: Number (from 0) or header of the column of each role, such as ``{"t": 0, "x": 3}``; others are ignored.
        units: Unit of a role, such as ``{"t": "ms", "x": "mm"}``.
        rate: Sampling rate (1/s), if no column is the time.
        start: Time (s) of the first sample to keep, on the record's clock.
        end: Time (s) of the last sample to keep.
        decimate: Keep every n-th sample, after a low-pass filter.
        detrend: Remove linear drift of the sensors; None to do so if it is significant.
        sensors: Whether several columns of a quantity are sensors of one motion; their unit may be unknown.

    Raises:
        InputError: A role is unknown or occurs twice, or a number is out of range.
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
                raise InputError(name, ", ".join(twice), "these are the same role; use one")
        if self.rate is not None and not (math.isfinite(self.rate) and self.rate > 0):
            raise InputError("rate", self.rate, "a positive sampling rate (1/s) is needed")
        for name, value in (("from", self.start), ("to", self.end)):
            if value is not None and not math.isfinite(value):
                raise InputError(name, value, "a time in seconds is needed")
        if self.decimate < 1:
            raise InputError("decimate", self.decimate, "a whole number of at least 1 is needed")
        if self.start is not None and self.end is not None and self.start >= self.end:
            raise InputError("from", self.start, f"it must be less than to={self.end:g}")

    def unit(self, role: str) -> str:
        """Return the unit of a role in ``units``, or that of its letter; "" without one."""
        given = (unit for other, unit in self.units.items() if slot(other) == slot(role))
        return next(given, self.units.get(role[0], ""))


def slot(role: str) -> tuple[str, int]:
    """Return letter and DOF (from 0) of a role; x and x1 are equal."""
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
    """Content of a file.

    Attributes:
        columns: Columns.
        notes: Sentences on the reading.
        rows: Number of the row in the file of each sample.
        contents: Variables and their shapes, for formats of named arrays.
        spectra: Frequency responses.
    """

    columns: tuple[Column, ...]
    notes: tuple[str, ...] = ()
    rows: np.ndarray | None = None
    contents: str = ""
    spectra: tuple[Spectrum, ...] = ()

    def listing(self) -> str:
        """Return the columns by number and header, or the variables and their shapes, for errors."""
        n = len(self.columns)
        if self.contents:
            return self.contents
        if not any(column.header for column in self.columns):
            return "one column, 0, without a header" if n == 1 else f"columns 0 to {n - 1}, without headers"
        names = [f"{i} '{c.header}'" + (f" ({c.flaw})" if c.flaw else "") for i, c in enumerate(self.columns[:LISTED])]
        return f"columns {', '.join(names)}{f' and {n - LISTED} more' if n > LISTED else ''}"


@dataclass(frozen=True, eq=False)
class Signal:
    """Measured quantity over time.

    Attributes:
        role: Role of the column.
        measures: Quantity.
        dof: Degree of freedom, from 0.
        values: Samples, shape (n,).
        unit: SI unit ("rad", "N·m" etc. for rotations), or the unit of the file if it is unknown.
        times: Times (s) since the first kept sample of the recording, shape (n,).
        written: Unit in the file.
        size: Size of this unit in SI units.
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
    """Signals of a record.

    Attributes:
        signals: Signals.
        notes: Sentences on the reading and preparation.
        source: Name of the file.
        sha256: Digest of its bytes.
        rate_error: Relative standard uncertainty of the sampling rate, due to rounded time stamps.
    """

    signals: tuple[Signal, ...]
    notes: tuple[str, ...]
    source: str
    sha256: str
    rate_error: float = 0.0


def check_size(rows: int, source: object, values: int = 0) -> None:
    """Raise InputError for a file with too many rows or values."""
    if rows > MAX_ROWS:
        raise InputError("data", source, f"{rows} rows; at most {MAX_ROWS}: shorten or decimate the record")
    if values > MAX_VALUES:
        remedy = f"{values} numbers; at most {MAX_VALUES}: delete columns that are not needed, or decimate the record"
        raise InputError("data", source, remedy)
