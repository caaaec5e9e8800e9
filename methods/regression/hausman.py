"""A test of a regression's answer against the most likely one of the same equation.

A regression on differentiated samples has a bias that its bootstrap's spread does not show: of coarse sampling, of
noise that differentiation amplifies (at a step h its part of a second difference grows as 1/h², so a fast sampler makes
it worse), of smoothing a fast decay away. The parameters whose simulated response explains the record best have none of
these biases; where this efficient estimate lies outside the regression's own interval, the regression is biased
(J. A. Hausman, Econometrica 46:1251, 1978). The answer stays the regression's own, with a sentence; where it is not
even of the right order of magnitude it is no estimate.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import stdtrit

from bench import Linearisation, StepLimits, minimise
from methods.regression.equation import Regression
from methods.regression.smoothing import SplineFits

ROUNDS, NONLINEAR_ROUNDS = 8, 3
"""Steps of the search, from the estimate on splines, which is near; fewer where each is integrated."""
RELATIVE_STEP = 1e-4
"""Step of an unknown, relative to its first size, for differentiating the response."""
LARGEST_STEP, LARGEST = 0.9, 100.0
"""Relative change of an unknown in one step, and of all steps."""
LEVEL = 0.975
"""Quantile of the half width of the interval that must cover the most likely value."""
HOPELESS = 10.0
"""A stiffness so many times the most likely one, its bias beyond its interval, is that of the noise."""


def most_likely(regression: Regression, fits: SplineFits) -> np.ndarray:
    """Find the unknowns (problems, d) of the responses that explain the records best, from their spline fits.

    NaN where the splines explain nothing. Unknown starts and offsets are fitted within each response.
    """
    d = len(regression.names)
    first = np.where(fits.explained[:, None], fits.unknowns[:, :d], np.nan)

    def evaluate(cases: np.ndarray, relative: np.ndarray) -> Linearisation:
        """Misfit over noise at ``relative`` times the first unknowns, and its slopes by differences."""
        trials = relative[:, None] + RELATIVE_STEP * np.concatenate([np.zeros((1, d)), np.eye(d)])
        repeated = regression[cases].repeated(d + 1)
        responses = repeated.responses((first[cases, None] * trials).reshape(-1, d))
        misfits = []
        for x, y, noise in zip(responses, repeated.values, fits.noise, strict=True):
            sd = np.maximum(np.repeat(noise[:, cases], d + 1, axis=1), 1e-300)[..., None]
            misfits.append(((x - y) / sd).transpose(1, 0, 2).reshape(cases.size, d + 1, -1))
        misfit = np.concatenate(misfits, axis=2)
        slopes = (misfit[:, 1:] - misfit[:, :1]).swapaxes(1, 2) / RELATIVE_STEP
        return Linearisation.of(relative, misfit[:, 0], slopes)

    start = evaluate(np.arange(len(first)), np.ones_like(first))
    limits = StepLimits(np.full(d, LARGEST_STEP), np.full(d, LARGEST))
    end = minimise(evaluate, start, ROUNDS if regression.system.linear else NONLINEAR_ROUNDS, limits)
    return first * end.at.unknowns


def doubts(
    regression: Regression, unknowns: np.ndarray, covariances: Sequence[np.ndarray | None], fits: SplineFits
) -> list[tuple[str, bool]]:
    """Say why unknowns (problems, q) should not be trusted, and whether they are no estimate; empty where they may be.

    They are none where a stiffness (a group k/m, say) is more than ``HOPELESS`` times the most likely one.
    """
    likely = most_likely(regression, fits)
    return [_doubt(regression, *of_problem) for of_problem in zip(unknowns, covariances, likely, strict=True)]


def _doubt(
    regression: Regression, unknowns: np.ndarray, covariance: np.ndarray | None, likely: np.ndarray
) -> tuple[str, bool]:
    d = len(regression.names)
    mean = unknowns[:d]
    if covariance is None or not np.all(np.isfinite(mean)) or not np.all(np.isfinite(likely)):
        return "", False
    sd = np.sqrt(np.diag(covariance)[:d])
    freedom = max(1, sum(record.n for record in regression.records) - unknowns.size)
    errors = np.abs(mean - likely) / np.where(sd > 0, sd, np.inf)
    biased = errors > stdtrit(freedom, LEVEL)
    if not np.any(biased):
        return "", False
    kinds = {p.name: p.kind for p in regression.system.parameters}
    stiff = np.array([kinds[name] == "stiffness" for name in regression.numerators])
    times = np.abs(mean / likely)
    hopeless = biased & stiff & (times > HOPELESS)
    if np.any(hopeless):
        name, worst = regression.names[int(np.argmax(hopeless))], float(np.max(times[hopeless]))
        sentence = (
            f"differentiation left only noise: {name} came out {worst:.0f} times the value whose response explains the "
            "record best; thin the samples, smooth them (ls_spline), or take a method that simulates"
        )
        return sentence, True
    i = int(np.argmax(errors))
    sentence = (
        f"do not trust it: {regression.names[i]} is {mean[i] / likely[i]:.2f} times the value whose response explains "
        f"the record best, {errors[i]:.1f} of its own standard errors away; differentiation is biased here"
    )
    return sentence, False
