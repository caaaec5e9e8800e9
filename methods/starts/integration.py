"""Responses of nonlinear systems by classical Runge-Kutta steps, as accurate as the noise requires.

Each step of order four has a phase error of ``(w h)^5 / 120`` (``w`` the highest angular frequency, ``h`` the step):
with ``w h = 0.15`` this is four parts per million of the phase, far below the differences between initial guesses.
:func:`radians_a_step` gives the step that a final estimate needs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from bench import InitialState, InitialValues, Record, SimulatedMotion, Steps, System, fastest_rates, rk4_path

RADIANS_A_STEP = 0.15
Carry = Callable[[System, Mapping[str, Any], Sequence[np.ndarray], Steps, np.ndarray], np.ndarray]
"""A function that integrates a state along steps, as :func:`bench.rk4_path` does."""
MOST_STEPS = 64
"""Largest number of steps between two samples; faster motions are no useful guesses."""


def radians_a_step(allowed: float, turned: float) -> float:
    """Return the step ``w h`` (radians) at which a motion of ``turned = w T`` radians has a relative error ``allowed``.

    The phase error is ``(w h)^5 / 120`` per step, hence ``w T (w h)^4 / 120`` over the record.
    """
    return float((120.0 * allowed / max(turned, 1.0)) ** 0.25)


def fastest_rate(system: System, p: dict[str, np.ndarray], start: InitialValues) -> float:
    """Return the highest angular frequency at rest and at the initial state, over all sets; 0 where none is finite."""
    x, v = (start.displacement, start.velocity) if isinstance(start, InitialState) else start
    return float(np.fmax.reduce(fastest_rates(system, p, np.concatenate([x, v])), axis=None, initial=0.0))


def integrated_readings(
    system: System,
    p: dict[str, np.ndarray],
    start: InitialValues,
    record: Record,
    radians: float = RADIANS_A_STEP,
    carry: Carry = rk4_path,
) -> np.ndarray:
    """Simulate the measurements of a record, channel after channel, (*sets, n_samples), without offsets.

    Parameters are arrays of one shape ``sets`` of at most one dimension; ``start`` an InitialState, or displacement
    and velocity of shape (n_dof, *sets); hidden states start at 0. Not finite where the motion diverges.
    """
    rig, n = record.rig(system), system.n_dof
    knots = [f.times[f.times < record.duration] for f in record.forces]
    grid = np.unique(np.concatenate([[0.0], *[c.times for c in record.channels], *knots]))
    x, v = (start.displacement, start.velocity) if isinstance(start, InitialState) else start
    sets = np.broadcast_shapes(*(np.shape(value) for value in p.values()), np.shape(x)[1:])
    state: list[Any] = [np.broadcast_to(part[i], sets) for part in (x, v) for i in range(n)]
    with np.errstate(all="ignore"):
        rate = fastest_rate(rig, p, (np.stack(state[:n]), np.stack(state[n:])))
        state += [np.zeros(sets) for _ in range(rig.n_hidden)]
        counts = np.clip(np.ceil(np.diff(grid) * rate / radians), 1, MOST_STEPS).astype(int)
        path = carry(rig, p, state, Steps.over(grid, counts, record.forces, n), np.arange(grid.size))
        times = np.unique(np.concatenate([c.times for c in record.channels]))
        path = np.broadcast_to(path, (len(path), *sets, grid.size))[..., np.searchsorted(grid, times)]
        return SimulatedMotion(path[:n], path[n : 2 * n], path[2 * n :]).readings(rig, p, record)
