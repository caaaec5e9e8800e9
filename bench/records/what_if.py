"""What more, denser or quieter data would make of the errors of a record's answer, before anybody measures them.

The covariance of the fit of a changed record follows from its derivatives at today's answer (Fisher information, R. A.
Fisher, Proc. Camb. Phil. Soc. 22:700, 1925; with coloured noise the sandwich of :mod:`bench.records.linearised`). The
noise is taken to stay as it is, its colour too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.contract.problem import Channel, Force, Problem, Record
from bench.likelihood.output_error import OutputError
from bench.records.finding import Finding
from bench.records.linearised import Linearised
from bench.records.replicas import determined_quantities

LONGER_S = 10.0
ALIKE = 100.0
"""A record longer or shorter than ``LONGER_S`` by more than this is taken as long again instead."""

Covariances = Sequence[np.ndarray | None]
"""Of each channel's noise at lags 0 to n - 1; None where it is not told."""


@dataclass(frozen=True)
class WhatIf:
    """A change of the record, and the standard errors over the value that it would give, by quantity.

    ``today``: the same of the record as it is.
    """

    change: str
    relative_errors: Mapping[str, float]
    today: Mapping[str, float]


def what_if(finding: Finding) -> tuple[WhatIf, ...]:
    """Predict the errors of three changed records; none where the finding has no fit, or the data leave it open.

    A longer record goes on at the same rate; a force is repeated from its first sample, which the change then says. At
    even times the noise keeps its colour: the autocovariance of its autoregression, between two lags on the straight
    line (which is a covariance too: its spectrum is that of the lags times a square). At uneven times, errors are those
    of white noise times what they are more today. What parts of the record differ by, or the model lacks, is left out
    of both: no more data help there.
    """
    at = finding.fit
    if at is None or at.coloured is None:
        return ()
    problem, sigma = at.model.problem, at.sigma
    lags = [None if noise is None else noise.autocovariance for noise in at.noises]
    now = [None if of is None else of(own.size) for of, own in zip(lags, at.channels, strict=True)]
    today = _errors(at, finding.problem, at.slopes, at.model, sigma, now)
    unit = finding.problem.natural_units().time
    duration = unit * max(record.duration for record in problem.records)
    extra = LONGER_S if duration / ALIKE < LONGER_S < duration * ALIKE else duration
    said = f"another {extra:.3g} s" + (", with the force repeated" if problem.forced else "")
    longer, denser = _changed(problem, lambda r: _longer(r, extra / unit)), _changed(problem, _denser)
    sizes = [c.n for record in longer.records for c in record.channels]
    cases = [
        (said, longer, sigma, [None if of is None else of(n) for of, n in zip(lags, sizes, strict=True)]),
        ("twice the sampling rate", denser, sigma, [None if c is None else _between(c) for c in now]),
        ("half the noise", problem, sigma / 2.0, [None if c is None else c / 4.0 for c in now]),
    ]
    found = []
    for change, own, noise, covariances in cases:
        model = replace(at.model, problem=own)
        _, slopes = model.jacobian(at.theta)
        found.append(WhatIf(change, _errors(at, finding.problem, slopes, model, noise, covariances), today))
    return tuple(found)


def _errors(
    at: Linearised, given: Problem, slopes: np.ndarray, model: OutputError, sigma: np.ndarray, covariances: Covariances
) -> dict[str, float]:
    """Standard deviations of the logarithms of what is told."""
    white = model.covariance(slopes, sigma)
    if white is None or at.white is None or at.coloured is None:
        return {}
    known = [c for c in covariances if c is not None]
    coloured = _sandwich(white, slopes, model, sigma, known) if len(known) == len(covariances) else None
    found = {}
    for quantity in determined_quantities(given):
        g = at.gradient(quantity)
        if coloured is not None:
            found[quantity.name] = float(np.sqrt(g @ coloured @ g))
        elif np.any(g):
            found[quantity.name] = float(np.sqrt(g @ white @ g * (g @ at.coloured @ g) / (g @ at.white @ g)))
    return {name: error for name, error in found.items() if error > 0 and np.isfinite(error)}


def _sandwich(
    white: np.ndarray, slopes: np.ndarray, model: OutputError, sigma: np.ndarray, covariances: Sequence[np.ndarray]
) -> np.ndarray:
    middle = np.zeros_like(white)
    if model.prior is not None:
        k = len(model.free)
        middle[:k, :k] = np.diag(model.prior.log_sds**-2.0)
    for i, covariance in enumerate(covariances):
        own = slopes[model.channel_of == i]
        middle += own.T @ _correlated(covariance, own) / sigma[i] ** 4
    return np.asarray(white @ middle @ white)


def _correlated(covariance: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Multiply slopes (n, size) by the Toeplitz matrix of a covariance (n,), as a part of a circulant one."""
    n = covariance.size
    length = 1 << (2 * n - 1).bit_length()
    circle = np.zeros(length)
    circle[:n], circle[length - n + 1 :] = covariance, covariance[:0:-1]
    product = np.fft.rfft(circle)[:, None] * np.fft.rfft(slopes, length, axis=0)
    return np.asarray(np.fft.irfft(product, length, axis=0)[:n])


def _changed(problem: Problem, change: Callable[[Record], Record]) -> Problem:
    return replace(problem, records=tuple(change(record) for record in problem.records))


def _longer(record: Record, extra: float) -> Record:
    """The record and as much again of its sampling, with each force repeated until then."""
    end = record.duration + extra
    channels = tuple(_sampled(c, np.append(c.times, _steps_on(c.times, extra))) for c in record.channels)
    return replace(record, channels=channels, forces=tuple(_repeated(force, end) for force in record.forces))


def _steps_on(times: np.ndarray, extra: float) -> np.ndarray:
    step = float(times[-1] - times[0]) / max(times.size - 1, 1)
    return np.asarray(times[-1] + step * np.arange(1, round(extra / step) + 1)) if step > 0 else np.zeros(0)


def _denser(record: Record) -> Record:
    """A sample more between any two."""
    channels = []
    for channel in record.channels:
        middles = (channel.times[1:] + channel.times[:-1]) / 2.0
        channels.append(_sampled(channel, np.sort(np.append(channel.times, middles))))
    return replace(record, channels=tuple(channels))


def _sampled(channel: Channel, times: np.ndarray) -> Channel:
    """The channel at other times; its values, which no derivative needs, are those nearest before."""
    before = np.clip(np.searchsorted(channel.times, times, side="right") - 1, 0, channel.n - 1)
    return replace(channel, times=times, values=channel.values[before])


def _repeated(force: Force, end: float) -> Force:
    """The force again and again until a time, one mean step between its last sample and its first."""
    n, span = force.times.size, float(force.times[-1] - force.times[0])
    period = span * n / (n - 1)
    again = max(int(np.ceil((end - force.times[0]) / period)), 1)
    times = np.concatenate([force.times + i * period for i in range(again)])
    return replace(force, times=times, values=np.tile(force.values, again))


def _between(covariance: np.ndarray) -> np.ndarray:
    """Covariance at lags of half a sample, up to 2 n - 2 of them; white noise stays white."""
    if not np.any(np.abs(covariance[1:]) > 1e-9 * covariance[0]):
        return np.append(covariance[0], np.zeros(2 * covariance.size - 2))
    lags = np.arange(2 * covariance.size - 1) / 2.0
    return np.interp(lags, np.arange(covariance.size), covariance)
