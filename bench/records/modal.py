"""Modal identification of measured records: modes with intervals, residuals, and reasons for caution.

Record and fit are compared by their spectra inside the band, for free decays and frequency responses alike. Intervals
are for this record.
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
"""Default methods."""
NOISE_CHANCE = 1e-3
"""p-value of a mode under noise above which it is reported as possible noise."""
NEAR, NEIGHBOURHOOD, FEWEST_LINES = 2.0, 8.0, 3
"""Distances from a mode, in half-power bandwidths, up to which residuals belong to it, and up to which they estimate
the noise nearby; least number of lines on either side."""
UNEXPLAINED = 2.0
"""Ratio of the residuals near a mode to the noise nearby (root mean square) above which noise does not explain them;
intervals are then widened by this ratio."""
LATER, FEWEST_LEFT = (0, 1, 2, 4, 8), 8
"""Cycles after the largest value at which the fitted part of a free motion may begin; least cycles of this part."""
FEW_CYCLES = 2.0
"""Cycles of the lowest mode below which caution is advised."""
ALIKE = 0.9
"""Modal assurance criterion above which two shapes count as equal; for a single sensor it is 1."""
REAL = 10.0
"""Angle (degrees) from 0 or 180 within which a component of a shape counts as in phase or in antiphase."""


@dataclass(frozen=True)
class Component:
    """Component of a mode shape relative to the largest one.

    Attributes:
        sensor: Role of the sensor.
        ratio: Amplitude ratio, signed if in phase or in antiphase.
        half: Half-width of its 95 % interval.
        phase: Phase (degrees); 0 if in phase or in antiphase.
    """

    sensor: str
    ratio: float
    half: float
    phase: float


@dataclass(frozen=True)
class ModalParameter:
    """Modal mass, damping or stiffness at a drive point; ``half`` is the half-width of the 95 % interval."""

    name: str
    value: float
    half: float
    unit: str


@dataclass(frozen=True)
class ShapedMode(OfferedMode):
    """Mode with its amplitude and shape, or its modal parameters.

    Attributes:
        amplitude: Amplitude of a free decay at the first sample, at the sensor where it is largest.
        amplitude_low: Lower end of its 95 % interval.
        amplitude_high: Upper end.
        amplitude_unit: Unit.
        shape: Components of the mode shape, for several sensors.
        parameters: Modal mass, damping and stiffness, for a force and one sensor.
    """

    amplitude: float = math.nan
    amplitude_low: float = math.nan
    amplitude_high: float = math.nan
    amplitude_unit: str = ""
    shape: tuple[Component, ...] = ()
    parameters: tuple[ModalParameter, ...] = ()


@dataclass(frozen=True, eq=False)
class Comparison:
    """Spectra of record and fit, shape (channels, lines), at ``frequencies`` (lines,) inside the band (Hz)."""

    frequencies: np.ndarray
    measured: np.ndarray
    fitted: np.ndarray

    @cached_property
    def power(self) -> np.ndarray:
        """Power (lines,) of the residuals over the total power of the record, averaged over channels."""
        size = np.sum(np.abs(self.measured) ** 2, axis=1, keepdims=True)
        return np.asarray(np.mean(np.abs(self.measured - self.fitted) ** 2 / np.where(size > 0, size, 1.0), axis=0))

    @property
    def left(self) -> float:
        """Ratio of residuals to record (root mean square)."""
        return float(np.sqrt(np.sum(self.power)))

    def line(self, modes: Sequence[Mode]) -> tuple[float, float]:
        """Test for a line in the residuals away from the modes (R. A. Fisher, Proc. R. Soc. A 125:54, 1929).

        Returns:
            Frequency (Hz) of the largest line, and its root mean square over that of the record; 0 if not significant.
        """
        power = np.where(np.min([self.distance(mode) for mode in modes], axis=0) > NEAR, self.power, 0.0)
        largest, lines = float(np.max(power)), power.size
        chance = lines * (1.0 - largest / (float(np.sum(self.power)) or 1.0)) ** (lines - 1)
        return float(self.frequencies[np.argmax(power)]), math.sqrt(largest) if chance < LINE_LEVEL else 0.0

    def distance(self, mode: Mode) -> np.ndarray:
        """Return the distance (lines,) from a mode in bandwidths, or in line spacings if these are wider."""
        width = max(mode.bandwidth, FEWEST_LINES / NEAR * float(self.frequencies[1] - self.frequencies[0]))
        return np.asarray(np.abs(self.frequencies - mode.frequency) / width)

    def near(self, mode: Mode) -> tuple[float, float]:
        """Return the ratios of the residuals near a mode to the noise nearby and to the record (root mean square).

        The power of a line of noise is exponentially distributed, so its mean is the median over log 2.
        """
        distance = self.distance(mode)
        near, nearby = distance <= NEAR, (distance > NEAR) & (distance <= NEIGHBOURHOOD)
        if np.count_nonzero(nearby) < 2 * FEWEST_LINES or not np.any(near):
            return 1.0, 0.0
        noise = float(np.median(self.power[nearby])) / math.log(2.0)
        left, record = (np.linalg.norm(part[:, near]) for part in (self.measured - self.fitted, self.measured))
        return float(np.sqrt(np.mean(self.power[near]) / (noise or 1.0))), float(left / (record or 1.0))


@dataclass(frozen=True, eq=False)
class ModalFinding:
    """Result of a modal method on a record.

    Attributes:
        method: Name of the method.
        record: The record.
        estimate: The method's estimate, or a failed one.
        wall_s: Computing time (s).
        comparison: Spectra of record and fit; None without modes.
        reasons: Reasons for caution.
        notes: Notes on the record and the fit.
    """

    method: str
    record: ModalRecord
    estimate: ModalEstimate
    wall_s: float
    comparison: Comparison | None = None
    reasons: tuple[Reason, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def trust(self) -> Trust:
        """Verdict of the reasons."""
        return verdict(self.reasons)

    @cached_property
    def unexplained(self) -> tuple[float, ...]:
        """Ratio of the residuals near each mode to the noise nearby if above :data:`UNEXPLAINED`, otherwise 1."""
        over = [self.comparison.near(mode)[0] for mode in self.estimate.modes] if self.comparison else []
        return tuple(value if value > UNEXPLAINED else 1.0 for value in over)

    @property
    def describes(self) -> bool:
        """Whether noise explains the residuals of fewer than the largest number of modes."""
        comparison, modes = self.comparison, self.estimate.modes
        if comparison is None or len(modes) == MOST_MODES or max(self.unexplained) > 1.0:
            return False
        if isinstance(data := self.record.data, FreeDecays) and start_up(*_left(data, modes)):
            return False
        return comparison.left <= 1.0 and comparison.line(modes)[1] <= SECOND_MODE

    @property
    def alike(self) -> list[tuple[Mode, Mode]]:
        """Pairs of close modes with equal shapes, which may be a single mode."""
        return _alike(self.estimate.modes)

    @property
    def rank(self) -> tuple[int, float]:
        """Sort key of results of a record, the best first."""
        return self.trust.severity, max(self.unexplained, default=math.inf)

    @cached_property
    def modes(self) -> tuple[ShapedMode, ...]:
        """Modes with 95 % intervals, widened by :attr:`unexplained`; NaN if the estimate is not trusted."""
        from scipy.stats import t as student

        quantile = math.nan if self.trust is Trust.NO else float(student.ppf(0.975, self.estimate.degrees))
        pairs = zip(self.estimate.modes, self.unexplained, strict=True) if self.comparison else ()
        return tuple(_shaped(mode, quantile * over, self.record) for mode, over in pairs)


def find_modes(request: ModalRequest, record: ModalRecord, others: bool = False) -> list[ModalFinding]:
    """Identify the modes of a record with each method of a request, in separate processes with limits.

    Args:
        request: Methods, number of modes, band and limits.
        record: The record.
        others: Whether to use all applicable methods if the request names none.

    Returns:
        A result per method, failed if the method has no estimate.
    """
    default = FREE_METHOD if isinstance(record.data, FreeDecays) else FORCED_METHOD
    problem = ModalProblem(record.data, request.count, request.band)
    methods = dict(request.methods) or {default: make_modal(default)}
    selectable = isinstance(record.data, FreeDecays) and request.count is None and request.options.start is None
    if others and not request.methods:
        able = ((name, make_modal(name)) for name in registered_modal())
        methods |= {name: method for name, method in able if not (_lacking(method) or method.objection(problem))}
    work, config = _best_start if selectable else _identify, request.config
    findings = []
    with Workers(preload=(__name__,)) as workers:
        tasks = {
            name: workers.submit(config.timeout_s, work, name, method, problem, record, memory_mb=config.memory_mb)
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
    reason = f"no estimate ({estimate.status.value}): {estimate.message or 'no mode is significant'}"
    return replace(finding, reasons=(Reason(Trust.NO, reason),))


def _identify(name: str, method: ModalIdentifier, problem: ModalProblem, record: ModalRecord) -> ModalFinding:
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
        notes.append(f"close modes, within their half-power bandwidths: {pairs}")
    comparison = compare(record, modes, problem.band)
    reasons = tuple(_reasons(record, modes, comparison, problem))
    return replace(finding, comparison=comparison, reasons=reasons, notes=(*record.notes, *notes))


def _best_start(name: str, method: ModalIdentifier, problem: ModalProblem, record: ModalRecord) -> ModalFinding:
    """Identify a free motion from its first sample, or from a later one if noise does not explain the residuals.

    The earliest start from which the modes describe the motion is used, or else that with the smallest residuals, as
    contact by a hand, a start-up or large amplitudes may precede it. Later starts are fitted with as few modes as leave
    no line in the residuals, unless the method's choice describes the motion.
    """
    started, data = time.perf_counter(), problem.data
    whole = _identify(name, method, problem, record)
    if whole.describes or whole.estimate.status in (Status.MISSING_DEPENDENCY, Status.UNSUPPORTED):
        return whole
    assert isinstance(data, FreeDecays)
    if growth_of(data.values) > GROWTH:  # it is not a free motion from any start
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
    again = _identify(name, method, replace(problem, data=best.record.data), best.record)
    if again.describes and again.rank <= best.rank and not again.alike:
        best = again
    fitted = f"the modes describe only the last {left:.3g} of {span:.3g} s"
    cause = "contact by a hand, a start-up or large amplitudes are excluded; from= sets another start"
    number = f"number of modes: the smallest without a line above {SECOND_MODE:.0%} of the signal in the residuals"
    notes = best.notes if best is again else (*(n for n in best.notes if n != best.estimate.message), number)
    reasons = (Reason(Trust.CAUTION, f"{fitted}: {cause}"), *best.reasons)
    return replace(best, reasons=reasons, notes=notes, wall_s=time.perf_counter() - started)


def _starts(data: FreeDecays) -> Iterator[float]:
    """Yield the time of the largest value, and times ``LATER`` cycles after it, while enough cycles follow."""
    size = np.std(data.values, axis=1, keepdims=True)
    motion = np.abs(data.values - np.mean(data.values, axis=1, keepdims=True)) / np.where(size > 0, size, 1.0)
    channel, largest = np.unravel_index(np.argmax(motion), motion.shape)
    cycle = 1.0 / dominant_frequency(data.times[largest:], data.values[channel, largest:])
    for start in (data.times[largest] + cycles * cycle for cycles in LATER):
        if data.times[-1] - start >= FEWEST_LEFT * cycle:
            yield float(start)


def _fewest(name: str, method: ModalIdentifier, problem: ModalProblem, record: ModalRecord) -> ModalFinding:
    """Return the result with the fewest modes that leave no line in the residuals and have no close, equal shapes."""
    best = _identify(name, method, replace(problem, count=1), record)
    while best.comparison is not None and best.comparison.line(best.estimate.modes)[1] > SECOND_MODE:
        count = len(best.estimate.modes) + 1
        longer = _identify(name, method, replace(problem, count=count), record)
        if longer.alike or not count == len(longer.estimate.modes) <= MOST_OFFERED:
            break
        best = longer
    return best


def _lacking(method: ModalIdentifier) -> str:
    return next((package for package in method.requires if importlib.util.find_spec(package) is None), "")


def _named(*modes: Mode) -> str:
    return f"{', '.join(f'{mode.frequency:.4g}' for mode in modes)} Hz"


# ------------------------------------------------------------------------------- residuals


def motion(data: FreeDecays, modes: Sequence[Mode], times: np.ndarray) -> np.ndarray:
    """Compute the free motion (channels, n) of modes, whose amplitudes refer to the first sample of ``data``.

    Args:
        data: The record.
        modes: Modes.
        times: Times (s), shape (n,).
    """
    waves = np.exp(np.multiply.outer([mode.pole for mode in modes], times - data.times[0]))
    return np.asarray(np.real(np.stack([mode.shape for mode in modes], axis=1) @ waves))


def _left(data: FreeDecays, modes: Sequence[Mode]) -> tuple[np.ndarray, np.ndarray]:
    """Return the residuals of modes and the samples, both (channels, n)."""
    return data.values - motion(data, modes, data.times), data.values


def compare(record: ModalRecord, modes: Sequence[Mode], band: tuple[float, float] | None) -> Comparison:
    """Return the spectra of a free decay and of its modes, or the frequency responses of a forced motion.

    Frequency responses are fitted with free residues, as noise of a blow's force scales them, and with the residual
    terms of modes below and above the band, ``a / s² + b`` (D. J. Ewins, Modal Testing, 2nd ed., section 4.4).

    Args:
        record: The record.
        modes: Modes.
        band: Lower and upper frequency (Hz).
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
        inside &= mean.reach  # elsewhere the force is too weak
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
        text = f"the largest number of modes, {MOST_MODES}, was reached: the record is no sum of modes or too complex"
        yield Reason(Trust.NO, f"{text}; exclude a start-up with from=, or set band= or modes=")
    data, power, left = record.data, comparison.power, comparison.left
    if noise := [mode for mode in modes if _chance_of_noise(mode, power.size) > NOISE_CHANCE]:
        yield Reason(Trust.NO if len(noise) == len(modes) else Trust.CAUTION, f"may be noise: {_named(*noise)}")
    frequency, share = comparison.line(modes)
    if share > SECOND_MODE:
        text = f"the residuals have a line at {frequency:.4g} Hz, {share:.0%} of the signal"
        yield Reason(Trust.NO if share > MOST_LEFT else Trust.CAUTION, f"{text}: try modes={len(modes) + 1} or band=")
    if left > 1.0:
        yield Reason(Trust.NO, "residual RMS exceeds signal RMS")
    worst = max(modes, key=lambda mode: comparison.near(mode)[0])
    over, there = comparison.near(worst)
    if over > UNEXPLAINED:
        text = f"near {_named(worst)} the residuals are {over:.2g} times the noise nearby, {there:.0%} of the motion"
        cause = "a close mode, nonlinear decay, or a start-up (from=); intervals are widened accordingly"
        yield Reason(Trust.NO if there > MOST_LEFT else Trust.CAUTION, f"{text}: {cause}")
    elif left > MOST_LEFT and share <= SECOND_MODE:
        yield Reason(Trust.CAUTION, f"residual RMS is {left:.0%} of signal RMS: strong noise")
    if alike := _alike(modes):
        pairs = "; ".join(_named(*pair) for pair in alike)
        yield Reason(Trust.CAUTION, f"close modes of equal shape, which may be one mode with nonlinear decay: {pairs}")
    if wide := [mode for mode in modes if 2.0 * mode.damping_ratio_sd > WIDE * mode.damping_ratio]:
        yield Reason(Trust.CAUTION, f"only the order of magnitude of damping ratios is determined: {_named(*wide)}")
    if not isinstance(data, FreeDecays):
        return
    if left > MOST_LEFT and (growth := growth_of(data.values)) > GROWTH:
        yield Reason(Trust.NO, f"the motion grows by a factor of {growth:.2g}: this is not a damped free vibration")
    yield from start_up(*_left(data, modes))
    if any(np.any(at_limit(values)) for values in data.values):
        yield Reason(Trust.NO, "the sensor is clipped: samples repeat its largest or smallest value")
    if (cycles := float(np.ptp(data.times)) * modes[0].frequency) < FEW_CYCLES:
        yield Reason(Trust.CAUTION, f"the record has {cycles:.2g} cycles of the mode at {_named(modes[0])}")


