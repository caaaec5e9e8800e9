"""A maximum of the posterior that multiple shooting found, and the answer that it is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench import SIGMA_FLOOR, Batch, Cost, Estimate, NoEstimate, OutputError, estimate_at
from methods.trajectory.ends import ends
from methods.trajectory.fineness import Fineness
from methods.trajectory.stepped import Stepped
from methods.trajectory.student import student_fit

UNSETTLED = (
    "the search with Student t errors did not settle: the noise is too far from any such law, or the samples few"
)
OPEN = "the data leave a parameter open here, so there is no uncertainty"
FEW = "fewer than twice as many samples as unknowns: fitted with normal errors, since no outlier can be told from noise"


@dataclass(frozen=True, eq=False)
class Maximum:
    """A vector of unknowns with the derivatives (N, size) of the predictions and the noise of each channel there.

    ``used``: degrees of freedom that the data spent.
    """

    model: OutputError
    theta: np.ndarray
    slopes: np.ndarray
    sigma: np.ndarray
    used: float
    iterations: int
    message: str = ""
    objectives: tuple[float, ...] = ()
    """Minus the log posterior where the search from each start ended."""

    def estimate(self) -> Estimate:
        """The answer; without uncertainty, and said so, where the data leave a parameter open."""
        covariance, cost = self.model.covariance(self.slopes, self.sigma), Cost(self.iterations, self.iterations)
        message = "; ".join(part for part in (self.message, OPEN if covariance is None else "") if part)
        found = estimate_at(self.model, self.theta, covariance, self.used, cost, message)
        sigma = np.maximum(self.sigma, SIGMA_FLOOR * self.model.rms)
        return replace(found, traces=ends(self.model, self.theta, self.slopes, sigma, self.objectives))


def with_student_errors(found: Maximum, fineness: Fineness) -> Maximum:
    """The maximum with Student t errors near one with normal errors, its motion integrated as finely."""
    model, one = found.model, np.zeros(1, int)
    if model.data.size < 2 * model.size:
        return replace(found, message="; ".join(part for part in (found.message, FEW) if part))
    batch = Batch((model,))
    if not model.system.linear:
        batch = Stepped.rough((model,), fineness).refined(one, found.theta[None], found.sigma[None])

    def look(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        point = batch.point(one, theta[None])
        return point.predicted[0], point.slopes[0]

    fit = student_fit(model, look, found.theta)
    iterations = found.iterations + fit.iterations
    if not fit.settled:
        raise NoEstimate(UNSETTLED, cost=Cost(iterations, iterations))
    return Maximum(model, fit.theta, fit.slopes, fit.sigma, fit.used, iterations, found.message)
