"""Somebody's method that keeps the contract: area and energy of a free decay, in whatever units."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

import bench


@dataclass(frozen=True)
class Good(bench.Identifier):
    """Equation error on the integrated equation of motion, with the sums of trapezoids."""

    card: ClassVar[bench.Card] = bench.Card(
        summary="integrated equation error",
        start="estimated always",
        scale="groups",
        reconstruction="simulated",
        uncertainty="none",
        settings_source="it has none",
    )
    scope: ClassVar[bench.Scope] = bench.Scope(forced=False, nonlinear=False)

    def estimate(self, problem: bench.Problem, rng: np.random.Generator) -> bench.Estimate:
        channel = problem.records[0].channels[0]
        t, x = channel.times, channel.values
        steps = np.diff(t)
        area = np.concatenate([[0.0], np.cumsum(steps * (x[1:] + x[:-1]) / 2)])
        twice = np.concatenate([[0.0], np.cumsum(steps * (area[1:] + area[:-1]) / 2)])
        # x - x0 - (v0 + c/m x0) t + c/m area + k/m twice = 0
        columns = np.column_stack([np.ones_like(t), t, -area, -twice])
        sizes = np.linalg.norm(columns, axis=0)
        found = np.linalg.lstsq(columns / sizes, x, rcond=None)[0] / sizes
        c, k = found[2:]
        if not (c > 0 and k > 0):
            raise bench.NoEstimate("no damped oscillation is seen; take a longer record")
        groups = bench.Normal(("k_over_m", "c_over_m"), np.array([k, c]), None, log=False)
        return bench.Estimate(problem.system, groups=groups)
