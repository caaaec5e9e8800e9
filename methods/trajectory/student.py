"""Errors that are normal, or Student's t, which expects outliers; and the maximum a posteriori with the latter.

Student's t with few, fixed degrees of freedom is the standard robust likelihood (K. L. Lange, R. J. A. Little,
J. M. G. Taylor, J. Am. Stat. Assoc. 84:881, 1989): a sample counts by ``w = (v + 1) / (v + (r / s)²)``, so one far off
counts for next to nothing. ``s`` is the scale of each channel, which is estimated.

The maximum is found from that with normal errors by iteratively reweighted least squares, which is the EM algorithm
(Lange et al., section 3): each step lowers the weighted misfit, and is taken only where it raises the posterior itself.
Fit and scale alternate as fit and noise do for normal errors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bench import (
    LOG_LIMIT,
    SIGMA_FLOOR,
    Cost,
    Linearisation,
    NoEstimate,
    OutputError,
    StepLimits,
    degrees_used,
    minimise,
)
from methods.trajectory.fit import Maximum

Likelihood = Literal["normal", "student"]
SCALE_ROUNDS, SCALE_TOLERANCE = 200, 1e-8
"""Of the fixed point that the scale is."""


@dataclass(frozen=True)
class NormalErrors:
    """Independent normal errors; ``location`` and ``scale``: Fisher information of a sample, in units of its scale."""

    location: float = 1.0
    scale: float = 2.0

    def log_likelihood(self, z: np.ndarray) -> np.ndarray:
        """Of errors (n, N) over their scales, shape (n,), without the scales' own term, up to a constant."""
        return np.asarray(-0.5 * np.einsum("ni,ni->n", z, z))

    def weights(self, z: np.ndarray) -> np.ndarray:
        """All samples count the same."""
        return np.ones_like(z)

    def scales(self, model: OutputError, residuals: np.ndarray, used: float) -> np.ndarray:
        """The scale of each channel that residuals (N,) tell, with ``used`` degrees of freedom spent."""
        return model.noise(residuals, used, floor=0.0)


@dataclass(frozen=True)
class StudentErrors:
    """Independent errors of Student's t with ``dof`` degrees of freedom; the information: Lange et al., appendix B."""

    dof: float = 4.0

    @property
    def location(self) -> float:
        return (self.dof + 1.0) / (self.dof + 3.0)

    @property
    def scale(self) -> float:
        return 2.0 * self.dof / (self.dof + 3.0)

    def log_likelihood(self, z: np.ndarray) -> np.ndarray:
        """As for normal errors."""
        return np.asarray(-0.5 * (self.dof + 1.0) * np.sum(np.log1p(z**2 / self.dof), axis=-1))

    def weights(self, z: np.ndarray) -> np.ndarray:
        """How much samples count that are off by z scales."""
        return np.asarray((self.dof + 1.0) / (self.dof + z**2))

    def scales(self, model: OutputError, residuals: np.ndarray, used: float) -> np.ndarray:
        """As for normal errors: ``s² = sum w r² / (N - used)``, with the weights at s itself."""
        squares, channel_of = residuals**2, model.channel_of
        sizes = model.noise(residuals, used, floor=0.0)
        least = 1e-12 * model.rms
        for _ in range(SCALE_ROUNDS):
            sizes = np.maximum(sizes, least)
            weights = self.weights(residuals / sizes[channel_of])
            before, sizes = sizes, model.noise(np.sqrt(weights * squares), used, floor=0.0)
            if np.all(np.abs(sizes - before) <= SCALE_TOLERANCE * before):
                break
        return sizes


NORMAL, STUDENT = NormalErrors(), StudentErrors()
ERRORS: dict[Likelihood, NormalErrors | StudentErrors] = {"normal": NORMAL, "student": STUDENT}

ROUNDS, TOLERANCE = 12, 1e-4
"""Of fit and scale in turn, and the relative change of the scale at which they have settled."""
STEPS = 60
LEFT = 1e-4
"""What a step may still gain in minus twice the log-posterior where a fit counts as ended at a maximum."""
LONGEST_STEP = 1.0
"""Largest change of a log-parameter in one step."""

UNSETTLED = (
    "the search with Student t errors did not settle: the noise is too far from any such law, or the samples few"
)
FEW = "fewer than twice as many samples as unknowns: fitted with normal errors, since no outlier can be told from noise"

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


