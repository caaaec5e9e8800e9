"""First channel of a record for display, in the unit of its file: samples, fitted response and residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.likelihood.compiled_model import compiled_output_error
from bench.records.colour import autocorrelation
from bench.records.diagnostics import part_of_signal, whiteness_level
from bench.records.dominant_frequency import dominant_frequency
from bench.records.finding import Finding
from bench.records.problem import Measured
from bench.records.verdict import Trust

A_CYCLE, FEWEST, MOST = 32, 1000, 20_000
"""Points of the fitted response per cycle; least and largest number of points of the curve."""
MOST_DRAWN = 800
"""Largest number of points of a curve after thinning."""


@dataclass(frozen=True, eq=False)
class ChannelResiduals:
    """Residuals (measured minus fitted) of a channel.

    Attributes:
        values: Residuals, shape (n,), in ``unit``.
        rms: Root mean square.
        part_of_signal: Root mean square over that of the signal.
        lag1_autocorrelation: Autocorrelation at lag 1.
        whiteness: p-value of the test that they are white noise.
        offset: Estimated offset of the sensor.
        unit: Unit of the file.
    """

    values: np.ndarray
    rms: float
    part_of_signal: float
    lag1_autocorrelation: float
    whiteness: float
    offset: float
    unit: str


@dataclass(frozen=True, eq=False)
class ChannelResponse:
    """Fitted response of a channel, in its unit.

    Attributes:
        times: Times of the curve (s), from the first sample to the last.
        values: Curve at these times.
        residuals: Residuals of the samples.
    """

    times: np.ndarray
    values: np.ndarray
    residuals: ChannelResiduals


@dataclass(frozen=True, eq=False)
class Response:
    """First channel of a record with the fit of a method.

    Attributes:
        method: Name of the method.
        trust: Verdict on the estimate.
        measures: Kind of the channel.
        unit: Unit of the file.
        times: Times of the samples (s).
        values: Samples.
        frequency: Dominant frequency (Hz).
        fit: Fitted response; None without an estimate.
    """

    method: str
    trust: Trust
    measures: str
    unit: str
    times: np.ndarray
    values: np.ndarray
    frequency: float
    fit: ChannelResponse | None


def best_of(findings: Sequence[Finding]) -> Finding:
    """Return the finding with the best verdict, or of several the one with the smallest residuals."""
    return min(findings, key=lambda finding: (finding.trust.severity, _left(finding)))


def _left(finding: Finding) -> float:
    return np.inf if finding.fit is None else part_of_signal(finding.fit)


def file_unit(measured: Measured) -> tuple[str, float]:
    """Return the unit of the first channel in its file, and its size in the problem's unit."""
    signals = [signal for recording in measured.recordings[:1] for signal in recording.signals]
    motion = next((signal for signal in signals if signal.measures != "force" and signal.written), None)
    return (motion.written, motion.size) if motion else (measured.unit, 1.0)


def residuals_of(finding: Finding) -> ChannelResiduals | None:
    """Return the residuals of the first channel; None without a fit."""
    fit = finding.fit
    if fit is None:
        return None
    unit, size = file_unit(finding.measured)
    values = finding.channel_size / size * fit.residuals[fit.channels[0]]
    return ChannelResiduals(
        values=values,
        rms=float(np.sqrt(np.mean(values**2))),
        part_of_signal=part_of_signal(fit),
        lag1_autocorrelation=autocorrelation(fit.residuals[fit.channels[0]]),
        whiteness=whiteness_level(fit),
        offset=finding.channel_size / size * float(fit.model.offsets(fit.theta)[0]),
        unit=unit,
    )


def response_of(finding: Finding) -> Response:
    """Return the first channel of the first record with its fitted response."""
    channel = finding.problem.records[0].channels[0]
    unit, size = file_unit(finding.measured)
    frequency = dominant_frequency(channel.times, channel.values)
    return Response(
        method=finding.method,
        trust=finding.trust,
        measures=channel.measures,
        unit=unit,
        times=channel.times,
        values=channel.values / size,
        frequency=frequency,
        fit=_fitted(finding, size, frequency),
    )


def _fitted(finding: Finding, size: float, frequency: float) -> ChannelResponse | None:
    """Return the fitted response of the first channel with its offset, in units of ``size``."""
    fit, residuals = finding.fit, residuals_of(finding)
    if fit is None or residuals is None:
        return None
    record = fit.model.problem.records[0]
    channel, shown = record.channels[0], finding.problem.records[0].channels[0]
    n = int(np.clip(A_CYCLE * frequency * np.ptp(shown.times), FEWEST, MOST))
    even = replace(channel, times=np.linspace(channel.times[0], channel.times[-1], n), values=np.zeros(n))
    record = replace(record, channels=(even, *record.channels[1:]))
    problem = replace(fit.model.problem, records=(record, *fit.model.problem.records[1:]))
    with np.errstate(all="ignore"):
        curve = finding.channel_size / size * compiled_output_error(problem, fit.model.gauge).predict(fit.theta)[:n]
    if np.all(np.isfinite(curve)):
        return ChannelResponse(np.linspace(shown.times[0], shown.times[-1], n), curve, residuals)
    # At the times of the samples the response is finite.
    return ChannelResponse(shown.times, shown.values / size - residuals.values, residuals)


def thinned(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Thin a curve to at most :data:`MOST_DRAWN` points: the smallest and the largest value of each segment."""
    if x.size <= MOST_DRAWN:
        return x, y
    parts = np.array_split(np.arange(x.size), MOST_DRAWN // 2)
    kept = np.unique([part[i] for part in parts for i in (np.argmin(y[part]), np.argmax(y[part]))])
    return x[kept], y[kept]
