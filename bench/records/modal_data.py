"""Measured data for modal methods: free decays of all sensors, hammer blows, or frequency responses.

Each free decay is a separate record; the blows of all files form one record, and so do their frequency responses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from bench.contract.modal import Blows, FreeDecays, FrequencyResponses, ModalData, Response
from bench.errors import InputError
from bench.likelihood.autoregression import even_times
from bench.records.decimation import PASSED, REACH, decimated
from bench.records.forced_response import forced_motion, frequency_responses, has_force
from bench.records.prepare import prepare
from bench.records.reading import Recording
from bench.records.reading.files import read_file
from bench.records.reading.recording import recordings_of
from bench.records.request import ModalRequest

MOST_SAMPLES, WITHOUT_BAND = 20_000, 10_000
"""Largest number of samples of a free decay, and number after decimation if no band is given."""
LEAST_SAMPLES = 32
"""Least number of samples of a free decay."""


@dataclass(frozen=True, eq=False)
class ModalRecord:
    """Record for modal identification.

    Attributes:
        source: Names of its files.
        data: Free decays, blows or frequency responses.
        channels: Role or point of each output.
        units: Unit of each output.
        notes: Sentences on the preparation.
    """

    source: str
    data: ModalData
    channels: tuple[str, ...]
    units: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def samples(self) -> int:
        """Number of samples per channel, or of lines of a frequency response."""
        values = self.data.responses if isinstance(self.data, Blows) else self.data.values
        return int(values.shape[-1])


def read_modal(request: ModalRequest, recordings: Sequence[Recording] = ()) -> tuple[ModalRecord, ...]:
    """Read and prepare the records of a request.

    Args:
        request: Files, options and band.
        recordings: Recordings that were read already, in place of the files.

    Raises:
        InputError: A file cannot be read, or the request does not fit the records.
    """
    source, options, window = ", ".join(path.name for path in request.files), request.options, request.config.window
    response: Response | None = request.config.response
    if not recordings:
        tables = [(str(path), *read_file(path)) for path in request.files]
        if spectra := [spectrum for _, table, _ in tables for spectrum in table.spectra]:
            records = [ModalRecord(source, *frequency_responses(spectra, source, options, response, window))]
            return _within(request.band, records)
        recordings = [r for path, table, sha256 in tables for r in recordings_of(table, options, path, sha256)]
    if response is not None:
        raise InputError(
            "response", response, "for frequency responses only; the kind of a record follows from its units"
        )
    if has_force(recordings):
        forced = forced_motion([decimated(recording, options.decimate) for recording in recordings], window)
        return _within(request.band, [ModalRecord(source, *forced)])
    if window:
        raise InputError("window", window, "for blows and frequency responses only; omit it")
    return _within(
        request.band, [_free_decays(recording, request.band) for recording in prepare(recordings, options, n_dof=2)]
    )


def _free_decays(recording: Recording, band: tuple[float, float] | None) -> ModalRecord:
    """Return the samples that all sensors have in common, decimated if they are many.

    Raises:
        InputError: There are too few or too many samples.
    """
    sensors = [signal for signal in recording.signals if signal.measures != "force"]
    if not sensors:
        raise InputError("data", recording.source, "no column is a motion; name one by columns=x:<number>")
    times = reduce(np.intersect1d, [signal.times for signal in sensors])
    if times.size < LEAST_SAMPLES:
        common = " common to all sensors" if len(sensors) > 1 else ""
        remedy = f"{times.size} samples{common}; at least {LEAST_SAMPLES} are needed for modes"
        raise InputError("data", recording.source, remedy)
    values = np.stack([signal.values[np.isin(signal.times, times)] / signal.size for signal in sensors])
    times, values, notes = _fewer(times, values, band) if times.size > MOST_SAMPLES else (times, values, ())
    if times.size > MOST_SAMPLES:
        remedy = f"{times.size} samples; at most {MOST_SAMPLES} for modes: use a narrower band=, or a part by to="
        raise InputError("data", recording.source, remedy)
    roles, units = zip(*((signal.role, signal.written or signal.unit) for signal in sensors), strict=True)
    return ModalRecord(recording.source, FreeDecays(times, values), roles, units, (*recording.notes, *notes))


def _fewer(
    times: np.ndarray, values: np.ndarray, band: tuple[float, float] | None
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Decimate samples to those that a band needs, or to ``WITHOUT_BAND`` without a band; return also notes.

    Raises InputError if the dominant frequency would be removed.
    """
    from scipy.signal import resample_poly  # slow to import

    if not even_times(times):
        return times, values, ()
    n, rate = times.size, (times.size - 1) / float(np.ptp(times))
    factor = int(PASSED * rate / (2.0 * band[1])) if band else -(-n // WITHOUT_BAND)
    if factor < 2:
        return times, values, ()
    note = f"low-pass filtered and decimated by {factor} from {n} samples, which is sufficient for the band"
    if band is None:
        power, last = (
            np.abs(np.fft.rfft(values - np.mean(values, axis=1, keepdims=True))) ** 2,
            PASSED * rate / factor / 2,
        )
        frequencies = np.fft.rfftfreq(n, 1.0 / rate)
        if (strongest := float(frequencies[np.argmax(np.max(power, axis=0))])) > last:
            remedy = f"needed for {n} samples with a dominant frequency of {strongest:.3g} Hz"
            raise InputError("band", "none", f"{remedy}; add band={strongest / 2:.3g}:{2 * strongest:.3g}")
        removed = float(np.sqrt(np.sum(power[:, frequencies > last]) / np.sum(power)))
        note = f"low-pass filtered and decimated by {factor} from {n} samples: modes above {last:.4g} Hz "
        note += f"({removed:.0%} of the signal) are not identified; band= selects other frequencies"
    inner = slice(REACH, (n - 1) // factor + 1 - REACH)
    return times[::factor][inner], resample_poly(values, 1, factor, axis=1)[:, inner], (note,)


def _within(band: tuple[float, float] | None, records: Sequence[ModalRecord]) -> tuple[ModalRecord, ...]:
    """Return the records; raises InputError if the band exceeds their frequencies."""
    for record in records:
        data = record.data
        if isinstance(data, FrequencyResponses):
            highest = float(data.frequencies[-1])
        elif isinstance(data, Blows):
            highest = 0.5 / data.step
        else:
            highest = (data.times.size - 1) / float(np.ptp(data.times)) / 2.0
        if band is not None and band[1] > highest * (1 + 1e-9):
            remedy = f"the highest frequency of {record.source} is {highest:.6g} Hz"
            raise InputError("band", f"{band[0]:g}:{band[1]:g}", remedy)
    return tuple(records)
