"""The sparse nonlinear programme of multiple shooting: how records are cut, its symbols in CasADi, its linearisation.

It is built once for a shape of problem and reused: data, times, forces, prior and noise are its parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, cast

import numpy as np
from scipy.sparse.linalg import splu

from bench import Ops, OutputError, Record, Start, System, interval_polynomials, ops_from, simulate
from methods.starts.rough import rough_states


class Plan:
    """How a record is cut: the ``grid`` of cuts, the ``steps`` between them, the force over each of them.

    ``forces`` ((degree + 1) * n_dof, steps): the coefficients of each DOF's force in powers of the part of the step
    that has passed, the constants of all DOFs first; between its samples a force is such a polynomial.
    """

    def __init__(self, system: System, record: Record) -> None:
        knots = [f.times[f.times < record.duration] for f in record.forces]
        grid = np.unique(np.concatenate([[0.0], *[c.times for c in record.channels], *knots]))
        # cuts that differ by rounding alone are one
        self.grid = grid[np.concatenate([[True], np.diff(grid) > 1e-11 * max(record.duration, 1e-300)])]
        self.steps = np.diff(self.grid)
        self.longest = float(np.max(self.steps, initial=0.0))
        n = system.n_dof
        coefficients = interval_polynomials(record.forces, self.grid, n)
        self.degree = len(coefficients) - 1
        self.forces = coefficients.transpose(0, 2, 1).reshape(-1, self.steps.size)
        self.at = tuple(
            np.abs(self.grid[None] - c.times[:, None]).argmin(axis=1) if c.n else np.zeros(0, int)
            for c in record.channels
        )
        self.sensor_forces = tuple(np.array(record.force(c.times, n)).reshape(n, -1) for c in record.channels)


@dataclass(frozen=True)
class Shape:
    """What a programme depends on; problems of one shape share it.

    ``records``: by record, the rig that moved, the number of cuts, the degree of the force between them, and the
    channels as (measures, dof, offset, cut of each sample). ``exact`` asks for the exact Hessian: Gauss-Newton's
    steps in the logarithm of a parameter that the data press towards zero go too far, again and again.
    """

    system: System
    records: tuple[tuple[System, int, int, tuple[tuple[str, int, bool, tuple[int, ...]], ...]], ...]
    substeps: int
    prior: bool
    exact: bool

    @staticmethod
    def of(model: OutputError, plans: tuple[Plan, ...], substeps: int, exact: bool) -> Shape:
        records = tuple(
            (
                record.rig(model.system),
                plan.grid.size,
                plan.degree,
                tuple(
                    (c.measures, c.dof, c.offset, tuple(map(int, at)))
                    for c, at in zip(record.channels, plan.at, strict=True)
                ),
            )
            for record, plan in zip(model.problem.records, plans, strict=True)
        )
        return Shape(model.system, records, substeps, model.prior is not None, exact)


@dataclass(frozen=True)
class Programme:
    """The solver, and ``linear``: (w, q) -> misfit, its derivatives, the derivatives of the joins, the joins."""

    solver: Any
    linear: Any


def casadi_ops() -> Ops:
    """The functions that a residual may call, for CasADi's symbols."""
    import casadi as ca

    def solve(matrix: Any, right: Any) -> list[Any]:
        rows = ca.vertcat(*[ca.horzcat(*row) for row in matrix])
        return cast("list[Any]", ca.vertsplit(ca.solve(rows, ca.vertcat(*right))))

    return ops_from(ca, solve, abs=ca.fabs, where=ca.if_else)


