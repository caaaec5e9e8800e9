"""Prepare measured signals for a fit: each step is done where it is certain, and is a sentence in the notes.

Only free motion is cut: a known force explains what a start-up, a pause or a second push do. Nothing is cut at the
start where ``from=`` or a known initial state says where the motion begins.
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
"""Of a run that is kept as one, after a cut."""
MOST_CUTS = 12
"""Beyond which a motion is disturbed all the time, and no cut makes it free."""
LIVELY = 0.05
"""Least mean square of a run over that of the liveliest one of its file."""
GROWTH = 1.5
"""Largest mean square in the second half of a run over that in its first: free motion loses energy."""
BLOCK_CYCLES = 1.5
"""Least cycles of a block of samples that is there again, value for value, to be a copy and not a periodic motion."""
LEVEL = 3.0
"""Constant level over the standard deviation from which it is taken off, so that it sets no scale of the search."""
DETREND_CYCLES = 4.0
"""Below which a line and a vibration are not told apart."""
DRIFT_P = 1e-4
"""Level of the test for a drift that nobody asked to remove."""
COHERENT, NOISE_BAND, BLOCKS = 0.7, 3.0, 8
"""Median coherence of two sensors' noise, above so many times the strongest frequency, from which one is computed from
the other; of independent noise it is about 0.1 with so many blocks."""


def prepare(
    recordings: Sequence[Recording], options: ReadOptions, *, known_state: bool = False, n_dof: int = 1
) -> tuple[Recording, ...]:
    """Return the runs in recordings, without what is no free motion, no second measurement or no vibration.

    Args:
        recordings: What was read.
        options: What the user asks for: ``start``, ``decimate``, ``detrend``.
        known_state: Whether the state at time 0 is given; its samples then stay as they are.
        n_dof: Degrees of freedom of the system; the motion of several is not looked through for changes.

    Raises:
        InputError: Decimation or detrending is asked for and not possible.
    """
    prepared: list[Recording] = []
    for recording in _without_copies(recordings):
        recording = _without_computed(recording)
        if options.decimate == 1:  # decimation needs all samples
            recording = _each_motion(recording, _within_limits)
        free, begun = not any(s.measures == "force" and np.any(s.values) for s in recording.signals), options.start
        runs = [recording]
        if free and not known_state:
            recording = _released(recording) if begun is None else recording
            runs = [_stopped(run) for run in (_runs(recording, begun is not None) if n_dof == 1 else [recording])]
        for run in runs:
            if options.detrend or (free and options.detrend is None):
                run = _each_motion(run, partial(_straightened, wanted=bool(options.detrend), source=run.source))
            prepared.append(run if known_state else _each_motion(run, _levelled))
    return tuple(decimated(run, options.decimate) for run in prepared)


def _said(recording: Recording, *sentences: str) -> Recording:
    return replace(recording, notes=(*recording.notes, *sentences))


def _each_motion(recording: Recording, change: Callable[[Signal], tuple[Signal, str]]) -> Recording:
    """Return the recording with each signal of a motion changed, and the sentences that say so."""
    changed = [(signal, "") if signal.measures == "force" else change(signal) for signal in recording.signals]
    said = [sentence for _, sentence in changed if sentence]
    return _said(replace(recording, signals=tuple(signal for signal, _ in changed)), *said)


def _motions(recording: Recording) -> list[Signal]:
    return [signal for signal in recording.signals if signal.measures != "force"]


def _kept(signal: Signal, samples: np.ndarray | slice) -> Signal:
    return replace(signal, times=signal.times[samples], values=signal.values[samples])


def _between(recording: Recording, first: float, last: float) -> Recording:
    """Return the samples from ``first`` to before ``last`` (s), with times from 0 on."""
    signals = [_kept(signal, (signal.times >= first) & (signal.times < last)) for signal in recording.signals]
    signals = [signal for signal in signals if signal.times.size]
    start = min((float(signal.times[0]) for signal in signals), default=0.0)
    return replace(recording, signals=tuple(replace(signal, times=signal.times - start) for signal in signals))


# ------------------------------------------------------------------------------- copies and computed columns


def _without_copies(recordings: Sequence[Recording]) -> list[Recording]:
    """Return recordings without those that repeat another's every value, and without what repeats within one."""
    kept: list[Recording] = []
    for recording in map(_once, recordings):
        same = next((i for i, other in enumerate(kept) if _equal(recording, other)), None)
        if same is None:
            kept.append(recording)
        else:
            twice = f"{recording.source} repeats every value of {kept[same].source} and is left out"
            kept[same] = _said(kept[same], twice)
    return kept


def _equal(first: Recording, second: Recording) -> bool:
    pairs = zip(first.signals, second.signals, strict=False)
    return len(first.signals) == len(second.signals) and all(
        a.role == b.role and np.ptp(a.values) > 0 and np.array_equal(a.values, b.values) for a, b in pairs
    )


