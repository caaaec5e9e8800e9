"""Errors expected from a longer, denser or less noisy record.

The covariance of a fit to the changed record follows from its derivatives at the present estimate (Fisher information,
R. A. Fisher, Proc. Camb. Phil. Soc. 22:700, 1925; with coloured noise as in ``linearised_fit``). Of a denser
record, coloured noise has the same autocovariance, interpolated between lags; white noise has the same variance per
sample.
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
"""Extension of a record (s)."""
ALIKE = 100.0
"""If the duration differs from ``LONGER_S`` by more than this factor, the record is doubled instead."""


@dataclass(frozen=True)
class WhatIf:
    """Change of a record and its effect.

    Attributes:
        change: Description of the change.
        relative_errors: Expected standard errors over the values, by quantity.
        today: Present standard errors over the values.
    """

    change: str
    relative_errors: Mapping[str, float]
    today: Mapping[str, float]


class Interpolated(Autoregression):
    """Noise of an autoregression at twice the sampling rate; white noise remains white.

    Its autocovariance is interpolated linearly between lags, so the spectrum is that of the autoregression, repeated
    above its Nyquist frequency, times ``1 + cos w``.
    """

    def spectrum(self, n: int) -> np.ndarray:
        """Return the variance at the n // 2 + 1 frequencies of a transform of length n, a multiple of 4."""
        if self.order == 0:
            return super().spectrum(n)
        lower = super().spectrum(n // 2)
        frequencies = 2.0 * np.pi * np.arange(n // 2 + 1) / n
        return np.asarray(np.concatenate([lower, lower[-2::-1]]) * (1.0 + np.cos(frequencies)))


def what_if(finding: Finding) -> tuple[WhatIf, ...]:
    """Predict the errors of three changed records; empty without a fit, or if the fit is singular.

    A longer record continues at the same sampling rate, and its force is repeated. At uneven times, errors are those
    for white noise times the present ratio of coloured to white. Errors of the model and differences between parts are
    not included, as more data do not reduce them.
    """
    fit = finding.fit
    if fit is None or fit.coloured is None:
        return ()
    problem, noises = fit.model.problem, [noise or Autoregression(np.zeros(0), np.nan) for noise in fit.noises]
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
    errors = {change: _errors(finding, fit, changed, factor, noise) for change, changed, factor, noise in changes}
    today = errors.pop("")
    return tuple(WhatIf(change, changed, today) for change, changed in errors.items())


def _errors(
    finding: Finding, fit: LinearisedFit, problem: Problem, factor: float, noises: list[Autoregression]
) -> dict[str, float]:
    """Return the standard errors of the logarithms of the determined quantities, for noise scaled by ``factor``."""
    model = replace(fit.model, problem=problem)
    _, slopes = model.jacobian(fit.theta)
    n = model.data.size
    residuals = factor * fit.sigma[model.channel_of] * np.sqrt(max(1.0 - fit.used / n, 1.0 / n))  # sets the noise level
    changed = LinearisedFit(model, fit.theta, residuals, slopes, tuple(noises))
    if changed.white is None or fit.white is None or fit.coloured is None:
        return {}
    uneven = any(noise is None for noise in fit.noises)
    covariance = changed.white if uneven or changed.coloured is None else changed.coloured
    errors = {}
    for quantity in determined_quantities(finding.problem):
        g = fit.gradient(quantity)
        more = (g @ fit.coloured @ g) / (g @ fit.white @ g) if uneven and np.any(g) else 1.0
        error = float(np.sqrt(more * (g @ covariance @ g)))
        if error > 0 and np.isfinite(error):
            errors[quantity.name] = error
    return errors


def _changed(problem: Problem, change: Callable[[Record], Record]) -> Problem:
    return replace(problem, records=tuple(change(record) for record in problem.records))


def _longer(record: Record, extra: float) -> Record:
    """Extend a record by a time at the same sampling rate, and repeat its forces."""
    channels = []
    for channel in record.channels:
        step = float(np.ptp(channel.times)) / max(channel.n - 1, 1)
        steps = np.arange(1, round(extra / step) + 1) if step > 0 else np.zeros(0)
        channels.append(_sampled(channel, np.append(channel.times, channel.times[-1:] + step * steps)))
    forces = tuple(_repeated(force, record.duration + extra) for force in record.forces)
    return replace(record, channels=tuple(channels), forces=forces)


def _denser(record: Record) -> Record:
    """Add a sample between any two."""
    middles = [(channel.times[1:] + channel.times[:-1]) / 2.0 for channel in record.channels]
    channels = [
        _sampled(channel, np.sort(np.append(channel.times, middle)))
        for channel, middle in zip(record.channels, middles, strict=True)
    ]
    return replace(record, channels=tuple(channels))


def _sampled(channel: Channel, times: np.ndarray) -> Channel:
    """Return the channel at other times; the values do not affect derivatives."""
    return replace(channel, times=times, values=np.interp(times, channel.times, channel.values))


def _repeated(force: Force, end: float) -> Force:
    """Repeat a force until a time, with one mean step between the last sample and the first."""
    n, span = force.times.size, float(np.ptp(force.times))
    period = span * n / (n - 1)
    repeats = max(int(np.ceil((end - force.times[0]) / period)), 1)
    times = np.concatenate([force.times + i * period for i in range(repeats)])
    return replace(force, times=times, values=np.tile(force.values, repeats))
