"""Prepare measured signals for a fit: each step is done where it is certain, and is a sentence in the notes.

Only free motion is cut: a known force explains what a start-up, a pause or a second push do. Nothing is cut at the
start where ``from=`` or a known initial state says where the motion begins.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from bench.contract.problem import MIN_SAMPLES
from bench.errors import InputError
from bench.records.decimation import decimated
from bench.records.free_motion import SensorDrift, drift, first_change, silence
from bench.records.reading import ReadOptions, Recording, Signal
from bench.records.saturation import at_limit
from bench.records.strongest import strongest_frequency

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
    runs: list[Recording] = []
    for recording in _without_copies(recordings):
        recording = _within_limits(_without_computed(recording), options)
        free = not any(s.measures == "force" and np.any(s.values) for s in recording.signals)
        cut = [recording]
        if free and not known_state:
            begun = recording if options.start is not None else _released(recording)
            cut = _runs(begun, options.start is not None) if n_dof == 1 else [begun]
        runs += [_levelled(_straightened(run, options.detrend, free), known_state) for run in cut]
    return tuple(decimated(run, options.decimate) for run in runs)


def _said(recording: Recording, *sentences: str) -> Recording:
    return replace(recording, notes=(*recording.notes, *sentences))


def _between(recording: Recording, first: float, last: float) -> Recording:
    """Return the samples from ``first`` to before ``last`` (s), with times from 0 on."""
    signals = []
    for signal in recording.signals:
        kept = (signal.times >= first) & (signal.times < last)
        signals.append(replace(signal, times=signal.times[kept], values=signal.values[kept]))
    start = min((float(s.times[0]) for s in signals if s.times.size), default=0.0)
    return replace(recording, signals=tuple(replace(s, times=s.times - start) for s in signals if s.times.size))


def _motions(recording: Recording) -> list[Signal]:
    return [signal for signal in recording.signals if signal.measures != "force"]


def _without_copies(recordings: Sequence[Recording]) -> list[Recording]:
    """Return recordings without those that repeat another's every value, and without what repeats within one."""
    kept: list[Recording] = []
    for recording in recordings:
        recording = _once(recording)
        same = [i for i, other in enumerate(kept) if _equal(recording, other)]
        if same:
            twice = f"{recording.source} repeats every value of {kept[same[0]].source} and is left out"
            kept[same[0]] = _said(kept[same[0]], twice)
        else:
            kept.append(recording)
    return kept


def _equal(one: Recording, other: Recording) -> bool:
    pairs = zip(one.signals, other.signals, strict=False)
    return len(one.signals) == len(other.signals) and all(
        a.role == b.role and np.ptp(a.values) > 0 and np.array_equal(a.values, b.values) for a, b in pairs
    )


