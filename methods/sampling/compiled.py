"""Output error of nonlinear systems by compiled Runge-Kutta steps: a sampler asks for many sets again and again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench import OutputError, Record, Start, compiled_path
from methods.starts.candidates import Stepped
from methods.starts.rough import rough_readings

COMPILED_SETS = 8
"""From so many sets on."""
RADIANS = 0.05
"""Steps in radians of the fastest rate where nothing else is said, as those of :func:`bench.simulate`."""


@dataclass(frozen=True, eq=False)
class Compiled(OutputError):
    """The same, for a nonlinear system, integrated by steps of at most so many radians."""

    radians: float = RADIANS

    def readings(self, p: dict[str, np.ndarray], start: Start, record: Record) -> np.ndarray:
        """As above; not finite where the response diverges."""
        if np.prod(np.broadcast_shapes(*(np.shape(value) for value in p.values()))) < COMPILED_SETS:
            return super().readings(p, start, record)
        return rough_readings(self.system, p, start, record, self.radians, compiled_path)


def compiled(model: OutputError) -> OutputError:
    """The same model, integrated as finely, by compiled steps where the system is not linear."""
    if model.system.linear:
        return model
    return Compiled(model.problem, radians=model.radians if isinstance(model, Stepped) else RADIANS)
