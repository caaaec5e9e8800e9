"""The response of a system, vectorised over parameter sets, for methods and for scoring.

Linear systems by superposition of their modes, exact in time. One motion of another system by adaptive Runge-Kutta
steps of order eight (:mod:`bench.dynamics.integrator`), to about 1e-8 of its largest value even where rates have
kinks; many at once by steps of order four, to about 1e-5 of it, alike for all sets, so that their differences are
smooth. The truth is never made here (see :mod:`bench.scenario.truth`), nor the sensitivities of a bound (see
:mod:`bench.information.fisher`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from numpy.polynomial import polynomial

from bench.contract.problem import Channel, Force, InitialState, Record
from bench.dynamics.integrator import Rate, integrate
from bench.dynamics.mechanics import acceleration, linear_matrices, numpy_ops, rk4_step, state_rate
from bench.systems import Ops, System

DEFECTIVE = 1e7
"""Condition number of the modes beyond which the matrix exponential is used instead."""
STEPS_PER_RADIAN = 20
MAX_STEPS = 200_000
FIRST_STEP = 0.5
"""The first step of an integration, in radians of the fastest rate at its start."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Displacement and velocity of every DOF and the hidden states, each of shape (their number, *sets, n_times)."""

    displacement: np.ndarray
    velocity: np.ndarray
    hidden: np.ndarray

    def measured(self, system: System, p: Mapping[str, Any], channel: Channel, record: Record) -> np.ndarray:
        """What an ideal sensor would give (without its offset), shape (*sets, n_times)."""
        if channel.measures == "displacement":
            return self.displacement[channel.dof]
        if channel.measures == "velocity":
            return self.velocity[channel.dof]
        force = record.force(channel.times, system.n_dof)
        expanded = {name: np.asarray(value)[..., None] for name, value in p.items()}
        x, v, z = map(list, (self.displacement, self.velocity, self.hidden))
        return np.asarray(acceleration(system, expanded, x, v, force, z, numpy_ops)[channel.dof])


def simulate(
    system: System,
    p: Mapping[str, Any],
    start: InitialState | tuple[np.ndarray, np.ndarray],
    times: np.ndarray,
    forces: Sequence[Force] = (),
) -> Motion:
    """The response from a state at time 0, at increasing times >= 0 (s), shape (n_times,).

    Parameters are floats or arrays of one shape ``sets``; ``start`` is an InitialState, or displacement and velocity
    of shape (n_dof, *sets). A diverging response gives infinities or NaNs, never an error.
    """
    x0, v0 = (start.displacement, start.velocity) if isinstance(start, InitialState) else start
    sets = np.broadcast_shapes(*(np.shape(v) for v in p.values()), np.shape(x0)[1:], np.shape(v0)[1:])
    state = [_spread(part[i], sets) for part in (x0, v0) for i in range(system.n_dof)]
    p = {name: _spread(value, sets) for name, value in p.items()}
    times = np.asarray(times, float)
    with np.errstate(all="ignore"):
        if system.linear:
            path = _by_modes(system, p, np.stack(state, -1), times, forces)
        else:
            state += [np.zeros(sets) for _ in range(system.n_hidden)]
            path = (_by_steps if sets else _alone)(system, p, state, times, forces)
    n = system.n_dof
    return Motion(path[:n], path[n : 2 * n], path[2 * n :])


def _spread(value: Any, shape: tuple[int, ...]) -> np.ndarray:
    array = np.asarray(value, float)
    return array if array.shape == shape else np.broadcast_to(array, shape)


