"""The response of a linear system and its exact derivatives by parameters and start, by matrix exponentials.

The state ``s = [x, v]`` obeys ``s' = A(p) s + B(p) f`` with a force that is a polynomial between samples, so over an
interval of length h the state, the force and the force's derivatives ``w`` obey ``w' = M w`` with one constant matrix
(C. F. Van Loan, IEEE Trans. Automatic Control 23:395, 1978). Their exact step is ``exp(M h) w``; its derivative by a
parameter is the derivative of the exponential in the direction of ``dM`` (I. Najfeld and T. F. Havel, Adv. Appl. Math.
16:321, 1995). Nothing is diagonalised, so repeated roots are no exception.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import cast

import numpy as np
from scipy.linalg import matrix_balance

from bench.contract.problem import Force, InitialState
from bench.dynamics.intervals import interval_polynomials, merged_grid
from bench.dynamics.mechanics import state_rate
from bench.dynamics.ops import numpy_ops
from bench.systems import Ops, System

IMAGINARY = 1e-30
"""Relative size of an imaginary step: its square is below rounding, so derivatives have no error of their own."""
_OPS = cast(Ops, SimpleNamespace(**{**vars(numpy_ops), "abs": lambda z: np.where(np.real(z) < 0, -z, z)}))
"""The numpy functions a residual may call, all of them analytic in an imaginary step."""
TERMS = 24
"""Of the Taylor series at norm 1 at most: what it leaves out, 1/23!, is below rounding."""


def linear_sensitivities(
    system: System, p: Mapping[str, float], start: InitialState, times: np.ndarray, forces: Sequence[Force] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement of a linear system and its derivatives, at increasing times >= 0 (s).

    Args:
        system: one that is linear, of any residual that numpy can run on complex numbers.
        p: the parameters, in SI units.
        start: the state at time 0.
        times: where the displacement is wanted, shape (n_times,).
        forces: the known forces; each is zero after its last sample.

    Returns:
        The displacement (m), shape (n_dof, n_times), and its derivatives, shape (n_dof, n_times, n_parameters +
        2 n_dof): by the log-parameters, then by the initial displacement and velocity of each DOF.
    """
    n, q, grid = system.n_dof, len(system.names), merged_grid(times, forces)
    driven = sorted({force.dof for force in forces})
    given = _force_derivatives(forces, grid, n, driven)
    a, b, da, db = _matrices(system, p, driven)
    exponentials = _Exponentials(a, b, da, db, given.shape[1])
    lengths, which = _distinct(np.diff(grid))
    growth = np.array([exponentials.step(h)[: 2 * n] for h in lengths]).reshape(-1, 2 * n, 2 * n + given.shape[1])

    state = np.empty((grid.size, 2 * n, 1))
    state[0, :, 0] = np.concatenate([start.displacement, start.velocity])
    state[1:] = growth[which, :, 2 * n :] @ given[..., None]
    _accumulate(growth[..., : 2 * n], which, state)

    slopes = np.empty((grid.size, 2 * n, q + 2 * n))
    slopes[0] = np.eye(2 * n, q + 2 * n, q)
    slopes[1:, :, q:] = 0.0
    augmented = np.concatenate([state[:-1, :, 0], given], axis=1)
    for j, h in enumerate(lengths):
        at = np.flatnonzero(which == j)
        slopes[at + 1, :, :q] = np.einsum("pik,tk->tip", exponentials.derivatives(h), augmented[at], optimize=True)
    _accumulate(growth[..., : 2 * n], which, slopes)

    wanted = np.searchsorted(grid, times)
    return state[wanted, :n, 0].T, np.moveaxis(slopes[wanted, :n], 1, 0)


