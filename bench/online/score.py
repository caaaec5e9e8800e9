"""Scores of trackers on one scenario: error over the bound, coverage, delay of a change, false alarms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bench.online.follow import Followed
from bench.online.scenario import OnlineScenario, Stream
from bench.systems import Quantity

SCORED_FROM = 0.25
"""Fraction of a record after which errors are scored; before it, trackers initialise."""
Z95 = 1.959963984540054
LEVELS = (1.0, 1.5, 1.96, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0)
"""Thresholds, in standard deviations, of the curve of delay against false alarms."""
AFTER = ((0, 50), (50, 200), (200, 1000))
"""Ranges of samples since a change, over which errors are pooled."""


@dataclass(frozen=True, eq=False)
class Scored:
    """Errors of one quantity in one replicate, each (n,).

    ``squared``: squared errors of the logarithm; ``stated``: variances stated by the tracker; ``bound``: variances of
    the bound; ``z_old``: distance of the estimate from the value at time 0, in stated standard deviations.
    """

    squared: np.ndarray
    stated: np.ndarray
    bound: np.ndarray
    z_old: np.ndarray


def scored(stream: Stream, path: Followed, bound: Mapping[str, np.ndarray], quantity: str) -> Scored:
    """Compare the path of a tracker with the true values."""
    i = [q.name for q in stream.layout.quantities].index(quantity)
    true = np.log(stream.layout.quantities[i].value(stream.truth.parameters))
    with np.errstate(invalid="ignore", divide="ignore"):
        z_old = np.abs(path.means[:, i] - true[0]) / path.sds[:, i]
    return Scored((path.means[:, i] - true) ** 2, path.sds[:, i] ** 2, bound[quantity], z_old)


@dataclass(frozen=True)
class Score:
    """Scores of one quantity over the replicates; NaN where not applicable.

    ``excess``: root mean square error over the bound, after :data:`SCORED_FROM`, over samples with a distribution;
    ``rms``: this error in percent; ``share``: share of samples with a distribution; ``coverage``: coverage of the 95 %
    intervals; ``after``: excess in the ranges :data:`AFTER` of samples since the change; ``delay``: median number of
    samples from the change until the 95 % interval excludes the old value, infinite if most never do; ``curve``: false
    alarms per 1,000 samples and median delay for each threshold of :data:`LEVELS`; ``n``: number of replicates.
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
    scenario: OnlineScenario, streams: Sequence[Stream], bounds: Sequence[np.ndarray], quantity: Quantity
) -> Score:
    """Return the scores of the bound: its error, and the delay of a tracker whose variance equals the bound."""
    first, change = round(SCORED_FROM * scenario.samples), scenario.change_at
    true = np.log([quantity.value(stream.truth.parameters) for stream in streams])
    z_old = np.abs(true - true[:, :1]) / np.sqrt(bounds)
    curve = tuple((float("nan"), _delay(z_old, change, level)) for level in LEVELS)
    after = tuple(1.0 if change is not None else float("nan") for _ in AFTER)
    rms = 100.0 * float(np.sqrt(np.mean([np.mean(bound[first:]) for bound in bounds])))
    return Score(1.0, rms, 1.0, float("nan"), after, _delay(z_old, change, Z95), curve, len(bounds))


def score(scenario: OnlineScenario, replicates: Sequence[Scored]) -> Score:
    """Score all replicates of a scenario."""
    first = round(SCORED_FROM * scenario.samples)
    squared, stated, bound, z_old = (
        np.stack([getattr(replicate, name) for replicate in replicates])
        for name in ("squared", "stated", "bound", "z_old")
    )
    in_range = np.arange(scenario.samples) >= first
    used = np.isfinite(squared) & in_range
    with np.errstate(invalid="ignore"):
        inside = squared[used] <= Z95**2 * stated[used]
    change = scenario.change_at
    after = tuple(
        _excess(squared, bound, used & _between(scenario.samples, change, low, high)) if change is not None else np.nan
        for low, high in AFTER
    )
    curve = tuple((_false_alarms(z_old, used, scenario, level), _delay(z_old, change, level)) for level in LEVELS)
    rms = 100.0 * float(np.sqrt(np.mean(squared[used]))) if used.any() else np.nan
    return Score(
        _excess(squared, bound, used), rms, float(used.sum() / (in_range.sum() * len(replicates))),
        float(np.mean(inside)) if used.any() else np.nan, after, _delay(z_old, change, Z95), curve, len(replicates),
    )  # fmt: skip


def _between(n: int, at: int, low: int, high: int) -> np.ndarray:
    place = np.arange(n) - at
    return np.asarray((place >= low) & (place < high))


def _excess(squared: np.ndarray, bound: np.ndarray, used: np.ndarray) -> float:
    return float(np.sqrt(np.mean(squared[used]) / np.mean(bound[used]))) if used.any() else float("nan")


def _delay(z_old: np.ndarray, change: int | None, level: float) -> float:
    """Return the median over replicates of the number of samples until the old value is excluded."""
    if change is None:
        return float("nan")
    with np.errstate(invalid="ignore"):
        excluded = z_old[:, change:] > level
    delays = np.where(excluded.any(axis=1), np.argmax(excluded, axis=1).astype(float), np.inf)
    return float(np.sort(delays)[(len(delays) - 1) // 2])


def _false_alarms(z_old: np.ndarray, used: np.ndarray, scenario: OnlineScenario, level: float) -> float:
    """Return how often per 1,000 samples the interval starts to exclude the true value of a constant system."""
    if not scenario.constant or not used.any():
        return float("nan")
    with np.errstate(invalid="ignore"):
        out = (z_old > level) & used
    begins = out & ~np.concatenate([np.zeros((len(out), 1), bool), out[:, :-1]], axis=1)
    return float(1000.0 * begins.sum() / used.sum())
