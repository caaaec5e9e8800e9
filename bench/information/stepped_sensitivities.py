"""The response of any system and its derivatives by parameters and start: Runge-Kutta steps, differentiated by jax.

The steps are fine enough not to matter. What jax compiles is kept on disk, for the next process.
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
from bench.dynamics.rates import longest_step
from bench.dynamics.stepper import rk4_scan
from bench.systems import System

REFINE = 12
"""Integration steps per step that plain simulation would take."""


def stepped_sensitivities(
    system: System, p: Mapping[str, float], start: InitialState, times: np.ndarray, forces: Sequence[Force] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement of a system and its derivatives, at increasing times >= 0 (s).

    Arguments and results are those of :func:`bench.information.linear_sensitivities.linear_sensitivities`; hidden
    states start at 0.
    """
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    _keep_compilations()
    n, names = system.n_dof, system.names

    def response(theta: Any, lengths: Any, pushes: Any, reached: Any) -> tuple[Any, Any]:
        values = {name: jnp.exp(theta[i]) for i, name in enumerate(names)}
        first = jnp.concatenate([theta[len(names) :], jnp.zeros(system.n_hidden)])
        path = rk4_scan(system, values, first, lengths, pushes)[reached, :n].T
        return path, path

    theta = np.concatenate([np.log([p[name] for name in names]), start.displacement, start.velocity])
    with warnings.catch_warnings():  # what cannot be kept, or read again, is compiled
        warnings.filterwarnings("ignore", message=".*persistent compilation cache")
        differentiated = jax.jit(jax.jacfwd(response, has_aux=True))
        slopes, path = differentiated(theta, *_steps(system, p, start, times, forces))
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


def _steps(
    system: System, p: Mapping[str, float], start: InitialState, times: np.ndarray, forces: Sequence[Force]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Step lengths (n,), forces at start, middle and end of each step (n, 3, n_dof), and where each time is reached."""
    grid = merged_grid(times, forces)
    state = [np.array(part[i]) for part in (start.displacement, start.velocity) for i in range(system.n_dof)]
    steps = Steps.over(grid, step_counts(grid, longest_step(system, p, state) / REFINE), forces, system.n_dof)
    return steps.lengths, steps.forces, steps.reached[np.searchsorted(grid, times)]
