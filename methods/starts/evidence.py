"""How probable a basin of the posterior is: the Laplace approximation of its evidence.

``max posterior × sqrt(det covariance)``, the noise at its best value and the initial state uniform (D. J. C. MacKay,
Information Theory, Inference, and Learning Algorithms, 2003, chapter 27). The best fit may be a narrow basin, and the
most probable one another.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench import OutputError
from methods.starts.candidates import screening
from methods.starts.separate import APART

ROUNDS, ITERATIONS = 2, 12
"""Of fit and noise in turn, and steps of each fit, from every start."""


@dataclass(frozen=True, eq=False)
class Basins:
    """Separate maxima of a posterior, best first: ``thetas`` (n, size), slopes (n, N, size), residuals (n, N).

    ``evidence`` (n,): the logarithm, up to a constant.
    """

    thetas: np.ndarray
    slopes: np.ndarray
    residuals: np.ndarray
    evidence: np.ndarray

    @property
    def weights(self) -> np.ndarray:
        """The probability of each."""
        weights = np.exp(self.evidence - np.max(self.evidence))
        return np.asarray(weights / weights.sum())


def basins(model: OutputError, starts: np.ndarray) -> Basins:
    """The maxima at which searches from ``starts`` (n, size) end, of those whose covariance the data and prior give."""
    quick = screening(model)
    thetas = quick.settle(starts, ROUNDS, ITERATIONS)
    predicted, slopes = quick.jacobian(thetas)
    residuals = model.data - predicted
    profiles = np.array([quick.profile_of(theta, left) for theta, left in zip(thetas, residuals, strict=True)])
    kept: list[int] = []
    evidence = []
    for i in map(int, np.argsort(profiles)):
        logs = thetas[i, : len(model.free)]
        if not np.isfinite(profiles[i]) or any(np.max(np.abs(logs - thetas[j, : logs.size])) < APART for j in kept):
            continue
        value = _log_evidence(model, profiles[i], slopes[i], residuals[i])
        if np.isfinite(value):
            kept.append(i)
            evidence.append(value)
    return Basins(thetas[kept], slopes[kept], residuals[kept], np.array(evidence))


def log_evidence(model: OutputError, theta: np.ndarray) -> float:
    """The logarithm of the evidence about a maximum, up to a constant; minus infinity where it has no covariance."""
    predicted, slopes = model.jacobian(theta)
    residuals = model.data - predicted
    return _log_evidence(model, model.profile_of(theta, residuals), slopes, residuals)


def _log_evidence(model: OutputError, profile: float, slopes: np.ndarray, residuals: np.ndarray) -> float:
    covariance = model.covariance(slopes, model.noise(residuals, 0.0)) if np.isfinite(profile) else None
    return -np.inf if covariance is None else float(-0.5 * profile + 0.5 * np.linalg.slogdet(covariance)[1])


def most_probable(model: OutputError, starts: list[np.ndarray]) -> list[np.ndarray]:
    """The end of most evidence alone, of searches from these starts; the starts where none has any."""
    ends = basins(model, np.stack(starts)) if starts else None
    return starts if ends is None or not ends.evidence.size else [ends.thetas[int(np.argmax(ends.evidence))]]
