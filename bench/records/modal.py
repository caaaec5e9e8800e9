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
from bench.contract.modal import FreeDecays, ModalEstimate, ModalIdentifier, ModalProblem, Mode
from bench.entrants.modal import make_modal
from bench.likelihood.autoregression import even_times
from bench.records.colour import autocorrelation
from bench.records.diagnostics import MOST_LEFT, SECOND_MODE, START_UP, START_UP_SHARE, WIDE
from bench.records.modal_data import ModalRecord
from bench.records.modes import OfferedMode
from bench.records.reading.units import MEASURES
from bench.records.request import ModalRequest
from bench.records.response import A_CYCLE, FEWEST, MOST, ChannelResiduals, ChannelResponse, Response
from bench.records.saturation import at_limit
from bench.records.strongest import strongest_frequency
from bench.records.verdict import Reason, Trust, verdict
from bench.scoring.statistics import whiteness

FREE_METHOD, FORCED_METHOD = "waves", "spectra"
"""Methods where none is named."""
NOISE_CHANCE = 1e-3
"""Chance at which a mode may be noise: beyond it the mode is doubted."""
LINE_CHANCE = 1e-6
"""Chance that white noise has such a line in the residuals (R. A. Fisher, Proc. R. Soc. A 125:54, 1929)."""
NEAR, BESIDE, FEWEST_LINES = 2.0, 8.0, 3
"""Half-power bandwidths from a mode within which, and between which, the residuals are its own and the noise beside it;
and the least lines to either side."""
UNEXPLAINED = 2.0
"""Root mean square of the residuals near a mode over the noise beside it, beyond which the noise does not explain them:
intervals that assume that noise are then as much too narrow."""
REAL = 10.0
"""Degrees from 0 or 180 within which a part of a shape is in phase or opposed."""


@dataclass(frozen=True)
class Component:
    """What a sensor has of a mode, relative to the largest: signed where in phase or opposed, else with its phase (°).

    ``half``: half of the 95 % interval.
    """

    sensor: str
    ratio: float
    half: float
    phase: float


@dataclass(frozen=True)
class ShapedMode(OfferedMode):
    """A mode with its amplitude at the first sample, of the sensor where it is largest, and its shape if several."""

    amplitude: float = math.nan
    amplitude_low: float = math.nan
    amplitude_high: float = math.nan
    amplitude_unit: str = ""
    shape: tuple[Component, ...] = ()


@dataclass(frozen=True, eq=False)
class Comparison:
    """Spectra of record and fit, shape (channels, lines), at ``frequencies`` (lines,) in Hz inside the band."""

    frequencies: np.ndarray
    measured: np.ndarray
    fitted: np.ndarray

    @cached_property
    def power(self) -> np.ndarray:
        """Power of the residuals of each line over the mean of the record's, averaged over channels."""
        size = np.mean(np.abs(self.measured) ** 2, axis=1, keepdims=True)
        return np.asarray(np.mean(np.abs(self.measured - self.fitted) ** 2 / np.where(size > 0, size, 1.0), axis=0))

    @property
    def left(self) -> float:
        """Root mean square of the residuals over that of the record, in the band."""
        return float(np.sqrt(np.mean(self.power)))

    def line(self) -> tuple[float, float]:
        """Return frequency and share of the signal of the residuals' strongest line; 0 where noise may be it."""
        i, total = int(np.argmax(self.power)), float(np.sum(self.power))
        largest = float(self.power[i]) / (total or 1.0)
        chance = self.power.size * (1.0 - largest) ** (self.power.size - 1)
        share = float(np.sqrt(self.power[i] / self.power.size)) if chance < LINE_CHANCE else 0.0
        return float(self.frequencies[i]), share

    def near(self, mode: Mode) -> tuple[float, float]:
        """Return the residuals near a mode, as root mean squares: over the noise beside it, and over the record there.

        The noise is the median of the lines beside, whose power is exponentially distributed: the mean over log 2.
        """
        step, distance = float(self.frequencies[1] - self.frequencies[0]), np.abs(self.frequencies - mode.frequency)
        width = max(mode.bandwidth, FEWEST_LINES * step / NEAR)
        near, beside = distance <= NEAR * width, (distance > NEAR * width) & (distance <= BESIDE * width)
        if np.count_nonzero(beside) < 2 * FEWEST_LINES or not np.any(near):
            return 1.0, 0.0
        noise = float(np.median(self.power[beside])) / math.log(2.0)
        record = np.linalg.norm(self.measured[:, near]) or 1.0
        left = float(np.linalg.norm((self.measured - self.fitted)[:, near]) / record)
        return float(np.sqrt(np.mean(self.power[near]) / (noise or 1.0))), left


