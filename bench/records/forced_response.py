"""Blows, a shaker's record and frequency responses out of files, for the modal methods."""

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
"""What is measured per unit of force, by the kind of motion."""
UNEVEN = 0.01
"""Largest departure of a sampling interval from the mean, and of the rates of two files, over it."""
FEWEST_LINES = 16
"""Of a frequency response."""
Forced = tuple[Blows | FrequencyResponses, tuple[str, ...], tuple[str, ...], tuple[str, ...]]
"""Data, names and units of the outputs, and notes."""


def has_force(recordings: Sequence[Recording]) -> bool:
    """Return whether a force acts in any of the recordings."""
    return any(s.measures == "force" and np.ptp(s.values) > 0 for recording in recordings for s in recording.signals)


def forced_motion(recordings: Sequence[Recording], window: float = 0.0) -> Forced:
    """Return the blows in recordings, or the record of a shaker.

    Args:
        recordings: of one point of force, each of one or more blows
        window: decay rate (1/s) of an exponential window that their responses were multiplied with

    Raises:
        InputError: they are of several forces, kinds of response or sensors, or not sampled evenly.
    """
    records, steps, notes = [], [], [note for recording in recordings for note in recording.notes]
    first = _motions(recordings[0])
    for recording in recordings:
        motions, forces = _motions(recording), [s for s in recording.signals if s.measures == "force"]
        if len(forces) != 1:
            remedy = f"{len(forces)} forces; blows act at one point: name its column by columns=f:…"
            raise InputError("data", recording.source, remedy)
        if [(s.role, s.unit) for s in motions] != [(s.role, s.unit) for s in first]:
            remedy = f"its responses differ from those of {recordings[0].source}; give files of the same sensors"
            raise InputError("data", recording.source, remedy)
        steps.append(_step(recording))
        for signal in motions:
            if at_limit(signal.values).any():
                notes.append(f"{recording.source}: {signal.role} is at the limit of its sensor; do not rely on it")
        records.append(
            ForcedRecord(Path(recording.source).name, forces[0].values, np.stack([s.values for s in motions]))
        )
    if np.ptp(steps) > UNEVEN * steps[0]:
        raise InputError("data", recordings[-1].source, "its sampling rate differs from that of the first file")
    blows, said = blows_of(records, float(np.mean(steps)), RESPONSES[first[0].measures], window)
    notes += [*said, averages(blows).summary()]
    if decay_needed(blows) > 0.0 and len(blows.forces) > 1:
        notes.append("the motion has not ended with the records, so averages of them leak near the natural frequencies")
    if window > 0.0:
        notes.append(_windowed(window))
    return blows, tuple(s.role for s in first), tuple(s.unit for s in first), tuple(dict.fromkeys(notes))


def _windowed(window: float) -> str:
    return f"the damping of the exponential window, {window:g} 1/s, is taken off the modes"


def _motions(recording: Recording) -> list[Signal]:
    """Return the responses of a recording; raises InputError for none, or for several kinds."""
    motions = [signal for signal in recording.signals if signal.measures != "force"]
    kinds = list(dict.fromkeys(signal.measures for signal in motions))
    if len(kinds) == 1:
        return motions
    remedy = (
        f"responses are {' and '.join(kinds)}; keep those of one kind by columns=" if kinds else "no response is in it"
    )
    raise InputError("data", recording.source, remedy)


def _step(recording: Recording) -> float:
    """Return the sampling interval (s) that all signals share."""
    times = recording.signals[0].times
    step = float(np.mean(np.diff(times)))
    if np.max(np.abs(np.diff(times) - step)) > UNEVEN * step:
        raise InputError("data", recording.source, "gaps or uneven times; blows need all samples, evenly spaced")
    for signal in recording.signals[1:]:
        if signal.times.size != times.size or np.max(np.abs(signal.times - times)) > UNEVEN * step:
            raise InputError("data", recording.source, f"{signal.role} is not sampled with {recording.signals[0].role}")
    return step


