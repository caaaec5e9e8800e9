"""Extended Kalman filter for state and parameters together, iterated: each map is replaced by its tangent.

``f(s) ~ f(m) + F (s - m)`` about the mean m of the distribution, F by central differences. What is common to it and the
unscented filter (joint state, starting points, iteration, noise) is in :mod:`methods.kalman.iteration`.

The extended filter is the oldest way to identify a structure on line (C. B. Yun, M. Shinozuka, J. Structural Mechanics
8:187, 1980), iterated over the record since M. Hoshiya, E. Saito (J. Engineering Mechanics 110:1757, 1984). A tangent
taken at a distribution as wide as a factor of two in stiffness may lose the motion, and then no later pass finds it
again: so the first one is taken about a trajectory that the data's scan suggests.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bench import Card
from methods.kalman.core import Rule, tangent
from methods.kalman.iteration import IteratedSmoother


@dataclass(frozen=True)
class EKF(IteratedSmoother):
    """The iterated smoother of tangents."""

    version: ClassVar[int] = 3
    """3: of several ends the most probable is kept, as at 0 dB, where innovations prefer a motion that dies at once."""
    card: ClassVar[Card] = Card(
        summary="extended Kalman filter and smoother for state and log-parameters, iterated from starts of a scan",
        start="used when known",
        scale="native",
        reconstruction="own",
        uncertainty="covariance of the last smoothing pass, Student t with N - p degrees of freedom",
        settings_source="starts and screening of multiple shooting; no process noise, since parameters are "
        "constants; passes until they settle",
        tuning="width of the distribution without a prior: 3; relaxation of the passes; on development systems "
        "at 200 to 0 dB, damping ratio 0.6-135 %, 1-13 cycles, 5-45 samples",
        title="Extended Kalman filter",
        order=170,
    )

    @property
    def rule(self) -> Rule:
        """Tangents at the means."""
        return tangent