@dataclass(frozen=True, eq=False)
class ModalFinding:
    """The answer of a modal method to a record; ``comparison`` is None without modes."""

    method: str
    record: ModalRecord
    estimate: ModalEstimate
    comparison: Comparison | None = None
    wall_s: float = math.nan
    reasons: tuple[Reason, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def trust(self) -> Trust:
        """The verdict."""
        return verdict(self.reasons)

    @cached_property
    def modes(self) -> tuple[ShapedMode, ...]:
        """The modes with 95 % intervals; without them where the answer is not to be trusted."""
        from scipy.stats import t as student

        quantile = math.nan if self.trust is Trust.NO else float(student.ppf(0.975, self.estimate.degrees))
        return tuple(_shaped(mode, quantile, self.record) for mode in self.estimate.modes)


def find_modes(request: ModalRequest, record: ModalRecord) -> list[ModalFinding]:
    """Return what each method of a request makes of a record."""
    default = FREE_METHOD if isinstance(record.data, FreeDecays) else FORCED_METHOD
    methods = request.methods or {default: make_modal(default)}
    problem = ModalProblem(record.data, request.count, request.band)
    return [_find(name, method, problem, record) for name, method in methods.items()]


def _find(name: str, method: ModalIdentifier, problem: ModalProblem, record: ModalRecord) -> ModalFinding:
    lacking = [package for package in method.requires if importlib.util.find_spec(package) is None]
    started = time.perf_counter()
    if lacking:
        estimate = ModalEstimate((), status=Status.MISSING_DEPENDENCY, message=f"it needs {lacking[0]}: pip install it")
    elif objection := method.objection(problem):
        estimate = ModalEstimate((), status=Status.UNSUPPORTED, message=objection)
    else:
        estimate = method.identify_modes(problem)
    finding = ModalFinding(name, record, estimate, wall_s=time.perf_counter() - started, notes=record.notes)
    if estimate.status is not Status.OK or not estimate.modes:
        why = estimate.message or "no mode stands out of the noise"
        return replace(finding, reasons=(Reason(Trust.NO, f"no answer ({estimate.status.value}): {why}"),))
    finding = replace(finding, comparison=compare(record, estimate.modes, problem.band))
    notes = [f"number of modes: {estimate.message}"] if estimate.message else []
    for first, second in pairwise(estimate.modes):
        if second.frequency - first.frequency < (first.bandwidth + second.bandwidth) / 2.0:
            notes.append(f"the modes at {_named(first)} and {_named(second)} are close, nearer than their bandwidths")
    return replace(finding, reasons=tuple(_reasons(finding, problem)), notes=(*finding.notes, *notes))


def _named(mode: Mode) -> str:
    return f"{mode.frequency:.4g} Hz"


# ------------------------------------------------------------------------------- what is left of the record


def motion(times: np.ndarray, modes: Sequence[Mode], first: float) -> np.ndarray:
    """Compute the free motion (channels, n) of modes at times, whose amplitudes are those at the ``first`` time."""
    waves = np.exp(np.multiply.outer([mode.pole for mode in modes], times - first))
    return np.asarray(np.real(np.stack([mode.shape for mode in modes], axis=1) @ waves))


def compare(record: ModalRecord, modes: Sequence[Mode], band: tuple[float, float] | None) -> Comparison:
    """Return the spectra of a record, about its mean, and of the modes' motion."""
    data = record.data
    assert isinstance(data, FreeDecays)
    even, n = np.linspace(data.times[0], data.times[-1], data.times.size), data.times.size
    measured, fitted = data.values, motion(data.times, modes, float(data.times[0]))
    if not even_times(data.times):
        measured, fitted = (np.stack([np.interp(even, data.times, row) for row in rows]) for rows in (measured, fitted))
    frequencies = np.fft.rfftfreq(n, (even[-1] - even[0]) / (n - 1))
    low, high = band or (0.0, math.inf)
    inside = (frequencies > 0) & (frequencies >= low) & (frequencies <= high)
    spectra = (np.fft.rfft(rows)[:, inside] * 2.0 / n for rows in (measured, fitted))
    return Comparison(frequencies[inside], *spectra)


def _reasons(finding: ModalFinding, problem: ModalProblem) -> Iterator[Reason]:
    """Yield reasons for caution, the gravest first."""
    comparison, data, modes = finding.comparison, finding.record.data, finding.estimate.modes
    assert comparison is not None
    for mode in modes if isinstance(data, FreeDecays) else ():
        if (chance := _chance_of_noise(mode, comparison.power.size)) > NOISE_CHANCE:
            grave = Trust.NO if len(modes) == 1 else Trust.CAUTION
            yield Reason(grave, f"the mode at {_named(mode)} may be noise: p = {chance:.2g}")
    frequency, share = comparison.line()
    if share > SECOND_MODE:
        more = f"modes={len(modes) + 1}" if problem.count else "more modes= by number"
        said = f"the residuals hold a line at {frequency:.4g} Hz, {share:.0%} of the signal: try {more}, or a band="
        yield Reason(Trust.NO if share > MOST_LEFT else Trust.CAUTION, said)
    elif comparison.left > MOST_LEFT:
        yield Reason(Trust.CAUTION, f"the residuals are {comparison.left:.0%} of the signal: much noise")
    for mode in modes:
        over, left = comparison.near(mode)
        if over > UNEXPLAINED:
            said = (
                f"near {_named(mode)} the residuals are {over:.2g} times the noise beside it, {left:.0%} of the record"
            )
            why = "its decay is not that of a mode, or another mode is close: its intervals are too narrow"
            yield Reason(Trust.NO if left > MOST_LEFT else Trust.CAUTION, f"{said}: {why}")
        if mode.damping_ratio <= 0.0:
            yield Reason(Trust.CAUTION, f"the mode at {_named(mode)} grows: its damping ratio is not positive")
        elif 2.0 * mode.damping_ratio_sd > WIDE * mode.damping_ratio:
            yield Reason(
                Trust.CAUTION, f"the damping ratio at {_named(mode)} is known to an order of magnitude at most"
            )
    if isinstance(data, FreeDecays):
        yield from _of_free_motion(data, modes, problem)


def _chance_of_noise(mode: Mode, lines: int) -> float:
    """Compute the chance that the best of so many lines of noise has a mode as strong, by Bonferroni's bound.

    Squares of real and imaginary parts over their variances are of chi square; the pole was chosen, too.
    """
    from scipy.stats import chi2

    known = np.isfinite(mode.shape_sd) & (mode.shape_sd > 0)
    statistic = float(np.sum(np.abs(mode.shape[known] / mode.shape_sd[known]) ** 2))
    return min(1.0, lines * float(chi2.sf(statistic, 2 * np.count_nonzero(known) + 2))) if np.any(known) else 0.0


def _of_free_motion(data: FreeDecays, modes: Sequence[Mode], problem: ModalProblem) -> Iterator[Reason]:
    if any(np.any(at_limit(values)) for values in data.values):
        yield Reason(Trust.NO, "the sensor is clipped: samples stay at its largest or smallest value")
    cycles = float(np.ptp(data.times)) * modes[0].frequency
    if cycles < 2.0:
        yield Reason(Trust.CAUTION, f"the record holds {cycles:.2g} cycles of the mode at {_named(modes[0])}")
    if problem.band is not None:  # what is outside of it is not fitted
        return
    residuals = data.values - motion(data.times, modes, float(data.times[0]))
    early, rest = (np.std(part, axis=1) for part in np.split(residuals, [max(data.times.size // 10, 5)], axis=1))
    signal = np.std(data.values, axis=1)
    worst = int(np.argmax(early / np.where(rest > 0, rest, np.inf)))
    if early[worst] > START_UP * rest[worst] and early[worst] > START_UP_SHARE * signal[worst]:
        said = f"the first tenth of the record fits {early[worst] / rest[worst]:.2g} times worse than the rest"
        yield Reason(Trust.CAUTION, f"{said}: leave a start-up out by from=")


# ------------------------------------------------------------------------------- what is shown


def _shaped(mode: Mode, quantile: float, record: ModalRecord) -> ShapedMode:
    """Return a mode as it is shown, with intervals of ``quantile`` standard errors; of a ratio by propagation."""
    f, f_half, ratio, half = mode.frequency, quantile * mode.frequency_sd, mode.damping_ratio, mode.damping_ratio_sd
    sizes, largest = np.abs(mode.shape), int(np.argmax(np.abs(mode.shape)))
    size, size_half = float(sizes[largest]), quantile * float(mode.shape_sd[largest])
    ends = max(ratio - quantile * half, min(ratio, 0.0)) if math.isfinite(quantile * half) else math.nan
    parts = []
    for i, channel in enumerate(record.channels if len(record.channels) > 1 else ()):
        part = mode.shape[i] / mode.shape[largest]
        phase, turned = float(np.degrees(np.angle(part))), float(abs(part))
        error = np.hypot(mode.shape_sd[i], turned * mode.shape_sd[largest]) / size if i != largest else 0.0
        if min(abs(phase), 180.0 - abs(phase)) < max(REAL, np.degrees(np.arctan2(2.0 * error, turned))):
            turned, phase = float(np.real(part)), 0.0
        parts.append(Component(channel, turned, quantile * float(error), phase))
    return ShapedMode(
        f, f - f_half, f + f_half, ratio, ends, ratio + quantile * half, mode.share, False,
        size, size - size_half, size + size_half, record.units[largest],
        tuple(parts),
    )  # fmt: skip


def modal_response(finding: ModalFinding) -> Response | None:
    """Return the free motion of the liveliest channel with its fit; None where the record is none of free motion."""
    data, record, modes = finding.record.data, finding.record, finding.estimate.modes
    if not isinstance(data, FreeDecays):
        return None
    i = int(np.argmax(np.std(data.values, axis=1)))
    times, values, unit, fit = data.times, data.values[i], record.units[i], None
    frequency = max(modes, key=lambda mode: mode.share).frequency if modes else strongest_frequency(times, values)
    if modes and (residuals := residuals_of_modes(finding, i)) is not None:
        n = int(np.clip(A_CYCLE * modes[-1].frequency * np.ptp(times), FEWEST, MOST))
        even = np.linspace(times[0], times[-1], n)
        curve = motion(even, modes, float(times[0]))[i] + residuals.offset
        fit = ChannelResponse(even, curve, residuals)
    return Response(finding.method, finding.trust, MEASURES[record.channels[i][0]], unit, times, values, frequency, fit)


def residuals_of_modes(finding: ModalFinding, i: int = 0) -> ChannelResiduals | None:
    """Return what the modes leave of a channel of free motion; None of other records, and without modes."""
    data, modes = finding.record.data, finding.estimate.modes
    if not (isinstance(data, FreeDecays) and modes):
        return None
    rest = data.values[i] - motion(data.times, modes, float(data.times[0]))[i]
    offset, rms = float(np.mean(rest)), float(np.std(rest))
    lag = float(autocorrelation(rest - offset, 1)[1])
    part = rms / (float(np.std(data.values[i])) or 1.0)
    kept = data.times[:2000] - data.times[0]  # as for one mode: the test draws white noise as long as the record
    waves = np.exp(np.multiply.outer(kept, [mode.pole for mode in modes]))
    slopes = np.column_stack([waves.real, waves.imag, kept[:, None] * waves.real, kept[:, None] * waves.imag])
    level = float(whiteness(rest[None, : kept.size] - offset, np.column_stack([slopes, np.ones(kept.size)]))[0])
    return ChannelResiduals(rest - offset, rms, part, lag, level, offset, finding.record.units[i])
