"""Zero crossings and logarithmic decrement: what an engineer does by hand with the free decay of one mass.

The zero crossings, interpolated linearly, lie half a period ``π/ω_d`` apart: the slope of a straight line through
(number, time) gives the damped frequency. The extremes between them (a parabola through the three samples about each
largest one) lie on ``A e^(-σt)`` up to one constant: the slope of a straight line through (time, log|extreme|) gives
``-σ`` (logarithmic decrement; S. S. Rao, Mechanical Vibrations, section 2.6). The roots of ``s² + (c/m) s + k/m`` are
``-σ ± iω_d``, so ``c/m = 2σ`` and ``k/m = ω_d² + σ²``.

Where a hand would stop: swings below ``smallest`` of the largest sample are taken for noise. A swing is a run of
samples beyond that level on one side; so a sign that noise turns about zero is no crossing. The reading ends where a
swing is missing (a gap of more than 1.5 times the median half period).

It is biased without any noise where samples are few: at five samples a cycle the top of a parabola is up to 4 % low,
depending on where the samples fall. A sensor's offset is the level about which successive extremes alternate and decay:
for three of them, ``e₁, e₂, e₃``, a geometric sequence about ``(e₁e₃ - e₂²)/(e₁ + e₃ - 2e₂)`` (Aitken's formula),
averaged over the triples, in a few rounds from the mean of the samples. Times may be uneven.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import Card, InputError
from methods.modal.free_decay import FreeDecayIdentifier
from methods.regression.derivatives import finite_differences

MIN_CROSSINGS = 3
"""One full cycle."""
MIN_EXTREMES = 2
LEVEL_ROUNDS = 5
MISSING = 1.5
"""A gap between crossings of more than this many median half periods has lost a swing."""


@dataclass(frozen=True)
class LogDecrement(FreeDecayIdentifier):
    """Swings down to ``smallest`` of the largest sample are read; ``bootstrap`` records give the covariance."""

    smallest: float = 0.2
    bootstrap: int = 100

    unreadable: ClassVar[str] = (
        f"fewer than {MIN_CROSSINGS} zero crossings or {MIN_EXTREMES} extremes above its level smallest: take a longer "
        "record, more samples a cycle or less noise; a mass that returns to rest without swinging, damped near or "
        "above critically, has no decrement: take matrix_pencil or output_error"
    )
    card: ClassVar[Card] = Card(
        summary="zero crossings for the frequency, logarithmic decrement of the extremes for the damping",
        start="not used",
        scale="groups",
        reconstruction="simulated",
        uncertainty="covariance of a parametric bootstrap: spread only, not the bias of few samples a cycle",
        settings_source="textbook; the level at which reading stops is a rule of thumb",
        tuning="none",
        title="Logarithmic decrement",
        order=110,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.smallest < 1:
            raise InputError("method.smallest", self.smallest, "a part of the largest sample, between 0 and 1")

    def read(self, times: np.ndarray, sets: np.ndarray, offset: bool) -> np.ndarray:
        level = resting_level(times, sets, self.smallest)[:, None] if offset else 0.0
        return decrement(times, sets - level, self.smallest)


def decrement(times: np.ndarray, sets: np.ndarray, smallest: float) -> np.ndarray:
    """k/m and c/m, (sets, 2), of records (sets, n) as the module's docstring says; NaN where there is too little."""
    swings = Swings.of(times, sets, smallest)
    at, heights = extremes(times, sets, swings.largest)
    numbers = np.broadcast_to(np.arange(swings.crossings.shape[1], dtype=float), swings.crossings.shape)
    with np.errstate(all="ignore"):
        half_period = _slope(numbers, swings.crossings)
        decay = -_slope(at, np.log(np.abs(heights)))
        groups = np.stack([(np.pi / half_period) ** 2 + decay**2, 2.0 * decay], axis=1)
    enough = (_count(swings.crossings) >= MIN_CROSSINGS) & (_count(heights) >= MIN_EXTREMES)
    return np.where(enough[:, None], groups, np.nan)


