"""What more, denser or quieter data would make of the errors of a record's answer, before anybody measures them.

The covariance of the fit of a changed record follows from its derivatives at today's answer (Fisher information, R. A.
Fisher, Proc. Camb. Phil. Soc. 22:700, 1925; with coloured noise as in ``linearised_fit``). The noise is
taken to stay as it is, its colour too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from bench.contract.problem import Channel, Force, Problem, Record
from bench.likelihood.autoregression import Autoregression
from bench.records.finding import Finding
from bench.records.linearised_fit import LinearisedFit
from bench.records.replicas import determined_quantities

LONGER_S = 10.0
ALIKE = 100.0
"""A record longer or shorter than ``LONGER_S`` by more than this is taken as long again instead."""


@dataclass(frozen=True)
class WhatIf:
    """A change of the record, and the standard errors over the value that it would give, by quantity.

    ``today``: the same of the record as it is.
    """

    change: str
    relative_errors: Mapping[str, float]
    today: Mapping[str, float]


class Interpolated(Autoregression):
    """The noise of an autoregression with a sample more between any two; white noise stays white.

    Its autocovariance lies on the straight line between two lags, so that its spectrum is that of the old samples, the
    upper half mirrored from the lower, times ``1 + cos w``.
    """

    def spectrum(self, n: int) -> np.ndarray:
        """Variance by frequency at the n // 2 + 1 frequencies of a transform of length n, a multiple of 4."""
        if self.order == 0:
            return super().spectrum(n)
        lower = super().spectrum(n // 2)
        frequencies = 2.0 * np.pi * np.arange(n // 2 + 1) / n
        return np.asarray(np.concatenate([lower, lower[-2::-1]]) * (1.0 + np.cos(frequencies)))


def what_if(finding: Finding) -> tuple[WhatIf, ...]:
    """Predict the errors of three changed records; none where the finding has no fit, or the data leave it open.

    A longer record goes on at the same rate; a force is repeated from its first sample, which the change then says. At
    uneven times, errors are those of white noise times what they are more today. What parts of the record differ by, or
    the model lacks, is left out: no more data help there.
    """
    at = finding.fit
    if at is None or at.coloured is None:
        return ()
    problem, noises = at.model.problem, [noise or Autoregression(np.zeros(0), np.nan) for noise in at.noises]
    unit = finding.problem.natural_units().time
    duration = unit * max(record.duration for record in problem.records)
    extra = LONGER_S if duration / ALIKE < LONGER_S < duration * ALIKE else duration
    longer = f"another {extra:.3g} s" + (", with the force repeated" if problem.forced else "")
    changes: list[tuple[str, Problem, float, list[Autoregression]]] = [
        ("", problem, 1.0, noises),
        (longer, _changed(problem, lambda record: _longer(record, extra / unit)), 1.0, noises),
        ("twice the sampling rate", _changed(problem, _denser), 1.0,
         [Interpolated(noise.coefficients, noise.variance) for noise in noises]),
        ("half the noise", problem, 0.5, [replace(noise, variance=noise.variance / 4.0) for noise in noises]),
    ]  # fmt: skip
    errors = {change: _errors(finding, at, changed, factor, noise) for change, changed, factor, noise in changes}
    today = errors.pop("")
    return tuple(WhatIf(change, changed, today) for change, changed in errors.items())


def _errors(
    finding: Finding, at: LinearisedFit, problem: Problem, factor: float, noises: list[Autoregression]
) -> dict[str, float]:
    """Return the standard deviations of the logarithms of what is determined, with ``factor`` times the noise."""
    model = replace(at.model, problem=problem)
    _, slopes = model.jacobian(at.theta)
    n = model.data.size
    residuals = factor * at.sigma[model.channel_of] * np.sqrt(max(1.0 - at.used / n, 1.0 / n))  # their size is used
    changed = LinearisedFit(model, at.theta, residuals, slopes, tuple(noises))
    if changed.white is None or at.white is None or at.coloured is None:
        return {}
    uneven = any(noise is None for noise in at.noises)
    covariance = changed.white if uneven or changed.coloured is None else changed.coloured
    errors = {}
    for quantity in determined_quantities(finding.problem):
        g = at.gradient(quantity)
        more = (g @ at.coloured @ g) / (g @ at.white @ g) if uneven and np.any(g) else 1.0
        error = float(np.sqrt(more * (g @ covariance @ g)))
        if error > 0 and np.isfinite(error):
            errors[quantity.name] = error
    return errors


def _changed(problem: Problem, change: Callable[[Record], Record]) -> Problem:
    return replace(problem, records=tuple(change(record) for record in problem.records))


def _longer(record: Record, extra: float) -> Record:
    """Go on with the sampling of a record for a time, with each force repeated until then."""
    channels = []
    for channel in record.channels:
        step = float(np.ptp(channel.times)) / max(channel.n - 1, 1)
        steps = np.arange(1, round(extra / step) + 1) if step > 0 else np.zeros(0)
        channels.append(_sampled(channel, np.append(channel.times, channel.times[-1:] + step * steps)))
    forces = tuple(_repeated(force, record.duration + extra) for force in record.forces)
    return replace(record, channels=tuple(channels), forces=forces)


def _denser(record: Record) -> Record:
    """Put a sample more between any two."""
    middles = [(channel.times[1:] + channel.times[:-1]) / 2.0 for channel in record.channels]
    channels = [
        _sampled(channel, np.sort(np.append(channel.times, middle)))
        for channel, middle in zip(record.channels, middles, strict=True)
    ]
    return replace(record, channels=tuple(channels))


def _sampled(channel: Channel, times: np.ndarray) -> Channel:
    """Return the channel at other times; no derivative needs its values."""
    return replace(channel, times=times, values=np.interp(times, channel.times, channel.values))


def _repeated(force: Force, end: float) -> Force:
    """Repeat the force until a time, one mean step between its last sample and its first."""
    n, span = force.times.size, float(np.ptp(force.times))
    period = span * n / (n - 1)
    repeats = max(int(np.ceil((end - force.times[0]) / period)), 1)
    times = np.concatenate([force.times + i * period for i in range(repeats)])
    return replace(force, times=times, values=np.tile(force.values, repeats))
