"""Recursive least squares: the finite-difference regression of LS, updated sample by sample.

The update is the standard one with exponential forgetting (Ljung, System Identification: Theory for the User, 2nd ed.
1999, section 11.2): with row ``φ``, target ``y`` and forgetting factor ``λ``,
``K = P φ / (λ + φᵀ P φ)``, ``θ <- θ + K (y - φᵀ θ)``, ``P <- (P - K φᵀ P) / λ``.
A sample of several degrees of freedom has several rows, with forgetting applied once. The recursion propagates a square
root S of ``P = S Sᵀ`` (Potter's form: G. J. Bierman, Factorization Methods for Discrete Sequential Estimation, 1977,
chapter II), with ``f = Sᵀ φ`` and ``β = λ + fᵀ f``: ``K = S f / β``, ``S <- (S - K fᵀ / (1 + √(λ/β))) / √λ``. P itself
would lose half of its digits from the diffuse initial value on.

The initial values are ``θ = 0`` and ``P`` equal to ``diffuse`` times the identity in natural units (displacement of
order one). Since the parameters are constant, forgetting costs accuracy; ``forgetting=1`` is batch LS.

A known initial state is used for the bootstrap's noise level only; prior, bias and warnings are as for LS. The
uncertainty is the spread of a parametric bootstrap. The trace ``trajectory`` contains the estimate after each sample
(n_samples, n_identified), ``trajectory_times`` its times (s).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import Card, Dimension, Estimate, InputError, Scope
from methods.regression.equation import Regression
from methods.regression.hausman import bias_warnings
from methods.regression.identifier import RegressionIdentifier, answer, bootstrap_covariances
from methods.regression.smoothing import TRIED, spline_fits


def recursive_least_squares(
    columns: np.ndarray, target: np.ndarray, forgetting: float, diffuse: float, rows_per_sample: int = 1
) -> np.ndarray:
    """Return estimates after each sample, (n_samples, sets, q), of columns (sets, rows, q), target (sets, rows)."""
    sets, rows, q = columns.shape
    theta, root = np.zeros((sets, q)), np.broadcast_to(np.sqrt(diffuse) * np.eye(q), (sets, q, q))
    path = np.empty((rows // rows_per_sample, sets, q))
    with np.errstate(all="ignore"):
        for i in range(rows):
            phi, rate = columns[:, i], forgetting if i % rows_per_sample == 0 else 1.0
            projected = np.sum(root * phi[..., None], axis=1)
            size = rate + np.sum(projected**2, axis=-1, keepdims=True)
            gain = np.sum(root * projected[:, None], axis=-1) / size
            theta = theta + gain * (target[:, i] - np.sum(phi * theta, axis=-1))[:, None]
            scaled_gain = gain / (1.0 + np.sqrt(rate / size))
            root = (root - scaled_gain[..., None] * projected[:, None]) / np.sqrt(rate)
            path[i // rows_per_sample] = theta
    return path


def check_recursion(forgetting: float, diffuse: float) -> None:
    """Raise InputError for invalid settings of the recursion."""
    if not 0 < forgetting <= 1:
        raise InputError("method.forgetting", forgetting, "a number above 0, at most 1")
    if not (diffuse > 0 and np.isfinite(diffuse)):
        raise InputError("method.diffuse", diffuse, "a positive number, large against 1")


def trajectory_dimensions(regression: Regression) -> dict[str, list[Dimension]]:
    """Return the dimensions of the traces ``trajectory`` and ``trajectory_times``."""
    system = regression.system
    dimensions = [system.dimension(system.quantity(name)) for name in regression.names]
    return {"trajectory": dimensions, "trajectory_times": [Dimension(time=1.0)]}


@dataclass(frozen=True)
class RLS(RegressionIdentifier):
    """Recursive least squares with ``forgetting`` factor (0 to 1) and initial covariance ``diffuse``."""

    forgetting: float = 0.98
    diffuse: float = 1e6
    bootstrap: int = 100

    version: ClassVar[int] = 2
    """2: smoothing splines are accurate at irregular times."""
    card: ClassVar[Card] = Card(
        summary="recursive least squares over finite differences, sample by sample, with a forgetting factor",
        start="used when known",
        scale="groups",
        reconstruction="simulated",
        uncertainty="covariance of a parametric bootstrap: spread only; Hausman's test warns of bias",
        settings_source="forgetting: Ljung, System Identification Toolbox user's guide (typically 0.97 to 0.995)",
        tuning="none",
        title="RLS",
        order=140,
        paper="rls",
    )
    scope: ClassVar[Scope] = Scope(
        several_records=True, several_channels=True, offsets=True, max_dof=None, added_mass=True
    )

    @property
    def records_held(self) -> int:
        return max(TRIED, self.bootstrap)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_recursion(self.forgetting, self.diffuse)

    def fit(self, regression: Regression, rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Run the recursion for all problems and for their synthetic records."""
        splines, path = spline_fits(regression), self._path(regression)
        covariances = bootstrap_covariances(
            regression, splines.centres, splines.noise, lambda data: self._path(data)[-1], rngs, self.bootstrap
        )
        times, dimensions = np.concatenate([t[1:-1] for t in regression.times]), trajectory_dimensions(regression)
        answers = []
        for i, warning in enumerate(bias_warnings(regression, path[-1], covariances, splines)):
            traces = {"trajectory": path[:, i, : len(regression.names)], "trajectory_times": times}
            answers.append(answer(regression, path[-1, i], covariances[i], *warning, traces, dimensions))
        return answers

    def _path(self, regression: Regression) -> np.ndarray:
        """Return the estimates after each sample, (n_samples, sets, q); NaN with fewer equations than unknowns."""
        columns, target = regression.finite()
        if columns.shape[1] < columns.shape[2]:
            columns = columns * np.nan  # the result would be the diffuse initial value
        return recursive_least_squares(columns, target, self.forgetting, self.diffuse, regression.system.n_dof)
