"""Runge-Kutta method of order four: single steps in any library, trajectories in NumPy and JAX."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from bench.dynamics.intervals import Steps
from bench.dynamics.mechanics import state_rate
from bench.dynamics.ops import array_ops, numpy_ops
from bench.systems import Array, Components, Ops, System

MOST_STATES = 10_000_000
"""Largest number of values of a compiled trajectory, which stores all steps; NumPy stores requested states only."""


def rk4(
    rate: Callable[[Components, Any], Components], state: Components, step: Array, inputs: tuple[Any, Any, Any]
) -> list[Array]:
    """Take one classical Runge-Kutta step of order four.

    Args:
        rate: Function of state components and input that returns their time derivatives; arrays of any library.
        state: Components of the state before the step.
        step: Length of the step (s).
        inputs: Second argument of ``rate`` at the beginning, middle and end of the step.

    Returns:
        Components of the state after the step.
    """
    start, middle, end = inputs
    k1 = rate(state, start)
    k2 = rate([s + 0.5 * step * k for s, k in zip(state, k1, strict=True)], middle)
    k3 = rate([s + 0.5 * step * k for s, k in zip(state, k2, strict=True)], middle)
    k4 = rate([s + step * k for s, k in zip(state, k3, strict=True)], end)
    return [s + step / 6.0 * (a + 2.0 * b + 2.0 * c + d) for s, a, b, c, d in zip(state, k1, k2, k3, k4, strict=True)]


def rk4_step(
    system: System,
    p: Mapping[str, Array],
    state: Components,
    step: Array,
    forces: tuple[Components, Components, Components],
    ops: Ops,
) -> list[Array]:
    """Take one :func:`rk4` step of a system.

    Args:
        system: The system.
        p: Parameters by name.
        state: Displacements, velocities and hidden states.
        step: Length of the step (s).
        forces: Forces (N) on all DOFs at the beginning, middle and end of the step.
        ops: Functions of the library of the arguments.

    Returns:
        Components of the state after the step.
    """
    return rk4(lambda moved, force: state_rate(system, p, moved, force, ops), state, step, forces)


def rk4_path(
    system: System, p: Mapping[str, Any], state: Sequence[np.ndarray], steps: Steps, wanted: np.ndarray
) -> np.ndarray:
    """Integrate over a sequence of steps, for all sets of parameters at once.

    Args:
        system: The system.
        p: Parameters by name, floats or arrays of one shape ``sets``.
        state: Components of the initial state, each of shape ``sets``.
        steps: The steps.
        wanted: Indices of grid points at which the state is returned, shape (n_wanted,).

    Returns:
        States, shape (n_state, *sets, n_wanted); not finite where the motion diverges.
    """
    path, arrival = np.empty((len(state), *state[0].shape, wanted.size)), steps.reached[wanted]
    path[..., arrival == 0] = np.stack(state)[..., None]
    reached = set(arrival.tolist())
    for j, (h, (start, middle, end)) in enumerate(zip(steps.lengths, steps.forces.tolist(), strict=True), start=1):
        state = rk4_step(system, p, state, h, (start, middle, end), numpy_ops)
        if j in reached:
            path[..., arrival == j] = np.stack(state)[..., None]
    return path


def rk4_scan(system: System, p: Mapping[str, Any], start: Any, lengths: Any, forces: Any) -> Any:
    """Integrate over a sequence of steps in JAX, which can differentiate the result.

    Args:
        system: The system.
        p: Parameters by name, JAX arrays of one shape ``sets``.
        start: Initial state, shape (n_state, *sets).
        lengths: Lengths of the steps (s), shape (J,).
        forces: Forces (N) at the beginning, middle and end of each step, shape (J, 3, n_dof).

    Returns:
        States before the first step and after each step, shape (J + 1, n_state, *sets).
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


def compiled_path(
    system: System,
    p: Mapping[str, Any],
    state: Sequence[np.ndarray],
    steps: Steps,
    wanted: np.ndarray,
    coarse: bool = False,
) -> np.ndarray:
    """Integrate over a sequence of steps by a compiled :func:`rk4_scan`, or by :func:`rk4_path` without JAX.

    A program is compiled for each system, number of sets and number of steps. Both numbers are rounded up, so that few
    programs are compiled.

    Args:
        system: The system.
        p: Parameters by name, floats or arrays of one shape ``sets``.
        state: Components of the initial state, each of shape ``sets``.
        steps: The steps.
        wanted: Indices of grid points at which the state is returned, shape (n_wanted,).
        coarse: Round to powers of four; for short computations, in which compilation would take most of the time.

    Returns:
        States, shape (n_state, *sets, n_wanted); not finite where the motion diverges.
    """
    sets = state[0].shape
    n_sets, n_steps = int(np.prod(sets)), steps.lengths.size
    without_jax = importlib.util.find_spec("jax") is None
    if without_jax or not n_sets or not n_steps or len(state) * n_sets * n_steps > MOST_STATES:
        return rk4_path(system, p, state, steps, wanted)
    repeated = np.minimum(np.arange(_power(4 if coarse else 2, n_sets)), n_sets - 1)
    values = np.stack([np.broadcast_to(np.asarray(p[name], float), sets).ravel()[repeated] for name in system.names])
    start = np.stack([component.ravel() for component in state])[:, repeated]
    path = np.asarray(_carrier(system)(values, start, *padded(steps, coarse)))
    return np.moveaxis(path[steps.reached[wanted], :, :n_sets], 0, -1).reshape(len(state), *sets, wanted.size)


def padded(steps: Steps, coarse: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Return lengths (n,) and forces (n, 3, n_dof), padded at the end by steps of length zero."""
    n_steps = steps.lengths.size
    part = 2 ** max(n_steps.bit_length() - 3, 0)
    more = (_power(4, n_steps) if coarse else -(-n_steps // part) * part) - n_steps
    return np.pad(steps.lengths, (0, more)), np.pad(steps.forces, ((0, more), (0, 0), (0, 0)))


def _power(base: int, number: int) -> int:
    """Return the smallest power of ``base`` that is at least a number."""
    power = 1
    while power < number:
        power *= base
    return power


@lru_cache(maxsize=64)
def _carrier(system: System) -> Any:
    """Return the compiled function of parameters, initial states, lengths and forces that returns all states."""
    import jax

    jax.config.update("jax_enable_x64", True)

    def path(values: Any, start: Any, lengths: Any, forces: Any) -> Any:
        return rk4_scan(system, dict(zip(system.names, values, strict=True)), start, lengths, forces)

    return jax.jit(path)
