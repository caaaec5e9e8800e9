"""An adaptive explicit Runge-Kutta integrator for one motion of a nonlinear system, in plain numbers.

The pair of orders 7 and 8 of E. Fehlberg (NASA TR R-287, 1968, table X), the higher order carried on. The truth comes
from another family at a tighter tolerance (:mod:`bench.scenario.truth`), so that no method fits by what made its data.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from operator import mul

import numpy as np

TOLERANCE = 1e-9
"""Estimated local error of a component over the largest value that it has had; the true one is far below it."""
MAX_STEPS = 40_000
SHORTEST = 1e-10
"""Steps below this part of the whole time mean that the motion has diverged."""

_TABLE = (
    "",
    "2/27",
    "1/36 1/12",
    "1/24 0 1/8",
    "5/12 0 -25/16 25/16",
    "1/20 0 0 1/4 1/5",
    "-25/108 0 0 125/108 -65/27 125/54",
    "31/300 0 0 0 61/225 -2/9 13/900",
    "2 0 0 -53/6 704/45 -107/9 67/90 3",
    "-91/108 0 0 23/108 -976/135 311/54 -19/60 17/6 -1/12",
    "2383/4100 0 0 -341/164 4496/1025 -301/82 2133/4100 45/82 45/164 18/41",
    "3/205 0 0 0 0 -6/41 -3/205 -3/41 3/41 6/41 0",
    "-1777/4100 0 0 -341/164 4496/1025 -289/82 2193/4100 51/82 33/164 12/41 0 1",
)
_ROWS = [[float(Fraction(entry)) for entry in row.split()] for row in _TABLE]
NODES = tuple(float(sum(Fraction(entry) for entry in row.split())) for row in _TABLE)
"""Part of the step at which each stage stands."""
WEIGHTS = [0.0, 0.0, 0.0, 0.0, 0.0, 34 / 105, 9 / 35, 9 / 35, 9 / 280, 9 / 280, 0.0, 41 / 840, 41 / 840]
"""Weights of order eight; those of order seven have 41/840 for stages 0 and 10 in place of 11 and 12."""
ERROR = [41 / 840, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 41 / 840, -41 / 840, -41 / 840]
KINK = [272 / 840 / 20 * c for c in (0, 0, 0, 0, 0, -20, -6, -6, 15, 15, 0, 1, 1)]
"""What leaving out the middle stage would change, for Fehlberg's error is blind to a kink inside the step.

The weights of order eight are those of the Newton-Cotes formula on seven points. The sixth difference of the rates is
about the error that it makes of a kink, but far above its error where they are smooth: used where they are not.
"""
Rate = Callable[[list[float], float], list[float]]
"""Time derivative of a state, component by component, at a time from the start of the interval (s)."""


def integrate(
    rate_over: Callable[[int], Rate],
    state: Sequence[float],
    grid: np.ndarray,
    wanted: np.ndarray,
    step: float,
    smooth: bool = True,
) -> np.ndarray:
    """The states at the grid points numbered ``wanted``, shape (n_state, n_wanted), from ``state`` at the first.

    ``rate_over(i)`` is the rate within interval i of the grid; not ``smooth`` says that it has kinks there, as ``|v|``
    has. ``step`` is the first to be tried (s). NaN from where the motion diverges.
    """
    motion = _Motion(state, smooth)
    path = np.full((len(state), wanted.size), np.nan)
    path[:, wanted == 0] = np.array(state)[:, None]
    shortest, taken, h = SHORTEST * float(grid[-1] - grid[0]), 0, step
    for i in range(grid.size - 1):
        rate, at, end = rate_over(i), 0.0, float(grid[i + 1] - grid[i])
        while at < end:
            taken += 1
            parts = max(1, math.ceil((end - at) / h - 1e-9))
            now = (end - at) / parts
            size = motion.attempt(rate, at, now)
            if size <= 1.0:
                motion.state = motion.new
                at = end if parts == 1 else at + now
            if taken > MAX_STEPS or (size > 1.0 and now < shortest):
                return path
            # the error goes with the eighth power of the step; one cut to fit the interval says little of longer ones
            if size > 1.0 or parts > 1 or now > 0.5 * h:
                h = now * min(4.0, max(0.2, 0.9 * max(size, 1e-8) ** -0.125))
        path[:, wanted == i + 1] = np.array(motion.state)[:, None]
    return path


class _Motion:
    """The state of one motion, the largest values that it has had, and the step that was tried last."""

    def __init__(self, state: Sequence[float], smooth: bool) -> None:
        self.final = (WEIGHTS, ERROR) if smooth else (WEIGHTS, ERROR, KINK)
        self.state = self.new = list(state)
        self.scale = [abs(s) for s in state]

    def attempt(self, rate: Rate, at: float, h: float) -> float:
        """Try a step of length h: the largest error over what is allowed, infinity where a number is not finite."""
        try:
            return self._attempt(rate, at, h)
        except (OverflowError, ZeroDivisionError, ValueError):
            return math.inf

    def _attempt(self, rate: Rate, at: float, h: float) -> float:
        state = self.state
        k: list[list[float]] = [[value] for value in rate(state, at)]
        for row, node in zip(_ROWS[1:], NODES[1:], strict=True):
            moved = [s + h * sum(map(mul, row, own)) for s, own in zip(state, k, strict=True)]
            for own, value in zip(k, rate(moved, at + node * h), strict=True):
                own.append(value)
        size, new = 0.0, []
        for i, (s, own) in enumerate(zip(state, k, strict=True)):
            change, *errors = (h * sum(map(mul, weights, own)) for weights in self.final)
            new.append(s + change)
            scale = max(self.scale[i], abs(s + change), abs(h * own[0]))
            size = max(size, sum(map(abs, errors)) / (TOLERANCE * scale + 1e-300))
        if not all(map(math.isfinite, (*new, size))):
            return math.inf
        if size <= 1.0:
            self.scale = [max(a, abs(b), abs(h * own[0])) for a, b, own in zip(self.scale, new, k, strict=True)]
        self.new = new
        return size
