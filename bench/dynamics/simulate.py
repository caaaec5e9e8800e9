"""Simulation of systems for methods and scoring, vectorised over parameter sets.

Linear systems are solved exactly in time (:mod:`bench.dynamics.linear_motion`). A single motion of a nonlinear system
is integrated by LSODA to a relative accuracy of about 1e-9, also for non-smooth equations; several sets at once by
Runge-Kutta steps of order four to about 1e-5, with the same steps for all sets, so that their differences are smooth.
True motions are integrated separately (:mod:`bench.scenario.truth`).
"""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.contract.problem import Force, InitialState, Record
from bench.dynamics.intervals import Steps, interval_polynomials, merged_grid, sample_times, step_counts
from bench.dynamics.linear_motion import linear_motion
from bench.dynamics.mechanics import acceleration, state_rate
from bench.dynamics.ops import float_ops, numpy_ops
from bench.dynamics.rates import longest_step
from bench.dynamics.stepper import rk4_path
from bench.systems import System

MAX_STEPS = 200_000
"""Largest number of Runge-Kutta steps; a motion that needs more is not finite."""
LONG_GRID = 200
"""Number of evenly spaced times from which free motions of one mass are superposed, which is faster."""
TOLERANCE = 1e-10
"""Local error tolerance of LSODA, relative to a component and to the largest component of the initial state."""
START_STEPS, PART = 5, 1e-3
"""Gauss-Newton steps for an initial state, and its finite difference relative to the size of the motion."""
MAX_RATES = 500_000
"""Evaluations of the equation of motion after which LSODA is stopped, after some seconds."""


@dataclass(frozen=True, eq=False)
class SimulatedMotion:
    """Simulated motion.

    Attributes:
        displacement: Displacement (m), shape (n_dof, *sets, n_times).
        velocity: Velocity (m/s), shape (n_dof, *sets, n_times).
        hidden: Hidden states, shape (n_hidden, *sets, n_times).
    """

    displacement: np.ndarray
    velocity: np.ndarray
    hidden: np.ndarray

    def readings(self, system: System, p: Mapping[str, Any], record: Record) -> np.ndarray:
        """Return noise-free sensor values without offsets.

        Args:
            system: System of the motion.
            p: Parameters by name, as for the simulation.
            record: Record at whose :func:`sample_times` the motion was simulated.

        Returns:
            Values, channel after channel, shape (*sets, n_samples).
        """
        by_kind: dict[str, Any] = {"displacement": self.displacement, "velocity": self.velocity}
        times, places = sample_times(record)
        if any(channel.measures == "acceleration" for channel in record.channels):
            expanded = {name: np.asarray(value)[..., None] for name, value in p.items()}
            x, v, z = map(list, (self.displacement, self.velocity, self.hidden))
            force = record.force(times, system.n_dof)
            by_kind["acceleration"] = acceleration(system, expanded, x, v, force, z, numpy_ops)
        channels = zip(record.channels, places, strict=True)
        return np.concatenate([by_kind[c.measures][c.dof][..., where] for c, where in channels], axis=-1)


def simulate(
    system: System,
    p: Mapping[str, Any],
    start: InitialState | tuple[np.ndarray, np.ndarray],
    times: np.ndarray,
    forces: Sequence[Force] = (),
) -> SimulatedMotion:
    """Simulate the response from an initial state.

    Args:
        system: The system.
        p: Parameters by name, floats or arrays of one shape ``sets``.
        start: Initial state at time 0; or displacement and velocity, each of shape (n_dof, *sets).
        times: Increasing times >= 0 (s), shape (n_times,).
        forces: Known forces.

    Returns:
        The motion; not finite where it diverges.
    """
    x0, v0 = (start.displacement, start.velocity) if isinstance(start, InitialState) else start
    sets = np.broadcast_shapes(*(np.shape(v) for v in p.values()), np.shape(x0)[1:], np.shape(v0)[1:])
    state = [_spread(part[i], sets) for part in (x0, v0) for i in range(system.n_dof)]
    p = {name: _spread(value, sets) for name, value in p.items()}
    times = np.asarray(times, float)
    with np.errstate(all="ignore"):
        if system.linear:
            flat = {name: value.ravel() for name, value in p.items()}
            motion, _ = linear_motion(system, flat, np.stack(state, -1).reshape(-1, len(state)), times, forces, False)
            path = motion.transpose(2, 0, 1).reshape(-1, *sets, times.size)
        else:
            state += [np.zeros(sets) for _ in range(system.n_hidden)]
            path = (_many if sets else _alone)(system, p, state, times, forces)
    n = system.n_dof
    return SimulatedMotion(path[:n], path[n : 2 * n], path[2 * n :])


