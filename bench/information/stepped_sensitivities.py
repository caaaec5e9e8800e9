"""The response of any system and its derivatives by parameters and start: Runge-Kutta steps, differentiated by jax.

The steps are fine enough not to matter. What jax compiles is kept on disk, for the next process.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from bench.contract.problem import Force, InitialState
from bench.dynamics.mechanics import rk4_step
from bench.dynamics.simulate import interval_polynomials, longest_step, merged_grid
from bench.systems import Ops, System

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
    n, names, ops = system.n_dof, system.names, jax_ops()

    def response(theta: Any, lengths: Any, pushes: Any, reached: Any) -> tuple[Any, Any]:
        values = {name: jnp.exp(theta[i]) for i, name in enumerate(names)}

        def step(state: Any, inputs: tuple[Any, Any]) -> tuple[Any, Any]:
            h, push = inputs
            f = [[push[i, j] for j in range(n)] for i in range(3)]
            at = [state[i] for i in range(state.shape[0])]
            new = jnp.stack(rk4_step(system, values, at, h, (f[0], f[1], f[2]), ops))
            return new, new[:n]

        first = jnp.concatenate([theta[len(names) :], jnp.zeros(system.n_hidden)])
        _, after = jax.lax.scan(step, first, (lengths, pushes))
        path = jnp.concatenate([first[None, :n], after])[reached].T
        return path, path

    theta = np.concatenate([np.log([p[name] for name in names]), start.displacement, start.velocity])
    with warnings.catch_warnings():  # what cannot be kept, or read again, is compiled
        warnings.filterwarnings("ignore", message=".*persistent compilation cache")
        differentiated = jax.jit(jax.jacfwd(response, has_aux=True))
        slopes, path = differentiated(theta, *_steps(system, p, start, times, forces))
    return np.asarray(path), np.asarray(slopes)


def jax_ops() -> Ops:
    """The jax functions a residual may call."""
    import jax.numpy as jnp

    def solve(matrix: Sequence[Sequence[Any]], rhs: Sequence[Any]) -> list[Any]:
        solution = jnp.linalg.solve(jnp.stack([jnp.stack(row) for row in matrix]), jnp.stack(rhs))
        return [solution[i] for i in range(len(rhs))]

    return cast(
        Ops,
        SimpleNamespace(
            sin=jnp.sin, cos=jnp.cos, tanh=jnp.tanh, exp=jnp.exp, abs=jnp.abs, where=jnp.where, solve=solve
        ),
    )


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
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)


def _steps(
    system: System, p: Mapping[str, float], start: InitialState, times: np.ndarray, forces: Sequence[Force]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Step lengths (n,), forces at start, middle and end of each step (n, 3, n_dof), and where each time is reached."""
    grid = merged_grid(times, forces)
    state = [np.array(part[i]) for part in (start.displacement, start.velocity) for i in range(system.n_dof)]
    state += [np.array(0.0)] * system.n_hidden
    longest = longest_step(system, p, state) / REFINE
    counts = np.maximum(1, np.ceil(np.diff(grid) / longest)).astype(int)
    which = np.repeat(np.arange(counts.size), counts)
    reached = np.concatenate([[0], np.cumsum(counts)])
    parts = (np.arange(which.size) - reached[which])[:, None] + np.array([0.0, 0.5, 1.0])
    parts /= counts[which, None]
    coefficients = interval_polynomials(forces, grid, system.n_dof)[:, which]
    pushes = sum(c[:, None] * parts[..., None] ** j for j, c in enumerate(coefficients))
    return (np.diff(grid) / counts)[which], np.asarray(pushes), reached[np.searchsorted(grid, times)]
