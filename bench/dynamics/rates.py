"""Largest eigenvalue of a linearised equation of motion, and the integration step that resolves it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.dynamics.mechanics import state_rate
from bench.dynamics.ops import numpy_ops
from bench.systems import System

DIFFERENCE = 1e-6
"""Step of finite differences, relative to the largest component of the state."""
LEAST_DIFFERENCE = 1e-9
"""Smallest step of finite differences."""
STEPS_PER_RADIAN = 20
"""Integration steps per radian of the fastest rate."""


def fastest_rates(system: System, p: Mapping[str, Any], state: np.ndarray, step: float | None = None) -> np.ndarray:
    """Compute the largest magnitude of an eigenvalue of ``s' = f(s)`` without force, linearised at rest and at a state.

    Args:
        system: The system.
        p: Parameters by name, floats or arrays of one shape ``sets``.
        state: Displacements, velocities and hidden states, shape (2 n_dof + n_hidden, *sets); hidden states may be
            omitted and are then zero.
        step: Step of finite differences; by default 1e-6 times the largest component of the state, at least 1e-9.

    Returns:
        Rates (1 / unit of time) at rest and at the state, shape (2, *sets); NaN if the linearisation is not finite.
    """
    hidden = 2 * system.n_dof + system.n_hidden - len(state)
    state = np.concatenate([state, np.zeros((hidden, *state.shape[1:]))])
    d = len(state)
    # one step for all components: a smaller step for zero components would amplify the rounding of stiff springs
    if step is None:
        step = max(DIFFERENCE * float(np.max(np.abs(state[np.isfinite(state)]), initial=0.0)), LEAST_DIFFERENCE)
    moves = (step * np.concatenate([np.eye(d), -np.eye(d)], axis=1)).reshape(d, 2 * d, *[1] * (state.ndim - 1))
    fastest = []
    with np.errstate(all="ignore"):
        for share in (0.0, 1.0):
            moved = list(share * state[:, None] + moves)
            rates = np.array(np.broadcast_arrays(*state_rate(system, p, moved, [0.0] * system.n_dof, numpy_ops)))
            jacobian = np.moveaxis((rates[:, :d] - rates[:, d:]) / (2 * step), (0, 1), (-2, -1))
            finite = np.all(np.isfinite(jacobian), axis=(-2, -1))
            eigenvalues = np.linalg.eigvals(np.where(finite[..., None, None], jacobian, 0.0))
            fastest.append(np.where(finite, np.max(np.abs(eigenvalues), axis=-1), np.nan))
    return np.array(fastest)


def longest_step(system: System, p: Mapping[str, Any], state: Sequence[np.ndarray]) -> float:
    """Return a step (s) that resolves the fastest rate of all sets, at rest and at a state.

    Of rest and state, one with a rate that is not finite is ignored; the step is infinite if all rates are zero.
    """
    rates = fastest_rates(system, p, np.stack(state)).reshape(2, -1)
    fastest = float(np.max(rates[np.all(np.isfinite(rates), axis=1)], initial=0.0))
    return 1.0 / (STEPS_PER_RADIAN * fastest) if fastest > 0 else np.inf
