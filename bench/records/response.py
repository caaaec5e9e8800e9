"""What is shown of a record's first channel, in the unit of its file: samples, fitted response, and residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.likelihood.compiled import compiled_output_error
from bench.records.diagnostics import lag_one, part_of_signal, whiteness_level
from bench.records.dominant_frequency import dominant_frequency
from bench.records.finding import Finding
from bench.records.problem import Measured
from bench.records.verdict import Trust

A_CYCLE, FEWEST, MOST = 32, 1000, 20_000
"""Points of the fitted response in a cycle, and on the whole curve at least and at most."""
MOST_DRAWN = 800
"""Points of a curve that are drawn at most."""
BEST_FIRST = (Trust.TRUST, Trust.CAUTION, Trust.NO)


@dataclass(frozen=True, eq=False)
class ChannelResiduals:
    """Measured minus identified motion of the first channel in ``unit``: all ``values`` and what they amount to.

    ``whiteness``: the p-value of the test that they are white noise.
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
    """The fitted response of a channel, in its unit.

    Attributes:
        times: Of the curve (s), from the first sample to the last, close enough to show each cycle.
        values: The curve.
        residuals: Measured minus fitted, of each sample.
    """

    times: np.ndarray
    values: np.ndarray
    residuals: ChannelResiduals


@dataclass(frozen=True, eq=False)
class Response:
    """A record's first channel with a method's fit, if it found one.

    Attributes:
        method: What the method is called.
        trust: How far its answer is to be trusted.
        measures: What the channel measures.
        unit: In which unit, that of its file.
        times: Of the samples (s).
        values: The samples.
        frequency: The strongest in the samples (Hz).
        fit: None where there is no answer.
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
    """The finding to be trusted most; of several, that which leaves least of the signal."""
    return min(findings, key=lambda one: (BEST_FIRST.index(one.trust), _left(one)))


def _left(finding: Finding) -> float:
    return np.inf if finding.fit is None else part_of_signal(finding.fit)


def file_unit(measured: Measured) -> tuple[str, float]:
    """Return the unit that the file of the first channel gives it, and how much one of it is in the problem's unit."""
    signals = [signal for recording in measured.recordings[:1] for signal in recording.signals]
    motion = next((signal for signal in signals if signal.measures != "force" and signal.written), None)
    return (motion.written, motion.size) if motion else (measured.unit, 1.0)


def residuals_of(finding: Finding) -> ChannelResiduals | None:
    """Return the residuals of the first channel; None where there is no fit."""
    fit = finding.fit
    if fit is None:
        return None
    unit, size = file_unit(finding.measured)
    values = finding.channel_size / size * fit.residuals[fit.channels[0]]
    return ChannelResiduals(
        values=values,
        rms=float(np.sqrt(np.mean(values**2))),
        part_of_signal=part_of_signal(fit),
        lag1_autocorrelation=lag_one(fit),
        whiteness=whiteness_level(fit),
        offset=finding.channel_size / size * float(fit.model.offsets(fit.theta)[0]),
        unit=unit,
    )


def response_of(finding: Finding) -> Response:
    """Return the first channel of the first record, and what the finding makes of it."""
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
    """Return the response of the first channel, with its offset, over units of ``size``."""
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
    # the samples' own times are known to have a response
    return ChannelResponse(shown.times, shown.values / size - residuals.values, residuals)


def thinned(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return at most :data:`MOST_DRAWN` points of a curve: the smallest and largest of every stretch, in order."""
    if x.size <= MOST_DRAWN:
        return x, y
    parts = np.array_split(np.arange(x.size), MOST_DRAWN // 2)
    kept = np.unique([part[i] for part in parts for i in (np.argmin(y[part]), np.argmax(y[part]))])
    return x[kept], y[kept]
