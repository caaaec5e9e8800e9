"""Extended Kalman filter for state and parameters together, iterated: each map is replaced by its tangent.

``f(s) ~ f(m) + F (s - m)`` about the mean m of the belief, F by central differences. What is common to it and the
unscented filter (joint state, starts, iteration, noise) is in :mod:`methods.kalman.iteration`.

The extended filter is the oldest way to identify a structure on line (C. B. Yun, M. Shinozuka, J. Structural Mechanics
8:187, 1980), iterated over the record since M. Hoshiya, E. Saito (J. Engineering Mechanics 110:1757, 1984). A tangent
taken at a belief as wide as a factor of two in stiffness may lose the motion, and then no later pass finds it again:
so the first one is taken about a trajectory that the data's scan suggests.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import EVERY_PROBLEM, Card, Estimate, Problem, Serves
from methods.kalman.core import tangent
from methods.kalman.iteration import Settings, estimate
from methods.starts.ambiguity import SearchingIdentifier


@dataclass(frozen=True)
class EKF(SearchingIdentifier):
    """At most ``passes`` over the record, until no parameter moves by ``tolerance`` of its standard deviation.

    ``drift``: standard deviation of the random walk of a log-parameter over the record (its process noise).
    ``open_sd``: that of a log-parameter at first, where no prior is given.
    """

    passes: int = 30
    tolerance: float = 1e-3
    drift: float = 0.0
    open_sd: float = 1.0

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
        tuning="width of the belief without a prior: 3; relaxation of the passes; on development systems "
        "at 200 to 0 dB, damping ratio 0.6-135 %, 1-13 cycles, 5-45 samples",
        title="Extended Kalman filter",
        order=170,
        colour="#117733",
        marker=(4, 1, 0.0),
    )
    serves: ClassVar[Serves] = EVERY_PROBLEM
    works_in = "natural units"

    def __post_init__(self) -> None:
        self._settings()

    def _settings(self) -> Settings:
        return Settings(self.passes, self.tolerance, self.drift, self.open_sd)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate all parameters, or the groups where nothing tells the scale. Uses no randomness."""
        return estimate(problem, tangent, self._settings())
