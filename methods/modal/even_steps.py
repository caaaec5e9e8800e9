"""Even steps of time, which every method needs that reads exponentials off a difference equation or a transform."""

from __future__ import annotations

import numpy as np

TOLERANCE = 1e-3
"""Steps may differ by this part of themselves: what rounding of printed times does."""


def unevenness(times: np.ndarray) -> str | None:
    """Why times (n,) are not at even steps, in a sentence; None where they are."""
    even = np.linspace(times[0], times[-1], times.size)
    if np.max(np.abs(times - even)) > TOLERANCE * (even[1] - even[0]):
        return "it needs samples at even steps of time; resample them"
    return None


def step_of(times: np.ndarray) -> float:
    """The step of even times (n,)."""
    return float(times[-1] - times[0]) / (times.size - 1)
