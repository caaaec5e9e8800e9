"""Time stamps: what rounding did to them is undone where one sampling rate explains them; nothing else is touched."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

IMMATERIAL = 1e-3
"""Rounding by less than this part of a step is left as it is."""
LAST_DECIMAL, MOST_ROOM = 10, 0.01
GAP = 1.5
"""A step longer than this many steps leaves samples out."""
MOST_GAPS, MOST_GAPS_AND_REPEATS = 0.5, 0.1
"""Of all steps; where more are gaps the sampling is not even."""


@dataclass(frozen=True, eq=False)
class TimeGrid:
    """Evenly spaced times with the sample number of each stamp, numbers being left out where samples are missing."""

    start: float
    step: float
    numbers: np.ndarray

    @property
    def times(self) -> np.ndarray:
        return self.start + self.step * self.numbers


def rebuilt(stamps: np.ndarray, unit: float) -> tuple[np.ndarray, list[str]]:
    """Times (s) from stamps that do not decrease, in a unit of so many seconds.

    Stamps that repeat or are rounded are replaced by those of an even sampling, where none moves by as much as one step
    of their resolution. Gaps stay, and so does sampling that is not even.

    Returns:
        Times, and a note of each thing done. Stamps that repeat stay in them where no even sampling explains them.
    """
    steps = np.diff(stamps)
    repeats = int(np.sum(steps == 0))
    if stamps.size < 3 or repeats == steps.size:
        return stamps * unit, []
    tick = resolution(stamps)
    if repeats:
        tick += float(np.min(steps[steps > 0]))  # the clock is no finer than its least step
    since = stamps - stamps[0]
    grid = _grid(since, tick if repeats else 0.0)
    if np.mean(np.diff(grid.numbers) > 1) > (MOST_GAPS_AND_REPEATS if repeats else MOST_GAPS):
        return stamps * unit, []
    moved = float(np.max(np.abs(grid.times - since)))
    if not repeats and moved <= max(IMMATERIAL * grid.step, 4 * _spacing(stamps)):
        return stamps * unit, _gaps(grid, unit)
    if moved >= tick * (1 + 1e-6):
        return stamps * unit, []
    rate = f"{1 / (grid.step * unit):.5g} Hz"
    if repeats:
        note = f"{repeats} of {stamps.size} time stamps repeat: times are rebuilt from {rate}"
    else:
        note = f"time stamps are rounded to {tick * unit:.3g} s: times are rebuilt from {rate}"
    return (stamps[0] + grid.times) * unit, [note, *_gaps(grid, unit)]


def resolution(stamps: np.ndarray) -> float:
    """The decimal step, or that of 32-bit numbers, to which all stamps are rounded; 0 where they are not."""
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
    """The rounding of numbers as large as these."""
    return float(np.spacing(np.max(np.abs(stamps))))


def _grid(stamps: np.ndarray, slack: float) -> TimeGrid:
    """The even sampling nearest to stamps; a step may seem longer by ``slack`` than it is."""
    steps = np.diff(stamps)
    if slack:
        step = float(np.mean(steps[steps <= 2.5 * slack]))
    else:
        step = float(np.median(steps))
        step = float(np.mean(steps[steps <= GAP * step]))
    grid = TimeGrid(float(stamps[0]), step, np.zeros(stamps.size))
    for _ in range(3):
        missing = np.where(steps > GAP * grid.step + slack, np.round(steps / grid.step) - 1, 0)
        numbers = np.arange(stamps.size) + np.concatenate([[0.0], np.cumsum(missing)])
        grid = _line(stamps, numbers)
    return grid


def _line(stamps: np.ndarray, numbers: np.ndarray) -> TimeGrid:
    """A straight line of stamp over sample number, by least squares, again without the stamps far from it."""
    kept = np.ones(stamps.size, dtype=bool)
    start = step = 0.0
    for _ in range(3):
        centre, origin = float(np.mean(numbers[kept])), float(np.mean(stamps[kept]))
        x = numbers[kept] - centre
        step = float(x @ (stamps[kept] - origin) / (x @ x))
        start = origin - step * centre
        away = np.abs(stamps - start - step * numbers)
        near = away <= 4 * np.median(away) + 1e-9 * step
        if np.sum(near) < max(3, stamps.size // 2):
            break
        kept = near
    return TimeGrid(start, step, numbers)


def _gaps(grid: TimeGrid, unit: float) -> list[str]:
    lost = np.diff(grid.numbers) - 1
    gaps, samples = int(np.sum(lost > 0)), int(np.sum(lost))
    if not gaps:
        return []
    return [f"gaps in time are kept: {gaps}, where {samples} samples {grid.step * unit:.4g} s apart are missing"]
