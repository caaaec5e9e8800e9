"""Recursive least squares with forgetting.

Each equation ``y = phi' theta + e`` is a Kalman update of constant parameters in units of the noise; dividing the
covariance by a forgetting factor discounts earlier equations (L. Ljung, System Identification, 2nd ed. 1999, section
11.2). The variance of the noise follows from the residuals.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from bench import Layout, Tracker


class LeastSquaresTracker(Tracker):
    """Tracker of ``theta`` (q,) with covariance over the noise variance ``inverse`` (q, q).

    ``power``: weighted sum of squared residuals; ``weight``: sum of the weights of all equations.
    """

    state_names: ClassVar[tuple[str, ...]] = ("theta", "inverse", "power", "weight")

    def __init__(self, layout: Layout, unknowns: int) -> None:
        super().__init__(layout)
        self.theta, self.inverse = np.zeros(unknowns), np.zeros((unknowns, unknowns))
        self.power = self.weight = 0.0

    def forget(self, keep: float) -> None:
        """Discount earlier equations by a forgetting factor, for the parameters and for the noise variance."""
        self.inverse = self.inverse / keep
        self.forget_noise(keep)

    def forget_noise(self, keep: float) -> None:
        """Discount earlier residuals by a forgetting factor, for the noise variance alone."""
        self.power, self.weight = keep * self.power, keep * self.weight

    def learn(self, phi: np.ndarray, left: float) -> None:
        """Update by an equation with regressors ``phi`` (q,) and prediction error ``left``."""
        gain_direction = self.inverse @ phi
        total = 1.0 + float(phi @ gain_direction)
        self.theta = self.theta + gain_direction * (left / total)
        inverse = self.inverse - np.outer(gain_direction / total, gain_direction)
        self.inverse = 0.5 * (inverse + inverse.T)
        self.weight += 1.0
        if self.weight > self.theta.size + 1:  # the first residuals come from the diffuse prior
            self.power += left**2 / total

    @property
    def variance(self) -> float | None:
        """Return the variance of the noise; None where the equations do not determine it."""
        spare = self.weight - self.theta.size
        return self.power / spare if spare >= 2 and self.power > 0 else None
