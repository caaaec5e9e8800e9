"""The choice of smoothing: regressions on splines of many weights, judged by the responses of their estimates.

How much to smooth cannot be seen from the samples alone where a cycle has few of them: the likelihood of a spline
without a system takes such a vibration for noise. The system decides: each smoother and weight gives an estimate, each
estimate a simulated response, and the response of largest likelihood chooses the smoothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench import NoEstimate, Status
from methods.regression.derivatives import WEIGHTS, smoothing_spline
from methods.regression.equation import Regression, solve

SMOOTHERS = ((3, 1), (3, 2), (4, 1), (4, 2))
"""Smoothing splines tried, as (order of the penalised derivative, samples left out at each end).

Degrees are 5 and 7. A natural spline bends wrongly at the ends of a record, so its derivatives there are not used.
"""
NEARBY = np.array([-4, -2, 0, 2, 4])
"""Steps on the grid of weights that a bootstrap sample tries about the chosen one."""
TRIED, TRIED_AGAIN = len(SMOOTHERS) * WEIGHTS, len(SMOOTHERS) * NEARBY.size
"""Splines tried on a data set, and on a bootstrap sample."""
FEW_SAMPLES, MANY_SAMPLES = 120, 1000
"""With more samples than these a bootstrap sample keeps its smoothing, and fewer weights are tried at first."""
MEANINGLESS = 0.9
"""A response that leaves more than this part of the variance of the data unexplained does not describe them."""


@dataclass(frozen=True, eq=False)
class SplineFits:
    """Regressions on smoothing splines, one a data set.

    ``unknowns`` (sets, q) on the spline of number ``smoother`` (sets,) at the weight of number ``weight`` (sets,).
    ``centres`` (n_dof, sets, n) a record are the responses of the unknowns, ``noise`` (n_dof, sets) a record the
    standard deviations of the data about them. Where no response describes the data (``explained``, (sets,), is false),
    the centre is the most likely spline.
    """

    unknowns: np.ndarray
    smoother: np.ndarray
    weight: np.ndarray
    centres: list[np.ndarray]
    noise: list[np.ndarray]
    explained: np.ndarray


def spline_fits(regression: Regression) -> SplineFits:
    """Regress on splines of each smoother and weight; keep the estimate that explains the record best."""
    smoothers = _usable(regression)
    # integrating a nonlinear system, or a long record, takes its time: fewer weights
    quick = regression.system.linear and max(t.size for t in regression.times) <= MANY_SAMPLES
    weights = np.arange(0, WEIGHTS, 1 if quick else 3)
    unknowns, deviance, responses = _tried(regression, smoothers, np.tile(weights, (regression.sets, 1)))
    each, best = np.arange(regression.sets), np.argmin(deviance, axis=1)
    centres = [x[:, each, best] for x in responses]
    noise = [
        np.sqrt(np.sum((centre - y) ** 2, axis=-1) / _left(regression, i))
        for i, (centre, y) in enumerate(zip(centres, regression.values, strict=True))
    ]
    smoother, weight = np.array(smoothers)[best // weights.size], weights[best % weights.size]
    fits = SplineFits(unknowns[each, best], smoother, weight, centres, noise, np.isfinite(deviance[each, best]))
    for i in np.flatnonzero(~fits.explained):
        _take_likely_spline(regression, fits, int(i), smoothers[0])
    return fits


def solved_on_splines(regression: Regression, smoother: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Solve for the unknowns (sets, q), each set on the spline of its numbers ``smoother`` and ``weight`` (sets,)."""
    groups = [np.flatnonzero(smoother == number) for number in np.unique(smoother)]
    solutions = []
    for sets in groups:
        motions = regression[sets].splines(SMOOTHERS[smoother[sets[0]]], weight[sets])
        solutions.append(solve(*regression.equations(motions)))
    return np.concatenate(solutions)[np.argsort(np.concatenate(groups))]


def smoothing_again(drawn: Regression, fits: SplineFits) -> tuple[np.ndarray, np.ndarray]:
    """Choose number of smoother and of weight, both (sets,), for sets drawn like the data, as many of each.

    For a linear system and few samples each set chooses anew, by its simulated response, among all smoothers and the
    weights near the fit's; else the fit's own is kept.
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
    """Number the smoothers that the shortest record can bear; raise NoEstimate where there is none."""
    shortest = min(t.size for t in regression.times)
    usable = [i for i, (order, trim) in enumerate(SMOOTHERS) if shortest > max(order, 2 * trim)]
    if not usable:
        needed = min(order for order, _ in SMOOTHERS) + 1
        raise NoEstimate(f"its smoothing spline needs at least {needed} samples a record", Status.UNSUPPORTED)
    return usable


def _tried(
    regression: Regression, smoothers: Sequence[int], weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Solve with every smoother at the weights of numbers (sets, w): candidates, smoother by smoother.

    Returns:
        Unknowns (sets, candidates, q); their deviance (sets, candidates), minus twice the log-likelihood of the
        response with the noise of each channel unknown, ``sum n log(mean squared misfit)``, infinite for a response
        that describes nothing; the responses (n_dof, sets, candidates, n) a record.
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


def _left(regression: Regression, number: int) -> float:
    """Count the degrees of freedom that a channel of a record keeps when each pays its share of what was fitted."""
    record, n_dof = regression.records[number], regression.system.n_dof
    shared = len(regression.names) / (len(regression.records) * n_dof)
    of_record = (2 if regression.starts[number] is None else 0) + sum(c.offset for c in record.channels) / n_dof
    return float(max(1.0, record.n / n_dof - shared - of_record))


def _take_likely_spline(regression: Regression, fits: SplineFits, place: int, smoother: int) -> None:
    """Fall back on the likelihood of the spline alone where no smoothing gives a response like the data."""
    numbers = []
    for times, y, centres, noise in zip(regression.times, regression.values, fits.centres, fits.noise, strict=True):
        spline = smoothing_spline(times, SMOOTHERS[smoother][0])
        weights, noise[:, place] = spline.likely_weights(y[:, place])
        centres[:, place] = spline.motion(spline.fit(y[:, place], weights), times).x
        numbers.append(np.flatnonzero(np.isin(spline.weights, weights)))
    fits.smoother[place], fits.weight[place] = smoother, int(np.median(np.concatenate(numbers)))
    only = np.array([place])
    fits.unknowns[place] = solved_on_splines(regression[only], fits.smoother[only], fits.weight[only])[0]
