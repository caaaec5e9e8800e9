"""Preparation of measured signals for a fit; each step is recorded in the notes.

Only free motions are cut, as a known force explains a start-up, a pause or a second push. The beginning is not cut if
``from=`` or a known initial state defines it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations, pairwise

import numpy as np

from bench.contract.problem import MIN_SAMPLES
from bench.errors import InputError
from bench.records.decimation import decimated
from bench.records.dominant_frequency import dominant_frequency
from bench.records.free_motion import changes, drift, silence
from bench.records.reading import ReadOptions, Recording, Signal
from bench.records.saturation import at_limit

LEAST_CYCLES, LEAST_SAMPLES = 3.0, 20
"""Least length of a run that is kept after a cut."""
MOST_CUTS = 12
"""Number of cuts above which a motion is disturbed throughout, and is not cut."""
LIVELY = 0.05
"""Least mean square of a run over the largest one of the file."""
GROWTH = 1.5
"""Largest mean square in the second half of a run over that in the first; free motions lose energy."""
BLOCK_CYCLES = 1.5
"""Least cycles of a repeated block of samples; a shorter one may be a periodic motion without noise."""
LEVEL = 3.0
"""Ratio of the mean to the standard deviation above which the mean is removed, as it would set the natural unit."""
DETREND_CYCLES = 4.0
"""Cycles below which a drift and a vibration are not distinguishable."""
DRIFT_P = 1e-4
"""p-value below which a drift is removed by default."""
COHERENT, NOISE_BAND, BLOCKS = 0.7, 3.0, 8
"""Two signals are not independent if the median coherence of their noise exceeds ``COHERENT`` at frequencies above
``NOISE_BAND`` times the dominant one; for independent noise it is about 0.1 with this number of blocks."""


def prepare(
    recordings: Sequence[Recording], options: ReadOptions, *, known_state: bool = False, n_dof: int = 1
) -> tuple[Recording, ...]:
    """Return the runs in recordings, without duplicates, computed channels, clipped samples, disturbances and drift.

    Args:
        recordings: Recordings as they were read.
        options: Options of the user: ``start``, ``decimate``, ``detrend``.
        known_state: Whether the state at time 0 is known; the first samples and the mean are then kept.
        n_dof: Degrees of freedom of the system; disturbances are detected for one only.

    Raises:
        InputError: Decimation or detrending was requested and is not possible.
    """
    prepared: list[Recording] = []
    for recording in _without_copies(recordings):
        recording = _without_computed(recording)
        if options.decimate == 1:  # decimation needs all samples
            recording = _each_motion(recording, _unclipped)
        free = not any(s.measures == "force" and np.any(s.values) for s in recording.signals)
        runs = [recording]
        if free and not known_state:
            begins = options.start is not None
            recording = recording if begins else _released(recording)
            runs = [_note_rest(run) for run in (_runs(recording, begins) if n_dof == 1 else [recording])]
        for run in runs:
            if options.detrend or (free and options.detrend is None):
                run = _each_motion(run, partial(_straightened, wanted=bool(options.detrend), source=run.source))
            prepared.append(run if known_state else _each_motion(run, _levelled))
    return tuple(decimated(run, options.decimate) for run in prepared)


def _with_notes(recording: Recording, *sentences: str) -> Recording:
    return replace(recording, notes=(*recording.notes, *sentences))


def _each_motion(recording: Recording, change: Callable[[Signal], tuple[Signal, str]]) -> Recording:
    """Apply a change, which returns a signal and a note, to all signals but the forces."""
    changed = [(signal, "") if signal.measures == "force" else change(signal) for signal in recording.signals]
    notes = [note for _, note in changed if note]
    return _with_notes(replace(recording, signals=tuple(signal for signal, _ in changed)), *notes)


def _motions(recording: Recording) -> list[Signal]:
    return [signal for signal in recording.signals if signal.measures != "force"]


def _kept(signal: Signal, samples: np.ndarray | slice) -> Signal:
    return replace(signal, times=signal.times[samples], values=signal.values[samples])


def _between(recording: Recording, first: float, last: float) -> Recording:
    """Return the samples in [``first``, ``last``) (s), with times that begin at 0."""
    signals = [_kept(signal, (signal.times >= first) & (signal.times < last)) for signal in recording.signals]
    signals = [signal for signal in signals if signal.times.size]
    start = min((float(signal.times[0]) for signal in signals), default=0.0)
    return replace(recording, signals=tuple(replace(signal, times=signal.times - start) for signal in signals))


# ------------------------------------------------------------------------------- copies and computed columns


def _without_copies(recordings: Sequence[Recording]) -> list[Recording]:
    """Return recordings without exact duplicates of others, and without repeated blocks."""
    kept: list[Recording] = []
    for recording in map(_once, recordings):
        same = next((i for i, other in enumerate(kept) if _equal(recording, other)), None)
        if same is None:
            kept.append(recording)
        else:
            duplicate = f"{recording.source} is an exact duplicate of {kept[same].source} and is excluded"
            kept[same] = _with_notes(kept[same], duplicate)
    return kept


def _equal(first: Recording, second: Recording) -> bool:
    pairs = zip(first.signals, second.signals, strict=False)
    return len(first.signals) == len(second.signals) and all(
        a.role == b.role and np.ptp(a.values) > 0 and np.array_equal(a.values, b.values) for a, b in pairs
    )


def _once(recording: Recording) -> Recording:
    """Return the first block of a recording that consists of exact repetitions of a block."""
    motion = next((signal for signal in _motions(recording) if np.ptp(signal.values) > 0), None)
    if motion is None or any(signal.values.size != motion.values.size for signal in recording.signals):
        return recording
    n = motion.values.size
    blocks = (p for p in range(LEAST_SAMPLES, n // 2 + 1) if n % p == 0)
    block = next((p for p in blocks if all(_repeats(signal.values, p) for signal in recording.signals)), n)
    cycles = block / n * float(np.ptp(motion.times)) * dominant_frequency(motion.times, motion.values)
    if block == n or cycles < BLOCK_CYCLES:  # a sine without noise is periodic, too
        return recording
    first = tuple(_kept(signal, slice(block)) for signal in recording.signals)
    note = f"the file repeats the same {block} samples {n // block} times: the first {block} are kept"
    return _with_notes(replace(recording, signals=first), note)


def _repeats(values: np.ndarray, period: int) -> bool:
    return bool(values[0] == values[period]) and np.array_equal(values[period:], values[:-period])


def _without_computed(recording: Recording) -> Recording:
    """Return the recording without motions that were computed from another one of the same degree of freedom.

    At frequencies above the vibration, the noise of both is then coherent, and that of the computed one is less white.
    """
    sources: dict[str, str] = {}
    for first, second in combinations(_motions(recording), 2):
        if first.dof == second.dof and first.measures != second.measures:
            coherence, colours = _noise(first, second)
            if coherence > COHERENT:
                source, computed = (first, second) if colours[0] <= colours[1] else (second, first)
                sources.setdefault(computed.role, source.role)
    kept = tuple(signal for signal in recording.signals if signal.role not in sources)
    notes = [f"{role} was computed from {source} (coherent noise) and is excluded" for role, source in sources.items()]
    return _with_notes(replace(recording, signals=kept), *notes)


def _noise(first: Signal, second: Signal) -> tuple[float, tuple[float, float]]:
    """Return the median coherence of the noise of two signals above the vibration, and the colour of either noise.

    The colour is the standard deviation of the log spectrum. The coherence of short records is taken as 0.
    """
    from scipy.signal import coherence, welch  # slow to import, and few records need it

    n, unknown = first.values.size, (0.0, (0.0, 0.0))
    if n != second.values.size or not np.array_equal(first.times, second.times) or n < 16 * BLOCKS:
        return unknown
    rate, block = (n - 1) / float(np.ptp(first.times)), 2 * n // (BLOCKS + 1)
    frequencies, coherent = coherence(first.values, second.values, rate, nperseg=block)
    above = frequencies > NOISE_BAND * dominant_frequency(first.times, first.values)
    if np.count_nonzero(above) < 8:
        return unknown
    powers = [welch(signal.values, rate, nperseg=block)[1][above] for signal in (first, second)]
    colours = [float(np.std(np.log(power[power > 0]))) if np.any(power > 0) else np.inf for power in powers]
    return float(np.nanmedian(coherent[above])), (colours[0], colours[1])


# ------------------------------------------------------------------------------- rests and disturbances


def _releases(recording: Recording, direction: int = 1) -> list[float]:
    """Return the time (s) of release of each motion, or of its stop if ``direction`` is -1; empty if one has none."""
    motions = [(direction * s.times[::direction], s.values[::direction]) for s in _motions(recording)]
    times = [time for motion in motions if (time := silence(*motion)) is not None]
    return [direction * time for time in times] if len(times) == len(motions) else []


def _released(recording: Recording) -> Recording:
    """Return the recording from its release on, if all its sensors are at rest before."""
    times = _releases(recording)
    if not times:
        return recording
    note = f"at rest for the first {min(times):.3g} s: the record begins at the release"
    return _with_notes(_between(recording, min(times), np.inf), note)


def _note_rest(recording: Recording) -> Recording:
    """Add a note if all sensors are at rest at the end, such as after sticking; the samples are kept."""
    times = _releases(recording, -1)
    return _with_notes(recording, f"at rest after {max(times):.3g} s") if times else recording


def _runs(recording: Recording, begins: bool) -> list[Recording]:
    """Return the undisturbed runs of a free motion, or the recording if it is undisturbed or no run is long enough.

    ``begins``: whether the user has specified the beginning of the motion.
    """
    signal = next(iter(_motions(recording)), None)
    cuts = [] if signal is None or signal.values.size < LEAST_SAMPLES else changes(signal.times, signal.values)
    if signal is None or not 0 < len(cuts) <= MOST_CUTS:
        return [recording]
    last = float(signal.times[-1])
    pieces = [_kept(signal, (signal.times >= a) & (signal.times < b)) for a, b in pairwise([0.0, *cuts, np.inf])]
    liveliest = max((np.var(piece.values) for piece in pieces if _is_run(piece)), default=0.0)
    lively = [_is_run(piece) and np.var(piece.values) >= LIVELY * liveliest for piece in pieces]
    spans: list[tuple[float, float, bool]] = []
    for first, end, is_run in zip([0.0, *cuts], [*cuts, last], lively, strict=True):
        if spans and not (is_run or spans[-1][2]):
            first = spans.pop()[0]
        spans.append((first, end, is_run))
    runs = [(first, np.inf if end == last else end) for first, end, is_run in spans if is_run]
    if not runs or (begins and runs[0][0] > 0.0):
        return [recording]
    notes = [_exclusion(first, end) for first, end, is_run in spans if not is_run]
    if len(runs) == 1:
        return [_with_notes(_between(recording, *runs[0]), *notes)]
    listed = " and ".join(f"{first:.4g} to {min(end, last):.4g} s" for first, end in runs)
    notes.append(f"the record has {len(runs)} free motions: {listed}")
    return [
        replace(_with_notes(_between(recording, *run), *notes), source=f"{recording.source} run {i}")
        for i, run in enumerate(runs, 1)
    ]


def _exclusion(first: float, end: float) -> str:
    if first == 0.0:
        return f"the first {end:.3g} s are not a free motion (contact by a hand, start-up) and are excluded"
    return f"{first:.4g} to {end:.4g} s are not a free motion (jump, contact by a hand) and are excluded"


def _is_run(piece: Signal) -> bool:
    """Return whether a segment is long enough for a run and its motion does not grow."""
    if piece.values.size < LEAST_SAMPLES or np.ptp(piece.values) == 0:
        return False
    early, late = (np.mean(half**2) for half in np.array_split(piece.values - np.mean(piece.values), 2))
    cycles = float(np.ptp(piece.times)) * dominant_frequency(piece.times, piece.values)
    return bool(late <= GROWTH * early and cycles >= LEAST_CYCLES)


# ------------------------------------------------------------------------------- errors of the sensor


def _unclipped(signal: Signal) -> tuple[Signal, str]:
    """Exclude samples at the limit of the sensor."""
    cut = at_limit(signal.values)
    if not np.any(cut):
        return signal, ""
    note = f"{signal.role} is clipped: {np.count_nonzero(cut)} samples at the limit of the sensor are excluded"
    return _kept(signal, ~cut), note


def _straightened(signal: Signal, wanted: bool, source: str) -> tuple[Signal, str]:
    """Subtract the linear drift of the sensor if it is ``wanted`` or significant."""
    level = signal.values - np.polynomial.Polynomial.fit(signal.times, signal.values, 1)(signal.times)
    cycles = float(np.ptp(signal.times)) * dominant_frequency(signal.times, level)
    if wanted and cycles < DETREND_CYCLES:
        remedy = f"{source} has {cycles:.2g} cycles of {signal.role}; at least {DETREND_CYCLES:g} are needed"
        raise InputError("detrend", "true", remedy)
    line = drift(signal.times, signal.values) if signal.values.size > MIN_SAMPLES else None
    if line is None or not (wanted or line[1] < DRIFT_P):
        return signal, ""
    slope, _ = line
    drifted = slope * (signal.times - 0.5 * (signal.times[0] + signal.times[-1]))
    share = 100.0 * float(np.ptp(drifted)) / (float(np.ptp(signal.values - drifted)) or 1.0)
    return replace(signal, values=signal.values - drifted), (
        f"{signal.role}: linear drift of {slope:.3g} {signal.unit}/s removed ({share:.2g} % of the motion "
        "over the record)"
    )


def _levelled(signal: Signal) -> tuple[Signal, str]:
    """Subtract a large mean, such as gravity in an accelerometer."""
    mean = float(np.mean(signal.values))
    if not abs(mean) > LEVEL * float(np.std(signal.values)) > 0:
        return signal, ""
    note = f"{signal.role}: mean of {mean:.4g} {signal.unit} removed before the fit"
    return replace(signal, values=signal.values - mean), note
