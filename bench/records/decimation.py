"""Fewer samples without aliasing: every n-th of a signal that was low-pass filtered before.

Thinning alone folds what lies above half of the new rate onto the vibration, and keeps the noise of each sample.
Here a linear-phase filter (SciPy's ``resample_poly``: Kaiser window, ten new samples to either side) goes first, so the
noise falls with the band. Motion and force pass the same filter, which leaves a linear equation of motion as it is;
samples nearer to an end than the filter reaches are left out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.signal import resample_poly

from bench.contract.problem import MIN_SAMPLES
from bench.errors import InputError
from bench.records.dominant_frequency import dominant_frequency
from bench.records.reading import Recording, Signal

REACH = 10
"""New samples that the filter reaches to either side."""
PASSED = 0.8
"""Part of the new Nyquist frequency up to which the filter leaves a signal as it is, to 1 %."""
UNEVEN = 0.01
"""Largest departure of a sampling interval from their mean, over that mean."""


def decimated(recording: Recording, factor: int) -> Recording:
    """Keep every ``factor``-th sample of the filtered signals, from a common start at time 0, and say what was done.

    Raises:
        InputError: Samples are uneven or too few, or the filter would take the vibration away.
    """
    if factor == 1:
        return recording
    pairs = [_decimated(signal, factor, recording.source) for signal in recording.signals]
    first, last = max(signal.times[0] for signal, _ in pairs), min(signal.times[-1] for signal, _ in pairs)
    room, signals = 1e-9 * (last - first), []
    for signal, _ in pairs:
        kept = (signal.times >= first - room) & (signal.times <= last + room)
        if np.sum(kept) < MIN_SAMPLES:
            remedy = f"{recording.source} keeps {np.sum(kept)} samples of {signal.role}; a smaller one"
            raise InputError("decimate", factor, remedy)
        signals.append(replace(signal, times=signal.times[kept] - first, values=signal.values[kept]))
    return replace(recording, signals=tuple(signals), notes=(*recording.notes, *(said for _, said in pairs)))


def _decimated(signal: Signal, factor: int, path: str) -> tuple[Signal, str]:
    n, step = signal.values.size, float(np.mean(np.diff(signal.times)))
    if np.max(np.abs(np.diff(signal.times) - step)) > UNEVEN * step:
        raise InputError("decimate", factor, f"{signal.role} of {path} has gaps or uneven times")
    if n // factor < 2 * REACH + MIN_SAMPLES:
        most = max(n // (2 * REACH + MIN_SAMPLES), 1)
        raise InputError("decimate", factor, f"{path} has {n} samples of {signal.role}: at most {most}")
    passed = PASSED / (2.0 * factor * step)
    strongest = dominant_frequency(signal.times, signal.values)
    if signal.measures != "force" and strongest > passed:
        remedy = f"the motion is strongest at {strongest:.4g} Hz and only {passed:.4g} Hz would pass; a smaller one"
        raise InputError("decimate", factor, remedy)
    mean = float(np.mean(signal.values))
    values = resample_poly(signal.values - mean, 1, factor) + mean
    inner = slice(REACH, (n - 1) // factor + 1 - REACH)
    kept = replace(signal, times=signal.times[::factor][inner], values=values[inner])
    taken = 100.0 * _power_above(signal.values - mean, PASSED / factor)
    return kept, (
        f"{signal.role}: one in {factor} of {n} samples after a low-pass filter, so {kept.values.size} are left; "
        f"{taken:.2g} % of its power was above the {passed:.4g} Hz that pass unchanged"
    )


def _power_above(values: np.ndarray, part: float) -> float:
    """Return the share of the power of values (n,) of mean zero above a part of their Nyquist frequency."""
    power = np.abs(np.fft.rfft(values)) ** 2
    total = float(np.sum(power))
    return float(np.sum(power[int(part * (power.size - 1)) + 1 :])) / total if total > 0 else 0.0
