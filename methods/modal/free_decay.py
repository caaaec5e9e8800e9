"""The common frame of methods that read k/m and c/m of one mass off its free decay, without a search.

A method brings one function, from displacements to (k/m, c/m) of many data sets at once. The rest is here: which
problems are a free decay, the covariance, and the answer. An initial state is not used even where it is known: that is
what these methods are like.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import Estimate, Problem, Scope, Status
from methods.modal.overdamped import real_decays
from methods.modal.realisation import step_of
from methods.regression.equation import Regression
from methods.regression.identifier import RegressionIdentifier, answer, bootstrap_covariances
from methods.starts.search_range import unevenness

GROWS = "the vibration grows: c/m came out negative; take a record with more decay above its noise"
NO_COVARIANCE = (
    "most synthetic records of this noise could not be read, so there is no uncertainty: do not trust the value; "
    "take a longer record or less noise"
)
POOR = 0.5
"""A response that leaves more than this part of the mean square of the data unexplained is said to be poor."""
POOR_FIT = (
    "the best response of its k/m and c/m leaves more than half of the record unexplained: do not trust them; "
    "take a record with less noise"
)
LEAST, LEAST_WITH_OFFSET = 5, 7
"""Samples for poles: amplitude and rate of each exponential, an offset, and one or two for the noise."""


@dataclass(frozen=True, eq=False)
class Decays:
    """Free decays as they were read: ``groups`` (sets, 2), k/m and c/m, at times (n,), whether about an ``offset``.

    ``centres`` (sets, n) are their responses from the best start, NaN where they overflow; ``noise`` (sets,) is the
    standard deviation of the data about them with N - 4 degrees of freedom (N - 5 with an offset).
    """

    times: np.ndarray
    groups: np.ndarray
    centres: np.ndarray
    noise: np.ndarray
    offset: bool


class FreeDecayIdentifier(RegressionIdentifier):
    """A method for the free decay of one mass; the uncertainty is a bootstrap's where ``spread`` gives none."""

    scope: ClassVar[Scope] = Scope(offsets=True, forced=False, nonlinear=False, max_dof=1)
    uses_start = False
    unreadable: ClassVar[str]
    """The sentence for a record that ``read`` makes nothing of."""
    most_samples: ClassVar[float] = np.inf

    @abstractmethod
    def read(self, times: np.ndarray, sets: np.ndarray, offset: bool) -> np.ndarray:
        """Read k/m and c/m (sets, 2), NaN where there are none, off displacements (sets, n) at times (n,).

        ``offset``: an unknown constant is in them.
        """

    def spread(self, decays: Decays) -> np.ndarray:
        """Compute covariances (sets, 2, 2) of k/m and c/m; NaN where the bootstrap is to find them."""
        return np.full((len(decays.groups), 2, 2), np.nan)

    def objection(self, problem: Problem) -> str | None:
        kinds = sorted(p.kind for p in problem.system.parameters)
        other = (
            None if kinds == ["damping", "mass", "stiffness"] else "it needs one mass, one damping and one stiffness"
        )
        return super().objection(problem) or other

    def fit(self, regression: Regression, rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Read the decays of all problems at once, and of their synthetic records."""
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
            # an unstable estimate is given as it is: dropping it would drop the unlucky half of the noise
            said = [GROWS] * bool(of_problem[1] <= 0) + [NO_COVARIANCE] * (cov is None and self.bootstrap > 0)
            # the resting level is found too, and costs a degree of freedom
            unknowns = np.append(of_problem[order], np.zeros(int(offset)))
            ordered = cov if cov is None else cov[np.ix_(order, order)]
            answers.append(answer(regression, unknowns, ordered, "; ".join(said or [POOR_FIT] * bool(is_poor))))
        return answers

    def _covariances(
        self, regression: Regression, decays: Decays, rngs: Sequence[np.random.Generator]
    ) -> list[np.ndarray | None]:
        """Compute covariances of k/m and c/m; None where there is none."""
        if not self.bootstrap:
            return [None] * len(rngs)
        covariances = [cov if np.all(np.isfinite(cov)) else None for cov in self.spread(decays)]
        known = np.all(np.isfinite(decays.centres), axis=1)
        left = [i for i, cov in enumerate(covariances) if cov is None and known[i]]
        drawn = bootstrap_covariances(
            regression[np.array(left, int)],
            [decays.centres[None, left]],
            [decays.noise[None, left]],
            lambda data: self.read(decays.times, data.values[0][0], decays.offset),
            [rngs[i] for i in left],
            self.bootstrap,
        )
        for i, cov in zip(left, drawn, strict=True):
            covariances[i] = cov
        return covariances


class PoleIdentifier(FreeDecayIdentifier):
    """A method that reads poles off even samples: where these are not a damped mass's, two real decays may be.

    Version 2: where noise turns the fast pole of an overdamped decay, two real poles are fitted.
    """

    version: ClassVar[int] = 2

    @abstractmethod
    def poles_read(self, sets: np.ndarray, step: float, offset: bool) -> np.ndarray:
        """Read k/m and c/m (sets, 2) off displacements (sets, n) at a step of time; NaN where there are none."""

    def read(self, times: np.ndarray, sets: np.ndarray, offset: bool) -> np.ndarray:
        groups = self.poles_read(sets, step_of(times), offset)
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
            return f"it needs at least {least} samples a record; sample it faster"
        if channel.n > self.most_samples:
            return f"it takes at most {self.most_samples} samples a record; thin a longer one"
        return unevenness(channel.times)


def has_offset(data: Problem | Regression) -> bool:
    """Decide whether the one sensor adds an unknown constant."""
    return data.records[0].channels[0].offset


def groups_order(regression: Regression) -> list[int]:
    """Number k/m and c/m in the system's own order of its groups; its own inverse, being of two."""
    stiffness = next(p.name for p in regression.system.parameters if p.kind == "stiffness")
    return [0, 1] if regression.numerators[0] == stiffness else [1, 0]
