"""A causal filter before the tracker: a band of frequencies, a low-pass with every n-th sample kept, or both.

A linear filter that motion and force pass alike leaves a linear equation of motion as it is; only its answer comes
later, by the filter's delay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bench.contract.online import Sample, Sensor, is_saturated
from bench.errors import InputError

LOOK_S, LOOK_LEAST, LOOK_MOST = 0.5, 250, 20_000
"""Length of a stream (s), and number of its samples, in which the frequency of the motion is looked for."""
FINER, PEAKS, LEAST_PEAK = 8, 3, 1e-3
"""Frequencies of that spectrum over those that its length resolves; peaks that are named, and their least power over
the largest's."""
MAINS, NEAR = (50.0, 60.0), 0.5
"""Frequencies of the mains (Hz), and how near (Hz) to a multiple of one a peak may be its."""
PASSED = 0.8
"""Part of the new Nyquist frequency that the low-pass leaves as it is; of the kind of ``scipy.signal.decimate``, but of
odd order, so that a constant passes."""
LONGEST_FILLED = 100
"""Missing samples that are filled with the one before; behind a longer gap the filter begins anew."""


SAVED = ("memory", "block", "last", "held", "before", "repeats", "lowest", "highest")


@dataclass
class Filter:
    """Takes each sample of a stream and gives one in ``decimate``; ``band`` in Hz, ``interval`` (s) of the stream.

    What a step changes: the filter's ``memory``, samples of the next output (``block``, NaN where one is missing), the
    time and values of the sample before, what the filter made of it (``before``), and the extreme values so far.
    """

    interval: float
    decimate: int = 1
    band: tuple[float, float] | None = None
    sensors: Sequence[Sensor] = ()
    memory: np.ndarray | None = None
    block: list[list[float]] = field(default_factory=list)
    last: float | None = None
    held: list[float] = field(default_factory=list)
    before: np.ndarray | None = None

    def __post_init__(self) -> None:
        self.sections: np.ndarray | None = None
        n = len(self.sensors)
        self.repeats, self.lowest, self.highest = [0] * n, [float("inf")] * n, [float("-inf")] * n
        if self.band is None and self.decimate == 1:
            return
        from scipy.signal import butter, cheby1  # slow to import, and few streams need it

        rate, sections = 1.0 / self.interval, []
        if self.band is not None:
            if not 0 < self.band[0] < self.band[1] < rate / 2:
                raise InputError(
                    "band", "{:g}:{:g}".format(*self.band), f"in Hz, below half the rate, {rate / 2:.4g} Hz"
                )
            sections.append(butter(2, self.band, "bandpass", fs=rate, output="sos"))
        if self.decimate > 1:
            sections.append(cheby1(7, 0.05, PASSED / self.decimate, output="sos"))
        self.sections = np.vstack(sections)

    @property
    def delay(self) -> float:
        """The group delay (s) at the middle of the band, or at low frequency."""
        from scipy.signal import sosfreqz

        if self.sections is None:
            return 0.0
        middle = np.sqrt(self.band[0] * self.band[1]) if self.band else 0.1 / self.decimate / self.interval
        at = 2 * np.pi * middle * self.interval * np.array([0.999, 1.001])
        phase = np.unwrap(np.angle(sosfreqz(self.sections, at)[1]))
        return float(-np.diff(phase)[0] / np.diff(at)[0] * self.interval)

    def take(self, sample: Sample) -> Sample | None:
        """Return the filtered sample that one completes, if any; one not after the sample before is left out."""
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
        """Return what the filter makes of rows that end at a time: of the motion, and of the force until ``end``.

        A force is held from a sample to the next. So that this delays it by nothing, it is the mean over that time, and
        the motion is that of the beginning.
        """
        from scipy.signal import sosfilt, sosfilt_zi

        missing = np.all(np.isnan(rows[-self.decimate :, :n]), axis=0)
        for row, before in zip(rows, [np.array(self.held or [0.0] * rows.shape[1]), *rows], strict=False):
            np.copyto(row, before, where=~np.isfinite(row))
        self.held = rows[-1].tolist()
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
        """What :meth:`restored` goes on from."""
        return {name: getattr(self, name) for name in SAVED}


def look(interval: float) -> int:
    """Return how many samples are looked at before the first is taken: none of a slow stream, or its answers wait."""
    n = round(LOOK_S / interval)
    return min(n, LOOK_MOST) if n >= LOOK_LEAST else 0


def survey(
    samples: Sequence[Sample], interval: float, band: tuple[float, float] | None, decimate: int | None
) -> tuple[int, str]:
    """Return the decimation of a stream, the given one or what its first samples can spare, and what they show.

    Args:
        samples: The first samples; fewer than are needed where the stream is slow.
        interval: Sampling interval (s).
        band: Frequencies (Hz) that the method will be given, if not all.
        decimate: The decimation that is asked for, if any.
    """
    rate, within = 1.0 / interval, "" if band is None else " in band={:g}:{:g}".format(*band)
    if len(samples) < LOOK_LEAST:
        return decimate or 1, _seen(rate, decimate or 1)
    from bench.records.problem import CYCLE_SAMPLES

    peaks, strongest = _peaks(samples, interval, band or (0.0, rate))
    spare = min(rate / strongest / CYCLE_SAMPLES, PASSED * rate / 2.0 / band[1] if band else np.inf)
    thinned = decimate or max(int(spare), 1)
    others = "".join(f", then {f:.4g} Hz ({size:.2g} of it)" for f, size in peaks[1:])
    text = f"{_seen(rate, thinned)}; strongest{within}: {peaks[0][0]:.4g} Hz{others}"
    mains = any(abs(strongest - base * max(round(strongest / base), 1)) < NEAR for base in MAINS)
    if mains or spare < 1.0:
        reason = "may be the mains" if mains else f"has {rate / strongest:.2g} samples per cycle"
        text += (
            f". {strongest:.4g} Hz {reason}: if it is not the motion, give band=lo:hi (Hz) about the motion's frequency"
        )
    return thinned, text


def _seen(rate: float, thinned: int) -> str:
    return f"sampling rate {rate:,.6g} 1/s, decimate={thinned}" + (
        f" leaves {rate / thinned:,.4g}" if thinned > 1 else ""
    )


def _peaks(
    samples: Sequence[Sample], interval: float, band: tuple[float, float]
) -> tuple[list[tuple[float, float]], float]:
    """Return frequency (Hz) and relative amplitude of the strongest peaks, and the highest of the sensors' largest."""
    from scipy.signal import find_peaks, periodogram  # slow to import, and few streams need it

    values = np.array([sample.values for sample in samples])
    values = np.where(np.isfinite(values), values, np.nanmean(values, axis=0))
    frequencies, power = periodogram(values, 1.0 / interval, "hann", FINER * len(values), axis=0)
    least = 1.0 / interval / len(values)  # one cycle, also of a sensor that does not move yet
    power[(frequencies < max(band[0], least)) | (frequencies > band[1])] = 0.0
    largest = frequencies[np.argmax(power, axis=0)]
    total = np.append(np.max(power / np.maximum(np.max(power, axis=0), 1e-300), axis=1), 0.0)
    places = find_peaks(total, LEAST_PEAK, distance=2 * FINER)[0]
    places = places[np.argsort(-total[places])][:PEAKS] if places.size else np.array([np.argmax(total)])
    return [(float(frequencies[i]), float(np.sqrt(total[i]))) for i in places], max(float(np.max(largest)), least)
