"""The motion of a linear system and its exact derivatives, for many sets of parameters and starts in one call.

The state ``s = [x, v]`` obeys ``s' = A(p) s + B(p) f``. One degree of freedom without a force has a closed form for
any damping. Anything else is carried from sample to sample by matrix exponentials of state, force and the force's
derivatives together (C. F. Van Loan, IEEE Trans. Automatic Control 23:395, 1978), and its derivatives by those of the
exponential (I. Najfeld and T. F. Havel, Adv. Appl. Math. 16:321, 1995): exact for forces that are polynomials between
their samples, and nothing is diagonalised, so repeated roots are no exception.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import cast

import numpy as np

from bench.contract.problem import Channel, Force, Record
from bench.dynamics.intervals import interval_polynomials, merged_grid
from bench.dynamics.ops import nan_ops
from bench.systems import Ops, System

IMAGINARY = 1e-30
"""Relative size of an imaginary step: its square is below rounding, so derivatives have no error of their own."""
_OPS = cast(Ops, SimpleNamespace(**{**vars(nan_ops), "abs": lambda z: np.where(np.real(z) < 0, -z, z)}))
"""The numpy functions a residual may call, all of them analytic in an imaginary step."""
TERMS = 24
"""Of the Taylor series at norm 1 at most: what it leaves out, 1/23!, is below rounding."""
NEAR = 1e-2
"""Of ``|d| t²``, below which the derivative of ``sinh(√d t)/√d`` by d is summed as a series: it cancels otherwise."""
MOST_AT_ONCE = 2**18
"""Numbers of the derivatives of exponentials that are formed together."""
FASTEST = 1e7
"""Radians that a motion may turn in an interval; one that is faster is said to be not finite."""


@dataclass(frozen=True, eq=False)
class StateMatrices:
    """``A`` (sets, 2n, 2n) and ``B`` (sets, 2n, m), and their derivatives by the log-parameters, (sets, q, 2n, ...)."""

    a: np.ndarray
    b: np.ndarray
    da: np.ndarray
    db: np.ndarray


def linear_matrices_and_slopes(system: System, p: Mapping[str, np.ndarray], driven: Sequence[int]) -> StateMatrices:
    """The matrices of a linear system for parameters of shape (sets,), with a column of ``B`` for each driven DOF.

    Columns of the mass, damping and stiffness matrices are the residual at one unit of acceleration, velocity or
    displacement and nothing else: so none is a small difference of large numbers. The imaginary step is in one
    parameter after the other (W. Squire and G. Trapp, SIAM Review 40:110, 1998).
    """
    n, m, q = system.n_dof, len(driven), len(system.names)
    steps = 1.0 + 1j * IMAGINARY * np.eye(q)
    stepped = {
        name: np.asarray(p[name])[:, None, None] * step[:, None] for name, step in zip(system.names, steps, strict=True)
    }
    units = np.eye(3 * n + m)
    x, v, a = (list(units[i * n : (i + 1) * n]) for i in range(3))
    force = [units[3 * n + driven.index(i)] if i in driven else np.zeros(3 * n + m) for i in range(n)]
    shape = (len(np.asarray(p[system.names[0]])), q, 3 * n + m)
    columns = [np.broadcast_to(r, shape) for r in system.residual(stepped, x, v, a, force, [], _OPS)]
    both = np.stack(columns, axis=2).astype(complex)
    order = np.r_[: 2 * n, 3 * n : 3 * n + m]
    low = -_solved(both[..., 2 * n : 3 * n], both[..., order])
    rates = np.zeros((*shape[:2], 2 * n, 2 * n + m), complex)
    rates[..., :n, n : 2 * n], rates[..., n:, :] = np.eye(n), low
    value, slope = rates[:, 0].real, rates.imag / IMAGINARY
    return StateMatrices(value[..., : 2 * n], value[..., 2 * n :], slope[..., : 2 * n], slope[..., 2 * n :])


def _solved(mass: np.ndarray, right: np.ndarray) -> np.ndarray:
    """``mass^-1 right``, not finite where the mass matrix is singular."""
    if mass.shape[-1] == 1:
        return np.asarray(right / mass)
    try:
        return np.asarray(np.linalg.solve(mass, right))
    except np.linalg.LinAlgError:
        singular = np.linalg.matrix_rank(mass.real) < mass.shape[-1]
        found = np.linalg.solve(np.where(singular[..., None, None], np.eye(mass.shape[-1]), mass), right)
        return np.where(singular[..., None, None], np.nan, found)


def linear_motion(
    system: System, p: Mapping[str, np.ndarray], start: np.ndarray, times: np.ndarray, forces: Sequence[Force] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """The states of a linear system and their derivatives, at increasing times >= 0.

    Args:
        system: one that is linear, of any residual that numpy can run on complex numbers.
        p: the parameters, each of shape (sets,).
        start: displacements, then velocities, at time 0, shape (sets, 2 n_dof).
        times: where the motion is wanted, shape (n_times,).
        forces: the known forces, the same for all sets; each is zero after its last sample.

    Returns:
        Displacements and velocities, shape (sets, n_times, 2 n_dof), and their derivatives, shape (sets, n_times,
        2 n_dof, n_parameters + 2 n_dof): by the log-parameters, then by the start. Not finite for sets that are too
        fast to be followed.
    """
    driven = sorted({force.dof for force in forces})
    matrices = linear_matrices_and_slopes(system, p, driven)
    if system.n_dof == 1 and not forces:
        return _free_oscillator(matrices, start, times)
    return _stepped(matrices, start, times, forces, driven)


def linear_readings(
    system: System, p: Mapping[str, np.ndarray], start: np.ndarray, record: Record
) -> tuple[np.ndarray, np.ndarray]:
    """What the sensors of a record would show, channel after channel, (sets, N), and its derivatives (sets, N, ...).

    As :func:`linear_motion`, without offsets. Sensors that are read at the same times share one motion.
    """
    rig, motions = record.rig(system), dict[bytes, tuple[np.ndarray, np.ndarray]]()
    parts = []
    for channel in record.channels:
        key = channel.times.tobytes()
        if key not in motions:
            motions[key] = linear_motion(rig, p, start, channel.times, record.forces)
        parts.append(_reading(rig, p, channel, record, *motions[key]))
    return np.concatenate([value for value, _ in parts], axis=1), np.concatenate([slope for _, slope in parts], axis=1)


def _reading(
    system: System, p: Mapping[str, np.ndarray], channel: Channel, record: Record, path: np.ndarray, slopes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What one sensor shows of a motion: a component of the state, or the acceleration that follows from it."""
    n = system.n_dof
    if channel.measures != "acceleration":
        at = channel.dof + (n if channel.measures == "velocity" else 0)
        return path[..., at], slopes[:, :, at]
    driven = sorted({force.dof for force in record.forces})
    own = linear_matrices_and_slopes(system, p, driven)
    push, row = np.stack(record.force(channel.times, n), axis=-1)[:, driven], n + channel.dof
    value = np.einsum("kj,ktj->kt", own.a[:, row], path) + np.einsum("kj,tj->kt", own.b[:, row], push)
    slope = np.einsum("kj,ktjd->ktd", own.a[:, row], slopes)
    q = own.da.shape[1]
    slope[..., :q] += np.einsum("kqj,ktj->ktq", own.da[:, :, row], path)
    slope[..., :q] += np.einsum("kqj,tj->ktq", own.db[:, :, row], push)
    return value, slope


