"""A table of a measured record, from a file or from arrays, to signals in SI units, each with its times."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from bench.contract.problem import MIN_SAMPLES
from bench.errors import InputError
from bench.records.reading.arrays import table_of
from bench.records.reading.columns import Pick, pick
from bench.records.reading.files import read_file
from bench.records.reading.headings import is_trial
from bench.records.reading.options import ReadOptions
from bench.records.reading.signals import Recording, Signal
from bench.records.reading.table import Table
from bench.records.reading.times import UNDETERMINED, increments_summed, rebuilt

NO_OPTIONS = ReadOptions()
LARGEST, SMALLEST = 1e15, 1e-30
"""In SI units: squares of larger or smaller numbers leave the range of floating point."""

LEAST_RUN = 10
"""Samples of a run; time that goes back sooner is out of order."""


@dataclass(frozen=True, eq=False)
class _Clock:
    """Stamps (s) as the record has them, the times that are meant, the samples they belong to, their rate's error."""

    stamps: np.ndarray
    times: np.ndarray
    kept: np.ndarray
    rate_error: float = 0.0


def read_recordings(path: Path, options: ReadOptions = NO_OPTIONS) -> tuple[Recording, ...]:
    """Read the records in a file (text, xlsx, xls, mat, npz, npy, Parquet, UFF 58, TDMS, wav).

    A file holds several where a column named ``trial`` or ``run`` counts them, or where its time starts again.

    Args:
        path: the file
        options: what the user says of it; by default the file must say itself what its columns are

    Returns:
        the signals of each; those with a known unit are in SI

    Raises:
        InputError: in one line, what is wrong or not certain and what to add.
    """
    table, sha256 = read_file(path)
    return _recordings(table, options, str(path), sha256)


def read_recording(path: Path, options: ReadOptions = NO_OPTIONS) -> Recording:
    """Read the one record in a file, as :func:`read_recordings`; raises InputError for several, too."""
    return _only(read_recordings(path, options))


def of_arrays(
    times: ArrayLike,
    displacement: ArrayLike,
    force: ArrayLike | None = None,
    options: ReadOptions = NO_OPTIONS,
) -> Recording:
    """Return the record in arrays of one length: times (s, or dates), m and N; raises InputError."""
    table = table_of({"times": times, "displacement": displacement, "force": force})
    return _only(_recordings(table, options, "arrays"))


def _only(recordings: Sequence[Recording]) -> Recording:
    if len(recordings) > 1:
        source = recordings[0].source.removesuffix(" run 1")
        remedy = "where its time goes back, or a trial is counted, another begins; give one of them"
        raise InputError("data", source, f"it holds {len(recordings)} runs: {remedy}")
    return recordings[0]


def _recordings(table: Table, options: ReadOptions, source: str, sha256: str = "") -> tuple[Recording, ...]:
    picks, notes = pick(table, options, source)
    notes = [*table.notes, *notes]
    cuts = _starts_of_runs(table, picks, source)
    if len(cuts) == 2:
        return (_recording(table, picks, notes, options, source, sha256),)
    rows = np.arange(1, cuts[-1] + 1) if table.rows is None else table.rows
    runs = []
    for k, (first, last) in enumerate(pairwise(cuts), 1):
        part = {role: found.part(first, last) for role, found in picks.items()}
        said = f"run {k} of {len(cuts) - 1}: rows {rows[first]} to {rows[last - 1]}"
        of_run = Table((), rows=rows[first:last])
        runs.append(_recording(of_run, part, [*notes, said], options, f"{source} run {k}", sha256))
    return tuple(runs)


def _starts_of_runs(table: Table, picks: Mapping[str, Pick], source: str) -> list[int]:
    """Return the samples at which runs begin, and the number of samples: where a trial's number or the time say so."""
    n = next(iter(picks.values())).column.values.size
    starts: set[int] = set()
    for column in table.columns:
        if is_trial(column.name) and not column.flaw and column.values.size == n:
            starts |= set((np.flatnonzero(np.diff(column.values)) + 1).tolist())
            if starts and not _long_enough(starts, n):
                remedy = f"column '{column.name}' counts several records; keep one of them in a file of its own"
                raise InputError("data", source, remedy)
    if "t" in picks:
        stamps = picks["t"].column.values
        there = np.flatnonzero(np.isfinite(stamps))
        again = set(there[1:][np.diff(stamps[there]) < 0].tolist())
        if increments_summed(stamps[there], picks["t"].column.name) is None and _long_enough(starts | again, n):
            starts |= again
    return [0, *sorted(starts), n]


def _long_enough(starts: Collection[int], n: int) -> bool:
    return min(last - first for first, last in pairwise([0, *sorted(starts), n])) >= LEAST_RUN


def _recording(
    table: Table, picks: Mapping[str, Pick], notes: list[str], options: ReadOptions, source: str, sha256: str
) -> Recording:
    signals = [found for role, found in picks.items() if role != "t"]
    time = picks.get("t")
    shared = None if time is None else _clock(table, time.column.values, time, signals, source, notes)
    made, errors = [], []
    for found in signals:
        clock = shared or _own_clock(table, found, options, source, notes)
        values, times = _kept(found, clock, options, source, notes)
        quantity = found.quantity
        assert quantity != "time"
        made.append(Signal(found.role, quantity, found.dof, values * found.size, found.unit, times))
        errors.append(clock.rate_error)
    start = min(float(signal.times[0]) for signal in made)
    made = [replace(signal, times=signal.times - start) for signal in made]
    return Recording(tuple(made), tuple(dict.fromkeys(notes)), source, sha256, max(errors))


