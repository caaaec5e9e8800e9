"""What a file of any kind is read into, before anything is known of what its columns measure."""

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
