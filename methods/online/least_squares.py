"""Recursive least squares: the Kalman filter of constants, in units of the noise, that forgets.

``y = phi' theta + e``: an equation is the Kalman update by one channel of unit variance, written out because it comes
with every sample; what was learned is forgotten by dividing its covariance (L. Ljung, System Identification, 2nd ed.
1999, section 11.2). The variance of the noise follows from the residuals.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from bench import Layout, Tracker


class LeastSquaresTracker(Tracker):
    """``theta`` (q,) and its covariance over the noise's variance, ``inverse`` (q, q).

    ``power``: weighted sum of squared residuals; ``weight``: of the equations, the sum of what is left of each.
    """

    holds: ClassVar[tuple[str, ...]] = ("theta", "inverse", "power", "weight")

    def __init__(self, layout: Layout, unknowns: int) -> None:
        super().__init__(layout)
        self.theta, self.inverse = np.zeros(unknowns), np.zeros((unknowns, unknowns))
        self.power = self.weight = 0.0

    def forget(self, keep: float) -> None:
        """Keep a part of what was learned of the noise, and in every direction of the parameters."""
        self.inverse = self.inverse / keep
        self.forget_noise(keep)

    def forget_noise(self, keep: float) -> None:
        """Keep a part of what was learned of the noise."""
        self.power, self.weight = keep * self.power, keep * self.weight

    def learn(self, phi: np.ndarray, left: float) -> None:
        """Learn from an equation with slopes (q,) that the parameters so far leave a residual."""
        along = self.inverse @ phi
        total = 1.0 + float(phi @ along)
        self.theta = self.theta + along * (left / total)
        inverse = self.inverse - np.outer(along / total, along)
        self.inverse = 0.5 * (inverse + inverse.T)
        self.weight += 1.0
        if self.weight > self.theta.size + 1:  # a residual of the first equations is the diffuse start's
            self.power += left**2 / total

    @property
    def variance(self) -> float | None:
        """Return the variance of the noise; None where the equations do not determine it."""
        spare = self.weight - self.theta.size
        return self.power / spare if spare >= 2 and self.power > 0 else None