def resting_level(times: np.ndarray, sets: np.ndarray, smallest: float) -> np.ndarray:
    """The levels (sets,) about which extremes of records (sets, n) alternate; the mean where there are fewer than 3."""
    level, going = np.mean(sets, axis=1), np.arange(len(sets))
    for _ in range(LEVEL_ROUNDS):
        y = sets[going] - level[going, None]
        _at, heights = extremes(times, y, Swings.of(times, y, smallest).largest)
        enough = _count(heights) >= 3
        going, e = going[enough], _packed(heights[enough])
        if not going.size:
            break
        # NaN in the triples that are not there
        levels = (e[:, :-2] * e[:, 2:] - e[:, 1:-1] ** 2) / (e[:, :-2] + e[:, 2:] - 2.0 * e[:, 1:-1])
        there = np.isfinite(e[:, 2:])
        level[going] += np.sum(np.where(there, levels, 0.0), axis=1) / np.sum(there, axis=1)
    return level


@dataclass(frozen=True, eq=False)
class Swings:
    """The swings of records, earliest first: where each is ``largest`` (sets, swings), -1 where there is none.

    ``crossings`` (sets, swings - 1) are the times of zero between them, NaN where there is none.
    """

    largest: np.ndarray
    crossings: np.ndarray

    @staticmethod
    def of(times: np.ndarray, sets: np.ndarray, smallest: float) -> Swings:
        """Read records (sets, n).

        Between the last sample of one swing and the first of the next the sign may turn more than once, in noise: the
        mean of those times is taken.
        """
        size, n = np.abs(sets), sets.shape[1]
        # samples beyond the level, set by set, and where among them a swing begins
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
        # straight lines between samples of opposite sign, each after the sample number ``before`` beyond the level
        turning, j = np.nonzero((sets[:, :-1] >= 0) != (sets[:, 1:] >= 0))
        before = np.searchsorted(owner * n + i, turning * n + j, side="right") - 1
        ends = np.append(begins[1:] & (np.diff(owner) == 0), [False, False])  # the last of a swing that has a next one
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
    """How many crossings of (sets, count) come before the first gap that has lost a swing, (sets,)."""
    count, gaps = _count(crossings), np.diff(crossings, axis=1)
    if not gaps.shape[1]:
        return count
    ordered, middle = np.sort(gaps, axis=1), np.maximum(count - 1, 1)
    low, high = (np.take_along_axis(ordered, i[:, None], axis=1) for i in ((middle - 1) // 2, middle // 2))
    lost = gaps > MISSING * 0.5 * (low + high)
    return np.where(np.any(lost, axis=1), np.argmax(lost, axis=1) + 1, count)


def extremes(times: np.ndarray, sets: np.ndarray, largest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times and heights of the extremes, by the parabola through each swing's ``largest`` sample and its neighbours.

    The parabola has its top at ``-x'/x''`` from the sample, where it is ``x - x'²/(2x'')``; of three equal samples it
    is the middle one. A swing whose largest sample is the first or the last of the record has no top to be seen: NaN,
    as where there is no swing. Of records (sets, n) and numbers of samples (sets, swings).
    """
    seen = (largest > 0) & (largest < sets.shape[1] - 1)
    i = np.where(seen, largest, 1)
    motion = finite_differences(times, sets)
    x, v, a = (np.take_along_axis(part, i - 1, axis=1) for part in (motion.x, motion.v, motion.a))
    away = np.where(a == 0.0, 0.0, -v / np.where(a == 0.0, 1.0, a))
    return np.where(seen, times[i] + away, np.nan), np.where(seen, x + 0.5 * v * away, np.nan)


def _count(values: np.ndarray) -> np.ndarray:
    """How many values (sets, count) are not NaN."""
    return np.sum(~np.isnan(values), axis=1)


def _packed(values: np.ndarray) -> np.ndarray:
    """Values (sets, count) with those that are NaN behind the others."""
    return np.take_along_axis(values, np.argsort(np.isnan(values), axis=1, kind="stable"), axis=1)


def _slope(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The slopes (sets,) of the least-squares lines through the points (sets, count) whose y is not NaN."""
    there = ~np.isnan(y)
    mean = np.sum(np.where(there, x, 0.0), axis=1) / np.sum(there, axis=1)
    away = np.where(there, x - mean[:, None], 0.0)
    return np.asarray(np.sum(away * np.where(there, y, 0.0), axis=1) / np.sum(away**2, axis=1))
