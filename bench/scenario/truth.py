"""True values of a replicate, and the reference solutions that generate its data.

The truth never comes from an integrator that a method fits with: closed form for the linear SDOF, matrix
exponential with the exact hold of the force for other linear systems, an explicit Runge-Kutta method of order
eight at tight tolerance for the nonlinear ones.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.contract.problem import Force, InitialState
from bench.dynamics.intervals import interval_polynomials, merged_grid
from bench.dynamics.mechanics import state_matrix, state_rate
from bench.dynamics.ops import numpy_ops
from bench.systems import System
from bench.systems.linear import SDOF


@dataclass(frozen=True, eq=False)
class Truth:
    """True values by which an estimate is scored; methods never receive them.

    ``dense_displacement`` has shape (n_dof, n_dense) on ``dense_times`` (s, over the record), ``forecast_displacement``
    likewise over what follows the record. ``sigma`` is the noise standard deviation of each channel (in its unit),
    ``realised_snr_db`` the SNR of all that the samples are off by, ``sigma_over_peak`` the noise over the largest
    displacement; ``measured`` the DOFs that have a sensor (None: all).
    """

    parameters: Mapping[str, float]
    initial_state: InitialState
    dense_times: np.ndarray
    dense_displacement: np.ndarray
    forecast_times: np.ndarray
    forecast_displacement: np.ndarray
    sigma: tuple[float, ...]
    realised_snr_db: float
    sigma_over_peak: float
    measured: tuple[int, ...] | None = None

    def scored(self, displacement: np.ndarray) -> np.ndarray:
        """Return the displacements (..., n_dof, n) of the DOFs with a sensor, which are scored."""
        return displacement if self.measured is None else displacement[..., list(self.measured), :]


def reference_response(
    system: System,
    p: Mapping[str, float],
    start: InitialState,
    times: np.ndarray,
    forces: Sequence[Force] = (),
) -> np.ndarray:
    """Return the displacement (m), shape (n_dof, n_times), at increasing times >= 0 (s)."""
    if isinstance(system, SDOF) and not forces:
        return closed_form(p, float(start.displacement[0]), float(start.velocity[0]), times)[None]
    if system.linear:
        return matrix_exponential_response(system, p, start, times, forces)
    return integrated_response(system, p, start, times, forces)


def reference_state(system: System, p: Mapping[str, float], start: InitialState, time: float) -> InitialState:
    """Return the state at a time > 0 (s) of the free motion from ``start``."""
    n = system.n_dof
    state = integrated_states(system, p, start, np.array([time]))[:, 0]
    return InitialState(state[:n], state[n : 2 * n])


def closed_form(p: Mapping[str, float], x0: float, v0: float, times: np.ndarray) -> np.ndarray:
    """Return the free response of ``m x'' + c x' + k x = 0``, shape of ``times``, for any damping.

    ``x = e^(-a t) (x0 C + (v0 + a x0) S)`` with ``a = c/2m``, ``d = a² - k/m``, and C, S = cos, sin/w at
    ``w = sqrt(-d)`` below critical damping, cosh, sinh/w at ``w = sqrt(d)`` above, 1 and t at it
    (Inman, Engineering Vibration, chapter 1).
    """
    t = np.asarray(times, float)
    a = p["c"] / (2 * p["m"])
    root = np.emath.sqrt(a * a - p["k"] / p["m"])
    cosh = (np.exp((root - a) * t) + np.exp(-(root + a) * t)) / 2
    sinh = (np.exp((root - a) * t) - np.exp(-(root + a) * t)) / (2 * root) if root != 0 else t * np.exp(-a * t)
    return np.real(x0 * cosh + (v0 + a * x0) * sinh)


def matrix_exponential_response(
    system: System, p: Mapping[str, float], start: InitialState, times: np.ndarray, forces: Sequence[Force] = ()
) -> np.ndarray:
    """Return the displacement of a linear system, shape (n_dof, n_times), with the exact hold of the force.

    The augmented-matrix form of the hold (C. F. Van Loan, IEEE Trans. Automatic Control 23:395, 1978): with
    ``f`` a polynomial over an interval, the state, the force and its derivatives obey one constant-coefficient system.
    """
    from scipy.linalg import expm  # slow to import, and one mass does not need it

    a, b = state_matrix(system, p)
    n, m = b.shape
    grid = merged_grid(times, forces)
    pushes = interval_polynomials(forces, grid, m)
    order = len(pushes)
    augmented = np.zeros((n + order * m, n + order * m))
    augmented[:n, :n], augmented[:n, n : n + m] = a, b
    augmented[n:-m, n + m :] = np.eye((order - 1) * m)
    state = np.concatenate([start.displacement, start.velocity])
    path = np.empty((grid.size, n))
    path[0] = state
    cache: dict[float, np.ndarray] = {}
    for i, h in enumerate(np.diff(grid)):
        key = float(np.round(h, 14))
        if key not in cache:
            cache[key] = expm(augmented * h)
        derivatives = [math.factorial(j) / h**j * pushes[j, i] for j in range(order)]
        state = (cache[key] @ np.concatenate([state, *derivatives]))[:n]
        path[i + 1] = state
    return path[np.searchsorted(grid, times), : system.n_dof].T


def integrated_response(
    system: System,
    p: Mapping[str, float],
    start: InitialState,
    times: np.ndarray,
    forces: Sequence[Force] = (),
    **settings: Any,
) -> np.ndarray:
    """Return the displacement (m) of :func:`integrated_states`, shape (n_dof, n_times)."""
    return integrated_states(system, p, start, times, forces, **settings)[: system.n_dof]


def integrated_states(
    system: System,
    p: Mapping[str, float],
    start: InitialState,
    times: np.ndarray,
    forces: Sequence[Force] = (),
    method: str = "DOP853",
    rtol: float = 1e-11,
    atol: float = 1e-13,
) -> np.ndarray:
    """Return displacement, velocity and hidden states, shape (2 n_dof + n_hidden, n_times).

    The motion is integrated by a method of ``scipy.integrate.solve_ivp`` at a relative and an absolute tolerance.
    """
    from scipy.integrate import solve_ivp  # slow to import, and linear systems do not need it

    n = system.n_dof

    def rate(t: float, state: np.ndarray) -> list[float]:
        f = [0.0] * n
        for force in forces:
            f[force.dof] += float(force(np.array(t)))
        return state_rate(system, p, list(state), f, numpy_ops)

    # the force has kinks at its samples: integrate from one to the next
    ends = np.unique(np.concatenate([[0.0, times[-1]], *[f.times[f.times < times[-1]] for f in forces]]))
    state = np.concatenate([start.displacement, start.velocity, np.zeros(system.n_hidden)])
    path = np.empty((state.size, times.size))
    path[:, times == 0.0] = state[:, None]
    for t0, t1 in itertools.pairwise(ends):
        inside = (times > t0) & (times <= t1)
        solution = solve_ivp(rate, (t0, t1), state, method=method, rtol=rtol, atol=atol, dense_output=True)
        if np.any(inside):
            path[:, inside] = solution.sol(times[inside])
        state = solution.y[:, -1]
    return path
