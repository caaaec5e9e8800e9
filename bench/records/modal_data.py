"""What a modal method is given of measured records: free decays of all sensors, read and prepared as for one mode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from bench.contract.modal import Blows, FreeDecays, ModalData
from bench.errors import InputError
from bench.records.prepare import prepare
from bench.records.reading import Recording, read_recordings
from bench.records.request import ModalRequest

LEAST_SAMPLES = 32
"""Of a record in which modes are sought: a pole, its amplitude and a constant are five numbers of a single mode."""


@dataclass(frozen=True, eq=False)
class ModalRecord:
    """A record: its data, role and unit of each channel, and the ``notes`` on what was done to it."""

    source: str
    data: ModalData
    channels: tuple[str, ...]
    units: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def samples(self) -> int:
        """Number of samples of a channel, or of lines of a frequency response."""
        values = self.data.responses if isinstance(self.data, Blows) else self.data.values
        return int(values.shape[-1])


def read_modal(request: ModalRequest, recordings: Sequence[Recording] = ()) -> tuple[ModalRecord, ...]:
    """Return the records of a request, from its files or from what was read of them before; raises InputError."""
    if not recordings:
        recordings = [recording for path in request.files for recording in read_recordings(path, request.options)]
    records = [_free_decays(recording) for recording in prepare(recordings, request.options, n_dof=2)]
    for record in records if request.band is not None else ():
        _check_band(request.band, record)
    return tuple(records)


def _free_decays(recording: Recording) -> ModalRecord:
    """Take the samples that all sensors have; raises InputError where they are too few."""
    sensors = [signal for signal in recording.signals if signal.measures != "force"]
    if not sensors:
        raise InputError("data", recording.source, "no column of it is a motion; name one by columns=x:<number>")
    times = reduce(np.intersect1d, [signal.times for signal in sensors])
    if times.size < LEAST_SAMPLES:
        common = " that all sensors have" if len(sensors) > 1 else ""
        remedy = f"{times.size} samples{common}: at least {LEAST_SAMPLES} are needed for modes"
        raise InputError("data", recording.source, remedy)
    values = np.stack([signal.values[np.isin(signal.times, times)] / signal.size for signal in sensors])
    roles, units = zip(*((signal.role, signal.written or signal.unit) for signal in sensors), strict=True)
    return ModalRecord(recording.source, FreeDecays(times, values), roles, units, recording.notes)


def _check_band(band: tuple[float, float] | None, record: ModalRecord) -> None:
    if band is None or not isinstance(record.data, FreeDecays):
        return
    times = record.data.times
    nyquist = (times.size - 1) / float(np.ptp(times)) / 2.0
    if band[1] > nyquist * (1 + 1e-9):
        remedy = f"{record.source} is sampled at {2 * nyquist:.6g} Hz, so frequencies end at {nyquist:.6g} Hz"
        raise InputError("band", f"{band[0]:g}:{band[1]:g}", remedy)
