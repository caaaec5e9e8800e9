"""Runge-Kutta motions of any system and their derivatives in the same pass, by functions that CasADi evaluates.

One step maps the state and its derivatives by the log-parameters (and by the start) to those at its end: the classical
step of order four, differentiated symbolically, so the derivatives are those of the steps themselves and the maximum of
a likelihood is that of the programme of multiple shooting with the same steps. A set of parameters is carried along all
steps in one call and by itself: the company of others changes nothing. Where a system bends suddenly, as a modulus
does, the derivative is that of the side on which the state is, as in the programme.

CasADi's evaluation needs no compiler, and takes as long for a set of parameters alone as in company: 0.2 ms for a
Duffing oscillator over 160 steps, in processor time on one core. For a hundred sets numpy takes 0.15 ms each by central
differences, but 15 ms for one set; jax 0.07 ms each, but it compiles for a second for each number of sets and of steps,
and both change from one iteration of a search to the next.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np

from bench import Steps, System, acceleration, rk4_step
from methods.trajectory.programme import casadi_ops, state_size


@lru_cache(maxsize=64)
def _step(system: System, by_start: int) -> Any:
    """One step: (state and derivatives, parameters, length, forces at start, middle and end) -> the same at its end."""
    import casadi as ca

    n, names, size = system.n_dof, system.names, state_size(system)
    s, p, h, f = ca.SX.sym("s", size), ca.SX.sym("p", len(names)), ca.SX.sym("h"), ca.SX.sym("f", n, 3)
    start, middle, end = ([f[i, j] for i in range(n)] for j in range(3))
    given = dict(zip(names, ca.vertsplit(p), strict=True))
    after = ca.vertcat(*rk4_step(system, given, ca.vertsplit(s), h, (start, middle, end), casadi_ops()))
    return _with_slopes(system, by_start, (s, p, [h, f]), after)


@lru_cache(maxsize=64)
def _acceleration(system: System, dof: int, by_start: int) -> Any:
    """What an accelerometer shows and its derivatives: (state and derivatives, parameters, forces) -> (1, 1 + q)."""
    import casadi as ca

    n, names, size = system.n_dof, system.names, state_size(system)
    s, p, f = ca.SX.sym("s", size), ca.SX.sym("p", len(names)), ca.SX.sym("f", n)
    x, v, z = (ca.vertsplit(s)[i:j] for i, j in ((0, n), (n, 2 * n), (2 * n, size)))
    given = dict(zip(names, ca.vertsplit(p), strict=True))
    a = acceleration(system, given, x, v, ca.vertsplit(f), z, casadi_ops())[dof]
    return _with_slopes(system, by_start, (s, p, [f]), a)


def _with_slopes(system: System, by_start: int, inputs: tuple[Any, Any, list[Any]], value: Any) -> Any:
    """The function of state *and* derivatives that follows from a function of the state, by directional derivatives."""
    import casadi as ca

    (s, p, others), k = inputs, len(system.names)
    slopes = ca.SX.sym("slopes", state_size(system), k + by_start)
    directions = ca.vertcat(slopes, ca.horzcat(ca.diag(p), ca.SX(k, by_start)))
    both = ca.horzcat(value, ca.jtimes(value, ca.vertcat(s, p), directions))
    return ca.Function("carried", [ca.horzcat(s, slopes), p, *others], [ca.densify(both)], {"cse": True})


@lru_cache(maxsize=64)
def _steps(system: System, by_start: int, number: int) -> Any:
    return _step(system, by_start).mapaccum(number)


@lru_cache(maxsize=64)
def _accelerations(system: System, dof: int, by_start: int, number: int) -> Any:
    return _acceleration(system, dof, by_start).map(number)


def stepped_motion(system: System, p: np.ndarray, start: np.ndarray, steps: Steps, by_start: bool) -> np.ndarray:
    """The states at the points of the grid of steps and their derivatives, set by set.

    Args:
        system: any.
        p: the parameters in the system's order, shape (sets, n_parameters).
        start: displacements, then velocities, shape (sets, 2 n_dof); hidden states start at zero.
        steps: from time 0.
        by_start: whether the derivatives by the start are wanted, too.

    Returns:
        The states, then their derivatives by the log-parameters and by the start, shape (sets, n_grid, 1 + q, n_state);
        not finite where the motion diverges.
    """
    sets, moving = start.shape
    k, own, number = p.shape[1], moving if by_start else 0, steps.lengths.size
    first = np.zeros((sets, 1 + k + own, state_size(system)))
    first[:, 0, :moving] = start
    first[:, 1 + k :, :moving] = np.eye(own, moving)
    path = np.empty((sets, steps.reached.size, *first.shape[1:]))
    path[:, 0] = first
    if number:
        values = np.repeat(p[:, None], number, axis=1)
        given = [first, values, steps.lengths, steps.forces]
        for place, after in zip(path, _evaluated(_steps(system, own, number), given, (2, 3)), strict=True):
            place[1:] = after.reshape(number, *first.shape[1:])[steps.reached[1:] - 1]
    return path


def stepped_accelerations(
    system: System, p: np.ndarray, states: np.ndarray, forces: np.ndarray, dof: int
) -> np.ndarray:
    """The acceleration of a DOF and its derivatives, shape (sets, n, 1 + q), at ``states`` (sets, n, 1 + q, n_state).

    ``forces`` (n, n_dof) act then; ``p`` as in :func:`stepped_motion`.
    """
    sets, number, columns, _ = states.shape
    shown = np.empty((sets, number, columns))
    if number:
        function = _accelerations(system, dof, columns - 1 - p.shape[1], number)
        given = [states, np.repeat(p[:, None], number, axis=1), forces]
        for place, found in zip(shown, _evaluated(function, given, (2,)), strict=True):
            place[:] = found.reshape(number, columns)
    return shown


def _evaluated(function: Any, inputs: list[np.ndarray], shared: tuple[int, ...]) -> Iterator[np.ndarray]:
    """What a function gives for one set after the other, in one array; ``shared`` inputs are the same for all."""
    buffer, evaluate = function.buffer()
    result = np.empty(function.nnz_out(0))
    buffer.set_res(0, result.data)
    inputs = [np.ascontiguousarray(given, dtype=float) for given in inputs]
    for i in shared:
        buffer.set_arg(i, inputs[i].data)
    for case in range(len(inputs[0])):
        for i, given in enumerate(inputs):
            if i not in shared:
                buffer.set_arg(i, given[case].data)
        evaluate()
        yield result
