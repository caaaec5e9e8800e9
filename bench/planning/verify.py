"""A proposed test, simulated: whether real estimates from it are as near as it was to give."""

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
"""Median size of a normal error, over its standard deviation."""


def simulated(
    likely: Likely,
    decay: Decay,
    quantity: str,
    method: Identifier,
    number: int,
    report: Callable[[], object],
    times: np.ndarray | None = None,
) -> np.ndarray:
    """Errors of the logarithm of a quantity in so many simulated free decays, each of a likely oscillator.

    Samples are at ``times`` in place of the even ones, where these are given. Infinite where the method has no
    estimate, or one that is not positive.
    """
    at = decay.times if times is None else times

    def clean(own: Oscillator) -> np.ndarray:
        return motion(own, at, (decay.amplitude, 0.0))[0]

    return _errors(likely, quantity, method, number, report, at, clean, ())


def simulated_forced(
    likely: Likely,
    test: ForcedTest,
    force: np.ndarray,
    quantity: str,
    method: Identifier,
    number: int,
    report: Callable[[], object],
) -> np.ndarray:
    """The same of tests under a measured force (n,), over mass and noise; from rest, which is not told."""

    def clean(own: Oscillator) -> np.ndarray:
        return displacement(own, test, force)

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
    """Errors of the logarithm of a quantity by a method, (number,), from clean motions with unit noise."""
    system, rng = make_system("sdof", {}), np.random.default_rng(0)
    exponents = QUANTITIES[quantity]
    found = np.full(number, np.inf)
    for i in range(number):
        own = likely.oscillators[int(rng.integers(len(likely.oscillators)))]
        values = clean(own) + rng.standard_normal(times.size)
        problem = Problem(system, (Record((Channel(times, values),), forces),))
        estimate = method.identify(problem, np.random.default_rng(i))
        true = (own.omega**2, 2.0 * own.damping_ratio * own.omega)
        groups = [estimate.marginal(system.quantity(name)) for name in ("k_over_m", "c_over_m")]
        logs = [
            exponent * math.log(marginal.value / t) if marginal is not None and marginal.value > 0 else math.inf
            for exponent, marginal, t in zip(exponents, groups, true, strict=True)
            if exponent  # a damping that is found to be 0 says nothing against the stiffness
        ]
        found[i] = abs(sum(logs))
        report()
    return found


def reached(errors: np.ndarray, wanted: float) -> float:
    """The share of simulated tests within :data:`WITHIN` times the wanted error."""
    return float(np.mean(errors <= WITHIN * wanted))


def counted(errors: np.ndarray) -> float:
    """The standard deviation that simulated errors had, were they normal: by their median size."""
    return float(np.median(errors)) / NORMAL
