"""Zero crossings and logarithmic decrement: what an engineer does by hand with the free decay of one mass.

The zero crossings, interpolated linearly, lie half a period ``π/ω_d`` apart: the slope of a straight line through
(number, time) gives the damped frequency. The extremes between them (a parabola through the three samples about each
largest one) lie on ``A e^(-σt)`` up to one constant: the slope of a straight line through (time, log|extreme|) gives
``-σ`` (logarithmic decrement; S. S. Rao, Mechanical Vibrations, section 2.6). The roots of ``s² + (c/m) s + k/m`` are
``-σ ± iω_d``, so ``c/m = 2σ`` and ``k/m = ω_d² + σ²``.

Where a hand would stop: swings below ``smallest`` of the largest sample are taken for noise. A swing is a run of
samples beyond that level on one side; so a sign that noise turns about zero is no crossing. The reading ends where a
swing is missing (a gap of more than 1.5 times the median half period).

It is biased without any noise where samples are few: a straight line is not the sine's way through zero, nor a parabola
its top. At five samples a cycle the top of a parabola is up to 4 % low, depending on where the samples fall.
A sensor's offset is the level about which successive extremes alternate and decay: for three of them, ``e₁, e₂, e₃``,
a geometric sequence about ``(e₁e₃ - e₂²)/(e₁ + e₃ - 2e₂)`` (Aitken's formula), averaged over the triples. It starts at
the mean of the samples and is found in a few rounds, since the swings are counted from it.

Times may be uneven. The start, the prior and the noise level are not used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np

from bench import Card, Estimate, Identifier, InputError, Problem, Serves
from methods.modal.free_decay import SERVES, Reading, decay_estimates, decay_objection
from methods.regression.derivatives import finite_differences

MIN_CROSSINGS = 3
"""One full cycle."""
MIN_EXTREMES = 2
LEVEL_ROUNDS = 5
MISSING = 1.5
"""A gap between crossings of more than this many median half periods has lost a swing."""


@dataclass(frozen=True)
class LogDecrement(Identifier):
    """Swings down to ``smallest`` of the largest sample are read; ``bootstrap`` records give the covariance."""

    smallest: float = 0.2
    bootstrap: int = 100

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
        colour="#44AA99",
        marker="<",
    )
    serves: ClassVar[Serves] = SERVES
    works_in = "natural units"

    def __post_init__(self) -> None:
        if not 0 < self.smallest < 1:
            raise InputError("method.smallest", self.smallest, "a part of the largest sample, between 0 and 1")
        if self.bootstrap < 0:
            raise InputError("method.bootstrap", self.bootstrap, "a number of records, 0 for no uncertainty")

    def objection(self, problem: Problem) -> str | None:
        return super().objection(problem) or decay_objection(problem)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate the groups k/m and c/m; ``diverged`` where there are too few crossings or extremes."""
        return self.estimate_many([problem], [rng])[0]

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Estimate problems of one layout together."""
        sentence = (
            f"fewer than {MIN_CROSSINGS} zero crossings or {MIN_EXTREMES} extremes above {self.smallest:g} of the "
            "largest sample: take a longer record, more samples a cycle or less noise"
        )
        return decay_estimates(problems, rngs, Reading(self._read, sentence, self.bootstrap))

    def _read(self, times: np.ndarray, sets: np.ndarray, offset: bool) -> np.ndarray:
        if offset:
            sets = np.array([y - resting_level(times, y, self.smallest) for y in sets])
        return np.array([decrement(times, y, self.smallest) for y in sets])


def decrement(times: np.ndarray, y: np.ndarray, smallest: float) -> tuple[float, float]:
    """k/m and c/m of one record (n,) as the module's docstring says; NaN where there is too little to read."""
    swings, crossings = swings_and_crossings(times, y, smallest)
    at, heights = extremes(times, y, swings)
    if crossings.size < MIN_CROSSINGS or heights.size < MIN_EXTREMES:
        return float("nan"), float("nan")
    half_period = _slope(np.arange(crossings.size, dtype=float), crossings)
    decay = -_slope(at, np.log(np.abs(heights)))
    return (np.pi / half_period) ** 2 + decay**2, 2.0 * decay


def resting_level(times: np.ndarray, y: np.ndarray, smallest: float) -> float:
    """The level about which the extremes of a record (n,) alternate; its mean where there are fewer than three."""
    level = float(np.mean(y))
    for _ in range(LEVEL_ROUNDS):
        swings, _crossings = swings_and_crossings(times, y - level, smallest)
        _at, e = extremes(times, y - level, swings)
        if e.size < 3:
            break
        level += float(np.mean((e[:-2] * e[2:] - e[1:-1] ** 2) / (e[:-2] + e[2:] - 2.0 * e[1:-1])))
    return level


def swings_and_crossings(times: np.ndarray, y: np.ndarray, smallest: float) -> tuple[list[np.ndarray], np.ndarray]:
    """The swings, as numbers of their samples, and the times of zero between them (one fewer), earliest first.

    Between the last sample of one swing and the first of the next the sign may turn more than once, in noise: the mean
    of those times is taken.
    """
    beyond = np.flatnonzero(np.abs(y) >= smallest * np.max(np.abs(y)))
    swings = np.split(beyond, np.flatnonzero(np.diff(np.sign(y[beyond]))) + 1)
    crossings = np.array([_zero(times, y, a[-1], b[0]) for a, b in pairwise(swings)])
    gaps = np.diff(crossings)
    lost = np.flatnonzero(gaps > MISSING * np.median(gaps)) if gaps.size else gaps
    kept = int(lost[0]) + 1 if lost.size else crossings.size
    return swings[: kept + 1], crossings[:kept]


def _zero(times: np.ndarray, y: np.ndarray, first: int, last: int) -> float:
    """Where straight lines between samples ``first`` and ``last``, of opposite sign, pass through zero; on average."""
    t, x = times[first : last + 1], y[first : last + 1]
    turns = np.flatnonzero((x[:-1] >= 0) != (x[1:] >= 0))
    return float(np.mean(t[turns] - x[turns] * (t[turns + 1] - t[turns]) / (x[turns + 1] - x[turns])))


def extremes(times: np.ndarray, y: np.ndarray, swings: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Times and heights of the extremes, by the parabola through the largest sample of each swing and its neighbours.

    The parabola has its top at ``-x'/x''`` from the sample, where it is ``x - x'²/(2x'')``; of three equal samples it
    is the middle one. A swing whose largest sample is the first or the last of the record has no top to be seen.
    """
    largest = np.array([swing[np.argmax(np.abs(y[swing]))] for swing in swings], dtype=int)
    largest = largest[(largest > 0) & (largest < y.size - 1)]
    motion = finite_differences(times, y)
    v, a = motion.v[largest - 1], motion.a[largest - 1]
    away = np.where(a == 0.0, 0.0, -v / np.where(a == 0.0, 1.0, a))
    return times[largest] + away, y[largest] + 0.5 * v * away


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    """The slope of the least-squares line through the points."""
    away = x - np.mean(x)
    return float(away @ y / (away @ away))
