"""Conversion of files and arrays to recordings: signals in SI units with their times."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from bench.contract.problem import MIN_SAMPLES
from bench.errors import InputError
from bench.records.reading.columns import columns_by_role
from bench.records.reading.files import read_file
from bench.records.reading.headings import Column, column_of
from bench.records.reading.table import ReadOptions, Recording, Signal, Table, check_size, slot
from bench.records.reading.times import UNDETERMINED, increments_summed, rebuilt
from bench.records.reading.units import MEASURED_BY

NO_OPTIONS = ReadOptions()
Clocked = tuple[np.ndarray, np.ndarray, float]
"""Indices of the kept samples, their times (s), and the relative error of the sampling rate."""
LARGEST, SMALLEST = 1e15, 1e-30
"""Limits of values in SI units, whose squares must be floating-point numbers."""
LEAST_RUN = 10
"""Least samples of a run; if the time decreases after fewer samples, they are out of order."""
ARRAYS = {"times": "s", "displacement": "m", "force": "N"}
"""Units of arrays in calls from Python."""
TRIALS = {"trial", "trials", "run", "experiment", "test"}
"""Headers of columns that number the runs in a file."""


def read_recordings(path: Path, options: ReadOptions = NO_OPTIONS) -> tuple[Recording, ...]:
    """Read the records in a file (text, xlsx, xls, mat, npz, npy, Parquet, UFF 58, TDMS, wav).

    A file has several records if a column named ``trial`` or ``run`` numbers them, or if its time decreases.

    Args:
        path: Path of the file.
        options: Columns, units and other properties that the file does not state.

    Returns:
        The recordings; signals with a known unit are in SI units.

    Raises:
        InputError: The file is invalid or ambiguous; the message says what to add.
    """
    table, sha256 = read_file(path)
    return recordings_of(table, options, str(path), sha256)


def read_recording(path: Path, options: ReadOptions = NO_OPTIONS) -> Recording:
    """Read a file with a single record, see :func:`read_recordings`; raises InputError for several records."""
    return _only(read_recordings(path, options))


def of_arrays(
    times: ArrayLike,
    displacement: ArrayLike,
    force: ArrayLike | None = None,
    options: ReadOptions = NO_OPTIONS,
) -> Recording:
    """Return the recording of arrays.

    Args:
        times: Times (s) or dates, shape (n,).
        displacement: Displacements (m), shape (n,).
        force: Forces (N), shape (n,).
        options: Preparation of the record.

    Raises:
        InputError: An array is not of real, finite numbers, or has another length than the times.
    """
    table = _table_of({"times": times, "displacement": displacement, "force": force})
    return _only(recordings_of(table, options, "arrays"))


def _table_of(arrays: Mapping[str, ArrayLike | None]) -> Table:
    """Return the table of arrays, see :func:`of_arrays`; masked samples are missing."""
    columns: list[Column] = []
    notes: list[str] = []
    for name, given in arrays.items():
        if given is None:
            continue
        mask = np.ma.getmaskarray(given) if np.ma.isMaskedArray(given) else np.zeros(np.shape(given), dtype=bool)
        values = _numbers(name, np.ma.getdata(given) if mask.any() else given, notes)
        if values.ndim != 1 or (columns and values.size != columns[0].values.size):
            raise InputError(name, f"array of shape {values.shape}", "use a vector with a number for each time")
        check_size(values.size, name)
        bad = ~np.isfinite(values) & ~mask
        if bad.any():
            raise InputError(name, "array", f"sample {np.argmax(bad)} is not finite; mask or remove it")
        if mask.any():
            notes.append(f"{name}: {np.sum(mask)} of {mask.size} samples are masked and ignored")
        columns.append(column_of(name, np.where(mask, np.nan, values), ARRAYS[name]))
    return Table(tuple(columns), tuple(notes))


def _numbers(name: str, given: ArrayLike, notes: list[str]) -> np.ndarray:
    """Return an array of real numbers; dates are converted to seconds since the first."""
    try:
        values = np.asarray(given)
        first = values.flat[0] if values.size else None
        moments = isinstance(first, np.datetime64) or hasattr(first, "year")
        if moments or isinstance(first, np.timedelta64) or hasattr(first, "total_seconds"):
            if name != "times":
                raise InputError(name, "array", "it contains dates; numbers are needed")
            import pandas as pd  # slow to import

            dates = pd.to_datetime(values, utc=True) if moments else pd.to_timedelta(values)
            notes.append(f"times are {'dates' if moments else 'time differences'}, converted to s since the first")
            return np.asarray((dates - dates[0]) / pd.Timedelta(seconds=1), dtype=float)
        if np.iscomplexobj(values) or (values.dtype == object and any(isinstance(v, complex) for v in values.flat)):
            raise InputError(name, "array", "it contains complex numbers; use their real or imaginary part")
        return np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError, IndexError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(name, "array", "numbers are needed") from None


def _only(recordings: Sequence[Recording]) -> Recording:
    if len(recordings) > 1:
        source = recordings[0].source.removesuffix(" run 1")
        remedy = "its time decreases, or a column numbers the runs; use a file with a single one"
        raise InputError("data", source, f"it has {len(recordings)} runs: {remedy}")
    return recordings[0]


def recordings_of(table: Table, options: ReadOptions, source: str, sha256: str = "") -> tuple[Recording, ...]:
    """Return the recordings in the table of a file, see :func:`read_recordings`.

    Args:
        table: Columns of the file.
        options: Properties that the file does not state.
        source: Name of the file.
        sha256: Digest of its bytes.

    Raises:
        InputError: The table is invalid or ambiguous.
    """
    if table.spectra and all(column.flaw for column in table.columns):
        raise InputError(
            "data", source, "it has frequency responses but no time records; add modes=auto to identify modes"
        )
    n, block = len(table.columns), _block(table, options)
    if block < n:
        tables = [replace(table, columns=table.columns[k : k + block]) for k in range(0, n, block)]
        runs = [recordings_of(part, options, f"{source} run {k}", sha256) for k, part in enumerate(tables, 1)]
        return tuple(run for several in runs for run in several)
    columns, notes = columns_by_role(table, options, source)
    notes, error = [*table.notes, *notes], 0.0
    if (time := columns.get("t")) and (sums := increments_summed(time.values, time.header)):
        columns["t"], error = replace(time, values=sums.times), sums.rate_error
        notes += sums.notes
    n = next(iter(columns.values())).values.size
    starts = _starts(table, columns, n, source)
    if not starts:
        return (_Run(columns, options, source, notes, table.rows).recording(sha256, error),)
    rows = np.arange(1, n + 1) if table.rows is None else table.rows
    recordings = []
    for k, (first, last) in enumerate(pairwise([0, *starts, n]), 1):
        parts = {role: replace(column, values=column.values[first:last]) for role, column in columns.items()}
        note = f"run {k} of {len(starts) + 1}: rows {rows[first]} to {rows[last - 1]}"
        run = _Run(parts, options, f"{source} run {k}", [*notes, note], rows[first:last])
        recordings.append(run.recording(sha256, error))
    return tuple(recordings)


def _block(table: Table, options: ReadOptions) -> int:
    """Return the number of columns after which the headers repeat, such as those of further blows."""
    n, headers = len(table.columns), [column.header for column in table.columns]
    last = max((int(key) for key in options.columns.values() if str(key).isdigit()), default=0)
    timed = all(column.times is not None for column in table.columns)
    blocks = (p for p in range(max(last + 1, 2), n) if timed and n % p == 0 and headers == headers[:p] * (n // p))
    return next((p for p in blocks if len(set(headers[:p])) > 1), n)


def _starts(table: Table, columns: Mapping[str, Column], n: int, source: str) -> list[int]:
    """Return the samples at which further runs begin, by the number of a trial or a decreasing time."""

    def long_enough(starts: Collection[int]) -> bool:
        return min(last - first for first, last in pairwise([0, *sorted(starts), n])) >= LEAST_RUN

    starts: set[int] = set()
    for column in table.columns:
        if column.header.lower() in TRIALS and not column.flaw and column.values.size == n:
            starts |= set((np.flatnonzero(np.diff(column.values)) + 1).tolist())
            if starts and not long_enough(starts):
                remedy = f"column '{column.header}' numbers several records; save one of them in a separate file"
                raise InputError("data", source, remedy)
    if "t" in columns:
        there = np.flatnonzero(np.isfinite(columns["t"].values))
        again = set(there[1:][np.diff(columns["t"].values[there]) < 0].tolist())
        starts |= again if long_enough(starts | again) else set()
    return sorted(starts)


@dataclass(frozen=True, eq=False)
class _Run:
    """Columns of a record by role, in SI units except for the times; methods append to ``notes``."""

    columns: Mapping[str, Column]
    options: ReadOptions
    source: str
    notes: list[str]
    rows: np.ndarray | None

    def recording(self, sha256: str, rate_error: float) -> Recording:
        """Return the signals, with times since the first sample; raises InputError."""
        measured = {role: column for role, column in self.columns.items() if role != "t"}
        time, shared = self.columns.get("t"), None
        if time is not None:
            assert time.unit is not None
            shared = self._times(time.values, time.unit.size, list(measured.values()))
        signals = []
        for role, column in measured.items():
            samples, times, error = shared or self._column_times(column)
            present = self._present(role, column.values[samples])
            values, times = column.values[samples][present], times[present]
            size = 1.0 if column.unit is None else column.unit.size
            measures, dof = MEASURED_BY[role[0]], slot(role)[1]
            signals.append(Signal(role, measures, dof, values, column.label, times, column.written, size))
            rate_error = max(rate_error, error)
        start = min(float(signal.times[0]) for signal in signals)
        signals = [replace(signal, times=signal.times - start) for signal in signals]
        return Recording(tuple(signals), tuple(dict.fromkeys(self.notes)), self.source, sha256, rate_error)

    def _error(self, remedy: str, sample: int | None = None) -> InputError:
        place = "" if sample is None else f" sample {sample + 1}" if self.rows is None else f" row {self.rows[sample]}"
        return InputError("data", self.source + place, remedy)

    def _check_size(self, name: str, values: np.ndarray) -> None:
        """Raise InputError for values (SI units) beyond the limits."""
        largest = float(np.max(np.abs(values)))
        if largest > LARGEST or 0 < largest < SMALLEST:
            allowed = f"from {SMALLEST:g} to {LARGEST:g}, see units="
            raise self._error(f"{name} is up to {largest:.3g} in SI units; {allowed}")

    def _column_times(self, column: Column) -> Clocked:
        """Return the times of a signal without a time column: by rate=, or those stored with the signal."""
        if self.options.rate is not None:
            times = np.arange(column.values.size) / self.options.rate
            inside = self._inside(times)
            return inside, times[inside], 0.0
        assert column.times is not None
        return self._times(column.times, 1.0, [column])

    def _times(self, stamps: np.ndarray, unit: float, signals: Sequence[Column]) -> Clocked:
        """Convert time stamps in a unit (s) to times; raises InputError if they decrease or repeat."""
        kept = np.flatnonzero(np.isfinite(stamps))
        if kept.size < stamps.size:
            self.notes.append(f"rows without a time are ignored: {stamps.size - kept.size} of {stamps.size}")
        if not kept.size:
            raise self._error("the column of the time has no numbers; name another by columns=t:…")
        self._check_size("t", stamps[kept] * unit)
        for i in np.flatnonzero(np.diff(stamps[kept]) < 0)[:1]:
            pair = f"{stamps[kept[i]]:.10g} to {stamps[kept[i + 1]]:.10g}"
            remedy = "sort the rows, use one record per file, or replace the time by rate="
            raise self._error(f"time decreases from {pair}; {remedy}", int(kept[i + 1]))
        kept = self._without_copies(stamps, kept, signals)
        clock = rebuilt(stamps[kept], unit)
        if clock.rate_error > UNDETERMINED:
            few = f"{np.unique(stamps[kept]).size} distinct time stamps"
            remedy = f"{few} determine the sampling rate only to {100 * clock.rate_error:.0f} %; add rate= (Hz)"
            raise self._error(remedy)
        self.notes.extend(clock.notes)
        for i in kept[1:][np.diff(clock.times) <= 0]:
            remedy = "occurs repeatedly, and the sampling is not even; replace the time by rate="
            raise self._error(f"time {stamps[i]:.10g} {remedy}", int(i))
        inside = self._inside(stamps[kept] * unit)
        return kept[inside], clock.times[inside], clock.rate_error

    def _without_copies(self, stamps: np.ndarray, kept: np.ndarray, signals: Sequence[Column]) -> np.ndarray:
        """Return samples without duplicates of the row before, if all repeated time stamps are duplicate rows."""
        again = np.flatnonzero(np.diff(stamps[kept]) == 0) + 1
        pairs = [(signal.values[kept[again]], signal.values[kept[again - 1]]) for signal in signals]
        if not again.size or not all(np.array_equal(a, b, equal_nan=True) for a, b in pairs):
            return kept
        self.notes.append(f"duplicate rows are ignored: {again.size} of {kept.size}")
        return np.delete(kept, again)

    def _inside(self, stamps: np.ndarray) -> np.ndarray:
        """Return the indices of the time stamps (s) from ``from`` to ``to``."""
        first, last = float(stamps[0]), float(stamps[-1])
        room = 1e-9 * max(abs(first), abs(last))
        for name, value in (("from", self.options.start), ("to", self.options.end)):
            if value is not None and not first - room <= value <= last + room:
                raise InputError(name, value, f"{self.source} runs from {first:.6g} to {last:.6g} s")
        start = first if self.options.start is None else self.options.start
        end = last if self.options.end is None else self.options.end
        return np.flatnonzero((stamps >= start - room) & (stamps <= end + room))

    def _present(self, role: str, values: np.ndarray) -> np.ndarray:
        """Return a mask of the values that are not missing; raises InputError for too few or too large ones."""
        present = np.isfinite(values)
        if not present.all():
            self.notes.append(f"{role}: {np.sum(~present)} of {present.size} values are missing and ignored")
        if np.sum(present) < MIN_SAMPLES:
            raise self._error(f"{np.sum(present)} samples of {role}; at least {MIN_SAMPLES} are needed")
        self._check_size(role, values[present])
        return present
