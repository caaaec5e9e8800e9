"""A causal filter before the tracker: a band-pass, a low-pass with decimation, or both.

Filtering motion and force with the same linear filter leaves a linear equation of motion unchanged; it only delays the
estimates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bench.contract.online import Sample, Sensor, is_saturated
from bench.errors import InputError

LOOK_S, LOOK_LEAST, LOOK_MOST = 0.5, 250, 20_000
"""Duration (s), and smallest and largest number of samples, of the initial part that is analysed for its
frequencies."""
FINER, PEAKS, LEAST_PEAK = 8, 3, 1e-3
"""Zero-padding factor of the spectrum; number of peaks to report, and their smallest power relative to the largest."""
MAINS, NEAR = (50.0, 60.0), 0.5
"""Mains frequencies (Hz), and the distance (Hz) from a harmonic within which a peak is attributed to the mains."""
PASSED = 0.8
"""Passband edge of the low-pass over the new Nyquist frequency. The filter is that of ``scipy.signal.decimate`` with an
odd order, for which the gain at frequency 0 is 1."""
LONGEST_FILLED = 100
"""Longest gap that is filled with the last sample; after a longer gap the filter is reset."""


SAVED = ("memory", "block", "last", "last_values", "before", "repeats", "lowest", "highest")


@dataclass
class Filter:
    """Filters a stream with sampling ``interval`` (s) to a ``band`` (Hz) and decimates it by ``decimate``.

    The state consists of the filter's ``memory``, the samples of the next output (``block``, NaN if missing), time and
    values of the ``last`` sample and its filtered values (``before``), and the extreme values of each sensor.
    """

    interval: float
    decimate: int = 1
    band: tuple[float, float] | None = None
    sensors: Sequence[Sensor] = ()
    memory: np.ndarray | None = None
    block: list[list[float]] = field(default_factory=list)
    last: float | None = None
    last_values: list[float] = field(default_factory=list)
    before: np.ndarray | None = None

    def __post_init__(self) -> None:
        self.sections: np.ndarray | None = None
        n = len(self.sensors)
        self.repeats, self.lowest, self.highest = [0] * n, [float("inf")] * n, [float("-inf")] * n
        if self.band is None and self.decimate == 1:
            return
        from scipy.signal import butter, cheby1  # slow to import

        rate, sections = 1.0 / self.interval, []
        if self.band is not None:
            if not 0 < self.band[0] < self.band[1] < rate / 2:
                raise InputError(
                    "band", "{:g}:{:g}".format(*self.band), f"must be below half the sampling rate, {rate / 2:.4g} Hz"
                )
            sections.append(butter(2, self.band, "bandpass", fs=rate, output="sos"))
        if self.decimate > 1:
            sections.append(cheby1(7, 0.05, PASSED / self.decimate, output="sos"))
        self.sections = np.vstack(sections)

    @property
    def delay(self) -> float:
        """The group delay (s) at the centre of the band, or at low frequency without a band."""
        from scipy.signal import sosfreqz

        if self.sections is None:
            return 0.0
        middle = np.sqrt(self.band[0] * self.band[1]) if self.band else 0.1 / self.decimate / self.interval
        angles = 2 * np.pi * middle * self.interval * np.array([0.999, 1.001])
        phase = np.unwrap(np.angle(sosfreqz(self.sections, angles)[1]))
        return float(-np.diff(phase)[0] / np.diff(angles)[0] * self.interval)

    def take(self, sample: Sample) -> Sample | None:
        """Process a sample; returns the filtered sample that it completes, if any. Repeated times are ignored."""
        if self.sections is None:
            return sample
        steps = 1.0 if self.last is None else (sample.time - self.last) / self.interval
        if not steps > 0.5:
            return None
        self.last = sample.time
        if steps > LONGEST_FILLED:
            self.memory, self.block = None, []
        else:
            self.block += [[float("nan")] * (len(sample.values) + len(sample.forces))] * (round(steps) - 1)
        values = enumerate(zip(sample.values, self.sensors, strict=True))
        self.block.append([float("nan") if is_saturated(self, i, y, sensor) else y for i, (y, sensor) in values])
        self.block[-1] += sample.forces
        ready = len(self.block) // self.decimate * self.decimate
        if not ready:
            return None
        rows, self.block = np.array(self.block[:ready]), self.block[ready:]
        return self._output(rows, len(sample.values), sample.time - len(self.block) * self.interval)

    def _output(self, rows: np.ndarray, n: int, end: float) -> Sample | None:
        """Return the filtered sample of input rows that end at time ``end``.

        A force is constant from one output sample to the next, so it is averaged over this interval, and the motion is
        that at its beginning; both then have the same delay.
        """
        from scipy.signal import sosfilt, sosfilt_zi

        missing = np.all(np.isnan(rows[-self.decimate :, :n]), axis=0)
        for row, before in zip(rows, [np.array(self.last_values or [0.0] * rows.shape[1]), *rows], strict=False):
            np.copyto(row, before, where=~np.isfinite(row))
        self.last_values = rows[-1].tolist()
        if self.memory is None:
            self.memory = sosfilt_zi(self.sections)[:, :, None] * rows[0]
            self.before = None
        filtered, self.memory = sosfilt(self.sections, rows, axis=0, zi=self.memory)
        course = filtered if self.before is None else np.vstack([self.before, filtered])
        self.before = filtered[-1:].copy()
        self.before[0, :n][missing] = np.nan
        if n == rows.shape[1]:
            return Sample(end, tuple(self.before[0].tolist()))
        if len(course) <= self.decimate:
            return None
        forces = np.mean(course[-self.decimate - 1 : -1, n:], axis=0)
        values = course[-self.decimate - 1, :n]
        return Sample(end - self.decimate * self.interval, tuple(values.tolist()), tuple(forces.tolist()))

    def saved(self) -> dict[str, Any]:
        """Return the state, from which a resumed session continues."""
        return {name: getattr(self, name) for name in SAVED}


def look(interval: float) -> int:
    """Return the number of initial samples to analyse; 0 for a slow stream, to avoid delaying its estimates."""
    n = round(LOOK_S / interval)
    return min(n, LOOK_MOST) if n >= LOOK_LEAST else 0


def survey(
    samples: Sequence[Sample], interval: float, band: tuple[float, float] | None, decimate: int | None
) -> tuple[int, str]:
    """Choose the decimation of a stream from the frequencies in its first samples.

    Args:
        samples: The first samples; there may be too few for a choice.
        interval: Sampling interval, s.
        band: Band of the filter, Hz, if any.
        decimate: Decimation requested by the user, if any.

    Returns:
        The decimation, and a description of the frequencies for the user.
    """
    rate, within = 1.0 / interval, "" if band is None else " in band={:g}:{:g}".format(*band)
    if len(samples) < LOOK_LEAST:
        return decimate or 1, _rates(rate, decimate or 1)
    from bench.records.problem import CYCLE_SAMPLES

    peaks, strongest = _peaks(samples, interval, band or (0.0, rate))
    spare = min(rate / strongest / CYCLE_SAMPLES, PASSED * rate / 2.0 / band[1] if band else np.inf)
    factor = decimate or max(int(spare), 1)
    others = "".join(f", then {f:.4g} Hz ({size:.2g} of it)" for f, size in peaks[1:])
    text = f"{_rates(rate, factor)}; strongest{within}: {peaks[0][0]:.4g} Hz{others}"
    mains = any(abs(strongest - base * max(round(strongest / base), 1)) < NEAR for base in MAINS)
    if mains or spare < 1.0:
        reason = "may be the mains" if mains else f"has {rate / strongest:.2g} samples per cycle"
        text += (
            f". {strongest:.4g} Hz {reason}: if it is not the motion, give band=lo:hi (Hz) about the motion's frequency"
        )
    return factor, text


def _rates(rate: float, factor: int) -> str:
    return f"sampling rate {rate:,.6g} 1/s, decimate={factor}" + (f" leaves {rate / factor:,.4g}" if factor > 1 else "")


def _peaks(
    samples: Sequence[Sample], interval: float, band: tuple[float, float]
) -> tuple[list[tuple[float, float]], float]:
    """Return frequency (Hz) and relative amplitude of the largest peaks, and the highest dominant frequency of a
    sensor."""
    from scipy.signal import find_peaks, periodogram  # slow to import

    values = np.array([sample.values for sample in samples])
    values = np.where(np.isfinite(values), values, np.nanmean(values, axis=0))
    frequencies, power = periodogram(values, 1.0 / interval, "hann", FINER * len(values), axis=0)
    least = 1.0 / interval / len(values)  # one cycle over the samples
    power[(frequencies < max(band[0], least)) | (frequencies > band[1])] = 0.0
    largest = frequencies[np.argmax(power, axis=0)]
    total = np.append(np.max(power / np.maximum(np.max(power, axis=0), 1e-300), axis=1), 0.0)
    places = find_peaks(total, LEAST_PEAK, distance=2 * FINER)[0]
    places = places[np.argsort(-total[places])][:PEAKS] if places.size else np.array([np.argmax(total)])
    return [(float(frequencies[i]), float(np.sqrt(total[i]))) for i in places], max(float(np.max(largest)), least)
