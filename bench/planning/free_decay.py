"""Fisher information of a free decay, sampled at any times, with unknown initial state, in closed form.

The displacement is ``x0 g(t) + v0 h(t)``, with the impulse response ``h`` and ``g = h' + 2 ζ ω h``. Derivatives by the
logarithms of ``k/m = ω²`` and ``c/m = 2 ζ ω`` are computed by complex steps (J. Lyness, C. Moler, SIAM J. Numerical
Analysis 4:202, 1967); the motion is linear in the initial state. The inverse of the information is the Cramér-Rao
bound.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

STEP = 1e-30
"""Size of a complex step, which may be arbitrarily small, since no difference is taken."""
TERMS = 12
"""Number of terms of a power series, sufficient for double precision for arguments up to 1."""
QUANTITIES = {
    "k_over_m": (1.0, 0.0), "c_over_m": (0.0, 1.0), "natural_frequency": (0.5, 0.0), "damping_ratio": (-0.5, 1.0),
}  # fmt: skip
"""Exponents of k/m and c/m in each quantity."""


@dataclass(frozen=True)
class Oscillator:
    """An oscillator with natural frequency (Hz) and damping ratio."""

    frequency: float
    damping_ratio: float

    @cached_property
    def omega(self) -> float:
        """Natural frequency (rad/s)."""
        return 2.0 * math.pi * self.frequency


@dataclass(frozen=True)
class Decay:
    """A free-decay test.

    ``samples`` over ``duration`` (s), both ends included; ``amplitude``: initial displacement over the standard
    deviation of the noise. The initial velocity is zero; the initial state is unknown to the method and in the bound.
    """

    samples: int
    duration: float
    amplitude: float

    @cached_property
    def times(self) -> np.ndarray:
        """Times of the samples (s), (samples,)."""
        return np.linspace(0.0, self.duration, self.samples)

    def with_samples(self, samples: int) -> Decay:
        """Return a test of the same duration with another number of samples."""
        return replace(self, samples=samples)


def motion(
    oscillator: Oscillator, times: np.ndarray, start: tuple[float, float] = (1.0, 0.0)
) -> tuple[np.ndarray, np.ndarray]:
    """Return the free response of an oscillator and its derivatives.

    Args:
        oscillator: The oscillator.
        times: Times, s, (n,).
        start: Initial displacement and velocity.

    Returns:
        Displacement (n,), and its derivatives (n, 4) by log k/m, log c/m, x0 and v0.
    """
    stiffness, damping = oscillator.omega**2, 2.0 * oscillator.damping_ratio * oscillator.omega
    even, odd = responses(times, stiffness, damping)
    columns = [even, odd]
    for exponents in ((STEP, 0.0), (0.0, STEP)):
        perturbed = responses(times, stiffness * (1.0 + 1j * exponents[0]), damping * (1.0 + 1j * exponents[1]))
        columns.append(np.imag(start[0] * perturbed[0] + start[1] * perturbed[1]) / STEP)
    derivatives = np.stack([columns[2], columns[3], np.real(even), np.real(odd)], axis=1)
    return np.real(start[0] * even + start[1] * odd), derivatives


def responses(times: np.ndarray, stiffness: complex, damping: complex) -> tuple[np.ndarray, np.ndarray]:
    """Return the free responses (n,) to a unit displacement and to a unit velocity.

    Both are even functions of the damped frequency, so they have no branch cut in complex arguments.
    """
    cosine, sine = _waves(complex(stiffness - damping**2 / 4.0), times)
    decay = np.exp(-damping * times / 2.0)
    slope = decay * sine
    return decay * cosine + damping / 2.0 * slope, slope


def _waves(square: complex, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return ``cos(w t)`` and ``sin(w t) / w`` as functions of ``w²``; by series if ``w`` is small, since a square root
    has no derivative at 0."""
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
    """Return the Fisher information (4, 4) about log k/m, log c/m, x0 and v0, for noise of unit variance."""
    derivatives = motion(oscillator, decay.times if times is None else times, (decay.amplitude, 0.0))[1]
    return np.asarray(derivatives.T @ derivatives)


def errors(fisher: np.ndarray, quantities: Mapping[str, tuple[float, ...]] = QUANTITIES) -> dict[str, float]:
    """Return the bound on the standard deviation of the logarithm of each quantity.

    Args:
        fisher: Fisher information (p, p) about log k/m, log c/m, and further unknowns.
        quantities: Exponents of the parameters in each quantity.

    Returns:
        The bounds by quantity; infinite if the information is singular.
    """
    scale = np.sqrt(np.diag(fisher))
    if not np.all(scale > 0):
        return dict.fromkeys(quantities, math.inf)
    values, vectors = np.linalg.eigh(fisher / np.outer(scale, scale))
    if values[0] <= 1e-13 * values[-1]:
        return dict.fromkeys(quantities, math.inf)
    bounds = {}
    for name, exponents in quantities.items():
        weights = np.array([*exponents, *np.zeros(len(scale) - len(exponents))]) / scale
        bounds[name] = float(np.sqrt(np.sum((vectors.T @ weights) ** 2 / values)))
    return bounds
