"""Detection of clipped samples, at the limit of a sensor.

In a histogram of a smooth motion with equal bins below its maximum, the first bin has up to twice the mean of the next
three, for any amplitude, resolution and sampling rate, as values are dense at turning points. With clipping the first
bin has many times as many samples, even if small noise is added after the clipping.
"""

from __future__ import annotations

import numpy as np

STEPS = np.geomspace(2e-4, 0.02, 7)
"""Widths of the bins over the range of the values; bins narrower than the resolution are not used."""
PILED = 6.0
"""Least samples in the first bin over the mean of the next three plus one."""
OTHERS = 2.0
"""Least samples in the first bin over any other bin; synchronous sampling fills other bins as well."""
COARSEST = 0.05
"""Largest width of a bin over the range."""
DEPTH = 0.25
"""Fraction of the range below the maximum to which values must fall before and after clipping; excludes rests."""
BETWEEN = 0.2
"""Least share of samples between both limits; square waves, steps and pulses have fewer."""


def at_limit(values: np.ndarray) -> np.ndarray:
    """Return a mask (n,) of the values at the limit of their sensor, empty if there is no clipping."""
    masks = [_at_top(values), _at_top(-values)]
    mask = masks[0] | masks[1]
    return mask if np.mean(~mask) >= BETWEEN else np.zeros(values.size, bool)


def _at_top(values: np.ndarray) -> np.ndarray:
    nowhere = np.zeros(values.size, bool)
    top, size = float(np.max(values)), float(np.ptp(values))
    inner = _visits(values, top - DEPTH * size)
    if size == 0 or not np.any(inner):
        return nowhere
    resolution = float(np.min(np.diff(np.unique(values))))
    for step in sorted({max(width * size, 1.001 * resolution) for width in STEPS}, reverse=True):
        below = np.round((top - values) / step)
        counts = np.bincount(below[inner].astype(int), minlength=4)
        least = max(PILED * (np.mean(counts[1:4]) + 1.0), OTHERS * np.max(counts[1:]))
        if step <= COARSEST * size and counts[0] >= least:
            return np.asarray(below == 0)
    return nowhere


def _visits(values: np.ndarray, level: float) -> np.ndarray:
    """Return a mask (n,) of the values above a level, in segments that begin and end below it."""
    above = values > level
    if np.all(above):
        return np.zeros(values.size, bool)
    first, last = int(np.argmin(above)), values.size - 1 - int(np.argmin(above[::-1]))
    inside = np.zeros(values.size, bool)
    inside[first : last + 1] = True
    return np.asarray(above & inside)