def frequency_responses(
    spectra: Sequence[Spectrum], source: str, options: ReadOptions, response: Response | None, window: float = 0.0
) -> Forced:
    """Return frequency responses in SI units, with one output for each.

    Those of one response and several points of force, as of a hammer that roves, are outputs as well: the response at
    A to a force at B is that at B to a force at A (reciprocity, J. W. S. Rayleigh, The Theory of Sound, section 107).

    Args:
        spectra: as the files hold them
        source: the files' names, for an error
        options: ``units`` where the files give none
        response: what was measured where the files do not say it
        window: decay rate (1/s) of an exponential window that is still in them

    Raises:
        InputError: what is measured or its unit is not known, or they are no row of one matrix of responses.
    """
    columns = [spectrum.response for spectrum in spectra]
    measured = {column.unit.measures if column.unit else column.says for column in columns}
    if len(measured) > 1 or not measured <= {*RESPONSES, None}:
        remedy = f"{' and '.join(str(m or 'something') for m in measured)} over force; give motions of one kind"
        raise InputError("data", source, remedy)
    kind = RESPONSES.get(str(*measured), response)
    if kind is None:
        remedy = f"it does not say what is measured; add response={' or response='.join(DERIVATIVES)}"
        raise InputError("data", source, remedy)
    if response not in (None, kind):
        raise InputError("response", response, f"{source} says {kind}; leave response= out")
    points, outputs = [s.at for s in spectra], [column.header for column in columns]
    roved = len(set(points)) > 1
    if roved and len(set(outputs)) > 1:
        held = f"forces at {', '.join(dict.fromkeys(points))} and responses at {', '.join(dict.fromkeys(outputs))}"
        raise InputError("data", source, f"{held}; give those of one point of force, or of one response")
    frequencies, *others = [np.asarray(column.times) for column in columns]
    room = UNEVEN * float(np.ptp(frequencies)) / frequencies.size
    if any(other.shape != frequencies.shape or np.max(np.abs(other - frequencies)) > room for other in others):
        raise InputError("data", source, "its responses are at different frequencies; give those of one set")
    motion = {kind: measures for measures, kind in RESPONSES.items()}[kind]
    sizes = [_size(s.response, motion, source, options) / _size(s.force, "force", source, options) for s in spectra]
    values = np.stack([size * column.values for size, column in zip(sizes, columns, strict=True)])
    kept = (frequencies > 0.0) & np.all(np.isfinite(values), axis=0) & np.any(values != 0.0, axis=0)
    if np.count_nonzero(kept) < FEWEST_LINES:
        raise InputError("data", source, f"{np.count_nonzero(kept)} lines of numbers; {FEWEST_LINES} are needed")
    names = tuple(points if roved else outputs)
    notes = [f"{kind} at {len(spectra)} {'points of force' if roved else 'outputs'}, {np.count_nonzero(kept)} lines"]
    if roved:
        notes.append(f"the points of force count as outputs of a force at {outputs[0]} (reciprocity)")
    if window > 0.0:
        notes.append(_windowed(window))
    data = FrequencyResponses(frequencies[kept], values[:, kept], kind, window=window)
    return data, names, (SI_UNITS[motion],) * len(spectra), tuple(notes)


def _size(column: Column, quantity: str, source: str, options: ReadOptions) -> float:
    """Return one unit of a column in SI, as units= or else the file says; raises InputError where neither does."""
    letter = LETTER_OF[quantity]
    given = options.unit(letter)
    unit = unit_of(given) if given else column.unit
    if unit is not None and unit.measures == quantity:
        return unit.size
    if given or column.label:
        raise InputError(
            "units", f"{letter}:{given or column.label}", f"no unit of {quantity}; known are {KNOWN[quantity]}"
        )
    raise InputError("data", source, f"no unit is known of the {quantity}; add units={letter}:{EXAMPLES[letter]}")
