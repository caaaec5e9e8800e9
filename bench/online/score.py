"""Scores of trackers on one scenario: error over the bound, coverage, delay of a change, false alarms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bench.online.follow import Followed
from bench.online.scenario import OnlineScenario, Stream
from bench.systems import Quantity

SCORED_FROM = 0.25
"""Part of a record behind which errors are pooled: before, trackers collect what they need to begin."""
Z95 = 1.959963984540054
LEVELS = (1.0, 1.5, 1.96, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0)
"""Standard deviations of the curve of delays against false alarms."""
AFTER = ((0, 50), (50, 200), (200, 1000))
"""Samples since a change, by which errors are pooled."""


@dataclass(frozen=True, eq=False)
class Scored:
    """One replicate and quantity: squared errors of the logarithm, variances stated and of the bound, each (n,).

    ``z_old``: standard deviations between what is believed and the value at time 0, (n,).
    """

    squared: np.ndarray
    stated: np.ndarray
    bound: np.ndarray
    z_old: np.ndarray


def scored(stream: Stream, path: Followed, bound: Mapping[str, np.ndarray], quantity: str) -> Scored:
    """Compare a path with the truth."""
    names = [q.name for q in stream.layout.quantities]
    i, of = names.index(quantity), stream.layout.quantities[names.index(quantity)]
    true = np.log(of.value(stream.truth.parameters))
    with np.errstate(invalid="ignore", divide="ignore"):
        z_old = np.abs(path.means[:, i] - true[0]) / path.sds[:, i]
    return Scored((path.means[:, i] - true) ** 2, path.sds[:, i] ** 2, bound[quantity], z_old)


@dataclass(frozen=True)
class Score:
    """Of one quantity over the replicates. NaN where it does not apply.

    ``excess``: root mean square error over the bound, pooled from :data:`SCORED_FROM` on, over samples with a
    distribution; ``share``: of those samples that have one; ``rms``: that error, in percent; ``after``: excess by
    samples since the change (:data:`AFTER`); ``coverage``: of the 95 % intervals; ``delay``: median samples from the
    change until the 95 % interval excludes the old value, infinite where most never do; ``curve``: (false alarms in
    1,000 samples, median delay) by :data:`LEVELS`, each NaN where the scenario cannot tell it.
    """

    excess: float
    rms: float
    share: float
    coverage: float
    after: tuple[float, ...]
    delay: float
    curve: tuple[tuple[float, float], ...]
    n: int


def score_bound(
    scenario: OnlineScenario, streams: Sequence[Stream], bounds: Sequence[np.ndarray], of: Quantity
) -> Score:
    """The bound's own row: its error, and the delay of a tracker whose error has just its variance."""
    first, at = round(SCORED_FROM * scenario.samples), scenario.change_at
    true = np.log([of.value(stream.truth.parameters) for stream in streams])
    z_old = np.abs(true - true[:, :1]) / np.sqrt(bounds)
    curve = tuple((float("nan"), _delay(z_old, at, level)) for level in LEVELS)
    after = tuple(1.0 if at is not None else float("nan") for _ in AFTER)
    rms = 100.0 * float(np.sqrt(np.mean([np.mean(bound[first:]) for bound in bounds])))
    return Score(1.0, rms, 1.0, float("nan"), after, _delay(z_old, at, Z95), curve, len(bounds))


def score(scenario: OnlineScenario, replicates: Sequence[Scored]) -> Score:
    """Pool replicates of one scenario."""
    first = round(SCORED_FROM * scenario.samples)
    squared, stated, bound, z_old = (
        np.stack([getattr(one, name) for one in replicates]) for name in ("squared", "stated", "bound", "z_old")
    )
    late = np.arange(scenario.samples) >= first
    told = np.isfinite(squared) & late
    with np.errstate(invalid="ignore"):
        inside = squared[told] <= Z95**2 * stated[told]
    at = scenario.change_at
    after = tuple(
        _excess(squared, bound, told & _between(scenario.samples, at, low, high)) if at is not None else np.nan
        for low, high in AFTER
    )
    curve = tuple((_false_alarms(z_old, told, scenario, level), _delay(z_old, at, level)) for level in LEVELS)
    rms = 100.0 * float(np.sqrt(np.mean(squared[told]))) if told.any() else np.nan
    return Score(
        _excess(squared, bound, told), rms, float(told.sum() / (late.sum() * len(replicates))),
        float(np.mean(inside)) if told.any() else np.nan, after, _delay(z_old, at, Z95), curve, len(replicates),
    )  # fmt: skip


def _between(n: int, at: int, low: int, high: int) -> np.ndarray:
    place = np.arange(n) - at
    return np.asarray((place >= low) & (place < high))


def _excess(squared: np.ndarray, bound: np.ndarray, told: np.ndarray) -> float:
    return float(np.sqrt(np.mean(squared[told]) / np.mean(bound[told]))) if told.any() else float("nan")


def _delay(z_old: np.ndarray, at: int | None, level: float) -> float:
    """Median over replicates of the samples until the old value is excluded."""
    if at is None:
        return float("nan")
    with np.errstate(invalid="ignore"):
        excluded = z_old[:, at:] > level
    delays = np.where(excluded.any(axis=1), np.argmax(excluded, axis=1).astype(float), np.inf)
    return float(np.sort(delays)[(len(delays) - 1) // 2])


def _false_alarms(z_old: np.ndarray, told: np.ndarray, scenario: OnlineScenario, level: float) -> float:
    """Times in 1,000 samples that the interval begins to exclude the true value of a constant system."""
    if not scenario.constant or not told.any():
        return float("nan")
    with np.errstate(invalid="ignore"):
        out = (z_old > level) & told
    begins = out & ~np.concatenate([np.zeros((len(out), 1), bool), out[:, :-1]], axis=1)
    return float(1000.0 * begins.sum() / told.sum())
