"""Conversion of time stamps to times; rounding is corrected if a constant sampling rate explains the stamps."""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np

IMMATERIAL = 1e-3
"""Rounding below this fraction of a step is not corrected."""
LAST_DECIMAL, MOST_ROOM = 10, 0.01
DIGITS = range(2, 8)
"""Numbers of significant digits to which stamps may be rounded."""
GAP = 1.5
"""Ratio of a step to the sampling interval above which samples are missing."""
MOST_GAPS, MOST_GAPS_AND_REPEATS = 0.5, 0.1
"""Largest share of gaps in evenly sampled stamps, without and with repeated stamps."""
UNDETERMINED = 0.1
"""Relative standard uncertainty of the sampling rate above which the record is rejected."""
SAID = 1e-4
"""Relative standard uncertainty of the sampling rate above which it is reported."""
ALIKE, MOSTLY, ENOUGH = 1.5, 0.9, 10
"""Decreasing stamps are increments if at least ``MOSTLY`` of them, and at least ``ENOUGH``, are within the factor
``ALIKE`` of the median."""
INCREMENT = re.compile(r"d_?t\b|Δ ?t|delta|diff|since (the )?(last|previous)|interval|increment|(time )?step\b", re.I)
"""Names of a column of increments."""


class SampleTimes(NamedTuple):
    """Times, notes on their conversion, and the relative standard uncertainty of the sampling rate."""

    times: np.ndarray
    notes: tuple[str, ...] = ()
    rate_error: float = 0.0


def increments_summed(stamps: np.ndarray, name: str) -> SampleTimes | None:
    """Return the cumulative sum of time increments, in their unit; None if the stamps are not increments.

    They are increments if the name says so, or if they do not increase and are similar. Rounding to multiples of ``q``
    of n increments of mean ``d`` gives a relative error of the sampling rate of q / (d sqrt(12 n)).

    Args:
        stamps: Time stamps, shape (n,), NaN if missing.
        name: Name of the column.
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
    note = f"{column} contains time increments, which were summed"
    distinct = np.unique(later)
    rounding = float(np.min(np.diff(distinct), initial=middle)) if distinct.size > 1 else 0.0
    error = rounding / (float(np.mean(later)) * np.sqrt(12.0 * later.size))
    return SampleTimes(np.where(there, np.nancumsum(stamps), np.nan), (note,), error)


def rebuilt(stamps: np.ndarray, unit: float) -> SampleTimes:
    """Convert time stamps to times.

    Repeated or rounded stamps are replaced by those of even sampling, if none changes by as much as its resolution.
    Gaps and uneven sampling are preserved. Repeated stamps remain if even sampling does not explain them.

    Args:
        stamps: Time stamps that do not decrease, shape (n,).
        unit: Their unit (s).
    """
    as_they_are = SampleTimes(stamps * unit)
    steps = np.diff(stamps)
    repeats = int(np.sum(steps == 0))
    if stamps.size < 3 or repeats == steps.size:
        return as_they_are
    rounding = resolution(stamps)
    tick = rounding + (np.min(steps[steps > 0]) if repeats else 0.0)  # the resolution is the smallest step
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
    reason = f"time stamps are rounded to {np.max(rounding) * unit:.3g} s"
    if repeats:
        reason = f"{repeats} of {stamps.size} time stamps are repeated"
    notes = (f"{reason}: times are replaced by even ones at {rate}", *_gaps(lost, step * unit))
    return SampleTimes((stamps[0] + start + step * numbers) * unit, notes, error)


def _gaps(lost: np.ndarray, step: float) -> tuple[str, ...]:
    gaps = f"{np.sum(lost > 0)} gaps in time, in which {np.sum(lost):.0f} samples"
    return (f"{gaps} at intervals of {step:.4g} s are missing",) if np.any(lost) else ()


def resolution(stamps: np.ndarray) -> np.ndarray:
    """Return the rounding step of stamps (0 if not rounded), constant or of shape (n,) for significant digits."""
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
    """Return the rounding step of decimals or 32-bit numbers, constant for all stamps; 0 if they are not rounded."""
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
    """Return the floating-point spacing of the largest stamp."""
    return float(np.spacing(np.max(np.abs(stamps))))


def _even(stamps: np.ndarray, slack: float) -> tuple[np.ndarray, float, float]:
    """Return the index of each stamp in even sampling (missing samples are counted), its start and its step.

    ``slack`` is the largest error of a step due to rounding.
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
    """Estimate start and step of even sampling from rounded stamps; return also the relative error of the step.

    Rounding errors are bounded: start + step * number differs from a stamp by at most ``room`` (and a common jitter,
    the smallest with a solution). All steps that satisfy these bounds are equally likely (Milanese and Vicino 1991);
    the error is their standard deviation, their range over the root of 12.

    Args:
        stamps: Time stamps, shape (n,).
        numbers: Their indices, shape (n,).
        start: Initial guess of the start.
        step: Initial guess of the step.
        room: Largest rounding errors, shape (n,).
    """
    away = stamps - start - step * numbers
    near = np.abs(away) <= 4 * np.median(np.abs(away)) + np.max(room) + 1e-9 * step
    scale = float(np.ptp(numbers[near]))
    x, off, half = (numbers[near] - numbers[near][0]) / scale, away[near] / step, room[near] / step

    def ends(slope: float) -> tuple[float, float]:
        """Return the largest lower bound and the smallest upper bound of the start, in steps."""
        return float(np.max(off - half - slope * x)), float(np.min(off + half - slope * x))

    from scipy.optimize import brentq, minimize_scalar  # slow to import

    def lacking(slope: float) -> float:
        """Return the difference of the bounds of the start, a convex function; positive if there is no solution."""
        lower, upper = ends(slope)
        return lower - upper

    far = float(np.ptp(off) + 2 * np.max(half)) + 1e-9 * scale  # here the first and last stamps have no solution
    best = float(minimize_scalar(lacking, bounds=(-far, far), method="bounded", options={"xatol": 1e-9 * far}).x)
    jitter = 1.2 * max(lacking(best) / 2, 0.0) + 1e-9 * scale
    far += 3 * jitter
    slopes = [brentq(lambda slope: lacking(slope) - 2 * jitter, best, side * far) for side in (-1.0, 1.0)]
    middle = np.mean([np.mean(ends(slope)) for slope in slopes])
    longer = 1 + float(np.mean(slopes)) / scale
    error = (slopes[1] - slopes[0]) / np.sqrt(12.0) / (scale * longer)
    return start + step * (float(middle) - numbers[near][0] * (longer - 1)), step * longer, float(error)
