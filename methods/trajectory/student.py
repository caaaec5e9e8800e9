"""Normal and Student's t errors, and the maximum a posteriori estimate with the latter.

Student's t with few, fixed degrees of freedom is the standard robust likelihood (K. L. Lange, R. J. A. Little,
J. M. G. Taylor, J. Am. Stat. Assoc. 84:881, 1989): a sample has the weight ``w = (v + 1) / (v + (r / s)²)``, which is
small for an outlier. The scale ``s`` of each channel is estimated.

The search starts from the maximum with normal errors and uses iteratively reweighted least squares, the EM algorithm
(Lange et al., section 3): each step decreases the weighted misfit and is accepted only if it increases the posterior.
Fit and scale alternate like fit and noise for normal errors.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from bench import (
    FIRST_DAMPING,
    SIGMA_FLOOR,
    Cost,
    Linearisation,
    Minimum,
    NoEstimate,
    OutputError,
    SimulatedData,
)
from methods.trajectory.fit import Fits, Maximum, fit
from methods.trajectory.screening import Rules

Likelihood = Literal["normal", "student"]
SCALE_ROUNDS, SCALE_TOLERANCE = 200, 1e-8
"""Largest number of fixed-point iterations for the scale, and the relative change at which they end."""
RULES = Rules(starts=1, screen_iterations=0, margin=0.0, sigma_rounds=12, sigma_tolerance=1e-4, iterations=60)
"""Settings of the alternation of fit and scale, from a maximum with normal errors."""
UNSETTLED = (
    "the search with Student t errors did not converge: the noise is too far from this distribution, or there are too "
    "few samples"
)
FEW = "fewer than twice as many samples as unknowns: fitted with normal errors, since outliers cannot be identified"


@dataclass(frozen=True)
class NormalErrors:
    """Independent normal errors; ``location``, ``scale``: Fisher information of a sample in units of its scale."""

    location: float = 1.0
    scale: float = 2.0

    def log_likelihood(self, z: np.ndarray) -> np.ndarray:
        """Return the log-likelihood of scaled errors (n, N), (n,), up to terms of the scales."""
        return np.asarray(-0.5 * np.einsum("ni,ni->n", z, z))

    def scales(self, model: OutputError, residuals: np.ndarray, used: float | np.ndarray) -> np.ndarray:
        """Estimate the scale of each channel from residuals (..., N), with ``used`` degrees of freedom."""
        return model.noise(residuals, used, floor=0.0)


@dataclass(frozen=True)
class StudentErrors:
    """Independent Student's t errors with ``dof`` degrees of freedom; information: Lange et al., appendix B."""

    dof: float = 4.0

    @property
    def location(self) -> float:
        return (self.dof + 1.0) / (self.dof + 3.0)

    @property
    def scale(self) -> float:
        return 2.0 * self.dof / (self.dof + 3.0)

    def log_likelihood(self, z: np.ndarray) -> np.ndarray:
        """Return the log-likelihood as for normal errors."""
        return np.asarray(-0.5 * (self.dof + 1.0) * np.sum(np.log1p(z**2 / self.dof), axis=-1))

    def weights(self, z: np.ndarray) -> np.ndarray:
        """Return the weights of samples with errors of z scales."""
        return np.asarray((self.dof + 1.0) / (self.dof + z**2))

    def scales(self, model: OutputError, residuals: np.ndarray, used: float | np.ndarray) -> np.ndarray:
        """Estimate scales by the fixed point of ``s² = sum w r² / (N - used)`` with the weights at s."""
        sizes, least = model.noise(residuals, used, floor=0.0), 1e-12 * model.rms
        for _ in range(SCALE_ROUNDS):
            sizes = np.maximum(sizes, least)
            roots = np.sqrt(self.weights(residuals / sizes[..., model.channel_of]))
            before, sizes = sizes, model.noise(roots * residuals, used, floor=0.0)
            if np.all(np.abs(sizes - before) <= SCALE_TOLERANCE * before):
                break
        return sizes


NORMAL, STUDENT = NormalErrors(), StudentErrors()


