"""Where to start, from the data alone: the damped sine wave that fits the measurements best, by a scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench import Channel, Problem

DECAYS = (0.2, 1.0, 3.0, 8.0)
"""Decay rates tried, times the duration: from nearly undamped to gone within an eighth of the record."""
PER_HALF_CYCLE = 4
"""Frequencies tried in each step of half a cycle a record."""


@dataclass(frozen=True)
class Guess:
    """A damped wave ``exp(-decay t) (a cos(omega t) + b sin(omega t))`` and the share of the data that it leaves.

    ``omega`` (rad per unit of time), ``decay`` (per unit of time); ``left`` is its sum of squared residuals over that
    of the data, with every channel scaled to unit size.
    """

    omega: float
    decay: float
    left: float


def scan(problem: Problem, waves: int = 1) -> tuple[list[Guess], float]:
    """The local minima over frequency of the best fit by one damped wave, best first (at least one); and what is left.

    A periodogram with decay: for every frequency and decay of a grid, amplitudes (and a constant, where a channel has
    an unknown one) of every channel by linear least squares. Frequencies end at the mean sampling's Nyquist limit.
    The second value is the share of the data that ``waves`` waves leave, found one after the other.
    """
    duration = max(record.duration for record in problem.records)
    n = max(channel.n for record in problem.records for channel in record.channels)
    halves = np.arange(0.5, max(n - 1, 2) + 1e-9, 1.0 / PER_HALF_CYCLE)
    omegas, decays = np.pi * halves / duration, np.array(DECAYS) / duration
    channels = [c for r in problem.records for c in r.channels if c.n > 4 and np.any(c.values)]
    fixed = [np.ones((c.n, 1)) if c.offset else np.zeros((c.n, 0)) for c in channels]
    guesses: list[Guess] = []
    left = 1.0
    for _ in range(waves):
        found = _best(channels, fixed, omegas, decays)
        guesses = guesses or found
        left = found[0].left
        if min((c.n - f.shape[1] for c, f in zip(channels, fixed, strict=True)), default=0) < 5:
            break
        fixed = [
            np.hstack([f, _wave(c.times, np.array([found[0].omega]), np.array([found[0].decay]))[0, 0]])
            for c, f in zip(channels, fixed, strict=True)
        ]
    return guesses, left


def _best(channels: list[Channel], fixed: list[np.ndarray], omegas: np.ndarray, decays: np.ndarray) -> list[Guess]:
    """Local minima over frequency when one wave is added to the fixed columns of each channel, best first."""
    left = np.zeros((omegas.size, decays.size))
    for channel, columns in zip(channels, fixed, strict=True):
        left += _left(channel.times, channel.values, columns, omegas, decays) / len(channels)
    score, best = left.min(axis=1), left.argmin(axis=1)
    padded = np.concatenate([[np.inf], score, [np.inf]])
    minima = np.flatnonzero((score <= padded[:-2]) & (score < padded[2:]))
    order = minima[np.argsort(score[minima], kind="stable")]
    return [Guess(float(omegas[i]), float(decays[best[i]]), float(score[i])) for i in order]


def _wave(t: np.ndarray, omegas: np.ndarray, decays: np.ndarray) -> np.ndarray:
    """The two columns of each wave, (n_omegas, n_decays, n_times, 2)."""
    envelope = np.exp(-decays[:, None] * t)
    phase = omegas[:, None, None] * t
    return np.stack([envelope * np.cos(phase), envelope * np.sin(phase)], -1)


def _left(t: np.ndarray, y: np.ndarray, fixed: np.ndarray, omegas: np.ndarray, decays: np.ndarray) -> np.ndarray:
    """Shares of the sum of squares (n_omegas, n_decays) that each wave leaves, together with the fixed columns."""
    waves = _wave(t, omegas, decays)
    a = np.concatenate([np.broadcast_to(fixed, (*waves.shape[:2], *fixed.shape)), waves], -1)
    q, _ = np.linalg.qr(a)
    return np.asarray(np.maximum(1.0 - np.sum((y @ q) ** 2, -1) / (y @ y), 0.0))
