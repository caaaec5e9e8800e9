"""The response of a system and its derivatives by parameters and initial state.

They are exact for a linear system; for others jax differentiates Runge-Kutta steps that are fine enough not to matter.
What jax compiles is kept on disk, for the next process.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.contract.problem import Force, InitialState
from bench.dynamics.intervals import Steps, merged_grid, step_counts
from bench.dynamics.linear_motion import linear_motion
from bench.dynamics.rates import longest_step
from bench.dynamics.stepper import rk4_scan
from bench.systems import System

REFINE = 12
"""Integration steps per step that plain simulation would take."""


def linear_sensitivities(
    system: System,
    p: Mapping[str, float],
    start: InitialState,
    times: np.ndarray,
    forces: Sequence[Force] = (),
    rows: int | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the displacement of a linear system and its derivatives, at increasing times >= 0 (s).

    Args:
        system: one that is linear, of any residual that numpy can run on complex numbers.
        p: the parameters, in SI units.
        start: the state at time 0.
        times: where the displacement is wanted, shape (n_times,).
        forces: the known forces; each is zero after its last sample.
        rows: how many components of the state are wanted, n_dof without; 2 n_dof for velocities, too.

    Returns:
        The displacement (m), shape (rows, n_times), and its derivatives, shape (rows, n_times, n_parameters +
        2 n_dof): by the log-parameters, then by the initial displacement and velocity of each DOF.
    """
    n, parameters = system.n_dof, {name: np.array([p[name]]) for name in system.names}
    state = np.concatenate([start.displacement, start.velocity])[None]
    path, slopes = linear_motion(system, parameters, state, times, forces)
    return path[0, :, : rows or n].T, np.moveaxis(slopes[0, :, : rows or n], 1, 0)


def stepped_sensitivities(
    system: System,
    p: Mapping[str, float],
    start: InitialState,
    times: np.ndarray,
    forces: Sequence[Force] = (),
    rows: int | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the displacement of any system and its derivatives, as :func:`linear_sensitivities`.

    Hidden states start at 0.
    """
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    _keep_compilations()
    n, names = system.n_dof, system.names

    def response(theta: Any, lengths: Any, pushes: Any, reached: Any) -> tuple[Any, Any]:
        values = {name: jnp.exp(theta[i]) for i, name in enumerate(names)}
        first = jnp.concatenate([theta[len(names) :], jnp.zeros(system.n_hidden)])
        path = rk4_scan(system, values, first, lengths, pushes)[reached, : rows or n].T
        return path, path

    grid = merged_grid(times, forces)
    longest = longest_step(system, p, [*start.displacement, *start.velocity]) / REFINE
    steps = Steps.over(grid, step_counts(grid, longest), forces, n)
    theta = np.concatenate([np.log([p[name] for name in names]), start.displacement, start.velocity])
    with warnings.catch_warnings():  # what cannot be kept, or read again, is compiled
        warnings.filterwarnings("ignore", message=".*persistent compilation cache")
        differentiated = jax.jit(jax.jacfwd(response, has_aux=True))
        reached = steps.reached[np.searchsorted(grid, times)]
        slopes, path = differentiated(theta, steps.lengths, steps.forces, reached)
    return np.asarray(path), np.asarray(slopes)


def _keep_compilations() -> None:
    """Have jax keep what it compiles in the user's cache folder, unless the user has named another."""
    import jax

    if jax.config.values["jax_compilation_cache_dir"] is not None:
        return
    try:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:  # a user without a home
        return
    jax.config.update("jax_compilation_cache_dir", str(cache / "vibration-bench" / "jax"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