def _rates(system: System) -> Any:
    """Rate of the state: (state, log-parameters, force on each DOF) -> velocities, accelerations, hidden rates.

    The mass matrix is the derivative of the residual by the accelerations: as a symbolic expression it is then as
    sparse as it is in truth, and the programme of ten masses eighteen times shorter than by unit accelerations.
    """
    import casadi as ca

    n, ops = system.n_dof, casadi_ops()
    state, logs, forces = ca.SX.sym("s", state_size(system)), ca.SX.sym("p", len(system.names)), ca.SX.sym("f", n)
    p = {name: ca.exp(logs[i]) for i, name in enumerate(system.names)}
    entries, a = ca.vertsplit(state), ca.SX.sym("a", n)
    x, v, z, f = entries[:n], entries[n : 2 * n], entries[2 * n :], ca.vertsplit(forces)
    residual = ca.vertcat(*system.residual(p, x, v, ca.vertsplit(a), f, z, ops))
    rest = ca.substitute(residual, a, ca.DM.zeros(n))
    hidden = system.hidden_rates(p, x, v, f, z, ops)
    accelerations = ca.solve(ca.jacobian(residual, a), -rest)
    return ca.Function("rates", [state, logs, forces], [ca.vertcat(*v, accelerations, *hidden)])


def state_size(system: System) -> int:
    """Entries of a state: displacements, velocities, hidden states."""
    return 2 * system.n_dof + system.n_hidden


def _interval(system: System, substeps: int, degree: int) -> Any:
    """The state after one interval: (state, log-parameters, length, coefficients of the forces) -> state."""
    import casadi as ca

    n, rates = system.n_dof, _rates(system)
    state, logs = ca.SX.sym("s", state_size(system)), ca.SX.sym("p", len(system.names))
    length, forces = ca.SX.sym("h"), ca.SX.sym("f", (degree + 1) * n)
    part, width = ca.SX.sym("part"), ca.SX.sym("width")
    start, middle, end = (ca.vertcat(*_polynomial(forces, part + d * width, n)) for d in (0.0, 0.5, 1.0))
    h = length * width
    k1 = rates(state, logs, start)
    k2 = rates(state + 0.5 * h * k1, logs, middle)
    k3 = rates(state + 0.5 * h * k2, logs, middle)
    k4 = rates(state + h * k3, logs, end)
    after = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    step = ca.Function("step", [state, logs, length, forces, part, width], [after])
    now = state
    for j in range(substeps):
        now = step(now, logs, length, forces, j / substeps, 1.0 / substeps)
    return ca.Function("interval", [state, logs, length, forces], [now])


def _polynomial(coefficients: Any, part: Any, n: int) -> list[Any]:
    """The force on each DOF where ``part`` of an interval has passed, by Horner's rule."""
    import casadi as ca

    rows = ca.vertsplit(coefficients)
    powers = [rows[i : i + n] for i in range(0, len(rows), n)]
    total = powers[-1]
    for lower in reversed(powers[:-1]):
        total = [c + part * t for c, t in zip(lower, total, strict=True)]
    return list(total)


@lru_cache(maxsize=32)
def build_programme(shape: Shape, max_iterations: int) -> Programme:
    """Build the sparse programme over ``w = [log-parameters, offsets, states at the cuts record by record]``.

    Its parameters, in the order of :func:`given_to`: of each record the interval lengths and forces, of each channel
    data, weights (1/sigma) and forces at the samples; then the prior's means and weights; last a common scale of
    the misfits, the smallest sigma relative to its channel, so that the objective is of order one at most.
    """
    import casadi as ca

    system, n = shape.system, shape.system.n_dof
    logs = ca.MX.sym("logs", len(system.names))
    offsets, states, given, misfits, joins = [], [], [], [], []
    for rig, cuts, degree, channels in shape.records:
        interval, rates = _interval(rig, shape.substeps, degree), _rates(rig)
        path = ca.MX.sym("path", state_size(system), cuts)
        steps, forces = ca.MX.sym("steps", 1, cuts - 1), ca.MX.sym("forces", (degree + 1) * n, cuts - 1)
        states.append(path)
        given += [steps, forces]
        end = interval.map(cuts - 1)(path[:, :-1], ca.repmat(logs, 1, cuts - 1), steps, forces)
        joins.append(ca.vec(end - path[:, 1:]))
        for measures, dof, offset, at in channels:
            data, weights, push = (ca.MX.sym("sensor", rows, len(at)) for rows in (1, 1, n))
            given += [data, weights, push]
            here = path[:, list(at)]
            if measures == "acceleration":
                ideal = rates.map(len(at))(here, ca.repmat(logs, 1, len(at)), push)[n + dof, :]
            else:
                ideal = here[dof + (n if measures == "velocity" else 0), :]
            if offset:
                offsets.append(ca.MX.sym("offset"))
                ideal = ideal + offsets[-1]
            misfits.append(ca.vec(weights * (data - ideal)))
    if shape.prior:
        given += [ca.MX.sym("means", len(system.names)), ca.MX.sym("precisions", len(system.names))]
        misfits.append(given[-1] * (given[-2] - logs))
    given.append(ca.MX.sym("scale"))
    misfits = [given[-1] * misfit for misfit in misfits]
    parts = [logs, *offsets, *states]
    model = ca.Function("model", [*parts, *given], [ca.vertcat(*misfits), ca.vertcat(*joins)])
    return _solver(model, len(parts), max_iterations, shape.exact)


