"""The true motion under parameters and forces that are held over each interval.

The truth never comes from an integrator that a tracker uses: matrix exponentials for linear systems (C. F. Van Loan,
IEEE Trans. Automatic Control 23:395, 1978), an explicit Runge-Kutta method of order eight for the others.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bench.dynamics.mechanics import state_matrix, state_rate
from bench.dynamics.ops import numpy_ops
from bench.systems import System

TOGETHER = 4096
"""Intervals whose exponentials are computed in one call."""


def held_motion(
    system: System, parameters: Mapping[str, np.ndarray], start: np.ndarray, forces: np.ndarray, interval: float
) -> np.ndarray:
    """Displacements, velocities and hidden states at the samples, shape (n, n_motion).

    Args:
        system: any.
        parameters: by name, each of shape (n,): over the interval that begins at each sample.
        start: the motion at the first sample, shape (n_motion,).
        forces: on every DOF (N), over the same intervals, shape (n, n_dof).
        interval: between samples (s).
    """
    path = np.empty((forces.shape[0], start.size))
    path[0] = start
    if system.linear:
        _linear(system, parameters, path, forces, interval)
    else:
        _integrated(system, parameters, path, forces, interval)
    return path


def _linear(
    system: System, parameters: Mapping[str, np.ndarray], path: np.ndarray, forces: np.ndarray, interval: float
) -> None:
    from scipy.linalg import expm  # slow to import, and few need it

    n, m = path.shape[1], forces.shape[1]
    values = np.stack([parameters[name] for name in system.names], axis=1)[:-1]
    new = np.concatenate([[True], np.any(np.diff(values, axis=0) != 0, axis=1)])
    which, distinct = np.cumsum(new) - 1, values[new]
    a, b = state_matrix(system, dict(zip(system.names, distinct.T, strict=True)))
    whole = np.zeros((len(distinct), n + m, n + m))
    whole[:, :n, :n], whole[:, :n, n:] = a * interval, b * interval
    steps = np.concatenate([expm(whole[i : i + TOGETHER]) for i in range(0, len(whole), TOGETHER)])
    for k, i in enumerate(which):
        path[k + 1] = steps[i, :n, :n] @ path[k] + steps[i, :n, n:] @ forces[k]


def _integrated(
    system: System, parameters: Mapping[str, np.ndarray], path: np.ndarray, forces: np.ndarray, interval: float
) -> None:
    from scipy.integrate import solve_ivp

    for k in range(len(path) - 1):
        p, f = {name: float(parameters[name][k]) for name in system.names}, forces[k].tolist()

        def rate(_: float, state: np.ndarray, p: dict[str, float] = p, f: list[float] = f) -> list[float]:
            return state_rate(system, p, list(state), f, numpy_ops)

        found = solve_ivp(rate, (0.0, interval), path[k], method="DOP853", rtol=1e-9, atol=1e-12)
        path[k + 1] = found.y[:, -1]