def _once(recording: Recording) -> Recording:
    """Return a recording whose samples are the same block again and again, value for value, with the first block."""
    motion = next((signal for signal in _motions(recording) if np.ptp(signal.values) > 0), None)
    if motion is None or any(signal.values.size != motion.values.size for signal in recording.signals):
        return recording
    n = motion.values.size
    blocks = (p for p in range(LEAST_SAMPLES, n // 2 + 1) if n % p == 0)
    block = next((p for p in blocks if all(_repeats(signal.values, p) for signal in recording.signals)), n)
    cycles = block / n * float(np.ptp(motion.times)) * dominant_frequency(motion.times, motion.values)
    if block == n or cycles < BLOCK_CYCLES:  # a sine without noise repeats itself
        return recording
    first = tuple(_kept(signal, slice(block)) for signal in recording.signals)
    said = f"the record is there {n // block} times, value for value: its first {block} samples are kept"
    return _said(replace(recording, signals=first), said)


def _repeats(values: np.ndarray, period: int) -> bool:
    return bool(values[0] == values[period]) and np.array_equal(values[period:], values[:-period])


def _without_computed(recording: Recording) -> Recording:
    """Return the recording without motions that a logger computed from another of the same degree of freedom.

    The noise of both, above the vibration, is the same noise then, and that of the computed one is farther from white.
    """
    sources: dict[str, str] = {}
    for first, second in combinations(_motions(recording), 2):
        if first.dof == second.dof and first.measures != second.measures:
            coherence, colours = _noise(first, second)
            if coherence > COHERENT:
                source, computed = (first, second) if colours[0] <= colours[1] else (second, first)
                sources.setdefault(computed.role, source.role)
    kept = tuple(signal for signal in recording.signals if signal.role not in sources)
    said = [f"{role} is computed from {source}, noise and all: no second measurement, left out"
            for role, source in sources.items()]  # fmt: skip
    return _said(replace(recording, signals=kept), *said)


def _noise(first: Signal, second: Signal) -> tuple[float, tuple[float, float]]:
    """Return the median coherence of two sensors' noise above the vibration, and how far each spectrum is from flat.

    That is the standard deviation of its logarithm. Nothing is coherent where too little is known.
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


# ------------------------------------------------------------------------------- where the free motion goes on


def _silences(recording: Recording, direction: int = 1) -> list[float]:
    """Return when (s) each motion is released, or stops with ``direction`` -1; none if a sensor shows no silence."""
    motions = [(direction * s.times[::direction], s.values[::direction]) for s in _motions(recording)]
    times = [time for motion in motions if (time := silence(*motion)) is not None]
    return [direction * time for time in times] if len(times) == len(motions) else []


def _released(recording: Recording) -> Recording:
    """Return the recording from its release on, where all its sensors show a constant before."""
    times = _silences(recording)
    if not times:
        return recording
    said = f"nothing moves in the first {min(times):.3g} s: the record begins at the release"
    return _said(_between(recording, min(times), np.inf), said)


def _stopped(recording: Recording) -> Recording:
    """Say where all sensors show a constant at the end, as after a stop by friction; the samples stay."""
    times = _silences(recording, -1)
    return (
        _said(recording, f"nothing moves after {max(times):.3g} s: the motion has ended there") if times else recording
    )


def _runs(recording: Recording, begun: bool) -> list[Recording]:
    """Return the undisturbed runs of a free motion; the recording itself where nothing disturbs it, or no run is left.

    ``begun``: whether the user says where the motion begins.
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
    if not runs or (begun and runs[0][0] > 0.0):
        return [recording]
    said = [_left_out(first, end) for first, end, is_run in spans if not is_run]
    if len(runs) == 1:
        return [_said(_between(recording, *runs[0]), *said)]
    listed = " and ".join(f"{first:.4g} to {min(end, last):.4g} s" for first, end in runs)
    said.append(f"the free motion starts again within the record: {len(runs)} runs, {listed}")
    return [
        replace(_said(_between(recording, *run), *said), source=f"{recording.source} run {i}")
        for i, run in enumerate(runs, 1)
    ]


def _left_out(first: float, end: float) -> str:
    if first == 0.0:
        return f"the first {end:.3g} s do not belong to the free motion that follows (a hand, a start-up): left out"
    return f"{first:.4g} to {end:.4g} s do not belong to the free motion before or after (a jump, a hand): left out"


def _is_run(piece: Signal) -> bool:
    """Return whether a stretch is long enough for a run, and its motion does not grow."""
    if piece.values.size < LEAST_SAMPLES or np.ptp(piece.values) == 0:
        return False
    early, late = (np.mean(half**2) for half in np.array_split(piece.values - np.mean(piece.values), 2))
    cycles = float(np.ptp(piece.times)) * dominant_frequency(piece.times, piece.values)
    return bool(late <= GROWTH * early and cycles >= LEAST_CYCLES)


# ------------------------------------------------------------------------------- what a sensor adds to its motion


def _within_limits(signal: Signal) -> tuple[Signal, str]:
    """Leave out samples at the limit of the sensor."""
    cut = at_limit(signal.values)
    if not np.any(cut):
        return signal, ""
    said = f"{signal.role} is clipped: {np.count_nonzero(cut)} samples at the sensor's limit are left out"
    return _kept(signal, ~cut), said


def _straightened(signal: Signal, wanted: bool, source: str) -> tuple[Signal, str]:
    """Take off the drift of the sensor: where the user wants it, or where it is significant."""
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
        f"{signal.role}: the sensor drifts by {slope:.3g} {signal.unit}/s, {share:.2g} % of the motion "
        "over the record: a straight line is taken off"
    )


def _levelled(signal: Signal) -> tuple[Signal, str]:
    """Take off a large constant, such as gravity in an accelerometer."""
    mean = float(np.mean(signal.values))
    if not abs(mean) > LEVEL * float(np.std(signal.values)) > 0:
        return signal, ""
    said = f"{signal.role}: its mean of {mean:.4g} {signal.unit} is taken off before the fit"
    return replace(signal, values=signal.values - mean), said
