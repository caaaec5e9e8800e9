"""Continuation in the smoothing of friction, used where the programme of multiple shooting has no solution.

Dry friction ``mu sign(v)`` is smoothed to ``mu tanh(v / v_s)``. Where a motion sticks, the likelihood has kinks at
which a search stops. With a larger v_s it is smooth, and its maximum is a good initial guess for a smaller v_s, down to
that of the system (a homotopy: E. L. Allgower, K. Georg, Introduction to Numerical Continuation Methods, 2003, chapter
1).

The estimate of a damping may tend to zero in a search, its logarithm to minus infinity. It is reset for the next
smoothing. If it vanishes at the last one, it is fixed at a negligible value, the other unknowns are searched again, and
its uncertainty is that of the likelihood linearised at zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bench import LOG_LIMIT, SIGMA_FLOOR, Linearisation, SimulatedData, System
from methods.trajectory.fit import Fits, Maximum, fit
from methods.trajectory.runge_kutta import SteppedOutputError
from methods.trajectory.screening import Rules

SMOOTHINGS = (30.0, 10.0, 3.0, 1.0, 1.0)
"""Smoothing velocities over that of the system, from about the speed of a motion down; the last is repeated."""
NOTHING = 1e-3
"""A parameter is negligible if doubling it changes all predictions by less than this, in standard errors."""
MOST_LEFT = 0.01
"""Largest remaining decrease of minus twice the log-posterior at a maximum: a tenth of a standard error, squared."""

VANISHED = "the likelihood is largest without {}, whose interval is that of the likelihood linearised at zero"


@dataclass(frozen=True, eq=False)
class FixedOutputError(SteppedOutputError):
    """A likelihood in which the unknowns of indices ``fixed`` are constant."""

    fixed: np.ndarray = field(default_factory=lambda: np.zeros(0, int))

    def point(self, theta: np.ndarray) -> SimulatedData:
        """Return predictions and slopes, with zero slopes for the fixed unknowns."""
        point = super().point(theta)
        point.slopes[..., self.fixed] = 0.0
        return point


@dataclass(frozen=True, eq=False)
class _Ends:
    """The ends of searches with fixed unknowns, and the linearisation there, standardised by the noise."""

    fits: Fits
    linearisation: Linearisation

    @staticmethod
    def of(model: SteppedOutputError, thetas: np.ndarray, rules: Rules, fixed: np.ndarray) -> _Ends:
        """Search from vectors (cases, size) with some unknowns fixed."""
        steps = (model.integration_error, model.noise_share)
        batch = FixedOutputError.batch([FixedOutputError(model.problem, model.gauge, *steps, fixed)])
        cases = np.zeros(len(thetas), int)
        fits = fit(batch, cases, thetas, rules)
        chosen = batch[cases]
        return _Ends(fits, chosen.standardised(fits.point, np.maximum(fits.sigma, SIGMA_FLOOR * chosen.rms)))

    @property
    def effects(self) -> np.ndarray:
        """Return the norms of the derivatives of all predictions, over the noise, (cases, size)."""
        return np.asarray(np.linalg.norm(self.linearisation.slopes, axis=1))

    def is_maximum(self) -> bool:
        """Return True where the first search converged or a Gauss-Newton step would gain less than ``MOST_LEFT``."""
        residuals, slopes = self.linearisation.residuals[0], self.linearisation.slopes[0]
        if self.fits.converged[0] or not (np.all(np.isfinite(slopes)) and np.all(np.isfinite(residuals))):
            return bool(self.fits.converged[0])
        gain = slopes @ np.linalg.lstsq(slopes, residuals, rcond=1e-12)[0]
        return float(np.sum(gain**2)) < MOST_LEFT


def solve_by_continuation(
    model: SteppedOutputError, starts: Sequence[np.ndarray], rules: Rules, ends: Sequence[np.ndarray] = ()
) -> Maximum | None:
    """Search from all initial guesses with decreasing smoothing of friction.

    Args:
        model: A problem of a nonlinear system in natural units.
        starts: Vectors of its unknowns, at least one.
        rules: Settings of the searches.
        ends: Ends of another search with the system's smoothing.

    Returns:
        The best maximum; None where the best end is no maximum.
    """
    first, k, iterations = np.stack(starts), len(model.free), 0
    thetas, systems, no_index = first, _smoothed(model.system), np.zeros(0, int)
    for system in systems:
        if system is systems[-1] and len(ends):
            first = np.concatenate([first, np.broadcast_to(first[0], np.shape(ends))])
            thetas = np.concatenate([thetas, np.where(np.abs(ends) < LOG_LIMIT, ends, first[0])])
        smoothed = replace(model, problem=replace(model.problem, system=system))
        reached = _Ends.of(smoothed, thetas, rules, no_index)
        thetas, iterations = reached.fits.point.theta.copy(), iterations + int(reached.fits.iterations.sum())
        thetas[:, :k] = np.where(reached.effects[:, :k] < NOTHING, first[:, :k], thetas[:, :k])
    best = reached.fits.point.theta[np.argmin(reached.fits.profile)].copy()
    last, fixed, slopes = _with_vanished_fixed(model, best, rules)
    if not last.is_maximum():
        return None
    fits, objectives = last.fits, 0.5 * np.append(reached.fits.profile, last.fits.profile)
    return Maximum(
        model=model,
        theta=fits.point.theta[0],
        residuals=model.data - fits.point.predicted[0],
        slopes=slopes,
        sigma=fits.sigma[0],
        covariance=model.covariance(slopes, fits.sigma[0]),
        used=float(fits.used[0]),
        iterations=iterations + int(fits.iterations[0]),
        certificate=float(fits.certificates[0]),
        message=VANISHED.format(", ".join(model.free[i] for i in fixed)) if fixed.size else "",
        objectives=tuple(map(float, objectives)),
    )


def _with_vanished_fixed(
    model: SteppedOutputError, theta: np.ndarray, rules: Rules
) -> tuple[_Ends, np.ndarray, np.ndarray]:
    """Search from one vector, fixing parameters that vanish and repeating the search until none does.

    Returns the end, the indices of the fixed unknowns, and the derivatives (N, size) by all unknowns.
    """
    k, slopes, fixed = len(model.free), np.zeros((model.data.size, model.size)), np.zeros(0, int)
    while True:
        end = _Ends.of(model, theta[None], rules, fixed)
        searched = np.setdiff1d(np.arange(model.size), fixed)
        theta, slopes[:, searched] = end.fits.point.theta[0].copy(), end.fits.point.slopes[0][:, searched]
        effects = end.effects[0]
        vanished = searched[(searched < k) & (effects[searched] < NOTHING)]
        if not vanished.size:
            return end, fixed, slopes
        # to the threshold of a negligible effect; smaller values cause rounding errors
        growth = np.log(NOTHING / np.maximum(effects[vanished], 1e-100))
        theta[vanished] += growth
        slopes[:, vanished] *= np.exp(growth)
        fixed = np.union1d(fixed, vanished)


def _smoothed(system: System) -> list[System]:
    """Return the system with decreasing smoothing, itself last; it alone without a smoothing velocity."""
    velocity = getattr(system, "smoothing_velocity", None)
    if velocity is None:
        return [system]
    return [replace(system, smoothing_velocity=factor * velocity) for factor in SMOOTHINGS]  # type: ignore[type-var]
