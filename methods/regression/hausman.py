"""Whether a regression's answer can be trusted: it is held against the most likely one of the same equation.

A regression on differentiated samples has a bias that its bootstrap's spread does not hold: of coarse sampling, of
noise that differentiation amplifies (at a step h its part of a second difference grows as 1/h², so a fast sampler makes
it worse), of smoothing a fast decay away. The record can tell. The parameters whose simulated response
explains it best have none of these biases; where this efficient estimate lies outside the regression's own interval,
the regression is biased (J. A. Hausman, Econometrica 46:1251, 1978). The answer stays the regression's own, with a
sentence; where it is not even of the right order of magnitude it is no estimate.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import stdtrit

from bench import NoEstimate
from methods.regression.bootstrap import SplineFit
from methods.regression.equation import Regression, responses

ROUNDS, NONLINEAR_ROUNDS = 8, 3
"""Levenberg-Marquardt steps, from the estimate on splines, which is near; fewer where each is integrated."""
RELATIVE_STEP = 1e-4
"""Of a group's own size, to differentiate the response by it."""
LEVEL = 0.975
"""Quantile of the half width of the interval that must hold the most likely value."""
HOPELESS = 10.0
"""A stiffness so many times the most likely one, its bias beyond its interval, is that of the noise."""


def most_likely(regression: Regression, fits: Sequence[SplineFit]) -> np.ndarray:
    """The unknowns (problems, d) of the responses that explain joined problems best, from their spline fits.

    NaN where the splines explain nothing. Starts, where they are not told, and offsets are fitted within each response.
    """
    d = len(regression.names)
    theta = np.array([fit.unknowns[:d] for fit in fits])
    theta[[not fit.explained for fit in fits]] = np.nan
    misfit, slopes = _linearised(regression, fits, theta)
    damping = np.full(len(theta), 1e-3)
    for _ in range(ROUNDS if regression.system.linear else NONLINEAR_ROUNDS):
        products = np.einsum("srk,srl->skl", slopes, slopes)
        size = np.einsum("skk->sk", products)
        damped = products + np.eye(d) * (damping[:, None] * size + 1e-300)[..., None]
        healthy = np.all(np.isfinite(damped), axis=(1, 2))
        damped = np.where(healthy[:, None, None], damped, np.eye(d))
        # the steps are fractions of each unknown, so singular means that the response does not change with one
        step = (np.linalg.pinv(damped, hermitian=True) @ np.einsum("srk,sr->sk", slopes, misfit)[..., None])[..., 0]
        tried = theta * (1.0 + np.clip(np.where(healthy[:, None], step, np.nan), -0.9, 9.0))
        new_misfit, new_slopes = _linearised(regression, fits, tried)
        better = np.sum(new_misfit**2, axis=1) < np.sum(misfit**2, axis=1)
        theta = np.where(better[:, None], tried, theta)
        misfit = np.where(better[:, None], new_misfit, misfit)
        slopes = np.where(better[:, None, None], new_slopes, slopes)
        damping = np.where(better, 0.1 * damping, 10.0 * damping)
    return theta


def _linearised(regression: Regression, fits: Sequence[SplineFit], theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Misfit over noise (problems, rows) at unknowns (problems, d), and its slopes by their relative change."""
    sets, d = theta.shape
    trials = theta[:, None] * (1.0 + RELATIVE_STEP * np.concatenate([np.zeros((1, d)), np.eye(d)]))
    p = regression.parameters(trials.reshape(-1, d))
    misfits = []
    rows = zip(regression.records, regression.values, regression.told, strict=True)
    for i, (record, values, told) in enumerate(rows):
        y = np.repeat(values, d + 1, axis=1)
        starts = None if told is None else np.repeat(told, d + 1, axis=1)
        guess = np.concatenate([fits[0].centres[i][:, 0], np.zeros(regression.system.n_dof)])
        noise = np.repeat(np.array([fit.noise[i] for fit in fits]), d + 1, axis=0).T[..., None]
        with np.errstate(all="ignore"):
            x = responses(regression.system, p, record, y, guess, starts)
            misfits.append(((y - x) / np.maximum(noise, 1e-300)).transpose(1, 0, 2).reshape(sets, d + 1, -1))
    misfit = np.concatenate(misfits, axis=2)
    return misfit[:, 0], (misfit[:, :1] - misfit[:, 1:]).swapaxes(1, 2) / RELATIVE_STEP


def doubt(regression: Regression, unknowns: np.ndarray, covariance: np.ndarray | None, likely: np.ndarray) -> str:
    """Why the unknowns (q,) should not be trusted, against the most likely ones (d,); empty where they may be.

    Raises:
        NoEstimate: A stiffness (a group k/m, say) is more than ``HOPELESS`` times the most likely one.
    """
    d = len(regression.names)
    found = unknowns[:d]
    if covariance is None or not np.all(np.isfinite(found)) or not np.all(np.isfinite(likely)):
        return ""
    sd = np.sqrt(np.diag(covariance)[:d])
    freedom = max(1, sum(record.n for record in regression.records) - unknowns.size)
    away = np.abs(found - likely) / np.where(sd > 0, sd, np.inf)
    biased = away > stdtrit(freedom, LEVEL)
    if not np.any(biased):
        return ""
    kinds = {p.name: p.kind for p in regression.system.parameters}
    stiff = np.array([kinds[name] == "stiffness" for name in regression.numerators])
    times = np.abs(found / likely)
    hopeless = biased & stiff & (times > HOPELESS)
    if np.any(hopeless):
        name, worst = regression.names[int(np.argmax(hopeless))], float(np.max(times[hopeless]))
        raise NoEstimate(
            f"differentiation left only noise: {name} came out {worst:.0f} times the value whose response explains the "
            "record best; thin the samples, smooth them (ls_spline), or take a method that simulates"
        )
    i = int(np.argmax(away))
    return (
        f"do not trust it: {regression.names[i]} is {found[i] / likely[i]:.2f} times the value whose response explains "
        f"the record best, {away[i]:.1f} of its own standard errors away; differentiation is biased here"
    )
