"""A test of an oscillator as a few dimensionless numbers, and the scenario that they stand for."""

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
"""What every test may tell: squared natural frequency, and twice damping ratio times natural frequency."""
SIZED = Axis("samples", 8, 500, "logarithmic")
DAMPED = Axis("damping_ratio", 5e-4, 1.2, "logarithmic")
NOISY = Axis("snr_db", -5.0, 60.0)
DENSE = 64
"""Times over the record at which the displacement is scored."""


@dataclass(frozen=True)
class Point(ABC):
    """A test.

    ``samples`` over ``cycles`` undamped periods, both ends included; ``damping_ratio``; ``snr_db``: mean square of the
    clean samples over the noise's variance. What else there is to a kind of test, its class says; in ``AXES`` and
    ``CHOICE`` the box of all tests, in ``QUANTITIES`` what is scored against a bound.
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
        """The test on an oscillator of some size, which follows from the point."""

    @property
    @abstractmethod
    def aliased(self) -> bool:
        """Whether the samples leave open which of several frequencies it is."""

    def numbers(self) -> list[float]:
        """All that the test is, as numbers."""
        return [float(value) for value in astuple(self)]

    def _oscillator(self) -> tuple[dict[str, float], float, float]:
        """Parameters, undamped natural frequency (rad/s) and size of the motion (m).

        No method may profit from a mass of 1 kg or a frequency of 1 rad/s, so all are drawn: within a factor of ten of
        1 kg, 1 Hz and 1 mm, from a random stream that the point's numbers seed.
        """
        words = np.frombuffer(np.array(self.numbers(), float).tobytes(), np.uint32)
        exponents = np.random.default_rng(words).uniform(-1.0, 1.0, 3)
        mass, omega, size = map(float, 10.0**exponents * np.array([1.0, 2.0 * math.pi, 1e-3]))
        return {"m": mass, "c": 2.0 * self.damping_ratio * omega * mass, "k": omega**2 * mass}, omega, size


@dataclass(frozen=True)
class FreeDecay(Point):
    """A motion without a force.

    ``phase`` (rad): of the start, ``x0 = A cos(phase)`` and ``v0 = -A omega sin(phase)``; ``start_known``: whether a
    method is told it. A start that is turned by half a cycle is the same motion upside down.
    """

    phase: float
    start_known: bool

    AXES: ClassVar[tuple[Axis, ...]] = (
        SIZED, Axis("cycles", 0.3, 100.0, "logarithmic"), DAMPED, NOISY, Axis("phase", 0.0, math.pi),
    )  # fmt: skip
    CHOICE: ClassVar[AxisValues] = AxisValues("start_known", (True, False))
    QUANTITIES: ClassVar[tuple[str, ...]] = GROUPS

    def scenario(self) -> Scenario:
        """The decay, the start told or not."""
        parameters, omega, amplitude = self._oscillator()
        start = (amplitude * math.cos(self.phase),), (-amplitude * omega * math.sin(self.phase),)
        return Scenario(
            "sdof",
            parameters,
            start,
            self.snr_db,
            duration=float(2.0 * math.pi * self.cycles / omega),
            samples=self.samples,
            initial_state="known" if self.start_known else "unknown",
            dense=DENSE,
        )

    @property
    def aliased(self) -> bool:
        """Whether the natural frequency is at or above half the sampling rate: a slower motion then fits as well."""
        return 2.0 * self.cycles >= self.samples - 1
