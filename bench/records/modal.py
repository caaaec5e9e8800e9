"""Modes of measured records: what a modal method finds, what it leaves of the record, and how far to trust it.

Record and fit are compared line by line of their spectra, inside the band, so free decays and frequency responses are
judged alike. Intervals are of this record: what its noise leaves open.
"""

from __future__ import annotations

import importlib.util
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from bench.contract.estimate import Status
from bench.contract.modal import (
    DERIVATIVES,
    MOST_MODES,
    Blows,
    FreeDecays,
    ModalEstimate,
    ModalIdentifier,
    ModalProblem,
    Mode,
)
from bench.entrants.modal import make_modal, registered_modal
from bench.isolation.failure import LONGEST, printable
from bench.isolation.processes import Died
from bench.likelihood.autoregression import even_times
from bench.modal.averages import averages, decay_needed
from bench.modal.spectra import modal_parameters
from bench.records.colour import autocorrelation
from bench.records.diagnostics import GROWTH, LINE_LEVEL, MOST_LEFT, SECOND_MODE, WIDE, growth_of, start_up
from bench.records.dominant_frequency import dominant_frequency
from bench.records.modal_data import ModalRecord
from bench.records.modes import MOST_OFFERED, OfferedMode
from bench.records.request import ModalRequest
from bench.records.response import A_CYCLE, FEWEST, MOST, ChannelResiduals, ChannelResponse, Response
from bench.records.saturation import at_limit
from bench.records.verdict import Reason, Trust, verdict
from bench.records.workers import Workers
from bench.scoring.statistics import whiteness

FREE_METHOD, FORCED_METHOD = "waves", "spectra"
"""Methods where none is named."""
NOISE_CHANCE = 1e-3
"""Chance at which a mode may be noise, beyond which that is said."""
NEAR, BESIDE, FEWEST_LINES = 2.0, 8.0, 3
"""Half-power bandwidths from a mode up to which the residuals are its own, and up to which they are the noise beside
it; and the least lines to either side."""
UNEXPLAINED = 2.0
"""Root mean square of the residuals near a mode over the noise beside it, beyond which the noise does not explain them:
intervals that assume that noise are then as much too narrow."""
LATER, FEWEST_LEFT = (0, 1, 2, 4, 8), 8
"""Cycles after the largest value from which a motion is described that is not from its start; least cycles left."""
FEW_CYCLES = 2.0
ALIKE = 0.9
"""Modal assurance criterion beyond which two shapes count as the same, as is usual; of one sensor it is 1."""
REAL = 10.0
"""Degrees from 0 or 180 within which a part of a shape counts as in phase or opposed."""


@dataclass(frozen=True)
class Component:
    """What a sensor has of a mode over the largest: signed where in phase or opposed, else beside its phase (degrees).

    ``half``: half of the 95 % interval.
    """

    sensor: str
    ratio: float
    half: float
    phase: float


@dataclass(frozen=True)
class ModalParameter:
    """Modal mass, damping or stiffness where the only sensor is at the force; ``half`` of the 95 % interval."""

    name: str
    value: float
    half: float
    unit: str


@dataclass(frozen=True)
class ShapedMode(OfferedMode):
    """A mode with its amplitude at the first sample, of the sensor where it is largest, and its shape if several.

    Of a force and one sensor it has ``parameters`` in place of an amplitude.
    """

    amplitude: float = math.nan
    amplitude_low: float = math.nan
    amplitude_high: float = math.nan
    amplitude_unit: str = ""
    shape: tuple[Component, ...] = ()
    parameters: tuple[ModalParameter, ...] = ()


