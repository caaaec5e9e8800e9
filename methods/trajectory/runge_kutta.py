"""The likelihood of any system by Runge-Kutta steps with sensitivities, evaluated by CasADi.

There is a node at every sample and every knot of a force; the number of steps between nodes follows from frequency and
noise, so that the error over a record is below the limit (:func:`methods.starts.integration.radians_a_step`).

One classical step of order four, differentiated symbolically, maps the state and its derivatives by the log-parameters
(and by the initial state) to those at its end. Each set of parameters is integrated independently of the batch. At a
kink of the equation of motion, the derivative is one-sided. CasADi requires no compiler, and takes the same time per
set of parameters in a batch as alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Self, cast

import numpy as np

from bench import Ops, OutputError, Record, Steps, System, fastest_rates, ops_from, rk4
from methods.starts.integration import radians_a_step

SUBSTEPS = np.array([1, 2, 3, *(n * 2**i for i in range(5) for n in (4, 6)), 128])
"""Possible numbers of steps between two nodes; few, so that few functions are built."""
ROUGH_RADIANS = 0.4
"""Step for comparing guesses, in radians of the fastest rate, with a relative phase error of 1/5000."""
ROUGHLY = 64
"""Largest number of steps between nodes for comparing guesses; faster motions are no useful guesses."""
DIFFERENCE = 1e-6
"""Step of the finite differences for rates, in natural units."""


@dataclass(frozen=True, eq=False)
class Cuts:
    """The shooting nodes of a record at times ``grid``, and the node of each sample of each channel."""

    grid: np.ndarray
    samples: tuple[np.ndarray, ...]

    @staticmethod
    def of(record: Record) -> Cuts:
        """Place nodes at every sample and every knot of a force."""
        knots = [f.times[f.times < record.duration] for f in record.forces]
        grid = np.unique(np.concatenate([[0.0], *[c.times for c in record.channels], *knots]))
        # merge nodes that differ by rounding only
        grid = grid[np.concatenate([[True], np.diff(grid) > 1e-11 * max(record.duration, 1e-300)])]
        return Cuts(grid, tuple(np.abs(grid - c.times[:, None]).argmin(axis=1) for c in record.channels))


@dataclass(frozen=True, eq=False)
class SteppedOutputError(OutputError):
    """The likelihood of a problem whose motion is integrated by ``substeps`` steps between two nodes, initially 1.

    The error of the integration is at most ``integration_error`` of the motion, or ``noise_share`` of the data's
    standard error, whichever is larger.
    """

    integration_error: float = 1e-8
    noise_share: float = 0.05

    per_problem: ClassVar[tuple[str, ...]] = (*OutputError.per_problem, "substeps")

    @cached_property
    def substeps(self) -> np.ndarray:
        return np.ones((), int)

    @cached_property
    def cuts(self) -> tuple[Cuts, ...]:
        return tuple(Cuts.of(record) for record in self.problem.records)

    def steps(self, number: int, count: int) -> Steps:
        """Return ``count`` steps between the nodes of record ``number``."""
        grid, record = self.cuts[number].grid, self.problem.records[number]
        return Steps.over(grid, np.full(grid.size - 1, count), record.forces, self.system.n_dof)

    @property
    def exact_slopes(self) -> bool:
        """Return True: sensitivities of the steps are exact."""
        return True

    def readings_and_slopes(
        self, number: int, p: dict[str, np.ndarray], state: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the simulated measurements of a record and their derivatives."""
        values = np.stack([p[name] for name in self.system.names], axis=1)
        counts = np.broadcast_to(self.substeps, len(values))
        groups = [np.flatnonzero(counts == count) for count in np.unique(counts)]
        parts = [self._shown(number, int(counts[group[0]]), values[group], state[group]) for group in groups]
        shown = np.concatenate(parts)[np.argsort(np.concatenate(groups))]
        return shown[..., 0], shown[..., 1:]

    def _shown(self, number: int, count: int, p: np.ndarray, start: np.ndarray) -> np.ndarray:
        """Return measurements and derivatives of some cases by ``count`` steps between nodes, (cases, N, 1 + q)."""
        record, n = self.problem.records[number], self.system.n_dof
        rig = record.rig(self.system)
        path = stepped_motion(rig, p, start, self.steps(number, count), record.initial_state is None)
        parts = []
        for channel, places in zip(record.channels, self.cuts[number].samples, strict=True):
            states = path[:, places]
            if channel.measures == "acceleration":
                parts.append(stepped_accelerations(rig, p, states, forces_at(record, channel.times, n), channel.dof))
            else:
                parts.append(states[..., channel.dof + (n if channel.measures == "velocity" else 0)])
        return np.concatenate(parts, axis=1)

    def for_screening(self, cases: np.ndarray, theta: np.ndarray) -> Self:
        """Return the model with enough steps to compare initial guesses ``theta``."""
        counts = np.minimum(self._longest * self._fastest(cases, theta) / ROUGH_RADIANS, ROUGHLY)
        return self._with(cases, _up(counts), np.ones_like(self.substeps))

    def refined(self, cases: np.ndarray, theta: np.ndarray, sigma: np.ndarray) -> Self:
        """Return the model with enough steps for estimates near ``theta``, equal for all cases of a problem."""
        return self._with(cases, self.needed(cases, theta, sigma), self.substeps)

    def coarse(self, cases: np.ndarray, theta: np.ndarray, sigma: np.ndarray) -> np.ndarray:
        """Return which estimates ``theta`` require more steps, (cases,)."""
        return np.asarray(self.needed(cases, theta, sigma) > self.substeps[cases])

    def needed(self, cases: np.ndarray, theta: np.ndarray, sigma: np.ndarray) -> np.ndarray:
        """Return the steps between nodes required for estimates (cases, size) and noise (cases, channels)."""
        relative = np.min(sigma / self[cases].rms, axis=1) / np.sqrt(self.channel_of.size)
        allowed = np.maximum(self.integration_error, self.noise_share * relative)
        rates, duration = self._fastest(cases, theta), max(record.duration for record in self.problem.records)
        radians = [radians_a_step(a, w * duration) for a, w in zip(allowed, rates, strict=True)]
        return _up(self._longest * np.maximum(rates, 1e-9) / np.array(radians))

    @cached_property
    def _longest(self) -> float:
        """Return the longest interval between two nodes."""
        return max(float(np.max(np.diff(cuts.grid), initial=0.0)) for cuts in self.cuts)

    def _fastest(self, cases: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Return the fastest rate of each case at rest and at the initial states of all records, (cases,)."""
        p = self.parameters(theta)
        rates = [fastest_rates(self.system, p, state.T, DIFFERENCE) for state in self[cases].states(theta)]
        return np.asarray(np.fmax.reduce(np.concatenate(rates), axis=0, initial=0.0))

    def _with(self, cases: np.ndarray, counts: np.ndarray, least: np.ndarray) -> Self:
        wanted = least.copy()
        np.maximum.at(wanted, cases, counts)
        if np.array_equal(wanted, self.substeps):
            return self
        finer = copy(self)
        finer.__dict__["substeps"] = wanted
        return finer


def _up(wanted: np.ndarray) -> np.ndarray:
    """Round up to the next possible number of steps."""
    return np.asarray(SUBSTEPS[np.searchsorted(SUBSTEPS, np.minimum(wanted, SUBSTEPS[-1]))])


def forces_at(record: Record, times: np.ndarray, n_dof: int) -> np.ndarray:
    """Return the known force on each DOF, (n_times, n_dof)."""
    return np.array(record.force(times, n_dof)).reshape(n_dof, -1).T


def casadi_ops() -> Ops:
    """Return the functions available to equations of motion, for CasADi's symbols."""
    import casadi as ca

    def solve(matrix: Any, right: Any) -> list[Any]:
        rows = ca.vertcat(*[ca.horzcat(*row) for row in matrix])
        return cast("list[Any]", ca.vertsplit(ca.solve(rows, ca.vertcat(*right))))

    return ops_from(ca, solve, abs=ca.fabs, where=ca.if_else)


@lru_cache(maxsize=64)
def rates(system: System) -> Any:
    """Return the function (state, log-parameters, force on each DOF) -> velocities, accelerations, hidden rates.

    The mass matrix is the symbolic derivative of the residual by the accelerations, which keeps its sparsity: for ten
    masses the expression is eighteen times shorter than with unit accelerations.
    """
    import casadi as ca

    n, ops = system.n_dof, casadi_ops()
    state, logs, forces = ca.SX.sym("s", 2 * n + system.n_hidden), ca.SX.sym("p", len(system.names)), ca.SX.sym("f", n)
    p = {name: ca.exp(logs[i]) for i, name in enumerate(system.names)}
    entries, a = ca.vertsplit(state), ca.SX.sym("a", n)
    x, v, z, f = entries[:n], entries[n : 2 * n], entries[2 * n :], ca.vertsplit(forces)
    residual = ca.vertcat(*system.residual(p, x, v, ca.vertsplit(a), f, z, ops))
    accelerations = ca.solve(ca.jacobian(residual, a), -ca.substitute(residual, a, ca.DM.zeros(n)))
    hidden = system.hidden_rates(p, x, v, f, z, ops)
    return ca.Function("rates", [state, logs, forces], [ca.vertcat(*v, accelerations, *hidden)])


@lru_cache(maxsize=64)
def step(system: System) -> Any:
    """Return a step: (state, log-parameters, length, forces (n_dof, 3) at its start, middle and end) -> state."""
    import casadi as ca

    rate = rates(system)
    state, logs, h = ca.SX.sym("s", rate.size1_in(0)), ca.SX.sym("p", len(system.names)), ca.SX.sym("h")
    forces = ca.SX.sym("f", system.n_dof, 3)
    first, middle, last = ca.horzsplit(forces)
    after = rk4(lambda moved, force: [rate(moved[0], logs, force)], [state], h, (first, middle, last))
    return ca.Function("step", [state, logs, h, forces], after)


def _with_slopes(function: Any, by_start: int) -> Any:
    """Extend a function of state, log-parameters and other inputs to the derivatives of the state."""
    import casadi as ca

    s, logs, *others = (ca.SX.sym("in", function.sparsity_in(i)) for i in range(function.n_in()))
    k, value = logs.numel(), function(s, logs, *others)
    slopes = ca.SX.sym("slopes", s.numel(), k + by_start)
    directions = ca.vertcat(slopes, ca.horzcat(ca.SX.eye(k), ca.SX(k, by_start)))
    both = ca.horzcat(value, ca.jtimes(value, ca.vertcat(s, logs), directions))
    return ca.Function("carried", [ca.horzcat(s, slopes), logs, *others], [ca.densify(both)], {"cse": True})


@lru_cache(maxsize=64)
def _steps_with_slopes(system: System, by_start: int, number: int) -> Any:
    return _with_slopes(step(system), by_start).mapaccum(number)


@lru_cache(maxsize=64)
def _rates_with_slopes(system: System, by_start: int, number: int) -> Any:
    return _with_slopes(rates(system), by_start).map(number)


def stepped_motion(system: System, p: np.ndarray, start: np.ndarray, steps: Steps, by_start: bool) -> np.ndarray:
    """Compute the states on the grid of steps and their derivatives, for each set of parameters.

    Args:
        system: The system.
        p: Parameters in the system's order, (sets, n_parameters).
        start: Initial displacements, then velocities, (sets, 2 n_dof); hidden states start at zero.
        steps: Steps from time 0.
        by_start: Include derivatives by the initial state.

    Returns:
        The states, then their derivatives by the log-parameters and the initial state, (sets, n_grid, 1 + q, n_state);
        not finite where the motion diverges.
    """
    sets, moving = start.shape
    k, columns, number = p.shape[1], moving if by_start else 0, steps.lengths.size
    first = np.zeros((sets, 1 + k + columns, moving + system.n_hidden))
    first[:, 0, :moving] = start
    first[:, 1 + k :, :moving] = np.eye(columns, moving)
    path = np.empty((sets, steps.reached.size, *first.shape[1:]))
    path[:, 0] = first
    if number:
        given = [first, np.repeat(np.log(p)[:, None], number, axis=1), steps.lengths, steps.forces]
        ends = _evaluated(_steps_with_slopes(system, columns, number), given, (2, 3))
        for place, after in zip(path, ends, strict=True):
            place[1:] = after.reshape(number, *first.shape[1:])[steps.reached[1:] - 1]
    return path


def stepped_accelerations(
    system: System, p: np.ndarray, states: np.ndarray, forces: np.ndarray, dof: int
) -> np.ndarray:
    """Compute the acceleration of a DOF and its derivatives, (sets, n, 1 + q), at states (sets, n, 1 + q, n_state).

    ``forces`` (n, n_dof): the known forces; ``p`` as in :func:`stepped_motion`.
    """
    number, columns = states.shape[1:3]
    shown = np.empty(states.shape[:3])
    if number:
        function = _rates_with_slopes(system, columns - 1 - p.shape[1], number)
        given = [states, np.repeat(np.log(p)[:, None], number, axis=1), forces]
        for place, values in zip(shown, _evaluated(function, given, (2,)), strict=True):
            place[:] = values.reshape(states.shape[1:])[..., system.n_dof + dof]
    return shown


def _evaluated(function: Any, inputs: Sequence[np.ndarray], shared: tuple[int, ...]) -> Iterator[np.ndarray]:
    """Yield the result of a function for each set, in one reused array; ``shared`` inputs are equal for all sets."""
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
