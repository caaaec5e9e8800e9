"""Modes that are offered where a record of one mode holds several, or an alias of its one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.contract.modal import FreeDecays, ModalProblem, Mode
from bench.likelihood.autoregression import even_times
from bench.modal.waves import Waves

MOST_OFFERED, LEAST_SHARE = 4, 0.03
"""Modes that are offered, at most, and the least part of the signal: less hardly moves the values of the others."""
MOST_SAMPLES = 20_000
"""Samples from the release on that are fitted: the rest of a longer record is used by the main fit only."""


@dataclass(frozen=True)
class OfferedMode:
    """Natural frequency (Hz) and damping ratio, each with the 95 % interval of this record.

    ``share``: root mean square of the mode over that of the signal. ``alias``: a frequency that would give the same
    samples as the mode above it.
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
    """Return a mode with its intervals; ``degrees`` of freedom of Student's t."""
    from scipy.stats import t as student  # slow to import

    quantile = float(student.ppf(0.975, degrees))
    f, ratio, half, half_ratio = (
        mode.frequency, mode.damping_ratio, quantile * mode.frequency_sd, quantile * mode.damping_ratio_sd,
    )  # fmt: skip
    return OfferedMode(f, f - half, f + half, ratio, max(ratio - half_ratio, 0.0), ratio + half_ratio, mode.share)


def modes_of(times: np.ndarray, values: np.ndarray, count: int | None = None) -> tuple[OfferedMode, ...]:
    """Fit so many modes, or those that matter, to samples (n,) at times (n,); the strongest first."""
    decay = FreeDecays(times[:MOST_SAMPLES], values[None, :MOST_SAMPLES])
    answer = Waves().identify_modes(ModalProblem(decay, count))
    modes = sorted(answer.modes, key=lambda mode: -mode.share)
    return tuple(offered(mode, answer.degrees) for mode in modes[:MOST_OFFERED] if mode.share >= LEAST_SHARE)


def alias_of(mode: OfferedMode, times: np.ndarray) -> OfferedMode | None:
    """Return the lowest frequency above a mode's that would give the same even samples, with its damping ratio."""
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