def _close(modes: Sequence[Mode]) -> list[tuple[Mode, Mode]]:
    """Return neighbouring modes within their half-power bandwidths."""
    return [(a, b) for a, b in pairwise(modes) if b.frequency - a.frequency < (a.bandwidth + b.bandwidth) / 2.0]


def _alike(modes: Sequence[Mode]) -> list[tuple[Mode, Mode]]:
    """Return close modes of equal shape, by the modal assurance criterion (Allemang, Sound Vib. 37(8):14, 2003)."""

    def criterion(a: np.ndarray, b: np.ndarray) -> float:
        return float((np.abs(np.vdot(a, b)) / np.linalg.norm(a) / np.linalg.norm(b)) ** 2)

    return [pair for pair in _close(modes) if criterion(*(mode.shape for mode in pair)) > ALIKE]


def _chance_of_noise(mode: Mode, lines: int) -> float:
    """Compute the p-value of a mode under noise, corrected for the choice among a number of lines (Bonferroni).

    The shape has a chi-square distribution, with two more degrees of freedom for the estimated pole.
    """
    from scipy.stats import chi2

    known = np.isfinite(mode.shape_sd) & (mode.shape_sd > 0)
    statistic = float(np.sum(np.abs(mode.shape[known] / mode.shape_sd[known]) ** 2))
    return min(1.0, lines * float(chi2.sf(statistic, 2 * np.count_nonzero(known) + 2))) if np.any(known) else 0.0


