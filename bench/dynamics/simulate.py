"""The response of a system, vectorised over parameter sets, for methods and for scoring.

Linear systems by superposition of their modes, exact in time. One motion of another system by adaptive Runge-Kutta
steps of order eight (:mod:`bench.dynamics.integrator`), to about 1e-8 of its largest value even where rates have
kinks; many at once by steps of order four, to about 1e-5 of it, alike for all sets, so that their differences are
smooth. The truth is never made here (see :mod:`bench.scenario.truth`), nor the sensitivities of a bound (see
:mod:`bench.information.fisher`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.contract.problem import Channel, Force, InitialState, Record
from bench.dynamics.fixed_step import Steps, rk4_path, step_counts
from bench.dynamics.integrator import Rate, integrate
from bench.dynamics.intervals import interval_polynomials, merged_grid
from bench.dynamics.linear_response import linear_response
from bench.dynamics.mechanics import acceleration, state_rate
from bench.dynamics.ops import float_ops, numpy_ops
from bench.dynamics.rates import fastest_rates
from bench.systems import System

STEPS_PER_RADIAN = 20
MAX_STEPS = 200_000
LONG_GRID = 200
"""Evenly spaced times from which on free motions of one mass are superposed rather than simulated at each time."""
FIRST_STEP = 0.5
"""The first step of an integration, in radians of the fastest rate at its start."""


@dataclass(frozen=True, eq=False)
class SimulatedMotion:
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
) -> SimulatedMotion:
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
            path = linear_response(system, p, np.stack(state, -1), times, forces)
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
    """Simulate many motions of one system, each as accurate as :func:`simulate` makes it alone.

    Args:
        system: The system of all of them.
        p: Its parameters, each of shape (n,).
        starts: Their states at time 0.
        grids: Where they are wanted (s): times that increase from one grid to the next.
        forces: The forces of each.

    Returns:
        Displacements (m) on each grid, shape (n, n_dof, n_times). Those that diverge are not finite.
    """
    if system.linear and system.n_dof == 1 and not any(forces):
        state = np.array([s.displacement for s in starts]).T, np.array([s.velocity for s in starts]).T
        free = [_free_motions(system, p, state, times)[:, None] for times in grids]
        if all(np.all(np.isfinite(path)) for path in free):  # one that diverges takes the others along
            return free
    paths = []
    for i, (start, own) in enumerate(zip(starts, forces, strict=True)):
        parameters = {name: values[i] for name, values in p.items()}
        paths.append(simulate(system, parameters, start, np.concatenate(grids), own).displacement)
    return np.split(np.stack(paths), np.cumsum([times.size for times in grids])[:-1], axis=2)


def _free_motions(
    system: System, p: Mapping[str, np.ndarray], start: tuple[np.ndarray, np.ndarray], times: np.ndarray
) -> np.ndarray:
    """Compute displacements of a free linear system of one mass, shape (n, n_times).

    The motion from a state is its displacement and velocity times the motions from a unit of each. So on a long, even
    grid the states at one time in ``stride`` and these two motions in between give all of it, with few sines.
    """
    even = np.linspace(times[0], times[-1], times.size)
    if times.size < LONG_GRID or np.max(np.abs(times - even)) > 4.0 * np.finfo(float).eps * times[-1]:
        return simulate(system, p, start, times).displacement[0]
    stride = math.isqrt(times.size)
    states = simulate(system, p, start, times[::stride])
    one, none = np.ones_like(start[0]), np.zeros_like(start[0])
    by_displacement = simulate(system, p, (one, none), times[:stride] - times[0]).displacement[0]
    by_velocity = simulate(system, p, (none, one), times[:stride] - times[0]).displacement[0]
    with np.errstate(all="ignore"):
        path = states.displacement[0][..., None] * by_displacement[:, None]
        path += states.velocity[0][..., None] * by_velocity[:, None]
    return path.reshape(len(path), -1)[:, : times.size]


def _spread(value: Any, shape: tuple[int, ...]) -> np.ndarray:
    array = np.asarray(value, float)
    return array if array.shape == shape else np.broadcast_to(array, shape)


def longest_step(system: System, p: Mapping[str, Any], state: Sequence[np.ndarray]) -> float:
    """Choose a step (s) that resolves the fastest rate of the system at rest and at a state, over all sets.

    Of the two, one at which the rate of any set is not finite does not count; infinite where nothing moves.
    """
    rates = fastest_rates(system, p, np.stack(state)).reshape(2, -1)
    fastest = float(np.max(rates[np.all(np.isfinite(rates), axis=1)], initial=0.0))
    return 1.0 / (STEPS_PER_RADIAN * fastest) if fastest > 0 else np.inf


def _many(
    system: System, p: Mapping[str, Any], state: list[np.ndarray], times: np.ndarray, forces: Sequence[Force]
) -> np.ndarray:
    """Many sets at once, by steps of order four that are short enough for all of them."""
    grid = merged_grid(times, forces)
    counts = step_counts(grid, longest_step(system, p, state))
    if counts.sum() > MAX_STEPS:
        return np.full((len(state), *state[0].shape, times.size), np.nan)
    steps = Steps.over(grid, counts, forces, system.n_dof)
    return rk4_path(system, p, state, steps, np.searchsorted(grid, times))


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
            return lambda s, at: state_rate(system, values, s, rest, float_ops)
        length, own = float(grid[i + 1] - grid[i]), pushes[:, i].T.tolist()
        return lambda s, at: state_rate(system, values, s, [_polynomial(c, at / length) for c in own], float_ops)

    return integrate(rate_over, [float(s) for s in state], grid, np.searchsorted(grid, times), first, system.smooth)


def _polynomial(coefficients: Sequence[float], part: float) -> float:
    total = 0.0
    for c in reversed(coefficients):
        total = total * part + c
    return total


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
    rig, motions, parts = record.rig(system), dict[bytes, SimulatedMotion](), []
    for channel in record.channels:
        key = channel.times.tobytes()
        if key not in motions:
            motions[key] = simulate(rig, p, start, channel.times, record.forces)
        parts.append(motions[key].measured(rig, p, channel, record))
    return np.concatenate(parts, axis=-1)
