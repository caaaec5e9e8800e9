"""The motion of a linear system and its exact derivatives, for many sets of parameters and initial states in one call.

The state ``s = [x, v]`` obeys ``s' = A(p) s + B(p) f``. One degree of freedom without a force has a closed form for
any damping. Anything else is carried from sample to sample by matrix exponentials of state, force and the force's
derivatives together (C. F. Van Loan, IEEE Trans. Automatic Control 23:395, 1978), and its derivatives by those of the
exponential (I. Najfeld and T. F. Havel, Adv. Appl. Math. 16:321, 1995): exact for forces that are polynomials between
their samples, and nothing is diagonalised, so repeated roots are no exception.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bench.contract.problem import Force, Record
from bench.dynamics.intervals import interval_polynomials, merged_grid, sample_times
from bench.dynamics.mechanics import state_matrix
from bench.systems import System

IMAGINARY = 1e-30
"""Relative size of an imaginary step: its square is below rounding, so derivatives have no error of their own."""
TERMS = 20
"""Terms of the Taylor series at a norm of at most 1; the remainder, 1/19!, is below rounding."""
NEAR = 1e-2
"""Of ``|d| t²``, below which the derivative of ``sinh(√d t)/√d`` by d is summed as a series: it cancels otherwise."""
MOST_AT_ONCE = 2**21
"""Number of values of derivatives of exponentials that are computed together, which limits memory."""
LONG_RUN = 16
"""Number of consecutive equal intervals from which the block algorithm is used, for speed,"""
FEW = 512
"""if the states of all sets together have at most this many values."""
FASTEST = 1e7
"""Largest product of rate and interval (radians); faster motions are returned as NaN."""


@dataclass(frozen=True, eq=False)
class StateMatrices:
    """``A`` (sets, 2n, 2n) and ``B`` (sets, 2n, n), and their derivatives by q log-parameters, (sets, q, 2n, ...)."""

    a: np.ndarray
    b: np.ndarray
    da: np.ndarray
    db: np.ndarray


def state_matrices(system: System, p: Mapping[str, np.ndarray], slopes: bool) -> StateMatrices:
    """Compute the matrices of a linear system for parameters of shape (sets,); q is 0 without ``slopes``.

    The imaginary step is in one parameter after the other (W. Squire and G. Trapp, SIAM Review 40:110, 1998).
    """
    if not slopes:
        a, b = state_matrix(system, p)
        return StateMatrices(a, b, a[:, None][:, :0], b[:, None][:, :0])
    steps = 1.0 + 1j * IMAGINARY * np.eye(len(system.names))
    stepped = {name: np.asarray(p[name])[:, None] * step for name, step in zip(system.names, steps, strict=True)}
    a, b = state_matrix(system, stepped)
    return StateMatrices(a[:, 0].real, b[:, 0].real, a.imag / IMAGINARY, b.imag / IMAGINARY)


def linear_motion(
    system: System,
    p: Mapping[str, np.ndarray],
    start: np.ndarray,
    times: np.ndarray,
    forces: Sequence[Force] = (),
    slopes: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the states of a linear system and their derivatives, at increasing times >= 0.

    Args:
        system: Linear system whose residual NumPy can evaluate with complex numbers.
        p: Parameters by name, each of shape (sets,).
        start: Displacements, then velocities, at time 0, shape (sets, 2 n_dof).
        times: Times (s), shape (n_times,).
        forces: Known forces, the same for all sets.
        slopes: True to compute derivatives.

    Returns:
        Displacements and velocities, shape (sets, n_times, 2 n_dof), and their derivatives by the log-parameters and
        the initial state, shape (sets, n_times, 2 n_dof, n_parameters + 2 n_dof), empty without ``slopes``. NaN for
        sets whose rates are too fast (:data:`FASTEST`).
    """
    return _motion(state_matrices(system, p, slopes), start, times, forces, slopes)


def _motion(
    matrices: StateMatrices, start: np.ndarray, times: np.ndarray, forces: Sequence[Force], slopes: bool
) -> tuple[np.ndarray, np.ndarray]:
    if start.shape[1] == 2 and not forces:
        return _free_oscillator(matrices, start, times, slopes)
    return _stepped(matrices, start, times, forces, slopes)


