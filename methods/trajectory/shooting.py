"""Direct multiple shooting: maximum a posteriori by a sparse nonlinear programme (CasADi, IPOPT).

The record is cut at every sample and at every knot of a known force. The states at the cuts are unknowns beside the
log-parameters, the initial states and the offsets of the sensors; that the motion joins at each cut is a constraint
(H. G. Bock, K.-J. Plitt, IFAC Proceedings 17(2):1603, 1984). So the trajectory can follow the data from the first
iteration on, while a single trajectory from a wrong frequency cannot. Between cuts: classical Runge-Kutta steps of
order four, as many as the frequency seen in the data and the noise seen in it call for. The Hessian is Gauss-Newton's.

Objective: ``sum ((y - h) / sigma)² + sum ((log p - log nominal) / sd)²``. The noise level is not known: fit, then
``sigma² = RSS / (N - p)`` for each channel, then fit again from there, until it settles; p is the number of
parameters that the data decide, ``trace(H_data H^-1)``.

Starts come from the data alone (:mod:`methods.starts.spectral`): the separate minima of a scan over frequency and
decay, a few output-error steps each (on the first samples, where a record of a nonlinear system is long); whatever
could still win is solved by shooting, and the best objective is kept.
Where all parameters are told without a prior (a known force, an added mass), the likelihood may have no maximum at
positive ones, as where the noise hides the damping: then all are solved again with a very wide prior about the first
start, which no output-error step has moved.
The covariance is the inverse of the Hessian reduced to the space that satisfies the constraints, with Student's t at
``N - p`` degrees of freedom. The programme is built once for a shape of problem and reused: data, times, forces,
prior and noise are its parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from types import SimpleNamespace
from typing import Any, ClassVar, cast

import numpy as np
from scipy.sparse.linalg import splu

from bench import (
    Card,
    Channel,
    Cost,
    Estimate,
    Identifier,
    Ops,
    Prior,
    Problem,
    Record,
    Serves,
    Status,
    System,
    simulate,
)
from methods.starts.open_parameters import left_open, very_wide
from methods.starts.rough import Start, fastest_rate, radians_a_step, rough_states
from methods.starts.spectral import OutputError, candidates, estimate_at, screened, screening, silent

SUBSTEPS = (1, 2, 3, *(n * 2**i for i in range(5) for n in (4, 6)), 128)
MAX_SUBSTEPS = SUBSTEPS[-1]
SCREENED = 300
"""Samples of each channel on which the starts of a nonlinear system are compared."""
HELD = "the likelihood has no maximum at positive parameters: held by a prior of a factor of 20 about the data's start"
POLISH = 3
"""Gauss-Newton steps in the reduced space after IPOPT, at most: they make the answer free of its tolerance."""


@dataclass(frozen=True)
class Shooting(Identifier):
    """CasADi multiple shooting with the Gauss-Newton Hessian; settings below, the method in the module's docstring.

    At most ``starts`` separate starts get ``screen_iterations`` output-error steps; each is then solved by shooting
    if minus twice its log-posterior is within ``margin`` of the best. The integration may err by ``integration_error``
    of the motion, or by ``noise_share`` of the standard error that the data allow, whichever is larger.
    Fit and noise alternate at most ``sigma_rounds`` times, until the noise changes by less than ``sigma_tolerance``.
    """

    starts: int = 3
    screen_iterations: int = 5
    margin: float = 15.0
    integration_error: float = 1e-8
    noise_share: float = 0.05
    sigma_rounds: int = 4
    sigma_tolerance: float = 0.01
    max_iterations: int = 60

    card: ClassVar[Card] = Card(
        summary="Direct multiple shooting, Gauss-Newton, maximum a posteriori with the noise estimated",
        start="used when known",
        scale="native",
        reconstruction="own",
        uncertainty="inverse reduced Hessian in the log-parameters, Student t with N - p degrees of freedom",
        settings_source="defaults by reasoning on accuracy and cost",
        tuning="two values of noise_share; development systems at 40 to 5 dB, damping ratio 2-20 %, 2-10 cycles",
        title="Multiple shooting",
        order=10,
        colour="#0072B2",
        marker="o",
    )
    serves: ClassVar[Serves] = Serves(
        measures=("displacement", "velocity", "acceleration"),
        several_records=True,
        several_channels=True,
        offsets=True,
        max_dof=None,
        added_mass=True,
        hidden_states=True,
    )
    requires: ClassVar[tuple[str, ...]] = ("casadi",)
    extra: ClassVar[str] = "casadi"

    def identify(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """The estimate: all parameters, or the groups where nothing tells the scale. Uses no randomness."""
        units = problem.natural_units()
        scaled = problem.expressed_in(units)
        if silent(scaled):
            return Estimate.failed(
                problem.system, Status.DIVERGED, "no sensor shows any motion; check the wiring or choose another record"
            )
        model = OutputError(scaled)
        with np.errstate(all="ignore"):
            estimate = self._solve(model)
        return replace(estimate, offsets=problem.offsets_from(units, estimate.offsets)).expressed_in(units.inverse)

    def _solve(self, model: OutputError) -> Estimate:
        found = screened(_head(model), self.starts, rounds=1, iterations=self.screen_iterations)
        if not found:
            return Estimate.failed(
                model.system, Status.DIVERGED, "no start gave a finite response; give a prior nearer to the system"
            )
        used = [theta for value, theta in found if value <= found[0][0] + self.margin]
        good, message = self._fits(model, used), ""
        if model.prior is None and model.problem.scale_told and not _closed(model, good):
            # the likelihood rises towards a parameter of zero or without limit: the data say that it is small or large
            prior = very_wide(candidates(_head(model), self.starts + 1)[0])
            model = OutputError(replace(model.problem, prior=prior))
            good, message = self._fits(model, [_within(prior, theta) for theta in used], exact=True), HELD
        iterations = sum(fit.iterations for fit in good)
        if not good:
            return Estimate.failed(
                model.system,
                Status.DIVERGED,
                "IPOPT found no solution from any start; raise max_iterations or give a prior",
                Cost(iterations=iterations),
            )
        best = min(good, key=lambda fit: fit.profile)
        return _estimate(model, best, Cost(evaluations=iterations, iterations=iterations), message)

    def _fits(self, model: OutputError, starts: Sequence[np.ndarray], exact: bool = False) -> list[_Fit]:
        """The solutions from these starts."""
        return [fit for fit in (self._fit(model, theta, exact) for theta in starts) if fit is not None]

    def _fit(self, model: OutputError, theta: np.ndarray, exact: bool) -> _Fit | None:
        """Fit and noise in turn, from one start; None where IPOPT fails."""
        residuals = model.data - screening(model).predict(theta)
        if not np.all(np.isfinite(residuals)):
            return None
        used, fit, iterations, substeps = float(model.size), None, 0, 1
        sigma = model.noise(residuals, used)
        plans = tuple(_Plan(model.system, record) for record in model.problem.records)
        for _ in range(self.sigma_rounds):
            substeps = max(self._substeps(model, theta, plans, model.noise(residuals, used, floor=0.0)), substeps)
            shape = _Shape.of(model, plans, substeps, exact)
            last, fit = fit, _shoot(shape, model, plans, theta, sigma, self.max_iterations, fit)
            if fit is None:
                return last
            iterations += fit.iterations
            theta, residuals, used = fit.theta, fit.residuals, fit.used
            fit.sigma, fit.profile = model.noise(residuals, used, floor=0.0), model.profile_of(theta, residuals)
            fit.iterations = iterations
            before, sigma = sigma, model.noise(residuals, used)
            # the solution may be faster than the start was, or fit better: then the steps were too long
            enough = self._substeps(model, theta, plans, fit.sigma) <= substeps
            if enough and np.max(np.abs(np.log(sigma / before))) < self.sigma_tolerance:
                break
        return fit

    def _substeps(self, model: OutputError, theta: np.ndarray, plans: tuple[_Plan, ...], sigma: np.ndarray) -> int:
        """Runge-Kutta steps in the longest interval: 1, 2, 3, 4, 6, 8, 12, ... so that few programmes are built.

        The error over the record is kept below what is allowed (:func:`methods.starts.rough.radians_a_step`).
        """
        relative = float(np.min(sigma / model.rms)) / np.sqrt(model.data.size)
        allowed = max(self.integration_error, self.noise_share * relative)
        radians = max(fastest_rate(model.system, model.parameters(theta), start) for start in model.starts(theta))
        duration = max(record.duration for record in model.problem.records)
        step = radians_a_step(allowed, radians * duration) / max(radians, 1e-9)
        longest = max(float(np.max(plan.steps)) for plan in plans)
        wanted = min(longest / step, MAX_SUBSTEPS)
        return int(next(n for n in SUBSTEPS if n >= wanted))


@dataclass
class _Fit:
    """One solved programme: ``theta`` as in OutputError, and what belongs to it."""

    theta: np.ndarray
    unknowns: np.ndarray
    residuals: np.ndarray
    slopes: np.ndarray
    used: float
    iterations: int
    substeps: int
    sigma: np.ndarray = field(default_factory=lambda: np.ones(1))
    """Noise by channel as the residuals have it, without a floor."""
    profile: float = np.inf


def _closed(model: OutputError, fits: Sequence[_Fit]) -> bool:
    """Whether the best of the solutions leaves no parameter more open than the very wide prior would."""
    if not fits:
        return False
    best = min(fits, key=lambda fit: fit.profile)
    covariance = model.covariance(best.slopes, best.sigma)
    return covariance is not None and not np.any(left_open(np.diag(covariance)[: len(model.free)]))


def _within(prior: Prior, theta: np.ndarray) -> np.ndarray:
    """A start that had run away, back within a standard deviation of the prior on its first entries."""
    k = prior.log_mean.size
    logs = np.clip(theta[:k], prior.log_mean - prior.log_sds, prior.log_mean + prior.log_sds)
    return np.concatenate([logs, theta[k:]])


def _head(model: OutputError) -> OutputError:
    """The first samples of long records of a nonlinear system, for the screening: ``theta`` means the same for them.

    Its step-by-step simulations would outlast the shooting; linear responses are quick at any length.
    """
    if model.system.linear or all(c.n <= SCREENED for _, c in model.channels):
        return model

    def short(c: Channel) -> Channel:
        return replace(c, times=c.times[:SCREENED], values=c.values[:SCREENED])

    records = tuple(replace(r, channels=tuple(short(c) for c in r.channels)) for r in model.problem.records)
    return OutputError(replace(model.problem, records=records))


class _Plan:
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
        n = system.n_dof
        self.degree = max((f.degree for f in record.forces), default=1)
        # sampled inside, since a held force jumps at the cuts
        nodes = (np.arange(self.degree + 1) + 0.5) / (self.degree + 1)
        sampled = np.array(record.force(self.grid[:-1] + nodes[:, None] * self.steps, n))
        coefficients = np.einsum("ij,njk->ink", np.linalg.inv(np.vander(nodes, increasing=True)), sampled)
        self.forces = coefficients.reshape(-1, self.steps.size)
        self.at = tuple(
            np.abs(self.grid[None] - c.times[:, None]).argmin(axis=1) if c.n else np.zeros(0, int)
            for c in record.channels
        )
        self.sensor_forces = tuple(np.array(record.force(c.times, n)).reshape(n, -1) for c in record.channels)


# ------------------------------------------------------------------------------------------------ the programme


@dataclass(frozen=True)
class _Shape:
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
    def of(model: OutputError, plans: tuple[_Plan, ...], substeps: int, exact: bool) -> _Shape:
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
        return _Shape(model.system, records, substeps, model.prior is not None, exact)


@dataclass(frozen=True)
class _Programme:
    """The solver, and ``linear``: (w, q) -> misfit, its derivatives, the derivatives of the joins, the joins."""

    solver: Any
    linear: Any


def _casadi_ops() -> Ops:
    import casadi as ca

    def solve(matrix: Any, right: Any) -> list[Any]:
        rows = ca.vertcat(*[ca.horzcat(*row) for row in matrix])
        return cast("list[Any]", ca.vertsplit(ca.solve(rows, ca.vertcat(*right))))

    return cast(
        Ops,
        SimpleNamespace(sin=ca.sin, cos=ca.cos, tanh=ca.tanh, exp=ca.exp, abs=ca.fabs, where=ca.if_else, solve=solve),
    )


def _rates(system: System) -> Any:
    """Rate of the state: (state, log-parameters, force on each DOF) -> velocities, accelerations, hidden rates.

    The mass matrix is the derivative of the residual by the accelerations: as a symbolic expression it is then as
    sparse as it is in truth, and the programme of ten masses eighteen times shorter than by unit accelerations.
    """
    import casadi as ca

    n, ops = system.n_dof, _casadi_ops()
    state, logs, forces = ca.SX.sym("s", _size(system)), ca.SX.sym("p", len(system.names)), ca.SX.sym("f", n)
    p = {name: ca.exp(logs[i]) for i, name in enumerate(system.names)}
    entries, a = ca.vertsplit(state), ca.SX.sym("a", n)
    x, v, z, f = entries[:n], entries[n : 2 * n], entries[2 * n :], ca.vertsplit(forces)
    residual = ca.vertcat(*system.residual(p, x, v, ca.vertsplit(a), f, z, ops))
    rest = ca.substitute(residual, a, ca.DM.zeros(n))
    hidden = system.hidden_rates(p, x, v, f, z, ops)
    accelerations = ca.solve(ca.jacobian(residual, a), -rest)
    return ca.Function("rates", [state, logs, forces], [ca.vertcat(*v, accelerations, *hidden)])


def _size(system: System) -> int:
    """Entries of a state: displacements, velocities, hidden states."""
    return 2 * system.n_dof + system.n_hidden


def _interval(system: System, substeps: int, degree: int) -> Any:
    """The state after one interval: (state, log-parameters, length, coefficients of the forces) -> state."""
    import casadi as ca

    n, rates = system.n_dof, _rates(system)
    state, logs = ca.SX.sym("s", _size(system)), ca.SX.sym("p", len(system.names))
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
def _programme(shape: _Shape, max_iterations: int) -> _Programme:
    """The sparse programme over ``w = [log-parameters, offsets, states at the cuts record by record]``.

    Its parameters, in the order of :func:`_given`: of each record the interval lengths and forces, of each channel
    data, weights (1/sigma) and forces at the samples; then the prior's means and weights; last a common scale of
    the misfits, the smallest sigma relative to its channel, so that the objective is of order one at most.
    """
    import casadi as ca

    system, n = shape.system, shape.system.n_dof
    logs = ca.MX.sym("logs", len(system.names))
    offsets, states, given, misfits, joins = [], [], [], [], []
    for rig, cuts, degree, channels in shape.records:
        interval, rates = _interval(rig, shape.substeps, degree), _rates(rig)
        path = ca.MX.sym("path", _size(system), cuts)
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


def _solver(model: Any, n_unknown: int, max_iterations: int, exact: bool) -> _Programme:
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
    return _Programme(solver, ca.Function("linear", [w, q], [misfit, slopes, ca.jacobian(joins, w), joins]))


def _given(model: OutputError, plans: tuple[_Plan, ...], sigma: np.ndarray) -> np.ndarray:
    """The programme's parameters, matrices column by column."""
    parts: list[np.ndarray] = []
    number = 0
    for record, plan in zip(model.problem.records, plans, strict=True):
        parts += [plan.steps, plan.forces.T.ravel()]
        for channel, force in zip(record.channels, plan.sensor_forces, strict=True):
            parts += [channel.values, np.full(channel.n, 1.0 / sigma[number]), force.T.ravel()]
            number += 1
    if model.prior is not None:
        parts += [model.prior.log_mean, 1.0 / model.prior.log_sds]
    return np.concatenate([*parts, [_scale(model, sigma)]])


