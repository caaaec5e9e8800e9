"""Extension of a measured free decay: expected accuracy of a longer record, and of repeated records.

The standard error supported by the record includes more than white noise. For a longer record it is multiplied by the
ratio of the Cramér-Rao bounds of the longer and the measured record, at the identified parameters, with unknown initial
state and offset.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench.planning.free_decay import QUANTITIES, Oscillator, errors, motion

LONGEST = 20.0
"""Largest proposed duration over that of the record."""


@dataclass(frozen=True, eq=False)
class MeasuredDecay:
    """A measured free decay with its identified parameters.

    ``times``: times of the samples from the first one (s), (n,); ``oscillator``: identified parameters; ``start``:
    initial displacement and velocity; ``sigma``: standard deviation of the noise; ``supported``: standard error of the
    logarithm of each quantity that the record supports.
    """

    times: np.ndarray
    oscillator: Oscillator
    start: tuple[float, float]
    sigma: float
    supported: Mapping[str, float]

    @property
    def interval(self) -> float:
        """Sampling interval (s)."""
        return float(np.median(np.diff(self.times)))

    @property
    def duration(self) -> float:
        """Time from the first to the last sample (s)."""
        return float(self.times[-1] - self.times[0])

    def extended(self, factor: float) -> np.ndarray:
        """Return the times of a record of ``factor`` times the duration, at the same sampling rate."""
        more = math.floor((factor - 1.0) * self.duration / self.interval + 1e-9)
        return np.concatenate([self.times, self.times[-1] + self.interval * np.arange(1, more + 1)])

    def bounds(self, times: np.ndarray) -> dict[str, float]:
        """Return the bound on the standard error of each logarithm for samples at ``times``."""
        _, derivatives = motion(self.oscillator, times, self.start)
        derivatives = np.concatenate([derivatives, np.ones((times.size, 1))], axis=1) / self.sigma
        return errors(derivatives.T @ derivatives)

    @cached_property
    def now(self) -> dict[str, float]:
        """The bounds of the measured record."""
        return self.bounds(self.times)

    def expected(self, factor: float) -> dict[str, float]:
        """Return the expected standard error of each logarithm for ``factor`` times the duration."""
        bounds = self.bounds(self.extended(factor))
        return {name: self.supported[name] * bounds[name] / self.now[name] for name in QUANTITIES}

    def repeated(self, number: int) -> dict[str, float]:
        """Return the expected standard error of each logarithm for ``number`` similar records."""
        return {name: error / math.sqrt(number) for name, error in self.supported.items()}

    def factor_for(self, quantity: str, error: float) -> float | None:
        """Return the smallest factor on the duration for a required standard error; None above :data:`LONGEST`."""
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
        """Return the number of similar records for a required standard error."""
        return max(1, math.ceil((self.supported[quantity] / error) ** 2 - 1e-9))


def initial_state(oscillator: Oscillator, times: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """Estimate displacement and velocity at time 0 by linear least squares, together with an offset."""
    _, derivatives = motion(oscillator, times)
    columns = np.concatenate([derivatives[:, 2:], np.ones((times.size, 1))], axis=1)
    scale = np.linalg.norm(columns, axis=0)
    solution = np.linalg.lstsq(columns / scale, values, rcond=None)[0] / scale
    return float(solution[0]), float(solution[1])
