"""Velocity and acceleration from irregularly sampled displacements: finite differences and smoothing splines.

Arrays hold many data sets at once: displacements of a record have shape (n_dof, sets, n), time last.
"""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import solve_triangular

from bench import NoEstimate, Status

WEIGHTS = 40
"""Smoothing weights on the grid of a spline."""


class Motion(NamedTuple):
    """Displacement, velocity and acceleration, each (n_dof, sets, rows), at times (rows,).

    ``force``, of the same shape, is the known force smoothed like the motion; None means the unsmoothed force.
    """

    times: np.ndarray
    x: np.ndarray
    v: np.ndarray
    a: np.ndarray
    force: np.ndarray | None = None


def finite_differences(times: np.ndarray, samples: np.ndarray) -> Motion:
    """Differentiate by central differences over three samples at uneven times; results are at the interior samples.

    With steps ``h1`` before and ``h2`` after a sample, the parabola through the three gives
    ``x' = -h2/(h1 (h1+h2)) x₋ + (h2-h1)/(h1 h2) x₀ + h1/(h2 (h1+h2)) x₊`` and
    ``x'' = 2/(h1 (h1+h2)) x₋ - 2/(h1 h2) x₀ + 2/(h2 (h1+h2)) x₊``
    (three-point weights of Fornberg, Mathematics of Computation 51 (1988) 699-706; on even times the usual
    ``(x₊ - x₋)/2h`` and ``(x₊ - 2 x₀ + x₋)/h²``). ``times`` (n,) and ``samples`` (..., n); raises NoEstimate for n < 3.
    """
    if times.size < 3:
        raise NoEstimate("finite differences require at least 3 samples per record", Status.UNSUPPORTED)
    before, here, after = samples[..., :-2], samples[..., 1:-1], samples[..., 2:]
    h1, h2 = np.diff(times)[:-1], np.diff(times)[1:]
    both = h1 + h2
    velocity = -h2 / (h1 * both) * before + (h2 - h1) / (h1 * h2) * here + h1 / (h2 * both) * after
    acceleration = 2.0 / (h1 * both) * before - 2.0 / (h1 * h2) * here + 2.0 / (h2 * both) * after
    return Motion(times[1:-1], here, velocity, acceleration)


