"""Simulate the general law of motion for many model classes at once, with derivatives by its unknowns.

The law and the units are those of :mod:`bench.records.general_law`. jax compiles the simulation, with derivatives by
forward differentiation. Without jax, NumPy performs the same steps in complex arithmetic, one step size for all
unknowns (Squire and Trapp 1998): the same numbers to rounding, several times slower.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

SMOOTHING = 0.05
"""Smoothing velocity of friction over the amplitude of the speed; reduces the energy dissipated per cycle by 0.1 %."""
STILL = 1e-3
"""Least amplitude in this ratio, so that friction is smooth at rest."""
STEP = 0.08
"""Runge-Kutta step in radians of the dominant frequency: 79 steps per cycle."""
IMAGINARY = 1e-30
"""Imaginary step of an unknown; its square is negligible, so derivatives are exact to rounding."""

Simulator = Callable[..., tuple[Any, Any]]
"""(unknowns (C, R, 11), number of steps, push (R, J), places, force (R, N), order (R,), still) -> motion, slopes.

The unknowns are the nine coefficients, and displacement and velocity at time 0. The motion has shape (C, R, N) for C
classes and R rows, its derivatives (C, R, N, 11).
"""


@cache
def simulator() -> Simulator:
    """Return the compiled simulation, or that of NumPy where jax is not installed."""
    return _simulate if importlib.util.find_spec("jax") is None else _compiled()


def _acceleration(q: Any, x: Any, v: Any, f: Any, still: Any, xp: Any, magnitude: Any) -> Any:
    of_force, c, k, pendulum, k3, c2, mu, b, turn = (q[i] for i in range(9))
    speed = SMOOTHING * xp.where(still > STILL, still, xp.sqrt(v * v + x * x + STILL**2))
    pull = k * x + pendulum * xp.sin(turn * x) / turn + k3 * x * x * x
    return of_force * f - pull - c * v - c2 * magnitude(v) * v - mu * xp.tanh(v / speed) - b


def _step(rate: Callable[[Any, Any], Any], s: Any, f: Any) -> Any:
    k1 = rate(s, f)
    k2 = rate(s + STEP / 2 * k1, f)
    k3 = rate(s + STEP / 2 * k2, f)
    k4 = rate(s + STEP * k3, f)
    return s + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def _between(t: Any, x0: Any, v0: Any, x1: Any, v1: Any) -> tuple[Any, Any]:
    """Interpolate displacement and velocity within a step by the cubic Hermite polynomial; ``t`` from 0 to 1."""
    x = (1 + 2 * t) * (1 - t) ** 2 * x0 + t * t * (3 - 2 * t) * x1
    x += STEP * t * (1 - t) * ((1 - t) * v0 - t * v1)
    return x, 6 * t * (1 - t) * (x1 - x0) / STEP + (1 - t) * (1 - 3 * t) * v0 + t * (3 * t - 2) * v1


def _compiled() -> Simulator:
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)

    def predict(q: Any, steps: Any, push: Any, places: Any, force: Any, order: Any, still: Any) -> Any:
        def rate(s: Any, f: Any) -> Any:
            return jnp.stack([s[1], _acceleration(q, s[0], s[1], f, still, jnp, jnp.abs)])

        path = jnp.zeros((push.shape[0] + 1, 2)).at[0].set(q[-2:])
        path = jax.lax.fori_loop(0, steps, lambda j, path: path.at[j + 1].set(_step(rate, path[j], push[j])), path)
        node = jnp.minimum((places / STEP).astype(int), push.shape[0] - 1)
        (x0, v0), (x1, v1) = jnp.moveaxis(path[node], -1, 0), jnp.moveaxis(path[node + 1], -1, 0)
        x, v = _between(places / STEP - node, x0, v0, x1, v1)
        return jnp.select([order == 0, order == 1], [x, v], _acceleration(q, x, v, force, still, jnp, jnp.abs))

    def with_slopes(q: Any, *data: Any) -> Any:
        moves = jnp.eye(q.size)
        return jax.vmap(lambda move: jax.jvp(lambda q: predict(q, *data), (q,), (move,)), out_axes=(None, -1))(moves)

    cases = jax.vmap(with_slopes, in_axes=(0, None, None, None, None, None, None))
    compiled: Simulator = jax.jit(jax.vmap(cases, in_axes=(1, None, 0, 0, 0, 0, None), out_axes=1))
    return compiled


def _magnitude(v: np.ndarray) -> np.ndarray:
    return np.where(v.real < 0, -v, v)


def _simulate(
    q: np.ndarray, steps: int, push: np.ndarray, places: np.ndarray, force: np.ndarray, order: np.ndarray, still: float
) -> tuple[np.ndarray, np.ndarray]:
    moved = np.moveaxis(q, -1, 0)[..., None] + 1j * IMAGINARY * np.eye(q.shape[-1])[:, None, None, :]
    path = np.zeros((push.shape[1] + 1, 2, *moved.shape[1:]), complex)
    path[0] = moved[-2:]

    def rate(s: np.ndarray, f: np.ndarray) -> np.ndarray:
        return np.stack([s[1], _acceleration(moved, s[0], s[1], f[:, None], still, np, _magnitude)])

    for j in range(steps):
        path[j + 1] = _step(rate, path[j], push[:, j])
    motion = np.empty((*q.shape[:2], places.shape[1], q.shape[-1]), complex)
    for row, nodes in enumerate(np.minimum((places / STEP).astype(int), push.shape[1] - 1)):
        (x0, v0), (x1, v1) = (
            np.moveaxis(path[nodes][:, :, :, row], 1, 0),
            np.moveaxis(path[nodes + 1][:, :, :, row], 1, 0),
        )
        x, v = _between((places[row] / STEP - nodes)[:, None, None], x0, v0, x1, v1)
        if order[row] == 2:
            of_class = moved[:, None, :, row]
            x = _acceleration(of_class, x, v, force[row][:, None, None], still, np, _magnitude)
        motion[:, row] = np.moveaxis(v if order[row] == 1 else x, 0, 1)
    return motion[..., 0].real, motion.imag / IMAGINARY
