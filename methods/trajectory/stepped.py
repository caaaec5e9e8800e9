"""The likelihood of problems of any system, by Runge-Kutta steps with their derivatives, evaluated by CasADi.

The steps are those of multiple shooting: cuts at every sample and every knot of a force, and between them as many steps
as frequency and noise call for. So the maximum is that of its programme.

One step maps the state and its derivatives by the log-parameters (and by the initial state) to those at its end: the
classical step of order four, differentiated symbolically. A set of parameters is carried along all steps in one call
and by itself: the other sets of a batch change nothing. Where a system bends suddenly, as a modulus does, the
derivative is that of the side on which the state is, as in the programme.

CasADi's evaluation needs no compiler, and takes as long for a set of parameters alone as in a batch: 0.2 ms for a
Duffing oscillator over 160 steps, in processor time on one core. For a hundred sets numpy takes 0.15 ms each by central
differences, but 15 ms for one set; jax 0.07 ms each, but it compiles for a second for each number of sets and of steps,
and both change from one iteration of a search to the next.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Self

import numpy as np

from bench import OutputError, Steps, System, acceleration, rk4_step
from methods.trajectory.fineness import Fineness, roughly
from methods.trajectory.programme import Plan, casadi_ops, state_size


@dataclass(frozen=True, eq=False)
class SteppedOutputError(OutputError):
    """The likelihood of a problem whose motion is integrated by ``substeps`` steps in each interval; 1 at first."""

    fineness: Fineness = field(kw_only=True)

    per_problem: ClassVar[tuple[str, ...]] = (*OutputError.per_problem, "substeps")

    @cached_property
    def substeps(self) -> np.ndarray:
        return np.ones((), int)

    @cached_property
    def _plans(self) -> tuple[Plan, ...]:
        return tuple(Plan(self.system, record) for record in self.problem.records)

    @property
    def _longest(self) -> float:
        return max(plan.longest for plan in self._plans)

    def jacobian(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Predictions (cases, N) and the derivatives (cases, N, size) of the steps, at ``theta`` (cases, size)."""
        return self._assembled(theta)

    def readings_and_slopes(
        self, number: int, p: dict[str, np.ndarray], state: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """What the sensors of a record would show, and its derivatives, by each case's own number of steps."""
        values = np.stack([p[name] for name in self.system.names], axis=1)
        counts = np.broadcast_to(self.substeps, len(values))
        groups = [np.flatnonzero(counts == count) for count in np.unique(counts)]
        parts = [self._shown(number, int(counts[group[0]]), values[group], state[group]) for group in groups]
        shown = np.concatenate(parts)[np.argsort(np.concatenate(groups))]
        return shown[..., 0], shown[..., 1:]

    def _shown(self, number: int, count: int, p: np.ndarray, start: np.ndarray) -> np.ndarray:
        """Readings and derivatives of some cases by ``count`` steps an interval, shape (cases, N, 1 + q)."""
        plan, record, n = self._plans[number], self.problem.records[number], self.system.n_dof
        rig = record.rig(self.system)
        steps = Steps.over(plan.grid, np.full(plan.steps.size, count), record.forces, n)
        path = stepped_motion(rig, p, start, steps, record.initial_state is None)
        parts = []
        for channel, at, force in zip(record.channels, plan.at, plan.sensor_forces, strict=True):
            states = path[:, at]
            if channel.measures == "acceleration":
                parts.append(stepped_accelerations(rig, p, states, force.T, channel.dof))
            else:
                parts.append(states[..., channel.dof + (n if channel.measures == "velocity" else 0)])
        return np.concatenate(parts, axis=1)

    def for_screening(self, cases: np.ndarray, theta: np.ndarray) -> Self:
        """The same with as many steps as it takes to compare initial guesses ``theta``."""
        counts = roughly(self, self._longest, theta, self[cases].states(theta))
        return self._with(cases, counts, np.ones_like(self.substeps))

    def refined(self, cases: np.ndarray, theta: np.ndarray, sigma: np.ndarray) -> Self:
        """The same with as many steps as answers near ``theta`` need, for all cases of a problem alike."""
        return self._with(cases, self._wanted(cases, theta, sigma), self.substeps)

    def coarse(self, cases: np.ndarray, theta: np.ndarray, sigma: np.ndarray) -> np.ndarray:
        """Whether an answer at ``theta`` needs more steps, shape (cases,)."""
        return np.asarray(self._wanted(cases, theta, sigma) > self.substeps[cases])

    def _wanted(self, cases: np.ndarray, theta: np.ndarray, sigma: np.ndarray) -> np.ndarray:
        chosen = self[cases]
        return self.fineness.substeps(self, self._longest, theta, chosen.states(theta), sigma, chosen.rms)

    def _with(self, cases: np.ndarray, counts: np.ndarray, least: np.ndarray) -> Self:
        wanted = least.copy()
        np.maximum.at(wanted, cases, counts)
        if np.array_equal(wanted, self.substeps):
            return self
        finer = copy(self)
        finer.__dict__["substeps"] = wanted
        return finer


@lru_cache(maxsize=64)
def _step(system: System, by_start: int) -> Any:
    """One step: (state and derivatives, parameters, length, forces at start, middle and end) -> the same at its end."""
    import casadi as ca

    n, names, size = system.n_dof, system.names, state_size(system)
    s, p, h, f = ca.SX.sym("s", size), ca.SX.sym("p", len(names)), ca.SX.sym("h"), ca.SX.sym("f", n, 3)
    start, middle, end = ([f[i, j] for i in range(n)] for j in range(3))
    given = dict(zip(names, ca.vertsplit(p), strict=True))
    after = ca.vertcat(*rk4_step(system, given, ca.vertsplit(s), h, (start, middle, end), casadi_ops()))
    return _with_slopes(system, by_start, (s, p, [h, f]), after)


@lru_cache(maxsize=64)
def _acceleration(system: System, dof: int, by_start: int) -> Any:
    """What an accelerometer shows and its derivatives: (state and derivatives, parameters, forces) -> (1, 1 + q)."""
    import casadi as ca

    n, names, size = system.n_dof, system.names, state_size(system)
    s, p, f = ca.SX.sym("s", size), ca.SX.sym("p", len(names)), ca.SX.sym("f", n)
    x, v, z = (ca.vertsplit(s)[i:j] for i, j in ((0, n), (n, 2 * n), (2 * n, size)))
    given = dict(zip(names, ca.vertsplit(p), strict=True))
    a = acceleration(system, given, x, v, ca.vertsplit(f), z, casadi_ops())[dof]
    return _with_slopes(system, by_start, (s, p, [f]), a)


def _with_slopes(system: System, by_start: int, inputs: tuple[Any, Any, list[Any]], value: Any) -> Any:
    """The function of state *and* derivatives that follows from a function of the state, by directional derivatives."""
    import casadi as ca

    (s, p, others), k = inputs, len(system.names)
    slopes = ca.SX.sym("slopes", state_size(system), k + by_start)
    directions = ca.vertcat(slopes, ca.horzcat(ca.diag(p), ca.SX(k, by_start)))
    both = ca.horzcat(value, ca.jtimes(value, ca.vertcat(s, p), directions))
    return ca.Function("carried", [ca.horzcat(s, slopes), p, *others], [ca.densify(both)], {"cse": True})


@lru_cache(maxsize=64)
def _steps(system: System, by_start: int, number: int) -> Any:
    return _step(system, by_start).mapaccum(number)


@lru_cache(maxsize=64)
def _accelerations(system: System, dof: int, by_start: int, number: int) -> Any:
    return _acceleration(system, dof, by_start).map(number)


def stepped_motion(system: System, p: np.ndarray, start: np.ndarray, steps: Steps, by_start: bool) -> np.ndarray:
    """The states at the points of the grid of steps and their derivatives, set by set.

    Args:
        system: any.
        p: the parameters in the system's order, shape (sets, n_parameters).
        start: displacements, then velocities, shape (sets, 2 n_dof); hidden states start at zero.
        steps: from time 0.
        by_start: whether the derivatives by the start are wanted, too.

    Returns:
        The states, then their derivatives by the log-parameters and by the start, shape (sets, n_grid, 1 + q, n_state);
        not finite where the motion diverges.
    """
    sets, moving = start.shape
    k, own, number = p.shape[1], moving if by_start else 0, steps.lengths.size
    first = np.zeros((sets, 1 + k + own, state_size(system)))
    first[:, 0, :moving] = start
    first[:, 1 + k :, :moving] = np.eye(own, moving)
    path = np.empty((sets, steps.reached.size, *first.shape[1:]))
    path[:, 0] = first
    if number:
        values = np.repeat(p[:, None], number, axis=1)
        given = [first, values, steps.lengths, steps.forces]
        for place, after in zip(path, _evaluated(_steps(system, own, number), given, (2, 3)), strict=True):
            place[1:] = after.reshape(number, *first.shape[1:])[steps.reached[1:] - 1]
    return path


def stepped_accelerations(
    system: System, p: np.ndarray, states: np.ndarray, forces: np.ndarray, dof: int
) -> np.ndarray:
    """The acceleration of a DOF and its derivatives, shape (sets, n, 1 + q), at ``states`` (sets, n, 1 + q, n_state).

    ``forces`` (n, n_dof) act then; ``p`` as in :func:`stepped_motion`.
    """
    sets, number, columns, _ = states.shape
    shown = np.empty((sets, number, columns))
    if number:
        function = _accelerations(system, dof, columns - 1 - p.shape[1], number)
        given = [states, np.repeat(p[:, None], number, axis=1), forces]
        for place, found in zip(shown, _evaluated(function, given, (2,)), strict=True):
            place[:] = found.reshape(number, columns)
    return shown


def _evaluated(function: Any, inputs: list[np.ndarray], shared: tuple[int, ...]) -> Iterator[np.ndarray]:
    """What a function gives for one set after the other, in one array; ``shared`` inputs are the same for all."""
    buffer, evaluate = function.buffer()
    result = np.empty(function.nnz_out(0))
    buffer.set_res(0, result.data)
    inputs = [np.ascontiguousarray(given, dtype=float) for given in inputs]
    for i in shared:
        buffer.set_arg(i, inputs[i].data)
    for case in range(len(inputs[0])):
        for i, given in enumerate(inputs):
            if i not in shared:
                buffer.set_arg(i, given[case].data)
        evaluate()
        yield result
