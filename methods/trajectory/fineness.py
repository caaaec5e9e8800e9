"""How many Runge-Kutta steps an interval between two cuts is given: as many as frequency and noise call for.

The error over a record is kept below what is allowed (:func:`methods.starts.rough.radians_a_step`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench import OutputError, fastest_rates
from methods.starts.rough import radians_a_step

SUBSTEPS = np.array([1, 2, 3, *(n * 2**i for i in range(5) for n in (4, 6)), 128])
"""Numbers of steps in an interval: few, so that few programmes are built."""
MAX_SUBSTEPS = int(SUBSTEPS[-1])
ROUGH_RADIANS = 0.4
"""Steps where starts are compared, in radians of the fastest rate: they err by a part in 5000 of the phase."""
ROUGHLY = 64
"""At most so many steps there: a motion that is faster than that is no start anyway."""
DIFFERENCE = 1e-6
"""Step of the differences by which rates are found, in natural units."""


@dataclass(frozen=True)
class Fineness:
    """An integration may err by ``least`` of the motion, or by ``noise_share`` of the standard error of the data."""

    least: float
    noise_share: float

    def substeps(
        self,
        model: OutputError,
        longest: float,
        theta: np.ndarray,
        states: Sequence[np.ndarray],
        sigma: np.ndarray,
        rms: np.ndarray,
    ) -> np.ndarray:
        """Steps in the longest interval for a final answer near each of the vectors ``theta``.

        Args:
            model: of the problem, or of one of the problems of one layout.
            longest: interval between two cuts of its records.
            theta: shape (cases, size).
            states: by record, displacements and velocities at its start, each of shape (cases, 2 n_dof).
            sigma: noise of each channel without a floor, shape (cases, channels).
            rms: size of each channel, of the same shape.

        Returns:
            Their numbers, shape (cases,).
        """
        relative = np.min(sigma / rms, axis=1) / np.sqrt(model.channel_of.size)
        allowed = np.maximum(self.least, self.noise_share * relative)
        rates = fastest_of(model, theta, states)
        duration = max(record.duration for record in model.problem.records)
        radians = [radians_a_step(a, w * duration) for a, w in zip(allowed, rates, strict=True)]
        return _up(longest * np.maximum(rates, 1e-9) / np.array(radians))


def roughly(model: OutputError, longest: float, theta: np.ndarray, states: Sequence[np.ndarray]) -> np.ndarray:
    """Steps in the longest interval for comparing starts; arguments and result as those of :class:`Fineness`."""
    wanted = longest * fastest_of(model, theta, states) / ROUGH_RADIANS
    return _up(np.minimum(wanted, ROUGHLY))


def fastest_of(model: OutputError, theta: np.ndarray, states: Sequence[np.ndarray]) -> np.ndarray:
    """The fastest rate of the system at rest and at the starts of all records, each case by itself; shape (cases,)."""
    p = model.parameters(theta)
    rates = [fastest_rates(model.system, p, state.T, DIFFERENCE) for state in states]
    return np.asarray(np.fmax.reduce(np.concatenate(rates), axis=0, initial=0.0))


def _up(wanted: np.ndarray) -> np.ndarray:
    """The least of the numbers of steps that are at least those wanted."""
    return np.asarray(SUBSTEPS[np.searchsorted(SUBSTEPS, np.minimum(wanted, MAX_SUBSTEPS))])