def _solver(model: Any, n_unknown: int, max_iterations: int, exact: bool) -> Programme:
    """IPOPT on ``½ |misfit|²`` subject to ``joins = 0``, with the exact or the Gauss-Newton Hessian."""
    import casadi as ca

    shapes = [model.size_in(i) for i in range(model.n_in())]
    sizes = [rows * columns for rows, columns in shapes]

    def cut(symbol: Any, first: int, last: int) -> list[Any]:
        pieces = ca.vertsplit(symbol, [0, *map(int, np.cumsum(sizes[first:last]))])
        return [ca.reshape(piece, *size) for piece, size in zip(pieces, shapes[first:last], strict=True)]

    w, q = ca.MX.sym("w", sum(sizes[:n_unknown])), ca.MX.sym("q", sum(sizes[n_unknown:]))
    misfit, joins = model.call([*cut(w, 0, n_unknown), *cut(q, n_unknown, len(sizes))], True, False)
    slopes, factor = ca.jacobian(misfit, w), ca.MX.sym("lam_f")
    hessian = ca.Function(
        "nlp_hess_l",
        [w, q, factor, ca.MX.sym("lam_g", joins.numel())],
        [factor * ca.triu(slopes.T @ slopes)],
        ["x", "p", "lam_f", "lam_g"],
        ["hess"],
    )
    quiet = {"print_level": 0, "sb": "yes", "max_iter": max_iterations, "tol": 1e-8, "acceptable_tol": 1e-6}
    options: Any = {
        **({} if exact else {"hess_lag": hessian}),
        "print_time": False,
        "error_on_fail": False,
        "show_eval_warnings": False,
        "calc_lam_p": False,
        "ipopt": {**quiet, "mu_strategy": "adaptive", "linear_solver": "mumps"},
    }
    programme: Any = {"x": w, "p": q, "f": 0.5 * ca.dot(misfit, misfit), "g": joins}
    solver = ca.nlpsol("shooting", "ipopt", programme, options)
    return Programme(solver, ca.Function("linear", [w, q], [misfit, slopes, ca.jacobian(joins, w), joins]))


def given_to(model: OutputError, plans: tuple[Plan, ...], sigma: np.ndarray) -> np.ndarray:
    """Collect the programme's parameters, matrices column by column."""
    parts: list[np.ndarray] = []
    number = 0
    for record, plan in zip(model.problem.records, plans, strict=True):
        parts += [plan.steps, plan.forces.T.ravel()]
        for channel, force in zip(record.channels, plan.sensor_forces, strict=True):
            parts += [channel.values, np.full(channel.n, 1.0 / sigma[number]), force.T.ravel()]
            number += 1
    if model.prior is not None:
        parts += [model.prior.log_mean, 1.0 / model.prior.log_sds]
    return np.concatenate([*parts, [misfit_scale(model, sigma)]])


