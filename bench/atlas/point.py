"""A vibration test of an oscillator, described by a few dimensionless numbers, and its scenario."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import astuple, dataclass
from typing import ClassVar

import numpy as np

from bench.atlas.axes import Axis, AxisValues
from bench.errors import InputError
from bench.scenario.scenario import Scenario

GROUPS = ("k_over_m", "c_over_m")
"""Quantities of every test: squared natural frequency, and twice the damping ratio times the natural frequency."""
SIZED = Axis("samples", 8, 500, "logarithmic")
DAMPED = Axis("damping_ratio", 5e-4, 1.2, "logarithmic")
NOISY = Axis("snr_db", -5.0, 60.0)
DENSE = 64
"""Number of times at which the displacement is scored."""


@dataclass(frozen=True)
class Point(ABC):
    """A test, with the numbers that all kinds share.

    ``samples``, equally spaced over ``cycles`` undamped periods, both ends included; ``damping_ratio``; ``snr_db``:
    mean square of the noise-free samples over the variance of the noise. A subclass defines ``AXES`` and ``CHOICE``,
    the range of its tests, and ``QUANTITIES``, the quantities that are scored against their bounds.
    """

    samples: int
    cycles: float
    damping_ratio: float
    snr_db: float

    AXES: ClassVar[tuple[Axis, ...]]
    CHOICE: ClassVar[AxisValues]
    QUANTITIES: ClassVar[tuple[str, ...]]

    def __post_init__(self) -> None:
        for name in ("cycles", "damping_ratio"):
            if not 0 < getattr(self, name) < math.inf:
                raise InputError(f"atlas.{name}", getattr(self, name), "a positive number")

    @abstractmethod
    def scenario(self) -> Scenario:
        """Return the scenario of the test, on an oscillator of pseudo-random scale."""

    @property
    @abstractmethod
    def aliased(self) -> bool:
        """True if the samples do not distinguish the natural frequency from another one."""

    def numbers(self) -> list[float]:
        """Return the test as numbers."""
        return [float(value) for value in astuple(self)]

    def _oscillator(self) -> tuple[dict[str, float], float, float]:
        """Return parameters, undamped natural frequency (rad/s) and amplitude of the motion (m).

        They are drawn within a factor of ten of 1 kg, 1 Hz and 1 mm, with the numbers of the point as seed, so that no
        method profits from a mass of 1 kg or a frequency of 1 rad/s.
        """
        words = np.frombuffer(np.array(self.numbers(), float).tobytes(), np.uint32)
        exponents = np.random.default_rng(words).uniform(-1.0, 1.0, 3)
        mass, omega, size = map(float, 10.0**exponents * np.array([1.0, 2.0 * math.pi, 1e-3]))
        return {"m": mass, "c": 2.0 * self.damping_ratio * omega * mass, "k": omega**2 * mass}, omega, size


@dataclass(frozen=True)
class FreeDecay(Point):
    """A free decay.

    ``phase`` (rad) of the initial state ``x0 = A cos(phase)``, ``v0 = -A omega sin(phase)``, up to pi, since a further
    half cycle only changes the sign; ``start_known``: whether the initial state is given to the method.
    """

    phase: float
    start_known: bool

    AXES: ClassVar[tuple[Axis, ...]] = (
        SIZED, Axis("cycles", 0.3, 100.0, "logarithmic"), DAMPED, NOISY, Axis("phase", 0.0, math.pi),
    )  # fmt: skip
    CHOICE: ClassVar[AxisValues] = AxisValues("start_known", (True, False))
    QUANTITIES: ClassVar[tuple[str, ...]] = GROUPS

    def scenario(self) -> Scenario:
        """Return the scenario of the free decay."""
        parameters, omega, amplitude = self._oscillator()
        initial_state = (amplitude * math.cos(self.phase),), (-amplitude * omega * math.sin(self.phase),)
        return Scenario(
            "sdof",
            parameters,
            initial_state,
            self.snr_db,
            duration=float(2.0 * math.pi * self.cycles / omega),
            samples=self.samples,
            initial_state="known" if self.start_known else "unknown",
            dense=DENSE,
        )

    @property
    def aliased(self) -> bool:
        """True if the natural frequency is at or above half the sampling rate, so that a lower one fits equally
        well."""
        return 2.0 * self.cycles >= self.samples - 1
