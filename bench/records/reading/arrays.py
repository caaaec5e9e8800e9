"""Arrays given from Python to a table: numbers, dates and masks of NumPy and pandas."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from bench.errors import InputError
from bench.records.reading.headings import Column, column_of
from bench.records.reading.table import Table, check_size

UNITS = {"times": "s", "displacement": "m", "force": "N"}


def table_of(arrays: Mapping[str, ArrayLike | None]) -> Table:
    """Return the table of arrays of one length (times, displacement, force) in SI units.

    Times may be dates or differences of dates. A masked sample is missing, which is noted.

    Raises:
        InputError: an array is not one of real, finite numbers, or of another length than the times.
    """
    columns: list[Column] = []
    notes: list[str] = []
    for name, given in arrays.items():
        if given is None:
            continue
        mask = np.ma.getmaskarray(given) if np.ma.isMaskedArray(given) else np.zeros(np.shape(given), dtype=bool)
        values = _numbers(name, np.ma.getdata(given) if mask.any() else given, notes)
        if values.ndim != 1 or (columns and values.size != columns[0].values.size):
            raise InputError(name, f"array of shape {values.shape}", "one-dimensional, with a number for each time")
        check_size(values.size, name)
        bad = ~np.isfinite(values) & ~mask
        if bad.any():
            raise InputError(name, "array", f"sample {np.argmax(bad)} is not finite; leave it out")
        if mask.any():
            notes.append(f"{name}: {np.sum(mask)} of {mask.size} samples are masked and left out")
        columns.append(column_of(name, np.where(mask, np.nan, values), UNITS[name]))
    return Table(tuple(columns), tuple(notes))


def _numbers(name: str, given: ArrayLike, notes: list[str]) -> np.ndarray:
    """Return real numbers as they are, and dates as seconds since the first."""
    try:
        values = np.asarray(given)
        first = values.flat[0] if values.size else None
        moments = isinstance(first, np.datetime64) or hasattr(first, "year")
        if moments or isinstance(first, np.timedelta64) or hasattr(first, "total_seconds"):
            if name != "times":
                raise InputError(name, "array", "dates are no samples; numbers are needed")
            import pandas as pd  # slow to import, and few need it

            dates = pd.to_datetime(values, utc=True) if moments else pd.to_timedelta(values)
            notes.append(f"times are {'dates' if moments else 'time differences'}: they count in s from the first")
            return np.asarray((dates - dates[0]) / pd.Timedelta(seconds=1), dtype=float)
        if np.iscomplexobj(values) or (values.dtype == object and any(isinstance(v, complex) for v in values.flat)):
            raise InputError(name, "array", "complex numbers are no samples; give their real or imaginary part")
        return np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError, IndexError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(name, "array", "numbers are needed") from None
