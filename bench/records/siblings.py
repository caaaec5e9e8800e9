"""Siblings: records of one rig, or parts of one record, that determine the same quantities; and how well they agree.

There is no truth of a measured record. Its siblings are what an interval of a repeat can be scored on: by the interval
score of its logarithm against the mean of the other siblings, over that of the ideal interval, which is as wide as the
siblings scatter. 1 is ideal; too narrow and too wide intervals both have more. Beside it stand how many intervals hold
that mean, ``R``, the standard deviation between siblings over the median stated standard error, and the median width.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.records.intervals import HALF, StatedInterval
from bench.records.reading import Recording, Signal
from bench.records.sets import MeasuredSet

KINDS = {"repeat": "", "record": "record_", "white": "white_"}
"""Kinds of interval, and how the names of their ends begin."""
LEAST_END = 1e-3
"""An end below this part of the value, or below zero, counts as this: a logarithm is needed."""


def pieces(recording: Recording, of: MeasuredSet) -> list[Recording]:
    """A recording of a set, cut into its parts, thinned, each from time 0."""
    scaled = [replace(s, times=s.times * of.time_scale) for s in recording.signals]
    end = max(float(s.times[-1]) for s in scaled)
    edges = np.linspace(0.0, end * (1.0 + 1e-12), of.parts + 1)
    found = []
    for i in range(of.parts):
        cut = [_cut(s, float(edges[i]), float(edges[i + 1]), i + 1 == of.parts) for s in scaled]
        start = min(float(s.times[0]) for s in cut)
        thin = tuple(_thinned(replace(s, times=s.times - start), of) for s in cut)
        found.append(replace(recording, signals=thin))
    return found


def _cut(signal: Signal, low: float, high: float, last: bool) -> Signal:
    inside = (signal.times >= low) & ((signal.times <= high) if last else (signal.times < high))
    return replace(signal, times=signal.times[inside], values=signal.values[inside])


def _thinned(signal: Signal, of: MeasuredSet) -> Signal:
    if signal.measures != "force":
        return replace(signal, times=signal.times[:: of.thin], values=signal.values[:: of.thin])
    n = signal.values.size // of.thin_force * of.thin_force
    if of.thin_force == 1 or n == 0:
        return signal
    times, values = (
        np.concatenate([own[:1], own[:n].reshape(-1, of.thin_force).mean(axis=1), own[-1:]])
        for own in (signal.times, signal.values)
    )
    return replace(signal, times=times, values=values)


@dataclass(frozen=True)
class IntervalScore:
    """How intervals of one kind do: ``score`` over the ideal's, how many are ``covered``, R, and the median width.

    ``width`` is the factor by which an interval reaches to either side of its value.
    """

    score: float = math.nan
    covered: int = 0
    ratio: float = math.nan
    width: float = math.nan


@dataclass(frozen=True)
class SiblingAgreement:
    """How siblings agree on one quantity, by kind of interval.

    ``n`` answers stand, of which ``counted`` have intervals that can be compared and ``limits`` state one end only;
    ``error`` is the median distance to the known value over it (%), NaN where nothing is known.
    """

    n: int
    median: float
    error: float
    counted: int
    limits: int
    kinds: Mapping[str, IntervalScore]


def agreement(stated: Sequence[StatedInterval], known: float | None = None) -> SiblingAgreement:
    """Compare the siblings that have an answer that stands."""
    values = np.array([own.value for own in stated])
    compared = [own for own in stated if not own.limit and own.value > 0 and _bounded(own)]
    compared = compared if len(compared) > 1 else []
    error = math.nan
    if known is not None and values.size:
        error = 100.0 * float(np.median(np.abs(values - known))) / abs(known)
    return SiblingAgreement(
        n=len(stated),
        median=float(np.median(values)) if values.size else math.nan,
        error=error,
        counted=len(compared),
        limits=sum(bool(own.limit) for own in stated),
        kinds={kind: interval_score_of(compared, kind) if compared else IntervalScore() for kind in KINDS},
    )


def _bounded(own: StatedInterval) -> bool:
    return all(math.isfinite(end) for end in (own.low, own.high, own.white_low, own.white_high))


def interval_score_of(stated: Sequence[StatedInterval], kind: str) -> IntervalScore:
    """Score the intervals of a kind of two or more siblings with positive values, on the scale of the logarithm."""
    values = np.log([own.value for own in stated])
    low, high = (
        np.log([max(getattr(own, f"{KINDS[kind]}{end}"), LEAST_END * own.value) for own in stated])
        for end in ("low", "high")
    )
    others = (np.sum(values) - values) / (values.size - 1)
    spread, half = float(np.std(values, ddof=1)), float(np.median(high - low)) / 2.0
    ideal = _interval_scores(values - HALF * spread, values + HALF * spread, others)
    return IntervalScore(
        score=float(np.mean(_interval_scores(low, high, others)) / np.mean(ideal)) if spread > 0 else math.nan,
        covered=int(np.sum((low <= others) & (others <= high))),
        ratio=HALF * spread / half if half > 0 else math.nan,
        width=math.exp(half),
    )


def _interval_scores(low: np.ndarray, high: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return the width of 95 % intervals, and forty times the distance by which they miss the truth.

    T. Gneiting, A. E. Raftery, J. Am. Stat. Assoc. 102:359, 2007, section 6.2.
    """
    missed = np.maximum(low - truth, 0.0) + np.maximum(truth - high, 0.0)
    return np.asarray(high - low + 2.0 / 0.05 * missed)


@dataclass(frozen=True)
class TotalScore:
    """Agreements taken together: median and worst score, coverage, medians of R and of the width."""

    score: float
    worst: float
    covered: int
    counted: int
    ratio: float
    width: float


def total(agreements: Iterable[SiblingAgreement], kind: str = "repeat") -> TotalScore:
    """Add the counts, and take medians over the agreements that have a score."""
    several = [each for each in agreements if each.counted]
    scores = [each.kinds[kind] for each in several]
    finite = [each.score for each in scores if math.isfinite(each.score)]
    return TotalScore(
        score=_middle([each.score for each in scores]),
        worst=max(finite, default=math.nan),
        covered=sum(each.covered for each in scores),
        counted=sum(each.counted for each in several),
        ratio=_middle([each.ratio for each in scores]),
        width=_middle([each.width for each in scores]),
    )


def _middle(values: Sequence[float]) -> float:
    finite = [value for value in values if math.isfinite(value)]
    return float(np.median(finite)) if finite else math.nan
