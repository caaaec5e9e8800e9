"""Hammer blows: detection of the contact, and division of records into blows of equal length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.signal import find_peaks

from bench.contract.modal import Blows, Response
from bench.errors import InputError

NOISY = 5.0
"""Ratio of the force to the standard deviation of its noise at contact; noise exceeds it in 1 of 2 million samples."""
LEAST_PEAK = 0.1
"""Least peak of a hit over the largest one."""
MOST_TOUCHED = 0.2
"""Largest share of a record with contact; a force that acts longer is that of a shaker."""
HOLD_OFF = 0.1
"""Least time between blows over the mean time between hits; a hit that follows sooner belongs to the same blow."""
PRE_TRIGGER = 0.02
"""Time before a blow that belongs to its record, over the mean time between blows; at least three pulse lengths."""
FEWEST_SAMPLES = 64
"""Least samples of a record."""
FEWEST_BLOWS = 2
"""Number of single blows from which on double hits are excluded."""
SHORT = 0.5
"""Ratio of the length of a record to the median below which it is excluded, as all are cut to the shortest length."""
FLAT = 3
"""Number of consecutive samples at the maximum from which on the force is clipped."""


@dataclass(frozen=True, eq=False)
class ForcedRecord:
    """Measured record of one or more blows, or of a shaker.

    Attributes:
        name: Name of the record.
        force: Force, shape (n,).
        responses: Responses, shape (outputs, n).
        double: Whether it is a double hit.
    """

    name: str
    force: np.ndarray
    responses: np.ndarray
    double: bool = False


def blows_of(
    records: Sequence[ForcedRecord], step: float, response: Response, window: float = 0.0
) -> tuple[Blows, tuple[str, ...]]:
    """Divide records into blows of equal length, each up to the next blow; shaker records are not divided.

    Double hits are excluded if there are two single ones, as noise within two pulses does not scale all lines equally.

    Args:
        records: Measured records.
        step: Sampling interval (s).
        response: Kind of the responses.
        window: Decay rate (1/s) of an exponential window on the responses.

    Returns:
        The blows, and notes.

    Raises:
        InputError: The records are too short.
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
        excluded = f"; excluded as less than half as long: {short}" if short else ""
        notes.append(f"{len(kept)} blows of {n * step:.4g} s each{excluded}")
    forces, responses = np.stack([p.force[:n] for p in kept]), np.stack([p.responses[:, :n] for p in kept])
    return Blows(step, forces, responses, response, window), tuple(notes)


def _pieces(record: ForcedRecord, step: float, notes: list[str]) -> list[ForcedRecord]:
    """Divide a record into blows, except for a shaker record; add notes on doubtful ones."""
    n, size = record.force.size, np.abs(record.force - np.median(record.force))
    if touched(record.force[None]) is None:
        notes.append(f"{record.name}: the force acts continuously (shaker), so the record is not divided")
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
                f"{name}: double hit after {later} ms, excluded if there are at least {FEWEST_BLOWS} single blows"
            )
        peak = size[begin:end] == np.max(size[begin:end])
        if np.any(np.convolve(peak, np.ones(FLAT), "valid") == FLAT):
            notes.append(f"{name}: the force repeats its maximum, so its sensor may be clipped at its limit")
        pieces.append(ForcedRecord(name, record.force[begin:end], record.responses[:, begin:end], double))
    return pieces


def _noise(size: np.ndarray) -> float:
    """Return the standard deviation of normal noise from the median of magnitudes."""
    return float(np.median(size)) / 0.6745


def touched(forces: np.ndarray) -> np.ndarray | None:
    """Return a mask of the contact of a hammer in forces (records, n); None if the force is not that of a hammer.

    Contact is where the force exceeds its noise, extended by the length of a pulse on either side.
    """
    size = np.abs(forces - np.median(forces, axis=1, keepdims=True))
    beyond = size > NOISY * _noise(size)
    pulse = beyond & (size > LEAST_PEAK * np.max(size, axis=1, keepdims=True))
    if not pulse.any(axis=1).all() or np.mean(pulse) > MOST_TOUCHED:
        return None
    width = int(np.median(np.count_nonzero(pulse, axis=1)))
    return np.asarray(binary_dilation(beyond, np.ones((1, 2 * width + 1), bool)))


def force_windowed(blows: Blows) -> Blows:
    """Set the force to zero outside of the contact of a hammer; shaker records are returned unchanged.

    The force measured there is noise, which increases bias and variance of H1.
    """
    hammer = touched(blows.forces)
    if hammer is None:
        return blows
    level = blows.forces - np.median(blows.forces, axis=1, keepdims=True)
    return replace(blows, forces=np.where(hammer, level, 0.0))
