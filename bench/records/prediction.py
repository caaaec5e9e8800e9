"""Prediction of the last part of a record by a fit to its first part."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench.likelihood.compiled_model import compiled_output_error
from bench.records.linearised_fit import LinearisedFit

HELD_OUT = 0.4
"""Share of the record that is held out, at its end."""
FEWEST = 12
"""Least number of samples per channel that are fitted, if there are as many."""
ITERATIONS = 15
"""Iterations of the fit, which starts at the estimate of the whole record."""


@dataclass(frozen=True, eq=False)
class HeldOutPrediction:
    """Prediction of a record by a fit to its first part.

    Attributes:
        split: Time of the last fitted sample of the first channel, in natural units.
        predicted: Predicted samples of all channels, shape (N,).
        late: Mask of the held-out samples, shape (N,).
    """

    split: float
    predicted: np.ndarray
    late: np.ndarray

    def fit_percent(self, measured: np.ndarray, samples: slice | np.ndarray = slice(None)) -> float:
        """Return the fit ``100 (1 - |y - h| / |y - mean y|)`` over held-out samples; NaN if it is not defined.

        See L. Ljung, System Identification, 2nd ed. 1999, section 16.4.

        Args:
            measured: Measured samples of all channels, shape (N,).
            samples: Selection of the samples to compare, such as those of a channel.
        """
        late = self.late[samples]
        y, h = measured[samples][late], self.predicted[samples][late]
        scale = float(np.linalg.norm(y - np.mean(y))) if y.size else 0.0
        return float(100.0 * (1.0 - np.linalg.norm(y - h) / scale)) if scale > 0 and np.all(np.isfinite(h)) else np.nan


def predict_held_out(fit: LinearisedFit) -> HeldOutPrediction | None:
    """Fit the first part of a record and predict all of it.

    Returns:
        The prediction; None for several records, or if the first part has other unknowns than the whole.
    """
    problem = fit.model.problem
    if len(problem.records) > 1:
        return None
    record, channels = problem.records[0], problem.records[0].channels
    length = (1.0 - HELD_OUT) * record.duration
    counts = [max(int(np.searchsorted(c.times, length, side="right")), min(FEWEST, c.n)) for c in channels]
    first = (replace(c, times=c.times[:n], values=c.values[:n]) for c, n in zip(channels, counts, strict=True))
    early = replace(problem, records=(replace(record, channels=tuple(first)),))
    model = compiled_output_error(early, fit.model.gauge)
    if model.size != fit.theta.size:
        return None
    with np.errstate(all="ignore"):
        predicted = fit.model.predict(model.settle(fit.theta[None], iterations=ITERATIONS)[0])
    late = np.concatenate([np.arange(c.n) >= n for c, n in zip(channels, counts, strict=True)])
    return HeldOutPrediction(float(channels[0].times[counts[0] - 1]), predicted, late)


def held_out_fit(fit: LinearisedFit) -> float:
    """Return the fit (%) of the held-out samples; NaN if they cannot be predicted."""
    prediction = predict_held_out(fit)
    return np.nan if prediction is None else prediction.fit_percent(fit.model.data)
