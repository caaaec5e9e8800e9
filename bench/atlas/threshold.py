"""Probability that the maximum of the likelihood lies in a wrong basin: the threshold effect, which limits the
Cramér-Rao bound to high signal-to-noise ratios.

With an unknown initial state, the free decays of a given frequency and damping ratio span a plane in the space of
samples. The likelihood is largest for the plane that contains the most energy of the record, so the estimate is in a
wrong basin if noise gives a competing plane more energy than the true one (D. Rife, R. Boorstyn, IEEE Trans.
Information Theory 20:591, 1974, for sinusoids; method of interval errors: F. Athley, IEEE Trans. Signal Processing
53:1295, 2005). Over the variance of the noise these energies are noncentral chi-squared: with two degrees of freedom
for a competitor, with four for the true plane, since frequency and damping are fitted as well. The competitors are
chosen with little mutual overlap, so that their energies are nearly independent. With a known initial state, a
competitor is a single motion, and the estimate is in a wrong basin if the record is closer to it than to the true
motion.
"""

from __future__ import annotations

import math

import numpy as np

from bench.atlas.point import FreeDecay

RATIOS = (1e-4, 3e-3, 1e-2, 3e-2, 0.1, 0.3, 0.7, 1.2)
"""Damping ratios of the competitors."""
FINE = 2
"""Frequencies of the competitors per resolved interval, which is half a cycle over the record."""
LARGEST_OVERLAP = 0.2
"""Largest overlap of two planes: the mean squared cosine of the angles between them."""
CERTAIN = 400.0
"""Energy of the motion over the variance of the noise above which the probability is zero."""
LEVELS = (np.arange(2000) + 0.5) / 2000
"""Levels at which the distribution of the true plane's energy is sampled."""


def wrong_basin(point: FreeDecay) -> float:
    """Return the probability that the maximum of the likelihood lies in a wrong basin.

    The natural frequency must be below half the sampling rate.
    """
    clean = _clean(point)
    energy = point.samples * 10.0 ** (point.snr_db / 10.0)
    if energy > CERTAIN:
        return 0.0
    motion = clean * math.sqrt(energy / float(clean @ clean))
    if point.start_known:
        return _wrong_basin_from_known_state(point, motion)
    planes = _planes(_times(point), *_grid(point))
    truth = _planes(_times(point), np.array([1.0]), np.array([point.damping_ratio]))[0]
    energies = np.sum((np.swapaxes(planes, 1, 2) @ motion) ** 2, axis=1)
    overlaps = 0.5 * np.sum((np.swapaxes(planes, 1, 2) @ truth) ** 2, axis=(1, 2))
    selected = _select(planes, np.where(overlaps <= LARGEST_OVERLAP, energies, -1.0))
    return _any_above(energy, energies[selected])


def _any_above(truth: float, rivals: np.ndarray) -> float:
    """Return the probability that any competitor has more energy than the true plane, from their noise-free
    energies."""
    from scipy.stats import ncx2  # slow to import

    values = ncx2.ppf(LEVELS, 4, truth)
    below = np.zeros_like(values)
    for rival in rivals:
        below += np.log(np.maximum(ncx2.cdf(values, 2, max(float(rival), 1e-9)), 1e-300))
    return float(np.clip(1.0 - np.mean(np.exp(below)), 0.0, 1.0))


def _wrong_basin_from_known_state(point: FreeDecay, motion: np.ndarray) -> float:
    """Return the same probability for a known initial state, from which each competitor is a single motion."""
    from scipy.special import ndtr, ndtri

    scale = float(np.linalg.norm(motion) / np.linalg.norm(_clean(point)))
    times = _times(point)
    rivals = scale * np.stack([_path(times, w, z, point.phase) for w, z in zip(*_grid(point), strict=True)])
    sizes = np.maximum(np.linalg.norm(rivals, axis=1), 1e-300)
    units = (rivals / sizes[:, None])[:, :, None]
    overlaps = (units[:, :, 0] @ motion / np.linalg.norm(motion)) ** 2
    distances = np.linalg.norm(rivals - motion, axis=1)
    selected = _select(units, np.where(overlaps <= LARGEST_OVERLAP, 1.0 / distances, -1.0))
    # The noise along the true motion is common to all pairs. The two fitted parameters add 2 to its mean energy.
    shared = 2.0 * np.linalg.norm(motion) * ndtri(LEVELS)
    margins = (distances[selected] ** 2 + 2.0)[:, None] + shared
    return float(1.0 - np.mean(np.prod(1.0 - ndtr(-margins / (2.0 * sizes[selected, None])), axis=0)))


def _select(planes: np.ndarray, order: np.ndarray) -> list[int]:
    """Select planes greedily by decreasing ``order``, without overlap; negative values exclude a plane."""
    selected = list[int]()
    free = order >= 0
    for i in np.argsort(-order):
        if free[i]:
            selected.append(int(i))
            rest = np.flatnonzero(free)
            shared = np.sum((np.swapaxes(planes[rest], 1, 2) @ planes[i]) ** 2, axis=(1, 2)) / planes.shape[2]
            free[rest] = shared <= LARGEST_OVERLAP
    return selected


def _times(point: FreeDecay) -> np.ndarray:
    """Return the times of the samples in units of the inverse natural frequency."""
    return np.linspace(0.0, 2.0 * math.pi * point.cycles, point.samples)


def _grid(point: FreeDecay) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies (over the natural frequency, up to half the sampling rate) and damping ratios of
    competitors."""
    omegas = np.arange(1, FINE * (point.samples - 1) + 1) / (2.0 * FINE * point.cycles)
    return np.repeat(omegas, len(RATIOS)), np.tile(RATIOS, omegas.size)


def _clean(point: FreeDecay) -> np.ndarray:
    return _path(_times(point), 1.0, point.damping_ratio, point.phase)


def _path(times: np.ndarray, omega: float, ratio: float, phase: float) -> np.ndarray:
    """Return a free decay with initial displacement ``cos(phase)`` and initial velocity ``-sin(phase)``."""
    even, odd = _modes(times, omega, ratio)
    x0, v0 = math.cos(phase), -math.sin(phase)
    return np.asarray(x0 * even + (v0 + ratio * omega * x0) * odd)


def _modes(times: np.ndarray, omega: float, ratio: float) -> tuple[np.ndarray, np.ndarray]:
    """Return ``exp(-ζωt) cos(ω_d t)`` and ``exp(-ζωt) sin(ω_d t) / ω_d``, or their overdamped equivalents."""
    root = omega * np.sqrt(complex(1.0 - ratio**2))
    decay = np.exp((-ratio * omega + 1j * root) * times), np.exp((-ratio * omega - 1j * root) * times)
    if abs(root) < 1e-9:
        return np.exp(-omega * times), times * np.exp(-omega * times)
    return np.real(0.5 * (decay[0] + decay[1])), np.real((decay[0] - decay[1]) / (2j * root))


def _planes(times: np.ndarray, omegas: np.ndarray, ratios: np.ndarray) -> np.ndarray:
    """Return orthonormal bases (n, samples, 2) of the free decays with given frequencies and damping ratios (n,)."""
    modes = np.stack([np.stack(_modes(times, w, z), axis=1) for w, z in zip(omegas, ratios, strict=True)])
    return np.asarray(np.linalg.qr(modes / np.linalg.norm(modes, axis=1, keepdims=True))[0])
