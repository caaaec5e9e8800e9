"""Hausman's test of a regression against the output-error estimate.

A regression on differentiated samples has a bias that its bootstrap does not show: from coarse sampling, from noise
amplified by differentiation (in a second difference at step h as 1/h², so faster sampling makes it worse), and from
smoothing of a fast decay. The output-error estimate, whose simulated response fits the record best, has none of these
biases and is efficient; where it lies outside the regression's interval, the regression is biased (J. A. Hausman,
Econometrica 46:1251, 1978). The estimate then gets a warning; if even its order of magnitude is wrong, it is rejected.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import stdtrit

from bench import Linearisation, StepLimits, minimise
from methods.regression.equation import Regression
from methods.regression.smoothing import SplineFits

ROUNDS, NONLINEAR_ROUNDS = 8, 3
"""Iterations of the search from the spline estimate, for linear and for nonlinear systems."""
RELATIVE_STEP = 1e-4
"""Relative step of an unknown for differentiating the response."""
LARGEST_STEP, LARGEST = 0.9, 100.0
"""Largest relative change of an unknown in one step, and in all."""
LEVEL = 0.975
"""Quantile of the interval that must cover the output-error estimate."""
HOPELESS = 10.0
"""An estimate is rejected if its stiffness exceeds the output-error estimate by this factor and its interval."""


def most_likely(regression: Regression, fits: SplineFits) -> np.ndarray:
    """Compute the output-error estimates (problems, d), starting from spline fits.

    NaN where the splines fit nothing. Unknown initial states and offsets are fitted within each response.
    """
    d = len(regression.names)
    first = np.where(fits.explained[:, None], fits.unknowns[:, :d], np.nan)

    def evaluate(cases: np.ndarray, relative: np.ndarray) -> Linearisation:
        """Compute misfit over noise at ``relative`` times the first unknowns, and its slopes by differences."""
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
    return first * end.point.unknowns


def bias_warnings(
    regression: Regression, unknowns: np.ndarray, covariances: Sequence[np.ndarray | None], fits: SplineFits
) -> list[tuple[str, bool]]:
    """Test the unknowns (problems, q) of each problem; return a warning, empty if passed, and whether to reject them.

    They are rejected where a stiffness (or k/m) is more than ``HOPELESS`` times the output-error estimate.
    """
    likely = most_likely(regression, fits)
    return [_bias_warning(regression, *of_problem) for of_problem in zip(unknowns, covariances, likely, strict=True)]


def _bias_warning(
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
            f"dominated by differentiated noise: {name} is {worst:.0f} times the value whose response fits the "
            "record best; decimate or smooth the samples (ls_spline), or use an output-error method"
        )
        return sentence, True
    i = int(np.argmax(errors))
    sentence = (
        f"biased estimate: {regression.names[i]} is {mean[i] / likely[i]:.2f} times the value whose response fits "
        f"the record best, a difference of {errors[i]:.1f} standard errors; the bias is due to differentiation"
    )
    return sentence, False