def displacements(
    system: System,
    p: Mapping[str, np.ndarray],
    starts: Sequence[InitialState],
    grids: Sequence[np.ndarray],
    forces: Sequence[Sequence[Force]],
) -> list[np.ndarray]:
    """Simulate n motions of one system, each with the accuracy of a single :func:`simulate`.

    Args:
        system: The system.
        p: Parameters by name, each of shape (n,).
        starts: Initial state of each motion.
        grids: Grids of times (s), increasing also from one grid to the next.
        forces: Known forces of each motion.

    Returns:
        Displacements (m) on each grid, shape (n, n_dof, n_times); not finite where the motion diverges.
    """
    times, first = np.concatenate(grids), forces[0] if forces else ()
    state = np.array([s.displacement for s in starts]).T, np.array([s.velocity for s in starts]).T
    if system.linear and system.n_dof == 1 and not any(forces):
        return [_free_motions(system, p, state, grid)[:, None] for grid in grids]
    if system.linear and all(_alike(first, other) for other in forces):
        paths = np.moveaxis(simulate(system, p, state, times, first).displacement, 0, 1)
    else:
        each = [{name: values[i] for name, values in p.items()} for i in range(len(starts))]
        motions = zip(each, starts, forces, strict=True)
        paths = np.stack([simulate(system, q, start, times, acting).displacement for q, start, acting in motions])
    return np.split(paths, np.cumsum([grid.size for grid in grids])[:-1], axis=2)


def _alike(forces: Sequence[Force], others: Sequence[Force]) -> bool:
    return len(forces) == len(others) and all(
        (a.dof, a.hold) == (b.dof, b.hold) and np.array_equal(a.times, b.times) and np.array_equal(a.values, b.values)
        for a, b in zip(forces, others, strict=True)
    )


def _free_motions(
    system: System, p: Mapping[str, np.ndarray], start: tuple[np.ndarray, np.ndarray], times: np.ndarray
) -> np.ndarray:
    """Compute displacements of a free linear system of one mass, shape (n, n_times).

    The motion from a state is a superposition of the motions from unit displacement and unit velocity. On a long
    uniform grid states are computed at every ``stride``-th time and superposed in between, with fewer sines.
    """
    even = np.linspace(times[0], times[-1], times.size)
    if times.size < LONG_GRID or np.max(np.abs(times - even)) > 4.0 * np.finfo(float).eps * times[-1]:
        return simulate(system, p, start, times).displacement[0]
    stride = math.isqrt(times.size)
    states = simulate(system, p, start, times[::stride])
    unit, zero = np.ones_like(start[0]), np.zeros_like(start[0])
    by_displacement = simulate(system, p, (unit, zero), times[:stride] - times[0]).displacement[0]
    by_velocity = simulate(system, p, (zero, unit), times[:stride] - times[0]).displacement[0]
    with np.errstate(all="ignore"):
        path = states.displacement[0][..., None] * by_displacement[:, None]
        path += states.velocity[0][..., None] * by_velocity[:, None]
    return path.reshape(len(path), -1)[:, : times.size]


def _spread(value: Any, shape: tuple[int, ...]) -> np.ndarray:
    array = np.asarray(value, float)
    return array if array.shape == shape else np.broadcast_to(array, shape)


def _many(
    system: System, p: Mapping[str, Any], state: list[np.ndarray], times: np.ndarray, forces: Sequence[Force]
) -> np.ndarray:
    """Integrate several sets together by Runge-Kutta steps that resolve all of them."""
    grid = merged_grid(times, forces)
    counts = step_counts(grid, longest_step(system, p, state))
    if counts.sum() > MAX_STEPS:
        return np.full((len(state), *state[0].shape, times.size), np.nan)
    steps = Steps.over(grid, counts, forces, system.n_dof)
    return rk4_path(system, p, state, steps, np.searchsorted(grid, times))


