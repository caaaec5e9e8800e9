"""The lines of the discrete Fourier transform (DFT) of even samples, as real numbers, and of a force as it runs.

``Y(k) = N^(-1/2) sum_n y(n) e^(-2 pi i k n / N)`` for k = 0 ... N/2. Real and imaginary parts, those of the lines that
have a mirror image times the root of two, are an orthonormal transform of the N samples: white noise of standard
deviation sigma stays so.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from bench import Force, interval_polynomials

ENTRIES = 2_000_000
"""Products of harmonics and intervals held at once."""
SMALL = 1.0
"""Size of the exponent of an interval below which its moments are summed as a power series."""
TERMS = 20
"""Of that series: the next is below 1e-18."""


def real_lines(lines: np.ndarray, samples: int) -> np.ndarray:
    """Complex lines (..., N // 2 + 1) as N real numbers, orthonormal."""
    scaled = np.sqrt(2.0) * lines
    scaled[..., 0] = lines[..., 0]
    inner = scaled[..., 1:]
    if samples % 2 == 0:
        inner = scaled[..., 1:-1]
    parts = [scaled[..., :1].real, inner.real, inner.imag]
    if samples % 2 == 0:
        parts.append(lines[..., -1:].real)
    return np.concatenate(parts, axis=-1)


def dft_lines(values: np.ndarray) -> np.ndarray:
    """The lines of real samples (..., N), complex (..., N // 2 + 1)."""
    return np.asarray(np.fft.rfft(values) / np.sqrt(values.shape[-1]))


def folded(harmonics: np.ndarray, samples: int) -> np.ndarray:
    """The DFT lines of even samples of a periodic function of ``harmonics``, (..., K) with K a multiple of N.

    With ``x(t) = X_0 + 2 Re sum_(k>0) X_k e^(2 pi i k t / P)`` and N samples a period P, every harmonic shows at its
    number modulo N: sampling folds the ones above half the sampling rate back.
    """
    half = samples // 2 + 1
    rest = harmonics.copy()
    rest[..., 0] = 0.5 * harmonics[..., 0]
    sums = rest.reshape(*rest.shape[:-1], -1, samples).sum(axis=-2)
    mirrored = np.roll(sums[..., ::-1], 1, axis=-1)
    return np.asarray(np.sqrt(samples) * (sums + mirrored.conj())[..., :half])


def force_harmonics(forces: Sequence[Force], first: float, last: float, period: float, count: int) -> np.ndarray:
    """``F_k = (1/P) integral of f(t) e^(-s_k (t - first))`` from ``first`` to ``last``, s_k = 2 pi i k / P; (count,).

    Exact for a force that is a polynomial between its samples, whatever their times. After ``last`` it counts as zero,
    which no sample up to there can see.
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
    found = np.empty(count, complex)
    batch = max(1, ENTRIES // lengths.size)
    for at in range(0, count, batch):
        s = 2j * np.pi * np.arange(at, min(at + batch, count))[:, None] / period
        moments = _moments(s * lengths, pushes.shape[0])
        inside = sum(own * moment for own, moment in zip(pushes, moments, strict=True))
        found[at : at + batch] = np.sum(np.exp(-s * begins) * lengths * inside, axis=1) / period
    found.setflags(write=False)
    return found


def _moments(z: np.ndarray, count: int) -> list[np.ndarray]:
    """``integral of u^j e^(-z u)`` over 0 ... 1 for j below ``count``: by parts, at small z by the power series."""
    small = np.abs(z) < SMALL
    safe, near = np.where(small, 1.0, z), np.where(small, z, 0.0)
    end = np.exp(-safe)
    found, by_parts = [], (1.0 - end) / safe
    for j in range(count):
        if j:
            by_parts = (j * by_parts - end) / safe
        series, term = np.zeros_like(z), np.ones_like(z)
        for n in range(TERMS):
            series = series + term / (n + j + 1)
            term = term * -near / (n + 1)
        found.append(np.where(small, series, by_parts))
    return found
