"""Dominant frequency of a signal."""

from __future__ import annotations

import numpy as np

FINER = 4
"""Zero padding: the frequency grid is this many times finer than the resolution of the record."""


def dominant_frequency(times: np.ndarray, values: np.ndarray) -> float:
    """Return the frequency (1/time) of most power, of at least one cycle in the record.

    Args:
        times: Increasing times, shape (n,); the values are interpolated to even times.
        values: Samples, shape (n,).
    """
    span = float(times[-1] - times[0]) or 1.0
    even = np.interp(np.linspace(times[0], times[-1], times.size), times, values)
    length = FINER * times.size
    power = np.abs(np.fft.rfft(even - np.mean(even), length))
    first = min(FINER, power.size - 1)
    return float((first + int(np.argmax(power[first:]))) / length * (times.size - 1) / span)
