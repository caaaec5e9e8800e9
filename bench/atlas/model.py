"""A model of the sampled atlas of free decays: what a method is expected to do at any point, learned from the computed.

Gradient-boosted trees (scikit-learn) on the numbers of a test and what follows from them: the logarithm of the core
error over the bound, by three quantiles, and the probability of a gross error. Where the model does not know, it says
why (:func:`unknown`). How well it does on points that it has not seen, :func:`held_out` says.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pandas as pd

from bench.atlas.point import FreeDecay
from bench.errors import InputError
from bench.isolation.machine import single_threaded

QUANTILES = (0.1, 0.5, 0.9)
FOLDS = 8
"""Of the points, each left out in turn."""
TOLD = 0.2
"""Standard deviation of a logarithm, by the bound, above which a test is said not to tell a quantity."""
FEWEST = 60
"""Points of a method, fewer than which are no ground for a model."""
FEW_CORE = 0.5
"""Share of gross errors, above which the errors that are left say nothing of the method."""
BOOSTED = {"max_iter": 60, "learning_rate": 0.06, "max_leaf_nodes": 8, "min_samples_leaf": 40}
"""Large leaves: quantiles of few points are too narrow."""


@dataclass(frozen=True)
class Expected:
    """What a method is expected to do: core error over the bound (low, middle, high), and share of gross errors."""

    excess: tuple[float, float, float]
    gross: float


@dataclass(frozen=True)
class HeldOut:
    """How a model does on points that it has not seen.

    ``error``: median size of the error of the log excess; ``within``: share of points inside its 10 to 90 % range; both
    NaN where a method errs grossly at nearly all points. ``calibration``: mean distance of predicted and counted shares
    of gross errors, in tenths of the points by prediction; ``points``: how many.
    """

    error: float
    within: float
    calibration: float
    points: int


class AtlasModel:
    """The model of one method and quantity."""

    def __init__(self, frame: pd.DataFrame, quantity: str) -> None:
        """Fit to the lines of a method; raises ValueError where there are too few points that tell the quantity."""
        frame = told(frame, quantity)
        if len(frame) < FEWEST:
            raise ValueError(f"{len(frame)} points are too few for a model")
        self.quantity = quantity
        core = frame[frame[f"{quantity}_gross"] <= FEW_CORE]
        known = len(core) >= FEWEST
        self._quantiles = [_quantile(core, quantity, share) for share in QUANTILES] if known else []
        self._gross = _classifier(frame, quantity)

    def expected(self, frame: pd.DataFrame) -> list[Expected]:
        """What is expected at the points of a frame, which has the columns of the test and the bounds."""
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


def told(frame: pd.DataFrame, quantity: str) -> pd.DataFrame:
    """The lines of tests that tell a quantity, and are not ambiguous."""
    return frame[(frame[f"bound_{quantity}"] <= TOLD) & ~frame.aliased]


def features(frame: pd.DataFrame, quantity: str) -> np.ndarray:
    """What the model sees of a test: its numbers, the bound, and what follows from them."""
    logs = {name: np.log10(frame[name].to_numpy(float)) for name in ("samples", "cycles", "damping_ratio")}
    phase, snr = frame.phase.to_numpy(float), frame.snr_db.to_numpy(float)
    columns = [
        *logs.values(), snr, np.cos(2.0 * phase), np.sin(2.0 * phase), frame.start_known.to_numpy(float),
        np.log10(frame[f"bound_{quantity}"].to_numpy(float)),
        logs["samples"] - logs["cycles"],  # samples a cycle
        logs["damping_ratio"] + logs["cycles"],  # by how much the motion decays
        snr + 10.0 * logs["samples"],  # energy over the noise's variance
        frame.wrong_basin.to_numpy(float),
    ]  # fmt: skip
    return np.stack(columns, axis=1)


def unknown(frame: pd.DataFrame, quantity: str) -> str:
    """Why nothing is said of a point (a frame of one line); empty where something is."""
    for axis in FreeDecay.AXES:
        value = float(frame[axis.name].iloc[0])
        if not axis.low <= value <= axis.high:
            return f"{axis.name} {value:g} is outside the atlas, {axis.low:g} to {axis.high:g}"
    if frame.aliased.iloc[0]:
        return "the natural frequency is at or above half the sampling rate: a slower motion fits as well"
    bound = float(frame[f"bound_{quantity}"].iloc[0])
    if not bound <= TOLD:
        return f"the bound on the standard deviation of its logarithm is {bound:.2g}: the test does not tell it"
    return ""


def held_out(frame: pd.DataFrame, quantity: str) -> HeldOut:
    """Leave every point out once, in :data:`FOLDS` parts; raises ValueError where there are too few points."""
    frame = told(frame, quantity).reset_index(drop=True)
    found: list[Expected] = [Expected((math.nan,) * 3, math.nan)] * len(frame)
    for fold in range(FOLDS):
        out = np.arange(len(frame)) % FOLDS == fold  # the sequence is spread evenly, and so is each part
        model = AtlasModel(frame[~out], quantity)
        for i, expected in zip(np.flatnonzero(out), model.expected(frame[out]), strict=True):
            found[i] = expected
    counted = frame[f"{quantity}_gross"].to_numpy(float)
    known = np.array([not math.isnan(one.excess[1]) for one in found])
    core = np.flatnonzero((counted <= FEW_CORE) & known)
    logs = np.log(frame[f"{quantity}_core"].to_numpy(float)[core])
    low, middle, high = np.log(np.array([found[i].excess for i in core]).reshape(-1, len(QUANTILES))).T
    order = np.array_split(np.argsort([one.gross for one in found], kind="stable"), 10)
    gaps = [abs(np.mean([found[i].gross for i in part]) - counted[part].mean()) for part in order if part.size]
    error = float(np.median(np.abs(logs - middle))) if core.size else math.nan
    within = float(np.mean((low <= logs) & (logs <= high))) if core.size else math.nan
    return HeldOut(error, within, float(np.mean(gaps)), len(frame))


@cache
def ensembles() -> Any:
    """scikit-learn's ensembles, on one thread: on many, small trees wait for each other. Raises InputError without."""
    single_threaded()
    try:
        from sklearn import ensemble  # slow to import
    except ModuleNotFoundError as error:
        raise InputError("package", error.name, "installed: pip install 'vibration-bench[atlas]'") from None
    return ensemble


def _quantile(frame: pd.DataFrame, quantity: str, share: float) -> Any:
    model = ensembles().HistGradientBoostingRegressor(loss="quantile", quantile=share, random_state=0, **BOOSTED)
    return model.fit(features(frame, quantity), np.log(frame[f"{quantity}_core"].to_numpy(float)))


def _classifier(frame: pd.DataFrame, quantity: str) -> Any:
    """The probability of a gross error: each point counts by its fits."""
    values, share = features(frame, quantity), frame[f"{quantity}_gross"].to_numpy(float)
    fits = frame.fits.to_numpy(float)
    weights = np.concatenate([fits * (1.0 - share), fits * share]) / fits.mean() + 1e-3  # both kinds are always there
    kinds = np.repeat([0, 1], len(frame))
    model = ensembles().HistGradientBoostingClassifier(random_state=0, **BOOSTED)
    return model.fit(np.concatenate([values, values]), kinds, sample_weight=weights)
