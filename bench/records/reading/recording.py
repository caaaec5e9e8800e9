"""A file of a measured record to its signals in SI units, each with its times."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.contract.problem import MIN_SAMPLES
from bench.errors import InputError
from bench.records.reading.decimation import decimated
from bench.records.reading.drift import detrended
from bench.records.reading.files import read_file
from bench.records.reading.options import ReadOptions
from bench.records.reading.picks import Pick, pick
from bench.records.reading.signals import Recording, Signal
from bench.records.reading.table import Table
from bench.records.reading.times import rebuilt
from bench.records.reading.units import Measures

NO_OPTIONS = ReadOptions()
LARGEST, SMALLEST = 1e15, 1e-30


@dataclass(frozen=True, eq=False)
class _Clock:
    """Stamps (s) on the record's own clock, the times that are meant, and which samples of the file they belong to."""

    stamps: np.ndarray
    times: np.ndarray
    kept: np.ndarray


def read_recording(path: Path, options: ReadOptions = NO_OPTIONS) -> Recording:
    """Read a record from a file of any kind (text, xlsx, mat, npz, npy, Parquet, UFF 58, TDMS).

    Args:
        path: the file
        options: what the user says of it; by default the file must say itself what its columns are

    Returns:
        its signals; those with a known unit are in SI

    Raises:
        InputError: in one line, what is wrong or not certain and what to add.
    """
    table, sha256 = read_file(path)
    picks, chosen = pick(table, options, path)
    notes = [*table.notes, *chosen]
    signals = [found for role, found in picks.items() if role != "t"]
    clocks = _clocks(table, picks, options, path, notes)
    kept = [_kept(found, clocks[found.role], options, path, notes) for found in signals]
    start = min(float(times[0]) for _, times in kept)
    made = tuple(
        Signal(found.role, _measures(found), found.dof, values * found.size, found.unit, times - start)
        for found, (values, times) in zip(signals, kept, strict=True)
    )
    return prepared(Recording(made, tuple(dict.fromkeys(notes)), str(path), sha256), options)


def _check_size(name: str, values: np.ndarray, path: Path) -> None:
    """Raise InputError for numbers in SI units whose squares are none any more."""
    largest = float(np.max(np.abs(values)))
    if largest > LARGEST or 0 < largest < SMALLEST:
        remedy = f"{name} is up to {largest:.3g} in SI units; from {SMALLEST:g} to {LARGEST:g}, see units="
        raise InputError("data", path, remedy)


def prepared(recording: Recording, options: ReadOptions) -> Recording:
    """A recording without drift and decimated, where the user says so; raises InputError."""
    return decimated(detrended(recording) if options.detrend else recording, options.decimate)


def _measures(found: Pick) -> Measures:
    quantity = found.quantity
    assert quantity != "time"
    return quantity


def _clocks(
    table: Table, picks: Mapping[str, Pick], options: ReadOptions, path: Path, notes: list[str]
) -> dict[str, _Clock]:
    """The clock of each signal: the time's column, rate=, or the one that the file gives it."""
    signals = {role: found for role, found in picks.items() if role != "t"}
    if "t" in picks:
        shared = _clock(table, picks["t"].column.values, picks["t"].size, list(signals.values()), path, notes)
        return dict.fromkeys(signals, shared)
    clocks = {}
    for role, found in signals.items():
        n = found.column.values.size
        if options.rate is not None:
            stamps = np.arange(n) / options.rate
            clocks[role] = _Clock(stamps, stamps, np.arange(n))
        elif found.column.times is not None:
            clocks[role] = _clock(table, found.column.times, 1.0, [found], path, notes)
    return clocks


def _clock(table: Table, stamps: np.ndarray, unit: float, signals: list[Pick], path: Path, notes: list[str]) -> _Clock:
    """Times from a column of stamps in a unit of so many seconds; raises InputError where they do not increase."""
    kept = np.flatnonzero(np.isfinite(stamps))
    if kept.size < stamps.size:
        notes.append(f"rows without a time are left out: {stamps.size - kept.size} of {stamps.size}")
    if not kept.size:
        raise InputError("data", path, "the column of the time holds no number; name another with columns=t:…")
    _check_size("t", stamps[kept] * unit, path)
    back = np.flatnonzero(np.diff(stamps[kept]) < 0)
    if back.size:
        i = kept[back[0] + 1]
        pair = f"{stamps[kept[back[0]]]:.10g} to {stamps[i]:.10g}"
        remedy = f"time goes back from {pair}; sort the rows, or keep one record in a file, or give rate= for the time"
        raise InputError("data", f"{path} {table.place(int(i))}", remedy)
    kept = _without_copies(stamps, kept, signals, notes)
    times, said = rebuilt(stamps[kept], unit)
    notes += said
    same = np.flatnonzero(np.diff(times) <= 0)
    if same.size:
        i = int(kept[same[0] + 1])
        remedy = f"time {stamps[i]:.10g} repeats and no even sampling explains it; give rate= in place of the time"
        raise InputError("data", f"{path} {table.place(i)}", remedy)
    return _Clock(stamps[kept] * unit, times, kept)


def _without_copies(stamps: np.ndarray, kept: np.ndarray, signals: list[Pick], notes: list[str]) -> np.ndarray:
    """Samples without those that repeat the row before them, where all stamps that repeat are such rows."""
    again = np.flatnonzero(np.diff(stamps[kept]) == 0) + 1
    pairs = [(found.column.values[kept[again]], found.column.values[kept[again - 1]]) for found in signals]
    if not again.size or not all(np.array_equal(a, b, equal_nan=True) for a, b in pairs):
        return kept
    notes.append(f"rows that repeat the row before them are left out: {again.size} of {kept.size}")
    return np.delete(kept, again)


def _kept(
    found: Pick, clock: _Clock, options: ReadOptions, path: Path, notes: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Values (as in the file) and times (s) of the part to keep, without missing values."""
    inside = _inside(clock.stamps, options, path)
    values, times = found.column.values[clock.kept][inside], clock.times[inside]
    there = np.isfinite(values)
    if not there.all():
        notes.append(f"{found.role}: {np.sum(~there)} of {there.size} values are missing and left out")
    if np.sum(there) < MIN_SAMPLES:
        raise InputError("data", path, f"{np.sum(there)} samples of {found.role}; at least {MIN_SAMPLES} are needed")
    _check_size(found.role, values[there] * found.size, path)
    return values[there], times[there]


def _inside(stamps: np.ndarray, options: ReadOptions, path: Path) -> np.ndarray:
    """Which samples are from ``from`` to ``to``; raises InputError where these are not within the record."""
    first, last = float(stamps[0]), float(stamps[-1])
    room = 1e-9 * max(abs(first), abs(last))
    for name, value in (("from", options.start), ("to", options.end)):
        if value is not None and not first - room <= value <= last + room:
            raise InputError(name, value, f"{path} runs from {first:.6g} to {last:.6g} s")
    start = first if options.start is None else options.start
    end = last if options.end is None else options.end
    return (stamps >= start - room) & (stamps <= end + room)
