"""Complex rates of damped sinusoids common to several channels, found one after the other on a grid.

A candidate adds two columns, ``e^(-d t) cos(w t)`` and ``e^(-d t) sin(w t)``, to those already selected. The reduction
of the misfit follows from inner products after projecting the selected columns out (variable projection: G. Golub and
V. Pereyra, SIAM J. Numer. Anal. 10:413, 1973). On a grid the columns are products of a decay and a wave, so all inner
products are matrix products. Channels sampled at the same times share the columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bench import Channel

DECAYS = (0.15, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Decay rates of the grid, in 1 / record."""
CYCLE_STEP = 0.25
"""Step of the grid in cycles per record: half of the half-cycle at which the misfit has its next minimum."""
MAX_CYCLES = 100.0
SPANS = (1.0, 0.3)
"""Half-widths of the refined grids: in grid steps of the frequency and in the logarithm of the decay."""
RIDGE = 1e-10
"""Regularisation relative to a column's squared norm; a column dependent on the others then reduces no misfit."""


def periodogram(channel: Channel, samples: int, padding: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies (cycles per unit of time) and powers of the first samples, interpolated to even times."""
    n = min(channel.n, samples)
    times = np.linspace(channel.times[0], channel.times[n - 1], n)
    values = np.interp(times, channel.times[:n], channel.values[:n])
    power = np.abs(np.fft.rfft(values - values.mean(), padding * n)) ** 2
    return np.arange(power.size) / (padding * (times[-1] - times[0])), power


def common_rates(channels: Sequence[Channel], n: int) -> np.ndarray:
    """Return complex rates (n,) of damped sinusoids common to channels of equal weight, in natural units."""
    gaps = [float(np.median(np.diff(c.times))) for c in channels]
    groups = _groups(channels)
    cycles = np.arange(CYCLE_STEP, min(0.5 / min(gaps), MAX_CYCLES) + 1e-9, CYCLE_STEP)
    rates = np.zeros(0, complex)
    for _ in range(n):
        decay, omega = _best(groups, rates, np.array(DECAYS), 2 * np.pi * cycles)
        for span in SPANS:
            shifts = np.linspace(-span, span, 5)
            decay, omega = _best(groups, rates, decay * np.exp(shifts), omega + 2 * np.pi * CYCLE_STEP * shifts)
        rates = np.append(rates, -decay + 1j * omega)
    return rates


def damped_columns(times: np.ndarray, rates: np.ndarray, offset: bool) -> np.ndarray:
    """Return damped sinusoids of the rates (k,), and a constant for an offset, at the times: (n, 2k) or (n, 2k + 1)."""
    waves = np.exp(rates * times[:, None])
    return np.concatenate([waves.real, -waves.imag, np.ones((times.size, int(offset)))], axis=1)


def _groups(channels: Sequence[Channel]) -> list[list[Channel]]:
    """Scale channels to unit norm and group those sampled at the same times."""
    groups: dict[tuple[bytes, bool], list[Channel]] = {}
    for c in channels:
        unit = replace(c, values=c.values / (float(np.linalg.norm(c.values)) or 1.0))
        groups.setdefault((c.times.tobytes(), c.offset), []).append(unit)
    return list(groups.values())


def _best(
    groups: Sequence[Sequence[Channel]], rates: np.ndarray, decays: np.ndarray, omegas: np.ndarray
) -> tuple[float, float]:
    """Return decay and angular frequency of the wave that reduces the misfit most when added to those of ``rates``."""
    total = sum((_gains(group, rates, decays, omegas) for group in groups), np.zeros((decays.size, omegas.size)))
    i, j = np.unravel_index(int(np.argmax(total)), total.shape)
    return float(decays[i]), float(omegas[j])


def _gains(group: Sequence[Channel], rates: np.ndarray, decays: np.ndarray, omegas: np.ndarray) -> np.ndarray:
    """Return the reduction of a group's sum of squares by one more wave, (n_decays, n_omegas)."""
    times = group[0].times
    basis = np.linalg.qr(damped_columns(times, rates, group[0].offset))[0].T
    return gains(times, np.stack([c.values for c in group]), basis, decays, omegas)


def gains(
    times: np.ndarray, values: np.ndarray, basis: np.ndarray, decays: np.ndarray, omegas: np.ndarray
) -> np.ndarray:
    """Compute by how much a wave reduces the sum of squares of values, when added to given columns.

    Args:
        times: (n,).
        values: (r, n).
        basis: The columns already selected, orthonormal, (k, n).
        decays: Decay rates of the grid.
        omegas: Angular frequencies of the grid.

    Returns:
        Reduction at each grid point, (n_decays, n_omegas).
    """
    residual = values - (values @ basis.T) @ basis
    phase = np.outer(times, omegas)
    waves = np.stack([np.cos(phase), np.sin(phase)])
    envelopes = np.exp(-np.outer(decays, times))

    def products(rows: np.ndarray) -> np.ndarray:
        """Return inner products of rows (r, n) with the columns: (2, n_decays, r, n_omegas)."""
        return np.asarray((envelopes[:, None] * rows).reshape(-1, times.size) @ waves).reshape(
            2, decays.size, len(rows), omegas.size
        )

    on_basis, on_residual = products(basis), products(residual)
    gram = np.empty((3, decays.size, omegas.size))
    for i, (a, b) in enumerate(((0, 0), (0, 1), (1, 1))):
        gram[i] = envelopes**2 @ (waves[a] * waves[b]) - np.sum(on_basis[a] * on_basis[b], axis=1)
    ridge = RIDGE * np.sum(envelopes**2, axis=1)[:, None]
    cc, cs, ss, (c, s) = gram[0] + ridge, gram[1], gram[2] + ridge, on_residual
    numerator = np.sum(ss[:, None] * c**2 - 2 * cs[:, None] * c * s + cc[:, None] * s**2, axis=1)
    return np.asarray(numerator / np.maximum(cc * ss - cs**2, ridge**2))
