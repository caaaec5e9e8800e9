"""Iterated extended Kalman smoother for state and parameters.

Each map is linearised about the mean m, ``f(s) ~ f(m) + F (s - m)``, with F by central differences. The parts common
to it and the unscented filter (joint state, starting points, iteration, noise) are in :mod:`methods.kalman.iteration`.

The extended filter is the oldest method of online structural identification (C. B. Yun, M. Shinozuka, J. Structural
Mechanics 8:187, 1980), iterated over the record since M. Hoshiya, E. Saito (J. Engineering Mechanics 110:1757, 1984).
With a prior as wide as a factor of two in stiffness the linearisation may lose the motion, and later passes do not
recover it; the first pass is therefore linearised about a trajectory from a scan of the data.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bench import Card
from methods.kalman.core import Rule, tangent
from methods.kalman.iteration import IteratedSmoother


@dataclass(frozen=True)
class EKF(IteratedSmoother):
    """Iterated extended Kalman smoother."""

    version: ClassVar[int] = 3
    """3: among several ends the most probable is kept, not the one with the most likely innovations."""
    card: ClassVar[Card] = Card(
        summary="extended Kalman filter and smoother for state and log-parameters, iterated from guesses of a scan",
        start="used when known",
        scale="native",
        reconstruction="own",
        uncertainty="covariance of the last smoothing pass, Student t with N - p degrees of freedom",
        settings_source="guesses and screening of multiple shooting; no process noise, since parameters are "
        "constants; passes until they settle",
        tuning="initial standard deviation without a prior: 3; relaxation of the passes; on development systems "
        "at 200 to 0 dB, damping ratio 0.6-135 %, 1-13 cycles, 5-45 samples",
        title="Extended Kalman filter",
        order=170,
    )

    @property
    def rule(self) -> Rule:
        """Return the linearisation by tangents at the means."""
        return tangent
