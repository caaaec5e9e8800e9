"""Runge-Kutta steps of order four, of one length within each interval of a grid, in numpy and in jax."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.contract.problem import Force
from bench.dynamics.intervals import interval_polynomials
from bench.dynamics.mechanics import state_rate
from bench.dynamics.ops import array_ops, numpy_ops
from bench.systems import Array, Components, Ops, System


def rk4_step(
    system: System,
    p: Mapping[str, Array],
    state: Components,
    step: Array,
    forces: tuple[Components, Components, Components],
    ops: Ops,
) -> list[Array]:
    """One classical Runge-Kutta step of order four; ``forces`` at its start, middle and end."""
    start, middle, end = forces
    k1 = state_rate(system, p, state, start, ops)
    k2 = state_rate(system, p, [s + 0.5 * step * k for s, k in zip(state, k1, strict=True)], middle, ops)
    k3 = state_rate(system, p, [s + 0.5 * step * k for s, k in zip(state, k2, strict=True)], middle, ops)
    k4 = state_rate(system, p, [s + step * k for s, k in zip(state, k3, strict=True)], end, ops)
    return [s + step / 6.0 * (a + 2.0 * b + 2.0 * c + d) for s, a, b, c, d in zip(state, k1, k2, k3, k4, strict=True)]


def step_counts(grid: np.ndarray, longest: float | np.floating[Any]) -> np.ndarray:
    """Count the steps within each interval of a grid that are no longer than ``longest``, shape (n_grid - 1,)."""
    return np.maximum(1, np.ceil(np.diff(grid) / longest)).astype(int)


@dataclass(frozen=True, eq=False)
class Steps:
    """The steps from the first point of a grid to the last.

    ``lengths`` (J,) in s; ``forces`` (J, 3, n_dof): the forces (N) at the start, middle and end of each step;
    ``reached`` (n_grid,): how many steps lead to each point of the grid.
    """

    lengths: np.ndarray
    forces: np.ndarray
    reached: np.ndarray

    @staticmethod
    def over(grid: np.ndarray, counts: np.ndarray, forces: Sequence[Force], n_dof: int) -> Steps:
        """Make ``counts`` (n_grid - 1,) steps in each interval of a grid that holds the samples of the forces."""
        interval, reached = np.repeat(np.arange(counts.size), counts), np.concatenate([[0], np.cumsum(counts)])
        within = (np.arange(interval.size) - reached[interval])[:, None] + np.array([0.0, 0.5, 1.0])
        part = (within / counts[interval, None])[..., None]
        total = np.zeros((*within.shape, n_dof))
        for coefficients in interval_polynomials(forces, grid, n_dof)[::-1]:
            total = coefficients[interval, None] + total * part
        return Steps((np.diff(grid) / counts)[interval], total, reached)


def rk4_path(
    system: System, p: Mapping[str, Any], state: Sequence[np.ndarray], steps: Steps, wanted: np.ndarray
) -> np.ndarray:
    """Carry a state along the steps, for all sets of parameters at once.

    Args:
        system: any.
        p: the parameters, floats or arrays of one shape ``sets``.
        state: the components at the first point of the grid, each of shape ``sets``.
        steps: the steps from there.
        wanted: the numbers of the grid's points at which the state is wanted, shape (n_wanted,).

    Returns:
        The states, shape (n_state, *sets, n_wanted); not finite where the motion diverges.
    """
    path, reached = np.empty((len(state), *state[0].shape, wanted.size)), set(steps.reached.tolist())
    arrival = steps.reached[wanted]
    path[..., arrival == 0] = np.stack(state)[..., None]
    for j, (h, at) in enumerate(zip(steps.lengths, steps.forces.tolist(), strict=True), start=1):
        state = rk4_step(system, p, state, h, (at[0], at[1], at[2]), numpy_ops)
        if j in reached:
            path[..., arrival == j] = np.stack(state)[..., None]
    return path


def rk4_scan(system: System, p: Mapping[str, Any], start: Any, lengths: Any, forces: Any) -> Any:
    """Carry a state along steps in jax, which differentiates it.

    Args:
        system: any.
        p: the parameters, scalars of jax.
        start: the state, shape (n_state,).
        lengths: of the steps, shape (J,).
        forces: at the start, middle and end of each step, shape (J, 3, n_dof).

    Returns:
        The states before the first step and after each, shape (J + 1, n_state).
    """
    import jax
    import jax.numpy as jnp

    ops = array_ops(jnp)

    def step(state: Any, inputs: tuple[Any, Any]) -> tuple[Any, Any]:
        h, push = inputs
        f = [[push[i, j] for j in range(system.n_dof)] for i in range(3)]
        new = jnp.stack(rk4_step(system, p, list(state), h, (f[0], f[1], f[2]), ops))
        return new, new

    _, after = jax.lax.scan(step, start, (lengths, forces))
    return jnp.concatenate([start[None], after])
