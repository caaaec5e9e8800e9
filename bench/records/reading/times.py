"""Time stamps: what rounding did to them is undone where one sampling rate explains them; nothing else is touched."""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np

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


class SampleTimes(NamedTuple):
    """Times from stamps, notes of what was done to them, and the relative standard uncertainty of their rate."""

    times: np.ndarray
    notes: tuple[str, ...] = ()
    rate_error: float = 0.0


def increments_summed(stamps: np.ndarray, name: str) -> SampleTimes | None:
    """Return the running sum of stamps that are times since the sample before, in their unit; None for other stamps.

    They are, where the column's name says so, or where they do not grow and are alike. Rounding by ``q`` of increments
    of mean ``d`` adds up to a relative error of the rate of q / (d sqrt(12 n)).
    """
    there = np.isfinite(stamps)
    later = stamps[there][1:]
    if later.size < 2 or np.any(stamps[there] < 0) or np.all(np.diff(stamps[there]) > 0):
        return None
    middle = float(np.median(later))
    alike = np.mean((later <= ALIKE * middle) & (later * ALIKE >= middle)) >= MOSTLY
    certain = alike and later.size >= ENOUGH and np.any(np.diff(later) < 0)
    if middle <= 0 or not (certain or INCREMENT.match(name)):
        return None
    column = f"column '{name}'" if name else "the column of the time"
    note = f"{column} holds the time since the sample before: the time is its running sum"
    distinct = np.unique(later)
    rounding = float(np.min(np.diff(distinct), initial=middle)) if distinct.size > 1 else 0.0
    error = rounding / (float(np.mean(later)) * np.sqrt(12.0 * later.size))
    return SampleTimes(np.where(there, np.nancumsum(stamps), np.nan), (note,), error)


def rebuilt(stamps: np.ndarray, unit: float) -> SampleTimes:
    """Return times (s) from stamps that do not decrease, in a unit of so many seconds.

    Stamps that repeat or are rounded are replaced by those of an even sampling, where none moves by as much as one step
    of their resolution. Gaps stay, and so does sampling that is not even. Stamps that repeat stay in the times where no
    even sampling explains them.
    """
    as_they_are = SampleTimes(stamps * unit)
    steps = np.diff(stamps)
    repeats = int(np.sum(steps == 0))
    if stamps.size < 3 or repeats == steps.size:
        return as_they_are
    rounding = resolution(stamps)
    tick = rounding + (np.min(steps[steps > 0]) if repeats else 0.0)  # a clock is no finer than its least step
    since = stamps - stamps[0]
    numbers, start, step = _even(since, float(np.max(tick)) if repeats else 0.0)
    lost = np.diff(numbers) - 1
    if np.mean(lost > 0) > (MOST_GAPS_AND_REPEATS if repeats else MOST_GAPS):
        return as_they_are
    moved = np.abs(start + step * numbers - since)
    if not repeats and np.max(moved) <= max(IMMATERIAL * step, 4 * _spacing(stamps)):
        return SampleTimes(stamps * unit, _gaps(lost, step * unit))
    if np.any(moved >= tick * (1 + 1e-6)):
        return as_they_are
    start, step, error = _bounded(since, numbers, start, step, np.broadcast_to(rounding, since.shape) / 2)
    rate = f"{1 / (step * unit):.5g} Hz" + (f" (known to {100 * error:.2g} %)" if error > SAID else "")
    why = f"time stamps are rounded to {np.max(rounding) * unit:.3g} s"
    if repeats:
        why = f"{repeats} of {stamps.size} time stamps repeat"
    notes = (f"{why}: times are rebuilt from {rate}", *_gaps(lost, step * unit))
    return SampleTimes((stamps[0] + start + step * numbers) * unit, notes, error)


def _gaps(lost: np.ndarray, step: float) -> tuple[str, ...]:
    gaps = f"gaps in time are kept: {np.sum(lost > 0)}, where {np.sum(lost):.0f} samples"
    return (f"{gaps} {step:.4g} s apart are missing",) if np.any(lost) else ()


