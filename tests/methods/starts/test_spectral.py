"""Starts and derivatives that several methods share: aliases of a coarse sampling, and what tells the scale."""

from __future__ import annotations

import numpy as np
import pytest

from bench import Channel, InitialState, OutputError, Prior, Problem, Record, measurements
from bench.systems import SDOF
from methods.starts.candidates import screened
from methods.trajectory.shooting import Shooting

STEP = 0.5
FAST, SLOW = 1.3 * np.pi / STEP, 0.7 * np.pi / STEP
"""rad/s; cos(1.3 π n) = cos(2 π n - 1.3 π n) = cos(0.7 π n): undamped, from rest, both go through the same samples."""


def coarse(nominal_stiffness: float) -> Problem:
    """25 samples of the fast motion, of a mass of 1 kg with hardly any damping, noise of 1 %, start told."""
    system, start = SDOF(), InitialState(np.array([1.0]), np.array([0.0]))
    times = STEP * np.arange(25)
    clean = measurements(system, {"m": 1.0, "c": 1e-6, "k": FAST**2}, start, Record((Channel(times, times),)))
    values = clean + np.random.default_rng(4).normal(0.0, 0.01, times.size)
    prior = Prior({"m": 1.0, "c": 0.01, "k": nominal_stiffness}, {"m": 0.02, "c": 1.0, "k": 0.3})
    return Problem(system, (Record((Channel(times, values),), initial_state=start),), prior)


@pytest.mark.parametrize("nominal", [0.9 * FAST, 1.1 * FAST, 1.1 * SLOW, 0.9 * SLOW])
def test_of_two_frequencies_through_the_same_samples_the_prior_says_which(nominal: float) -> None:
    """The stiffnesses differ by a factor of 3.4, four standard deviations of the prior's; each nominal is near one."""
    nearer = min((FAST, SLOW), key=lambda rate: abs(np.log(rate / nominal)))
    problem = coarse(nominal**2)
    marginal = Shooting().identify(problem, np.random.default_rng(0)).marginal(problem.system.quantity("k_over_m"))
    assert marginal.value == pytest.approx(nearer**2, rel=0.01)


def test_where_the_prior_is_in_two_minds_both_are_starts_and_what_the_sampling_resolves_is_first() -> None:
    """The nominal stiffness is half a standard deviation nearer to the fast one's than to that of the slow one."""
    middle = np.log(FAST * SLOW) + 0.25 * 0.3
    units = coarse(np.exp(middle)).natural_units()
    model = OutputError(coarse(np.exp(middle)).expressed_in(units))
    rates = [np.sqrt(np.exp(theta[2] - theta[0])) / units.time for _, theta in screened(model)]
    assert rates[:2] == pytest.approx([SLOW, FAST], rel=0.01)


def test_500_cycles_leave_the_scale_to_the_prior() -> None:
    """Raised together, m, c and k change nothing in free vibration: only the prior, of precision Σ 1/sd², tells them.

    The phase tells k/m to one part in 10^6, so that an error of the derivatives of that size would pass for knowledge
    of the mass. The log-ratios are told so well that all three move as one.
    """
    system, start = SDOF(), InitialState(np.array([1.0]), np.array([0.0]))
    p = {"m": 1.0, "c": 0.0057, "k": 8.0}
    times = np.linspace(0.0, 1110.0, 5000)
    clean = measurements(system, p, start, Record((Channel(times, times),)))
    sds = {"m": 0.02, "c": 1.0, "k": 0.5}
    problem = Problem(system, (Record((Channel(times, clean),), initial_state=start),), Prior(p, sds))
    model = OutputError(problem.expressed_in(problem.natural_units()))
    _, slopes = model.jacobian(model.prior.log_mean)
    covariance = model.covariance(slopes, 1e-3 * model.rms)
    expected = sum(sd**-2 for sd in sds.values()) ** -0.5
    assert np.sqrt(np.diag(covariance)) == pytest.approx([expected] * 3, rel=0.02)