# ------------------------------------------------------------------------------------------------ one DOF, no force


def _free_oscillator(matrices: StateMatrices, start: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``exp(A t) s0`` for ``A = [[0, 1], [-r, -g]]`` and its derivatives, at any damping.

    By Cayley and Hamilton ``exp(A t) = e^(-g t/2) (C I + S (A + g/2 I))`` with ``d = g²/4 - r``, ``C = cosh(√d t)`` and
    ``S = sinh(√d t)/√d``, which are ``cos`` and ``sin`` where d < 0 (D. S. Bernstein and W. So, IEEE Trans. Automatic
    Control 38:1228, 1993). ``dC/dd = t S/2`` and ``dS/dd = (t C - S)/(2 d)``.
    """
    r, g = -matrices.a[:, 1, :1], -matrices.a[:, 1, 1:]
    c, s, ds = _cosh_and_sinh(0.25 * g * g - r, g, times)
    x0, v0, half = start[:, :1], start[:, 1:], 0.5 * g
    up, down = half * x0 + v0, -r * x0 - half * v0
    path = np.stack([c * x0 + s * up, c * v0 + s * down], axis=-1)
    dc = 0.5 * times * s
    by_r = np.stack([-dc * x0 - ds * up, -dc * v0 - ds * down - s * x0], axis=-1)
    by_g = 0.5 * np.stack([g * (dc * x0 + ds * up) + s * x0, g * (dc * v0 + ds * down) - s * v0], axis=-1)
    by_g -= 0.5 * times[:, None] * path
    dr, dg = -matrices.da[:, None, None, :, 1, 0], -matrices.da[:, None, None, :, 1, 1]
    q = dr.shape[-1]
    slopes = np.empty((*path.shape, q + 2))
    slopes[..., :q] = by_r[..., None] * dr + by_g[..., None] * dg
    slopes[..., 0, q], slopes[..., 0, q + 1] = c + s * half, s
    slopes[..., 1, q], slopes[..., 1, q + 1] = -r * s, c - s * half
    return path, slopes


def _cosh_and_sinh(d: np.ndarray, g: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``C``, ``S`` and ``dS/dd``, each times the envelope ``e^(-g t/2)``, shape (sets, n_times)."""
    w = np.sqrt(np.abs(d))
    angle, envelope = w * times, np.exp(-0.5 * g * times)
    c, s = envelope * np.cos(angle), envelope * np.sin(angle) / np.maximum(w, 1e-300)
    decaying = d[:, 0] > 0
    if np.any(decaying):
        # two decays: cosh by itself would overflow where the envelope makes up for it
        own, rate = w[decaying], -0.5 * g[decaying]
        slow, fast = np.exp((rate + own) * times), np.exp((rate - own) * times)
        c[decaying], s[decaying] = 0.5 * (slow + fast), 0.5 * (slow - fast) / own
    ds = (times * c - s) / np.where(d == 0, 1.0, 2.0 * d)
    u = d * times**2
    near = np.abs(u) < NEAR
    if np.any(near):
        e, t, small = envelope[near], np.broadcast_to(times, u.shape)[near], u[near]
        s[near] = e * t * (1 + small / 6 * (1 + small / 20 * (1 + small / 42 * (1 + small / 72))))
        ds[near] = e * t**3 / 6 * (1 + small / 10 * (1 + small / 28 * (1 + small / 54 * (1 + small / 88))))
    return c, s, ds


# ------------------------------------------------------------------------------------------------ any linear system


def _stepped(
    matrices: StateMatrices, start: np.ndarray, times: np.ndarray, forces: Sequence[Force], driven: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """State and derivatives from one point of the grid of samples and forces to the next."""
    sets, n2 = start.shape
    q, grid = matrices.da.shape[1], merged_grid(times, forces)
    given = _force_derivatives(forces, grid, n2 // 2, driven)
    lengths, which = _distinct(np.diff(grid))
    exponentials = _Exponentials(matrices, given.shape[1])
    exponentials.hold(float(np.max(lengths, initial=0.0)))
    growth, slopes = exponentials.steps(lengths)

    path = np.empty((grid.size, sets, n2, 1 + q + n2))
    path[0] = np.eye(n2, 1 + q + n2, 1 + q)
    path[0, ..., 0] = start
    now = np.empty((sets, n2 + given.shape[1], 1))
    for i, j in enumerate(which):
        now[:, :n2, 0], now[:, n2:, 0] = path[i, ..., 0], given[i]
        np.matmul(growth[j][..., :n2], path[i], out=path[i + 1])
        path[i + 1, ..., 0] += (growth[j][..., n2:] @ given[i][:, None])[..., 0]
        path[i + 1, ..., 1 : 1 + q] += np.swapaxes((slopes[j] @ now[:, None])[..., 0], 1, 2)
    wanted = np.moveaxis(path[np.searchsorted(grid, times)], 0, 1)
    wanted[exponentials.lost] = np.nan
    return wanted[..., 0], wanted[..., 1:]


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


class _Exponentials:
    """``exp(M h)`` and its derivatives at any h for many sets, from one Taylor series whose terms all h share.

    ``M`` is over state, force and derivatives of the force, (2n + k) square. A step of norm above 1 is halved and the
    exponential squared, as often as it takes. The norm is that of ``A`` with displacement and velocity in units of one
    size: the force comes in by a nilpotent part, a polynomial of ``h``. ``lost`` says which sets are too fast.
    """

    def __init__(self, matrices: StateMatrices, inputs: int) -> None:
        """Collect the matrices; ``inputs`` is how many forces and derivatives of forces there are."""
        sets, q, n, m = matrices.db.shape
        self.n, self.inputs = n, inputs
        self.matrix, self.slopes = np.zeros((sets, n + inputs, n + inputs)), np.zeros((sets, q, n, n + inputs))
        self.matrix[:, :n, :n], self.matrix[:, :n, n : n + m] = matrices.a, matrices.b
        self.matrix[:, n:, n:] = np.eye(inputs, k=m)
        self.slopes[..., :n], self.slopes[..., n : n + m] = matrices.da, matrices.db
        self.norms = _balanced_norms(matrices.a)
        self.lost = ~np.isfinite(self.norms)

    def hold(self, longest: float) -> None:
        """Take out the sets that are too fast for the longest step, and sum the terms for the others."""
        self.lost |= ~(self.norms * longest < FASTEST)
        self.matrix[self.lost] = self.slopes[self.lost] = 0.0
        self.norm = float(np.max(self.norms[~self.lost], initial=1e-300))
        matrix, slopes, n = self.matrix / self.norm, self.slopes / self.norm, self.n
        self._powers, self._derivatives = [np.broadcast_to(np.eye(matrix.shape[-1]), matrix.shape)], [0.0 * slopes]
        for k in range(1, TERMS):
            rows = self._derivatives[-1] @ matrix[:, None] + self._powers[-1][:, None, :n, :n] @ slopes
            self._derivatives.append(rows / k)
            self._powers.append(self._powers[-1] @ matrix / k)

    def steps(self, lengths: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """The rows of the state of ``exp(M h)`` by h, (sets, 2n, 2n + k), and derivatives (sets, q, 2n, 2n + k)."""
        growth, slopes = list[np.ndarray](), list[np.ndarray]()
        together = max(1, MOST_AT_ONCE // max(1, self._derivatives[0].size, self._powers[0].size))
        for at in range(0, lengths.size, together):
            found = self._steps(lengths[at : at + together])
            growth.extend(found[0])
            slopes.extend(found[1])
        return growth, slopes

    def _steps(self, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same for lengths that fit into memory together."""
        n = self.n
        halvings = np.array([max(0, math.ceil(math.log2(max(self.norm * h, 1e-300)))) for h in lengths])
        weights = ((self.norm * lengths / 2.0**halvings)[:, None] ** np.arange(TERMS)).T[:, :, None, None, None]
        growth = sum(w * power for w, power in zip(weights, self._powers, strict=True))
        slopes = sum(w[..., None] * rows for w, rows in zip(weights, self._derivatives, strict=True))
        for done in range(int(np.max(halvings, initial=0))):
            left = slice(None) if np.all(halvings > done) else halvings > done
            mine, own = growth[left], slopes[left]
            slopes[left] = mine[:, :, None, :n, :n] @ own + own @ mine[:, :, None]
            growth[left] = mine @ mine
        return growth[:, :, :n], slopes


def _balanced_norms(a: np.ndarray) -> np.ndarray:
    """The 1-norm of each ``A`` (sets, 2n, 2n) in the unit of time in which displacement and velocity have one size."""
    n = a.shape[-1] // 2
    low = np.abs(a[:, n:])
    stiffness = np.max(np.sum(low[..., :n], axis=1), axis=-1)
    damping = np.max(np.sum(low[..., n:], axis=1), axis=-1)
    return np.asarray(np.sqrt(stiffness) + damping)
