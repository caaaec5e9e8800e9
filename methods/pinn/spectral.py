"""Where to start, from the data alone: the damped sine wave that fits the measurements best, by a scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench import Problem

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


def scan(problem: Problem) -> list[Guess]:
    """The local minima over frequency of the best fit, best first; at least one.

    A periodogram with decay: for every frequency and decay of a grid, amplitudes (and a constant, where a channel has
    an unknown one) of every channel by linear least squares. Frequencies end at the mean sampling's Nyquist limit.
    """
    duration = max(record.duration for record in problem.records)
    n = max(channel.n for record in problem.records for channel in record.channels)
    halves = np.arange(0.5, max(n - 1, 2) + 1e-9, 1.0 / PER_HALF_CYCLE)
    omegas = np.pi * halves / duration
    left = np.zeros((omegas.size, len(DECAYS)))
    energy = 0.0
    for record in problem.records:
        for channel in record.channels:
            size = float(channel.values @ channel.values)
            if size == 0.0 or channel.n < 4:
                continue
            energy += 1.0
            left += _residuals(channel.times, channel.values, omegas, np.array(DECAYS) / duration, channel.offset) / size
    best = left.argmin(axis=1)
    score = left.min(axis=1) / max(energy, 1.0)
    padded = np.concatenate([[np.inf], score, [np.inf]])
    minima = np.flatnonzero((score <= padded[:-2]) & (score < padded[2:]))
    order = minima[np.argsort(score[minima], kind="stable")] if minima.size else np.array([int(score.argmin())])
    return [Guess(float(omegas[i]), DECAYS[best[i]] / duration, float(score[i])) for i in order]


def _residuals(t: np.ndarray, y: np.ndarray, omegas: np.ndarray, decays: np.ndarray, offset: bool) -> np.ndarray:
    """Sums of squares (n_omegas, n_decays) that the best wave of each leaves."""
    envelope = np.exp(-decays[:, None] * t)
    phase = omegas[:, None, None] * t
    columns = [envelope * np.cos(phase), envelope * np.sin(phase)]
    if offset:
        columns.append(np.ones_like(columns[0]))
    a = np.stack(columns, -1)
    q, _ = np.linalg.qr(a)
    return np.asarray(np.maximum(y @ y - np.sum(np.einsum("wdtk,t->wdk", q, y) ** 2, -1), 0.0))