def _alone(
    system: System, p: Mapping[str, Any], state: list[np.ndarray], times: np.ndarray, forces: Sequence[Force]
) -> np.ndarray:
    """Integrate one set by LSODA between the knots of the forces; not finite after the motion diverges.

    LSODA (L. Petzold, SIAM J. Sci. Stat. Comput. 4:136, 1983) is a multistep method, unlike the integrator of the true
    motion, so that no method fits with the integrator that generated its data.
    """
    from scipy.integrate import odeint  # slow to import, not needed by linear systems

    values, left = {name: float(value) for name, value in p.items()}, MAX_RATES
    knots = merged_grid(times[-1:], forces)
    pushes, passed = interval_polynomials(forces, knots, system.n_dof), np.searchsorted(times, knots, "right").tolist()
    path, now = np.full((len(state), times.size), np.nan), np.array(state, float)
    path[:, : passed[0]] = now[:, None]
    tolerances = {"rtol": TOLERANCE, "atol": TOLERANCE * float(np.max(np.abs(now))) or TOLERANCE}

    def rate(state: np.ndarray, time: float, begin: float, length: float, polynomials: list[list[float]]) -> list[Any]:
        nonlocal left
        left -= 1
        part, push = (time - begin) / length, [0.0] * system.n_dof
        for dof, polynomial in enumerate(polynomials):
            for coefficient in polynomial:
                push[dof] = push[dof] * part + coefficient
        try:
            return state_rate(system, values, state.tolist(), push, float_ops) if left > 0 else [math.nan] * len(state)
        except (ArithmeticError, ValueError):
            return [math.nan] * len(state)

    for i, (begin, end) in enumerate(itertools.pairwise(knots.tolist())):
        inside = slice(passed[i], passed[i + 1])
        wanted = np.concatenate([[begin], times[inside], [end]])
        given = begin, end - begin, pushes[::-1, i].T.tolist()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # times that are not reached become NaN
            states, report = odeint(rate, now, wanted, given, mxstep=MAX_RATES, full_output=True, **tolerances)
        states[1:][report["tcur"] < wanted[1:]] = np.nan
        path[:, inside], now = states[1:-1].T, states[-1]
        if not np.all(np.isfinite(now)):
            break
    return path


@dataclass(frozen=True, eq=False)
class SimulatedResponse:
    """Simulated displacement as a function of time, a picklable reconstruction.

    Attributes:
        system: The system.
        parameters: Parameters by name.
        start: Initial state.
        forces: Known forces.
    """

    system: System
    parameters: Mapping[str, float]
    start: InitialState
    forces: tuple[Force, ...] = ()

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Simulate the displacement (m), shape (n_dof, n_times), at increasing times (s)."""
        return simulate(self.system, self.parameters, self.start, times, self.forces).displacement


def fit_initial_state(system: System, p: Mapping[str, float], record: Record) -> InitialState:
    """Estimate the initial state of a record at given parameters by least squares.

    Gauss-Newton steps with finite differences of the state, together with unknown offsets; for a linear system, whose
    response is affine in the state, one step is exact.

    Args:
        system: The system.
        p: Parameters by name.
        record: The record.

    Returns:
        The estimated initial state, or the known one.
    """
    if record.initial_state is not None:
        return record.initial_state
    n, state = system.n_dof, np.zeros(2 * system.n_dof)
    size = max(float(np.max(np.abs(c.values), initial=0.0)) for c in record.channels) or 1.0
    scale = np.repeat([size, size / record.duration], n)
    values = np.concatenate([c.values for c in record.channels])
    channel_of = np.repeat(np.arange(len(record.channels)), [c.n for c in record.channels])
    offsets = size * (channel_of[:, None] == [i for i, c in enumerate(record.channels) if c.offset])
    sets = {name: np.full(2 * n + 1, value) for name, value in p.items()}
    for _ in range(1 if system.linear else START_STEPS):
        trial = state[:, None] + np.concatenate([np.zeros((2 * n, 1)), PART * np.diag(scale)], axis=1)
        predicted = measurements(system, sets, (trial[:n], trial[n:]), record)
        if not np.all(np.isfinite(predicted)):
            break
        slopes = (predicted[1:] - predicted[0]).T / PART
        solution, *_ = np.linalg.lstsq(np.hstack([slopes, offsets]), values - predicted[0], rcond=1e-12)
        state = state + scale * solution[: 2 * n]
    return InitialState(state[:n], state[n:])


def measurements(
    system: System, p: Mapping[str, Any], start: InitialState | tuple[np.ndarray, np.ndarray], record: Record
) -> np.ndarray:
    """Simulate noise-free measurements of all channels of a record.

    Args:
        system: The system.
        p: Parameters by name, floats or arrays of one shape ``sets``.
        start: Initial state; or displacement and velocity, each of shape (n_dof, *sets).
        record: Record with channels, known forces and added masses.

    Returns:
        Values, channel after channel, shape (*sets, n_samples).
    """
    rig, (times, _) = record.rig(system), sample_times(record)
    return simulate(rig, p, start, times, record.forces).readings(rig, p, record)
