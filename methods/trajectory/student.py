"""The maximum a posteriori with Student t errors, from that with normal ones, by iteratively reweighted least squares.

That is the EM algorithm (K. L. Lange, R. J. A. Little, J. M. G. Taylor, J. Am. Stat. Assoc. 84:881, 1989, section 3):
samples are weighted by how far they are off, and the weighted misfit is made less by damped Gauss-Newton steps, each
taken only where it raises the posterior itself. Fit and scale alternate as fit and noise do for normal errors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bench import LOG_LIMIT, SIGMA_FLOOR, OutputError, used_of
from methods.trajectory.errors import STUDENT, NormalErrors, StudentErrors

ROUNDS, TOLERANCE = 12, 1e-4
"""Of fit and scale in turn, and the relative change of the scale at which they have settled."""
STEPS = 60
LEFT = 1e-9
"""What a step may still gain in minus twice the log-posterior where a fit has ended."""
LONGEST = 1.0
"""Of a step in a log-parameter."""

Look = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Prediction (N,) and its derivatives (N, size) at a vector of unknowns (size,)."""


@dataclass(frozen=True, eq=False)
class StudentFit:
    """Where the search ended: the scales of the channels, degrees of freedom used, and steps that it took."""

    theta: np.ndarray
    slopes: np.ndarray
    scales: np.ndarray
    used: float
    value: float
    """Minus twice the log-posterior with the scales at their best values, up to a constant."""
    iterations: int
    settled: bool

    @property
    def sigma(self) -> np.ndarray:
        """The noise by channel at which normal errors would tell as much: the information of the t over the scale."""
        return np.asarray(self.scales / np.sqrt(STUDENT.location))


def student_fit(model: OutputError, look: Look, theta: np.ndarray) -> StudentFit:
    """The maximum near ``theta``, which may be anywhere that the response is finite."""
    now, floor = _Point.at(look, theta), SIGMA_FLOOR * model.rms
    used, iterations, settled = float(model.size), 0, False
    free = STUDENT.scales(model, model.data - now.predicted, used)
    scales = np.maximum(free, floor)
    for _ in range(ROUNDS):
        now, steps, ended = _searched(model, look, now, scales, STUDENT)
        iterations += steps
        rows = np.concatenate(
            [np.sqrt(STUDENT.location) * now.slopes / scales[model.channel_of][:, None], _prior_rows(model)]
        )
        used = float(used_of(rows[None], model.data.size)[0]) if np.all(np.isfinite(rows)) else used
        free = STUDENT.scales(model, model.data - now.predicted, used)
        before, scales = scales, np.maximum(free, floor)
        settled = ended and bool(np.max(np.abs(np.log(scales / before))) < TOLERANCE)
        if settled:
            break
    value = _misfit(model, now, scales, STUDENT) + float(2.0 * model.counts @ np.log(scales))
    return StudentFit(now.theta, now.slopes, free, used, value, iterations, settled)


@dataclass(frozen=True, eq=False)
class _Point:
    theta: np.ndarray
    predicted: np.ndarray
    slopes: np.ndarray

    @staticmethod
    def at(look: Look, theta: np.ndarray) -> _Point:
        return _Point(theta, *look(theta))


def searched(
    model: OutputError, look: Look, theta: np.ndarray, scales: np.ndarray, errors: NormalErrors | StudentErrors
) -> np.ndarray:
    """The vector of unknowns at the maximum near ``theta`` at given scales of the channels."""
    return _searched(model, look, _Point.at(look, theta), scales, errors)[0].theta


def _searched(
    model: OutputError, look: Look, now: _Point, scales: np.ndarray, errors: NormalErrors | StudentErrors
) -> tuple[_Point, int, bool]:
    """The maximum at given scales; the steps that it took, and whether it was reached."""
    value, damping, k = _misfit(model, now, scales, errors), 0.0, len(model.free)
    for number in range(STEPS):
        z = (model.data - now.predicted) / scales[model.channel_of]
        roots = np.sqrt(errors.weights(z))
        rows = np.concatenate([(roots / scales[model.channel_of])[:, None] * now.slopes, _prior_rows(model)])
        right = np.concatenate([roots * z, -model.penalty(now.theta)])
        sizes = np.linalg.norm(rows, axis=0)
        sizes[sizes == 0] = 1.0
        eased = np.concatenate([rows / sizes, np.sqrt(damping) * np.eye(sizes.size)])
        step = np.linalg.lstsq(eased, np.concatenate([right, np.zeros(sizes.size)]), rcond=1e-14)[0] / sizes
        gain = float(2.0 * right @ (rows @ step) - np.sum((rows @ step) ** 2))
        if gain < LEFT:
            return now, number, True
        step[:k] = np.clip(step[:k], -LONGEST, LONGEST)
        theta = now.theta + step
        theta[:k] = np.clip(theta[:k], -LOG_LIMIT, LOG_LIMIT)
        trial = _Point.at(look, theta)
        new = _misfit(model, trial, scales, errors)
        if new < value:
            now, value, damping = trial, new, 0.1 * damping if damping > 1e-6 else 0.0
        else:
            damping = max(8.0 * damping, 1e-3)
            if damping > 1e12:
                return now, number, gain < 1e-4
    return now, STEPS, False


def _misfit(model: OutputError, at: _Point, scales: np.ndarray, errors: NormalErrors | StudentErrors) -> float:
    """Minus twice the log-posterior at given scales, up to a constant; infinite without a response or slopes."""
    if not (np.all(np.isfinite(at.predicted)) and np.all(np.isfinite(at.slopes))):
        return float("inf")
    z = (model.data - at.predicted) / scales[model.channel_of]
    return float(-2.0 * errors.log_likelihood(z[None])[0] + np.sum(model.penalty(at.theta) ** 2))


def _prior_rows(model: OutputError) -> np.ndarray:
    """Derivatives of the standardised distances from the prior, shape (n_parameters, size)."""
    if model.prior is None:
        return np.zeros((0, model.size))
    return np.eye(len(model.free), model.size) / model.prior.log_sds[:, None]