@dataclass(frozen=True, eq=False)
class StudentOutputError(OutputError):
    """The likelihood of a ``model`` of one problem with Student t errors; ``noise`` returns their scale.

    A step of the search is a least-squares step weighted at the current residuals; degrees of freedom follow from the
    expected information of the errors.
    """

    model: OutputError = field(kw_only=True)

    @staticmethod
    def of(model: OutputError) -> StudentOutputError:
        """Return the problem with Student t errors."""
        return StudentOutputError(model.problem, model.gauge, model=model)

    @cached_property
    def data(self) -> np.ndarray:
        return self.model.data.ravel()

    def jacobian(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the model's predictions (cases, N) and their derivatives (cases, N, size)."""
        return self.model.jacobian(theta)

    def noise(self, residuals: np.ndarray, used: float | np.ndarray, floor: float = SIGMA_FLOOR) -> np.ndarray:
        """Return the scale of each channel, (cases, channels), at least ``floor`` of the channel's size."""
        return np.maximum(STUDENT.scales(self.model, residuals, used), floor * self.rms)

    def standardised(self, point: SimulatedData, sigma: np.ndarray) -> Linearisation:
        """Return weighted residuals over the scales, then those of the prior, with the cost of the t likelihood."""
        normal, n = super().standardised(point, sigma), self.channel_of.size
        z, roots = normal.residuals[:, :n], np.ones_like(normal.residuals)
        roots[:, :n] = np.sqrt(STUDENT.weights(z))
        cost = np.sum(normal.residuals[:, n:] ** 2, axis=1) - 2.0 * STUDENT.log_likelihood(z)
        return Linearisation(
            normal.unknowns,
            roots * normal.residuals,
            roots[..., None] * normal.slopes,
            np.where(np.isfinite(normal.cost), cost, np.inf),
        )

    def search(
        self,
        start: SimulatedData,
        sigma: np.ndarray,
        iterations: int,
        damping: float = FIRST_DAMPING,
        polished: bool = False,
    ) -> tuple[SimulatedData, Minimum]:
        """Search as with normal errors; linearise the end with the expected information of the errors."""
        _, end = super().search(start, sigma, iterations, damping, polished)
        point = self.point(end.point.unknowns)
        expected = super().standardised(point, sigma / np.sqrt(STUDENT.location))
        return point, replace(end, point=replace(expected, cost=end.point.cost))

    def profile_of(self, theta: np.ndarray, residuals: np.ndarray) -> np.ndarray:
        """Return minus twice the log-posterior at the scales of residuals (cases, N), up to a constant."""
        scales = self.noise(residuals, float(self.size))
        errors = STUDENT.log_likelihood(residuals / scales[:, self.channel_of])
        value = 2.0 * np.log(scales) @ self.counts - 2.0 * errors + np.sum(self.penalty(theta) ** 2, axis=1)
        return np.where(np.isfinite(value), value, np.inf)


def student_fits(model: OutputError, thetas: np.ndarray) -> Fits:
    """Search maxima with Student t errors from vectors (cases, size) at which ``model`` is finite.

    The field ``sigma`` of the result is the scale of each channel.
    """
    return fit(StudentOutputError.batch([StudentOutputError.of(model)]), np.zeros(len(thetas), int), thetas, RULES)


def searched(
    model: OutputError, theta: np.ndarray, scales: np.ndarray, errors: NormalErrors | StudentErrors
) -> np.ndarray:
    """Return the vector of unknowns at the maximum near ``theta`` at given scales of the channels."""
    likelihood = StudentOutputError.of(model) if isinstance(errors, StudentErrors) else model
    point, _ = likelihood.search(likelihood.point(theta[None]), scales[None], RULES.iterations)
    return np.asarray(point.theta[0])


def with_student_errors(maximum: Maximum, batch: OutputError) -> Maximum:
    """Return the maximum with Student t errors near one with normal errors; ``batch`` simulates its problem alone."""
    model, first = maximum.model, np.zeros(1, int)
    if model.data.size < 2 * model.size:
        return replace(maximum, message="; ".join(filter(None, [maximum.message, FEW])))
    simulated = batch.refined(first, maximum.theta[None], maximum.sigma[None])[first]
    fits = student_fits(simulated, maximum.theta[None])
    iterations = maximum.iterations + int(fits.iterations[0])
    if not (fits.converged[0] and fits.settled[0]):
        raise NoEstimate(UNSETTLED, cost=Cost(iterations, iterations))
    # the noise at which normal errors would have the same information
    sigma, slopes = fits.sigma[0] / np.sqrt(STUDENT.location), fits.point.slopes[0]
    return replace(
        maximum,
        theta=fits.point.theta[0],
        residuals=model.data - fits.point.predicted[0],
        slopes=slopes,
        sigma=sigma,
        covariance=model.covariance(slopes, sigma),
        used=float(fits.used[0]),
        iterations=iterations,
        certificate=float(fits.certificates[0]),
        objectives=(0.5 * float(fits.profile[0]),),
    )
