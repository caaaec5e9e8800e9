"""What reading makes of a file: a table of columns first, then signals over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.errors import InputError
from bench.records.reading.headings import Column
from bench.records.reading.units import Measures

MAX_ROWS, MAX_COLUMNS, MAX_VALUES = 1_000_000, 64, 20_000_000
"""Of a table; a matrix wider than that is a picture, no set of signals. All values together take 160 MB."""
PREAMBLE = 10_000
"""Rows of a text or a sheet that need not be of the table."""
LISTED = 24


@dataclass(frozen=True, eq=False)
class Table:
    """Columns, what was done to get them, the row of the file of each sample, and what else the file holds."""

    columns: tuple[Column, ...]
    notes: tuple[str, ...] = ()
    rows: np.ndarray | None = None
    contents: str = ""

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
