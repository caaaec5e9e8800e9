"""Searches by single shooting: fit and noise in turn, from given vectors, linear systems of one layout together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from bench import SIGMA_FLOOR, Batch, InitialState, OutputError, Standardised, layout, used_of
from methods.regression.equation import too_fast
from methods.trajectory.trust_region import TrustRegion, within_reach

MOST_AT_ONCE = 1_000_000
"""Derivatives of predictions that are held together."""
TOGETHER = 0.3
"""The part of the searches that must have ended before the next ones begin: a few at a time would cost as much."""
BAD_START = "the response at the start values is not finite, or too fast; give a prior nearer to the system"
NO_RESPONSE = "the search ran to parameters without a response; give a prior nearer to the system"


@dataclass(frozen=True)
class Searches:
    """At most ``sigma_rounds`` fits, until the noise changes by less than ``sigma_tolerance``.

    Each takes at most ``max_evaluations`` trial steps.
    """

    sigma_rounds: int
    sigma_tolerance: float
    max_evaluations: int

    def ends(self, models: Sequence[OutputError], thetas: Sequence[np.ndarray]) -> list[Found | str]:
        """Where the fits from these vectors end, or a sentence where they cannot."""
        groups: dict[object, list[int]] = {}
        for i, model in enumerate(models):
            groups.setdefault(layout(model.problem) if model.system.linear else i, []).append(i)
        found: dict[int, Found | str] = {}
        for places in groups.values():
            first = models[places[0]]
            size = max(1, MOST_AT_ONCE // (first.data.size * first.size)) if first.system.linear else 1
            for at in range(0, len(places), size):
                own = places[at : at + size]
                found |= zip(own, self._fitted([models[i] for i in own], [thetas[i] for i in own]), strict=True)
        return [found[i] for i in range(len(models))]

    def _fitted(self, models: Sequence[OutputError], thetas: Sequence[np.ndarray]) -> Sequence[Found | str]:
        """Those of linear systems of one layout, or of a single problem."""
        model = models[0]
        if model.system.linear:
            return self._settled_together(Batch(tuple(models)), np.stack(thetas))
        if not np.all(np.isfinite(model.predict(thetas[0]))) or _out_of_reach(model, thetas[0]):
            return [BAD_START]
        try:
            return [self._settled(model, thetas[0])]
        except np.linalg.LinAlgError:
            return [NO_RESPONSE]

    def _settled_together(self, batch: Batch, thetas: np.ndarray) -> list[Found | str]:
        """Fit and noise in turn, of linear systems of one layout: each goes on to its next fit by itself."""
        every, samples = np.arange(len(thetas)), batch.first.data.size
        search = TrustRegion(batch, within_reach(batch, every, thetas), self.max_evaluations)
        used, rounds = np.full(every.size, float(batch.first.size)), np.ones(every.size, int)
        residuals = batch.data - search.predicted
        started = np.all(np.isfinite(residuals), axis=1)
        going = every[started]
        if going.size:
            search.begin(going, batch.noise(going, residuals[going], used[going], SIGMA_FLOOR))
        while (going := going[~search.lost[going]]).size:
            search.step()
            ended = going[search.done[going] & ~search.lost[going]]
            if ended.size <= TOGETHER * going.size:
                continue
            used[ended] = used_of(search.jacobian(ended), samples)
            before = search.sigma[ended]
            sigma = batch.noise(ended, batch.data[ended] - search.predicted[ended], used[ended], SIGMA_FLOOR)
            moved = np.max(np.abs(np.log(sigma / before)), axis=1) >= self.sigma_tolerance
            again = moved & (rounds[ended] < self.sigma_rounds)
            going = np.setdiff1d(going, ended[~again])
            rounds[ended[again]] += 1
            search.begin(ended[again], sigma[again])
        residuals = batch.data - search.predicted
        ends: list[Found | str] = [
            Found(
                theta=search.theta[i],
                residuals=residuals[i],
                slopes=search.slopes[i],
                used=float(used[i]),
                stopped=bool(search.stopped[i]),
                evaluations=int(search.evaluations[i]),
                iterations=int(search.iterations[i]),
            )
            for i in every
        ]
        return [BAD_START if not started[i] else NO_RESPONSE if search.lost[i] else end for i, end in enumerate(ends)]

    def _settled(self, model: OutputError, theta: np.ndarray) -> Found:
        """Fit and noise in turn, from ``theta``."""
        residuals, used = model.data - model.predict(theta), float(model.size)
        evaluations, iterations, stopped = 1, 0, False
        sigma = model.noise(residuals, used)
        for _ in range(self.sigma_rounds):
            aim = _Reachable(model, sigma)
            fit = least_squares(aim.residuals, theta, aim.jacobian, x_scale="jac", max_nfev=self.max_evaluations)
            theta, residuals, used = fit.x, model.data - model.predict(fit.x), _used(fit.jac, model.data.size)
            evaluations += aim.evaluations + 1
            iterations += fit.njev
            stopped = fit.status == 0
            before, sigma = sigma, model.noise(residuals, used)
            if np.max(np.abs(np.log(sigma / before))) < self.sigma_tolerance:
                break
        return Found(theta, residuals, model.jacobian(theta)[1], used, stopped, evaluations, iterations)


@dataclass(frozen=True)
class Found:
    """Where a fit ended, the degrees of freedom that it ``used``, and what it took."""

    theta: np.ndarray
    residuals: np.ndarray
    slopes: np.ndarray
    used: float
    stopped: bool
    evaluations: int
    iterations: int


class _Reachable(Standardised):
    """Standardised residuals, not finite where the motion is too fast for the samples: the step is shortened."""

    def residuals(self, theta: np.ndarray) -> np.ndarray:
        if _out_of_reach(self.model, theta):
            return np.full(self.model.data.size + self.model.penalty(theta).size, np.nan)
        return super().residuals(theta)


def _out_of_reach(model: OutputError, theta: np.ndarray) -> bool:
    """Whether a nonlinear system moves faster than the samples show: its integration would outlast every fit."""
    if model.system.linear:
        return False
    p = {name: value[None] for name, value in model.parameters(theta).items()}
    return any(
        bool(too_fast(record.rig(model.system), p, np.concatenate([s.displacement, s.velocity]), c.times)[0])
        for s, record in zip(_states(model, theta), model.problem.records, strict=True)
        for c in record.channels
        if c.n > 1
    )


def _states(model: OutputError, theta: np.ndarray) -> list[InitialState]:
    return [s if isinstance(s, InitialState) else InitialState(s[0], s[1]) for s in model.starts(theta)]


def _used(slopes: np.ndarray, samples: int) -> float:
    """Degrees of freedom that the data spent: ``trace(H_data H^-1)``, in an orthogonal basis of the slopes."""
    basis, values, _ = np.linalg.svd(slopes, full_matrices=False)
    return float(np.sum(basis[:samples, values > 1e-12 * values[0]] ** 2))