def _scale(model: OutputError, sigma: np.ndarray) -> float:
    return float(np.min(sigma / model.rms))


def _first_guess(model: OutputError, plans: tuple[_Plan, ...], theta: np.ndarray) -> np.ndarray:
    """The unknowns at ``theta``: simulated states at the cuts, the measured displacement in place of the simulated."""
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
class _Layout:
    """Where things are in the programme's unknowns: numbers of the independent ones, in the order of theta."""

    independent: np.ndarray
    dependent: np.ndarray
    fixed: np.ndarray

    @staticmethod
    def of(model: OutputError, plans: tuple[_Plan, ...]) -> _Layout:
        names, n, moving = model.system.names, _size(model.system), 2 * model.system.n_dof
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
        return _Layout(np.array([*logs, *starts, *offsets], int), np.array(dependent, int), np.array(fixed, int))


def _shoot(
    shape: _Shape,
    model: OutputError,
    plans: tuple[_Plan, ...],
    theta: np.ndarray,
    sigma: np.ndarray,
    max_iterations: int,
    last: _Fit | None,
) -> _Fit | None:
    """Solve the programme at given noise, and linearise it at the solution."""
    programme, layout = _programme(shape, max_iterations), _Layout.of(model, plans)
    w = _first_guess(model, plans, theta) if last is None else last.unknowns
    low, high = np.full(w.size, -np.inf), np.full(w.size, np.inf)
    low[layout.fixed] = high[layout.fixed] = w[layout.fixed]
    given = _given(model, plans, sigma)
    solution = programme.solver(x0=w, p=given, lbx=low, ubx=high, lbg=0.0, ubg=0.0)
    iterations = int(programme.solver.stats()["iter_count"])
    w = np.asarray(solution["x"]).ravel()
    for _ in range(POLISH):
        if not np.all(np.isfinite(w)):
            return None
        try:
            misfit, reduced, move, gap = _reduced(programme, layout, w, given)
            q, values, axes = np.linalg.svd(reduced, full_matrices=False)
        except (RuntimeError, np.linalg.LinAlgError):  # a singular system: IPOPT ran away
            return None
        downhill = q.T @ misfit
        # its length in standard errors: the gain in the objective that is left
        left = float(np.linalg.norm(downhill)) / _scale(model, sigma)
        w = w - move @ (axes.T @ np.where(values > 1e-10 * values[0], downhill / np.maximum(values, 1e-300), 0.0))
        if left < 1e-4 and gap < 1e-9:
            break
    if not (left < 0.05 and gap < 1e-6):
        return None
    n, weights = model.data.size, _scale(model, sigma) / sigma[model.channel_of]
    return _Fit(
        theta=w[layout.independent],
        unknowns=w,
        residuals=misfit[:n] / weights,
        slopes=reduced[:n] / weights[:, None],
        used=float(np.sum(q[:n] ** 2)),
        iterations=iterations,
        substeps=shape.substeps,
    )


def _reduced(
    programme: _Programme, layout: _Layout, w: np.ndarray, given: np.ndarray
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


# ---------------------------------------------------------------------------------------------------- the answer


def _estimate(model: OutputError, fit: _Fit, cost: Cost, message: str) -> Estimate:
    """The answer in the units of the model's problem."""
    covariance = model.covariance(fit.slopes, fit.sigma)
    if covariance is None:
        return Estimate.failed(
            model.system,
            Status.DIVERGED,
            "the data leave a parameter open; give more samples, a known force or a prior",
            cost,
        )
    return estimate_at(model, fit.theta, covariance, fit.used, cost, message)
