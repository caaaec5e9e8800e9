"""Probabilities of the basins of a posterior by the Laplace approximation of their evidence.

The evidence is ``max posterior × sqrt(det covariance)``, with the noise at its best value and a uniform initial state
(D. J. C. MacKay, Information Theory, Inference, and Learning Algorithms, 2003, chapter 27). The basin of the best fit
may be narrow, and another basin more probable. A basin that leaves an initial state open has no evidence, since its
volume would be infinite: a wave at exactly half the sampling rate has a velocity that no even sample shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench import OutputError, batches
from methods.starts.candidates import screening
from methods.starts.distinct_minima import ALIAS_MARGIN, APART, aliased
from methods.starts.search_range import resolved_cycles
from methods.starts.waves import ORDER

ROUNDS, ITERATIONS = 2, 12
"""Alternations of fit and noise estimation, and iterations of each fit."""
SPARE = 3
"""Samples beyond the number of unknowns above which the noise level is identifiable."""
OPEN = 1e3
"""Standard deviation of an initial state over a generous size of the motion, above which the data leave it open."""
SAME_SDS = 3.0
"""Two ends of searches closer than this many standard deviations are the same maximum."""


def preferred(log_weights: np.ndarray, beyond: np.ndarray) -> int:
    """Return the index of the largest weight; one ``beyond`` half the sampling rate must be clearly larger."""
    return int(np.argmax(log_weights - 0.5 * ALIAS_MARGIN * beyond))


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
        """Return the most probable basin below half the sampling rate, unless one above it is clearly more probable.

        "Clearly" means by the odds of :data:`methods.starts.distinct_minima.ALIAS_MARGIN`.
        """
        return preferred(self.evidence, aliased(model, self.thetas))

    @property
    def weights(self) -> np.ndarray:
        """Return the probability of each basin."""
        weights = np.exp(self.evidence - np.max(self.evidence))
        return np.asarray(weights / weights.sum())


def basins(models: Sequence[OutputError], starts: Sequence[np.ndarray]) -> list[Basins]:
    """Search for the maxima of each problem's posterior from its ``starts`` (n, size), a batch of problems at once.

    Maxima at which data and prior determine no covariance are left out.
    """
    maxima = [Basins(ends, np.zeros((0, 0, 0)), np.zeros((0, 0)), np.zeros(0)) for ends in starts]
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
        limits = [_start_limits(model) for model in quick]
        covariances = [_closed(each, limits[case]) for each, case in zip(covariances, cases, strict=True)]
        enough = batch.channel_of.size > batch.size + SPARE
        evidence = np.array([_log_evidence(*pair, enough) for pair in zip(profiles, covariances, strict=True)])
        for number, i in enumerate(places):
            ends = np.flatnonzero((cases == number) & np.isfinite(evidence))
            kept = _apart(point.theta[:, : len(batch.free)], covariances, ends[np.argsort(profiles[ends])])
            maxima[i] = Basins(point.theta[kept], point.slopes[kept], residuals[kept], evidence[kept])
    return maxima


def _apart(logs: np.ndarray, covariances: Sequence[np.ndarray | None], places: np.ndarray) -> list[int]:
    """Return those of ``places`` (best first) whose log-parameters lie in the basin of no better one."""
    kept = list[int]()
    for i in map(int, places):
        if not any(_same(logs[i] - logs[j], covariances[j]) for j in kept):
            kept.append(i)
    return kept


def _same(distance: np.ndarray, covariance: np.ndarray | None) -> bool:
    """Return True where log-parameters at this distance from a maximum belong to it."""
    if np.max(np.abs(distance)) < APART or covariance is None:
        return True
    return bool(distance @ np.linalg.solve(covariance[: distance.size, : distance.size], distance) < SAME_SDS**2)


def _start_limits(model: OutputError) -> np.ndarray:
    """Return the variances of all unknowns above which data leave an initial state open; infinite for the others.

    A velocity is compared with the motion's size at half the sampling rate, a displacement with that of one cycle in
    the record.
    """
    limits = np.full(model.size, np.inf)
    if model.unknown_starts:
        slow = 2.0 * np.pi / max(record.duration for record in model.problem.records)
        fast = 2.0 * np.pi * max(resolved_cycles(record) for record in model.problem.records)
        orders = np.array([ORDER[channel.measures] for _, channel in model.channels])
        size = float(np.max(model.rms * slow ** (-orders)))
        k, of_record = len(model.free), np.repeat((OPEN * size * np.array([1.0, fast])) ** 2, model.system.n_dof)
        n = of_record.size * len(model.unknown_starts)
        limits[k : k + n] = np.tile(of_record, len(model.unknown_starts))
    return limits


def _closed(covariance: np.ndarray | None, limits: np.ndarray) -> np.ndarray | None:
    """Return a covariance; None where a variance is not below its limit."""
    return covariance if covariance is not None and np.all(np.diag(covariance) < limits) else None


def log_evidence(model: OutputError, theta: np.ndarray) -> float:
    """Return the log-evidence of a maximum up to a constant; minus infinity where it has no covariance."""
    predicted, slopes = model.jacobian(theta)
    residuals = model.data - predicted
    covariance = _closed(model.covariance(slopes, model.noise(residuals, 0.0)), _start_limits(model))
    return _log_evidence(model.profile_of(theta, residuals), covariance, model.data.size > model.size + SPARE)


def _log_evidence(profile: float, covariance: np.ndarray | None, enough: bool) -> float:
    """Count the volume only where ``enough`` samples determine the noise: a perfect fit has a volume of zero."""
    if covariance is None or not np.isfinite(profile):
        return -np.inf
    return float(-0.5 * profile + (0.5 * np.linalg.slogdet(covariance)[1] if enough else 0.0))


def most_probable(model: OutputError, starts: list[np.ndarray]) -> list[np.ndarray]:
    """Return the preferred maximum (:meth:`Basins.first`) of searches from ``starts``, or these where there is none."""
    ends = basins([model], [np.stack(starts)])[0] if starts else None
    return starts if ends is None or not ends.evidence.size else [ends.thetas[ends.first(model)]]