def _check_size(name: str, values: np.ndarray, source: str) -> None:
    """Raise InputError for numbers in SI units whose squares are none any more."""
    largest = float(np.max(np.abs(values)))
    if largest > LARGEST or 0 < largest < SMALLEST:
        remedy = f"{name} is up to {largest:.3g} in SI units; from {SMALLEST:g} to {LARGEST:g}, see units="
        raise InputError("data", source, remedy)


def _own_clock(table: Table, found: Pick, options: ReadOptions, source: str, notes: list[str]) -> _Clock:
    """Return the clock of a signal without a column of times: rate=, or the one that the file gives it."""
    if options.rate is None:
        assert found.column.times is not None
        return _clock(table, found.column.times, None, [found], source, notes)
    numbers = np.arange(found.column.values.size)
    return _Clock(numbers / options.rate, numbers / options.rate, numbers)


def _clock(
    table: Table, stamps: np.ndarray, time: Pick | None, signals: Sequence[Pick], source: str, notes: list[str]
) -> _Clock:
    """Return times from stamps, in the unit of the column they stand in; raises InputError where they do not grow."""
    unit = 1.0 if time is None else time.size
    kept = np.flatnonzero(np.isfinite(stamps))
    if kept.size < stamps.size:
        notes.append(f"rows without a time are left out: {stamps.size - kept.size} of {stamps.size}")
    if not kept.size:
        raise InputError("data", source, "the column of the time holds no number; name another with columns=t:…")
    _check_size("t", stamps[kept] * unit, source)
    error = 0.0
    if time is not None and (sums := increments_summed(stamps[kept], time.column.name)) is not None:
        stamps, error = stamps.copy(), sums.rate_error
        stamps[kept] = sums.times
        notes += sums.notes
    back = np.flatnonzero(np.diff(stamps[kept]) < 0)
    if back.size:
        i = kept[back[0] + 1]
        pair = f"{stamps[kept[back[0]]]:.10g} to {stamps[i]:.10g}"
        remedy = f"time goes back from {pair}; sort the rows, or keep one record in a file, or give rate= for the time"
        raise InputError("data", f"{source} {table.place(int(i))}", remedy)
    kept = _without_copies(stamps, kept, signals, notes)
    clock = rebuilt(stamps[kept], unit)
    if clock.rate_error > UNDETERMINED:
        few = f"its {np.unique(stamps[kept]).size} distinct time stamps"
        remedy = f"{few} leave the sampling rate open by {100 * clock.rate_error:.0f} %; give rate= (Hz)"
        raise InputError("data", source, remedy)
    notes += clock.notes
    same = np.flatnonzero(np.diff(clock.times) <= 0)
    if same.size:
        i = int(kept[same[0] + 1])
        remedy = f"time {stamps[i]:.10g} repeats and no even sampling explains it; give rate= in place of the time"
        raise InputError("data", f"{source} {table.place(i)}", remedy)
    return _Clock(stamps[kept] * unit, clock.times, kept, clock.rate_error or error)


def _without_copies(stamps: np.ndarray, kept: np.ndarray, signals: Sequence[Pick], notes: list[str]) -> np.ndarray:
    """Return the samples without those that repeat the row before them, where all stamps that repeat are such rows."""
    again = np.flatnonzero(np.diff(stamps[kept]) == 0) + 1
    pairs = [(found.column.values[kept[again]], found.column.values[kept[again - 1]]) for found in signals]
    if not again.size or not all(np.array_equal(a, b, equal_nan=True) for a, b in pairs):
        return kept
    notes.append(f"rows that repeat the row before them are left out: {again.size} of {kept.size}")
    return np.delete(kept, again)


def _kept(
    found: Pick, clock: _Clock, options: ReadOptions, source: str, notes: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Return values (as in the file) and times (s) of the part to keep, without missing values."""
    inside = _inside(clock.stamps, options, source)
    values, times = found.column.values[clock.kept][inside], clock.times[inside]
    there = np.isfinite(values)
    if not there.all():
        notes.append(f"{found.role}: {np.sum(~there)} of {there.size} values are missing and left out")
    if np.sum(there) < MIN_SAMPLES:
        raise InputError("data", source, f"{np.sum(there)} samples of {found.role}; at least {MIN_SAMPLES} are needed")
    _check_size(found.role, values[there] * found.size, source)
    return values[there], times[there]


def _inside(stamps: np.ndarray, options: ReadOptions, source: str) -> np.ndarray:
    """Return which samples are from ``from`` to ``to``; raises InputError where these are not within the record."""
    first, last = float(stamps[0]), float(stamps[-1])
    room = 1e-9 * max(abs(first), abs(last))
    for name, value in (("from", options.start), ("to", options.end)):
        if value is not None and not first - room <= value <= last + room:
            raise InputError(name, value, f"{source} runs from {first:.6g} to {last:.6g} s")
    start = first if options.start is None else options.start
    end = last if options.end is None else options.end
    return (stamps >= start - room) & (stamps <= end + room)