@dataclass(frozen=True, eq=False)
class Comparison:
    """Spectra of record and fit, shape (channels, lines), at ``frequencies`` (lines,) in Hz inside the band."""

    frequencies: np.ndarray
    measured: np.ndarray
    fitted: np.ndarray

    @cached_property
    def power(self) -> np.ndarray:
        """Power (lines,) of the residuals over that of the record in the band, averaged over channels; its sum is 1."""
        size = np.sum(np.abs(self.measured) ** 2, axis=1, keepdims=True)
        return np.asarray(np.mean(np.abs(self.measured - self.fitted) ** 2 / np.where(size > 0, size, 1.0), axis=0))

    @property
    def left(self) -> float:
        """Root mean square of the residuals over that of the record."""
        return float(np.sqrt(np.sum(self.power)))

    def line(self, modes: Sequence[Mode]) -> tuple[float, float]:
        """Return frequency and root mean square, over the record's, of a significant line away from modes; 0 if none.

        By the test of R. A. Fisher, Proc. R. Soc. A 125:54, 1929.
        """
        power = np.where(np.min([self.distance(mode) for mode in modes], axis=0) > NEAR, self.power, 0.0)
        largest, lines = float(np.max(power)), power.size
        chance = lines * (1.0 - largest / (float(np.sum(self.power)) or 1.0)) ** (lines - 1)
        return float(self.frequencies[np.argmax(power)]), math.sqrt(largest) if chance < LINE_LEVEL else 0.0

    def distance(self, mode: Mode) -> np.ndarray:
        """Return the distance of each line from a mode over its bandwidth, or over a line's where this is wider."""
        width = max(mode.bandwidth, FEWEST_LINES / NEAR * float(self.frequencies[1] - self.frequencies[0]))
        return np.asarray(np.abs(self.frequencies - mode.frequency) / width)

    def near(self, mode: Mode) -> tuple[float, float]:
        """Return the residuals near a mode, as root mean squares: over the noise beside it, and over the record there.

        The power of a line of noise is exponentially distributed, so its mean is the median over log 2.
        """
        distance = self.distance(mode)
        near, beside = distance <= NEAR, (distance > NEAR) & (distance <= BESIDE)
        if np.count_nonzero(beside) < 2 * FEWEST_LINES or not np.any(near):
            return 1.0, 0.0
        noise = float(np.median(self.power[beside])) / math.log(2.0)
        left, record = (np.linalg.norm(part[:, near]) for part in (self.measured - self.fitted, self.measured))
        return float(np.sqrt(np.mean(self.power[near]) / (noise or 1.0))), float(left / (record or 1.0))


