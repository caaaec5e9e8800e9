"""A sensor that drifts: the straight line under a vibration, taken away before anything is fitted.

The mean over one period of a vibration has little of it left, so a straight line through the moving mean is the
drift's. Of a decay the mean keeps about the damping ratio's part, which alternates and does not bend the line by more
than that over the number of cycles.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.errors import InputError
from bench.records.reading.signals import Recording, Signal
from bench.records.strongest import strongest_frequency

LEAST_CYCLES = 4.0
"""Below which a line and a vibration are not told apart."""


def detrended(recording: Recording) -> Recording:
    """The recording without the drift of its displacements, and with a note of how much that was.

    Raises:
        InputError: fewer than four cycles.
    """
    notes, signals = list(recording.notes), []
    for signal in recording.signals:
        if signal.measures != "displacement":
            signals.append(signal)
            continue
        slope, middle = _line(signal, recording.source)
        drift = slope * (signal.times - middle)
        share = 100.0 * abs(slope) * float(np.ptp(signal.times)) / (float(np.ptp(signal.values - drift)) or 1.0)
        said = f"{signal.role}: a drift of {slope:.3g} {signal.unit}/s is taken away"
        notes.append(f"{said}, {share:.2g} % of the motion over the record")
        signals.append(replace(signal, values=signal.values - drift))
    return replace(recording, signals=tuple(signals), notes=tuple(notes))


def _line(signal: Signal, source: str) -> tuple[float, float]:
    """Slope of the line through the means over one period, and the middle of the times."""
    first = np.polynomial.Polynomial.fit(signal.times, signal.values, 1).convert().coef
    level = signal.values - np.polynomial.polynomial.polyval(signal.times, first)
    period = 1.0 / strongest_frequency(signal.times, level)
    span = float(signal.times[-1] - signal.times[0])
    if span < LEAST_CYCLES * period:
        remedy = f"{source} has {span / period:.2g} cycles of {signal.role}; at least {LEAST_CYCLES:g} are needed"
        raise InputError("detrend", "true", remedy)
    fine = np.linspace(signal.times[0], signal.times[-1], 4 * signal.times.size)
    step = fine[1] - fine[0]
    areas = np.concatenate([[0.0], np.cumsum(np.diff(fine) * _middles(np.interp(fine, signal.times, signal.values)))])
    centres = fine[(fine > fine[0] + 0.5 * period + step) & (fine < fine[-1] - 0.5 * period - step)]
    after, before = (np.interp(centres + side * 0.5 * period, fine, areas) for side in (1.0, -1.0))
    slope = np.polynomial.Polynomial.fit(centres, (after - before) / period, 1).convert().coef[1]
    return float(slope), 0.5 * float(signal.times[0] + signal.times[-1])


def _middles(values: np.ndarray) -> np.ndarray:
    return np.asarray((values[1:] + values[:-1]) / 2.0)
