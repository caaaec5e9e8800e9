"""A sensor's zero that jumps: where it did, and by how much, from the samples alone.

A smooth motion is nearly a parabola over a few samples; a jump of the zero between two of them is the step of a
parabola with a step, by least squares. What that finds where nothing jumps tells how far off it is by chance. A spike
makes two steps one behind the other, of opposite signs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

SIDE = 3
"""Samples on either side of a jump."""
GATE = 6.0
"""Robust standard deviations of what is found where nothing jumps."""
SPIKE = 0.5
"""Of a step, the one beside it that makes them a spike: a spike's are alike, a jump has a tenth of itself there."""


class Jump(NamedTuple):
    """The first sample behind a jump, and its size."""

    at: int
    size: float


def largest_jump(values: np.ndarray) -> Jump | None:
    """The largest jump of equally spaced values (n,), NaN where one is missing; None where none stands out.

    The first and last :data:`SIDE` samples are not told.
    """
    if values.size < 10 * SIDE:
        return None
    found = np.convolve(values, _step()[::-1], mode="valid")  # of a step before sample SIDE, SIDE + 1, ...
    there = np.flatnonzero(np.isfinite(found))
    if there.size < 5 * SIDE:
        return None
    scale = 1.4826 * float(np.median(np.abs(found[there])))
    steps = np.nan_to_num(found)
    beside = np.zeros_like(steps)  # the largest of opposite sign
    beside[1:] = np.maximum(beside[1:], -steps[:-1] * np.sign(steps[1:]))
    beside[:-1] = np.maximum(beside[:-1], -steps[1:] * np.sign(steps[:-1]))
    sizes = np.where(beside < SPIKE * np.abs(steps), np.abs(steps), 0.0)
    top = int(np.argmax(sizes))
    return Jump(top + SIDE, float(steps[top])) if sizes[top] > GATE * scale else None


def remove_jumps(values: np.ndarray, zero: np.ndarray) -> int | None:
    """Take the largest jump of each sensor off the samples behind it, and add it to the sensor's zero, both in place.

    Args:
        values: equally spaced samples, (n, n_sensors).
        zero: what is taken off the sensors, (n_sensors,).

    Returns:
        The first sample behind the jump of the last sensor that has one; None where none has.
    """
    at = None
    for i, own in enumerate(values.T):
        jump = largest_jump(own)
        if jump is not None:
            at = jump.at
            own[at:] -= jump.size
            zero[i] += jump.size
    return at


def _step() -> np.ndarray:
    """The weights (2 SIDE,) that make the step out of values, by least squares."""
    t = np.arange(2 * SIDE) - SIDE + 0.5
    columns = np.stack([np.ones_like(t), t, t**2, 1.0 * (t > 0)], axis=1)
    return np.asarray(np.linalg.pinv(columns)[3])
