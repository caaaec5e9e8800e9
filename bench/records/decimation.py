"""Decimation: a low-pass filter against aliasing, then every n-th sample.

The filter has linear phase (SciPy's ``resample_poly``: Kaiser window, ten new samples on either side). It reduces the
noise with the bandwidth. Motion and force pass the same filter, so a linear equation of motion still holds. Samples
within the length of the filter from either end are dropped.
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
"""Length of the filter on either side, in samples after decimation."""
PASSED = 0.8
"""Share of the new Nyquist frequency up to which the filter passes a signal unchanged, to 1 %."""
UNEVEN = 0.01
"""Largest relative deviation of a sampling interval from the mean at which times count as even."""


def decimated(recording: Recording, factor: int) -> Recording:
    """Decimate the signals of a recording by a factor, over their common time, which begins at 0.

    Args:
        recording: Signals at even times.
        factor: Every ``factor``-th sample is kept; 1 leaves the recording unchanged.

    Raises:
        InputError: Samples are uneven or too few, or the filter would remove the vibration.
    """
    if factor == 1:
        return recording
    pairs = [_decimated(signal, factor, recording.source) for signal in recording.signals]
    first, last = max(signal.times[0] for signal, _ in pairs), min(signal.times[-1] for signal, _ in pairs)
    room, signals = 1e-9 * (last - first), []
    for signal, _ in pairs:
        kept = (signal.times >= first - room) & (signal.times <= last + room)
        if np.sum(kept) < MIN_SAMPLES:
            remedy = f"{recording.source} would keep {np.sum(kept)} samples of {signal.role}; use a smaller factor"
            raise InputError("decimate", factor, remedy)
        signals.append(replace(signal, times=signal.times[kept] - first, values=signal.values[kept]))
    return replace(recording, signals=tuple(signals), notes=(*recording.notes, *(note for _, note in pairs)))


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
        remedy = f"the motion at {strongest:.4g} Hz is above the passband of {passed:.4g} Hz; use a smaller factor"
        raise InputError("decimate", factor, remedy)
    mean = float(np.mean(signal.values))
    values = resample_poly(signal.values - mean, 1, factor) + mean
    inner = slice(REACH, (n - 1) // factor + 1 - REACH)
    kept = replace(signal, times=signal.times[::factor][inner], values=values[inner])
    power = np.abs(np.fft.rfft(signal.values - mean)) ** 2
    above = float(np.sum(power[int(PASSED / factor * (power.size - 1)) + 1 :]))
    removed = 100.0 * above / (float(np.sum(power)) or 1.0)
    return kept, (
        f"{signal.role}: low-pass filtered and decimated by {factor} from {n} to {kept.values.size} samples; "
        f"{removed:.2g} % of its power was above the passband of {passed:.4g} Hz"
    )
