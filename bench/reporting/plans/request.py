"""The request that plans of tests share, and how they write errors."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from bench.contract.method import Identifier
from bench.planning.search import Likely

Simulation = Callable[[Identifier, int, Callable[[], object]], np.ndarray]
"""Errors of a test that is simulated: called with a method, a number of tests, and what to call after each."""
TITLES = {"k_over_m": "k/m", "c_over_m": "c/m", "natural_frequency": "frequency", "damping_ratio": "damping ratio"}


@dataclass(frozen=True)
class PlanRequest:
    """A quantity wanted to an ``error`` (of its logarithm), of a likely oscillator, from samples with ``noise`` (m).

    Each proposed test is simulated ``simulations`` times and fitted by ``method``.
    """

    quantity: str
    error: float
    likely: Likely
    noise: float
    method: str
    simulations: int

    @property
    def title(self) -> str:
        """Name the wanted quantity."""
        return TITLES[self.quantity]

    @property
    def median(self) -> str:
        """Say what a percentage is, where more than one oscillator is likely."""
        return ", median over the likely oscillators" if self.likely.in_doubt else ""

    def simulated(self, tests: Sequence[Simulation]) -> list[np.ndarray]:
        """Simulate and fit each test; returns its errors."""
        from bench.engine.progress import counter
        from bench.entrants.registry import make_method

        method, number = make_method(self.method, {}), self.simulations
        with counter("test", number * len(tests)) as advance:
            return [test(method, number, advance) for test in tests]


def percent(value: float) -> str:
    """Write an error in percent; a dash where there is none."""
    shown = 100 * value
    return "-" if not math.isfinite(value) else f"{shown:.0f}" if shown >= 10 else f"{shown:.2g}"
