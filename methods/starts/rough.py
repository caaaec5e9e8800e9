"""The response of a nonlinear system, as finely as the noise requires: classical Runge-Kutta steps of so many radians.

Fixed steps of order four turn the phase by ``(w h)^5 / 120`` too little each (``w`` the fastest rate, ``h`` the step):
with ``w h = 0.15`` four parts in a million of it, far below what tells one start from another.
:func:`radians_a_step` says what a final answer needs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from bench import InitialState, Record, SimulatedMotion, Start, Steps, System, fastest_rates, rk4_path

RADIANS_A_STEP = 0.15
Carry = Callable[[System, Mapping[str, Any], Sequence[np.ndarray], Steps, np.ndarray], np.ndarray]
"""Carries a state along steps, as :func:`bench.rk4_path` does."""
MOST_STEPS = 64
"""Steps between two samples at most: a motion that is faster than that is no start anyway."""


def radians_a_step(allowed: float, turned: float) -> float:
    """Return the step ``w h`` (radians) at which a motion of ``turned = w T`` radians errs by a part ``allowed``.

    Each step errs by ``(w h)^5 / 120``, so the record by ``w T (w h)^4 / 120``.
    """
    return float((120.0 * allowed / max(turned, 1.0)) ** 0.25)


def fastest_rate(system: System, p: dict[str, np.ndarray], start: Start) -> float:
    """Return the largest rate (1 / time) at rest and at the start, over all sets; 0 where none is finite."""
    x, v = (start.displacement, start.velocity) if isinstance(start, InitialState) else start
    return float(np.fmax.reduce(fastest_rates(system, p, np.concatenate([x, v])), axis=None, initial=0.0))


def rough_readings(
    system: System,
    p: dict[str, np.ndarray],
    start: Start,
    record: Record,
    radians: float = RADIANS_A_STEP,
    carry: Carry = rk4_path,
) -> np.ndarray:
    """Return what the sensors of a record would show, channel after channel, (*sets, n_samples), without offsets.

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
