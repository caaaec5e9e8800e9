"""Continuation in the smoothing of friction: where the programme of multiple shooting has no solution.

Dry friction ``mu sign(v)`` is smoothed to ``mu tanh(v / v_s)``. Where a motion sticks, the likelihood has kinks that
stop a search. With a larger v_s it is smooth; its maximum is a good starting point for a smaller v_s, down to that of
the system (a homotopy: E. L. Allgower, K. Georg, Introduction to Numerical Continuation Methods, 2003, chapter 1).

A damping may run down to zero on the way, in its logarithm without an end. At the next smoothing it starts anew. At the
last one the likelihood is largest without it: it stays where nothing depends on it, the others are searched again, and
the likelihood linearised at zero gives its uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bench import LOG_LIMIT, SIGMA_FLOOR, Linearisation, SimulatedData, System
from methods.trajectory.fit import Fits, Maximum, fit
from methods.trajectory.screening import Rules
from methods.trajectory.stepped import SteppedOutputError

SMOOTHINGS = (30.0, 10.0, 3.0, 1.0, 1.0)
"""Smoothing velocities, over that of the system: from about the speed of a motion down; the last for a second start."""
NOTHING = 1e-3
"""A parameter has run down where doubling it moves all predictions together by less than this, in standard errors."""
MOST_LEFT = 0.01
"""What a search that counts may still gain in minus twice the log-posterior: a tenth of a standard error, squared."""

RUN_DOWN = "the likelihood is largest without {}, whose interval is that of the likelihood linearised at zero"


@dataclass(frozen=True, eq=False)
class Without(SteppedOutputError):
    """A likelihood whose unknowns of numbers ``fixed`` are not searched."""

    fixed: np.ndarray = field(default_factory=lambda: np.zeros(0, int))

    def point(self, theta: np.ndarray) -> SimulatedData:
        """The predictions, as if they did not depend on the fixed unknowns."""
        point = super().point(theta)
        point.slopes[..., self.fixed] = 0.0
        return point


@dataclass(frozen=True, eq=False)
class _Ends:
    """Where searches with some unknowns fixed ended; their residuals and derivatives, over the noise."""

    fits: Fits
    at: Linearisation

    @staticmethod
    def of(model: SteppedOutputError, thetas: np.ndarray, rules: Rules, fixed: np.ndarray) -> _Ends:
        """Search from vectors (cases, size)."""
        steps = (model.integration_error, model.noise_share)
        batch = Without.batch([Without(model.problem, model.gauge, *steps, fixed)])
        cases = np.zeros(len(thetas), int)
        fits = fit(batch, cases, thetas, rules)
        chosen = batch[cases]
        return _Ends(fits, chosen.standardised(fits.point, np.maximum(fits.sigma, SIGMA_FLOOR * chosen.rms)))

    @property
    def effects(self) -> np.ndarray:
        """Lengths of the derivatives of all predictions, in standard errors of the noise, (cases, size)."""
        return np.asarray(np.linalg.norm(self.at.slopes, axis=1))

    def is_maximum(self) -> bool:
        """Decide whether the search of the first vector settled, or a Gauss-Newton step would gain next to nothing."""
        residuals, slopes = self.at.residuals[0], self.at.slopes[0]
        if self.fits.converged[0] or not (np.all(np.isfinite(slopes)) and np.all(np.isfinite(residuals))):
            return bool(self.fits.converged[0])
        gain = slopes @ np.linalg.lstsq(slopes, residuals, rcond=1e-12)[0]
        return float(np.sum(gain**2)) < MOST_LEFT


def solve_by_continuation(
    model: SteppedOutputError, starts: Sequence[np.ndarray], rules: Rules, ends: Sequence[np.ndarray] = ()
) -> Maximum | None:
    """Search from all starting points, the friction smoothed less and less; None where the best is no maximum.

    Args:
        model: a problem of a nonlinear system in natural units.
        starts: vectors of its unknowns, at least one.
        rules: the settings of the searches.
        ends: where another search with the system's own smoothing ended.
    """
    first, k, iterations = np.stack(starts), len(model.free), 0
    thetas, systems, nothing = first, _smoothed(model.system), np.zeros(0, int)
    for system in systems:
        if system is systems[-1] and len(ends):
            first = np.concatenate([first, np.broadcast_to(first[0], np.shape(ends))])
            thetas = np.concatenate([thetas, np.where(np.abs(ends) < LOG_LIMIT, ends, first[0])])
        smoothed = replace(model, problem=replace(model.problem, system=system))
        reached = _Ends.of(smoothed, thetas, rules, nothing)
        thetas, iterations = reached.fits.point.theta.copy(), iterations + int(reached.fits.iterations.sum())
        thetas[:, :k] = np.where(reached.effects[:, :k] < NOTHING, first[:, :k], thetas[:, :k])
    best = reached.fits.point.theta[np.argmin(reached.fits.profile)].copy()
    last, fixed, slopes = _without_run_down(model, best, rules)
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
        message=RUN_DOWN.format(", ".join(model.free[i] for i in fixed)) if fixed.size else "",
        objectives=tuple(map(float, objectives)),
    )


def _without_run_down(
    model: SteppedOutputError, theta: np.ndarray, rules: Rules
) -> tuple[_Ends, np.ndarray, np.ndarray]:
    """Search from one vector; what runs down is fixed and the others searched again, until nothing more does.

    Returns the end, the fixed unknowns, and the derivatives (N, size) by these too.
    """
    k, slopes, fixed = len(model.free), np.zeros((model.data.size, model.size)), np.zeros(0, int)
    while True:
        end = _Ends.of(model, theta[None], rules, fixed)
        searched = np.setdiff1d(np.arange(model.size), fixed)
        theta, slopes[:, searched] = end.fits.point.theta[0].copy(), end.fits.point.slopes[0][:, searched]
        effects = end.effects[0]
        gone = searched[(searched < k) & (effects[searched] < NOTHING)]
        if not gone.size:
            return end, fixed, slopes
        # to where it can just not be seen: smaller numbers say no more, and round badly
        growth = np.log(NOTHING / np.maximum(effects[gone], 1e-100))
        theta[gone] += growth
        slopes[:, gone] *= np.exp(growth)
        fixed = np.union1d(fixed, gone)


def _smoothed(system: System) -> list[System]:
    """The system smoothed less and less, itself last; alone where it has no smoothing velocity."""
    velocity = getattr(system, "smoothing_velocity", None)
    if velocity is None:
        return [system]
    return [replace(system, smoothing_velocity=factor * velocity) for factor in SMOOTHINGS]  # type: ignore[type-var]
