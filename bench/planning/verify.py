"""A proposed test, simulated: whether real estimates from it are as near as it was to give."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from bench.contract.method import Identifier
from bench.contract.problem import Channel, Problem, Record
from bench.planning.free_decay import QUANTITIES, Decay, motion
from bench.planning.search import WITHIN, Likely
from bench.systems import make_system


def simulated(
    likely: Likely,
    decay: Decay,
    quantity: str,
    method: Identifier,
    number: int,
    report: Callable[[], object],
    times: np.ndarray | None = None,
) -> np.ndarray:
    """Errors of the logarithm of a quantity in so many simulated tests, each of an oscillator as likely as it is known.

    Samples are at ``times`` in place of the even ones, where these are given. Infinite where the method has no
    estimate, or one that is not positive.
    """
    system, rng = make_system("sdof", {}), np.random.default_rng(0)
    exponents = QUANTITIES[quantity]
    found, at = np.full(number, np.inf), decay.times if times is None else times
    for i in range(number):
        own = likely.oscillators[int(rng.integers(len(likely.oscillators)))]
        values = motion(own, at, (decay.amplitude, 0.0))[0] + rng.standard_normal(at.size)
        problem = Problem(system, (Record((Channel(at, values),)),))
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
