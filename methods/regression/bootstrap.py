"""How much to smooth, and how uncertain a regression is: the spline fit, and records drawn like the one at hand.

* :func:`spline_fits` is the regression on smoothing splines of many smoothing weights; the one is kept whose estimate,
  simulated, explains the record best.
* :func:`bootstrap_covariances` makes records like the one at hand and fits them again. The textbook covariance of a
  regression is wrong here: its columns are noisy too (errors in variables), and the noise of differentiated data is
  correlated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from bench import NoEstimate, Record, Status
from methods.regression.derivatives import WEIGHTS, smoothing_spline
from methods.regression.equation import Regression, Values, responses, solve

SMOOTHERS = ((3, 1), (3, 2), (4, 1), (4, 2))
"""Smoothing splines tried, as (order of the penalised derivative, samples left out at each end).

Degrees are 5 and 7. A natural spline bends wrongly at the ends of a record, so its derivatives there are not used.
"""
NEARBY = np.array([-4, -2, 0, 2, 4])
"""Steps on the grid of weights that a bootstrap sample tries about the chosen one."""
TRIED = len(SMOOTHERS) * WEIGHTS
"""Splines tried on a data set."""
TRIED_ANEW = len(SMOOTHERS) * NEARBY.size
"""And on a bootstrap sample."""
FEW_SAMPLES = 120
"""With more samples the smoothing matters little, and a bootstrap sample keeps it as it is."""
MEANINGLESS = 0.9
"""A response that leaves more than this part of the variance of the data unexplained does not describe them."""


class World(Protocol):
    """What synthetic records are drawn from: a response (n_dof, n) a record, and its noise (n_dof,) a record."""

    @property
    def centres(self) -> tuple[np.ndarray, ...]: ...

    @property
    def noise(self) -> tuple[np.ndarray, ...]: ...


@dataclass(frozen=True, eq=False)
class SplineFit:
    """The regression on smoothing splines: unknowns (q,), the smoother and weight used, and what the data look like.

    ``centres`` (n_dof, n) a record is the response that the unknowns give (or, where none describes the data, the most
    likely spline), ``noise`` (n_dof,) a record the standard deviation of the data about it: a bootstrap's world.
    """

    unknowns: np.ndarray
    smoother: tuple[int, int]
    which: int
    centres: tuple[np.ndarray, ...]
    noise: tuple[np.ndarray, ...]
    explained: bool = True


@dataclass(frozen=True, eq=False)
class _Trial:
    """Estimates (sets, candidates, q) on splines, their deviance (sets, candidates), their responses a record."""

    unknowns: np.ndarray
    deviance: np.ndarray
    responses: tuple[np.ndarray, ...]


def _try(regression: Regression, values: Values, smoothers: Sequence[tuple[int, int]], which: np.ndarray) -> _Trial:
    """Every smoother at the weights of numbers ``which`` (sets, w), on displacements (n_dof, sets, n) a record.

    The sets are those of the regression's problems, as many of each, problem by problem.
    The deviance is minus twice the log-likelihood of the simulated response, the noise level of each channel unknown:
    ``sum n log(mean squared misfit)``. It is infinite for a response that describes nothing.
    """
    sets, found = values[0].shape[1], []
    for smoother in smoothers:
        repeated = [np.repeat(y, which.shape[1], axis=1) for y in values]
        unknowns = solve(*regression.splines(repeated, smoother, which.ravel()))
        found.append(unknowns.reshape(sets, which.shape[1], -1))
    candidates = np.concatenate(found, axis=1)
    count = candidates.shape[1]
    p = regression.parameters(candidates.reshape(sets * count, -1))
    simulated, deviance = [], np.zeros(sets * count)
    for record, times, y, told in zip(regression.records, regression.times, values, regression.told, strict=True):
        repeated_y = np.repeat(y, count, axis=1)
        starts = None if told is None else np.repeat(told, sets * count // told.shape[1], axis=1)
        x = responses(regression.system, p, record, repeated_y, _start_guess(times, np.mean(y, axis=1)), starts)
        with np.errstate(all="ignore"):
            square, power = np.mean((x - repeated_y) ** 2, axis=-1), np.var(repeated_y, axis=-1)
            deviance += np.sum(times.size * np.log(np.maximum(square, 1e-28 * power)), axis=0)
            deviance = np.where(np.all(square < MEANINGLESS * power, axis=0), deviance, np.inf)
        simulated.append(x.reshape(x.shape[0], sets, count, -1))
    return _Trial(candidates, deviance.reshape(sets, count), tuple(simulated))


def _start_guess(times: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Displacement and velocity at time 0, (2 n_dof,), by the parabola through the first samples of y (n_dof, n)."""
    polynomial = np.linalg.solve(np.vander(times[:3], increasing=True), y[:, :3].T)
    return np.concatenate([polynomial[0], polynomial[1]])


