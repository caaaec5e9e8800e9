"""Samples at the limit of a sensor, unlike turning points that are flat because digits are coarse or the motion slow.

At a turning point the values of a smooth motion are dense: in equal steps from the extreme down, the first holds up to
twice the mean of the next three, whatever the amplitude, resolution and rate. A limit that cuts tops off puts many
times as many samples into the first step, also where small noise is added behind the limit.
"""

from __future__ import annotations

import numpy as np

STEPS = np.geomspace(2e-4, 0.02, 7)
"""Widths of a step over the range of the values; steps finer than the resolution are not used."""
PILED = 6.0
"""Least samples in the first step over the mean of the next three, and one more."""
OTHERS = 2.0
"""Least samples in the first step over any other near the limit: a motion sampled in step with itself has as many."""
COARSEST = 0.05
"""Largest width of a step over the range."""
APART = 0.25
"""Part of the range that the values leave a limit by, before and after it, so that it is no rest and no hold."""
BETWEEN = 0.2
"""Least part of samples between both limits; a square wave, a step or a pulse has fewer."""


def at_limit(values: np.ndarray) -> np.ndarray:
    """Return which values (n,) are at the limit of their sensor, as a mask; nowhere where none is cut off."""
    masks = [_at_top(values), _at_top(-values)]
    mask = masks[0] | masks[1]
    return mask if np.mean(~mask) >= BETWEEN else np.zeros(values.size, bool)


def _at_top(values: np.ndarray) -> np.ndarray:
    nowhere = np.zeros(values.size, bool)
    top, size = float(np.max(values)), float(np.ptp(values))
    inner = _visits(values, top - APART * size)
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
    """Return where values (n,) are above a level, in stretches that begin and end below it."""
    above = values > level
    if np.all(above):
        return np.zeros(values.size, bool)
    first, last = int(np.argmin(above)), values.size - 1 - int(np.argmin(above[::-1]))
    inside = np.zeros(values.size, bool)
    inside[first : last + 1] = True
    return np.asarray(above & inside)