@dataclass(frozen=True, eq=False)
class ModalFinding:
    """The answer of a modal method to a record; ``comparison`` is None without modes."""

    method: str
    record: ModalRecord
    estimate: ModalEstimate
    wall_s: float
    comparison: Comparison | None = None
    reasons: tuple[Reason, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def trust(self) -> Trust:
        """The verdict."""
        return verdict(self.reasons)

    @cached_property
    def unexplained(self) -> tuple[float, ...]:
        """Residuals near each mode over the noise beside it, where that is beyond :data:`UNEXPLAINED`; else 1."""
        over = [self.comparison.near(mode)[0] for mode in self.estimate.modes] if self.comparison else []
        return tuple(value if value > UNEXPLAINED else 1.0 for value in over)

    @property
    def describes(self) -> bool:
        """Return whether fewer modes than the largest number leave residuals that noise explains."""
        comparison, modes = self.comparison, self.estimate.modes
        if comparison is None or len(modes) == MOST_MODES or max(self.unexplained) > 1.0:
            return False
        if isinstance(data := self.record.data, FreeDecays) and start_up(*_left(data, modes)):
            return False
        return comparison.left <= 1.0 and comparison.line(modes)[1] <= SECOND_MODE

    @property
    def alike(self) -> list[tuple[Mode, Mode]]:
        """Modes that are close and of one shape, so that they may be one."""
        return _alike(self.estimate.modes)

    @property
    def rank(self) -> tuple[int, float]:
        """Order of answers to one record, the best first."""
        return list(Trust).index(self.trust), max(self.unexplained, default=math.inf)

    @cached_property
    def modes(self) -> tuple[ShapedMode, ...]:
        """The modes with 95 % intervals, wider by what is unexplained; without them where the answer is not trusted."""
        from scipy.stats import t as student

        quantile = math.nan if self.trust is Trust.NO else float(student.ppf(0.975, self.estimate.degrees))
        pairs = zip(self.estimate.modes, self.unexplained, strict=True) if self.comparison else ()
        return tuple(_shaped(mode, quantile * over, self.record) for mode, over in pairs)


def find_modes(request: ModalRequest, record: ModalRecord, others: bool = False) -> list[ModalFinding]:
    """Return what each method of a request makes of a record; ``others``: where none is named, all that can serve.

    Each answers in a process of its own, within the limits of time and memory; one that does not is said to have none.
    """
    default = FREE_METHOD if isinstance(record.data, FreeDecays) else FORCED_METHOD
    problem = ModalProblem(record.data, request.count, request.band)
    methods = dict(request.methods) or {default: make_modal(default)}
    begins = isinstance(record.data, FreeDecays) and request.count is None and request.options.start is None
    if others and not request.methods:
        able = ((name, make_modal(name)) for name in registered_modal())
        methods |= {name: method for name, method in able if not (_lacking(method) or method.objection(problem))}
    answer, config = _free if begins else _find, request.config
    findings = []
    with Workers(preload=(__name__,)) as workers:
        tasks = {
            name: workers.submit(config.timeout_s, answer, name, method, problem, record, memory_mb=config.memory_mb)
            for name, method in methods.items()
        }
        for name, task in tasks.items():
            try:
                findings.append(task.result())
            except Died as died:
                last = died.log.strip().splitlines()[-1:] if died.reason == Status.CRASHED else []
                message = ": ".join([died.message, *(printable(line, LONGEST) for line in last)])
                failed = ModalEstimate((), status=Status(died.reason), message=message)
                findings.append(_without_modes(ModalFinding(name, record, failed, math.nan, notes=record.notes)))
    return findings


def _without_modes(finding: ModalFinding) -> ModalFinding:
    estimate = finding.estimate
    why = f"no answer ({estimate.status.value}): {estimate.message or 'no mode stands out of the noise'}"
    return replace(finding, reasons=(Reason(Trust.NO, why),))


def _find(name: str, method: ModalIdentifier, problem: ModalProblem, record: ModalRecord) -> ModalFinding:
    started = time.perf_counter()
    if lacking := _lacking(method):
        estimate = ModalEstimate((), status=Status.MISSING_DEPENDENCY, message=f"pip install {lacking}")
    elif objection := method.objection(problem):
        estimate = ModalEstimate((), status=Status.UNSUPPORTED, message=objection)
    else:
        estimate = method.identify_modes(problem)
    finding = ModalFinding(name, record, estimate, time.perf_counter() - started, notes=record.notes)
    modes, notes = estimate.modes, [estimate.message] if estimate.message else []
    if estimate.status is not Status.OK or not modes:
        return _without_modes(finding)
    if close := _close(modes):
        pairs = "; ".join(_named(*pair) for pair in close)
        notes.append(f"modes that are close, nearer than their half-power bandwidths: {pairs}")
    comparison = compare(record, modes, problem.band)
    reasons = tuple(_reasons(record, modes, comparison, problem))
    return replace(finding, comparison=comparison, reasons=reasons, notes=(*record.notes, *notes))


def _free(name: str, method: ModalIdentifier, problem: ModalProblem, record: ModalRecord) -> ModalFinding:
    """Answer a free motion; where the modes leave more than noise, from a later start, with as few as leave no line.

    The earliest start is taken from which they describe the motion, or that from which they leave least: before it are
    a hand, a start-up or large amplitudes. There the method's own number of modes stands if it describes the motion.
    """
    started, data = time.perf_counter(), problem.data
    whole = _find(name, method, problem, record)
    if whole.describes or whole.estimate.status in (Status.MISSING_DEPENDENCY, Status.UNSUPPORTED):
        return whole
    assert isinstance(data, FreeDecays)
    if growth_of(data.values) > GROWTH:  # no start makes it free
        return whole
    best, span = whole, float(np.ptp(data.times))
    for start in _starts(data):
        kept = data.times >= start
        part = replace(record, data=FreeDecays(data.times[kept], data.values[:, kept]))
        fewest = _fewest(name, method, replace(problem, data=part.data), part)
        if fewest.rank < best.rank:
            best, left = fewest, float(data.times[-1]) - start
        if fewest.describes:
            break
    if best is whole:
        return whole
    again = _find(name, method, replace(problem, data=best.record.data), best.record)
    if again.describes and again.rank <= best.rank and not again.alike:
        best = again
    said = f"the modes describe only the last {left:.3g} of {span:.3g} s"
    why = "a hand, a start-up or large amplitudes, at which they may be others, are left out; from= sets another start"
    number = f"their number is the least that leaves no line above {SECOND_MODE:.0%} of the signal"
    notes = best.notes if best is again else (*(n for n in best.notes if n != best.estimate.message), number)
    reasons = (Reason(Trust.CAUTION, f"{said}: {why}"), *best.reasons)
    return replace(best, reasons=reasons, notes=notes, wall_s=time.perf_counter() - started)


def _starts(data: FreeDecays) -> Iterator[float]:
    """Yield the time of the largest value, and times by so many cycles later, while enough cycles are left."""
    size = np.std(data.values, axis=1, keepdims=True)
    motion = np.abs(data.values - np.mean(data.values, axis=1, keepdims=True)) / np.where(size > 0, size, 1.0)
    channel, largest = np.unravel_index(np.argmax(motion), motion.shape)
    cycle = 1.0 / dominant_frequency(data.times[largest:], data.values[channel, largest:])
    for start in (data.times[largest] + cycles * cycle for cycles in LATER):
        if data.times[-1] - start >= FEWEST_LEFT * cycle:
            yield float(start)


def _fewest(name: str, method: ModalIdentifier, problem: ModalProblem, record: ModalRecord) -> ModalFinding:
    """Return the answer with as few modes as leave no line, of which no two are close and of one shape."""
    best = _find(name, method, replace(problem, count=1), record)
    while best.comparison is not None and best.comparison.line(best.estimate.modes)[1] > SECOND_MODE:
        count = len(best.estimate.modes) + 1
        longer = _find(name, method, replace(problem, count=count), record)
        if longer.alike or not count == len(longer.estimate.modes) <= MOST_OFFERED:
            break
        best = longer
    return best


def _lacking(method: ModalIdentifier) -> str:
    return next((package for package in method.requires if importlib.util.find_spec(package) is None), "")


def _named(*modes: Mode) -> str:
    return f"{', '.join(f'{mode.frequency:.4g}' for mode in modes)} Hz"


# ------------------------------------------------------------------------------- what is left of the record


def motion(data: FreeDecays, modes: Sequence[Mode], times: np.ndarray) -> np.ndarray:
    """Compute the free motion (channels, n) of modes at times, whose amplitudes are those at the data's first."""
    waves = np.exp(np.multiply.outer([mode.pole for mode in modes], times - data.times[0]))
    return np.asarray(np.real(np.stack([mode.shape for mode in modes], axis=1) @ waves))


def _left(data: FreeDecays, modes: Sequence[Mode]) -> tuple[np.ndarray, np.ndarray]:
    """Return what modes leave of each channel, and its samples, both (channels, n)."""
    return data.values - motion(data, modes, data.times), data.values


def compare(record: ModalRecord, modes: Sequence[Mode], band: tuple[float, float] | None) -> Comparison:
    """Return the spectra of a record, about its mean, and of the modes; of forced motion its frequency responses.

    To these the poles are fitted with any residues, as noise of a blow's force scales them, and with what modes below
    and above the band leave in it, ``a / s² + b`` (D. J. Ewins, Modal Testing, 2nd ed., section 4.4).
    """
    data, (low, high) = record.data, band or (0.0, math.inf)
    if isinstance(data, FreeDecays):
        even, n = np.linspace(data.times[0], data.times[-1], data.times.size), data.times.size
        rows = [data.values, motion(data, modes, data.times)]
        if not even_times(data.times):
            rows = [np.stack([np.interp(even, data.times, channel) for channel in channels]) for channels in rows]
        frequencies = np.fft.rfftfreq(n, (even[-1] - even[0]) / (n - 1))
        measured, fitted = (np.fft.rfft(channels) * 2.0 / n for channels in rows)
    elif isinstance(data, Blows):
        mean = averages(data, decay_needed(data))
        frequencies, measured, data = mean.frequencies, mean.h1, mean.frequency_responses()
    else:
        frequencies, measured = data.frequencies, data.values
    inside = (frequencies > 0) & (frequencies >= low) & (frequencies <= high)
    if isinstance(record.data, Blows):
        inside &= mean.reach  # beyond, noise over hardly any force looks like lines
    frequencies, measured = frequencies[inside], measured[:, inside]
    if isinstance(data, FreeDecays):
        return Comparison(frequencies, measured, fitted[:, inside])
    s, poles = 2j * np.pi * frequencies + data.window, np.array([mode.pole for mode in modes])
    parts = [1.0 / (s - pole) for pole in (*poles, *poles.conj())]
    basis = s ** DERIVATIVES[data.response] * np.stack([*parts, s**-2, np.ones_like(s)])
    basis = (basis / np.linalg.norm(basis, axis=1, keepdims=True)).T
    return Comparison(frequencies, measured, (basis @ np.linalg.lstsq(basis, measured.T)[0]).T)


def _reasons(
    record: ModalRecord, modes: Sequence[Mode], comparison: Comparison, problem: ModalProblem
) -> Iterator[Reason]:
    """Yield reasons for caution."""
    if problem.count is None and len(modes) == MOST_MODES:
        said = (
            f"{MOST_MODES} modes are as many as are sought: what is there is no sum of modes, or too much for one fit"
        )
        yield Reason(Trust.NO, f"{said}; leave a start-up out by from=, choose a band= or a number of modes=")
    data, power, left = record.data, comparison.power, comparison.left
    if noise := [mode for mode in modes if _chance_of_noise(mode, power.size) > NOISE_CHANCE]:
        yield Reason(Trust.NO if len(noise) == len(modes) else Trust.CAUTION, f"may be noise: {_named(*noise)}")
    frequency, share = comparison.line(modes)
    if share > SECOND_MODE:
        said = f"the residuals hold a line at {frequency:.4g} Hz, {share:.0%} of the signal"
        yield Reason(Trust.NO if share > MOST_LEFT else Trust.CAUTION, f"{said}: modes={len(modes) + 1}, or a band=")
    if left > 1.0:
        yield Reason(Trust.NO, "the modes leave more than the record holds")
    worst = max(modes, key=lambda mode: comparison.near(mode)[0])
    over, there = comparison.near(worst)
    if over > UNEXPLAINED:
        said = f"near {_named(worst)} the residuals are {over:.2g} times the noise beside it, {there:.0%} of the motion"
        why = "another mode is close, it does not decay as a mode, or the start does not belong to it (from=)"
        yield Reason(Trust.NO if there > MOST_LEFT else Trust.CAUTION, f"{said}: {why}; intervals are wider by as much")
    elif left > MOST_LEFT and share <= SECOND_MODE:
        yield Reason(Trust.CAUTION, f"the residuals are {left:.0%} of the signal: much noise")
    if alike := _alike(modes):
        pairs = "; ".join(_named(*pair) for pair in alike)
        said = "close and of one shape, so they may be one that does not decay as a mode"
        yield Reason(Trust.CAUTION, f"{said}: {pairs}")
    if wide := [mode for mode in modes if 2.0 * mode.damping_ratio_sd > WIDE * mode.damping_ratio]:
        yield Reason(Trust.CAUTION, f"damping ratios are known to an order of magnitude at most: {_named(*wide)}")
    if not isinstance(data, FreeDecays):
        return
    if left > MOST_LEFT and (growth := growth_of(data.values)) > GROWTH:
        yield Reason(Trust.NO, f"the motion grows {growth:.2g} times over the record, as no free vibration does")
    yield from start_up(*_left(data, modes))
    if any(np.any(at_limit(values)) for values in data.values):
        yield Reason(Trust.NO, "the sensor is clipped: samples stay at its largest or smallest value")
    if (cycles := float(np.ptp(data.times)) * modes[0].frequency) < FEW_CYCLES:
        yield Reason(Trust.CAUTION, f"the record holds {cycles:.2g} cycles of the mode at {_named(modes[0])}")


def _close(modes: Sequence[Mode]) -> list[tuple[Mode, Mode]]:
    """Return neighbours that are nearer than their half-power bandwidths."""
    return [(a, b) for a, b in pairwise(modes) if b.frequency - a.frequency < (a.bandwidth + b.bandwidth) / 2.0]


def _alike(modes: Sequence[Mode]) -> list[tuple[Mode, Mode]]:
    """Return close modes of one shape, by the modal assurance criterion.

    R. J. Allemang, Sound and Vibration 37(8):14, 2003.
    """

    def criterion(a: np.ndarray, b: np.ndarray) -> float:
        return float((np.abs(np.vdot(a, b)) / np.linalg.norm(a) / np.linalg.norm(b)) ** 2)

    return [pair for pair in _close(modes) if criterion(*(mode.shape for mode in pair)) > ALIKE]


def _chance_of_noise(mode: Mode, lines: int) -> float:
    """Compute the chance that the best of so many lines of noise has a mode as strong, by Bonferroni's bound.

    Squares of real and imaginary parts over their variances are of chi square; the pole was chosen, too.
    """
    from scipy.stats import chi2

    known = np.isfinite(mode.shape_sd) & (mode.shape_sd > 0)
    statistic = float(np.sum(np.abs(mode.shape[known] / mode.shape_sd[known]) ** 2))
    return min(1.0, lines * float(chi2.sf(statistic, 2 * np.count_nonzero(known) + 2))) if np.any(known) else 0.0


# ------------------------------------------------------------------------------- what is shown


def _shaped(mode: Mode, quantile: float, record: ModalRecord) -> ShapedMode:
    """Return a mode as it is shown, with intervals of ``quantile`` standard errors; of a ratio by propagation."""
    f, half, ratio, ratio_half = (
        mode.frequency, quantile * mode.frequency_sd, mode.damping_ratio, quantile * mode.damping_ratio_sd
    )  # fmt: skip
    sizes, largest = np.abs(mode.shape), int(np.argmax(np.abs(mode.shape)))
    size, size_half, parts = float(sizes[largest]), quantile * float(mode.shape_sd[largest]), []
    for i, channel in enumerate(record.channels if len(record.channels) > 1 else ()):
        part = complex(mode.shape[i] / mode.shape[largest]) if i != largest else 1.0 + 0.0j
        error = float(np.hypot(mode.shape_sd[i], abs(part) * mode.shape_sd[largest])) / size if i != largest else 0.0
        phase = float(np.degrees(np.angle(part)))
        in_line = min(abs(phase), 180.0 - abs(phase)) < max(REAL, np.degrees(np.arctan2(2.0 * error, abs(part))))
        parts.append(
            Component(channel, part.real if in_line else abs(part), quantile * error, 0.0 if in_line else phase)
        )
    if not isinstance(record.data, FreeDecays):
        size = math.nan
    return ShapedMode(
        f, f - half, f + half, ratio, ratio - ratio_half, ratio + ratio_half, mode.share, False,
        size, size - size_half, size + size_half, record.units[largest], tuple(parts),
        _parameters(mode, quantile, record),
    )  # fmt: skip


def _parameters(mode: Mode, quantile: float, record: ModalRecord) -> tuple[ModalParameter, ...]:
    """Return modal mass, damping and stiffness; none of free motion, of several sensors and of a residue not real."""
    if isinstance(record.data, FreeDecays) or len(record.channels) > 1 or not np.isfinite(mode.shape_sd[0]):
        return ()
    by = modal_parameters(mode)
    triples = (("m", by.m, by.m_sd, "kg"), ("c", by.c, by.c_sd, "N·s/m"), ("k", by.k, by.k_sd, "N/m"))
    return () if by.note else tuple(ModalParameter(name, value, quantile * sd, u) for name, value, sd, u in triples)


def residuals_of_modes(finding: ModalFinding, i: int = 0) -> ChannelResiduals | None:
    """Return what the modes leave of a channel of free motion; None of other records, and without modes."""
    data, modes = finding.record.data, finding.estimate.modes
    if not (isinstance(data, FreeDecays) and modes):
        return None
    rest = _left(data, modes)[0][i]
    offset, rms = float(np.mean(rest)), float(np.std(rest))
    kept = data.times[:2000] - data.times[0]  # as for one mode: the test draws white noise as long as the record
    waves = np.exp(np.multiply.outer(kept, [mode.pole for mode in modes]))
    slopes = np.column_stack([waves.real, waves.imag, kept[:, None] * waves.real, kept[:, None] * waves.imag])
    level = float(whiteness(rest[None, : kept.size] - offset, np.column_stack([slopes, np.ones(kept.size)]))[0])
    part, lag = rms / (float(np.std(data.values[i])) or 1.0), float(autocorrelation(rest - offset, 1)[1])
    return ChannelResiduals(rest - offset, rms, part, lag, level, offset, finding.record.units[i])


def modal_response(finding: ModalFinding) -> Response | None:
    """Return the free motion of the first channel with its fit; None where the record is none of free motion."""
    data, record, modes = finding.record.data, finding.record, finding.estimate.modes
    if not isinstance(data, FreeDecays):
        return None
    times, values, residuals, fit = data.times, data.values[0], residuals_of_modes(finding), None
    if residuals is not None:
        n = int(np.clip(A_CYCLE * modes[-1].frequency * np.ptp(times), FEWEST, MOST))
        even = np.linspace(times[0], times[-1], n)
        fit = ChannelResponse(even, motion(data, modes, even)[0] + residuals.offset, residuals)
    frequency = dominant_frequency(times, values)
    return Response(finding.method, finding.trust, record.channels[0], record.units[0], times, values, frequency, fit)
