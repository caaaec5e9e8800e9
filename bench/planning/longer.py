"""A free decay that was taken: what it would tell if it had gone on for longer, or were taken again.

The error that the record supports counts more than white noise; how it would fall is by the ratio of Cramér-Rao bounds,
of the longer record and of the one that there is, at what was found in it, start and offset unknown.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench.planning.free_decay import QUANTITIES, Oscillator, errors, motion

LONGEST = 20.0
"""Times its duration, beyond which no record is proposed."""


@dataclass(frozen=True, eq=False)
class Taken:
    """A record: sample ``times`` (s) from its start, what was found, the start (x0, v0), ``sigma`` of its noise.

    ``supported``: by quantity, the standard error of the logarithm that the record supports.
    """

    times: np.ndarray
    oscillator: Oscillator
    start: tuple[float, float]
    sigma: float
    supported: Mapping[str, float]

    @property
    def interval(self) -> float:
        """Between samples, s."""
        return float(np.median(np.diff(self.times)))

    @property
    def duration(self) -> float:
        """First to last sample, s."""
        return float(self.times[-1] - self.times[0])

    def extended(self, factor: float) -> np.ndarray:
        """Times of the record gone on to so many times its duration, at its rate."""
        more = math.floor((factor - 1.0) * self.duration / self.interval + 1e-9)
        return np.concatenate([self.times, self.times[-1] + self.interval * np.arange(1, more + 1)])

    def bounds(self, times: np.ndarray) -> dict[str, float]:
        """The bound on the standard error of each logarithm from samples at ``times``, start and offset unknown."""
        _, derivatives = motion(self.oscillator, times, self.start)
        derivatives = np.concatenate([derivatives, np.ones((times.size, 1))], axis=1) / self.sigma
        return errors(derivatives.T @ derivatives)

    @cached_property
    def now(self) -> dict[str, float]:
        """The bound of the record as it is."""
        return self.bounds(self.times)

    def expected(self, factor: float) -> dict[str, float]:
        """The standard error of each logarithm, if the record had gone on."""
        then = self.bounds(self.extended(factor))
        return {name: self.supported[name] * then[name] / self.now[name] for name in QUANTITIES}

    def repeated(self, number: int) -> dict[str, float]:
        """The same of so many records alike."""
        return {name: error / math.sqrt(number) for name, error in self.supported.items()}

    def factor_for(self, quantity: str, error: float) -> float | None:
        """How many times its duration the record takes until a quantity is told so well; None where it never is."""
        if self.supported[quantity] <= error:
            return 1.0
        low, high = 1.0, LONGEST
        if self.expected(high)[quantity] > error:
            return None
        while high - low > 0.01:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self.expected(middle)[quantity] <= error else (middle, high)
        return high

    def number_for(self, quantity: str, error: float) -> int:
        """How many records alike tell a quantity so well."""
        return max(1, math.ceil((self.supported[quantity] / error) ** 2 - 1e-9))


def start_of(oscillator: Oscillator, times: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """Displacement and velocity at time 0 by least squares, with an offset; the motion is linear in them."""
    _, derivatives = motion(oscillator, times)
    columns = np.concatenate([derivatives[:, 2:], np.ones((times.size, 1))], axis=1)
    scale = np.linalg.norm(columns, axis=0)
    found = np.linalg.lstsq(columns / scale, values, rcond=None)[0] / scale
    return float(found[0]), float(found[1])
