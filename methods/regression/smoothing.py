"""The choice of smoothing by the simulated responses of the estimates.

With few samples per cycle the likelihood of a spline alone treats the vibration as noise. Therefore each smoother and
weight gives an estimate, each estimate a simulated response, and the response of largest likelihood determines the
smoothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench import NoEstimate, Status
from methods.regression.derivatives import WEIGHTS, smoothing_spline
from methods.regression.equation import Regression, solve

SMOOTHERS = ((3, 1), (3, 2), (4, 1), (4, 2))
"""Smoothing splines compared: order of the penalised derivative, and samples left out at each end.

Degrees are 5 and 7. Derivatives of a natural spline are wrong at the ends of a record and are not used.
"""
NEARBY = np.array([-4, -2, 0, 2, 4])
"""Steps on the grid of weights compared for a bootstrap sample, about the selected weight."""
TRIED, TRIED_AGAIN = len(SMOOTHERS) * WEIGHTS, len(SMOOTHERS) * NEARBY.size
"""Numbers of splines compared for a data set, and for a bootstrap sample."""
FEW_SAMPLES, MANY_SAMPLES = 120, 1000
"""Above these numbers of samples, bootstrap samples keep the smoothing, and fewer weights are compared."""
MEANINGLESS = 0.9
"""A response is not accepted if its misfit exceeds this fraction of the data's variance."""


@dataclass(frozen=True, eq=False)
class SplineFits:
    """Regressions on smoothing splines, one per data set.

    ``unknowns`` (sets, q), with the spline of index ``smoother`` (sets,) at the weight of index ``weight`` (sets,).
    ``centres`` (n_dof, sets, n) per record: responses at the unknowns. ``noise`` (n_dof, sets) per record: standard
    deviations of the data about them. ``explained`` (sets,): False where no response is accepted; the centre is then
    the most likely spline.
    """

    unknowns: np.ndarray
    smoother: np.ndarray
    weight: np.ndarray
    centres: list[np.ndarray]
    noise: list[np.ndarray]
    explained: np.ndarray


