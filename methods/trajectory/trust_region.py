"""The trust-region search of SciPy's ``least_squares`` for many problems of one layout at once.

It takes the steps of the method ``trf`` without bounds, with scales from the Jacobian and its default tolerances, one
case beside the other: so it ends in the minimum in which SciPy's ends from the same start. The radius and Gauss-Newton
step are those of J. J. Moré (Lecture Notes in Mathematics 630:105, 1978). Derivatives are exact.
"""

from __future__ import annotations

import numpy as np

from bench import Batch, Point

TOLERANCE = 1e-8
"""Relative, of cost and step, and absolute, of the gradient, at which a search ends: SciPy's default."""
ROOT_TOLERANCE, ROOT_STEPS = 0.01, 10
"""When the step is as long as the radius, and how often it is tried."""
FARTHEST = 300.0
"""The largest log-parameter: beyond, products of parameters overflow."""
EPS = float(np.finfo(float).eps)


class TrustRegion:
    """The searches of a batch, a case a problem; :meth:`begin` each at a noise, and :meth:`step` until ``done``.

    ``stopped``: that the ``most`` evaluations of a search were used up. ``lost``: that residuals or derivatives were
    not finite at its beginning. ``evaluations`` and ``iterations`` are those of all searches of a case.
    """

    def __init__(self, batch: Batch, start: Point, most: int) -> None:
        self.batch, self.most = batch, most
        self.theta, self.predicted, self.slopes = start.theta.copy(), start.predicted.copy(), start.slopes.copy()
        n, size = start.theta.shape
        self.evaluations, self.iterations, self.tried = np.zeros(n, int), np.zeros(n, int), np.zeros(n, int)
        self.stopped, self.lost, self.done = np.zeros(n, bool), np.zeros(n, bool), np.ones(n, bool)
        self.sigma = np.ones((n, batch.first.counts.size))
        # cost, damping and radius of the trust region, gradient, scales of the unknowns
        self.cost, self.damping, self.radius = np.zeros(n), np.zeros(n), np.ones(n)
        self.gradient, self.sizes = np.zeros((n, size)), np.ones((n, size))
        # the singular value decomposition of the scaled Jacobian, and the residuals along its axes
        self.rows = batch.rows(np.zeros(1, int), start.at(np.zeros(1, int)), self.sigma[:1])[0].shape[1]
        count = min(self.rows, size)
        self.along, self.values, self.axes = np.zeros((n, count)), np.zeros((n, count)), np.zeros((n, size, count))

    def begin(self, at: np.ndarray, sigma: np.ndarray) -> None:
        """Search on from where some cases are, at another noise (cases, channels)."""
        self.sigma[at], self.damping[at], self.tried[at] = sigma, 0.0, 1
        self.done[at] = self.stopped[at] = False
        self.evaluations[at] += 1
        self.iterations[at] += 1
        residuals, rows = self._rows(at, Point(self.theta, self.predicted, self.slopes).at(at))
        self.cost[at] = 0.5 * np.sum(residuals**2, axis=1)
        sizes = _norm(rows, axis=1)
        self.sizes[at] = np.where(sizes == 0, 1.0, sizes)
        radius = _norm(self.theta[at] * self.sizes[at])
        self.radius[at] = np.where(radius == 0, 1.0, radius)
        self._linearise(at, residuals, rows)

    def step(self) -> None:
        """One trial step of every case that is not done."""
        going = np.flatnonzero(~self.done & ~self.lost)
        out = self.tried[going] >= self.most
        self.stopped[going[out]] = self.done[going[out]] = True
        if going[~out].size:
            self._try(going[~out])

    def jacobian(self, at: np.ndarray) -> np.ndarray:
        """Derivatives of the standardised predictions and of the prior's distances, (cases, N + parameters, size)."""
        return self._rows(at, Point(self.theta, self.predicted, self.slopes).at(at))[1]

    def _rows(self, at: np.ndarray, point: Point) -> tuple[np.ndarray, np.ndarray]:
        """Residuals, and minus their derivatives, with a slope that is not finite taken as nothing."""
        residuals, rows = self.batch.rows(at, point, self.sigma[at])
        return residuals, np.where(np.isfinite(rows), rows, 0.0)

    def _linearise(self, at: np.ndarray, residuals: np.ndarray, rows: np.ndarray) -> None:
        """Take gradient and Jacobian at a new point."""
        gradient = -np.einsum("cn,cnp->cp", residuals, rows)
        scaled = rows / self.sizes[at][:, None]
        good = np.all(np.isfinite(residuals), axis=1) & np.all(np.isfinite(scaled), axis=(1, 2))
        self.lost[at[~good]] = self.done[at[~good]] = True
        at, good_residuals = at[good], residuals[good]
        basis, self.values[at], axes = np.linalg.svd(scaled[good], full_matrices=False)
        self.gradient[at], self.axes[at] = gradient[good], np.swapaxes(axes, 1, 2)
        self.along[at] = np.einsum("cnk,cn->ck", basis, good_residuals)
        self.done[at] |= np.max(np.abs(self.gradient[at]), axis=1) < TOLERANCE

    def _try(self, at: np.ndarray) -> None:
        """One trial step of some cases."""
        radius = self.radius[at]
        now = (self.along[at], self.values[at], self.axes[at])
        scaled, self.damping[at] = _step(*now, radius, self.damping[at], self.rows)
        step = scaled / self.sizes[at]
        point = within_reach(self.batch, at, self.theta[at] + step)
        residuals, rows = self._rows(at, point)
        self.evaluations[at] += 1
        self.tried[at] += 1
        finite = np.all(np.isfinite(residuals), axis=1)
        cost = np.where(finite, 0.5 * np.sum(np.where(finite[:, None], residuals, 0.0) ** 2, axis=1), np.inf)
        gain, length = self.cost[at] - cost, _norm(scaled)
        ratio = self._ratio(at, scaled, gain)
        new = np.where(ratio < 0.25, 0.25 * length, radius)
        new = np.where((ratio > 0.75) & (length > 0.95 * radius), 2.0 * radius, new)
        small = (gain < TOLERANCE * self.cost[at]) & (ratio > 0.25)
        short = _norm(step) < TOLERANCE * (TOLERANCE + _norm(self.theta[at]))
        self.done[at] |= finite & (small | short)
        self.damping[at] *= np.where(finite, radius / new, 1.0)
        self.radius[at] = new
        good = gain > 0
        took = at[good]
        self.theta[took], self.predicted[took], self.slopes[took] = (
            point.theta[good], point.predicted[good], point.slopes[good]
        )  # fmt: skip
        self.cost[took] = cost[good]
        self.iterations[took] += 1
        self.sizes[took] = np.maximum(self.sizes[took], _norm(rows[good], axis=1))
        self._linearise(took, residuals[good], rows[good])

    def _ratio(self, at: np.ndarray, scaled: np.ndarray, gain: np.ndarray) -> np.ndarray:
        """What a step gained over what the linear model promised; minus infinity where it ended nowhere."""
        bent = self.values[at] * np.einsum("cpk,cp->ck", self.axes[at], scaled)
        promised = -0.5 * np.sum(bent**2, axis=1) - np.sum(self.gradient[at] / self.sizes[at] * scaled, axis=1)
        ratio = np.where(promised > 0, gain / np.where(promised > 0, promised, 1.0), 0.0)
        return np.where((promised == 0) & (gain == 0), 1.0, ratio)