def _once(recording: Recording) -> Recording:
    """Return a recording whose samples are the same block again and again, value for value, with the first block."""
    sizes = {signal.values.size for signal in recording.signals}
    motions = [signal for signal in _motions(recording) if np.ptp(signal.values) > 0]
    if len(sizes) != 1 or not motions:
        return recording
    n = sizes.pop()
    block = next(
        (p for p in range(1, n // 2 + 1) if n % p == 0 and all(_repeats(s.values, p) for s in recording.signals)), n
    )
    cycles = block / n * float(np.ptp(motions[0].times)) * strongest_frequency(motions[0].times, motions[0].values)
    if block == n or block < LEAST_SAMPLES or cycles < BLOCK_CYCLES:  # a sine without noise repeats itself
        return recording
    first = tuple(replace(s, times=s.times[:block], values=s.values[:block]) for s in recording.signals)
    said = f"the record is there {n // block} times, value for value: its first {block} samples are kept"
    return _said(replace(recording, signals=first), said)


def _repeats(values: np.ndarray, period: int) -> bool:
    return bool(values[0] == values[period]) and np.array_equal(values[period:], values[:-period])


def _without_computed(recording: Recording) -> Recording:
    """Return the recording without motions that a logger computed from another of the same degree of freedom."""
    left_out: dict[int, Signal] = {}
    motions = _motions(recording)
    for i, one in enumerate(motions):
        for other in motions[i + 1 :]:
            if one.dof == other.dof and one.measures != other.measures and _computed(one, other):
                computed, source = sorted((one, other), key=_colour, reverse=True)
                left_out.setdefault(id(computed), source)
    if not left_out:
        return recording
    kept = tuple(s for s in recording.signals if id(s) not in left_out)
    return _said(
        replace(recording, signals=kept),
        *(
            f"{s.role} is computed from {left_out[id(s)].role}, noise and all: no second measurement, left out"
            for s in recording.signals
            if id(s) in left_out
        ),
    )


def _computed(one: Signal, other: Signal) -> bool:
    """Return whether the noise of two sensors, above the vibration, is the same noise: by its coherence."""
    from scipy.signal import coherence  # slow to import, and few records need it

    n = one.values.size
    if n != other.values.size or not np.array_equal(one.times, other.times) or n < 16 * BLOCKS:
        return False
    rate = (n - 1) / float(np.ptp(one.times))
    frequencies, coherent = coherence(one.values, other.values, rate, nperseg=2 * n // (BLOCKS + 1))
    noise = frequencies > NOISE_BAND * strongest_frequency(one.times, one.values)
    return int(np.count_nonzero(noise)) >= 8 and float(np.nanmedian(coherent[noise])) > COHERENT


def _colour(signal: Signal) -> float:
    """Return how far the spectrum of a sensor's noise is from flat: the standard deviation of its logarithm."""
    from scipy.signal import welch

    frequencies, power = welch(signal.values, nperseg=2 * signal.values.size // (BLOCKS + 1))
    cycles = strongest_frequency(signal.times, signal.values) * float(np.ptp(signal.times)) / signal.values.size
    noise = (frequencies > NOISE_BAND * cycles) & (power > 0)
    return float(np.std(np.log(power[noise]))) if np.any(noise) else np.inf


def _within_limits(recording: Recording, options: ReadOptions) -> Recording:
    """Return the recording without samples of a motion at the limit of its sensor; decimation needs them all."""
    signals, said = [], []
    for signal in recording.signals:
        cut = at_limit(signal.values) if signal.measures != "force" and options.decimate == 1 else np.zeros(0, bool)
        if np.any(cut):
            said.append(f"{signal.role} is clipped: {np.count_nonzero(cut)} samples at the sensor's limit are left out")
            signal = replace(signal, times=signal.times[~cut], values=signal.values[~cut])
        signals.append(signal)
    return _said(replace(recording, signals=tuple(signals)), *said)


def _released(recording: Recording) -> Recording:
    """Return the recording from its release on, where its sensors show a constant before."""
    released = [silence(signal.times, signal.values) for signal in _motions(recording)]
    times = [time for time in released if time is not None]
    if not times or len(times) < len(released):
        return recording
    said = f"nothing moves in the first {min(times):.3g} s: the record begins at the release"
    return _said(_between(recording, min(times), np.inf), said)


def _runs(recording: Recording, begun: bool) -> list[Recording]:
    """Return the undisturbed runs of a free motion; the recording itself where nothing disturbs it, or no run is left.

    ``begun``: whether the user says where the motion begins.
    """
    signal = next(iter(_motions(recording)), None)
    if signal is None or signal.values.size < LEAST_SAMPLES:
        return [recording]
    last = float(signal.times[-1])
    ends = _ends(signal)
    if len(ends) == 2:
        return [recording]
    pieces = list(pairwise(ends))
    runs = [piece for piece in pieces if _is_run(signal, *piece)]
    sizes = [_power(signal, *run) for run in runs]
    runs = [run for run, size in zip(runs, sizes, strict=True) if size >= LIVELY * max(sizes)]
    if not runs or (begun and runs[0][0] > 0.0):
        return [recording]
    said = [_left_out(first, min(end, last)) for first, end in pieces if (first, end) not in runs]
    if len(runs) == 1:
        return [_said(_between(recording, *runs[0]), *said)]
    spans = " and ".join(f"{first:.4g} to {min(end, last):.4g} s" for first, end in runs)
    said.append(f"the free motion starts again within the record: {len(runs)} runs, {spans}")
    return [
        replace(_said(_between(recording, *run), *said), source=f"{recording.source} run {i}")
        for i, run in enumerate(runs, 1)
    ]


def _left_out(first: float, end: float) -> str:
    if first == 0.0:
        return f"the first {end:.3g} s do not belong to the free motion that follows (a hand, a start-up): left out"
    return f"{first:.4g} to {end:.4g} s do not belong to the free motion before or after (a jump, a hand): left out"


def _ends(signal: Signal) -> list[float]:
    """Return times (s) between which a motion goes on undisturbed, first and last included."""
    done, waiting = [0.0, np.inf], [(0.0, np.inf)]
    while waiting:
        first, last = waiting.pop()
        inside = (signal.times >= first) & (signal.times < last)
        cut = first_change(signal.times[inside], signal.values[inside]) if np.sum(inside) > LEAST_SAMPLES else None
        if cut is not None:
            done.append(cut.time)
            waiting += [(first, cut.time), (cut.time, last)]
        if len(done) > MOST_CUTS:
            return [0.0, np.inf]
    return sorted(done)


def _is_run(signal: Signal, first: float, last: float) -> bool:
    """Return whether a stretch is long enough for a run, and its motion does not grow."""
    inside = (signal.times >= first) & (signal.times < last)
    times, values = signal.times[inside], signal.values[inside]
    if values.size < LEAST_SAMPLES or np.ptp(values) == 0:
        return False
    halves = np.array_split(values - np.mean(values), 2)
    grows = np.mean(halves[1] ** 2) > GROWTH * np.mean(halves[0] ** 2)
    return not grows and float(np.ptp(times)) * strongest_frequency(times, values) >= LEAST_CYCLES


def _power(signal: Signal, first: float, last: float) -> float:
    return float(np.var(signal.values[(signal.times >= first) & (signal.times < last)]))


def _straightened(recording: Recording, wanted: bool | None, free: bool) -> Recording:
    """Return the recording without the drift of its motions: where the user wants it, or where it is significant."""
    if wanted is False or not (wanted or free):
        return recording
    signals, said = [], []
    for signal in recording.signals:
        line = None if signal.measures == "force" else _drift(signal, bool(wanted), recording.source)
        if line is not None and (wanted or line.p_value < DRIFT_P):
            middle = 0.5 * (signal.times[0] + signal.times[-1])
            taken = line.slope * (signal.times - middle)
            share = 100.0 * float(np.ptp(taken)) / (float(np.ptp(signal.values - taken)) or 1.0)
            said.append(
                f"{signal.role}: the sensor drifts by {line.slope:.3g} {signal.unit}/s, {share:.2g} % of the motion "
                "over the record: a straight line is taken off"
            )
            signal = replace(signal, values=signal.values - taken)
        signals.append(signal)
    return _said(replace(recording, signals=tuple(signals)), *said)


def _drift(signal: Signal, wanted: bool, source: str) -> SensorDrift | None:
    level = signal.values - np.polynomial.Polynomial.fit(signal.times, signal.values, 1)(signal.times)
    cycles = float(np.ptp(signal.times)) * strongest_frequency(signal.times, level)
    if wanted and cycles < DETREND_CYCLES:
        remedy = f"{source} has {cycles:.2g} cycles of {signal.role}; at least {DETREND_CYCLES:g} are needed"
        raise InputError("detrend", "true", remedy)
    return drift(signal.times, signal.values) if signal.values.size > MIN_SAMPLES else None


def _levelled(recording: Recording, known_state: bool) -> Recording:
    """Return the recording with a large constant taken off each motion, such as gravity off an accelerometer."""
    if known_state:
        return recording
    signals, said = [], []
    for signal in recording.signals:
        mean = float(np.mean(signal.values))
        if signal.measures != "force" and abs(mean) > LEVEL * float(np.std(signal.values)) > 0:
            said.append(f"{signal.role}: its mean of {mean:.4g} {signal.unit} is taken off before the fit")
            signal = replace(signal, values=signal.values - mean)
        signals.append(signal)
    return _said(replace(recording, signals=tuple(signals)), *said)
