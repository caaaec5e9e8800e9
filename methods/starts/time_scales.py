"""Starts of a nonlinear system of one degree of freedom that the sampling does not resolve, as the prior expects it.

No derivative can be taken of such samples, so no regression of the equation of motion gives a start. The prior's
nominal motion, run faster or slower, passes through the same curve in another time: of all such speeds within the
prior's reach, those are starts at which the response fits best.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bench import OutputError, System
from methods.starts.reach import UP, expected_rate

MOST_SPEEDS = 120
"""Speeds that are tried, at most."""
START_STEPS = 5
"""Gauss-Newton steps of the initial state that fits best at a speed."""
RADIANS_APART = 1.5
"""Phase at the end of the record by which two speeds differ: half of the half-cycle between two minima."""


def sped_up(system: System, p: Mapping[str, float], factor: float) -> dict[str, float]:
    """Parameters of the same curve in another time; damping, which is known least, stays as it is."""
    return {q.name: p[q.name] * (1.0 if q.kind == "damping" else factor**-q.dimension.time) for q in system.parameters}


def best_speeds(model: OutputError, n: int) -> list[dict[str, float]]:
    """The ``n`` best separate minima of the misfit over the speed of the nominal motion, in natural units."""
    problem, expected = model.problem, expected_rate(model.problem)
    assert problem.prior is not None
    assert expected is not None
    centre, sd = expected
    phase = np.exp(centre + UP * sd) * max(record.duration for record in problem.records)
    count = int(np.clip(2 * UP * sd * phase / RADIANS_APART, 8, MOST_SPEEDS))
    factors = np.exp(np.linspace(-UP * sd, UP * sd, count))
    starts = [sped_up(problem.system, problem.prior.nominal, factor) for factor in factors]
    thetas = np.zeros((count, model.size))
    thetas[:, : len(model.free)] = np.log([[p[name] for name in model.free] for p in starts])
    profiles = model.profile(model.with_initial_states(thetas, START_STEPS))
    padded = np.concatenate([[np.inf], np.where(np.isfinite(profiles), profiles, np.inf), [np.inf]])
    minima = np.flatnonzero((padded[1:-1] <= padded[:-2]) & (padded[1:-1] < padded[2:]))
    return [starts[i] for i in minima[np.argsort(padded[1:-1][minima])][:n]]