def within_reach(batch: Batch, at: np.ndarray, theta: np.ndarray) -> Point:
    """The predictions of some cases; not a number where a log-parameter is out of all bounds."""
    point = batch.point(at, theta)
    point.predicted[np.any(theta[:, : len(batch.first.free)] > FARTHEST, axis=1)] = np.nan
    return point


def _norm(x: np.ndarray, axis: int = -1) -> np.ndarray:
    return np.asarray(np.sqrt(np.sum(x**2, axis=axis)))


def _step(
    along: np.ndarray, values: np.ndarray, axes: np.ndarray, radius: np.ndarray, damping: np.ndarray, samples: int
) -> tuple[np.ndarray, np.ndarray]:
    """The least of the linear model within the radius, and its damping: Gauss-Newton's step where that is inside.

    ``along``: the residuals, which are minus the misfit, along the axes of the Jacobian of these singular values.
    """
    gradient = values * along
    full = (values[:, -1] > EPS * samples * values[:, 0]) & (samples >= axes.shape[1])
    newton = np.einsum("cpk,ck->cp", axes, along / np.where(full[:, None], values, 1.0))
    inside = full & (_norm(newton) <= radius)

    def excess(damping: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """By how much a damped step is longer than the radius, and the derivative."""
        below = values**2 + damping[:, None]
        length = _norm(gradient / below)
        return length - radius, -np.sum(gradient**2 / below**3, axis=1) / length

    with np.errstate(all="ignore"):
        high = _norm(gradient) / radius
        phi, slope = excess(np.zeros_like(radius))
        low = np.where(full, -phi / slope, 0.0)
        damping = np.where(~full & (damping == 0), np.maximum(0.001 * high, np.sqrt(low * high)), damping)
        going = ~inside
        for _ in range(ROOT_STEPS):
            out = (damping < low) | (damping > high)
            tried = np.where(out, np.maximum(0.001 * high, np.sqrt(low * high)), damping)
            phi, slope = excess(tried)
            high = np.where(going & (phi < 0), tried, high)
            low = np.where(going, np.maximum(low, tried - phi / slope), low)
            damping = np.where(going, tried - (phi + radius) * (phi / slope) / radius, damping)
            going &= ~(np.abs(phi) < ROOT_TOLERANCE * radius)
            if not np.any(going):
                break
        bounded = np.einsum("cpk,ck->cp", axes, gradient / (values**2 + damping[:, None]))
        bounded *= (radius / _norm(bounded))[:, None]
    return np.where(inside[:, None], newton, bounded), np.where(inside, 0.0, damping)
