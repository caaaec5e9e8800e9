"""What reading makes of a file: a table of columns first, then signals over time."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.errors import InputError
from bench.records.reading.units import Measures

MAX_ROWS, MAX_COLUMNS, MAX_VALUES = 1_000_000, 64, 20_000_000
"""Of a table; a matrix wider than that is a picture, no set of signals. All values together take 160 MB."""
LISTED = 24


@dataclass(frozen=True, eq=False)
class Column:
    """Numbers under a header, NaN where one is missing.

    ``unit`` and ``measures`` are what the file says of them outside the header, ``times`` (s) their own clock where
    the file gives each column one, ``flaw`` why the column cannot be taken ("" if it can).
    """

    name: str
    values: np.ndarray
    unit: str = ""
    measures: Measures | None = None
    times: np.ndarray | None = None
    flaw: str = ""


@dataclass(frozen=True, eq=False)
class Table:
    """Columns, what was done to get them, the row of the file of each sample, and what else the file holds."""

    columns: tuple[Column, ...]
    notes: tuple[str, ...] = ()
    rows: np.ndarray | None = None
    contents: str = ""

    def listing(self) -> str:
        """The columns by number and header, or the variables and their shapes, for an error."""
        if self.contents:
            return self.contents
        if not any(column.name for column in self.columns):
            n = len(self.columns)
            return "one column, 0, without a header" if n == 1 else f"columns 0 to {n - 1}, without headers"
        names = [f"{i} '{c.name}'" + (f" ({c.flaw})" if c.flaw else "") for i, c in enumerate(self.columns[:LISTED])]
        rest = len(self.columns) - LISTED
        return "columns " + ", ".join(names) + (f" and {rest} more" if rest > 0 else "")

    def place(self, sample: int) -> str:
        """Where a sample (from 0) stands in the file."""
        return f"sample {sample + 1}" if self.rows is None else f"row {self.rows[sample]}"


@dataclass(frozen=True, eq=False)
class Signal:
    """One measured quantity over time.

    ``dof`` counts from 0; ``unit`` is in SI ("rad", "N·m" and so on where it turns), or the label as written where it
    is no known unit. ``times`` (s) count from the first kept sample of the recording; a signal with missing values has
    fewer samples than others.
    """

    role: str
    measures: Measures
    dof: int
    values: np.ndarray
    unit: str
    times: np.ndarray


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


def check_rows(n: int, source: object) -> None:
    """Raise InputError where a file has more rows than are read."""
    if n > MAX_ROWS:
        raise InputError("data", source, f"{n} rows; at most {MAX_ROWS}, thin the record or cut a part out of it")


def check_values(n: int, source: object) -> None:
    """Raise InputError where a file holds more numbers than are read."""
    if n > MAX_VALUES:
        remedy = f"{n} numbers in all; at most {MAX_VALUES}, keep the columns that matter or thin the record"
        raise InputError("data", source, remedy)


def optional(package: str, source: object) -> Any:
    """Import a package that only some kinds of file need; raise InputError that says how to install it."""
    try:
        return importlib.import_module(package)
    except ImportError:
        remedy = f'this kind of file needs the package {package}: pip install "vibration-bench[files]"'
        raise InputError("data", source, remedy) from None
