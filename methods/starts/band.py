"""The frequency band of an estimate: without a prior, it is valid for frequencies below half the sampling rate.

An estimate with few samples per cycle gets a message with the next frequency that would give the same samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bench import Draws, Estimate, Identifier, Problem, Status
from methods.starts.search_range import first_stiffness, oscillations, resolved_cycles, unevenness

FEW_SAMPLES = 4.0
"""Samples per cycle below which an estimate names its first alias."""


class BandIdentifier(Identifier):
    """Base of methods limited to frequencies below half the sampling rate; they name the first alias."""

    def completed(self, problems: Sequence[Problem], estimates: Sequence[Estimate]) -> list[Estimate]:
        """State the band of estimates with few samples per cycle."""
        return [with_band(problem, estimate) for problem, estimate in zip(problems, estimates, strict=True)]


def with_band(problem: Problem, estimate: Estimate) -> Estimate:
    """State the band and the first alias of an estimate whose highest frequency has few samples per cycle.

    Systems with hidden states have no natural frequency; their estimates are returned unchanged.
    """
    if estimate.status is not Status.OK or estimate.distribution is None or problem.system.n_hidden:
        return estimate
    frequencies = natural_frequencies(problem, estimate)
    rate = 2.0 * max(resolved_cycles(record) for record in problem.records)
    if not frequencies or rate >= FEW_SAMPLES * frequencies[-1]:
        return estimate
    frequency = frequencies[-1]
    alias = rate - frequency if frequency < rate else rate * np.ceil(frequency / rate) - frequency
    sentence = (
        f"valid for frequencies below {rate / 2:.3g} Hz, half the sampling rate: at {rate / frequency:.2g} "
        f"samples per cycle, {alias:.3g} Hz would give nearly the same samples as {frequency:.3g} Hz"
    )
    return replace(estimate, message="; ".join(filter(None, [estimate.message, sentence])))


def are_even(problem: Problem) -> bool:
    """Return True where every channel is evenly sampled."""
    channels = [channel for record in problem.records for channel in record.channels if channel.n]
    return all(unevenness(channel.times) is None for channel in channels)


def natural_frequencies(problem: Problem, estimate: Estimate) -> list[float]:
    """Return natural frequencies (Hz), lowest first; a nonlinear system has that of its first stiffness."""
    system, values = problem.system, values_of(estimate)
    if not all(np.isfinite(value) for value in values.values()):
        return []
    if system.linear and system.n_dof > 1:
        rates = oscillations(system, values)
    else:
        rates = np.sqrt([max(values[first_stiffness(system)] / values[system.gauge], 0.0)])
    return [float(rate / (2 * np.pi)) for rate in rates if rate > 0]


def values_of(estimate: Estimate) -> dict[str, float]:
    """Return the estimated parameters; from groups, those with a gauge mass of 1; NaN where there are none."""
    system = estimate.system
    if isinstance(estimate.parameters, Draws):  # a median over several basins may lie in none of them; a draw does not
        draws = dict(zip(estimate.parameters.names, estimate.parameters.samples.T, strict=True))
        order = np.argsort(draws[first_stiffness(system)] / draws[system.gauge], kind="stable")
        return {name: float(samples[order[order.size // 2]]) for name, samples in draws.items()}
    if estimate.parameters is not None:
        return {name: float(value) for name, value in estimate.parameters.values().items()}
    values = dict.fromkeys(system.names, 1.0)
    for name, value in (estimate.groups.values() if estimate.groups is not None else {}).items():
        numerator = next(n for n, power in system.quantity(name).exponents.items() if power > 0)
        values[numerator] = float(value)
    return values
