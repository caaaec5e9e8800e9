"""Candidate modes for a record that is fitted with one mode but shows several, or an alias."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.contract.modal import FreeDecays, ModalProblem, Mode
from bench.likelihood.autoregression import even_times
from bench.modal.waves import Waves

MOST_OFFERED, LEAST_SHARE = 4, 0.03
"""Largest number of candidate modes, and least share of the signal; weaker modes hardly affect the others."""
MOST_SAMPLES = 20_000
"""Number of first samples that are fitted."""


@dataclass(frozen=True)
class OfferedMode:
    """Mode of a record.

    Attributes:
        frequency: Natural frequency (Hz).
        frequency_low: Lower end of its 95 % interval for this record.
        frequency_high: Upper end.
        damping_ratio: Damping ratio.
        damping_ratio_low: Lower end of its 95 % interval for this record.
        damping_ratio_high: Upper end.
        share: Root mean square of the mode over that of the signal.
        alias: Whether it is an alias, which has the same samples as the mode before it.
    """

    frequency: float
    frequency_low: float
    frequency_high: float
    damping_ratio: float
    damping_ratio_low: float
    damping_ratio_high: float
    share: float
    alias: bool = False


def offered(mode: Mode, degrees: float) -> OfferedMode:
    """Return a mode with intervals of Student's t distribution with ``degrees`` of freedom."""
    from scipy.stats import t as student  # slow to import

    quantile = float(student.ppf(0.975, degrees))
    f, ratio, half, half_ratio = (
        mode.frequency, mode.damping_ratio, quantile * mode.frequency_sd, quantile * mode.damping_ratio_sd,
    )  # fmt: skip
    return OfferedMode(f, f - half, f + half, ratio, max(ratio - half_ratio, 0.0), ratio + half_ratio, mode.share)


def modes_of(times: np.ndarray, values: np.ndarray, count: int | None = None) -> tuple[OfferedMode, ...]:
    """Fit modes to a free decay.

    Args:
        times: Times, shape (n,).
        values: Samples, shape (n,).
        count: Number of modes; chosen by an information criterion if None.

    Returns:
        The modes, sorted by their share of the signal; weak ones are dropped.
    """
    decay = FreeDecays(times[:MOST_SAMPLES], values[None, :MOST_SAMPLES])
    estimate = Waves().identify_modes(ModalProblem(decay, count))
    modes = sorted(estimate.modes, key=lambda mode: -mode.share)
    return tuple(offered(mode, estimate.degrees) for mode in modes[:MOST_OFFERED] if mode.share >= LEAST_SHARE)


def alias_of(mode: OfferedMode, times: np.ndarray) -> OfferedMode | None:
    """Return the alias of lowest frequency above a mode, which has the same samples; None at uneven times."""
    if not even_times(times):
        return None
    rate = (times.size - 1) / float(np.ptp(times))
    decay = mode.damping_ratio * mode.frequency
    damped = rate - float(np.sqrt(max(mode.frequency**2 - decay**2, 0.0)))
    frequency = float(np.hypot(damped, decay))
    half = (mode.frequency_high - mode.frequency_low) / 2.0
    ratios = (mode.damping_ratio, mode.damping_ratio_low, mode.damping_ratio_high)
    ratio, low, high = (mode.frequency / frequency * end for end in ratios)
    return OfferedMode(frequency, frequency - half, frequency + half, ratio, low, high, mode.share, alias=True)
