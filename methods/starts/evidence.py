"""How probable a basin of the posterior is: the Laplace approximation of its evidence.

``max posterior × sqrt(det covariance)``, the noise at its best value and the initial state uniform (D. J. C. MacKay,
Information Theory, Inference, and Learning Algorithms, 2003, chapter 27). The best fit may be a narrow basin, and the
most probable one another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench import OutputError, batches
from methods.starts.candidates import screening
from methods.starts.separate import ALIAS_MARGIN, APART, aliased

ROUNDS, ITERATIONS = 2, 12
"""Of fit and noise in turn, and steps of each fit, from every start."""
SPARE = 3
"""Samples beyond the unknowns that tell the level of the noise."""
SAME_SDS = 3.0
"""Standard deviations: two ends nearer than this are one, which a search has not quite reached."""


@dataclass(frozen=True, eq=False)
class Basins:
    """Separate maxima of a posterior, best first: ``thetas`` (n, size), slopes (n, N, size), residuals (n, N).

    ``evidence`` (n,): the logarithm, up to a constant.
    """

    thetas: np.ndarray
    slopes: np.ndarray
    residuals: np.ndarray
    evidence: np.ndarray

    def first(self, model: OutputError) -> int:
        """The basin that stands first: the most probable that the sampling resolves, unless one beyond is clearly more.

        ``clearly``: by the odds of :data:`methods.starts.separate.ALIAS_MARGIN`.
        """
        best = int(np.argmax(self.evidence))
        resolved = np.flatnonzero(~aliased(model, self.thetas))
        if not resolved.size:
            return best
        place = int(resolved[np.argmax(self.evidence[resolved])])
        return place if self.evidence[place] + 0.5 * ALIAS_MARGIN >= self.evidence[best] else best

    @property
    def weights(self) -> np.ndarray:
        """The probability of each."""
        weights = np.exp(self.evidence - np.max(self.evidence))
        return np.asarray(weights / weights.sum())


def basins(models: Sequence[OutputError], starts: Sequence[np.ndarray]) -> list[Basins]:
    """Return the separate maxima at which searches from each problem's ``starts`` (n, size) end, those of a batch at
    once; left out are those whose covariance data and prior do not give.
    """
    found = [Basins(own, np.zeros((0, 0, 0)), np.zeros((0, 0)), np.zeros(0)) for own in starts]
    for places in batches(models, [not model.system.linear for model in models]):
        quick = [screening(models[i]) for i in places]
        cases = np.repeat(np.arange(len(places)), [len(starts[i]) for i in places])
        if not cases.size:
            continue
        batch = type(quick[0]).batch(quick)[cases] if quick[0].system.linear else quick[0]
        point = batch.point(batch.settle(np.concatenate([starts[i] for i in places]), ROUNDS, ITERATIONS))
        residuals = batch.data - point.predicted
        profiles = batch.profile_of(point.theta, residuals)
        covariances = batch.covariances(point, batch.noise(residuals, 0.0))
        enough = batch.channel_of.size > batch.size + SPARE
        evidence = np.array([_log_evidence(*pair, enough) for pair in zip(profiles, covariances, strict=True)])
        for number, i in enumerate(places):
            own = np.flatnonzero((cases == number) & np.isfinite(evidence))
            kept = _apart(point.theta[:, : len(batch.free)], covariances, own[np.argsort(profiles[own])])
            found[i] = Basins(point.theta[kept], point.slopes[kept], residuals[kept], evidence[kept])
    return found


def _apart(logs: np.ndarray, covariances: Sequence[np.ndarray | None], places: np.ndarray) -> list[int]:
    """Those of the places, best first, whose log-parameters are no part of a better one's basin."""
    kept = list[int]()
    for i in map(int, places):
        if not any(_same(logs[i] - logs[j], covariances[j]) for j in kept):
            kept.append(i)
    return kept


def _same(distance: np.ndarray, covariance: np.ndarray | None) -> bool:
    """Decide whether log-parameters at this distance from a maximum are in its basin, to where a search may end."""
    if np.max(np.abs(distance)) < APART or covariance is None:
        return True
    return bool(distance @ np.linalg.solve(covariance[: distance.size, : distance.size], distance) < SAME_SDS**2)


def log_evidence(model: OutputError, theta: np.ndarray) -> float:
    """The logarithm of the evidence about a maximum, up to a constant; minus infinity where it has no covariance."""
    predicted, slopes = model.jacobian(theta)
    residuals = model.data - predicted
    covariance = model.covariance(slopes, model.noise(residuals, 0.0))
    return _log_evidence(model.profile_of(theta, residuals), covariance, model.data.size > model.size + SPARE)


def _log_evidence(profile: float, covariance: np.ndarray | None, enough: bool) -> float:
    """Volumes count where ``enough`` samples tell the noise: a perfect fit of few would shrink its own to nothing."""
    if covariance is None or not np.isfinite(profile):
        return -np.inf
    return float(-0.5 * profile + (0.5 * np.linalg.slogdet(covariance)[1] if enough else 0.0))


def most_probable(model: OutputError, starts: list[np.ndarray]) -> list[np.ndarray]:
    """Of the ends of searches from these starts the one that stands first, alone; the starts where there is none."""
    ends = basins([model], [np.stack(starts)])[0] if starts else None
    return starts if ends is None or not ends.evidence.size else [ends.thetas[ends.first(model)]]
