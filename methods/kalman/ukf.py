"""Unscented Kalman filter for state and parameters together, iterated: each map is replaced by its regression.

The belief N(m, P) is replaced by points at ``m ± sqrt(d + kappa)`` times each column of a square root of P, and at m
(S. J. Julier, J. K. Uhlmann, Proc. SPIE 3068:182, 1997), where d is the size of the joint state. The straight line
through what the map makes of them is the affine map of least mean square error, and what it leaves is that map's error
covariance (statistical linear regression; T. Lefebvre et al., IEEE Trans. Automatic Control 47:1406, 2002): mean and
covariance of the filter are then those of the unscented transform. The root is that of the eigenvectors; directions in
which the belief is certain (a known start) get a small spread, which makes the line a tangent there.

``kappa`` = 0 weighs all points alike and the centre not at all, as in the cubature filter (I. Arasaratnam, S. Haykin,
IEEE Trans. Automatic Control 54:1254, 2009); the other usual choice, 3 - d, weighs the centre negatively from four
unknowns on, and covariances then need not stay positive.

What is common to it and the extended filter (joint state, starts, iteration, noise) is in
:mod:`methods.kalman.iteration`; the first pass, about the trajectory of a start, is the extended filter's. For
structural identification: S. Mariani, A. Ghisi, Nonlinear Dynamics 49:131, 2007.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from bench import EVERY_PROBLEM, Card, Estimate, InputError, Problem, Serves
from methods.kalman.filtering import Affine, Map
from methods.kalman.iteration import Settings, estimate
from methods.starts.ambiguity import SearchingIdentifier

CERTAIN = 1e-5
"""Least standard deviation of a direction, in natural units and in log-parameters."""


@dataclass(frozen=True)
class UKF(SearchingIdentifier):
    """At most ``passes`` over the record, until no parameter moves by ``tolerance`` of its standard deviation.

    ``kappa`` >= 0: weight of the central point against those about it. ``drift``: standard deviation of the random walk
    of a log-parameter over the record (its process noise). ``open_sd``: that of a log-parameter at first, where no
    prior is given.
    """

    passes: int = 30
    tolerance: float = 1e-3
    drift: float = 0.0
    open_sd: float = 1.0
    kappa: float = 0.0

    card: ClassVar[Card] = Card(
        summary="unscented Kalman filter and smoother for state and log-parameters, iterated from starts of a scan",
        start="used when known",
        scale="native",
        reconstruction="own",
        uncertainty="covariance of the last smoothing pass, Student t with N - p degrees of freedom",
        settings_source="kappa of the cubature filter; starts and screening of multiple shooting; no process noise, "
        "since parameters are constants; passes until they settle",
        tuning="width of the belief without a prior: 3; relaxation of the passes; when aliases are followed: 2; on "
        "development systems at 200 to 0 dB, damping ratio 0.6-135 %, 1-13 cycles, 5-45 samples",
        title="Unscented Kalman filter",
        order=180,
        colour="#661100",
        marker=(6, 1, 0.0),
    )
    serves: ClassVar[Serves] = EVERY_PROBLEM
    works_in = "natural units"

    def __post_init__(self) -> None:
        if not (np.isfinite(self.kappa) and self.kappa >= 0):
            raise InputError("method.kappa", self.kappa, "0 or more: a negative weight breaks the covariance")
        self._settings()

    def _settings(self) -> Settings:
        return Settings(self.passes, self.tolerance, self.drift, self.open_sd)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate all parameters, or the groups where nothing tells the scale. Uses no randomness."""
        return estimate(problem, partial(regression, kappa=self.kappa), self._settings())


def regression(function: Map, means: np.ndarray, covariances: np.ndarray, kappa: float = 0.0) -> Affine:
    """The line through the map's values at the sigma points, and the covariance of what it leaves.

    The points lie symmetrically, so the odd part of the values is the line's exactly; the even part is its error.
    """
    d = means.shape[1]
    if not np.all(np.isfinite(covariances)):
        covariances = np.where(np.isfinite(covariances), covariances, 0.0)
    values, axes = np.linalg.eigh(covariances)
    sizes = np.sqrt(np.maximum(values, CERTAIN**2) * (d + kappa))
    moves = (axes * sizes[:, None]).swapaxes(1, 2)
    points = np.concatenate([means[:, None], means[:, None] + moves, means[:, None] - moves], axis=1)
    found = function(points)
    centre, plus, minus = found[:, 0], found[:, 1 : d + 1], found[:, d + 1 :]
    weight = 0.5 / (d + kappa)
    mean = kappa / (d + kappa) * centre + weight * np.sum(plus + minus, axis=1)
    slopes = (0.5 * (plus - minus) / sizes[..., None]).swapaxes(1, 2) @ axes.swapaxes(1, 2)
    bent = 0.5 * (plus + minus) - mean[:, None]
    middle = centre - mean
    error = 2 * weight * bent.swapaxes(1, 2) @ bent + kappa / (d + kappa) * middle[..., None] * middle[:, None]
    return slopes, mean - (slopes @ means[..., None])[..., 0], error
