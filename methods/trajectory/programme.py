"""Multiple shooting as a sparse nonlinear programme, solved by IPOPT through CasADi.

The states at the shooting nodes, the log-parameters and the offsets are unknowns; continuity of the motion at each node
is a constraint (H. G. Bock, K.-J. Plitt, IFAC Proceedings 17(2):1603, 1984). The programme is built once per structure
of a problem and reused: data, times, forces, prior and noise are its parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from bench import System
from methods.trajectory.runge_kutta import SteppedOutputError, forces_at, rates, step, stepped_motion


@dataclass(frozen=True)
class Shape:
    """The structure on which a programme depends; problems with equal shapes share it.

    ``records``: for each record the rig, the number of nodes, and the channels as (measures, dof, offset, node of each
    sample). ``exact``: use the exact Hessian, since Gauss-Newton steps in the logarithm of a parameter that tends to
    zero are repeatedly too long.
    """

    records: tuple[tuple[System, int, tuple[tuple[str, int, bool, tuple[int, ...]], ...]], ...]
    substeps: int
    prior: bool
    exact: bool
    max_iterations: int

    @staticmethod
    def of(model: SteppedOutputError, substeps: int, exact: bool, max_iterations: int) -> Shape:
        """Return the shape of a problem."""
        records = tuple(
            (
                record.rig(model.system),
                cuts.grid.size,
                tuple(
                    (c.measures, c.dof, c.offset, tuple(map(int, places)))
                    for c, places in zip(record.channels, cuts.samples, strict=True)
                ),
            )
            for record, cuts in zip(model.problem.records, model.cuts, strict=True)
        )
        return Shape(records, substeps, model.prior is not None, exact, max_iterations)


def shoot(
    model: SteppedOutputError, theta: np.ndarray, sigma: np.ndarray, substeps: int, exact: bool, max_iterations: int
) -> tuple[np.ndarray, int]:
    """Solve the programme at given noise; return the vector of unknowns and the iterations.

    The initial guess is the motion at ``theta``, with displacements replaced by measured ones.

    Args:
        model: A single problem in natural units.
        theta: Its unknowns, where the motion is finite.
        sigma: Noise of each channel.
        substeps: Runge-Kutta steps between two nodes.
        exact: Use the exact Hessian.
        max_iterations: Iteration limit of IPOPT.
    """
    solver = _solver(Shape.of(model, substeps, exact, max_iterations))
    guess, fixed, independent = _unknowns(model, theta, substeps)
    low, high = np.where(fixed, guess, -np.inf), np.where(fixed, guess, np.inf)
    given = _given(model, sigma, substeps)
    solution = solver(x0=guess, p=given, lbx=low, ubx=high, lbg=0.0, ubg=0.0)
    return np.asarray(solution["x"]).ravel()[independent], int(solver.stats()["iter_count"])


@lru_cache(maxsize=32)
def _solver(shape: Shape) -> Any:
    """Build the solver of ``½ |misfit|²`` subject to ``joins = 0``, w = [log-parameters, offsets, node states]."""
    import casadi as ca

    system = shape.records[0][0]
    n, k, state = system.n_dof, len(system.names), 2 * system.n_dof + system.n_hidden
    offsets = sum(offset for _, _, channels in shape.records for _, _, offset, _ in channels)
    w, (logs, shifts, *paths) = _symbols("w", [(k, 1), (offsets, 1), *[(state, cuts) for _, cuts, _ in shape.records]])
    sizes = []  # in the order of _given
    for _, cuts, channels in shape.records:
        sizes += [(1, cuts - 1), (3 * n * shape.substeps, cuts - 1)]
        sizes += [(rows, len(places)) for *_, places in channels for rows in (1, 1, n)]
    q, parts = _symbols("q", [*sizes, *[(k, 1)] * (2 * shape.prior), (1, 1)])
    given, shift = iter(parts), iter(ca.vertsplit(shifts) if offsets else ())
    misfits, joins = [], []
    for (rig, cuts, channels), path in zip(shape.records, paths, strict=True):
        lengths, forces = next(given), next(given)
        ends = _interval(rig, shape.substeps).map(cuts - 1)(path[:, :-1], ca.repmat(logs, 1, cuts - 1), lengths, forces)
        joins.append(ca.vec(ends - path[:, 1:]))
        for measures, dof, offset, places in channels:
            data, weights, force = next(given), next(given), next(given)
            here = path[:, list(places)]
            if measures == "acceleration":
                ideal = rates(rig).map(len(places))(here, ca.repmat(logs, 1, len(places)), force)[n + dof, :]
            else:
                ideal = here[dof + (n if measures == "velocity" else 0), :]
            misfits.append(ca.vec(weights * (data - ideal - (next(shift) if offset else 0.0))))
    if shape.prior:
        means, precisions = next(given), next(given)
        misfits.append(precisions * (means - logs))
    misfit = next(given) * ca.vertcat(*misfits)
    slopes, factor = ca.jacobian(misfit, w), ca.MX.sym("lam_f")
    programme: Any = {"x": w, "p": q, "f": 0.5 * ca.dot(misfit, misfit), "g": ca.vertcat(*joins)}
    options: Any = {
        "print_time": False,
        "error_on_fail": False,
        "show_eval_warnings": False,
        "calc_lam_p": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.max_iter": shape.max_iterations,
        "ipopt.tol": 1e-8,
        "ipopt.acceptable_tol": 1e-6,
        "ipopt.mu_strategy": "adaptive",
        "ipopt.linear_solver": "mumps",
    }
    if not shape.exact:
        multipliers = ca.MX.sym("lam_g", programme["g"].numel())
        hessian = [factor * ca.triu(slopes.T @ slopes)]
        names = ["x", "p", "lam_f", "lam_g"]
        options["hess_lag"] = ca.Function("nlp_hess_l", [w, q, factor, multipliers], hessian, names, ["hess"])
    return ca.nlpsol("shooting", "ipopt", programme, options)


def _symbols(name: str, sizes: list[tuple[int, int]]) -> tuple[Any, list[Any]]:
    """Return a vector of symbols and its parts as matrices of the given sizes."""
    import casadi as ca

    ends = np.cumsum([0, *[rows * columns for rows, columns in sizes]])
    vector = ca.MX.sym(name, int(ends[-1]))
    return vector, [
        ca.reshape(part, *size) for part, size in zip(ca.vertsplit(vector, ends.tolist()), sizes, strict=True)
    ]


@lru_cache(maxsize=32)
def _interval(system: System, substeps: int) -> Any:
    """Return the state transition over an interval: (state, log-parameters, length, forces of its steps)."""
    import casadi as ca

    n, one_step = system.n_dof, step(system)
    state, logs = ca.SX.sym("s", one_step.size1_in(0)), ca.SX.sym("p", len(system.names))
    length, forces = ca.SX.sym("h"), ca.SX.sym("f", 3 * n * substeps)
    now = state
    for pushes in ca.vertsplit(forces, 3 * n):
        now = one_step(now, logs, length / substeps, ca.reshape(pushes, n, 3))
    return ca.Function("interval", [state, logs, length, forces], [now])


def _given(model: SteppedOutputError, sigma: np.ndarray, substeps: int) -> np.ndarray:
    """Return the programme's parameters, with matrices by column.

    The last one is a common scale of the misfits, the smallest sigma relative to its channel, so that the objective is
    at most of order one.
    """
    parts: list[np.ndarray] = []
    noise = iter(sigma)
    for number, (record, cuts) in enumerate(zip(model.problem.records, model.cuts, strict=True)):
        parts += [np.diff(cuts.grid), model.steps(number, substeps).forces.ravel()]
        for channel in record.channels:
            forces = forces_at(record, channel.times, model.system.n_dof)
            parts += [channel.values, np.full(channel.n, 1.0 / next(noise)), forces.ravel()]
    if model.prior is not None:
        parts += [model.prior.log_mean, 1.0 / model.prior.log_sds]
    return np.concatenate([*parts, [np.min(sigma / model.rms)]])


def _unknowns(model: SteppedOutputError, theta: np.ndarray, substeps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return an initial guess of the programme's unknowns, which are fixed, and the indices of those of ``theta``."""
    system, moving = model.system, 2 * model.system.n_dof
    p = np.array([float(value) for value in model.parameters(theta).values()])
    offsets = model.offsets(theta)[list(model.offset_channels)]
    parts, fixed = (
        [np.log(p), offsets],
        [np.array([name not in model.free for name in system.names]), offsets == np.inf],
    )
    shift, starts, place = iter(model.offsets(theta)), list[int](), p.size + offsets.size
    for number, (record, state) in enumerate(zip(model.problem.records, model.states(theta), strict=True)):
        cuts, rig = model.cuts[number], record.rig(system)
        path = stepped_motion(rig, p[None], state[None], model.steps(number, substeps), False)[0, :, 0].copy()
        for channel, places in zip(record.channels, cuts.samples, strict=True):
            offset = next(shift)
            if channel.measures == "displacement":
                path[places, channel.dof] = channel.values - offset
        if record.initial_state is None:
            starts += range(place, place + moving)
        else:
            path[0, :moving] = state
        is_fixed = np.zeros(path.shape, bool)
        is_fixed[0, 0 if record.initial_state is not None else moving :] = True  # hidden states start at zero
        parts.append(path.ravel())
        fixed.append(is_fixed.ravel())
        place += path.size
    logs = [system.names.index(name) for name in model.free]
    independent = np.array([*logs, *starts, *range(p.size, p.size + offsets.size)], int)
    return np.concatenate(parts), np.concatenate(fixed), independent