def spline_fits(regressions: Sequence[Regression]) -> list[SplineFit]:
    """The regressions on splines of each smoother and weight; kept is the one that explains the record best.

    How much to smooth cannot be told from the samples alone where a cycle has few of them (the likelihood of a spline
    without a system takes such a vibration for noise). The system can tell: each smoother and weight gives an
    estimate, each estimate a simulated response, and the response of largest likelihood names the smoothing.
    The problems are of one layout; there is one of them where the system is not linear.
    """
    joined = Regression.joined(regressions)
    usable = _usable(joined)
    # integrating a nonlinear system, or a long record, takes its time: fewer weights
    quick = joined.system.linear and max(t.size for t in joined.times) <= 1000
    which = np.arange(0, WEIGHTS, 1 if quick else 3)
    trial = _try(joined, joined.values, usable, np.tile(which, (len(regressions), 1)))
    return [
        _best(regression, trial, i, [(smoother, int(w)) for smoother in usable for w in which])
        for i, regression in enumerate(regressions)
    ]


def _best(
    regression: Regression, trial: _Trial, number: int, candidates: Sequence[tuple[tuple[int, int], int]]
) -> SplineFit:
    """The fit of one of the problems tried; ``candidates`` are smoothers and numbers of weights."""
    best = int(np.argmin(trial.deviance[number]))
    if not np.isfinite(trial.deviance[number, best]):
        return _unexplained(regression, candidates[0][0])
    centres = tuple(x[:, number, best] for x in trial.responses)
    noise = tuple(
        np.sqrt(np.sum((centre - y[:, 0]) ** 2, axis=-1) / _left(regression, record))
        for record, centre, y in zip(regression.records, centres, regression.values, strict=True)
    )
    return SplineFit(trial.unknowns[number, best], *candidates[best], centres, noise)


def _usable(regression: Regression) -> list[tuple[int, int]]:
    """The smoothers that the shortest record can bear; raises NoEstimate where there is none."""
    usable = [s for s in SMOOTHERS if all(t.size > max(s[0], 2 * s[1]) for t in regression.times)]
    if not usable:
        needed = min(order for order, _ in SMOOTHERS) + 1
        raise NoEstimate(f"its smoothing spline needs at least {needed} samples a record", Status.UNSUPPORTED)
    return usable


def _left(regression: Regression, record: Record) -> float:
    """Degrees of freedom that a channel of a record keeps when each pays its share of what was fitted."""
    n_dof = regression.system.n_dof
    shared = len(regression.names) / (len(regression.records) * n_dof)
    own = (0 if record.initial_state is not None else 2) + sum(c.offset for c in record.channels) / n_dof
    return float(max(1.0, record.n / n_dof - shared - own))


