"""How often maximum likelihood ends in a wrong basin: the threshold below which the Cramér-Rao bound means nothing.

At a point the motion and its rivals (other frequencies and damping ratios) each span a plane of samples where the start
is not told. The likelihood is largest where the record's energy in the plane is, so a rival wins when noise gives it
more energy than the truth has (D. Rife, R. Boorstyn, IEEE Trans. Information Theory 20:591, 1974, for sinusoids; method
of interval errors: F. Athley, IEEE Trans. Signal Processing 53:1295, 2005). Over the noise's variance that energy is
chi-square distributed: of a rival with two degrees of freedom about the clean motion's energy in its plane; of the
truth with four, since frequency and damping are fitted too. Rivals are taken so far apart, from the truth and from each
other, that their energies are nearly independent. Where the start is told, a rival is one motion, which wins where the
record is nearer to it than to the truth.
"""

from __future__ import annotations

import math

import numpy as np

from bench.atlas.point import FreeDecay

RATIOS = (1e-4, 3e-3, 1e-2, 3e-2, 0.1, 0.3, 0.7, 1.2)
"""Damping ratios of the rivals."""
FINE = 2
"""Frequencies of the rivals in a resolved interval, which is half a cycle over the record."""
APART = 0.2
"""Most overlap of two rivals, or of one and the truth: mean squared cosine of the angles between their planes."""
CERTAIN = 400.0
"""Energy of the motion over the noise's variance, above which no rival that is so far apart can win."""
LEVELS = (np.arange(2000) + 0.5) / 2000
"""Levels at which the truth's energy is sampled."""


def wrong_basin(point: FreeDecay) -> float:
    """The probability that maximum likelihood ends in another basin, for a frequency below half the sampling rate."""
    clean = _clean(point)
    energy = point.samples * 10.0 ** (point.snr_db / 10.0)
    if energy > CERTAIN:
        return 0.0
    motion = clean * math.sqrt(energy / float(clean @ clean))
    if point.start_known:
        return _told(point, motion)
    planes = _planes(_times(point), *_grid(point))
    truth = _planes(_times(point), np.array([1.0]), np.array([point.damping_ratio]))[0]
    energies = np.sum((np.swapaxes(planes, 1, 2) @ motion) ** 2, axis=1)
    overlaps = 0.5 * np.sum((np.swapaxes(planes, 1, 2) @ truth) ** 2, axis=(1, 2))
    kept = _apart(planes, np.where(overlaps <= APART, energies, -1.0))
    return _any_above(energy, energies[kept])


def _any_above(truth: float, rivals: np.ndarray) -> float:
    """Probability that any rival has more energy than the truth, from what each has without noise."""
    from scipy.stats import ncx2  # slow to import

    values = ncx2.ppf(LEVELS, 4, truth)
    below = np.zeros_like(values)
    for rival in rivals:
        below += np.log(np.maximum(ncx2.cdf(values, 2, max(float(rival), 1e-9)), 1e-300))
    return float(np.clip(1.0 - np.mean(np.exp(below)), 0.0, 1.0))


def _told(point: FreeDecay, motion: np.ndarray) -> float:
    """The same for a start that is told: each rival is one motion from that start."""
    from scipy.special import ndtr, ndtri

    scale = float(np.linalg.norm(motion) / np.linalg.norm(_clean(point)))
    times = _times(point)
    rivals = scale * np.stack([_path(times, w, z, point.phase) for w, z in zip(*_grid(point), strict=True)])
    sizes = np.maximum(np.linalg.norm(rivals, axis=1), 1e-300)
    units = (rivals / sizes[:, None])[:, :, None]
    overlaps = (units[:, :, 0] @ motion / np.linalg.norm(motion)) ** 2
    distances = np.linalg.norm(rivals - motion, axis=1)
    kept = _apart(units, np.where(overlaps <= APART, 1.0 / distances, -1.0))
    # the noise along the truth is shared by all pairs; fitted frequency and damping bring the truth a mean of 2
    shared = 2.0 * np.linalg.norm(motion) * ndtri(LEVELS)
    off = (distances[kept] ** 2 + 2.0)[:, None] + shared
    return float(1.0 - np.mean(np.prod(1.0 - ndtr(-off / (2.0 * sizes[kept, None])), axis=0)))


def _apart(planes: np.ndarray, order: np.ndarray) -> list[int]:
    """The rivals from the largest of ``order`` down that overlap with none before; those below 0 are left out."""
    kept = list[int]()
    free = order >= 0
    for i in np.argsort(-order):
        if free[i]:
            kept.append(int(i))
            rest = np.flatnonzero(free)
            shared = np.sum((np.swapaxes(planes[rest], 1, 2) @ planes[i]) ** 2, axis=(1, 2)) / planes.shape[2]
            free[rest] = shared <= APART
    return kept


def _times(point: FreeDecay) -> np.ndarray:
    """In units of the inverse natural frequency."""
    return np.linspace(0.0, 2.0 * math.pi * point.cycles, point.samples)


def _grid(point: FreeDecay) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies, over the natural one, up to half the sampling rate, and damping ratios, of all rivals."""
    omegas = np.arange(1, FINE * (point.samples - 1) + 1) / (2.0 * FINE * point.cycles)
    return np.repeat(omegas, len(RATIOS)), np.tile(RATIOS, omegas.size)


def _clean(point: FreeDecay) -> np.ndarray:
    return _path(_times(point), 1.0, point.damping_ratio, point.phase)


def _path(times: np.ndarray, omega: float, ratio: float, phase: float) -> np.ndarray:
    """A motion from ``cos(phase)`` with velocity ``-sin(phase)``."""
    even, odd = _modes(times, omega, ratio)
    x0, v0 = math.cos(phase), -math.sin(phase)
    return np.asarray(x0 * even + (v0 + ratio * omega * x0) * odd)


def _modes(times: np.ndarray, omega: float, ratio: float) -> tuple[np.ndarray, np.ndarray]:
    """``exp(-ζωt) cos(ω_d t)`` and ``exp(-ζωt) sin(ω_d t) / ω_d``; beyond critical damping hyperbolic ones."""
    root = omega * np.sqrt(complex(1.0 - ratio**2))
    decay = np.exp((-ratio * omega + 1j * root) * times), np.exp((-ratio * omega - 1j * root) * times)
    if abs(root) < 1e-9:
        return np.exp(-omega * times), times * np.exp(-omega * times)
    return np.real(0.5 * (decay[0] + decay[1])), np.real((decay[0] - decay[1]) / (2j * root))


def _planes(times: np.ndarray, omegas: np.ndarray, ratios: np.ndarray) -> np.ndarray:
    """Orthonormal bases (n, samples, 2) of the motions of frequencies and damping ratios from any start."""
    modes = np.stack([np.stack(_modes(times, w, z), axis=1) for w, z in zip(omegas, ratios, strict=True)])
    return np.asarray(np.linalg.qr(modes / np.linalg.norm(modes, axis=1, keepdims=True))[0])
