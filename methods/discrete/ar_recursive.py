"""Autoregression of order two by recursive least squares.

The regression is that of ``ar`` (:mod:`methods.discrete.ar`), with its bias, updated sample by sample as in ``rls``
(:mod:`methods.regression.rls`) but without differentiation. The initial values are zero coefficients and a diffuse
covariance, ``diffuse`` times the identity in natural units (displacement of order one). Since the parameters are
constant, the default forgetting factor is 1, and the last estimate equals that of ``ar`` but for the diffuse prior.

The trace ``trajectory`` contains k/m and c/m after each sample from the third (n_samples - 2, 2), NaN where the roots
are not those of an oscillator, ``trajectory_times`` its times (s).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bench import Card, Estimate, Status
from methods.discrete.ar import NO_OSCILLATOR, equations, groups_of
from methods.modal.free_decay import PoleIdentifier, groups_order, has_offset
from methods.modal.realisation import step_of
from methods.regression.equation import Regression
from methods.regression.rls import check_recursion, recursive_least_squares, trajectory_dimensions


@dataclass(frozen=True)
class ARRecursive(PoleIdentifier):
    """Recursive autoregression; ``forgetting`` factor, initial covariance ``diffuse``.

    ``bootstrap``: synthetic records for the covariance, 0 for none.
    """

    bootstrap: int = 100
    forgetting: float = 1.0
    diffuse: float = 1e6

    unreadable: ClassVar[str] = NO_OSCILLATOR
    card: ClassVar[Card] = Card(
        summary="autoregression of order two by recursive least squares, sample by sample",
        start="not used",
        scale="groups",
        reconstruction="simulated",
        uncertainty="covariance of a parametric bootstrap: spread only, not the bias of noisy columns",
        settings_source="forgetting 1: the parameters are constant; diffuse: large against 1, as that of RLS",
        tuning="none",
        title="AR, recursive",
        order=210,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        check_recursion(self.forgetting, self.diffuse)

    def fit(self, regression: Regression, rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Estimate all problems; the recursion is returned as a trace."""
        answers, times = super().fit(regression, rngs), regression.times[0]
        path = self._path(regression.values[0][0], step_of(times), has_offset(regression))[
            ..., groups_order(regression)
        ]
        dimensions = trajectory_dimensions(regression)
        return [
            replace(a, traces={"trajectory": path[:, i], "trajectory_times": times[2:]}, dimensions=dimensions)
            if a.status is Status.OK
            else a
            for i, a in enumerate(answers)
        ]

    def from_poles(self, sets: np.ndarray, step: float, offset: bool) -> np.ndarray:
        return np.array(self._path(sets, step, offset)[-1])

    def _path(self, sets: np.ndarray, step: float, offset: bool) -> np.ndarray:
        """Return k/m and c/m after each sample from the third, (n - 2, sets, 2)."""
        path = recursive_least_squares(*equations(sets, offset), self.forgetting, self.diffuse)
        return groups_of(path, step)