def misfit_scale(model: OutputError, sigma: np.ndarray) -> float:
    """Find the common scale of the misfits: the smallest sigma relative to its channel."""
    return float(np.min(sigma / model.rms))


def first_guess(model: OutputError, plans: tuple[Plan, ...], theta: np.ndarray) -> np.ndarray:
    """Guess the unknowns at ``theta``: states simulated at the cuts, displacements as measured."""
    p = {name: float(value) for name, value in model.parameters(theta).items()}
    offsets = model.offsets(theta)
    parts = [np.log(list(p.values())), offsets[list(model.offset_channels)]]
    number = 0
    for record, plan, start in zip(model.problem.records, plans, model.starts(theta), strict=True):
        states = _simulated(model.system, p, start, record, plan.grid)
        for channel, at in zip(record.channels, plan.at, strict=True):
            if channel.measures == "displacement":
                states[channel.dof, at] = channel.values - offsets[number]
            number += 1
        if record.initial_state is not None:
            told = np.concatenate([record.initial_state.displacement, record.initial_state.velocity])
            states[: told.size, 0] = told
        parts.append(states.T.ravel())
    return np.concatenate(parts)


def _simulated(system: System, p: dict[str, float], start: Start, record: Record, grid: np.ndarray) -> np.ndarray:
    """States (2 n_dof + n_hidden, cuts) at the cuts, as finely as a first guess needs."""
    if not system.linear and not system.n_hidden:
        return rough_states(system, {name: np.array(value) for name, value in p.items()}, start, record, grid)
    motion = simulate(record.rig(system), p, start, grid, record.forces)
    return np.concatenate([motion.displacement, motion.velocity, motion.hidden])


@dataclass(frozen=True)
class ProgrammeLayout:
    """Where things are in the programme's unknowns: numbers of the independent ones, in the order of theta."""

    independent: np.ndarray
    dependent: np.ndarray
    fixed: np.ndarray

    @staticmethod
    def of(model: OutputError, plans: tuple[Plan, ...]) -> ProgrammeLayout:
        names, n, moving = model.system.names, state_size(model.system), 2 * model.system.n_dof
        logs = [names.index(name) for name in model.free]
        at = len(names) + len(model.offset_channels)
        offsets = list(range(len(names), at))
        starts: list[int] = []
        dependent: list[int] = []
        fixed = [i for i, name in enumerate(names) if name not in model.free]
        for record, plan in zip(model.problem.records, plans, strict=True):
            (starts if record.initial_state is None else fixed).extend(range(at, at + moving))
            fixed.extend(range(at + moving, at + n))  # hidden states start at zero
            dependent += range(at + n, at + n * plan.grid.size)
            at += n * plan.grid.size
        return ProgrammeLayout(
            np.array([*logs, *starts, *offsets], int), np.array(dependent, int), np.array(fixed, int)
        )


def reduced(
    programme: Programme, layout: ProgrammeLayout, w: np.ndarray, given: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Misfit and its slopes by the independent unknowns where the states follow; how all follow; the widest gap.

    The states follow by the implicit function theorem: ``d dependent = -(joins by dependent)^-1 joins by independent``.
    """
    parts = programme.linear(w, given)
    misfit = np.asarray(parts[0]).ravel()
    slopes, by_state = parts[1].sparse().tocsc(), parts[2].sparse().tocsc()
    gap = float(np.max(np.abs(np.asarray(parts[3])), initial=0.0)) / max(float(np.max(np.abs(w))), 1e-300)
    follow = splu(by_state[:, layout.dependent].tocsc()).solve(-by_state[:, layout.independent].toarray())
    move = np.zeros((w.size, layout.independent.size))
    move[layout.independent, np.arange(layout.independent.size)] = 1.0
    move[layout.dependent] = follow
    return misfit, slopes @ move, move, gap
