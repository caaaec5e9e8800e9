"""Sampling with autoregressive errors: the spread is that of generalised least squares, and it holds the truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.optimize import least_squares
from scipy.signal import lfilter
from scipy.stats import binom

from bench import Channel, Problem, Record
from bench.contract.estimate import Estimate, Status
from bench.systems.sums import sum_from

pytest.importorskip("emcee")
from methods.sampling.mcmc import MCMC

OMEGA, ZETA, RHO, SIZE = 6.0, 0.04, 0.8, 0.05
T = np.linspace(0.0, 10.0, 300)
SYSTEM = sum_from("sdof")
TRUE = {"k_over_m": OMEGA**2, "c_over_m": 2 * ZETA * OMEGA}


def response(theta: np.ndarray) -> np.ndarray:
    """Of k/m, c/m and the amplitudes of cosine and sine, with an offset: the closed form of a damped vibration."""
    k, c, a, b, offset = theta
    damped = np.sqrt(k - c**2 / 4)
    return np.exp(-c * T / 2) * (a * np.cos(damped * T) + b * np.sin(damped * T)) + offset


TRUTH = np.array([TRUE["k_over_m"], TRUE["c_over_m"], 1.0, 0.0, 0.0])


def coloured_noise(seed: int) -> np.ndarray:
    white = np.random.default_rng(seed).standard_normal(700)
    return SIZE * np.sqrt(1 - RHO**2) * np.asarray(lfilter([1.0], [1.0, -RHO], white))[400:]


def problem(seed: int) -> Problem:
    x = response(TRUTH) + coloured_noise(seed)
    return Problem(SYSTEM, (Record((Channel(T, x, offset=True),)),))


def sample(seed: int, likelihood: str) -> Estimate:
    estimate = MCMC(likelihood=likelihood).identify(problem(seed), np.random.default_rng(seed))
    assert estimate.status is Status.OK, estimate.message
    return estimate


def test_value_and_spread_are_those_of_generalised_least_squares() -> None:
    """With the covariance of the noise in full, from a closed form; the colour itself is estimated, so to a fifth."""
    root = np.linalg.inv(np.linalg.cholesky(toeplitz(SIZE**2 * RHO ** np.arange(T.size))))
    data = response(TRUTH) + coloured_noise(1)
    fit = least_squares(lambda theta: root @ (data - response(theta)), TRUTH, x_scale=np.abs(TRUTH) + 0.01)
    covariance = np.linalg.inv(fit.jac.T @ fit.jac)
    computed = sample(1, "autoregressive")
    for i, name in enumerate(TRUE):
        marginal = computed.marginal(SYSTEM.quantity(name))
        low, high = marginal.interval(0.95)
        deviation = np.sqrt(covariance[i, i])
        assert (high - low) / 3.92 == pytest.approx(deviation, rel=0.2)
        assert abs(marginal.value - fit.x[i]) < 0.3 * deviation


@pytest.mark.slow
def test_its_intervals_hold_the_truth_and_those_of_white_errors_do_not() -> None:
    """Of 40 records: as often as right intervals do in all but one of a thousand draws, and white ones far less."""
    covered = {"normal": 0, "autoregressive": 0}
    for seed in range(40):
        for likelihood in covered:
            marginal = sample(seed, likelihood).marginal(SYSTEM.quantity("c_over_m"))
            low, high = marginal.interval(0.95)
            covered[likelihood] += low <= TRUE["c_over_m"] <= high
    assert covered["autoregressive"] >= binom.ppf(0.001, 40, 0.95)
    assert covered["normal"] < binom.ppf(0.001, 40, 0.95)
