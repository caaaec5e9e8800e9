"""Lines of the discrete Fourier transform (DFT) of evenly sampled motion, and the model of one mass for them.

``Y(k) = N^(-1/2) sum_n y(n) e^(-2 pi i k n / N)`` for k = 0 ... N/2. Real and imaginary parts, multiplied by the root
of two for lines with a mirror image, are an orthonormal transform of the N samples: white noise stays white.

The motion is the response to the force continued with period N h, plus a free vibration. The response has the
harmonics ``G(s) F``, ``G(s) = 1 / (m s² + c s + k)``, which sampling aliases. Samples of the free vibration satisfy
``y(n) + a1 y(n-1) + a2 y(n-2) = 0``, with ``A(z) = 1 + a1/z + a2/z²`` of the roots ``e^(lambda h)``, lambda those of
``m s² + c s + k``; the DFT of N of them is exactly ``T(z_k) / A(z_k)`` with ``T = t0 + t1/z``,
``z_k = e^(2 pi i k / N)`` (R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed.
2012, section 6.3: leakage as a transient over the denominator of the system). No window is needed, and the truncation
of the harmonics is the only approximation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from bench import Force, interval_polynomials

ENTRIES = 2_000_000
"""Largest number of products of harmonics and intervals in memory."""
SMALL = 1.0
"""Exponent of an interval below which its moments are computed by a power series."""
TERMS = 20
"""Number of terms of that series; the next one is below 1e-18."""


def real_lines(lines: np.ndarray, samples: int) -> np.ndarray:
    """Convert complex lines (..., N // 2 + 1) to N real numbers, orthonormally."""
    inner = np.sqrt(2.0) * lines[..., 1 : (samples + 1) // 2]
    last = lines[..., samples // 2 :].real if samples % 2 == 0 else lines[..., :0].real
    return np.concatenate([lines[..., :1].real, inner.real, inner.imag, last], axis=-1)


def folded(harmonics: np.ndarray, samples: int) -> np.ndarray:
    """Return the DFT lines of samples of a periodic function with ``harmonics`` (..., K), K a multiple of N.

    With ``x(t) = X_0 + 2 Re sum_(k>0) X_k e^(2 pi i k t / P)`` and N samples per period P, every harmonic is aliased to
    its index modulo N.
    """
    half = samples // 2 + 1
    rest = harmonics.copy()
    rest[..., 0] = 0.5 * harmonics[..., 0]
    sums = rest.reshape(*rest.shape[:-1], -1, samples).sum(axis=-2)
    mirrored = np.roll(sums[..., ::-1], 1, axis=-1)
    return np.asarray(np.sqrt(samples) * (sums + mirrored.conj())[..., :half])


def force_harmonics(forces: Sequence[Force], first: float, last: float, period: float, count: int) -> np.ndarray:
    """Compute ``F_k = (1/P) integral of f(t) e^(-s_k (t - first))`` from first to last, s_k = 2 pi i k / P; (count,).

    The integrals are exact for a force that is a polynomial between its samples. After ``last`` the force is set to
    zero, which affects no sample up to there.
    """
    key = tuple((f.times.tobytes(), f.values.tobytes(), str(f.hold)) for f in forces)
    return _harmonics(key, first, last, period, count)


@lru_cache(maxsize=8)
def _harmonics(
    key: tuple[tuple[bytes, bytes, str], ...], first: float, last: float, period: float, count: int
) -> np.ndarray:
    forces = [Force(np.frombuffer(t), np.frombuffer(v), hold) for t, v, hold in key]  # type: ignore[arg-type]
    breaks = np.concatenate([[first, last], *[f.times for f in forces]])
    grid = np.unique(breaks[(breaks >= first) & (breaks <= last)])
    pushes = interval_polynomials(forces, grid, 1)[..., 0]
    lengths, begins = np.diff(grid), grid[:-1] - first
    harmonics = np.empty(count, complex)
    batch = max(1, ENTRIES // lengths.size)
    for first_place in range(0, count, batch):
        s = 2j * np.pi * np.arange(first_place, min(first_place + batch, count))[:, None] / period
        moments = _moments(s * lengths, pushes.shape[0])
        inside = sum(push * moment for push, moment in zip(pushes, moments, strict=True))
        harmonics[first_place : first_place + batch] = np.sum(np.exp(-s * begins) * lengths * inside, axis=1) / period
    harmonics.setflags(write=False)
    return harmonics


def _moments(z: np.ndarray, count: int) -> list[np.ndarray]:
    """Integrate ``u^j e^(-z u)`` over 0 ... 1 for j below ``count``: by parts, for small z by the power series."""
    small = np.abs(z) < SMALL
    safe, near = np.where(small, 1.0, z), np.where(small, z, 0.0)
    end = np.exp(-safe)
    integrals, by_parts = [], (1.0 - end) / safe
    for j in range(count):
        if j:
            by_parts = (j * by_parts - end) / safe
        series, term = np.zeros_like(z), np.ones_like(z)
        for n in range(TERMS):
            series = series + term / (n + j + 1)
            term = term * -near / (n + 1)
        integrals.append(np.where(small, series, by_parts))
    return integrals


@dataclass(frozen=True, eq=False)
class HarmonicLayout:
    """Number and step of even samples, and harmonics (K,) of the known force, empty without a force."""

    samples: int
    step: float
    harmonics: np.ndarray

    @property
    def forced(self) -> bool:
        """Return True if a force acts."""
        return self.harmonics.size > 0


def transient(layout: HarmonicLayout, r: float, g: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the columns (N, 2) of free vibrations, T = 1 and T = 1/z, and their derivatives by r and g (2, N, 2).

    ``r`` is k/m and ``g`` is c/m.
    """
    h, d = layout.step, 0.5 * g
    root = np.sqrt(complex(d**2 - r))
    first_root, second_root = np.exp((-d + root) * h), np.exp((-d - root) * h)
    product = np.exp(-g * h)
    # e^(-dh) sinh(root h) / root, the same for a real and an imaginary root, and finite where it is zero
    ratio = float(((first_root - second_root) / (2 * root)).real) if abs(root) * h > 1e-6 else h * np.exp(-d * h)
    total = float((first_root + second_root).real)
    delay = np.exp(-2j * np.pi * np.arange(layout.samples // 2 + 1) / layout.samples)
    a = 1.0 - total * delay + product * delay**2
    by_r = h * ratio * delay
    by_g = (0.5 * h * total - 0.5 * h * g * ratio) * delay - h * product * delay**2
    columns = np.stack([1.0 / a, delay / a])
    slopes = np.stack([-columns * by_r / a, -columns * by_g / a])
    return real_lines(columns, layout.samples).T, real_lines(slopes, layout.samples).swapaxes(1, 2)


def forced_lines(layout: HarmonicLayout, m: float, c: float, k: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the periodic response to the force (N,), and its derivatives by m, c and k (3, N)."""
    force, samples = layout.harmonics, layout.samples
    s = 2j * np.pi * np.arange(force.size) / (samples * layout.step)
    g = 1.0 / (m * s**2 + c * s + k)
    response = g * force
    slopes = -g * response * np.stack([s**2, s, np.ones_like(s)])
    every = real_lines(folded(np.concatenate([response[None], slopes]), samples), samples)
    return every[0], every[1:]
