"""How far a search for a frequency looks: to half the sampling rate, and beyond as far as the prior expects the motion.

Evenly spaced samples do not tell a frequency from its alias in half the sampling rate, so beyond it nothing is looked
for that the prior does not expect; what it expects is looked for however far beyond, since the prior decides between
aliases. One rule for all methods that scan.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bench import LOG_LIMIT, Problem, Record, System, state_matrix

UP = 3.0
"""Standard deviations of the prior up to which a motion is expected."""
MOST_MODES = 3
"""Degrees of freedom up to which modes that the sampling does not resolve are looked for, in draws from the prior."""
FEW = 0.1
"""Spacing of the samples of a record without two in a channel, in natural units."""
EVEN = 1e-3
"""Even times may be off by this part of a step: what rounding of printed times does."""


def unevenness(times: np.ndarray) -> str | None:
    """Say why times (n,) are not at even steps; None where they are."""
    even = np.linspace(times[0], times[-1], times.size)
    if times.size > 1 and np.max(np.abs(times - even)) > EVEN * (even[1] - even[0]):
        return "it needs samples at even steps of time; resample them"
    return None


def resolved_cycles(record: Record) -> float:
    """Half the sampling rate of the densest channel, in cycles per unit of time."""
    gaps = [_median(np.diff(c.times)) for c in record.channels if c.n > 1]
    return 0.5 / min(gaps, default=FEW)


def _median(values: np.ndarray) -> float:
    """The median of values without NaN, several times faster than numpy's for a few."""
    ordered = np.sort(values)
    return float(0.5 * (ordered[(values.size - 1) // 2] + ordered[values.size // 2]))


def first_stiffness(system: System) -> str:
    """Name the first stiffness; the gauge mass where there is none."""
    return next((p.name for p in system.parameters if p.kind == "stiffness"), system.gauge)


def expected_rate(problem: Problem) -> tuple[float, float] | None:
    """Logarithm of the rate (rad per unit of time) that the prior expects, and its standard deviation.

    That of the first stiffness on the gauge mass; None without a prior.
    """
    if problem.prior is None:
        return None
    system, prior = problem.system, problem.prior
    stiffness = first_stiffness(system)
    centre = 0.5 * np.log(prior.nominal[stiffness] / prior.nominal[system.gauge])
    return float(centre), float(0.5 * np.hypot(prior.log_sd[stiffness], prior.log_sd[system.gauge]))


def most_cycles(problem: Problem, limit: float = np.inf) -> float:
    """Highest frequency worth looking at, in cycles per unit of time, at most ``limit``.

    What the prior expects is rounded up to whole cycles, so that records with priors much alike share a grid.
    """
    resolved = max(resolved_cycles(record) for record in problem.records)
    expected = expected_rate(problem)
    if expected is None:
        return min(resolved, limit)
    return min(max(resolved, _highest_cycles(*expected)), limit)


def is_unresolved(problem: Problem) -> bool:
    """Decide whether the prior expects motion beyond half the sampling rate, of any of a few modes; in any units."""
    expected = expected_rate(problem)
    if expected is None:
        return False
    time = max(record.duration for record in problem.records)
    highest = _highest_cycles(_fastest_rate(problem, expected[0]) + float(np.log(time)), expected[1])
    return highest > time * max(resolved_cycles(record) for record in problem.records) * (1.0 + 1e-9)


def _fastest_rate(problem: Problem, rate: float) -> float:
    """Return the logarithm of the rate of the fastest mode at the prior's nominal values; of others ``rate``."""
    assert problem.prior is not None
    if not 1 < problem.system.n_dof <= MOST_MODES or not problem.system.linear:
        return rate
    return float(np.log(max(oscillations(problem.system, problem.prior.nominal)[-1], np.exp(rate))))


def oscillations(system: System, values: Mapping[str, float]) -> np.ndarray:
    """Return the rates (n_dof,) of the modes of a linear system in rad per unit of time, lowest first.

    A mode that does not oscillate has the rate 0.
    """
    matrix = state_matrix(system, {name: np.asarray(value) for name, value in values.items()})[0]
    eigenvalues = np.linalg.eigvals(matrix)
    return np.sort(np.where(eigenvalues.imag > 0, np.abs(eigenvalues), 0.0))[system.n_dof :]


def _highest_cycles(centre: float, sd: float) -> float:
    """What a prior on the logarithm of the rate expects, rounded up to whole cycles."""
    return float(np.ceil(np.exp(min(centre + UP * sd, LOG_LIMIT)) / (2 * np.pi)))
