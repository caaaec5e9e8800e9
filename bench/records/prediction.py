"""The last part of a record as a fit of its first part predicts it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench.likelihood.compiled import compiled_output_error
from bench.records.linearised_fit import LinearisedFit

HELD_OUT = 0.4
"""Part of the record that the fit does not see."""
FEWEST = 12
"""Samples of a channel that the fit sees at least, where there are as many."""
ITERATIONS = 15
"""Of the search from the whole record's answer, which is near."""


@dataclass(frozen=True, eq=False)
class HeldOutPrediction:
    """The record's samples (N,) as a fit of those before ``split`` predicts them; ``late``: which it has not seen.

    ``split`` is the time of the last sample of the first channel that the fit has seen, in natural units.
    """

    split: float
    predicted: np.ndarray
    late: np.ndarray

    def fit_percent(self, measured: np.ndarray, samples: slice | np.ndarray = slice(None)) -> float:
        """Compute ``100 (1 - |y - h| / |y - mean y|)`` over the unseen of some samples; NaN where it is not defined.

        The fit that nonlinear system identification reports (L. Ljung, System Identification, 2nd ed. 1999, section
        16.4).
        """
        late = self.late[samples]
        y, h = measured[samples][late], self.predicted[samples][late]
        scale = float(np.linalg.norm(y - np.mean(y))) if y.size else 0.0
        return float(100.0 * (1.0 - np.linalg.norm(y - h) / scale)) if scale > 0 and np.all(np.isfinite(h)) else np.nan


def predict_held_out(at: LinearisedFit) -> HeldOutPrediction | None:
    """Fit the first part of a record from its answer; None for several records, or without the same unknowns."""
    problem = at.model.problem
    if len(problem.records) > 1:
        return None
    record, channels = problem.records[0], problem.records[0].channels
    length = (1.0 - HELD_OUT) * record.duration
    counts = [max(int(np.searchsorted(c.times, length, side="right")), min(FEWEST, c.n)) for c in channels]
    first = (replace(c, times=c.times[:n], values=c.values[:n]) for c, n in zip(channels, counts, strict=True))
    early = replace(problem, records=(replace(record, channels=tuple(first)),))
    model = compiled_output_error(early, at.model.gauge)
    if model.size != at.theta.size:
        return None
    with np.errstate(all="ignore"):
        predicted = at.model.predict(model.settle(at.theta[None], iterations=ITERATIONS)[0])
    late = np.concatenate([np.arange(c.n) >= n for c, n in zip(channels, counts, strict=True)])
    return HeldOutPrediction(float(channels[0].times[counts[0] - 1]), predicted, late)


def held_out_fit(at: LinearisedFit) -> float:
    """Return the fit (%) of the last part by that of the first; NaN where that fit is not possible."""
    early = predict_held_out(at)
    return np.nan if early is None else early.fit_percent(at.model.data)
