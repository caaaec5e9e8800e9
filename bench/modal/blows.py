"""Blows of a hammer: where it touches, and the records of equal length, one a blow, that a test is cut into."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.signal import find_peaks

from bench.contract.modal import Blows, Response
from bench.errors import InputError

NOISY = 5.0
"""Force over the standard deviation of its noise from which it is no noise: so is one of two million normal samples."""
LEAST_PEAK = 0.1
"""Least peak of a hit over that of the hardest."""
MOST_TOUCHED = 0.2
"""Largest part of a record in which a hammer touches; a force that acts longer is a shaker's."""
HOLD_OFF = 0.1
"""Least time between two blows over the mean time between hits; what comes sooner is a second hit of the same blow."""
PRE_TRIGGER = 0.02
"""Time before a blow that belongs to its record, over the mean time between blows; three times the pulse at least."""
FEWEST_SAMPLES = 64
"""Of a record."""
FEWEST_BLOWS = 2
"""Single blows beside which double hits are left out."""
SHORT = 0.5
"""Length of a record over their median below which it is left out, so that the others need not be as short."""
FLAT = 3
"""Samples in a row at the very maximum from which the force is at the limit of its sensor."""


@dataclass(frozen=True, eq=False)
class ForcedRecord:
    """A record of one or more blows, or of a shaker, as it was measured: ``force`` (n,), ``responses`` (outputs, n).

    ``double``: of a blow with which the hammer hits again.
    """

    name: str
    force: np.ndarray
    responses: np.ndarray
    double: bool = False


def blows_of(
    records: Sequence[ForcedRecord], step: float, response: Response, window: float = 0.0
) -> tuple[Blows, tuple[str, ...]]:
    """Cut records into one a blow, of equal length, each up to the next blow; a shaker's stays whole.

    A double hit is left out where two others are there: noise within two pulses is not one factor of all lines.

    Returns:
        the blows, and in sentences what was done and what is doubtful

    Raises:
        InputError: the records are too short.
    """
    notes: list[str] = []
    pieces = [piece for record in records for piece in _pieces(record, step, notes)]
    if len(single := [piece for piece in pieces if not piece.double]) >= FEWEST_BLOWS:
        pieces = single
    least = SHORT * float(np.median([piece.force.size for piece in pieces]))
    kept = [piece for piece in pieces if piece.force.size >= least]
    n = min(piece.force.size for piece in kept)
    if n < FEWEST_SAMPLES:
        raise InputError("data", kept[0].name, f"{n} samples of force and response; {FEWEST_SAMPLES} are needed")
    if len(pieces) > 1:
        short = ", ".join(piece.name for piece in pieces if piece.force.size < least)
        left_out = f"; less than half as long and left out: {short}" if short else ""
        notes.append(f"{len(kept)} records of {n * step:.4g} s are cut out, each of a blow{left_out}")
    forces, responses = np.stack([p.force[:n] for p in kept]), np.stack([p.responses[:, :n] for p in kept])
    return Blows(step, forces, responses, response, window), tuple(notes)


def _pieces(record: ForcedRecord, step: float, notes: list[str]) -> list[ForcedRecord]:
    """Return the record of each blow, the whole one of a shaker; say which are doubtful."""
    n, size = record.force.size, np.abs(record.force - np.median(record.force))
    if touched(record.force[None]) is None:
        notes.append(f"{record.name}: the force acts all the time, as a shaker's: one record, not cut")
        return [record]
    level = max(LEAST_PEAK * float(np.max(size)), NOISY * _noise(size))
    hits, _ = find_peaks(size, prominence=level)
    first = np.diff(hits, prepend=-n) >= HOLD_OFF * n / max(hits.size, 1)
    blows = hits[first]
    before = int(max(PRE_TRIGGER * n / max(blows.size, 1), 3 * np.count_nonzero(size > level) / max(hits.size, 1)))
    begins = [0] if blows.size < 2 else [max(int(blow) - before, 0) for blow in blows]
    pieces = []
    for k, (begin, end) in enumerate(zip(begins, [*begins[1:], n], strict=True), 1):
        name = f"{record.name} blow {k}" if len(begins) > 1 else record.name
        inside = hits[(hits >= begin) & (hits < end)]
        double = inside.size > 1
        if double:
            later = ", ".join(f"{1e3 * step * (hit - inside[0]):.3g}" for hit in inside[1:])
            notes.append(
                f"{name}: the hammer hits again after {later} ms; left out if {FEWEST_BLOWS} single blows are there"
            )
        peak = size[begin:end] == np.max(size[begin:end])
        if np.any(np.convolve(peak, np.ones(FLAT), "valid") == FLAT):
            notes.append(
                f"{name}: the force stays at its maximum, so its sensor may be at its limit; do not rely on it"
            )
        pieces.append(ForcedRecord(name, record.force[begin:end], record.responses[:, begin:end], double))
    return pieces


def _noise(size: np.ndarray) -> float:
    """Return the standard deviation of normal noise from magnitudes, most of which are noise."""
    return float(np.median(size)) / 0.6745


def touched(forces: np.ndarray) -> np.ndarray | None:
    """Return where the hammer touches in forces (records, n), as a mask; None where the force is not that of a hammer.

    It touches where the force is more than its noise, and as long as a pulse lasts before and after.
    """
    size = np.abs(forces - np.median(forces, axis=1, keepdims=True))
    beyond = size > NOISY * _noise(size)
    pulse = beyond & (size > LEAST_PEAK * np.max(size, axis=1, keepdims=True))
    if not pulse.any(axis=1).all() or np.mean(pulse) > MOST_TOUCHED:
        return None
    width = int(np.median(np.count_nonzero(pulse, axis=1)))
    return np.asarray(binary_dilation(beyond, np.ones((1, 2 * width + 1), bool)))


def force_windowed(blows: Blows) -> Blows:
    """Return blows whose force is zero where the hammer does not touch; those of a shaker as they are.

    What is measured there is noise, which biases H1 and makes it scatter; that within the pulse stays.
    """
    hammer = touched(blows.forces)
    if hammer is None:
        return blows
    level = blows.forces - np.median(blows.forces, axis=1, keepdims=True)
    return replace(blows, forces=np.where(hammer, level, 0.0))
