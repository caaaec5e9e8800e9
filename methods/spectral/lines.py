"""The lines of the discrete Fourier transform (DFT) of even samples, and what one mass under a force shows on them.

``Y(k) = N^(-1/2) sum_n y(n) e^(-2 pi i k n / N)`` for k = 0 ... N/2. Real and imaginary parts, those of the lines that
have a mirror image times the root of two, are an orthonormal transform of the N samples: white noise stays white.

The motion is the periodic response to the force, repeated after N steps h of time, plus a free vibration. The first
has the harmonics ``G(s) F``, ``G(s) = 1 / (m s² + c s + k)``, which sampling folds. Samples of the second obey
``y(n) + a1 y(n-1) + a2 y(n-2) = 0``, with ``A(z) = 1 + a1/z + a2/z²`` of the roots ``e^(lambda h)``, lambda those of
``m s² + c s + k``; the DFT of N of them is exactly ``T(z_k) / A(z_k)`` with ``T = t0 + t1/z``,
``z_k = e^(2 pi i k / N)`` (R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed.
2012, section 6.3: leakage as a transient over the denominator of the system). So no window is needed, and nothing is
approximate but the number of harmonics.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
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
    inner = np.sqrt(2.0) * lines[..., 1 : (samples + 1) // 2]
    last = lines[..., samples // 2 :].real if samples % 2 == 0 else lines[..., :0].real
    return np.concatenate([lines[..., :1].real, inner.real, inner.imag, last], axis=-1)


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
    """``integral of u^j e^(-z u)`` over 0 ... 1 for j below ``count``: by parts, at small z by the power series."""
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
    """Even samples: their number and step; the harmonics (K,) of the known force, of no length where there is none."""

    samples: int
    step: float
    harmonics: np.ndarray

    @property
    def forced(self) -> bool:
        """Return True if a force acts."""
        return self.harmonics.size > 0


def transient(layout: HarmonicLayout, r: float, g: float) -> tuple[np.ndarray, np.ndarray]:
    """The two columns (N, 2) of a free vibration of k/m = ``r`` and c/m = ``g``; their derivatives by both (2, N, 2).

    The columns are those of T = 1 and of T = 1/z.
    """
    h, d = layout.step, 0.5 * g
    root = np.sqrt(complex(d**2 - r))
    one, two = np.exp((-d + root) * h), np.exp((-d - root) * h)
    product = np.exp(-g * h)
    # e^(-dh) sinh(root h) / root, the same for a real and an imaginary root, and finite where it is zero
    ratio = float(((one - two) / (2 * root)).real) if abs(root) * h > 1e-6 else h * np.exp(-d * h)
    total = float((one + two).real)
    delay = np.exp(-2j * np.pi * np.arange(layout.samples // 2 + 1) / layout.samples)
    a = 1.0 - total * delay + product * delay**2
    by_r = h * ratio * delay
    by_g = (0.5 * h * total - 0.5 * h * g * ratio) * delay - h * product * delay**2
    columns = np.stack([1.0 / a, delay / a])
    slopes = np.stack([-columns * by_r / a, -columns * by_g / a])
    return real_lines(columns, layout.samples).T, real_lines(slopes, layout.samples).swapaxes(1, 2)


def forced_lines(layout: HarmonicLayout, m: float, c: float, k: float) -> tuple[np.ndarray, np.ndarray]:
    """The periodic response to the force (N,), and its derivatives by m, c and k (3, N)."""
    force, samples = layout.harmonics, layout.samples
    s = 2j * np.pi * np.arange(force.size) / (samples * layout.step)
    g = 1.0 / (m * s**2 + c * s + k)
    response = g * force
    slopes = -g * response * np.stack([s**2, s, np.ones_like(s)])
    every = real_lines(folded(np.concatenate([response[None], slopes]), samples), samples)
    return every[0], every[1:]