def linear_readings(
    system: System, p: Mapping[str, np.ndarray], start: np.ndarray, record: Record
) -> tuple[np.ndarray, np.ndarray]:
    """Return noise-free sensor values of a record, channel after channel, and derivatives, (sets, n_samples, ...).

    Derivatives are those of :func:`linear_motion`; accelerations are rows of ``A s + B f``. Offsets are not included.
    """
    n, (times, places) = system.n_dof, sample_times(record)
    matrices = state_matrices(record.rig(system), p, slopes=True)
    path, slopes = _motion(matrices, start, times, record.forces, slopes=True)
    q, values, derivatives = matrices.da.shape[1], [], []
    for channel, where in zip(record.channels, places, strict=True):
        row = channel.dof + (0 if channel.measures == "displacement" else n)
        if channel.measures != "acceleration":
            values.append(path[:, where, row])
            derivatives.append(slopes[:, where, row])
            continue
        state, push = path[:, where], np.stack(record.force(channel.times, n), axis=-1)
        values.append(np.einsum("kj,ktj->kt", matrices.a[:, row], state) + matrices.b[:, row] @ push.T)
        slope = np.einsum("kj,ktjd->ktd", matrices.a[:, row], slopes[:, where])
        slope[..., :q] += np.einsum("kqj,ktj->ktq", matrices.da[:, :, row], state)
        slope[..., :q] += np.einsum("kqj,tj->ktq", matrices.db[:, :, row], push)
        derivatives.append(slope)
    return np.concatenate(values, axis=1), np.concatenate(derivatives, axis=1)


# ------------------------------------------------------------------------------------------------ one DOF, no force


