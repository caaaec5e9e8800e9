"""What a free decay tells of an oscillator, in closed form: information of samples at any times, start unknown.

The displacement is ``x0 g(t) + v0 h(t)``, ``h`` the impulse response and ``g = h' + 2 ζ ω h``. Derivatives by the
logarithms of k/m and c/m are those of ``ω² = k/m`` and ``2 ζ ω = c/m`` by complex steps (J. Lyness, C. Moler, SIAM J.
Numerical Analysis 4:202, 1967); the motion is linear in the start. The inverse of the information is the Cramér-Rao
bound.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

STEP = 1e-30
"""Of a complex step: nothing is subtracted, so it may be as small as one likes."""
TERMS = 12
"""Of a series whose argument is at most 1: beyond double precision."""
QUANTITIES = {
    "k_over_m": (1.0, 0.0), "c_over_m": (0.0, 1.0), "natural_frequency": (0.5, 0.0), "damping_ratio": (-0.5, 1.0),
}  # fmt: skip
"""Exponents of k/m and c/m in each."""


@dataclass(frozen=True)
class Oscillator:
    """Natural frequency (Hz) and damping ratio."""

    frequency: float
    damping_ratio: float

    @cached_property
    def omega(self) -> float:
        """Natural frequency, rad/s."""
        return 2.0 * math.pi * self.frequency


@dataclass(frozen=True)
class Decay:
    """A test: ``samples`` over ``duration`` (s), both ends included, from a displacement ``amplitude`` over the noise's
    standard deviation, at rest; method and bound do not know the start."""

    samples: int
    duration: float
    amplitude: float

    @cached_property
    def times(self) -> np.ndarray:
        """Of the samples (s)."""
        return np.linspace(0.0, self.duration, self.samples)

    def longer(self, samples: int) -> Decay:
        """The same with so many samples over the same duration."""
        return replace(self, samples=samples)


def motion(
    oscillator: Oscillator, times: np.ndarray, start: tuple[float, float] = (1.0, 0.0)
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement (n,) from a start (x0, v0), and its derivatives (n, 4) by log k/m, log c/m, x0 and v0."""
    stiffness, damping = oscillator.omega**2, 2.0 * oscillator.damping_ratio * oscillator.omega
    even, odd = responses(times, stiffness, damping)
    columns = [even, odd]
    for exponents in ((STEP, 0.0), (0.0, STEP)):
        moved = responses(times, stiffness * (1.0 + 1j * exponents[0]), damping * (1.0 + 1j * exponents[1]))
        columns.append(np.imag(start[0] * moved[0] + start[1] * moved[1]) / STEP)
    derivatives = np.stack([columns[2], columns[3], np.real(even), np.real(odd)], axis=1)
    return np.real(start[0] * even + start[1] * odd), derivatives


def responses(times: np.ndarray, stiffness: complex, damping: complex) -> tuple[np.ndarray, np.ndarray]:
    """The motion from a unit displacement, and from a unit velocity; even functions of the damped frequency."""
    cosine, sine = _waves(complex(stiffness - damping**2 / 4.0), times)
    decay = np.exp(-damping * times / 2.0)
    slope = decay * sine
    return decay * cosine + damping / 2.0 * slope, slope


def _waves(square: complex, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``cos(w t)`` and ``sin(w t) / w`` from ``w²``; by series where that is small: a root has no derivative at 0."""
    if abs(square) * float(np.max(times)) ** 2 > 1.0:
        damped = np.sqrt(square)
        return np.cos(damped * times), np.sin(damped * times) / damped
    power = -square * times**2
    cosine, sine = np.ones_like(power), np.ones_like(power)
    term = np.ones_like(power)
    for k in range(1, TERMS):
        term = term * power / (2 * k * (2 * k - 1))
        cosine, sine = cosine + term, sine + term / (2 * k + 1)
    return cosine, sine * times


def information(oscillator: Oscillator, decay: Decay, times: np.ndarray | None = None) -> np.ndarray:
    """The Fisher information (4, 4) of samples of unit noise, about log k/m, log c/m, x0 and v0."""
    derivatives = motion(oscillator, decay.times if times is None else times, (decay.amplitude, 0.0))[1]
    return np.asarray(derivatives.T @ derivatives)


def errors(told: np.ndarray, quantities: Mapping[str, tuple[float, ...]] = QUANTITIES) -> dict[str, float]:
    """The bound on the standard deviation of each quantity's logarithm, by information; inf where it tells nothing.

    ``told`` is about log k/m, log c/m, and what else is unknown; ``quantities`` by their exponents of these.
    """
    scale = np.sqrt(np.diag(told))
    if not np.all(scale > 0):
        return dict.fromkeys(quantities, math.inf)
    values, vectors = np.linalg.eigh(told / np.outer(scale, scale))
    if values[0] <= 1e-13 * values[-1]:
        return dict.fromkeys(quantities, math.inf)
    found = {}
    for name, exponents in quantities.items():
        weights = np.array([*exponents, *np.zeros(len(scale) - len(exponents))]) / scale
        found[name] = float(np.sqrt(np.sum((vectors.T @ weights) ** 2 / values)))
    return found
