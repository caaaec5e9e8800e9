"""Zero crossings and logarithmic decrement for the free decay of one mass.

The zero crossings, interpolated linearly, are half a period ``π/ω_d`` apart: a straight line through (index, time)
gives the damped frequency. The extremes between them (from a parabola through three samples) lie on ``A e^(-σt)`` up to
a constant factor: a straight line through (time, log|extreme|) gives ``-σ`` (logarithmic decrement; S. S. Rao,
Mechanical Vibrations, section 2.6). The roots of ``s² + (c/m) s + k/m`` are ``-σ ± iω_d``, so ``c/m = 2σ`` and ``k/m =
ω_d² + σ²``.

Swings below ``smallest`` times the largest sample are ignored as noise. A swing is a run of samples beyond that level
on one side, so that sign changes by noise about zero are no crossings. Swings after a missing one (a gap of more than
1.5 times the median half period) are ignored too.

With few samples the method is biased even without noise: at 5.3 samples per cycle the top of a parabola is up to 4 %
low. A sensor's offset is the level about which successive extremes alternate and decay: three of them, ``e₁, e₂, e₃``,
form a geometric sequence about ``(e₁e₃ - e₂²)/(e₁ + e₃ - 2e₂)`` (Aitken's formula), averaged over all triples and
iterated from the mean of the samples. Times may be uneven.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import Card, InputError
from methods.modal.free_decay import FreeDecayIdentifier
from methods.regression.derivatives import finite_differences

MIN_CROSSINGS = 3
"""Crossings of one full cycle."""
MIN_EXTREMES = 2
LEVEL_ROUNDS = 5
MISSING = 1.5
"""A swing is missing where a gap between crossings exceeds this many median half periods."""


@dataclass(frozen=True)
class LogDecrement(FreeDecayIdentifier):
    """``smallest``: least swing used, over the largest sample; ``bootstrap``: synthetic records for the covariance."""

    smallest: float = 0.2
    bootstrap: int = 100

    unreadable: ClassVar[str] = (
        f"fewer than {MIN_CROSSINGS} zero crossings or {MIN_EXTREMES} extremes above the level smallest: a longer "
        "record, more samples per cycle or less noise are required; near or above critical damping there is no "
        "decrement: use matrix_pencil or output_error"
    )
    card: ClassVar[Card] = Card(
        summary="zero crossings for the frequency, logarithmic decrement of the extremes for the damping",
        start="not used",
        scale="groups",
        reconstruction="simulated",
        uncertainty="covariance of a parametric bootstrap: spread only, not the bias of few samples per cycle",
        settings_source="textbook; the least swing is a rule of thumb",
        tuning="none",
        title="Logarithmic decrement",
        order=110,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.smallest < 1:
            raise InputError("method.smallest", self.smallest, "a fraction of the largest sample, between 0 and 1")

    def read(self, times: np.ndarray, sets: np.ndarray, offset: bool) -> np.ndarray:
        level = resting_level(times, sets, self.smallest)[:, None] if offset else 0.0
        return decrement(times, sets - level, self.smallest)


def decrement(times: np.ndarray, sets: np.ndarray, smallest: float) -> np.ndarray:
    """Estimate k/m and c/m, (sets, 2), from records (sets, n); NaN with too few crossings or extremes."""
    swings = Swings.of(times, sets, smallest)
    peak_times, heights = extremes(times, sets, swings.largest)
    indices = np.broadcast_to(np.arange(swings.crossings.shape[1], dtype=float), swings.crossings.shape)
    with np.errstate(all="ignore"):
        half_period = _slope(indices, swings.crossings)
        decay = -_slope(peak_times, np.log(np.abs(heights)))
        groups = np.stack([(np.pi / half_period) ** 2 + decay**2, 2.0 * decay], axis=1)
    enough = (_count(swings.crossings) >= MIN_CROSSINGS) & (_count(heights) >= MIN_EXTREMES)
    return np.where(enough[:, None], groups, np.nan)


def resting_level(times: np.ndarray, sets: np.ndarray, smallest: float) -> np.ndarray:
    """Return the levels (sets,) about which extremes of records (sets, n) alternate; the mean for fewer than 3."""
    level, going = np.mean(sets, axis=1), np.arange(len(sets))
    for _ in range(LEVEL_ROUNDS):
        y = sets[going] - level[going, None]
        _, heights = extremes(times, y, Swings.of(times, y, smallest).largest)
        enough = _count(heights) >= 3
        going, e = going[enough], _packed(heights[enough])
        if not going.size:
            break
        # incomplete triples are NaN
        levels = (e[:, :-2] * e[:, 2:] - e[:, 1:-1] ** 2) / (e[:, :-2] + e[:, 2:] - 2.0 * e[:, 1:-1])
        complete = np.isfinite(e[:, 2:])
        level[going] += np.sum(np.where(complete, levels, 0.0), axis=1) / np.sum(complete, axis=1)
    return level


@dataclass(frozen=True, eq=False)
class Swings:
    """The swings of records, earliest first: index of the ``largest`` sample (sets, swings), -1 where there is none.

    ``crossings`` (sets, swings - 1): times of the zero crossings between them, NaN where there is none.
    """

    largest: np.ndarray
    crossings: np.ndarray

    @staticmethod
    def of(times: np.ndarray, sets: np.ndarray, smallest: float) -> Swings:
        """Find the swings of records (sets, n).

        Where noise changes the sign several times between two swings, the mean of these times is the crossing.
        """
        size, n = np.abs(sets), sets.shape[1]
        # samples beyond the level of all sets, and the first ones of each swing
        owner, i = np.nonzero(size >= smallest * np.max(size, axis=1, keepdims=True))
        begins = np.ones(owner.size, bool)
        begins[1:] = (np.diff(owner) > 0) | (np.diff(np.sign(sets[owner, i])) != 0)
        swing, first = np.cumsum(begins) - 1, np.flatnonzero(begins)
        beyond = size[owner, i]
        tops = np.flatnonzero(beyond == np.maximum.reduceat(beyond, first)[swing])
        tops = tops[np.searchsorted(swing[tops], np.arange(first.size))]
        row = owner[first]
        place = np.arange(first.size) - np.searchsorted(row, row)
        shape = (len(sets), int(np.max(place, initial=0)) + 1)
        largest, crossings = np.full(shape, -1), np.full(shape, np.nan)
        largest[row, place] = i[tops]
        # interpolation between samples of opposite sign; ``before``: index of the previous sample beyond the level
        turning, j = np.nonzero((sets[:, :-1] >= 0) != (sets[:, 1:] >= 0))
        before = np.searchsorted(owner * n + i, turning * n + j, side="right") - 1
        ends = np.append(begins[1:] & (np.diff(owner) == 0), [False, False])  # ends of swings with a successor
        between = ends[before] & (owner[before] == turning)
        turning, j, before = turning[between], j[between], before[between]
        zero = times[j] - sets[turning, j] * (times[j + 1] - times[j]) / (sets[turning, j + 1] - sets[turning, j])
        with np.errstate(all="ignore"):
            counts = np.bincount(swing[before], minlength=first.size)
            crossings[row, place] = np.bincount(swing[before], zero, first.size) / counts
        crossings = crossings[:, :-1]
        kept = _kept(crossings)[:, None]
        return Swings(
            np.where(np.arange(shape[1]) <= kept, largest, -1),
            np.where(np.arange(shape[1] - 1) < kept, crossings, np.nan),
        )


def _kept(crossings: np.ndarray) -> np.ndarray:
    """Return the number of crossings (sets,) before the first gap with a missing swing."""
    count, gaps = _count(crossings), np.diff(crossings, axis=1)
    if not gaps.shape[1]:
        return count
    ordered, middle = np.sort(gaps, axis=1), np.maximum(count - 1, 1)
    low, high = (np.take_along_axis(ordered, i[:, None], axis=1) for i in ((middle - 1) // 2, middle // 2))
    lost = gaps > MISSING * 0.5 * (low + high)
    return np.where(np.any(lost, axis=1), np.argmax(lost, axis=1) + 1, count)


def extremes(times: np.ndarray, sets: np.ndarray, largest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return times and heights of the extremes from parabolas through each ``largest`` sample and its neighbours.

    The extreme is at ``-x'/x''`` from the sample, with height ``x - x'²/(2x'')``; for three equal samples it is the
    middle one. Both are NaN where the largest sample is the first or the last of the record, or there is no swing.

    Args:
        times: Sample times, (n,).
        sets: Records, (sets, n).
        largest: Indices of samples, (sets, swings).
    """
    inner = (largest > 0) & (largest < sets.shape[1] - 1)
    i = np.where(inner, largest, 1)
    motion = finite_differences(times, sets)
    x, v, a = (np.take_along_axis(part, i - 1, axis=1) for part in (motion.x, motion.v, motion.a))
    away = np.where(a == 0.0, 0.0, -v / np.where(a == 0.0, 1.0, a))
    return np.where(inner, times[i] + away, np.nan), np.where(inner, x + 0.5 * v * away, np.nan)


def _count(values: np.ndarray) -> np.ndarray:
    """Return the number of values that are not NaN, (sets,)."""
    return np.sum(~np.isnan(values), axis=1)


def _packed(values: np.ndarray) -> np.ndarray:
    """Move NaN to the end of each row of values (sets, count)."""
    return np.take_along_axis(values, np.argsort(np.isnan(values), axis=1, kind="stable"), axis=1)


def _slope(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the slopes (sets,) of least-squares lines through the points (sets, count) whose y is not NaN."""
    valid = ~np.isnan(y)
    mean = np.sum(np.where(valid, x, 0.0), axis=1) / np.sum(valid, axis=1)
    deviation = np.where(valid, x - mean[:, None], 0.0)
    return np.asarray(np.sum(deviation * np.where(valid, y, 0.0), axis=1) / np.sum(deviation**2, axis=1))
