"""Motions of nonlinear systems by Runge-Kutta steps that jax compiles: a sampler asks for them again and again.

What is compiled depends on the system, the number of sets and the number of steps. Both numbers are rounded up, so few
programmes serve many calls.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from bench import OutputError, Record, Start, Steps, System, rk4_path, rk4_scan
from methods.starts.candidates import Stepped
from methods.starts.rough import rough_readings

PARTS_OF_OCTAVE = 2
"""Powers of two: a number of steps is rounded up to a fourth of the next lower power of two."""
MOST_STATES = 10_000_000
"""Numbers in the states after all steps, which are all kept; numpy keeps those that are wanted."""
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


def compiled_path(
    system: System, p: Mapping[str, Any], state: Sequence[np.ndarray], steps: Steps, wanted: np.ndarray
) -> np.ndarray:
    """Carry a state along the steps; arguments and result are those of :func:`bench.rk4_path`."""
    sets = state[0].shape
    many = int(np.prod(sets))
    if not many or not steps.lengths.size or len(state) * many * steps.lengths.size > MOST_STATES:
        return rk4_path(system, p, state, steps, wanted)
    repeated = np.minimum(np.arange(1 << (many - 1).bit_length()), many - 1)
    values = np.stack([np.broadcast_to(np.asarray(p[name], float), sets).ravel()[repeated] for name in system.names])
    path = np.asarray(_carried(system)(values, np.stack([s.ravel() for s in state])[:, repeated], *_padded(steps)))
    picked = path[steps.reached[wanted], :, :many]
    return np.moveaxis(picked, 0, -1).reshape(len(state), *sets, wanted.size)


def compiled(model: OutputError) -> OutputError:
    """The same model, integrated as finely, by compiled steps where the system is not linear."""
    if model.system.linear:
        return model
    return Compiled(model.problem, radians=model.radians if isinstance(model, Stepped) else RADIANS)


@lru_cache(maxsize=64)
def _carried(system: System) -> Any:
    """(parameters, states, lengths, forces) -> the states before the first step and after each."""
    import jax

    jax.config.update("jax_enable_x64", True)

    def path(values: Any, start: Any, lengths: Any, pushes: Any) -> Any:
        return rk4_scan(system, dict(zip(system.names, values, strict=True)), start, lengths, pushes)

    return jax.jit(path)


def _padded(steps: Steps) -> tuple[np.ndarray, np.ndarray]:
    """Lengths (n,) and forces (n, 3, n_dof) with steps of no length at the end, which move nothing."""
    used = steps.lengths.size
    part = 2 ** max(used.bit_length() - 1 - PARTS_OF_OCTAVE, 0)
    more = -(-used // part) * part - used
    return np.pad(steps.lengths, (0, more)), np.pad(steps.forces, ((0, more), (0, 0), (0, 0)))
