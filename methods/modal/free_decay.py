"""Base classes of direct methods that estimate k/m and c/m of one mass from its free decay.

A method implements one function, from displacements to (k/m, c/m) of many data sets at once. The base classes check the
problem and compute the covariance and the estimate. A known initial state is not used.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import Estimate, Problem, Scope, Status
from methods.modal.real_decays import real_decays
from methods.modal.realisation import step_of
from methods.regression.equation import Regression
from methods.regression.identifier import RegressionIdentifier, answer, bootstrap_covariances
from methods.starts.search_range import unevenness

GROWS = "the vibration grows: the estimate of c/m is negative; a record with more decay above its noise is required"
NO_COVARIANCE = (
    "most synthetic records with this noise gave no estimate, so no uncertainty is given and the value is unreliable; "
    "a longer record or less noise is required"
)
POOR = 0.5
"""A fit is poor if its residuals exceed this fraction of the data's mean square."""
POOR_FIT = (
    "the response at the estimated k/m and c/m leaves more than half of the record unexplained; the estimate is "
    "unreliable"
)
LEAST, LEAST_WITH_OFFSET = 5, 7
"""Least number of samples: for amplitude and rate of two exponentials, an offset, and the noise."""


@dataclass(frozen=True, eq=False)
class Decays:
    """Estimates from free decays at times (n,): ``groups`` (sets, 2), k/m and c/m; ``offset``: whether one is fitted.

    ``centres`` (sets, n): responses from the fitted initial state, NaN where they overflow. ``noise`` (sets,): standard
    deviation of the data about them with N - 4 degrees of freedom (N - 5 with an offset).
    """

    times: np.ndarray
    groups: np.ndarray
    centres: np.ndarray
    noise: np.ndarray
    offset: bool


class FreeDecayIdentifier(RegressionIdentifier):
    """A method for the free decay of one mass, with a bootstrap covariance where ``spread`` gives none."""

    scope: ClassVar[Scope] = Scope(offsets=True, forced=False, nonlinear=False, max_dof=1)
    uses_start = False
    unreadable: ClassVar[str]
    """Message for a record from which ``read`` gives no estimate."""
    most_samples: ClassVar[float] = np.inf

    @abstractmethod
    def read(self, times: np.ndarray, sets: np.ndarray, offset: bool) -> np.ndarray:
        """Estimate k/m and c/m (sets, 2) from displacements (sets, n) at times (n,); NaN where this fails.

        ``offset``: the displacements contain an unknown constant.
        """

    def spread(self, decays: Decays) -> np.ndarray:
        """Compute covariances (sets, 2, 2) of k/m and c/m; NaN where the bootstrap is to be used."""
        return np.full((len(decays.groups), 2, 2), np.nan)

    def objection(self, problem: Problem) -> str | None:
        kinds = sorted(p.kind for p in problem.system.parameters)
        other = (
            None if kinds == ["damping", "mass", "stiffness"] else "it requires one mass, one damping and one stiffness"
        )
        return super().objection(problem) or other

    def fit(self, regression: Regression, rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Estimate all problems, and their synthetic records, at once."""
        times, y, offset = regression.times[0], regression.values[0][0], has_offset(regression)
        order = groups_order(regression)
        groups = self.read(times, y, offset)
        centres = regression.responses(groups[:, order])[0][0]
        misfit = np.sum((centres - y) ** 2, axis=1)
        noise = np.sqrt(misfit / max(times.size - 4 - int(offset), 1))
        covariances = self._covariances(regression, Decays(times, groups, centres, noise, offset), rngs)
        level = np.mean(y, axis=1, keepdims=True) if offset else 0.0
        poor = ~(misfit <= POOR * np.sum((y - level) ** 2, axis=1))
        answers = []
        for of_problem, cov, is_poor in zip(groups, covariances, poor, strict=True):
            if not np.all(np.isfinite(of_problem)):
                answers.append(Estimate.failed(regression.system, Status.DIVERGED, self.unreadable))
                continue
            # unstable estimates are returned, since dropping them would bias the errors of all others
            messages = [GROWS] * bool(of_problem[1] <= 0) + [NO_COVARIANCE] * (cov is None and self.bootstrap > 0)
            # the estimated offset takes a degree of freedom
            unknowns = np.append(of_problem[order], np.zeros(int(offset)))
            ordered = cov if cov is None else cov[np.ix_(order, order)]
            answers.append(answer(regression, unknowns, ordered, "; ".join(messages or [POOR_FIT] * bool(is_poor))))
        return answers

    def _covariances(
        self, regression: Regression, decays: Decays, rngs: Sequence[np.random.Generator]
    ) -> list[np.ndarray | None]:
        """Compute covariances of k/m and c/m, by ``spread`` or by bootstrap; None where both fail."""
        if not self.bootstrap:
            return [None] * len(rngs)
        covariances = [cov if np.all(np.isfinite(cov)) else None for cov in self.spread(decays)]
        known = np.all(np.isfinite(decays.centres), axis=1)
        remaining = [i for i, cov in enumerate(covariances) if cov is None and known[i]]
        drawn = bootstrap_covariances(
            regression[np.array(remaining, int)],
            [decays.centres[None, remaining]],
            [decays.noise[None, remaining]],
            lambda data: self.read(decays.times, data.values[0][0], decays.offset),
            [rngs[i] for i in remaining],
            self.bootstrap,
        )
        for i, cov in zip(remaining, drawn, strict=True):
            covariances[i] = cov
        return covariances


class PoleIdentifier(FreeDecayIdentifier):
    """A method that estimates poles from even samples, with a fit of two real decays where the poles are invalid.

    Version 2: where noise makes the fast pole of an overdamped decay negative, two real poles are fitted.
    """

    version: ClassVar[int] = 2

    @abstractmethod
    def from_poles(self, sets: np.ndarray, step: float, offset: bool) -> np.ndarray:
        """Estimate k/m and c/m (sets, 2) from displacements (sets, n) at a time step; NaN where this fails."""

    def read(self, times: np.ndarray, sets: np.ndarray, offset: bool) -> np.ndarray:
        groups = self.from_poles(sets, step_of(times), offset)
        lost = ~np.all(np.isfinite(groups), axis=1)
        if np.any(lost):
            groups[lost] = real_decays(times, sets[lost], offset)
        return groups

    def objection(self, problem: Problem) -> str | None:
        return super().objection(problem) or self._sampling_objection(problem)

    def _sampling_objection(self, problem: Problem) -> str | None:
        channel = problem.records[0].channels[0]
        least = LEAST_WITH_OFFSET if channel.offset else LEAST
        if channel.n < least:
            return f"it requires at least {least} samples per record"
        if channel.n > self.most_samples:
            return f"it supports at most {self.most_samples} samples per record; decimate a longer one"
        return unevenness(channel.times)


def has_offset(data: Problem | Regression) -> bool:
    """Return True where the sensor has an unknown offset."""
    return data.records[0].channels[0].offset


def groups_order(regression: Regression) -> list[int]:
    """Return the permutation between (k/m, c/m) and the system's order of its groups."""
    stiffness = next(p.name for p in regression.system.parameters if p.kind == "stiffness")
    return [0, 1] if regression.numerators[0] == stiffness else [1, 0]
