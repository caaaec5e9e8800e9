"""Continuation in the smoothing of friction: where the programme of multiple shooting has no solution.

Dry friction ``mu sign(v)`` is smoothed to ``mu tanh(v / v_s)``. Where a motion sticks, the response bends within a
small part of a step, and the likelihood has kinks at which a search stops. With a larger v_s the likelihood is smooth;
its maximum is a good starting point for a smaller v_s, down to that of the system (a homotopy: E. L. Allgower,
K. Georg, Introduction to Numerical Continuation Methods, 2003, chapter 1). Each maximum is that of a single trajectory,
by the Runge-Kutta steps of shooting (:mod:`methods.trajectory.stepped`).

A damping may run down to zero on the way, in its logarithm without an end. At the next smoothing it starts anew. At the
last one the likelihood is largest without it: it stays where nothing depends on it, the others are searched again, and
the likelihood linearised at zero gives its uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bench import LOG_LIMIT, SIGMA_FLOOR, Linearisation, OutputError, Problem, SimulatedData, System
from methods.trajectory.fineness import Fineness
from methods.trajectory.fit import Fits, Maximum, Rules, fit
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

    fixed: np.ndarray = field(kw_only=True)

    @staticmethod
    def alone(problem: Problem, gauge: float, fineness: Fineness, fixed: np.ndarray) -> Without:
        """The batch of one problem."""
        return Without.batch([Without(problem, gauge, fineness=fineness, fixed=fixed)])

    def point(self, theta: np.ndarray) -> SimulatedData:
        """The predictions, as if they did not depend on the fixed unknowns."""
        point = super().point(theta)
        point.slopes[..., self.fixed] = 0.0
        return point


def solve_by_continuation(
    model: OutputError, starts: Sequence[np.ndarray], rules: Rules, fineness: Fineness, ends: Sequence[np.ndarray] = ()
) -> Maximum | None:
    """Search from all starting points, the friction smoothed less and less; None where the best is no maximum.

    Args:
        model: a problem of a nonlinear system in natural units.
        starts: vectors of its unknowns, at least one.
        rules: the settings of the searches.
        fineness: how exactly the motion is integrated.
        ends: where another search with the system's own smoothing ended.
    """
    first, k, iterations = np.stack(starts), len(model.free), 0
    thetas, systems = first, _smoothed(model.system)
    for system in systems:
        if system is systems[-1] and len(ends):
            first = np.concatenate([first, np.broadcast_to(first[0], np.shape(ends))])
            thetas = np.concatenate([thetas, np.where(np.abs(ends) < LOG_LIMIT, ends, first[0])])
        batch = Without.alone(replace(model.problem, system=system), model.gauge, fineness, np.zeros(0, int))
        fits = fit(batch, np.zeros(len(first), int), thetas, rules)
        thetas, iterations = fits.point.theta.copy(), iterations + int(fits.iterations.sum())
        gone = _effects(batch, fits)[:, :k] < NOTHING
        thetas[:, :k] = np.where(gone, first[:, :k], thetas[:, :k])
    end = _without_run_down(model, fineness, fits.point.theta[np.argmin(fits.profile)], rules)
    if not _is_maximum(end.batch, end.fits):
        return None
    fixed, objectives = end.batch.fixed, 0.5 * np.append(fits.profile, end.fits.profile)
    return Maximum(
        model=model,
        theta=end.fits.point.theta[0],
        residuals=model.data - end.fits.point.predicted[0],
        slopes=end.slopes,
        sigma=end.fits.sigma[0],
        covariance=model.covariance(end.slopes, end.fits.sigma[0]),
        used=float(end.fits.used[0]),
        iterations=iterations + int(end.fits.iterations[0]),
        message=RUN_DOWN.format(", ".join(model.free[i] for i in fixed)) if fixed.size else "",
        objectives=tuple(map(float, objectives)),
    )


@dataclass(frozen=True, eq=False)
class _End:
    """Where the search of one vector ended, and the derivatives (N, size) by the fixed unknowns too."""

    batch: Without
    fits: Fits
    slopes: np.ndarray


def _without_run_down(model: OutputError, fineness: Fineness, theta: np.ndarray, rules: Rules) -> _End:
    """Search from one vector; what runs down is fixed and the others searched again, until nothing more does."""
    theta, k = theta.copy(), len(model.free)
    slopes, fixed = np.zeros((model.data.size, model.size)), np.zeros(0, int)
    while True:
        batch = Without.alone(model.problem, model.gauge, fineness, fixed)
        fits = fit(batch, np.zeros(1, int), theta[None], rules)
        searched = np.setdiff1d(np.arange(model.size), fixed)
        theta, slopes[:, searched] = fits.point.theta[0].copy(), fits.point.slopes[0][:, searched]
        effects = _effects(batch, fits)[0]
        gone = searched[(searched < k) & (effects[searched] < NOTHING)]
        if not gone.size:
            return _End(batch, fits, slopes)
        # to where it can just not be seen: smaller numbers say no more, and round badly
        growth = np.log(NOTHING / np.maximum(effects[gone], 1e-100))
        theta[gone] += growth
        slopes[:, gone] *= np.exp(growth)
        fixed = np.union1d(fixed, gone)


def _effects(batch: OutputError, fits: Fits) -> np.ndarray:
    """Lengths of the derivatives of all predictions, in standard errors of the noise, (cases, size)."""
    return np.asarray(np.linalg.norm(_standardised(batch, fits).slopes, axis=1))


def _is_maximum(batch: OutputError, fits: Fits) -> bool:
    """Decide whether the search of a single vector settled, or a Gauss-Newton step would gain next to nothing."""
    here = _standardised(batch, fits)
    residuals, slopes = here.residuals[0], here.slopes[0]
    if fits.converged[0] or not (np.all(np.isfinite(slopes)) and np.all(np.isfinite(residuals))):
        return bool(fits.converged[0])
    gain = slopes @ np.linalg.lstsq(slopes, residuals, rcond=1e-12)[0]
    return float(np.sum(gain**2)) < MOST_LEFT


def _standardised(batch: OutputError, fits: Fits) -> Linearisation:
    """Standardised residuals and their derivatives, of cases of the only problem of a batch."""
    chosen = batch[np.zeros(len(fits.sigma), int)]
    return chosen.standardised(fits.point, np.maximum(fits.sigma, SIGMA_FLOOR * chosen.rms))


def _smoothed(system: System) -> list[System]:
    """The system smoothed less and less, itself last; alone where it has no smoothing velocity."""
    velocity = getattr(system, "smoothing_velocity", None)
    if velocity is None:
        return [system]
    return [replace(system, smoothing_velocity=factor * velocity) for factor in SMOOTHINGS]  # type: ignore[type-var]
