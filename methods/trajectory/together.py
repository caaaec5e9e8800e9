"""Many problems at once, as multiple shooting solves them one by one.

Where the motion follows from parameters and start, multiple shooting and output error have the same maximum of the same
posterior: the states at the cuts are functions of the parameters and the start, and at a solution the joins hold. What
is left of multiple shooting is how it gets there. So the starts of :mod:`methods.starts.candidates` are searched here
by Levenberg-Marquardt, all problems and starts together, fit and noise in turn by the same rules. Linear systems move
exactly; others by the same Runge-Kutta steps as in shooting (:mod:`methods.trajectory.stepped`), with the derivatives
of these steps. A linear system in which any of these searches does not end at a maximum has no answer here, and another
where the best does not: they are left to shooting.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench import SIGMA_FLOOR, Batch, OutputError, Point, layout, used_of
from methods.trajectory.fineness import Fineness
from methods.trajectory.screened import LONGEST, Screening, Starts, screened_together
from methods.trajectory.stepped import Stepped

MOST_ITERATIONS = 60
MOST_AT_ONCE = 1_000_000
"""Derivatives of predictions that are held together, of one start a problem."""
LEFT = 1e-6
"""What a search may still gain where it counts as ended at a maximum, in minus twice the log-posterior."""
LEFT_AT_KINKS = 1e-3
"""The same where a system bends suddenly: so does its likelihood, and there no step gains what its slopes promise."""


@dataclass(frozen=True)
class Rules:
    """How starts are chosen and when fit and noise have settled: the settings of shooting by the same names."""

    screening: Screening
    sigma_rounds: int
    sigma_tolerance: float
    fineness: Fineness
    """How exactly the motion of a system that is not linear is integrated."""


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
    objectives: tuple[float, ...]
    """Minus the log posterior where the search from each start ended."""


def solve_together(models: Sequence[OutputError], rules: Rules) -> list[Solution | None]:
    """The solutions of problems in natural units, in order; None where shooting is to find it."""
    groups: dict[object, list[int]] = {}
    for i, model in enumerate(models):
        if model.system.linear or all(c.n <= LONGEST for _, c in model.channels):
            groups.setdefault(layout(model.problem), []).append(i)
    found: list[Solution | None] = [None] * len(models)
    for places in groups.values():
        first = models[places[0]]
        size = max(1, MOST_AT_ONCE // (first.data.size * first.size))
        for at in range(0, len(places), size):
            own = places[at : at + size]
            for i, solution in zip(own, _solve(_batch([models[i] for i in own], rules), rules), strict=True):
                found[i] = solution
    return found


def _batch(models: Sequence[OutputError], rules: Rules) -> Batch:
    """Problems of one layout, by the motion that is exact for a linear system, or by steps."""
    return Batch(tuple(models)) if models[0].system.linear else Stepped.rough(models, rules.fineness)


def _solve(batch: Batch, rules: Rules) -> list[Solution | None]:
    """The solutions of problems of one layout."""
    starts = screened_together(batch, rules.screening)
    return _fitted(batch, starts, rules) if starts.cases.size else [None] * len(batch.models)


def solve_from(model: OutputError, starts: np.ndarray, rules: Rules) -> Solution | None:
    """The solution of one problem from given vectors (starts, size); None where shooting is to find it."""
    own = Starts(np.zeros(len(starts), int), starts, starts[:1])
    return _fitted(_batch([model], rules), own, rules)[0]


def _fitted(batch: Batch, starts: Starts, rules: Rules) -> list[Solution | None]:
    """The best maximum of each problem, where all of its fits end at one."""
    cases, found = starts.cases, list[Solution | None]()
    fits = _settled(batch, cases, starts.thetas, rules)
    for problem in range(len(batch.models)):
        own = np.flatnonzero(cases == problem)
        if not _ended(batch, fits, own):
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
                objectives=tuple(map(float, 0.5 * fits.profile[own])),
            )
        )
    return found


def _ended(batch: Batch, fits: _Fits, own: np.ndarray) -> bool:
    """Whether the best of these fits ended at a maximum, and of a linear system all of them did."""
    if not own.size:
        return False
    wanted = own if batch.first.system.linear else own[[np.argmin(fits.profile[own])]]
    return bool(np.all(fits.good[wanted]))


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
    left = LEFT if batch.first.system.linear or batch.first.system.smooth else LEFT_AT_KINKS
    known, n = batch.for_screening(cases, thetas), cases.size
    point = known.point(cases, thetas)
    used, iterations = np.full(n, float(batch.first.size)), np.zeros(n, int)
    residuals = batch.data[cases] - point.predicted
    sigma, good = batch.noise(cases, residuals, used, SIGMA_FLOOR), np.ones(n, bool)
    searched_at = sigma.copy()
    going = np.arange(n)
    for _ in range(rules.sigma_rounds):
        free = batch.noise(cases[going], residuals[going], used[going], 0.0)
        batch = batch.refined(cases[going], point.theta[going], free)
        if batch is not known:
            known = batch
            _put(point, going, batch.point(cases[going], point.theta[going]))
        search = batch.search(cases[going], point.at(going), sigma[going], MOST_ITERATIONS)
        _put(point, going, search.point)
        iterations[going] += search.iterations
        good[going] = search.left < left
        _, rows = batch.rows(cases[going], search.point, sigma[going])
        finite = np.all(np.isfinite(rows), axis=(1, 2))
        good[going] &= finite
        used[going[finite]] = used_of(rows[finite], batch.first.data.size)
        residuals[going] = batch.data[cases[going]] - search.predicted
        before = searched_at[going] = sigma[going]
        sigma[going] = batch.noise(cases[going], residuals[going], used[going], SIGMA_FLOOR)
        moved = np.max(np.abs(np.log(sigma[going] / before)), axis=1)
        # where the answer moves faster than its start did, or fits better, the steps were too long
        free = batch.noise(cases[going], residuals[going], used[going], 0.0)
        unsettled = (moved >= rules.sigma_tolerance) | batch.coarse(cases[going], search.theta, free)
        going = going[good[going] & unsettled]
        if not going.size:
            break
    if batch.first.system.linear:
        residuals = _polished(batch, cases, point, searched_at, np.flatnonzero(good))
    free = batch.noise(cases, residuals, used, 0.0)
    return _Fits(point, free, used, batch.profile(cases, point.theta, residuals), iterations, good)


def _polished(batch: Batch, cases: np.ndarray, point: Point, sigma: np.ndarray, good: np.ndarray) -> np.ndarray:
    """Take one more Gauss-Newton step in the ``good`` cases, kept where it does not lose; returns the residuals of all.

    The search ends where nothing is left to gain; the square of what is left in the unknowns is that little.
    """
    rights, rows = batch.rows(cases[good], point.at(good), sigma[good])
    sizes = np.sqrt(np.sum(rows**2, axis=1)) + 1e-150
    scaled = rows / sizes[:, None]
    transposed = np.swapaxes(scaled, 1, 2)
    hessian = transposed @ scaled + 1e-14 * np.eye(batch.first.size)
    steps = np.linalg.solve(hessian, transposed @ rights[..., None])[..., 0] / sizes
    trial = batch.point(cases[good], point.theta[good] + steps)
    with np.errstate(all="ignore"):
        new = np.sum(batch.rows(cases[good], trial, sigma[good])[0] ** 2, axis=1)
        # rounding must not decide, or an answer would depend on its company
        better = (new <= np.sum(rights**2, axis=1) * (1.0 + 1e-9) + 1e-9) & np.all(
            np.isfinite(trial.slopes), axis=(1, 2)
        )
    _put(point, good[better], trial.at(np.flatnonzero(better)))
    return np.asarray(batch.data[cases] - point.predicted)


def _put(point: Point, cases: np.ndarray, new: Point) -> None:
    """Write the values of some cases over those of a point."""
    point.theta[cases], point.predicted[cases], point.slopes[cases] = new.theta, new.predicted, new.slopes