class SmoothingSpline:
    """Smoothing splines of degree ``2 order - 1`` through samples at fixed, irregular times.

    Such a spline minimises ``sum (y - x(t))² + w ∫ (d^order x / dt^order)² dt`` with time in mean sampling steps, so
    that a weight ``w`` does not depend on rate or units: it damps frequencies (radians per step) above
    ``w^(-1/(2 order))`` (Wahba, Spline Models for Observational Data, 1990, chapter 1). In the basis that diagonalises
    both fit and penalty (Demmler and Reinsch, Numerische Mathematik 24 (1975) 375-382) each weight costs n
    multiplications.

    The basis is computed from the factors of fit and penalty, ``[B; √b R] = Q T`` and the singular values of the lower
    part of Q (the CS decomposition: Golub and Van Loan, Matrix Computations, 4th ed. 2013, section 2.5.4), not from
    their products, in which the penalty of smooth components, some 1e-16 of the largest, would be lost.

    Knots lie at the samples, thinned to at most ``MAX_KNOTS``. As many basis functions are kept as there are samples,
    the smoothest ones. Raises NoEstimate for n < order + 1.
    """

    MAX_KNOTS = 300
    LEAST_DIAGONAL = 1e-13
    """Smallest ratio of the diagonal elements of T; below it some sample times are too close to each other."""

    def __init__(self, times: np.ndarray, order: int) -> None:
        self.times, self.order, self.n = times, order, times.size
        if self.n < order + 1:
            raise NoEstimate(
                f"its smoothing spline requires at least {order + 1} samples per record", Status.UNSUPPORTED
            )
        self.step = float(times[-1] - times[0]) / (self.n - 1)
        scaled = (times - times[0]) / self.step
        knots = scaled[np.unique(np.linspace(0, self.n - 1, min(self.n, self.MAX_KNOTS)).round().astype(int))]
        degree = 2 * order - 1
        self._knots = np.concatenate([np.full(degree, knots[0]), knots, np.full(degree, knots[-1])])
        basis, rough = self._basis(scaled), self._penalty_root(knots)
        blend = float(np.sum(basis**2) / np.sum(rough**2))
        q, triangle = np.linalg.qr(np.concatenate([basis, np.sqrt(blend) * rough]))
        diagonal = np.abs(np.diagonal(triangle))
        if np.min(diagonal) < self.LEAST_DIAGONAL * np.max(diagonal):
            sentence = "its smoothing spline is not determined: some sample times are too close; remove samples there"
            raise NoEstimate(sentence)
        sines, axes = np.linalg.svd(q[self.n :], full_matrices=False)[1:]
        kept = slice(None, -min(self.n, sines.size) - 1, -1)  # the smoothest first
        axes = axes[kept].T
        self._project = (q[: self.n] @ axes).T
        self._vectors = solve_triangular(triangle, axes)
        self._fit = np.sum(self._project**2, axis=1)
        self._rough = sines[kept] ** 2 / blend
        self._rough[:order] = 0.0  # polynomials below the order are not penalised

    def _basis(self, points: np.ndarray, derivative: int = 0) -> np.ndarray:
        count = self._knots.size - 2 * self.order
        return np.asarray(BSpline(self._knots, np.eye(count), 2 * self.order - 1)(points, nu=derivative))

    def _penalty_root(self, knots: np.ndarray) -> np.ndarray:
        """Return a square root of the penalty, exact by Gauss-Legendre quadrature in each interval."""
        nodes, weights = np.polynomial.legendre.leggauss(self.order)
        half = np.diff(knots) / 2
        points = (knots[:-1] + half)[:, None] + half[:, None] * nodes
        return self._basis(points.ravel(), self.order) * np.sqrt((half[:, None] * weights).ravel())[:, None]

    @cached_property
    def weights(self) -> np.ndarray:
        """Return a grid of weights, (WEIGHTS,), from a polynomial (largest) to interpolation (smallest)."""
        corner = np.geomspace(1.0 / self.n, 30.0, WEIGHTS)
        return np.asarray(corner ** (-2.0 * self.order))

    def fit(self, samples: np.ndarray, weights: np.ndarray | float) -> np.ndarray:
        """Return spline coefficients (..., n_coefficients) of samples (..., n) at weights that broadcast with (...)."""
        size = self._fit + np.asarray(weights)[..., None] * self._rough
        return np.asarray((samples @ self._project.T / size) @ self._vectors.T)

    def likely_weights(self, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the most likely weight of the grid and the noise's standard deviation for samples (..., n).

        It is the mode of the restricted likelihood (REML) of the model: samples = polynomial + integrated white noise +
        measurement noise, with both noise levels unknown (Wahba, Annals of Statistics 13 (1985) 1378-1402, called GML
        there). Without a model of the system, it treats a vibration of fewer than about six samples per cycle as noise.
        """
        parts = samples @ (self._project / np.sqrt(self._fit)[:, None]).T
        rough = parts[..., self.order :] ** 2
        outside = np.clip(np.sum(samples**2, -1) - np.sum(parts**2, -1), 0.0, None)
        shrunk = np.maximum(self.weights[:, None] * (self._rough / self._fit)[self.order :], 1e-300)
        kept = 1.0 / (1.0 + shrunk)
        # the quadratic form of the likelihood, (..., weights); a floor keeps exact data finite
        form = rough @ (1.0 - kept).T + outside[..., None]
        size = np.maximum(np.sum(rough, -1) + outside, 1e-300)
        dof = self.n - self.order
        log_det = np.sum(np.log1p(1.0 / shrunk), axis=-1)
        best = np.argmin(dof * np.log(np.maximum(form, 1e-28 * size[..., None])) + log_det, axis=-1)
        # residual power over the residual degrees of freedom (Wahba 1990, section 4.7)
        residual = 1.0 - kept[best]
        freedom = np.maximum(self.n - self.order - np.sum(kept[best], axis=-1), 1.0)
        return self.weights[best], np.sqrt((np.sum(rough * residual**2, axis=-1) + outside) / freedom)

    def motion(self, coefficients: np.ndarray, times: np.ndarray) -> Motion:
        """Evaluate splines, their velocities and accelerations at times (rows,), each (..., rows)."""
        scaled = (times - self.times[0]) / self.step
        x, v, a = (coefficients @ self._basis(scaled, i).T / self.step**i for i in range(3))
        return Motion(times, x, v, a)


@lru_cache(maxsize=64)
def _spline_at(times: bytes, order: int) -> SmoothingSpline:
    return SmoothingSpline(np.frombuffer(times), order)


def smoothing_spline(times: np.ndarray, order: int) -> SmoothingSpline:
    """Return the smoother for times (n,), cached since replicates share their times."""
    return _spline_at(np.ascontiguousarray(times, float).tobytes(), order)
