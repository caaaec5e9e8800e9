"""How far a search for a frequency looks: to half the sampling rate, and beyond as far as the prior expects the motion.

Evenly spaced samples do not tell a frequency from its alias in half the sampling rate, so beyond it nothing is looked
for that the prior does not expect; what it expects is looked for however far beyond, since the prior decides between
aliases. One rule for all methods that scan.
"""

from __future__ import annotations

import numpy as np

from bench import LOG_LIMIT, Problem, Record

UP = 3.0
"""Standard deviations of the prior up to which a motion is expected."""
FEW = 0.1
"""Spacing of the samples of a record without two in a channel, in natural units."""


def resolved_cycles(record: Record) -> float:
    """Half the sampling rate of the densest channel, in cycles per unit of time."""
    gaps = [float(np.median(np.diff(c.times))) for c in record.channels if c.n > 1]
    return 0.5 / min(gaps, default=FEW)


def expected_rate(problem: Problem) -> tuple[float, float] | None:
    """Logarithm of the rate (rad per unit of time) that the prior expects, and its standard deviation.

    That of the first stiffness on the gauge mass; None without a prior.
    """
    if problem.prior is None:
        return None
    system, prior = problem.system, problem.prior
    stiffness = next((p.name for p in system.parameters if p.kind == "stiffness"), system.gauge)
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
    centre, sd = expected
    highest = float(np.ceil(np.exp(min(centre + UP * sd, LOG_LIMIT)) / (2 * np.pi)))
    return min(max(resolved, highest), limit)


def is_unresolved(problem: Problem) -> bool:
    """Decide whether the prior expects motion beyond half the sampling rate, in natural units."""
    resolved = max(resolved_cycles(record) for record in problem.records)
    return problem.prior is not None and most_cycles(problem) > resolved * (1.0 + 1e-9)
