"""Detection and removal of jumps of a sensor's zero.

Over a few samples a smooth motion is nearly a parabola. A parabola with a step is fitted by least squares at every
sample; the median of the absolute step sizes is the scale against which a jump is tested. A spike appears as two
consecutive steps of opposite signs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

SIDE = 3
"""Number of samples on either side of a jump in the fit."""
GATE = 6.0
"""Smallest size of a jump in robust standard deviations of the fitted steps."""
SPIKE = 0.5
"""Largest relative size of an adjacent step of opposite sign; it is about 1 for a spike and 0.1 for a jump."""


class Jump(NamedTuple):
    """A jump: index of the first sample after it, and its size."""

    first: int
    size: float


def largest_jump(values: np.ndarray) -> Jump | None:
    """Return the largest significant jump of equally spaced values (n,), NaN if missing; None if there is none.

    Jumps within the first and last :data:`SIDE` samples are not detected.
    """
    if values.size < 10 * SIDE:
        return None
    fitted = np.convolve(values, _step()[::-1], mode="valid")  # step before sample SIDE, SIDE + 1, ...
    valid = np.flatnonzero(np.isfinite(fitted))
    if valid.size < 5 * SIDE:
        return None
    scale = 1.4826 * float(np.median(np.abs(fitted[valid])))
    steps = np.nan_to_num(fitted)
    adjacent = np.zeros_like(steps)  # the larger adjacent step of opposite sign
    adjacent[1:] = np.maximum(adjacent[1:], -steps[:-1] * np.sign(steps[1:]))
    adjacent[:-1] = np.maximum(adjacent[:-1], -steps[1:] * np.sign(steps[:-1]))
    sizes = np.where(adjacent < SPIKE * np.abs(steps), np.abs(steps), 0.0)
    top = int(np.argmax(sizes))
    return Jump(top + SIDE, float(steps[top])) if sizes[top] > GATE * scale else None


def remove_jumps(values: np.ndarray, zero: np.ndarray) -> int | None:
    """Subtract the largest jump of each sensor from later samples and add it to the sensor's zero, both in place.

    Args:
        values: Equally spaced samples, shape (n, n_sensors).
        zero: Constants subtracted from the sensors so far, shape (n_sensors,).

    Returns:
        Index of the first sample after the jump, of the last sensor that has one; None if there is no jump.
    """
    first = None
    for i, column in enumerate(values.T):
        jump = largest_jump(column)
        if jump is not None:
            first = jump.first
            column[first:] -= jump.size
            zero[i] += jump.size
    return first


def _step() -> np.ndarray:
    """Return the least-squares weights (2 SIDE,) of the values for the size of the step."""
    t = np.arange(2 * SIDE) - SIDE + 0.5
    columns = np.stack([np.ones_like(t), t, t**2, 1.0 * (t > 0)], axis=1)
    return np.asarray(np.linalg.pinv(columns)[3])
