"""The range of a frequency search: up to half the sampling rate, and beyond as far as the prior supports.

Evenly spaced samples cannot distinguish a frequency from its aliases about half the sampling rate, so the search
goes beyond it only where the prior, which decides between aliases, supports it. All methods that scan share this rule.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bench import LOG_LIMIT, Problem, Record, System, state_matrix

UP = 3.0
"""Standard deviations of the prior up to which frequencies are searched."""
MOST_MODES = 3
"""Degrees of freedom up to which modes above half the sampling rate are searched, in draws from the prior."""
FEW = 0.1
"""Spacing assumed for a record without two samples in any channel, in natural units."""
EVEN = 1e-3
"""Tolerance of even sampling, in steps; rounding of printed times causes such errors."""


def unevenness(times: np.ndarray) -> str | None:
    """Return a message where times (n,) are not evenly spaced, None where they are."""
    even = np.linspace(times[0], times[-1], times.size)
    if times.size > 1 and np.max(np.abs(times - even)) > EVEN * (even[1] - even[0]):
        return "it needs samples at even steps of time; resample them"
    return None


def resolved_cycles(record: Record) -> float:
    """Return half the sampling rate of the densest channel, in cycles per unit of time."""
    gaps = [_median(np.diff(c.times)) for c in record.channels if c.n > 1]
    return 0.5 / min(gaps, default=FEW)


def _median(values: np.ndarray) -> float:
    """Return the median of values without NaN, several times faster than numpy for short arrays."""
    ordered = np.sort(values)
    return float(0.5 * (ordered[(values.size - 1) // 2] + ordered[values.size // 2]))


def first_stiffness(system: System) -> str:
    """Return the name of the first stiffness, or of the gauge mass where there is none."""
    return next((p.name for p in system.parameters if p.kind == "stiffness"), system.gauge)


def expected_rate(problem: Problem) -> tuple[float, float] | None:
    """Return the prior mean of the log angular frequency of the first stiffness on the gauge mass, and its sd.

    None without a prior.
    """
    if problem.prior is None:
        return None
    system, prior = problem.system, problem.prior
    stiffness = first_stiffness(system)
    centre = 0.5 * np.log(prior.nominal[stiffness] / prior.nominal[system.gauge])
    return float(centre), float(0.5 * np.hypot(prior.log_sd[stiffness], prior.log_sd[system.gauge]))


def most_cycles(problem: Problem, limit: float = np.inf) -> float:
    """Return the highest frequency to search, in cycles per unit of time, at most ``limit``.

    The prior's limit is rounded up to whole cycles, so that records with similar priors share a grid.
    """
    resolved = max(resolved_cycles(record) for record in problem.records)
    expected = expected_rate(problem)
    if expected is None:
        return min(resolved, limit)
    return min(max(resolved, _highest_cycles(*expected)), limit)


def is_unresolved(problem: Problem) -> bool:
    """Return True where the prior supports a mode above half the sampling rate; in any units."""
    expected = expected_rate(problem)
    if expected is None:
        return False
    time = max(record.duration for record in problem.records)
    highest = _highest_cycles(_fastest_rate(problem, expected[0]) + float(np.log(time)), expected[1])
    return highest > time * max(resolved_cycles(record) for record in problem.records) * (1.0 + 1e-9)


def _fastest_rate(problem: Problem, rate: float) -> float:
    """Return the log-frequency of the fastest mode at the prior's nominal values; ``rate`` for one DOF and many."""
    assert problem.prior is not None
    if not 1 < problem.system.n_dof <= MOST_MODES or not problem.system.linear:
        return rate
    return float(np.log(max(oscillations(problem.system, problem.prior.nominal)[-1], np.exp(rate))))


def oscillations(system: System, values: Mapping[str, float]) -> np.ndarray:
    """Return the natural frequencies (n_dof,) of a linear system in rad per unit of time, lowest first.

    A mode that does not oscillate has frequency 0.
    """
    matrix = state_matrix(system, {name: np.asarray(value) for name, value in values.items()})[0]
    eigenvalues = np.linalg.eigvals(matrix)
    return np.sort(np.where(eigenvalues.imag > 0, np.abs(eigenvalues), 0.0))[system.n_dof :]


def _highest_cycles(centre: float, sd: float) -> float:
    """Return the upper limit of a prior on the log-frequency, rounded up to whole cycles."""
    return float(np.ceil(np.exp(min(centre + UP * sd, LOG_LIMIT)) / (2 * np.pi)))