def resolution(stamps: np.ndarray) -> np.ndarray:
    """Return the step to which stamps are rounded, 0 where they are not: one for all, or (n,) of significant digits."""
    all_alike = _decimals(stamps)
    with np.errstate(divide="ignore"):
        decades = 10.0 ** np.floor(np.log10(np.abs(stamps)))
    for digits in DIGITS:
        steps = decades * 10.0 ** (1 - digits)
        if np.max(steps) <= all_alike:
            break
        counts = np.divide(stamps, steps, out=np.zeros_like(steps), where=steps > 0)
        if np.all(np.abs(stamps - np.round(counts) * steps) < 1e-9 * np.max(np.abs(stamps))):
            return np.asarray(np.maximum(steps, all_alike))
    return np.asarray(all_alike)


def _decimals(stamps: np.ndarray) -> float:
    """Return the decimal step, or that of 32-bit numbers, to which all stamps are rounded; 0 where they are not."""
    steps, single = np.diff(stamps), stamps.astype(np.float32)
    coarse = float(np.spacing(np.max(np.abs(single)))) if np.array_equal(single, stamps) else 0.0
    for decimals in range(-int(np.floor(np.log10(np.min(steps[steps > 0])) + 1e-9)), LAST_DECIMAL):
        step = 10.0**-decimals
        room = 1e-4 + 4 * _spacing(stamps) / step
        if room > MOST_ROOM:
            break
        counts = (stamps - stamps[0]) / step
        if np.all(np.abs(counts - np.round(counts)) < room):
            return max(step, coarse)
    return coarse


def _spacing(stamps: np.ndarray) -> float:
    """Return the rounding of numbers as large as these."""
    return float(np.spacing(np.max(np.abs(stamps))))


def _even(stamps: np.ndarray, slack: float) -> tuple[np.ndarray, float, float]:
    """Return the number of each stamp in the nearest even sampling, and its start and step.

    Missing samples have numbers, too. A step may seem longer by ``slack`` than it is.
    """
    steps = np.diff(stamps)
    step = float(np.mean(steps[steps <= (2.5 * slack or GAP * np.median(steps))]))
    numbers, half = np.arange(stamps.size), stamps.size // 2
    for _ in range(3):
        missing = np.where(steps > GAP * step + slack, np.round(steps / step) - 1, 0)
        numbers = np.arange(stamps.size) + np.concatenate([[0.0], np.cumsum(missing)])
        step = float(np.median((stamps[half:] - stamps[:-half]) / (numbers[half:] - numbers[:-half])))
    return numbers, float(np.median(stamps - step * numbers)), step


def _bounded(
    stamps: np.ndarray, numbers: np.ndarray, start: float, step: float, room: np.ndarray
) -> tuple[float, float, float]:
    """Return start and step of the middle one of the samplings that rounding by ``room`` (n,) allows, and an error.

    Rounding is an error with bounds: each stamp says start + step * number = stamp within its room (and a jitter common
    to all, the least that has a solution), and the steps that satisfy all of them are equally likely (Milanese and
    Vicino 1991). The error is their standard deviation, their range over the root of 12, relative to the step.
    """
    away = stamps - start - step * numbers
    near = np.abs(away) <= 4 * np.median(np.abs(away)) + np.max(room) + 1e-9 * step
    scale = float(np.ptp(numbers[near]))
    x, off, half = (numbers[near] - numbers[near][0]) / scale, away[near] / step, room[near] / step

    def ends(slope: float) -> tuple[float, float]:
        """Return the largest of the lower bounds of the start, and the least of its upper ones, in steps."""
        return float(np.max(off - half - slope * x)), float(np.min(off + half - slope * x))

    from scipy.optimize import brentq, minimize_scalar  # slow to import, and few need it

    def lacking(slope: float) -> float:
        """Return by how much the bounds of the start contradict each other, a convex function."""
        lower, upper = ends(slope)
        return lower - upper

    far = float(np.ptp(off) + 2 * np.max(half)) + 1e-9 * scale  # here the first and the last contradict each other
    best = float(minimize_scalar(lacking, bounds=(-far, far), method="bounded", options={"xatol": 1e-9 * far}).x)
    jitter = 1.2 * max(lacking(best) / 2, 0.0) + 1e-9 * scale
    far += 3 * jitter
    slopes = [brentq(lambda slope: lacking(slope) - 2 * jitter, best, side * far) for side in (-1.0, 1.0)]
    middle = np.mean([np.mean(ends(slope)) for slope in slopes])
    longer = 1 + float(np.mean(slopes)) / scale
    error = (slopes[1] - slopes[0]) / np.sqrt(12.0) / (scale * longer)
    return start + step * (float(middle) - numbers[near][0] * (longer - 1)), step * longer, float(error)
