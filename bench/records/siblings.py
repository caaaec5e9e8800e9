"""Siblings: records of one rig, or parts of one record, that tell the same quantities; and how well they agree.

There is no truth of a measured record. That its siblings agree within what is stated of each is what can be asked:
``R`` is the standard deviation between siblings over the median standard error stated of one, 1 where the stated
errors are right, and of the intervals it is counted how many hold the mean of the other siblings. That mean has an
error of its own, so that right intervals of 95 % hold it in 83 % of cases with two siblings, 91 % with four, 93 % with
six.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.records.intervals import HALF
from bench.records.reading import Recording, Signal
from bench.records.sets import MeasuredSet


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
class Stated:
    """A value with its 95 % interval, and that which takes the noise for white."""

    value: float
    low: float
    high: float
    white_low: float
    white_high: float

    def error(self, white: bool) -> float:
        """The standard error: half of the interval over 1.96."""
        low, high = self.ends(white)
        return (high - low) / 2.0 / HALF

    def ends(self, white: bool) -> tuple[float, float]:
        return (self.white_low, self.white_high) if white else (self.low, self.high)


@dataclass(frozen=True)
class SiblingAgreement:
    """How siblings agree on one quantity: R, and how many of ``counted`` intervals hold the mean of the others.

    ``n`` answers stand, with an interval or without; ``error`` is the median distance to the known value over it (%),
    NaN where nothing is known.
    """

    n: int
    median: float
    error: float
    ratio: float
    ratio_white: float
    covered: int
    covered_white: int
    counted: int


def agreement(found: Sequence[Stated], known: float | None = None) -> SiblingAgreement:
    """The agreement of the siblings that have an answer that stands; one without an interval states nothing."""
    values = [one.value for one in found]
    bounded = [one for one in found if all(map(math.isfinite, (*one.ends(False), *one.ends(True))))]
    counted = bounded if len(bounded) > 1 else []
    spread = float(np.std([one.value for one in counted], ddof=1)) if counted else math.nan
    covered = {False: 0, True: 0}
    for one in counted:
        mean = float(np.mean([other.value for other in counted if other is not one]))
        for white in covered:
            low, high = one.ends(white)
            covered[white] += low <= mean <= high
    error = math.nan
    if known is not None and values:
        error = 100.0 * float(np.median(np.abs(np.array(values) - known))) / abs(known)
    return SiblingAgreement(
        n=len(found),
        median=float(np.median(values)) if values else math.nan,
        error=error,
        ratio=_ratio(spread, [one.error(False) for one in counted]),
        ratio_white=_ratio(spread, [one.error(True) for one in counted]),
        covered=covered[False],
        covered_white=covered[True],
        counted=len(counted),
    )


def _ratio(spread: float, errors: Sequence[float]) -> float:
    middle = float(np.median(errors)) if errors else math.nan
    return spread / middle if middle > 0 else math.nan


@dataclass(frozen=True)
class Total:
    """Agreements taken together: coverage as stated and white, and the median of R."""

    covered: int
    covered_white: int
    counted: int
    ratio: float
    ratio_white: float

    @property
    def coverage(self) -> float:
        return self.covered / self.counted if self.counted else math.nan

    @property
    def coverage_white(self) -> float:
        return self.covered_white / self.counted if self.counted else math.nan


def total(agreements: Iterable[SiblingAgreement]) -> Total:
    """The sums of the counts, and the medians of R over those that have one."""
    several = [one for one in agreements if one.counted]
    return Total(
        covered=sum(one.covered for one in several),
        covered_white=sum(one.covered_white for one in several),
        counted=sum(one.counted for one in several),
        ratio=_middle([one.ratio for one in several]),
        ratio_white=_middle([one.ratio_white for one in several]),
    )


def _middle(ratios: Sequence[float]) -> float:
    finite = [ratio for ratio in ratios if math.isfinite(ratio)]
    return float(np.median(finite)) if finite else math.nan


def interval_score(low: float, high: float, truth: float, level: float = 0.95) -> float:
    """Return the width of an interval, and 2 / (1 - level) times the distance by which it misses the truth.

    T. Gneiting, A. E. Raftery, J. Am. Stat. Assoc. 102:359, 2007, section 6.2. The smaller the better.
    """
    return (high - low) + 2.0 / (1.0 - level) * (max(low - truth, 0.0) + max(truth - high, 0.0))


def interval_score_ratio(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[float, float]:
    """Score intervals of siblings' values (n,) against the mean of the others, over the score of the ideal intervals.

    The ideal ones are as wide as 1.96 standard deviations between siblings to either side. Returns the ratio, and the
    share of the intervals that cover the mean of the others.
    """
    others = (np.sum(values) - values) / (values.size - 1)
    half = HALF * float(np.std(values, ddof=1))
    stated = [interval_score(*each) for each in zip(low, high, others, strict=True)]
    ideal = [interval_score(v - half, v + half, mean) for v, mean in zip(values, others, strict=True)]
    covered = float(np.mean((low <= others) & (others <= high)))
    return float(np.mean(stated) / np.mean(ideal)) if half > 0 else math.nan, covered