def _unexplained(regression: Regression, smoother: tuple[int, int]) -> SplineFit:
    """No smoothing gives a response like the data: fall back on the likelihood of the spline alone."""
    centres, noise, numbers = [], [], []
    for times, y in zip(regression.times, regression.values, strict=True):
        spline = smoothing_spline(times, smoother[0])
        weights, sd = spline.likely_weights(y[:, 0])
        centres.append(spline.motion(spline.fit(y[:, 0], weights), times).x)
        noise.append(sd)
        numbers.append(np.flatnonzero(np.isin(spline.weights, weights)))
    which = int(np.median(np.concatenate(numbers)))
    unknowns = solve(*regression.splines(regression.values, smoother, np.array([which])))[0]
    return SplineFit(unknowns, smoother, which, tuple(centres), tuple(noise), explained=False)


def spline_refit(regression: Regression, fits: Sequence[SplineFit], values: Values) -> np.ndarray:
    """Unknowns (sets, q) of other data (n_dof, sets, n) a record, each smoothed as :func:`smoothings` says."""
    found = np.full((values[0].shape[1], fits[0].unknowns.size), np.nan)
    chosen = smoothings(regression, fits, values)
    for smoother in set(s for s, _ in chosen):
        mine = np.array([s == smoother for s, _ in chosen])
        which = np.array([w for _, w in chosen])[mine]
        found[mine] = solve(*regression.splines([y[:, mine] for y in values], smoother, which))
    return found


def smoothings(regression: Regression, fits: Sequence[SplineFit], values: Values) -> list[tuple[tuple[int, int], int]]:
    """Smoother and number of the weight for each set of other data (n_dof, sets, n) a record.

    The sets are like the data of the regression's problems, as many of each, problem by problem; ``fits`` are those
    problems'. For a linear system and few samples each set chooses anew, by its simulated response, among all smoothers
    and the weights near the fit's; else the fit's own is kept.
    """
    own = [fit for fit in fits for _ in range(values[0].shape[1] // len(fits))]
    usual = [(fit.smoother, fit.which) for fit in own]
    if not regression.system.linear or max(t.size for t in regression.times) > FEW_SAMPLES:
        return usual
    usable = _usable(regression)
    which = np.clip(np.array([fit.which for fit in own])[:, None] + NEARBY, 0, WEIGHTS - 1)
    deviance = _try(regression, values, usable, which).deviance
    best = np.argmin(deviance, axis=1)
    return [
        (usable[b // NEARBY.size], int(which[i, b % NEARBY.size]))
        if own[i].explained and np.isfinite(deviance[i, b])
        else usual[i]
        for i, b in enumerate(best)
    ]


def bootstrap_covariances(
    fits: Sequence[World], fitter: Callable[[Values], np.ndarray], rngs: Sequence[np.random.Generator], count: int
) -> list[np.ndarray | None]:
    """Covariances (q, q) of what ``fitter`` finds in ``count`` synthetic data sets of each fit.

    The parametric bootstrap (Efron and Tibshirani, An Introduction to the Bootstrap, 1993, section 6.5): records are
    drawn from the response of a fit plus white noise of its misfit, and fitted like the data.
    ``fitter`` maps displacements (n_dof, fits * count, n) a record, fit by fit, to unknowns (fits * count, q). It
    measures spread, not bias. None where too few can be fitted, or none are drawn.
    """
    if not fits or not count:
        return [None] * len(fits)
    drawn = [_drawn(fit, rng, count) for fit, rng in zip(fits, rngs, strict=True)]
    found = fitter([np.concatenate(own, axis=1) for own in zip(*drawn, strict=True)])
    return [_covariance(own) for own in found.reshape(len(fits), count, -1)]


def _drawn(fit: World, rng: np.random.Generator, count: int) -> list[np.ndarray]:
    return [
        centre[:, None] + sd[:, None, None] * rng.standard_normal((centre.shape[0], count, centre.shape[1]))
        for centre, sd in zip(fit.centres, fit.noise, strict=True)
    ]


def _covariance(found: np.ndarray) -> np.ndarray | None:
    """Covariance of what was found (count, q) where finite."""
    count = len(found)
    found = found[np.all(np.isfinite(found), axis=1)]
    if found.shape[0] <= max(found.shape[1] + 1, count // 2):
        return None
    return np.atleast_2d(np.cov(found, rowvar=False))
