"""What a picture of a fit shows: the samples of a record's first channel, and the fitted response between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.likelihood.compiled import compiled_output_error
from bench.records.diagnostics import part_of_signal
from bench.records.finding import Finding
from bench.records.linearised import Linearised
from bench.records.strongest import strongest_frequency
from bench.records.verdict import Trust

A_CYCLE, FEWEST, MOST = 32, 1000, 20_000
"""Points of the fitted response in a cycle, and on the whole curve at least and at most."""
BEST_FIRST = (Trust.TRUST, Trust.CAUTION, Trust.NO)


@dataclass(frozen=True, eq=False)
class ChannelResponse:
    """The fitted response of a channel, in its unit.

    Attributes:
        times: Of the curve (s), from the first sample to the last, close enough to show each cycle.
        values: The curve.
        residuals: Measured minus fitted, of each sample.
        part: Root mean square of the residuals over that of the signal.
    """

    times: np.ndarray
    values: np.ndarray
    residuals: np.ndarray
    part: float

    @property
    def rms(self) -> float:
        """Root mean square of the residuals."""
        return float(np.sqrt(np.mean(self.residuals**2)))


@dataclass(frozen=True, eq=False)
class Response:
    """A record's first channel with a method's fit, if it found one.

    Attributes:
        method: What the method is called.
        trust: How far its answer is to be trusted.
        measures: What the channel measures.
        unit: In which unit.
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


def response_of(finding: Finding) -> Response:
    """The first channel of the first record, and what the finding makes of it."""
    channel = finding.problem.records[0].channels[0]
    frequency = strongest_frequency(channel.times, channel.values)
    return Response(
        method=finding.method,
        trust=finding.trust,
        measures=channel.measures,
        unit=channel.unit,
        times=channel.times,
        values=channel.values,
        frequency=frequency,
        fit=None if finding.fit is None else _fit(finding, finding.fit, frequency),
    )


def _fit(finding: Finding, at: Linearised, frequency: float) -> ChannelResponse:
    channel, size = finding.problem.records[0].channels[0], finding.channel_size
    residuals = size * at.residuals[at.channels[0]]
    n = int(np.clip(A_CYCLE * frequency * np.ptp(channel.times), FEWEST, MOST))
    curve = size * _between(at, n)
    times = np.linspace(channel.times[0], channel.times[-1], n)
    if not np.all(np.isfinite(curve)):  # the samples' own times are known to have a response
        times, curve = channel.times, channel.values - residuals
    return ChannelResponse(times, curve, residuals, part_of_signal(at))


def _between(at: Linearised, n: int) -> np.ndarray:
    """The predictions of the first channel, with its offset, at ``n`` even times from its first sample to its last."""
    first = at.model.problem.records[0]
    mine = first.channels[0]
    even = replace(mine, times=np.linspace(mine.times[0], mine.times[-1], n), values=np.zeros(n))
    record = replace(first, channels=(even, *first.channels[1:]))
    problem = replace(at.model.problem, records=(record, *at.model.problem.records[1:]))
    with np.errstate(all="ignore"):
        return compiled_output_error(problem, at.model.gauge).predict(at.theta)[:n]
