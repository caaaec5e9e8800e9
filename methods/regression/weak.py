"""The weak form of the equation of motion, solved by generalised least squares.

Multiplied by a test function φ that vanishes with its slope at both ends of its support, and integrated by parts,
``m x'' + c x' + k x = f`` becomes ``m ∫φ'' x - c ∫φ' x + k ∫φ x = ∫φ f``, so only φ is differentiated. Each of many
overlapping φ, ``(1 - s²)^6`` with s from -1 to 1 over the support, gives one equation (D. A. Messenger, D. M. Bortz,
Multiscale Modeling and Simulation 19:1474, 2021). The trapezoidal rule over the samples is accurate to high order for
integrands that vanish smoothly at both ends.

The noise of a sample enters several equations, so ordinary least squares is badly biased. The residual at parameters p
is linear in the noise, with covariance ``S(p) = L(p) L(p)ᵀ``, where L has rows ``m φ'' - c φ' + k φ``. Generalised
least squares with S(p) is iterated (WENDy: D. M. Bortz, D. A. Messenger, V. Dukic, Bulletin of Mathematical Biology
85:110, 2023) from the spline estimate, for linear systems only. The ends of a record, where every φ is small, have
little weight.

:func:`weak_rows` is the weak form for a library of terms, ``x'' = Σ ξ_j θ_j(x, v)``: ``∫φ'' x = Σ ξ_j ∫φ θ_j`` (WSINDy,
the same source). The terms x and v are integrated over the samples, ``∫φ v = -∫φ' x``, the others along the smoothed
motion. The support is about one period: long test functions average the oscillation out, short ones keep the noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench import NoEstimate, Status
from methods.regression.derivatives import Motion
from methods.regression.equation import Regression, solve
from methods.regression.smoothing import SplineFits

POWER = 6
"""Power of the test function, whose fifth derivative vanishes at the ends, as the trapezoidal rule requires."""
WIDTH = 0.35
"""Support as a fraction of the record; functions of several widths would be nearly dependent."""
SHARE, MOST_FUNCTIONS = 0.5, 60
"""Number of test functions as a fraction of the samples, and the largest number."""
REWEIGHTED = 4
"""Iterations of generalised least squares."""
RIDGE = 1e-9
"""Regularisation of the covariance relative to its mean variance, for nearly dependent test functions."""

PERIODS = 1.0
"""Support of a test function for a library of terms, in periods of the motion."""
LEAST_SAMPLES = 6
"""Least number of samples in a support, for the quadrature."""


@dataclass(frozen=True, eq=False)
class WeightFunctions:
    """Test functions about ``centres`` (functions,) times the weights of the quadrature.

    ``shapes`` (3, functions, n): their values, negative slopes and curvatures; products with a record's samples replace
    displacement, velocity and acceleration.
    """

    centres: np.ndarray
    shapes: np.ndarray

    @staticmethod
    def of(times: np.ndarray, width: float = WIDTH, share: float = SHARE) -> WeightFunctions:
        """Return test functions of unit integral for samples at increasing times (n,).

        ``width``: support as a fraction of the record; ``share``: their number as a fraction of the samples.
        """
        n, length = times.size, float(times[-1] - times[0])
        gaps = np.diff(times)
        weights = 0.5 * (np.append(gaps, 0.0) + np.append(0.0, gaps))
        count = int(np.clip(int(share * n), 4, MOST_FUNCTIONS))
        centres = times[0] + np.linspace(width / 2, 1.0 - width / 2, count) * length
        rate = 2.0 / (width * length)
        s = (times - centres[:, None]) * rate
        u = np.clip(1.0 - s**2, 0.0, None)
        value = u**POWER
        slope = -2.0 * POWER * rate * s * u ** (POWER - 1)
        curvature = 2.0 * POWER * rate**2 * u ** (POWER - 2) * (2.0 * (POWER - 1) * s**2 - u)
        total = np.sum(value * weights, axis=1, keepdims=True)
        scale = weights / np.where(total > 0, total, 1.0)  # a support may contain no sample
        return WeightFunctions(centres, np.stack([value, -slope, curvature]) * scale)

    def where_sampled(self, least: int) -> WeightFunctions:
        """Keep functions with at least ``least`` samples in the support; raise NoEstimate where none has."""
        kept = np.count_nonzero(self.shapes[0] > 0, axis=1) >= least
        if not np.any(kept):
            raise NoEstimate("no part of the record is sampled densely enough for its integrals", Status.UNSUPPORTED)
        return WeightFunctions(self.centres[kept], self.shapes[:, kept])

    def motion(self, y: np.ndarray, force: np.ndarray) -> Motion:
        """Integrate displacements (n_dof, sets, n) and forces (n_dof, n) against the test functions."""
        x, v, a = (y @ shape.T for shape in self.shapes)
        return Motion(self.centres, x, v, a, np.broadcast_to((force @ self.shapes[0].T)[:, None], x.shape))


def weak_fit(data: Regression, fits: SplineFits) -> np.ndarray:
    """Estimate unknowns (sets, q) by generalised least squares of the weak form of a linear system.

    ``data`` has equally many consecutive sets for each set of ``fits``, which gives the first estimate and the noise
    of each channel.
    """
    if not data.system.linear:
        raise NoEstimate("its weak form supports linear systems only; use derivative=spline", Status.UNSUPPORTED)
    functions = [WeightFunctions.of(times) for times in data.times]
    forces = [np.array(r.force(t, data.system.n_dof)) for r, t in zip(data.records, data.times, strict=True)]
    motions = [f.motion(y, force) for f, y, force in zip(functions, data.values, forces, strict=True)]
    columns, target = data.equations(motions)
    both = np.concatenate([columns, target[..., None]], axis=2)
    parts = np.split(both, np.cumsum([f.centres.size * data.system.n_dof for f in functions])[:-1], axis=1)
    of_fit = np.repeat(np.arange(len(fits.unknowns)), data.sets // len(fits.unknowns))
    unknowns, noise = fits.unknowns[of_fit], np.stack([sd.T[of_fit] for sd in fits.noise])
    for _ in range(REWEIGHTED):
        scaled = _matrices(data, unknowns) * noise[:, None, :, None]
        whitened = [
            np.linalg.solve(_root(_covariance(m, f.shapes)), part)
            for m, f, part in zip(scaled, functions, parts, strict=True)
        ]
        rows = np.concatenate(whitened, axis=1)
        unknowns = solve(rows[..., :-1], rows[..., -1])
    return unknowns


def _matrices(regression: Regression, unknowns: np.ndarray) -> np.ndarray:
    """Return stiffness, damping and mass matrices at unknowns (sets, q), (records, 3, sets, n, n)."""
    n, records = regression.system.n_dof, len(regression.records)
    units = np.eye(3 * n)[:, None]
    unit = Motion(np.zeros(3 * n), units[:n], units[n : 2 * n], units[2 * n :], np.zeros((n, 1, 3 * n)))
    columns, target = regression.equations([unit] * records)
    residual = unknowns[:, : len(regression.names)] @ columns[0, :, : len(regression.names)].T - target[0]
    return np.asarray(residual.reshape(-1, records, 3, n, n).transpose(1, 2, 0, 4, 3))


def _covariance(scaled: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """Return the covariance (sets, rows, rows) of the residuals, ordered by function and DOF.

    ``scaled``: matrices (3, sets, n, n), their columns times the noise of each DOF; ``shapes`` (3, functions, n).
    """
    gram = np.einsum("afn,bgn->abfg", shapes, shapes)
    both = np.einsum("asij,bskj->sabik", scaled, scaled)
    covariance = np.einsum("abfg,sabik->sfigk", gram, both, optimize=True)
    rows = shapes.shape[1] * scaled.shape[2]
    return np.asarray(covariance.reshape(-1, rows, rows))


def _root(covariance: np.ndarray) -> np.ndarray:
    """Return Cholesky factors (sets, rows, rows); that of the identity where a set is not finite."""
    size = np.trace(covariance, axis1=1, axis2=2)[:, None, None] / covariance.shape[1]
    eye = np.eye(covariance.shape[1])
    with np.errstate(all="ignore"):
        scaled = covariance / size
    scaled = np.where(np.all(np.isfinite(scaled), axis=(1, 2), keepdims=True), scaled, eye)
    return np.asarray(np.linalg.cholesky(scaled + RIDGE * eye))


def weak_rows(
    motion: Motion, samples: np.ndarray, features: np.ndarray, linear: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Integrate a record against test functions.

    Args:
        motion: The smoothed motion at the times of the samples.
        samples: Measured displacements, (n_dof, sets, n).
        features: Library terms along the motion, (sets, n, terms).
        linear: Columns of the terms that are displacements, then velocities, of each degree of freedom, (2 n_dof,).

    Returns:
        Features (sets, functions, terms) and target (n_dof, sets, functions).
    """
    times = motion.times
    # the angular frequency is the ratio of the root mean squares of acceleration and velocity
    period = 2.0 * np.pi * np.sqrt(np.mean(motion.v**2) / np.mean(motion.a**2))
    width = float(np.clip(PERIODS * period / (times[-1] - times[0]), LEAST_SAMPLES / times.size, WIDTH))
    shapes = WeightFunctions.of(times, width, share=1.0).where_sampled(LEAST_SAMPLES // 2).shapes
    weak = np.einsum("fn,snk->sfk", shapes[0], features)
    weak[..., linear] = np.moveaxis(np.concatenate([samples @ shape.T for shape in shapes[:2]]), 0, -1)
    return weak, samples @ shapes[2].T