def state_matrix(system: System, p: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """``A`` and ``B`` of ``s' = A s + B f`` for the state ``s = [x, v]``, shapes (..., 2n, 2n) and (..., 2n, n)."""
    n = system.n_dof
    mass, damping, stiffness = linear_matrices(system, p)
    inverse = 1.0 / mass if n == 1 else np.linalg.inv(mass)
    a = np.zeros((*mass.shape[:-2], 2 * n, 2 * n))
    a[..., :n, n:] = np.eye(n)
    a[..., n:, :n] = -inverse @ stiffness
    a[..., n:, n:] = -inverse @ damping
    b = np.zeros((*mass.shape[:-2], 2 * n, n))
    b[..., n:, :] = inverse
    return a, b


def _by_modes(
    system: System, p: Mapping[str, Any], s0: np.ndarray, times: np.ndarray, forces: Sequence[Force]
) -> np.ndarray:
    a, b = state_matrix(system, p)
    if not np.all(np.isfinite(a)):
        return np.full((2 * system.n_dof, *s0.shape[:-1], times.size), np.nan)
    if a.shape[-1] == 2 and not forces:
        return _free_two_states(a, s0, times)
    rates, modes = np.linalg.eig(a)
    if np.max(np.linalg.cond(modes), initial=0.0) > DEFECTIVE:
        # a repeated root (critical damping): move it apart by less than any data could show
        a = a.copy()
        diagonal = np.arange(a.shape[-1])
        a[..., diagonal, diagonal] += 1e-7 * np.linalg.norm(a, axis=(-2, -1))[..., None] * (diagonal - diagonal.mean())
        if not np.all(np.isfinite(a)):  # the norm of what is nearly infinite
            return np.full((2 * system.n_dof, *s0.shape[:-1], times.size), np.nan)
        rates, modes = np.linalg.eig(a)
    inverse = np.linalg.inv(modes.astype(complex))
    q0 = (inverse @ s0[..., None])[..., 0]
    if forces:
        q = _forced_modes(rates, inverse @ b, q0, times, forces)
    else:
        q = q0[..., None] * np.exp(rates[..., None] * times)
    return np.moveaxis((modes @ q).real, -2, 0)


def _free_two_states(a: np.ndarray, s0: np.ndarray, times: np.ndarray) -> np.ndarray:
    """``exp(A t) s0`` for matrices A of two by two and any damping, shape (2, ..., n_times).

    By Cayley and Hamilton ``exp(A t) = e^(mu t) (C I + S (A - mu I))`` with ``mu`` half the trace and
    ``d = mu² - det A``: ``C, S = cos(w t), sin(w t)/w`` where ``d = -w² < 0``, and ``cosh(w t), sinh(w t)/w`` where
    ``d = w² > 0`` (Bernstein and So, IEEE Trans. Automatic Control 38:1228, 1993). No modes, so nothing is defective.
    """
    mu = 0.5 * (a[..., 0, 0] + a[..., 1, 1])[..., None]
    half = 0.5 * (a[..., 0, 0] - a[..., 1, 1])[..., None]
    d = half * half + (a[..., 0, 1] * a[..., 1, 0])[..., None]
    # the floor moves d by less than rounding does, and spares the division by zero at critical damping
    w = np.maximum(np.sqrt(np.abs(d)), 1e-8 / max(float(times[-1]), 1e-300)) if times.size else np.ones_like(d)
    angle = w * times
    cosine, sine = np.cos(angle), np.sin(angle) / w
    envelope = np.exp(mu * times)
    cosine *= envelope
    sine *= envelope
    if np.any(d > 0):
        # two decays: cosh by itself would overflow where the envelope makes up for it
        slow, fast = np.exp((mu + w) * times), np.exp((mu - w) * times)
        cosine = np.where(d > 0, 0.5 * (slow + fast), cosine)
        sine = np.where((d > 0) & (angle > 1e-5), 0.5 * (slow - fast) / w, sine)
    x, v = s0[..., :1], s0[..., 1:]
    path = np.empty((2, *sine.shape))
    np.multiply(half * x + a[..., :1, 1] * v, sine, out=path[0])
    np.multiply(a[..., 1:, 0] * x - half * v, sine, out=path[1])
    path[0] += x * cosine
    path[1] += v * cosine
    return path


def _forced_modes(
    rates: np.ndarray, gains: np.ndarray, q0: np.ndarray, times: np.ndarray, forces: Sequence[Force]
) -> np.ndarray:
    """Modal coordinates (..., n_modes, n_times) under forces that are polynomials between the times of a merged grid.

    Over one interval of length h: ``q <- e^z q + h sum_j j! phi_(j+1)(z) g_j`` with ``z = rate h`` and the modal force
    ``sum_j g_j s^j`` in the part s of the interval that has passed, exact (Hochbruck and Ostermann, Acta Numerica
    19:209, 2010, section 2.1).
    """
    grid = merged_grid(times, forces)
    wanted = np.searchsorted(grid, times)
    # lengths that differ by rounding alone share their coefficients
    tick = 1e-12 * max(grid[-1], 1e-300)
    _, first, which = np.unique(np.round(np.diff(grid) / tick), return_index=True, return_inverse=True)
    h = np.diff(grid)[first].reshape(-1, *(1,) * rates.ndim)
    z = rates * h
    growth = np.exp(z)
    pushes = np.zeros((which.size, *q0.shape), complex)
    for j, (phi, given) in enumerate(zip(_phis(z), interval_polynomials(forces, grid, gains.shape[-1]), strict=False)):
        pushes += math.factorial(j) * (h * phi)[which] * np.einsum("...ij,kj->k...i", gains, given)
    path = np.empty((grid.size, *q0.shape), complex)
    path[0] = q0
    for i, j in enumerate(which):
        np.multiply(growth[j], path[i], out=path[i + 1])
        path[i + 1] += pushes[i]
    return np.moveaxis(path[wanted], 0, -1)


def _phis(z: np.ndarray) -> Iterator[np.ndarray]:
    """``phi_1(z), phi_2(z), ...``: phi_0 = e^z and ``phi_(k+1) = (phi_k - 1/k!) / z``; near 0 the Taylor series."""
    small = np.abs(z) < 0.5
    safe, near = np.where(small, 1.0, z), np.where(small, z, 0.0)
    phi = np.expm1(safe) / safe
    for k in itertools.count(1):
        series = sum(near**i / math.factorial(i + k) for i in range(16))
        yield np.where(small, series, phi)
        phi = (phi - 1.0 / math.factorial(k)) / safe


def merged_grid(times: np.ndarray, forces: Sequence[Force]) -> np.ndarray:
    """Zero, the times, and between them those at which a force has a sample; increasing, shape (n,)."""
    return np.unique(np.concatenate([[0.0], times, *[f.times[f.times <= times[-1]] for f in forces]]))


def interval_polynomials(forces: Sequence[Force], grid: np.ndarray, n_dof: int) -> np.ndarray:
    """Coefficients of the force on each DOF over each interval of a grid that holds the forces' samples.

    Shape (degree + 1, n_intervals, n_dof), in powers of the part of the interval that has passed; from values inside
    the interval, since the force may jump at its ends.
    """
    degree = max((force.degree for force in forces), default=0)
    nodes = (np.arange(degree + 1) + 0.5) / (degree + 1)
    at = grid[:-1] + nodes[:, None] * np.diff(grid)
    total = np.zeros((degree + 1, grid.size - 1, n_dof))
    for force in forces:
        total[..., force.dof] += np.linalg.solve(np.vander(nodes, increasing=True), force(at))
    return total


def _by_steps(
    system: System, p: Mapping[str, Any], state: list[np.ndarray], times: np.ndarray, forces: Sequence[Force]
) -> np.ndarray:
    """Many sets at once, by steps of order four that are short enough for all of them."""
    grid = merged_grid(times, forces)
    pushes = interval_polynomials(forces, grid, system.n_dof)
    longest = longest_step(system, p, state)
    wanted = np.searchsorted(grid, times)
    path = np.empty((len(state), *state[0].shape, times.size))
    path[..., wanted == 0] = np.stack(state)[..., None]
    steps = np.maximum(1, np.ceil(np.diff(grid) / longest)).astype(int)
    if steps.sum() > MAX_STEPS:
        return np.full(path.shape, np.nan)
    for i, n in enumerate(steps):
        h = (grid[i + 1] - grid[i]) / n
        parts = (np.arange(n)[:, None] + np.array([0.0, 0.5, 1.0])) / n
        for at in polynomial.polyval(parts, pushes[:, i]).transpose(1, 2, 0).tolist():
            state = rk4_step(system, p, state, h, (at[0], at[1], at[2]), numpy_ops)
        path[..., wanted == i + 1] = np.stack(state)[..., None]
    return path


def _alone(
    system: System, p: Mapping[str, Any], state: list[np.ndarray], times: np.ndarray, forces: Sequence[Force]
) -> np.ndarray:
    """One set, by adaptive steps in plain numbers, which are several times faster than arrays of one."""
    grid = merged_grid(times, forces)
    pushes = interval_polynomials(forces, grid, system.n_dof)
    first = FIRST_STEP * STEPS_PER_RADIAN * longest_step(system, p, state)
    values, rest = {name: float(value) for name, value in p.items()}, [0.0] * system.n_dof

    def rate_over(i: int) -> Rate:
        if not forces:
            return lambda s, at: state_rate(system, values, s, rest, _float_ops)
        length, own = float(grid[i + 1] - grid[i]), pushes[:, i].T.tolist()
        return lambda s, at: state_rate(system, values, s, [_polynomial(c, at / length) for c in own], _float_ops)

    return integrate(rate_over, [float(s) for s in state], grid, np.searchsorted(grid, times), first, system.smooth)


def _polynomial(coefficients: Sequence[float], part: float) -> float:
    total = 0.0
    for c in reversed(coefficients):
        total = total * part + c
    return total


def _solve_floats(matrix: Sequence[Sequence[float]], rhs: Sequence[float]) -> list[float]:
    return list(np.linalg.solve(matrix, rhs).tolist())


_float_ops = cast(
    Ops,
    SimpleNamespace(
        sin=math.sin,
        cos=math.cos,
        tanh=math.tanh,
        exp=math.exp,
        abs=abs,
        where=lambda condition, a, b: a if condition else b,
        solve=_solve_floats,
    ),
)
"""The functions that a residual may call, for plain numbers."""


def longest_step(system: System, p: Mapping[str, Any], state: list[np.ndarray]) -> float:
    """A step that resolves the fastest rate of the system linearised at rest and at its start."""
    n = len(state)
    fastest = 0.0
    for level in (0.0, 1.0):
        at = [level * s for s in state]
        jacobian = np.empty((*state[0].shape, n, n))
        for j in range(n):
            size = 1e-6 * max(float(np.max(np.abs(state[j]), initial=0.0)), 1e-3)
            plus = _rate(system, p, [s + size * (i == j) for i, s in enumerate(at)])
            minus = _rate(system, p, [s - size * (i == j) for i, s in enumerate(at)])
            for i in range(n):
                jacobian[..., i, j] = (plus[i] - minus[i]) / (2 * size)
        if np.all(np.isfinite(jacobian)):
            fastest = max(fastest, float(np.max(np.abs(np.linalg.eigvals(jacobian)), initial=0.0)))
    return 1.0 / (STEPS_PER_RADIAN * fastest) if fastest > 0 else np.inf


def _rate(system: System, p: Mapping[str, Any], state: list[np.ndarray]) -> list[np.ndarray]:
    n = system.n_dof
    zero = [0.0] * n
    x, v, z = state[:n], state[n : 2 * n], state[2 * n :]
    hidden = system.hidden_rates(p, x, v, zero, z, numpy_ops)
    return [*v, *acceleration(system, p, x, v, zero, z, numpy_ops), *hidden]


@dataclass(frozen=True, eq=False)
class SimulatedResponse:
    """The simulated displacement as a function of time: a reconstruction that can be pickled."""

    system: System
    parameters: Mapping[str, float]
    start: InitialState
    forces: tuple[Force, ...] = ()

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Displacement (m), shape (n_dof, n_times), at increasing times (s)."""
        return simulate(self.system, self.parameters, self.start, times, self.forces).displacement


def fitted_start(system: System, p: Mapping[str, float], record: Record) -> InitialState:
    """The initial state that fits a record best at given parameters: the told one, or least squares on the data.

    Gauss-Newton on the simulated measurements by finite differences of the start; one step solves a linear system,
    where the response is affine in the start. Offsets of channels are fitted along.
    """
    if record.initial_state is not None:
        return record.initial_state
    n = system.n_dof
    size = max(float(np.max(np.abs(c.values), initial=0.0)) for c in record.channels) or 1.0
    theta = np.zeros(2 * n)
    offsets = [c for c in record.channels if c.offset]
    time = record.duration
    scale = np.concatenate([np.full(n, size), np.full(n, size / time)])
    y = np.concatenate([c.values for c in record.channels])
    constants = np.array([[float(c is o) for o in offsets] for c in record.channels for _ in range(c.n)]).reshape(
        y.size, -1
    )
    for _ in range(1 if system.linear else 5):
        trial = theta[:, None] + np.concatenate([np.zeros((2 * n, 1)), 1e-3 * np.diag(scale)], axis=1)
        p_sets = {name: np.full(2 * n + 1, value) for name, value in p.items()}
        predicted = measurements(system, p_sets, (trial[:n], trial[n:]), record)
        if not np.all(np.isfinite(predicted)):
            break
        jacobian = (predicted[1:] - predicted[0]).T / (1e-3 * scale)
        solution, *_ = np.linalg.lstsq(np.hstack([jacobian * scale, size * constants]), y - predicted[0], rcond=1e-12)
        theta = theta + scale * solution[: 2 * n]
    return InitialState(theta[:n], theta[n:])


def measurements(
    system: System, p: Mapping[str, Any], start: InitialState | tuple[np.ndarray, np.ndarray], record: Record
) -> np.ndarray:
    """Ideal measurements of all channels of a record, channel after channel, shape (*sets, n_samples).

    Sensors that are read at the same times share one simulation.
    """
    rig, motions, parts = record.rig(system), dict[bytes, Motion](), []
    for channel in record.channels:
        key = channel.times.tobytes()
        if key not in motions:
            motions[key] = simulate(rig, p, start, channel.times, record.forces)
        parts.append(motions[key].measured(rig, p, channel, record))
    return np.concatenate(parts, axis=-1)


def matrix_exponential_response(
    system: System, p: Mapping[str, float], start: InitialState, times: np.ndarray, forces: Sequence[Force] = ()
) -> np.ndarray:
    """Displacement of a linear system, shape (n_dof, n_times), by matrix exponentials with the exact hold of the force.

    The augmented-matrix form of the hold (C. F. Van Loan, IEEE Trans. Automatic Control 23:395, 1978): with
    ``f`` a polynomial over an interval, the state, the force and its derivatives obey one constant-coefficient system.
    """
    from scipy.linalg import expm  # slow to import, and few need it

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
