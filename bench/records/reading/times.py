"""Time stamps: what rounding did to them is undone where one sampling rate explains them; nothing else is touched."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, QhullError

IMMATERIAL = 1e-3
"""Rounding by less than this part of a step is left as it is."""
LAST_DECIMAL, MOST_ROOM = 10, 0.01
DIGITS = range(2, 8)
"""Significant digits that stamps may be rounded to."""
GAP = 1.5
"""A step longer than this many steps leaves samples out."""
MOST_GAPS, MOST_GAPS_AND_REPEATS = 0.5, 0.1
"""Of all steps; where more are gaps the sampling is not even."""
UNDETERMINED = 0.1
"""Relative standard uncertainty of a rate from which on it is too uncertain to be used."""
SAID = 1e-4
"""Relative standard uncertainty of a rate from which on it is worth a word."""
ALIKE, MOSTLY, ENOUGH = 1.5, 0.9, 10
"""Stamps that do not grow are increments where this share of at least so many is within this factor of the median."""
INCREMENT = re.compile(r"d_?t\b|Δ ?t|delta|diff|since (the )?(last|previous)|interval|increment|(time )?step\b", re.I)
"""Names of a column of increments."""


@dataclass(frozen=True, eq=False)
class Clock:
    """Times (s) from stamps, notes of what was done to them, and the relative standard uncertainty of their rate."""

    times: np.ndarray
    notes: tuple[str, ...] = ()
    rate_error: float = 0.0


@dataclass(frozen=True, eq=False)
class TimeGrid:
    """Evenly spaced times with the sample number of each stamp, numbers being left out where samples are missing."""

    start: float
    step: float
    numbers: np.ndarray

    @property
    def times(self) -> np.ndarray:
        return self.start + self.step * self.numbers


def increments_summed(stamps: np.ndarray, name: str) -> Clock | None:
    """Return the running sum of stamps that are times since the sample before, in their unit; None for other stamps.

    They are, where the column's name says so, or where they do not grow and are alike. Rounding by ``q`` of increments
    of mean ``d`` adds up to a relative error of the rate of q / (d sqrt(12 n)).
    """
    there = np.isfinite(stamps)
    known = stamps[there]
    later = known[1:]
    if later.size < 2 or np.any(known < 0) or np.all(np.diff(known) > 0):
        return None
    middle = float(np.median(later))
    alike = np.mean((later <= ALIKE * middle) & (later * ALIKE >= middle)) >= MOSTLY
    certain = alike and later.size >= ENOUGH and np.any(np.diff(later) < 0)
    if middle <= 0 or not (certain or INCREMENT.match(name)):
        return None
    column = f"column '{name}'" if name else "the column of the time"
    note = f"{column} holds the time since the sample before: the time is its running sum"
    steps = np.diff(np.unique(later))
    error = float(np.min(steps, initial=middle) / (np.mean(later) * np.sqrt(12.0 * later.size))) if steps.size else 0.0
    return Clock(np.where(there, np.nancumsum(stamps), np.nan), (note,), error)


def rebuilt(stamps: np.ndarray, unit: float) -> Clock:
    """Return times (s) from stamps that do not decrease, in a unit of so many seconds.

    Stamps that repeat or are rounded are replaced by those of an even sampling, where none moves by as much as one step
    of their resolution. Gaps stay, and so does sampling that is not even. Stamps that repeat stay in the times where no
    even sampling explains them.
    """
    as_they_are = stamps * unit
    steps = np.diff(stamps)
    repeats = int(np.sum(steps == 0))
    if stamps.size < 3 or repeats == steps.size:
        return Clock(as_they_are)
    rounding = resolution(stamps)
    tick = rounding  # where stamps repeat, the clock is no finer than its least step
    if repeats:
        tick = tick + float(np.min(steps[steps > 0]))
    since = stamps - stamps[0]
    grid = _grid(since, float(np.max(tick)) if repeats else 0.0)
    if np.mean(np.diff(grid.numbers) > 1) > (MOST_GAPS_AND_REPEATS if repeats else MOST_GAPS):
        return Clock(as_they_are)
    moved = np.abs(grid.times - since)
    if not repeats and np.max(moved) <= max(IMMATERIAL * grid.step, 4 * _spacing(stamps)):
        return Clock(as_they_are, _gaps(grid, unit))
    if np.any(moved >= tick * (1 + 1e-6)):
        return Clock(as_they_are)
    grid, error = _bounded(since, grid, np.broadcast_to(rounding, since.shape) / 2)
    rate = f"{1 / (grid.step * unit):.5g} Hz" + (f" (known to {100 * error:.2g} %)" if error > SAID else "")
    if repeats:
        note = f"{repeats} of {stamps.size} time stamps repeat: times are rebuilt from {rate}"
    else:
        note = f"time stamps are rounded to {np.max(rounding) * unit:.3g} s: times are rebuilt from {rate}"
    return Clock((stamps[0] + grid.times) * unit, (note, *_gaps(grid, unit)), error)


def resolution(stamps: np.ndarray) -> np.ndarray:
    """Return the step to which stamps are rounded, 0 where they are not: one for all, or (n,) of significant digits."""
    all_alike = _decimals(stamps)
    largest = float(np.max(np.abs(stamps)))
    for digits in DIGITS:
        with np.errstate(divide="ignore"):
            steps = 10.0 ** (np.floor(np.log10(np.abs(stamps))) - digits + 1)
        if np.max(steps) <= all_alike:
            break
        if np.all(np.abs(stamps - np.round(stamps / np.where(steps > 0, steps, 1)) * steps) < 1e-9 * largest):
            return np.asarray(np.maximum(steps, all_alike))
    return np.asarray(all_alike)


def _decimals(stamps: np.ndarray) -> float:
    """Return the decimal step, or that of 32-bit numbers, to which all stamps are rounded; 0 where they are not."""
    since, steps = stamps - stamps[0], np.diff(stamps)
    single = stamps.astype(np.float32)
    coarse = float(np.spacing(np.max(np.abs(single)))) if np.array_equal(single, stamps) else 0.0
    for decimals in range(-int(np.floor(np.log10(np.min(steps[steps > 0])) + 1e-9)), LAST_DECIMAL):
        step = 10.0**-decimals
        room = 1e-4 + 4 * _spacing(stamps) / step
        if room > MOST_ROOM:
            break
        counts = since / step
        if np.all(np.abs(counts - np.round(counts)) < room):
            return max(step, coarse)
    return coarse


def _spacing(stamps: np.ndarray) -> float:
    """Return the rounding of numbers as large as these."""
    return float(np.spacing(np.max(np.abs(stamps))))


def _grid(stamps: np.ndarray, slack: float) -> TimeGrid:
    """Return the even sampling nearest to stamps; a step may seem longer by ``slack`` than it is."""
    steps = np.diff(stamps)
    step = float(np.mean(steps[steps <= (2.5 * slack or GAP * np.median(steps))]))
    numbers, half = np.arange(stamps.size), stamps.size // 2
    for _ in range(3):
        missing = np.where(steps > GAP * step + slack, np.round(steps / step) - 1, 0)
        numbers = np.arange(stamps.size) + np.concatenate([[0.0], np.cumsum(missing)])
        step = float(np.median((stamps[half:] - stamps[:-half]) / (numbers[half:] - numbers[:-half])))
    return TimeGrid(float(np.median(stamps - step * numbers)), step, numbers)


def _bounded(stamps: np.ndarray, grid: TimeGrid, room: np.ndarray) -> tuple[TimeGrid, float]:
    """Return the middle one of the grids that rounding by ``room`` (n,) allows, and its rate's relative uncertainty.

    Rounding is an error with bounds: each stamp says start + step * number = stamp within its room (and a jitter common
    to all, the least that has a solution), and the steps that satisfy all of them are equally likely (Milanese and
    Vicino 1991). The standard deviation of such a step is its range over the root of 12.
    """
    away = np.abs(stamps - grid.times)
    near = away <= 4 * np.median(away) + np.max(room) + 1e-9 * grid.step
    number, stamp, half = grid.numbers[near], stamps[near] / grid.step, room[near] / grid.step
    scale = float(np.ptp(number))
    x = (number - number[0]) / scale
    upper, lower = _corners(x, stamp + half), _corners(x, -stamp + half)
    a = np.array([[1.0, x[i]] for i in upper] + [[-1.0, -x[i]] for i in lower])
    b = np.concatenate([(stamp + half)[upper], (half - stamp)[lower]])

    def solve(objective: list[float], jitter: float | None = None) -> np.ndarray:
        free = (None, None)
        if jitter is None:
            rows = np.column_stack([a, -np.ones(len(a))])
            return np.asarray(linprog(objective, rows, b, bounds=[free, free, (0.0, None)]).x)
        return np.asarray(linprog(objective, a, b + jitter, bounds=[free, free]).x)

    jitter = 1.2 * float(solve([0.0, 0.0, 1.0])[2]) + 1e-9 * scale
    ends = [solve([0.0, side], jitter) for side in (1.0, -1.0)]
    start, slope = np.mean(ends, axis=0)
    step = float(slope) * grid.step / scale
    error = float(abs(ends[1][1] - ends[0][1]) / np.sqrt(12.0) / slope)
    return TimeGrid(float(start) * grid.step - step * number[0], step, grid.numbers), error


def _corners(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the numbers of the points that bound a line from above: the corners of their convex hull."""
    try:
        return np.asarray(ConvexHull(np.column_stack([x, y / (np.ptp(y) or 1.0)])).vertices)
    except QhullError:  # all on one line
        return np.array([0, x.size - 1])


def _gaps(grid: TimeGrid, unit: float) -> tuple[str, ...]:
    lost = np.diff(grid.numbers) - 1
    gaps, samples = int(np.sum(lost > 0)), int(np.sum(lost))
    if not gaps:
        return ()
    return (f"gaps in time are kept: {gaps}, where {samples} samples {grid.step * unit:.4g} s apart are missing",)
