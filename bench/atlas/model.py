"""A statistical model of the free-decay atlas, which predicts the accuracy of a method at any point.

Gradient-boosted trees (scikit-learn) predict three quantiles of the logarithm of the core error over the bound, and the
probability of an outlier fit. :func:`unknown` states why there is no prediction for a point, :func:`cross_validate`
measures the accuracy of the predictions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pandas as pd

from bench.atlas.point import FreeDecay
from bench.isolation.machine import single_threaded

QUANTILES = (0.1, 0.5, 0.9)
FOLDS = 8
"""Number of parts in the cross-validation."""
MAX_SD = 0.2
"""A test determines a quantity if the bound on the standard deviation of its logarithm is at most this."""
FEWEST = 60
"""Smallest number of points for a model."""
MOST_OUTLIERS = 0.5
"""If the share of outlier fits at a point is larger, the core error of the others is not used."""
BOOSTED = {"max_iter": 60, "learning_rate": 0.06, "max_leaf_nodes": 8, "min_samples_leaf": 40}
"""Settings of the trees; leaves are large, since quantiles of few points are too narrow."""


@dataclass(frozen=True)
class Expected:
    """Predicted accuracy of a method: quantiles of the core error over the bound, and the share of outlier fits."""

    excess: tuple[float, float, float]
    gross: float


@dataclass(frozen=True)
class CrossValidation:
    """Accuracy of a model at points that were left out of its fit.

    ``error``: median absolute error of the log excess; ``within``: share of points inside the predicted 10 to 90 %
    range; both are NaN if nearly all points have mostly outlier fits. ``calibration``: mean difference of the predicted
    and the actual share of outlier fits, over tenths of the points in order of prediction; ``points``: their number.
    """

    error: float
    within: float
    calibration: float
    points: int


class AtlasModel:
    """The model of one method and quantity."""

    def __init__(self, frame: pd.DataFrame, quantity: str) -> None:
        """Fit the model to the rows of a method; raises ValueError if too few tests determine the quantity."""
        frame = determined(frame, quantity)
        if len(frame) < FEWEST:
            raise ValueError(f"{len(frame)} points are too few for a model")
        self.quantity = quantity
        core = frame[frame[f"{quantity}_gross"] <= MOST_OUTLIERS]
        known = len(core) >= FEWEST
        self._quantiles = [_quantile(core, quantity, share) for share in QUANTILES] if known else []
        self._gross = _classifier(frame, quantity)

    def expected(self, frame: pd.DataFrame) -> list[Expected]:
        """Predict the accuracy at the points of a frame with the columns of the tests and their bounds."""
        values = features(frame, self.quantity)
        logs = np.array(
            [model.predict(values) for model in self._quantiles] or [[math.nan] * len(frame)] * len(QUANTILES)
        )
        shares = self._gross.predict_proba(values)[:, 1]
        low, middle, high = np.exp(np.sort(logs, axis=0))
        return [
            Expected((float(a), float(b), float(c)), float(p))
            for a, b, c, p in zip(low, middle, high, shares, strict=True)
        ]


def determined(frame: pd.DataFrame, quantity: str) -> pd.DataFrame:
    """Return the rows of the tests that determine a quantity and are not aliased."""
    return frame[(frame[f"bound_{quantity}"] <= MAX_SD) & ~frame.aliased]


def features(frame: pd.DataFrame, quantity: str) -> np.ndarray:
    """Return the features of the model, (n, n_features): the numbers of a test, the bound, and combinations of them."""
    logs = {name: np.log10(frame[name].to_numpy(float)) for name in ("samples", "cycles", "damping_ratio")}
    phase, snr = frame.phase.to_numpy(float), frame.snr_db.to_numpy(float)
    columns = [
        *logs.values(), snr, np.cos(2.0 * phase), np.sin(2.0 * phase), frame.start_known.to_numpy(float),
        np.log10(frame[f"bound_{quantity}"].to_numpy(float)),
        logs["samples"] - logs["cycles"],  # samples per cycle
        logs["damping_ratio"] + logs["cycles"],  # decay over the record
        snr + 10.0 * logs["samples"],  # energy over the variance of the noise
        frame.wrong_basin.to_numpy(float),
    ]  # fmt: skip
    return np.stack(columns, axis=1)


def unknown(frame: pd.DataFrame, quantity: str) -> str:
    """Return the reason why there is no prediction for a point (a frame of one row); empty if there is one."""
    for axis in FreeDecay.AXES:
        value = float(frame[axis.name].iloc[0])
        if not axis.low <= value <= axis.high:
            return f"{axis.name} {value:g} is outside the range of the atlas, {axis.low:g} to {axis.high:g}"
    if frame.aliased.iloc[0]:
        return "the natural frequency is at or above half the sampling rate, so a lower frequency fits equally well"
    bound = float(frame[f"bound_{quantity}"].iloc[0])
    if not bound <= MAX_SD:
        return f"not identifiable: the bound on the standard deviation of its logarithm is {bound:.2g}"
    return ""


def cross_validate(frame: pd.DataFrame, quantity: str) -> CrossValidation:
    """Cross-validate the model in :data:`FOLDS` parts; raises ValueError if there are too few points."""
    frame = determined(frame, quantity).reset_index(drop=True)
    predictions: list[Expected] = [Expected((math.nan,) * 3, math.nan)] * len(frame)
    for fold in range(FOLDS):
        out = np.arange(len(frame)) % FOLDS == fold  # each part of the Sobol sequence also fills the range evenly
        model = AtlasModel(frame[~out], quantity)
        for i, expected in zip(np.flatnonzero(out), model.expected(frame[out]), strict=True):
            predictions[i] = expected
    counted = frame[f"{quantity}_gross"].to_numpy(float)
    known = np.array([not math.isnan(prediction.excess[1]) for prediction in predictions])
    core = np.flatnonzero((counted <= MOST_OUTLIERS) & known)
    logs = np.log(frame[f"{quantity}_core"].to_numpy(float)[core])
    low, middle, high = np.log(np.array([predictions[i].excess for i in core]).reshape(-1, len(QUANTILES))).T
    shares = np.array([prediction.gross for prediction in predictions])
    tenths = np.array_split(np.argsort(shares, kind="stable"), 10)
    gaps = [abs(np.mean(shares[tenth]) - counted[tenth].mean()) for tenth in tenths if tenth.size]
    error = float(np.median(np.abs(logs - middle))) if core.size else math.nan
    within = float(np.mean((low <= logs) & (logs <= high))) if core.size else math.nan
    return CrossValidation(error, within, float(np.mean(gaps)), len(frame))


@cache
def ensembles() -> Any:
    """Return the module ``sklearn.ensemble``, restricted to one thread, which is faster for small trees."""
    single_threaded()
    from sklearn import ensemble  # slow to import

    return ensemble


def _quantile(frame: pd.DataFrame, quantity: str, share: float) -> Any:
    model = ensembles().HistGradientBoostingRegressor(loss="quantile", quantile=share, random_state=0, **BOOSTED)
    return model.fit(features(frame, quantity), np.log(frame[f"{quantity}_core"].to_numpy(float)))


def _classifier(frame: pd.DataFrame, quantity: str) -> Any:
    """Fit the probability of an outlier fit; each point is weighted by its number of fits."""
    values, share = features(frame, quantity), frame[f"{quantity}_gross"].to_numpy(float)
    fits = frame.fits.to_numpy(float)
    weights = np.concatenate([fits * (1.0 - share), fits * share]) / fits.mean() + 1e-3  # both classes must occur
    kinds = np.repeat([0, 1], len(frame))
    model = ensembles().HistGradientBoostingClassifier(random_state=0, **BOOSTED)
    return model.fit(np.concatenate([values, values]), kinds, sample_weight=weights)
