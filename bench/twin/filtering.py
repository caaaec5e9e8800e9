"""A causal filter before the tracker: a band of frequencies, a low-pass with every n-th sample kept, or both.

A linear filter that motion and force pass alike leaves a linear equation of motion as it is; only its answer comes
later, by the filter's delay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bench.contract.online import Sample, Sensor
from bench.errors import InputError
from bench.records.strongest import strongest_frequency

LOOK_S, LOOK_LEAST, LOOK_MOST = 0.5, 250, 20_000
"""Length of a stream (s), and number of its samples, in which the frequency of the motion is looked for."""
PASSED = 0.8
"""Part of the new Nyquist frequency that the low-pass leaves as it is; of the kind of ``scipy.signal.decimate``, but of
odd order, so that a constant passes."""
LONGEST_FILLED = 100
"""Missing samples that are filled with the one before; behind a longer gap the filter begins anew."""


@dataclass
class Filter:
    """Takes each sample of a stream and gives one in ``decimate``; ``band`` in Hz, ``interval`` (s) of the stream.

    What a step changes: the filter's ``memory``, samples of the next output (``block``, NaN where one is missing), the
    time and values of the sample before, and what the filter made of it (``before``).
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
        limits = [s.limits or (float("-inf"), float("inf")) for s in self.sensors]
        inside = [low < y < high for y, (low, high) in zip(sample.values, limits, strict=True)]
        self.block.append([y if there else float("nan") for y, there in zip(sample.values, inside, strict=True)])
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
        return {name: getattr(self, name) for name in ("memory", "block", "last", "held", "before")}


def look(interval: float) -> int:
    """Return how many samples are looked at before the first is taken: none of a slow stream, or its answers wait."""
    n = round(LOOK_S / interval)
    return min(n, LOOK_MOST) if n >= LOOK_LEAST else 0


def spare_decimation(samples: Sequence[Sample], interval: float) -> tuple[int, float]:
    """Return by how much the first samples of a stream can be decimated, and the frequency (Hz) of their motion."""
    if len(samples) < LOOK_LEAST:
        return 1, 0.0
    from bench.records.problem import CYCLE_SAMPLES

    times = interval * np.arange(len(samples))
    values = np.array([sample.values for sample in samples])
    values = np.where(np.isfinite(values), values, np.nanmean(values, axis=0))
    frequency = max(strongest_frequency(times, column) for column in values.T)
    return max(int(1.0 / interval / frequency / CYCLE_SAMPLES), 1), frequency
