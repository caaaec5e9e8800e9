"""The true motion for parameters and forces that are constant over each sampling interval.

It is computed independently of the integrators of the trackers: by matrix exponentials for linear systems (C. F. Van
Loan, IEEE Trans. Automatic Control 23:395, 1978), and by an explicit Runge-Kutta method of order eight for others.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bench.dynamics.mechanics import state_matrix, state_rate
from bench.dynamics.ops import numpy_ops
from bench.systems import System

BATCH = 4096
"""Number of matrix exponentials per call."""


def simulate_motion(
    system: System, parameters: Mapping[str, np.ndarray], start: np.ndarray, forces: np.ndarray, interval: float
) -> np.ndarray:
    """Return displacements, velocities and hidden states at the samples, (n, n_motion).

    Args:
        system: The system.
        parameters: Parameters over the interval after each sample, by name, each (n,).
        start: State at the first sample, (n_motion,).
        forces: Forces on all degrees of freedom over the interval after each sample, N, (n, n_dof).
        interval: Sampling interval, s.
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
    from scipy.linalg import expm  # slow to import

    n, m = path.shape[1], forces.shape[1]
    values = np.stack([parameters[name] for name in system.names], axis=1)[:-1]
    new = np.concatenate([[True], np.any(np.diff(values, axis=0) != 0, axis=1)])
    which, distinct = np.cumsum(new) - 1, values[new]
    a, b = state_matrix(system, dict(zip(system.names, distinct.T, strict=True)))
    whole = np.zeros((len(distinct), n + m, n + m))
    whole[:, :n, :n], whole[:, :n, n:] = a * interval, b * interval
    steps = np.concatenate([expm(whole[i : i + BATCH]) for i in range(0, len(whole), BATCH)])
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

        solution = solve_ivp(rate, (0.0, interval), path[k], method="DOP853", rtol=1e-9, atol=1e-12)
        path[k + 1] = solution.y[:, -1]