def _free_oscillator(
    matrices: StateMatrices, start: np.ndarray, times: np.ndarray, slopes: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Compute ``exp(A t) s0`` for ``A = [[0, 1], [-r, -g]]`` and its derivatives, at any damping.

    By Cayley and Hamilton ``exp(A t) = e^(-g t/2) (C I + S (A + g/2 I))`` with ``d = g²/4 - r``, ``C = cosh(√d t)`` and
    ``S = sinh(√d t)/√d``, which are ``cos`` and ``sin`` where d < 0 (D. S. Bernstein and W. So, IEEE Trans. Automatic
    Control 38:1228, 1993). ``dC/dd = t S/2`` and ``dS/dd = (t C - S)/(2 d)``.
    """
    r, g = -matrices.a[:, 1, :1], -matrices.a[:, 1, 1:]
    d = 0.25 * g * g - r
    # the floor changes d by less than rounding and avoids a division by zero at critical damping
    w = np.maximum(np.sqrt(np.abs(d)), 1e-8 / max(float(np.max(times, initial=0.0)), 1e-300))
    angle, envelope = w * times, np.exp(-0.5 * g * times)
    c, s = np.cos(angle), np.sin(angle)
    c *= envelope
    s *= envelope
    s /= w
    if np.any(decaying := d[:, 0] > 0):
        c[decaying], s[decaying] = _two_decays(w[decaying], -0.5 * g[decaying], times)
    x0, v0, half = start[:, :1], start[:, 1:], 0.5 * g
    up, down = half * x0 + v0, -r * x0 - half * v0
    by_component = np.empty((2, *c.shape))
    np.multiply(up, s, out=by_component[0])
    np.multiply(down, s, out=by_component[1])
    by_component[0] += c * x0
    by_component[1] += c * v0
    path = by_component.transpose(1, 2, 0)
    if not slopes:
        return path, np.empty((*path.shape, 0))
    u = d * times**2
    ds = (times * c - s) / np.where(d == 0, 1.0, 2.0 * d)
    if np.any(near := np.abs(u) < NEAR):
        e, t, small = envelope[near], np.broadcast_to(times, u.shape)[near], u[near]
        ds[near] = e * t**3 / 6 * (1 + small / 10 * (1 + small / 28 * (1 + small / 54 * (1 + small / 88))))
    dc = 0.5 * times * s
    by_r = np.stack([-dc * x0 - ds * up, -dc * v0 - ds * down - s * x0], axis=-1)
    by_g = 0.5 * np.stack([g * (dc * x0 + ds * up) + s * x0, g * (dc * v0 + ds * down) - s * v0], axis=-1)
    by_g -= 0.5 * times[:, None] * path
    dr, dg = -matrices.da[:, None, None, :, 1, 0], -matrices.da[:, None, None, :, 1, 1]
    q = dr.shape[-1]
    derivatives = np.empty((*path.shape, q + 2))
    derivatives[..., :q] = by_r[..., None] * dr + by_g[..., None] * dg
    derivatives[..., 0, q], derivatives[..., 0, q + 1] = c + s * half, s
    derivatives[..., 1, q], derivatives[..., 1, q + 1] = -r * s, c - s * half
    return path, derivatives


def _two_decays(w: np.ndarray, rate: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute ``e^(rate t) cosh(w t)`` and ``e^(rate t) sinh(w t)/w`` without overflow of the hyperbolic functions."""
    slow, fast = np.exp((rate + w) * times), np.exp((rate - w) * times)
    near = np.exp(rate * times) * np.sinh(np.minimum(w * times, 1.0))
    return 0.5 * (slow + fast), np.where(w * times < 1.0, near, 0.5 * (slow - fast)) / w


# ------------------------------------------------------------------------------------------------ any linear system


def _stepped(
    matrices: StateMatrices, start: np.ndarray, times: np.ndarray, forces: Sequence[Force], slopes: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Carry state and derivatives from one point of the grid of samples and forces to the next."""
    sets, n2 = start.shape
    q, grid = matrices.da.shape[1], merged_grid(times, forces)
    driven = sorted({force.dof for force in forces})
    given = _force_derivatives(forces, grid, n2 // 2, driven)
    lengths, which = _distinct(np.diff(grid))
    exponentials, derivatives, lost = _exponentials(matrices, driven, given.shape[1], lengths)
    growth, wanted = exponentials[..., :n2], np.searchsorted(grid, times)
    groups = np.split(np.argsort(which, kind="stable"), np.cumsum(np.bincount(which))[:-1])

    pushes = np.zeros((which.size, sets, n2, 1))
    if forces:
        for by_input, group in zip(exponentials[..., n2:], groups, strict=True):
            pushes[group, ..., 0] = np.moveaxis(by_input @ given[group].T, -1, 0)
    path = _carried(growth, which, start[..., None], pushes)
    path[:, lost] = np.nan
    values = np.moveaxis(path[wanted, ..., 0], 0, 1)
    if not slopes:
        return values, np.empty((*values.shape, 0))

    pushes = np.zeros((which.size, sets, n2, q + n2))
    for change, group in zip(derivatives, groups, strict=True):
        inputs = np.concatenate([path[group, ..., 0], np.repeat(given[group, None], sets, axis=1)], axis=-1)
        moved = change.reshape(sets, q * n2, -1) @ np.moveaxis(inputs, 0, -1)
        pushes[group, ..., :q] = moved.reshape(sets, q, n2, -1).transpose(3, 0, 2, 1)
    first = np.broadcast_to(np.eye(n2, q + n2, q), (sets, n2, q + n2))
    path = _carried(growth, which, first, pushes)
    path[:, lost] = np.nan
    return values, np.moveaxis(path[wanted], 0, 1)


def _carried(growth: np.ndarray, which: np.ndarray, first: np.ndarray, pushes: np.ndarray) -> np.ndarray:
    """Return ``x_0`` and all ``x_(i+1) = growth[which[i]] x_i + pushes[i]``, each of shape (sets, 2n, columns)."""
    path = np.concatenate([first[None], pushes])
    runs = np.flatnonzero(np.diff(which, prepend=-1, append=-1))
    for begin, end in itertools.pairwise(runs):
        matrix = growth[which[begin]]
        if end - begin >= LONG_RUN and first.size <= FEW:
            begin += _carry_in_blocks(matrix, path[begin : end + 1])
        for i in range(begin, end):
            path[i + 1] += matrix @ path[i]
    return path


def _carry_in_blocks(matrix: np.ndarray, path: np.ndarray) -> int:
    """Carry a run of equal intervals in blocks side by side, in place, and return how many of its intervals.

    Each block goes from zero; then the motion from its first state is added, by powers of the matrix.
    """
    size = math.isqrt(len(path) - 1)
    carried = (len(path) - 1) // size * size
    blocks = path[1 : carried + 1].reshape(-1, size, *path.shape[1:])
    powers = np.empty((size, *matrix.shape))
    powers[0] = matrix
    for j in range(1, size):
        blocks[:, j] += matrix @ blocks[:, j - 1]
        powers[j] = matrix @ powers[j - 1]
    for i, block in enumerate(blocks):
        block += powers @ path[i * size]
    return carried


def _force_derivatives(forces: Sequence[Force], grid: np.ndarray, n_dof: int, driven: Sequence[int]) -> np.ndarray:
    """Force and its derivatives by time at the start of each interval, shape (n_intervals, (degree + 1) * n_driven)."""
    if not forces:
        return np.zeros((grid.size - 1, 0))
    pushes, h = interval_polynomials(forces, grid, n_dof)[..., driven], np.diff(grid)[:, None]
    return np.concatenate([math.factorial(j) / h**j * push for j, push in enumerate(pushes)], axis=1)


def _distinct(lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The lengths that differ by more than rounding, and which of them each one is."""
    tick = 1e-12 * max(float(lengths.sum()), 1e-300)
    _, first, which = np.unique(np.round(lengths / tick), return_index=True, return_inverse=True)
    return lengths[first], which


def _exponentials(
    matrices: StateMatrices, driven: Sequence[int], inputs: int, lengths: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the rows of the state of ``exp(M h)`` and their derivatives at each of the lengths h, for many sets.

    ``M`` is over the state and ``inputs`` forces and derivatives of forces, (2n + inputs) square. All h share the terms
    of one Taylor series; a step of norm above 1 is halved and the exponential squared, as often as it takes. The norm
    is that of ``A`` with displacement and velocity in units of one size: the force comes in by a nilpotent part, a
    polynomial of ``h``.

    Returns:
        The exponentials (lengths, sets, 2n, 2n + inputs), their derivatives (lengths, sets, q, 2n, 2n + inputs), and
        which sets are too fast.
    """
    sets, q, n, _ = matrices.db.shape
    m, size = len(driven), n + inputs
    norms = _balanced_norms(matrices.a)
    lost = ~(norms * float(np.max(lengths, initial=0.0)) < FASTEST)
    norms = np.where(lost, 1.0, np.maximum(norms, 1e-300))
    matrix, slopes = np.zeros((sets, size, size)), np.zeros((sets, q, n, size))
    matrix[:, :n, :n], matrix[:, :n, n : n + m] = matrices.a, matrices.b[..., driven]
    matrix[:, n:, n:] = np.eye(inputs, k=m)
    slopes[..., :n], slopes[..., n : n + m] = matrices.da, matrices.db[..., driven]
    matrix[lost] = slopes[lost] = 0.0
    matrix, slopes = matrix / norms[:, None, None], slopes / norms[:, None, None, None]
    powers, derivatives = np.zeros((TERMS, sets, size, size)), np.zeros((TERMS, sets, q, n, size))
    powers[0] = np.eye(size)
    for k in range(1, TERMS):
        powers[k] = powers[k - 1] @ matrix / k
        if q:
            derivatives[k] = derivatives[k - 1] @ matrix[:, None]
            derivatives[k] += powers[k - 1, :, None, :n, :n] @ slopes
            derivatives[k] /= k

    growth, change = np.empty((lengths.size, sets, n, size)), np.empty((lengths.size, sets, q, n, size))
    together = max(1, MOST_AT_ONCE // max(1, sets * max(q * n, size) * size))
    for i in range(0, lengths.size, together):
        part = slice(i, i + together)
        growth[part], change[part] = _summed(norms[:, None] * lengths[part], powers, derivatives)
    return growth, change, lost


def _summed(radians: np.ndarray, powers: np.ndarray, derivatives: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sum the series of steps of ``radians`` (sets, lengths), of the rows of the state, with lengths in front."""
    (_, sets, q, n, size), number = derivatives.shape, radians.shape[1]
    halvings = np.maximum(0, np.ceil(np.log2(np.maximum(radians, 1e-300)))).astype(int)
    weights: np.ndarray = np.ones((sets, number, TERMS))
    weights[..., 1:] = (radians / 2.0**halvings)[..., None]
    weights = np.cumprod(weights, axis=-1)
    growth = weights @ powers.reshape(TERMS, sets, size**2).swapaxes(0, 1)
    change = weights @ derivatives.reshape(TERMS, sets, q * n * size).swapaxes(0, 1)
    growth, change = growth.reshape(sets, number, size, size), change.reshape(sets, number, q, n, size)
    for done in range(int(np.max(halvings, initial=0))):
        left = slice(None) if np.all(halvings > done) else halvings > done
        half, rows = growth[left], change[left]
        if q:
            change[left] = half[..., None, :n, :n] @ rows + rows @ half[..., None, :, :]
        growth[left] = half @ half
    return np.moveaxis(growth[:, :, :n], 1, 0), np.moveaxis(change, 1, 0)


def _balanced_norms(a: np.ndarray) -> np.ndarray:
    """The 1-norm of each ``A`` (sets, 2n, 2n) in the unit of time in which displacement and velocity have one size."""
    n = a.shape[-1] // 2
    low = np.abs(a[:, n:])
    stiffness = np.max(np.sum(low[..., :n], axis=1), axis=-1)
    damping = np.max(np.sum(low[..., n:], axis=1), axis=-1)
    return np.asarray(np.sqrt(stiffness) + damping)
