"""Simulation of a proposed test, to compare actual errors of a method with the expected ones."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from bench.contract.method import Identifier
from bench.contract.problem import Channel, Force, Problem, Record
from bench.planning.forced_test import ForcedTest, displacement
from bench.planning.free_decay import QUANTITIES, Decay, Oscillator, motion
from bench.planning.search import WITHIN, Likely
from bench.systems import make_system

NORMAL = 0.6745
"""Median absolute value of a normal error over its standard deviation."""


def simulate_decays(
    likely: Likely,
    decay: Decay,
    quantity: str,
    method: Identifier,
    number: int,
    report: Callable[[], object],
    times: np.ndarray | None = None,
) -> np.ndarray:
    """Return the errors of a method in simulated free decays of likely oscillators.

    Args:
        likely: Prior knowledge of the oscillator.
        decay: The test.
        quantity: One of :data:`QUANTITIES`.
        method: The method.
        number: Number of simulated tests.
        report: Called after each test.
        times: Sampling times, s; by default those of ``decay``.

    Returns:
        Absolute errors of the logarithm of the quantity, (number,); infinite if the estimate is missing or not
        positive.
    """
    grid = decay.times if times is None else times

    def clean(oscillator: Oscillator) -> np.ndarray:
        return motion(oscillator, grid, (decay.amplitude, 0.0))[0]

    return _errors(likely, quantity, method, number, report, grid, clean, ())


def simulate_forced_tests(
    likely: Likely,
    test: ForcedTest,
    force: np.ndarray,
    quantity: str,
    method: Identifier,
    number: int,
    report: Callable[[], object],
) -> np.ndarray:
    """Return the errors of a method in simulated tests with a measured ``force`` (n,); see :func:`simulate_decays`."""

    def clean(oscillator: Oscillator) -> np.ndarray:
        return displacement(oscillator, test, force)

    return _errors(likely, quantity, method, number, report, test.times, clean, (Force(test.times, force),))


def _errors(
    likely: Likely,
    quantity: str,
    method: Identifier,
    number: int,
    report: Callable[[], object],
    times: np.ndarray,
    clean: Callable[[Oscillator], np.ndarray],
    forces: tuple[Force, ...],
) -> np.ndarray:
    """Return the absolute errors of the logarithm of a quantity, (number,), for noise of unit variance."""
    system, rng = make_system("sdof", {}), np.random.default_rng(0)
    exponents = QUANTITIES[quantity]
    result = np.full(number, np.inf)
    for i in range(number):
        oscillator = likely.oscillators[int(rng.integers(len(likely.oscillators)))]
        values = clean(oscillator) + rng.standard_normal(times.size)
        problem = Problem(system, (Record((Channel(times, values),), forces),))
        estimate = method.identify(problem, np.random.default_rng(i))
        true = (oscillator.omega**2, 2.0 * oscillator.damping_ratio * oscillator.omega)
        groups = [estimate.marginal(system.quantity(name)) for name in ("k_over_m", "c_over_m")]
        logs = [
            exponent * math.log(marginal.value / t) if marginal is not None and marginal.value > 0 else math.inf
            for exponent, marginal, t in zip(exponents, groups, true, strict=True)
            if exponent  # an estimated damping of 0 must not affect the stiffness alone
        ]
        result[i] = abs(sum(logs))
        report()
    return result


def share_within(errors: np.ndarray, required: float) -> float:
    """Return the share of simulated tests with an error within :data:`WITHIN` times the required standard deviation."""
    return float(np.mean(errors <= WITHIN * required))


def robust_deviation(errors: np.ndarray) -> float:
    """Estimate the standard deviation of simulated errors from their median absolute value."""
    return float(np.median(errors)) / NORMAL
