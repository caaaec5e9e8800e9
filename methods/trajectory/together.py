"""Many problems of linear systems at once, as multiple shooting solves them one by one.

Where the motion of a linear system is known exactly, multiple shooting and output error have the same maximum of the
same posterior: the states at the cuts are functions of the parameters and the start, and at a solution the joins hold.
What is left of multiple shooting is how it gets there. So the starts of :mod:`methods.starts.candidates` are searched
here by Levenberg-Marquardt with exact derivatives, all problems and starts together, fit and noise in turn by the same
rules. A problem in which any of these searches does not end at a maximum has no answer here: it is left to shooting.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench import SIGMA_FLOOR, Batch, OutputError, Point, layout, used_of
from methods.starts.candidates import candidates
from methods.starts.separate import separate

MOST_ITERATIONS = 60
MOST_AT_ONCE = 1_000_000
"""Derivatives of predictions that are held together, of one start a problem."""
LEFT = 1e-6
"""What a search may still gain where it counts as ended at a maximum, in minus twice the log-posterior."""


@dataclass(frozen=True)
class Rules:
    """How starts are chosen and when fit and noise have settled: the settings of shooting by the same names."""

    starts: int
    screen_iterations: int
    margin: float
    sigma_rounds: int
    sigma_tolerance: float


@dataclass(frozen=True, eq=False)
class Solution:
    """The best maximum of one problem: as shooting's own, with the noise of each channel as the residuals have it."""

    theta: np.ndarray
    slopes: np.ndarray
    sigma: np.ndarray
    used: float
    iterations: int
    first: np.ndarray
    """The first start as the data gave it, before any step."""


def solve_together(models: Sequence[OutputError], rules: Rules) -> list[Solution | None]:
    """The solutions of problems in natural units, in order; None where shooting is to find it."""
    groups: dict[object, list[int]] = {}
    for i, model in enumerate(models):
        if model.system.linear:
            groups.setdefault(layout(model.problem), []).append(i)
    found: list[Solution | None] = [None] * len(models)
    for places in groups.values():
        first = models[places[0]]
        size = max(1, MOST_AT_ONCE // (first.data.size * first.size))
        for at in range(0, len(places), size):
            own = places[at : at + size]
            for i, solution in zip(own, _solve(Batch(tuple(models[i] for i in own)), rules), strict=True):
                found[i] = solution
    return found


def _solve(batch: Batch, rules: Rules) -> list[Solution | None]:
    """The solutions of problems of one layout."""
    starts = _screened(batch, rules)
    return _fitted(batch, starts, rules) if starts.cases.size else [None] * len(batch.models)


def solve_from(model: OutputError, starts: np.ndarray, rules: Rules) -> Solution | None:
    """The solution of one problem from given vectors (starts, size); None where shooting is to find it."""
    own = _Starts(np.zeros(len(starts), int), starts, starts[:1])
    return _fitted(Batch((model,)), own, rules)[0]


@dataclass(frozen=True, eq=False)
class _Starts:
    """What is worth a fit: cases and their vectors, and by problem the first start as the data gave it."""

    cases: np.ndarray
    thetas: np.ndarray
    first: np.ndarray


def _fitted(batch: Batch, starts: _Starts, rules: Rules) -> list[Solution | None]:
    """The best maximum of each problem, where all of its fits end at one."""
    cases, found = starts.cases, list[Solution | None]()
    fits = _settled(batch, cases, starts.thetas, rules)
    for problem in range(len(batch.models)):
        own = np.flatnonzero(cases == problem)
        if not own.size or not np.all(fits.good[own]):
            found.append(None)
            continue
        best = own[np.argmin(fits.profile[own])]
        found.append(
            Solution(
                theta=fits.point.theta[best],
                slopes=fits.point.slopes[best],
                sigma=fits.sigma[best],
                used=float(fits.used[best]),
                iterations=int(fits.iterations[own].sum()),
                first=starts.first[problem],
            )
        )
    return found


def _screened(batch: Batch, rules: Rules) -> _Starts:
    """The starts that are worth a fit after a few output-error steps."""
    vectors = [[model.vector(p) for p in candidates(model, rules.starts + 1)] for model in batch.models]
    cases = np.repeat(np.arange(len(vectors)), [len(own) for own in vectors])
    start = batch.point(cases, np.array([theta for own in vectors for theta in own]).reshape(-1, batch.first.size))
    residuals = batch.data[cases] - start.predicted
    good = np.flatnonzero(np.all(np.isfinite(residuals), axis=1))
    cases = cases[good]
    sigma = batch.noise(cases, residuals[good], np.zeros(good.size), SIGMA_FLOOR)
    settled = batch.search(cases, start.at(good), sigma, rules.screen_iterations).point
    values = batch.profile(cases, settled.theta, batch.data[cases] - settled.predicted)
    kept: list[int] = []
    for problem, model in enumerate(batch.models):
        own = np.flatnonzero(cases == problem)
        best = own[separate(model, values[own], settled.theta[own])[: rules.starts]]
        kept += [i for i in best if values[i] <= values[best[0]] + rules.margin]
    nothing = np.full(batch.first.size, np.nan)
    return _Starts(cases[kept], settled.theta[kept], np.array([own[0] if own else nothing for own in vectors]))


@dataclass(frozen=True, eq=False)
class _Fits:
    """Where each case ended; ``good`` says whether at a maximum."""

    point: Point
    sigma: np.ndarray
    used: np.ndarray
    profile: np.ndarray
    iterations: np.ndarray
    good: np.ndarray


def _settled(batch: Batch, cases: np.ndarray, thetas: np.ndarray, rules: Rules) -> _Fits:
    """Fit and noise in turn, from one vector a case, until the noise settles."""
    point, n = batch.point(cases, thetas), cases.size
    used, iterations = np.full(n, float(batch.first.size)), np.zeros(n, int)
    residuals = batch.data[cases] - point.predicted
    sigma, good = batch.noise(cases, residuals, used, SIGMA_FLOOR), np.ones(n, bool)
    going = np.arange(n)
    for _ in range(rules.sigma_rounds):
        search = batch.search(cases[going], point.at(going), sigma[going], MOST_ITERATIONS)
        _put(point, going, search.point)
        iterations[going] += search.iterations
        good[going] = search.left < LEFT
        _, rows = batch.rows(cases[going], search.point, sigma[going])
        finite = np.all(np.isfinite(rows), axis=(1, 2))
        good[going] &= finite
        used[going[finite]] = used_of(rows[finite], batch.first.data.size)
        residuals[going] = batch.data[cases[going]] - search.predicted
        before = sigma[going]
        sigma[going] = batch.noise(cases[going], residuals[going], used[going], SIGMA_FLOOR)
        moved = np.max(np.abs(np.log(sigma[going] / before)), axis=1)
        going = going[good[going] & (moved >= rules.sigma_tolerance)]
        if not going.size:
            break
    free = batch.noise(cases, residuals, used, 0.0)
    return _Fits(point, free, used, batch.profile(cases, point.theta, residuals), iterations, good)


def _put(point: Point, cases: np.ndarray, new: Point) -> None:
    """Write the values of some cases over those of a point."""
    point.theta[cases], point.predicted[cases], point.slopes[cases] = new.theta, new.predicted, new.slopes
