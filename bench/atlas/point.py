"""A free-decay test as six dimensionless numbers, and the scenario that they stand for."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass

import numpy as np

from bench.errors import InputError
from bench.scenario.scenario import Scenario

GROUPS = ("k_over_m", "c_over_m")
"""What a free decay tells: squared natural frequency, and twice damping ratio times natural frequency."""


@dataclass(frozen=True)
class Point:
    """A test.

    ``samples`` over ``cycles`` undamped periods, both ends included; ``damping_ratio``; ``snr_db``: mean square of the
    clean samples over the noise's variance; ``phase`` (rad): of the start, ``x0 = A cos(phase)`` and
    ``v0 = -A omega sin(phase)``; ``start_known``: whether a method is told it.
    """

    samples: int
    cycles: float
    damping_ratio: float
    snr_db: float
    phase: float
    start_known: bool

    def __post_init__(self) -> None:
        for name in ("cycles", "damping_ratio"):
            if not 0 < getattr(self, name) < math.inf:
                raise InputError(f"atlas.{name}", getattr(self, name), "a positive number")

    def scenario(self) -> Scenario:
        """The test on a mass of some size at some frequency, which follow from the point.

        No method may profit from a mass of 1 kg or a frequency of 1 rad/s, so both are drawn: within a factor of ten of
        1 kg, 1 Hz and 1 mm, from a random stream that the point's numbers seed.
        """
        exponents = self._stream().uniform(-1.0, 1.0, 3)
        mass, omega, amplitude = 10.0**exponents * np.array([1.0, 2.0 * math.pi, 1e-3])
        start = (amplitude * math.cos(self.phase),), (-amplitude * omega * math.sin(self.phase),)
        return Scenario(
            "sdof",
            {"m": float(mass), "c": float(2.0 * self.damping_ratio * omega * mass), "k": float(omega**2 * mass)},
            (tuple(map(float, start[0])), tuple(map(float, start[1]))),
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

    def _stream(self) -> np.random.Generator:
        words = np.frombuffer(np.array(astuple(self), float).tobytes(), np.uint32)
        return np.random.default_rng(words)


DENSE = 64
"""Times over the record at which the displacement is scored."""
