"""The last part of a record as a fit of its first part predicts it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench.contract.problem import Channel, Record
from bench.likelihood.compiled import compiled_output_error
from bench.records.linearised import Linearised

HELD_OUT = 0.4
ITERATIONS = 15


@dataclass(frozen=True, eq=False)
class EarlyFit:
    """The record's samples (N,) as a fit of those before ``split`` predicts them; ``late``: which it has not seen.

    ``split`` is the time of the last sample of the first channel that the fit has seen, in natural units.
    """

    split: float
    predicted: np.ndarray
    late: np.ndarray

    def fit_percent(self, measured: np.ndarray, channel: np.ndarray | None = None) -> float:
        """``100 (1 - |y - h| / |y - mean y|)`` over the unseen samples, of one ``channel`` (sample numbers) or of all.

        The fit that nonlinear system identification reports (L. Ljung, System Identification, 2nd ed. 1999, section
        16.4). NaN where it is not defined.
        """
        own = self.late if channel is None else self.late & np.isin(np.arange(self.late.size), channel)
        y, h = measured[own], self.predicted[own]
        scale = float(np.linalg.norm(y - np.mean(y))) if y.size else 0.0
        return float(100.0 * (1.0 - np.linalg.norm(y - h) / scale)) if scale > 0 and np.all(np.isfinite(h)) else np.nan


def early_fit(at: Linearised) -> EarlyFit | None:
    """Fit the first 60 % of a record from its answer; None for several records, or where a start is not told again."""
    problem = at.model.problem
    if len(problem.records) > 1:
        return None
    record = problem.records[0]
    early = window(record, (1.0 - HELD_OUT) * record.duration)
    model = compiled_output_error(replace(problem, records=(early,)), at.model.gauge)
    if model.size != at.theta.size:
        return None
    with np.errstate(all="ignore"):
        predicted = at.model.predict(model.settle(at.theta[None], iterations=ITERATIONS)[0])
    late = [np.arange(c.n) >= e.n for c, e in zip(record.channels, early.channels, strict=True)]
    return EarlyFit(float(early.channels[0].times[-1]), predicted, np.concatenate(late))


def held_out_fit(at: Linearised) -> float:
    """The fit (%) of the last 40 % by that of the first 60 %; NaN where that fit is not possible."""
    found = early_fit(at)
    return float("nan") if found is None else found.fit_percent(at.model.data)


def window(record: Record, length: float) -> Record:
    """Return the record up to a time, but no shorter than twelve samples a channel."""
    return replace(record, channels=tuple(_first_part(channel, length) for channel in record.channels))


def _first_part(channel: Channel, length: float) -> Channel:
    n = max(int(np.searchsorted(channel.times, length, side="right")), min(12, channel.n))
    return replace(channel, times=channel.times[:n], values=channel.values[:n])
