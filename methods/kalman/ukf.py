"""Iterated unscented Kalman smoother for state and parameters.

Each map is replaced by its regression on symmetric sigma points (:func:`methods.kalman.core.regression`). Directions of
zero variance (a known initial state) get a small spread, which makes the regression a tangent there. ``kappa`` = 0
gives equal weights to all points but the centre, which has none, as in the cubature filter (I. Arasaratnam, S. Haykin,
IEEE Trans. Automatic Control 54:1254, 2009). The other usual choice, 3 - d, has a negative central weight from four
unknowns on, and covariances may then become indefinite.

The parts common to it and the extended filter (joint state, initial guesses, iteration, noise) are in
:mod:`methods.kalman.iteration`; the first pass is that of the extended filter. For structural identification: S.
Mariani, A. Ghisi, Nonlinear Dynamics 49:131, 2007.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from bench import Card, InputError
from methods.kalman.core import Rule, regression
from methods.kalman.iteration import IteratedSmoother


@dataclass(frozen=True)
class UKF(IteratedSmoother):
    """Iterated unscented Kalman smoother; ``kappa`` >= 0: relative weight of the central sigma point."""

    kappa: float = 0.0

    version: ClassVar[int] = 3
    """3: among several ends the most probable is kept, not the one with the most likely innovations."""
    card: ClassVar[Card] = Card(
        summary="unscented Kalman filter and smoother for state and log-parameters, iterated from guesses of a scan",
        start="used when known",
        scale="native",
        reconstruction="own",
        uncertainty="covariance of the last smoothing pass, Student t with N - p degrees of freedom",
        settings_source="kappa of the cubature filter; guesses and screening of multiple shooting; no process noise, "
        "since parameters are constants; passes until they settle",
        tuning="initial standard deviation without a prior: 3; relaxation of the passes; on development systems "
        "at 200 to 0 dB, damping ratio 0.6-135 %, 1-13 cycles, 5-45 samples",
        title="Unscented Kalman filter",
        order=180,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (np.isfinite(self.kappa) and self.kappa >= 0):
            raise InputError("method.kappa", self.kappa, "0 or more: a negative weight makes covariances indefinite")

    @property
    def rule(self) -> Rule:
        """Return the linearisation by regression on sigma points."""
        return partial(regression, kappa=self.kappa)