def with_student_errors(maximum: Maximum, batch: OutputError) -> Maximum:
    """Return the maximum with Student t errors near one with normal errors; ``batch`` simulates its problem alone."""
    model, one = maximum.model, np.zeros(1, int)
    if model.data.size < 2 * model.size:
        return replace(maximum, message="; ".join(part for part in (maximum.message, FEW) if part))
    simulated = batch.refined(one, maximum.theta[None], maximum.sigma[None])[one]

    def look(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        point = simulated.point(theta[None])
        return point.predicted[0], point.slopes[0]

    fit = student_fit(model, look, maximum.theta)
    iterations = maximum.iterations + fit.iterations
    if not fit.settled:
        raise NoEstimate(UNSETTLED, cost=Cost(iterations, iterations))
    residuals = model.data - look(fit.theta)[0]
    covariance = model.covariance(fit.slopes, fit.sigma)
    return Maximum(
        model, fit.theta, residuals, fit.slopes, fit.sigma, covariance, fit.used, iterations, maximum.message
    )


def student_fit(model: OutputError, look: Look, theta: np.ndarray) -> StudentFit:
    """Return the maximum near ``theta``, which may be anywhere that the response is finite."""
    floor, used, iterations, settled = SIGMA_FLOOR * model.rms, float(model.size), 0, False
    predicted, slopes = look(theta)
    free = STUDENT.scales(model, model.data - predicted, used)
    scales = np.maximum(free, floor)
    for _ in range(ROUNDS):
        theta, steps, ended = _search(model, look, theta, scales, STUDENT)
        iterations += steps
        predicted, slopes = look(theta)
        weighed = np.sqrt(STUDENT.location) * slopes / scales[model.channel_of][:, None]
        rows = np.concatenate([weighed, _prior_rows(model)])
        used = float(degrees_used(rows[None], model.data.size)[0]) if np.all(np.isfinite(rows)) else used
        free = STUDENT.scales(model, model.data - predicted, used)
        before, scales = scales, np.maximum(free, floor)
        settled = ended and bool(np.max(np.abs(np.log(scales / before))) < TOLERANCE)
        if settled:
            break
    value = _misfit(model, theta, predicted, scales, STUDENT) + float(2.0 * model.counts @ np.log(scales))
    return StudentFit(theta, slopes, free, used, value, iterations, settled)


def searched(
    model: OutputError, look: Look, theta: np.ndarray, scales: np.ndarray, errors: NormalErrors | StudentErrors
) -> np.ndarray:
    """Return the vector of unknowns at the maximum near ``theta`` at given scales of the channels."""
    return _search(model, look, theta, scales, errors)[0]


def _search(
    model: OutputError, look: Look, theta: np.ndarray, scales: np.ndarray, errors: NormalErrors | StudentErrors
) -> tuple[np.ndarray, int, bool]:
    """Return the maximum at given scales, the steps that it took, and whether it was reached."""

    def evaluate(_: np.ndarray, thetas: np.ndarray) -> Linearisation:
        predicted, slopes = look(thetas[0])
        z = (predicted - model.data) / scales[model.channel_of]
        roots = np.sqrt(errors.weights(z))
        rows = np.concatenate([(roots / scales[model.channel_of])[:, None] * slopes, _prior_rows(model)])
        residuals = np.concatenate([roots * z, model.penalty(thetas[0])])
        cost = _misfit(model, thetas[0], predicted, scales, errors) if np.all(np.isfinite(slopes)) else np.inf
        return Linearisation(thetas, residuals[None], rows[None], np.array([cost]))

    logs = np.arange(model.size) < len(model.free)
    limits = StepLimits(np.where(logs, LONGEST_STEP, np.inf), np.where(logs, LOG_LIMIT, np.inf))
    end = minimise(evaluate, evaluate(np.zeros(1, int), theta[None]), STEPS, limits)
    return end.at.unknowns[0], int(end.iterations[0]), bool(end.left[0] < LEFT)


def _misfit(
    model: OutputError,
    theta: np.ndarray,
    predicted: np.ndarray,
    scales: np.ndarray,
    errors: NormalErrors | StudentErrors,
) -> float:
    """Minus twice the log-posterior at given scales, up to a constant; infinite without a response."""
    if not np.all(np.isfinite(predicted)):
        return float("inf")
    z = (model.data - predicted) / scales[model.channel_of]
    return float(-2.0 * errors.log_likelihood(z[None])[0] + np.sum(model.penalty(theta) ** 2))


def _prior_rows(model: OutputError) -> np.ndarray:
    """Derivatives of the standardised distances from the prior, shape (n_parameters, size)."""
    return model.precision[:, None] * np.eye(model.precision.size, model.size)
