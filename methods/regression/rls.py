"""Recursive least squares: the finite-difference regression of LS, taken one sample at a time.

The update is the standard one with exponential forgetting (Ljung, System Identification: Theory for the User, 2nd ed.
1999, section 11.2): with row ``φ``, target ``y`` and forgetting factor ``λ``,
``K = P φ / (λ + φᵀ P φ)``, ``θ <- θ + K (y - φᵀ θ)``, ``P <- (P - K φᵀ P) / λ``.
A sample of several degrees of freedom brings several rows; it forgets once. Held is a root S of ``P = S Sᵀ`` (Potter's
form: G. J. Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, chapter II), with ``f = Sᵀ φ`` and
``β = λ + fᵀ f``: ``K = S f / β``, ``S <- (S - K fᵀ / (1 + √(λ/β))) / √λ``. P itself loses half of its
digits on the way from diffuse to known.

It starts from nothing: ``θ = 0`` and a diffuse ``P``, ``diffuse`` times the identity in the problem's natural units
(displacement of order one). The prior does not enter here; the harness combines it with the groups, once. The
forgetting factor is a textbook value for parameters that hardly move; since they do not move at all, any forgetting
costs something: ``forgetting=1`` is the batch LS.

Told: the equations, the samples, the known force. A told start is used in the bootstrap's noise level only. It has the
bias of finite differences, and says so as LS does. No own reconstruction. The uncertainty is a parametric bootstrap's
spread. The trace ``trajectory`` keeps the estimate after each sample (n_samples, n_identified), ``trajectory_times``
its times (s).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from bench import Card, Dimension, Estimate, InputError, Problem, Serves
from methods.regression.bootstrap import TRIED, bootstrap_covariances, spline_fits
from methods.regression.company import Finish, answers_together
from methods.regression.equation import Regression, answer, layout_objection
from methods.regression.hausman import doubt, most_likely
from methods.starts.ambiguity import BandIdentifier


def recursive_least_squares(
    columns: np.ndarray, target: np.ndarray, forgetting: float, diffuse: float, rows_per_sample: int = 1
) -> np.ndarray:
    """Estimates after each sample, (n_samples, sets, q), for columns (sets, rows, q) and target (sets, rows)."""
    sets, rows, q = columns.shape
    theta, root = np.zeros((sets, q)), np.broadcast_to(np.sqrt(diffuse) * np.eye(q), (sets, q, q))
    path = np.empty((rows // rows_per_sample, sets, q))
    with np.errstate(all="ignore"):
        for i in range(rows):
            phi, rate = columns[:, i], forgetting if i % rows_per_sample == 0 else 1.0
            seen = np.sum(root * phi[..., None], axis=1)
            size = rate + np.sum(seen**2, axis=-1, keepdims=True)
            gain = np.sum(root * seen[:, None], axis=-1) / size
            theta = theta + gain * (target[:, i] - np.sum(phi * theta, axis=-1))[:, None]
            shrunk = gain / (1.0 + np.sqrt(rate / size))
            root = (root - shrunk[..., None] * seen[:, None]) / np.sqrt(rate)
            path[i // rows_per_sample] = theta
    return path


@dataclass(frozen=True)
class RLS(BandIdentifier):
    """Recursive least squares with ``forgetting`` (0 to 1) and initial covariance ``diffuse``; see the module."""

    forgetting: float = 0.98
    diffuse: float = 1e6
    bootstrap: int = 100

    card: ClassVar[Card] = Card(
        summary="recursive least squares over finite differences, sample by sample, with a forgetting factor",
        start="used when known",
        scale="groups",
        reconstruction="simulated",
        uncertainty="covariance of a parametric bootstrap: spread only; a bias beyond it (Hausman's test) is said",
        settings_source="forgetting: Ljung, System Identification Toolbox user's guide (typically 0.97 to 0.995)",
        tuning="none",
        title="RLS",
        order=140,
        colour="#999999",
        marker="1",
        paper="rls",
    )
    serves: ClassVar[Serves] = Serves(
        several_records=True, several_channels=True, offsets=True, max_dof=None, added_mass=True
    )

    works_in = "natural units"

    def __post_init__(self) -> None:
        if not 0 < self.forgetting <= 1:
            raise InputError("method.forgetting", self.forgetting, "a number above 0, at most 1")
        if not (self.diffuse > 0 and np.isfinite(self.diffuse)):
            raise InputError("method.diffuse", self.diffuse, "a positive number, large against 1")

    def objection(self, problem: Problem) -> str | None:
        return super().objection(problem) or layout_objection(problem)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate groups, or parameters where the scale is told."""
        return self.estimate_many([problem], [rng])[0]

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Estimate problems of one layout together."""
        return answers_together(problems, rngs, self._solve, max(self.bootstrap, TRIED))

    def _solve(self, regressions: Sequence[Regression], rngs: Sequence[np.random.Generator]) -> Sequence[Finish]:
        joined = Regression.joined(regressions)
        columns, target = joined.finite(joined.values)
        if columns.shape[1] < columns.shape[2]:
            columns = columns * np.nan  # fewer equations than unknowns: the diffuse start would answer
        fits = spline_fits(regressions)
        path = self._path(joined, columns, target)
        covariances = bootstrap_covariances(
            fits, lambda values: self._path(joined, *joined.finite(values))[-1], rngs, self.bootstrap
        )
        return [
            partial(_answer, regression, path[:, i], covariance, likely)
            for i, (regression, covariance, likely) in enumerate(
                zip(regressions, covariances, most_likely(joined, fits), strict=True)
            )
        ]

    def _path(self, regression: Regression, columns: np.ndarray, target: np.ndarray) -> np.ndarray:
        return recursive_least_squares(columns, target, self.forgetting, self.diffuse, regression.system.n_dof)


def _answer(regression: Regression, path: np.ndarray, covariance: np.ndarray | None, likely: np.ndarray) -> Estimate:
    """The last of the estimates (n_samples, q), with all of them as a trace."""
    system = regression.system
    traces = {
        "trajectory": path[:, : len(regression.names)],
        "trajectory_times": np.concatenate([t[1:-1] for t in regression.times]),
    }
    dimensions = {
        "trajectory": [system.dimension(system.quantity(name)) for name in regression.names],
        "trajectory_times": [Dimension(time=1.0)],
    }
    message = doubt(regression, path[-1], covariance, likely)
    return answer(regression, path[-1], covariance, message, traces, dimensions)