def _matrices(
    system: System, p: Mapping[str, float], driven: Sequence[int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """``A``, ``B`` and their derivatives by the log-parameters, the forces being those on the ``driven`` DOFs.

    Shapes (2n, 2n), (2n, m), (n_parameters, 2n, 2n) and (n_parameters, 2n, m): the state rate at unit states and unit
    forces, with an imaginary step in one parameter after the other (W. Squire and G. Trapp, SIAM Review 40:110, 1998).
    """
    n, m = system.n_dof, len(driven)
    steps = 1.0 + 1j * IMAGINARY * np.eye(len(system.names))
    stepped = {name: p[name] * step[:, None] for name, step in zip(system.names, steps, strict=True)}
    units = np.eye(2 * n + m)
    force = [units[2 * n + driven.index(i)] if i in driven else np.zeros(2 * n + m) for i in range(n)]
    rates = state_rate(system, stepped, list(units[: 2 * n]), force, _OPS)
    both = np.stack([np.broadcast_to(rate, (len(steps), 2 * n + m)) for rate in rates], axis=1)
    value, slope = both[0].real, both.imag / IMAGINARY
    return value[:, : 2 * n], value[:, 2 * n :], slope[..., : 2 * n], slope[..., 2 * n :]


def _force_derivatives(forces: Sequence[Force], grid: np.ndarray, n_dof: int, driven: Sequence[int]) -> np.ndarray:
    """Force and its derivatives by time at the start of each interval, shape (n_intervals, (degree + 1) * n_driven)."""
    pushes, h = interval_polynomials(forces, grid, n_dof)[..., driven], np.diff(grid)[:, None]
    return np.concatenate([math.factorial(j) / h**j * push for j, push in enumerate(pushes)], axis=1)


def _distinct(lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The lengths that differ by more than rounding, and which of them each one is."""
    tick = 1e-12 * max(float(lengths.sum()), 1e-300)
    _, first, which = np.unique(np.round(lengths / tick), return_index=True, return_inverse=True)
    return lengths[first], which


def _accumulate(growth: np.ndarray, which: np.ndarray, path: np.ndarray) -> None:
    """``path[i + 1] += growth[which[i]] @ path[i]``, from the first entry on, in place."""
    for i, j in enumerate(which):
        path[i + 1] += growth[j] @ path[i]


class _Exponentials:
    """``exp(M h)`` and its derivatives at any h, from one Taylor series whose terms all h share.

    ``M`` is over state, force and derivatives of the force, (2n + k) square; ``dM`` has rows of the state alone. A step
    of norm above 1 is halved and the exponential squared, as often as it takes. The norm is that of the balanced ``A``
    (displacement and velocity in units of one size): the force comes in by a nilpotent part, a polynomial of ``h``.
    """

    def __init__(self, a: np.ndarray, b: np.ndarray, da: np.ndarray, db: np.ndarray, inputs: int) -> None:
        """Collect the terms; ``inputs`` is how many forces and derivatives of forces there are."""
        n, m = b.shape
        self.norm = float(np.linalg.norm(matrix_balance(a, permute=False)[0], 1))
        matrix, slopes = np.zeros((n + inputs, n + inputs)), np.zeros((len(da), n, n + inputs))
        matrix[:n, :n], matrix[:n, n : n + m] = a, b
        matrix[n:, n:] = np.eye(inputs, k=m)
        slopes[..., :n], slopes[..., n : n + m] = da, db
        matrix, slopes = matrix / self.norm, slopes / self.norm
        self._powers, self._slopes = [np.eye(n + inputs)], [np.zeros_like(slopes)]
        for k in range(1, TERMS):
            rows = self._slopes[-1].reshape(-1, n + inputs) @ matrix
            self._slopes.append((rows.reshape(slopes.shape) + self._powers[-1][:n, :n] @ slopes) / k)
            self._powers.append(self._powers[-1] @ matrix / k)

    def _halvings(self, h: float) -> tuple[int, np.ndarray]:
        halvings = max(0, math.ceil(math.log2(max(self.norm * h, 1e-300))))
        return halvings, (self.norm * h / 2.0**halvings) ** np.arange(TERMS)

    def step(self, h: float) -> np.ndarray:
        """``exp(M h)``."""
        halvings, weights = self._halvings(h)
        result = np.tensordot(weights, self._powers, 1)
        for _ in range(halvings):
            result = result @ result
        return np.asarray(result)

    def derivatives(self, h: float) -> np.ndarray:
        """Those of the rows of the state of ``exp(M h)`` by the log-parameters, shape (n_parameters, 2n, 2n + k)."""
        halvings, weights = self._halvings(h)
        slopes, result = np.tensordot(weights, self._slopes, 1), np.tensordot(weights, self._powers, 1)
        n = slopes.shape[1]
        for _ in range(halvings):
            slopes = result[:n, :n] @ slopes + slopes @ result
            result = result @ result
        return np.asarray(slopes)