def spline_fits(regression: Regression) -> SplineFits:
    """Regress on splines of each smoother and weight; keep the estimate whose response fits the record best."""
    smoothers = _usable(regression)
    # integrating a nonlinear system or a long record is slow: fewer weights
    quick = regression.system.linear and max(t.size for t in regression.times) <= MANY_SAMPLES
    weights = np.arange(0, WEIGHTS, 1 if quick else 3)
    unknowns, deviance, responses = _tried(regression, smoothers, np.tile(weights, (regression.sets, 1)))
    sets, best = np.arange(regression.sets), np.argmin(deviance, axis=1)
    centres = [x[:, sets, best] for x in responses]
    noise = [
        np.sqrt(np.sum((centre - y) ** 2, axis=-1) / _residual_freedom(regression, i))
        for i, (centre, y) in enumerate(zip(centres, regression.values, strict=True))
    ]
    smoother, weight = np.array(smoothers)[best // weights.size], weights[best % weights.size]
    fits = SplineFits(unknowns[sets, best], smoother, weight, centres, noise, np.isfinite(deviance[sets, best]))
    for i in np.flatnonzero(~fits.explained):
        _take_likely_spline(regression, fits, int(i), smoothers[0])
    return fits


def solved_on_splines(regression: Regression, smoother: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Solve for the unknowns (sets, q), each set on the spline of indices ``smoother`` and ``weight`` (sets,)."""
    groups = [np.flatnonzero(smoother == number) for number in np.unique(smoother)]
    solutions = []
    for sets in groups:
        motions = regression[sets].splines(SMOOTHERS[smoother[sets[0]]], weight[sets])
        solutions.append(solve(*regression.equations(motions)))
    return np.concatenate(solutions)[np.argsort(np.concatenate(groups))]


def smoothing_again(drawn: Regression, fits: SplineFits) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of smoother and weight, both (sets,), for synthetic data, equally many sets per problem.

    For a linear system and few samples, smoothing is selected again by the simulated response, among all smoothers and
    nearby weights; otherwise that of the fit is kept.
    """
    of_fit = np.repeat(np.arange(len(fits.weight)), drawn.sets // len(fits.weight))
    smoother, weight = fits.smoother[of_fit], fits.weight[of_fit]
    if not drawn.system.linear or max(t.size for t in drawn.times) > FEW_SAMPLES:
        return smoother, weight
    smoothers = _usable(drawn)
    nearby = np.clip(weight[:, None] + NEARBY, 0, WEIGHTS - 1)
    deviance = _tried(drawn, smoothers, nearby)[1]
    each, best = np.arange(drawn.sets), np.argmin(deviance, axis=1)
    chosen = fits.explained[of_fit] & np.isfinite(deviance[each, best])
    new_smoother, new_weight = np.array(smoothers)[best // NEARBY.size], nearby[each, best % NEARBY.size]
    return np.where(chosen, new_smoother, smoother), np.where(chosen, new_weight, weight)


def _usable(regression: Regression) -> list[int]:
    """Return the indices of the smoothers that the shortest record allows; raise NoEstimate where there is none."""
    shortest = min(t.size for t in regression.times)
    usable = [i for i, (order, trim) in enumerate(SMOOTHERS) if shortest > max(order, 2 * trim)]
    if not usable:
        needed = min(order for order, _ in SMOOTHERS) + 1
        raise NoEstimate(f"its smoothing spline requires at least {needed} samples per record", Status.UNSUPPORTED)
    return usable


def _tried(
    regression: Regression, smoothers: Sequence[int], weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Solve with every smoother at the weights of indices (sets, w); the candidates are ordered by smoother.

    Returns:
        Unknowns (sets, candidates, q); their deviance (sets, candidates), minus twice the log-likelihood of the
        response with the noise of each channel unknown, ``sum n log(mean squared misfit)``, infinite where a response
        is not accepted; the responses (n_dof, sets, candidates, n) per record.
    """
    sets, tried = weights.shape
    repeated = regression.repeated(tried)
    solutions = [solve(*regression.equations(repeated.splines(SMOOTHERS[i], weights.ravel()))) for i in smoothers]
    unknowns = np.concatenate([solution.reshape(sets, tried, -1) for solution in solutions], axis=1)
    count = unknowns.shape[1]
    trials = regression.repeated(count)
    responses, deviance = trials.responses(unknowns.reshape(sets * count, -1)), np.zeros(sets * count)
    for x, y in zip(responses, trials.values, strict=True):
        with np.errstate(all="ignore"):
            square, power = np.mean((x - y) ** 2, axis=-1), np.var(y, axis=-1)
            deviance += np.sum(y.shape[-1] * np.log(np.maximum(square, 1e-28 * power)), axis=0)
            deviance = np.where(np.all(square < MEANINGLESS * power, axis=0), deviance, np.inf)
    return unknowns, deviance.reshape(sets, count), [x.reshape(len(x), sets, count, -1) for x in responses]


def _residual_freedom(regression: Regression, number: int) -> float:
    """Return the residual degrees of freedom of each channel of a record, given equal shares of the fitted ones."""
    record, n_dof = regression.records[number], regression.system.n_dof
    shared = len(regression.names) / (len(regression.records) * n_dof)
    of_record = (2 if regression.starts[number] is None else 0) + sum(c.offset for c in record.channels) / n_dof
    return float(max(1.0, record.n / n_dof - shared - of_record))


def _take_likely_spline(regression: Regression, fits: SplineFits, place: int, smoother: int) -> None:
    """Select the smoothing by the likelihood of the spline alone, where no response is accepted."""
    numbers = []
    for times, y, centres, noise in zip(regression.times, regression.values, fits.centres, fits.noise, strict=True):
        spline = smoothing_spline(times, SMOOTHERS[smoother][0])
        weights, noise[:, place] = spline.likely_weights(y[:, place])
        centres[:, place] = spline.motion(spline.fit(y[:, place], weights), times).x
        numbers.append(np.flatnonzero(np.isin(spline.weights, weights)))
    fits.smoother[place], fits.weight[place] = smoother, int(np.median(np.concatenate(numbers)))
    only = np.array([place])
    fits.unknowns[place] = solved_on_splines(regression[only], fits.smoother[only], fits.weight[only])[0]