# ------------------------------------------------------------------------------- display


def _shaped(mode: Mode, quantile: float, record: ModalRecord) -> ShapedMode:
    """Return a mode for display, with intervals of ``quantile`` standard errors."""
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
    """Return modal mass, damping and stiffness for one sensor at a drive point; empty in other cases."""
    if isinstance(record.data, FreeDecays) or len(record.channels) > 1 or not np.isfinite(mode.shape_sd[0]):
        return ()
    by = modal_parameters(mode)
    triples = (("m", by.m, by.m_sd, "kg"), ("c", by.c, by.c_sd, "N·s/m"), ("k", by.k, by.k_sd, "N/m"))
    return () if by.note else tuple(ModalParameter(name, value, quantile * sd, u) for name, value, sd, u in triples)


def residuals_of_modes(finding: ModalFinding) -> ChannelResiduals | None:
    """Return the residuals of the first channel of a free decay; None for other records and without modes."""
    data, modes = finding.record.data, finding.estimate.modes
    if not (isinstance(data, FreeDecays) and modes):
        return None
    rest = _left(data, modes)[0][0]
    offset, rms = float(np.mean(rest)), float(np.std(rest))
    kept = data.times[:2000] - data.times[0]  # the test simulates white noise of this length
    waves = np.exp(np.multiply.outer(kept, [mode.pole for mode in modes]))
    slopes = np.column_stack([waves.real, waves.imag, kept[:, None] * waves.real, kept[:, None] * waves.imag])
    level = float(whiteness(rest[None, : kept.size] - offset, np.column_stack([slopes, np.ones(kept.size)]))[0])
    part, lag = rms / (float(np.std(data.values[0])) or 1.0), autocorrelation(rest - offset)
    return ChannelResiduals(rest - offset, rms, part, lag, level, offset, finding.record.units[0])


def modal_response(finding: ModalFinding) -> Response | None:
    """Return the first channel of a free decay with its fit; None for other records."""
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
