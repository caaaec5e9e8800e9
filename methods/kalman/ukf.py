"""Unscented Kalman filter for state and parameters together, iterated: each map is replaced by its regression.

The distribution is replaced by symmetric points, and a map by the straight line through its values there
(:func:`methods.kalman.core.regression`). Directions in which the distribution is certain (a known start) get a small
spread, which makes the line a tangent there. ``kappa`` = 0 weighs all points alike and the centre not at all, as in the
cubature filter (I. Arasaratnam, S. Haykin, IEEE Trans. Automatic Control 54:1254, 2009); the other usual choice, 3 - d,
weighs the centre negatively from four unknowns on, and covariances then need not stay positive.

What is common to it and the extended filter (joint state, starts, iteration, noise) is in
:mod:`methods.kalman.iteration`; the first pass, about the trajectory of a start, is the extended filter's. For
structural identification: S. Mariani, A. Ghisi, Nonlinear Dynamics 49:131, 2007.
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
    """The iterated smoother of regressions on sigma points.

    ``kappa`` >= 0: weight of the central point against those about it.
    """

    kappa: float = 0.0

    version: ClassVar[int] = 3
    """3: of several ends the most probable is kept, as at 0 dB, where innovations prefer a motion that dies at once."""
    card: ClassVar[Card] = Card(
        summary="unscented Kalman filter and smoother for state and log-parameters, iterated from starts of a scan",
        start="used when known",
        scale="native",
        reconstruction="own",
        uncertainty="covariance of the last smoothing pass, Student t with N - p degrees of freedom",
        settings_source="kappa of the cubature filter; starts and screening of multiple shooting; no process noise, "
        "since parameters are constants; passes until they settle",
        tuning="width of the distribution without a prior: 3; relaxation of the passes; on development systems "
        "at 200 to 0 dB, damping ratio 0.6-135 %, 1-13 cycles, 5-45 samples",
        title="Unscented Kalman filter",
        order=180,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (np.isfinite(self.kappa) and self.kappa >= 0):
            raise InputError("method.kappa", self.kappa, "0 or more: a negative weight breaks the covariance")

    @property
    def rule(self) -> Rule:
        """Regressions on the sigma points."""
        return partial(regression, kappa=self.kappa)
