"""Hammer blows, shaker records and frequency responses from files, for the modal methods."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bench.contract.modal import DERIVATIVES, Blows, FrequencyResponses, Response
from bench.errors import InputError
from bench.modal.averages import averages, decay_needed
from bench.modal.blows import ForcedRecord, blows_of
from bench.records.reading import ReadOptions, Recording, Signal
from bench.records.reading.columns import EXAMPLES, LETTER_OF
from bench.records.reading.formats import SI_UNITS
from bench.records.reading.headings import Column
from bench.records.reading.table import Spectrum
from bench.records.reading.units import KNOWN, unit_of
from bench.records.saturation import at_limit

RESPONSES: dict[str, Response] = {"displacement": "receptance", "velocity": "mobility", "acceleration": "accelerance"}
"""Kind of frequency response by the kind of motion."""
UNEVEN = 0.01
"""Largest relative deviation of a sampling interval from the mean, and of the sampling rates of two files."""
FEWEST_LINES = 16
"""Least number of lines of a frequency response."""
ForcedData = tuple[Blows | FrequencyResponses, tuple[str, ...], tuple[str, ...], tuple[str, ...]]
"""Data, names of the outputs, their units, and notes."""


def has_force(recordings: Sequence[Recording]) -> bool:
    """Return whether any recording has a force that is not constant."""
    return any(s.measures == "force" and np.ptp(s.values) > 0 for recording in recordings for s in recording.signals)


def forced_motion(recordings: Sequence[Recording], window: float = 0.0) -> ForcedData:
    """Return the hammer blows in recordings, or the record of a shaker.

    Args:
        recordings: Recordings of one point of force, with one or more blows each.
        window: Decay rate (1/s) of the exponential window that was applied to the responses.

    Returns:
        Data, names and units of the outputs, and notes.

    Raises:
        InputError: There are several forces, kinds of response or sets of sensors, or times are uneven.
    """
    records, steps, notes = [], [], [note for recording in recordings for note in recording.notes]
    first = _motions(recordings[0])
    for recording in recordings:
        motions, forces = _motions(recording), [s for s in recording.signals if s.measures == "force"]
        if len(forces) != 1:
            remedy = f"it has {len(forces)} forces; one is needed: select its column by columns=f:…"
            raise InputError("data", recording.source, remedy)
        if [(s.role, s.unit) for s in motions] != [(s.role, s.unit) for s in first]:
            remedy = f"its responses differ from those of {recordings[0].source}; use files of the same sensors"
            raise InputError("data", recording.source, remedy)
        steps.append(_step(recording))
        for signal in motions:
            if at_limit(signal.values).any():
                notes.append(f"{recording.source}: {signal.role} is clipped at the limit of its sensor")
        records.append(
            ForcedRecord(Path(recording.source).name, forces[0].values, np.stack([s.values for s in motions]))
        )
    if np.ptp(steps) > UNEVEN * steps[0]:
        raise InputError("data", recordings[-1].source, "its sampling rate differs from that of the first file")
    blows, blow_notes = blows_of(records, float(np.mean(steps)), RESPONSES[first[0].measures], window)
    notes += [*blow_notes, averages(blows).summary()]
    if decay_needed(blows) > 0.0 and len(blows.forces) > 1:
        notes.append("the motion outlasts the records: averages are biased by leakage near the natural frequencies")
    if window > 0.0:
        notes.append(_windowed(window))
    return blows, tuple(s.role for s in first), tuple(s.unit for s in first), tuple(dict.fromkeys(notes))


def _windowed(window: float) -> str:
    return f"the damping added by the exponential window, {window:g} 1/s, is subtracted from that of the modes"


def _motions(recording: Recording) -> list[Signal]:
    """Return the responses of a recording; raises InputError for no response or several kinds."""
    motions = [signal for signal in recording.signals if signal.measures != "force"]
    kinds = list(dict.fromkeys(signal.measures for signal in motions))
    if len(kinds) == 1:
        return motions
    remedy = f"responses are {' and '.join(kinds)}; select one kind by columns=" if kinds else "it has no response"
    raise InputError("data", recording.source, remedy)


def _step(recording: Recording) -> float:
    """Return the common sampling interval (s) of all signals; raises InputError if there is none."""
    times = recording.signals[0].times
    step = float(np.mean(np.diff(times)))
    if np.max(np.abs(np.diff(times) - step)) > UNEVEN * step:
        raise InputError("data", recording.source, "gaps or uneven times; forced responses need evenly spaced samples")
    for signal in recording.signals[1:]:
        if signal.times.size != times.size or np.max(np.abs(signal.times - times)) > UNEVEN * step:
            remedy = f"{signal.role} and {recording.signals[0].role} are sampled at different times"
            raise InputError("data", recording.source, remedy)
    return step


def frequency_responses(
    spectra: Sequence[Spectrum], source: str, options: ReadOptions, response: Response | None, window: float = 0.0
) -> ForcedData:
    """Return frequency responses in SI units, one output each.

    Responses at one point to forces at several points (roving hammer) are treated as outputs, as the response at A to a
    force at B is that at B to a force at A (reciprocity, J. W. S. Rayleigh, The Theory of Sound, section 107).

    Args:
        spectra: Frequency responses of the files.
        source: Names of the files, for errors.
        options: ``units`` for files without units.
        response: Kind of response for files that do not state it.
        window: Decay rate (1/s) of an exponential window on the data.

    Returns:
        Data, names and units of the outputs, and notes.

    Raises:
        InputError: The kind of response or its unit is unknown, or both the points of force and those of response
            differ.
    """
    columns = [spectrum.response for spectrum in spectra]
    measured = {column.unit.measures if column.unit else column.says for column in columns}
    if len(measured) > 1 or not measured <= {*RESPONSES, None}:
        remedy = f"{' and '.join(str(m or 'unknown') for m in measured)} over force; use responses of one kind"
        raise InputError("data", source, remedy)
    kind = RESPONSES.get(str(*measured), response)
    if kind is None:
        remedy = f"unknown kind of response; add response={' or response='.join(DERIVATIVES)}"
        raise InputError("data", source, remedy)
    if response not in (None, kind):
        raise InputError("response", response, f"{source} contains {kind}; omit response=")
    points, outputs = [s.force_point for s in spectra], [column.header for column in columns]
    roved = len(set(points)) > 1
    if roved and len(set(outputs)) > 1:
        pairs = f"forces at {', '.join(dict.fromkeys(points))} and responses at {', '.join(dict.fromkeys(outputs))}"
        raise InputError("data", source, f"{pairs}; use a single point of force, or a single response")
    frequencies, *others = [np.asarray(column.times) for column in columns]
    tolerance = UNEVEN * float(np.ptp(frequencies)) / frequencies.size
    if any(other.shape != frequencies.shape or np.max(np.abs(other - frequencies)) > tolerance for other in others):
        raise InputError("data", source, "responses are at different frequencies; use responses at the same ones")
    motion = {kind: measures for measures, kind in RESPONSES.items()}[kind]
    sizes = [_size(s.response, motion, source, options) / _size(s.force, "force", source, options) for s in spectra]
    values = np.stack([size * column.values for size, column in zip(sizes, columns, strict=True)])
    kept = (frequencies > 0.0) & np.all(np.isfinite(values), axis=0) & np.any(values != 0.0, axis=0)
    if np.count_nonzero(kept) < FEWEST_LINES:
        raise InputError("data", source, f"{np.count_nonzero(kept)} lines; at least {FEWEST_LINES} are needed")
    names = tuple(points if roved else outputs)
    notes = [f"{kind} at {len(spectra)} {'points of force' if roved else 'outputs'}, {np.count_nonzero(kept)} lines"]
    if roved:
        notes.append(f"points of force are treated as outputs of a force at {outputs[0]} (reciprocity)")
    if window > 0.0:
        notes.append(_windowed(window))
    data = FrequencyResponses(frequencies[kept], values[:, kept], kind, window=window)
    return data, names, (SI_UNITS[motion],) * len(spectra), tuple(notes)


def _size(column: Column, quantity: str, source: str, options: ReadOptions) -> float:
    """Return the size of a column's unit in SI, from units= or else the file; raises InputError for an unknown unit."""
    letter = LETTER_OF[quantity]
    given = options.unit(letter)
    unit = unit_of(given) if given else column.unit
    if unit is not None and unit.measures == quantity:
        return unit.size
    if given or column.label:
        raise InputError(
            "units", f"{letter}:{given or column.label}", f"not a unit of {quantity}; supported: {KNOWN[quantity]}"
        )
    raise InputError("data", source, f"the unit of the {quantity} is unknown; add units={letter}:{EXAMPLES[letter]}")
