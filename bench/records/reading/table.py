"""What a file of any kind is read into, before anything is known of what its columns measure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.errors import InputError
from bench.records.reading.units import Measures

MAX_ROWS = 1_000_000
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
