"""Simulated records of one mass in free decay, and the input features of the network.

The unit of time is the record (the last sample is at 1), that of displacement the root mean square of the record, so
that one network serves all sizes and durations. The motion is drawn from a wide box, independent of the prior:
log-uniform frequency and damping ratio, uniform phase of the initial state, and uniform signal-to-noise ratio in dB.

The features are the samples and the residuals of a bank of damped waves (as in :mod:`methods.starts.scan`): the
residual share of the record after fitting a wave of each frequency and decay, with a free or the known initial state.
The frequency of the least residual is the anchor: the network estimates the frequency relative to it, in steps of the
bank.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

CYCLES, MOST_CYCLES = 0.25, 40.0
"""Range of cycles in a record; the upper limit is at most ``NYQUIST`` times half the sampling rate."""
NYQUIST = 0.95
RATIOS = (1e-3, 2.0)
"""Range of damping ratios."""
DECIBELS = (0.0, 50.0)
"""Range of signal-to-noise ratios (dB)."""
FREQUENCIES, DECAYS = 64, (0.2, 1.0, 3.0, 8.0)
"""Number of frequencies of the bank, and its decay rates times the duration of the record."""
NEIGHBOURS = 3
"""Frequencies on either side of the anchor with features relative to it."""
LEAST_LEFT = 1e-6
"""Lower limit of residual shares in the features."""
CRITICAL = 1e-6
"""Least distance of squared damping ratios from 1, against division by zero."""


@dataclass(frozen=True)
class SampleLayout:
    """``samples`` even times from ``first`` to 1, and whether the initial state is ``known``."""

    samples: int
    first: float
    known: bool

    @cached_property
    def times(self) -> np.ndarray:
        return np.linspace(self.first, 1.0, self.samples)

    @cached_property
    def cycles(self) -> tuple[float, float]:
        """Return the least and largest number of cycles in a record."""
        half_rate = 0.5 * (self.samples - 1) / (1.0 - self.first)
        return CYCLES, min(MOST_CYCLES, NYQUIST * half_rate)

    @cached_property
    def box(self) -> np.ndarray:
        """Return the limits (2, 2) of log angular frequency and log damping ratio: rows lowest, highest."""
        omegas = 2 * np.pi * np.array(self.cycles)
        return np.log(np.stack([omegas, np.array(RATIOS)], axis=1))

    @cached_property
    def bank(self) -> np.ndarray:
        """Return the angular frequencies of the bank, evenly spaced, (FREQUENCIES,)."""
        return np.asarray(2 * np.pi * np.linspace(*self.cycles, FREQUENCIES))

    @cached_property
    def waves(self) -> np.ndarray:
        """Return the bank's responses to unit displacement and unit velocity, (FREQUENCIES, decays, 2, samples)."""
        omega, decay = self.bank[:, None], np.array(DECAYS)
        return np.stack(unit_responses(np.hypot(omega, decay), decay / np.hypot(omega, decay), self.times), axis=2)

    @cached_property
    def products(self) -> np.ndarray:
        """Return the inner products of each pair of responses, (3, pairs)."""
        even, odd = np.moveaxis(self.waves.reshape(-1, 2, self.samples), 1, 0)
        return np.stack([np.sum(a * b, axis=1) for a, b in ((even, even), (even, odd), (odd, odd))])

    @cached_property
    def bases(self) -> np.ndarray:
        """Return an orthonormal basis of each pair of responses, (FREQUENCIES * decays * 2, samples)."""
        q = np.linalg.qr(np.swapaxes(self.waves, -1, -2))[0]
        return np.ascontiguousarray(np.swapaxes(q, -1, -2).reshape(-1, self.samples))


