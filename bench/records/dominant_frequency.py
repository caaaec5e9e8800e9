"""The strongest frequency of a signal, from the data alone."""

from __future__ import annotations

import numpy as np

FINER = 4
"""Frequencies of the search, over those that the record resolves."""


def dominant_frequency(times: np.ndarray, values: np.ndarray) -> float:
    """The frequency (1/time) at which the values, joined by lines, have most power: from a cycle in the record on."""
    span = float(times[-1] - times[0]) or 1.0
    even = np.interp(np.linspace(times[0], times[-1], times.size), times, values)
    length = FINER * times.size
    power = np.abs(np.fft.rfft(even - np.mean(even), length))
    first = min(FINER, power.size - 1)
    return float((first + int(np.argmax(power[first:]))) / length * (times.size - 1) / span)
