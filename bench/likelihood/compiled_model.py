"""The likelihood of output error with compiled steps, for a nonlinear system whose response is asked for many times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.contract.problem import InitialState, Problem, Record
from bench.dynamics.intervals import Steps, merged_grid, sample_times, step_counts
from bench.dynamics.rates import longest_step
from bench.dynamics.simulate import MAX_STEPS, SimulatedMotion
from bench.dynamics.stepper import compiled_path
from bench.likelihood.output_error import InitialValues, OutputError


def compiled_output_error(problem: Problem, gauge: float = 1.0) -> OutputError:
    """The likelihood of a problem, by compiled steps where its system is not linear."""
    return (OutputError if problem.system.linear else CompiledOutputError)(problem, gauge)


@dataclass(frozen=True, eq=False)
class CompiledOutputError(OutputError):
    """The same by the steps of order four that :func:`bench.simulate` takes for many sets, for one set too."""

    def readings(self, p: dict[str, np.ndarray], start: InitialValues, record: Record) -> np.ndarray:
        """What the sensors would show, shape (..., n), without offsets; not finite where the response diverges."""
        rig, n = record.rig(self.system), self.system.n_dof
        x, v = (start.displacement, start.velocity) if isinstance(start, InitialState) else start
        sets = np.broadcast_shapes(*(np.shape(value) for value in p.values()), np.shape(x)[1:])
        state = [np.broadcast_to(part[i], sets or (1,)) for part in (x, v) for i in range(n)]
        state += [np.zeros(sets or (1,)) for _ in range(rig.n_hidden)]
        times, _ = sample_times(record)
        grid = merged_grid(times, record.forces)
        with np.errstate(all="ignore"):
            counts = step_counts(grid, longest_step(rig, p, state))
            if counts.sum() > MAX_STEPS:
                path = np.full((len(state), *(sets or (1,)), times.size), np.nan)
            else:
                steps = Steps.over(grid, counts, record.forces, n)
                path = compiled_path(rig, p, state, steps, np.searchsorted(grid, times), coarse=True)
            path = path.reshape(len(state), *sets, times.size)
            return SimulatedMotion(path[:n], path[n : 2 * n], path[2 * n :]).readings(rig, p, record)