def unit_responses(omega: np.ndarray, ratio: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return free responses to unit displacement and unit velocity at time 0, (*sets, n_times) each.

    ``e^(-d t) (cosh(w t) + d/w sinh(w t))`` and ``e^(-d t) sinh(w t) / w`` with ``d = ratio omega`` and
    ``w = omega sqrt(ratio² - 1)``, imaginary below critical damping.
    """
    square = ratio**2 - 1.0
    square = np.where(np.abs(square) < CRITICAL, -CRITICAL, square)
    d, w = (ratio * omega)[..., None], (omega * np.sqrt(np.abs(square)))[..., None]
    over = (square > 0)[..., None]
    slow, fast = np.exp(-(d - np.where(over, w, 0.0)) * times), np.exp(-(d + np.where(over, w, 0.0)) * times)
    even = np.where(over, 0.5 * (slow + fast), slow * np.cos(w * times))
    odd = np.where(over, 0.5 * (slow - fast), slow * np.sin(w * times)) / w
    return even + d * odd, odd


@dataclass(frozen=True, eq=False)
class Inputs:
    """Network inputs of records: ``features`` (sets, n), and the log-frequency ``anchor`` of each (sets,).

    ``step`` (sets,): step of the bank at the anchor, in log-frequency.
    """

    features: np.ndarray
    anchor: np.ndarray
    step: np.ndarray


def network_inputs(layout: SampleLayout, values: np.ndarray, starts: np.ndarray | None) -> Inputs:
    """Compute inputs from ``values`` (sets, samples) and known initial states ``starts`` (sets, 2), or None."""
    size = np.sqrt(np.mean(values**2, axis=1, keepdims=True))
    y = values / size
    shape = (len(y), FREQUENCIES, len(DECAYS))
    features = [y]
    if starts is None:
        caught = (y @ layout.bases.T).reshape(*shape, 2)
        residual = layout.samples - np.sum(caught**2, axis=-1)
    else:
        scaled = starts / size
        # residual sum of squares of the response to the known initial state, by inner products
        on = (y @ layout.waves.reshape(-1, layout.samples).T).reshape(*shape, 2)
        both = np.stack([scaled[:, 0] ** 2, 2 * scaled[:, 0] * scaled[:, 1], scaled[:, 1] ** 2], axis=1)
        energy = (both @ layout.products).reshape(shape)
        residual = layout.samples - 2 * np.einsum("bi,bfdi->bfd", scaled, on) + energy
        features.append(np.arcsinh(scaled))
    logs = np.log(np.clip(residual / layout.samples, LEAST_LEFT, 1.0 / LEAST_LEFT))
    best = logs.min(axis=2).argmin(axis=1)
    places = best[:, None] + np.arange(-NEIGHBOURS, NEIGHBOURS + 1)
    inside = (places >= 0) & (places < FREQUENCIES)
    near = np.where(inside[..., None], logs[np.arange(len(y))[:, None], np.clip(places, 0, FREQUENCIES - 1)], 0.0)
    omega = layout.bank[best]
    # demodulation at the anchor: phase along the record, independent of the frequency
    demodulated = y * np.exp(-1j * omega[:, None] * layout.times)
    anchor, step = np.log(omega), (layout.bank[1] - layout.bank[0]) / omega
    features += [near.reshape(len(y), -1), logs.min(axis=2), demodulated.real, demodulated.imag]
    features += [anchor[:, None] - layout.box[0, 0], inside[:, [0, -1]], near.min(axis=(1, 2))[:, None]]
    return Inputs(np.concatenate(features, axis=1).astype(np.float32), anchor, step)


def simulated(layout: SampleLayout, n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draw ``n`` records: log frequency and log damping ratio (n, 2), values (n, samples), initial states (n, 2)."""
    low, high = layout.box
    logs = low + (high - low) * rng.random((n, 2))
    omega, ratio = np.exp(logs).T
    phase = 2 * np.pi * rng.random(n)
    starts = np.stack([np.cos(phase), omega * np.sin(phase)], axis=1)
    even, odd = unit_responses(omega, ratio, layout.times)
    clean = starts[:, :1] * even + starts[:, 1:] * odd
    decibels = DECIBELS[0] + (DECIBELS[1] - DECIBELS[0]) * rng.random((n, 1))
    sigma = np.sqrt(np.mean(clean**2, axis=1, keepdims=True)) * 10 ** (-decibels / 20)
    return logs, clean + sigma * rng.standard_normal(clean.shape), starts
