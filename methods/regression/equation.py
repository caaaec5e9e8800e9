"""What the equation-error methods share: the equation of motion as a linear regression, and what its answer implies.

LS, RLS, DDNN and SINDy put (displacement, velocity, acceleration) at some times into the residual of the system,
which is affine in the parameters, and solve for them. They differ in how they differentiate and how they solve.
:class:`Regression` turns the motion of every degree of freedom (DOF) into ``columns @ unknowns = target``.

Arrays hold many data sets at once: displacements of a record have shape (n_dof, sets, n), time last. Everything works
on a problem in its natural units (:meth:`bench.Problem.natural_units`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bench import (
    Dimension,
    Estimate,
    NoEstimate,
    Normal,
    Problem,
    Record,
    Status,
    System,
    fastest_rates,
    regression_columns,
    simulate,
)
from methods.regression.derivatives import Motion, finite_differences, smoothing_spline

Values = Sequence[np.ndarray]
"""Displacements, one array of shape (n_dof, sets, n) a record."""

MAX_SAMPLES = 20_000
"""A record of more is refused: the arrays of the bootstrap would fill the memory, and smoothing decides nothing."""
SINGULAR = 1e-9
"""A column that is, up to this part of its length, a combination of the others cannot be told from them."""
# ---------------------------------------------------------------------------------------------------- regression


def layout_objection(problem: Problem) -> str | None:
    """Why the records cannot be put into a regression, in a sentence; None where they can.

    A regression needs the displacement of every DOF, all at the same times, and a residual affine in its parameters
    whose groups are ratios to the gauge mass.
    """
    system = problem.system
    if not system.affine_in_parameters or system.n_hidden:
        return f"its regression needs a residual that is affine in the parameters, which that of {system.name} is not"
    if any(dict(g.exponents) != {_numerator(g.exponents): 1.0, system.gauge: -1.0} for g in system.groups):
        return f"its regression needs groups that are ratios to {system.gauge}, which those of {system.name} are not"
    for record in problem.records:
        if sorted(c.dof for c in record.channels if c.measures == "displacement") != list(range(system.n_dof)):
            return "its regression needs one displacement channel for every DOF"
        if any(not np.array_equal(c.times, record.channels[0].times) for c in record.channels):
            return "its regression needs all channels of a record sampled at the same times; resample them"
        if record.channels[0].n > MAX_SAMPLES:
            return f"its regression takes at most {MAX_SAMPLES} samples a record; thin them"
        if any(c.offset for c in record.channels) and not system.linear:
            return "it can estimate a sensor's offset for linear systems only; subtract it first"
    return None


def _state(record: Record) -> np.ndarray | None:
    start = record.initial_state
    return None if start is None else np.concatenate([start.displacement, start.velocity])[:, None]


def _numerator(exponents: Mapping[str, float]) -> str:
    return next((name for name, power in exponents.items() if power > 0), "")


@dataclass(frozen=True, eq=False)
class Regression:
    """A problem as ``columns @ unknowns = target``.

    In free vibration the residual is homogeneous in the parameters: the gauge mass is set to 1, and the unknowns are
    the identifiable groups, in the order of ``system.groups``. Where a known force or an added mass tells the scale
    they are all parameters. An unknown sensor offset of a linear system adds a constant to each equation of its record:
    a nuisance unknown after those.

    Several problems of one layout (:func:`bench.layout`) can stand in one, with the records of the first: ``values``
    are the measured displacements, (n_dof, problems, n) a record, ``told`` displacement and velocity at time 0,
    (2 n_dof, problems) a record, None where they are not told.
    """

    system: System
    records: tuple[Record, ...]
    scale_told: bool
    values: tuple[np.ndarray, ...]
    told: tuple[np.ndarray | None, ...]

    @staticmethod
    def of(problem: Problem) -> Regression:
        """Make that of a problem past :func:`layout_objection`; NoEstimate where a displacement never changes."""
        by_dof = [sorted(record.channels, key=lambda c: c.dof) for record in problem.records]
        series = tuple(np.stack([c.values for c in channels])[:, None] for channels in by_dof)
        told = tuple(_state(record) for record in problem.records)
        regression = Regression(problem.system, problem.records, problem.scale_told, series, told)
        for values in regression.values:
            dead = [i for i, series in enumerate(values[:, 0]) if not np.any(series != series[0])]
            if dead:
                where = f"the measured displacement of DOF {dead[0] + 1}"
                raise NoEstimate(f"{where} never changes: check the sensor and its cable", Status.INVALID)
        return regression

    @staticmethod
    def joined(regressions: Sequence[Regression]) -> Regression:
        """Problems of one layout in one."""
        values = zip(*(regression.values for regression in regressions), strict=True)
        told = zip(*(regression.told for regression in regressions), strict=True)
        return replace(
            regressions[0],
            values=tuple(np.concatenate(own, axis=1) for own in values),
            told=tuple(None if own[0] is None else np.concatenate(own, axis=1) for own in told),
        )

    @cached_property
    def times(self) -> tuple[np.ndarray, ...]:
        return tuple(record.channels[0].times for record in self.records)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """What is identified: group names, or parameter names where a force or an added mass is known."""
        return self.system.names if self.scale_told else tuple(g.name for g in self.system.groups)

    @cached_property
    def numerators(self) -> tuple[str, ...]:
        """The parameter of each of these, beside the gauge mass that a group is over."""
        return self.system.names if self.scale_told else tuple(_numerator(g.exponents) for g in self.system.groups)

    def parameters(self, unknowns: np.ndarray) -> dict[str, np.ndarray]:
        """Parameters, each (...), from unknowns (..., q); the gauge mass is 1 where nothing tells it."""
        values = {self.system.gauge: np.ones(unknowns.shape[:-1])}
        values |= {name: unknowns[..., i] for i, name in enumerate(self.numerators)}
        return {name: values[name] for name in self.system.names}

    def equations(self, motions: Sequence[Motion]) -> tuple[np.ndarray, np.ndarray]:
        """Columns (sets, rows, q) and target (sets, rows), record by record, time by time, DOF by DOF."""
        n = self.system.n_dof
        columns, targets = [], []
        with_offset = [any(c.offset for c in record.channels) for record in self.records]
        for i, (record, motion) in enumerate(zip(self.records, motions, strict=True)):
            force = record.force(motion.times, n) if motion.force is None else motion.force
            a_matrix, offset = regression_columns(
                record.rig(self.system), list(motion.x), list(motion.v), list(motion.a), list(force)
            )
            sets, rows = motion.x.shape[1:]
            # regression_columns stacks the DOFs on the first axis and the parameters on the second
            a_matrix = a_matrix.reshape(n, sets, -1, rows).transpose(1, 3, 0, 2).reshape(sets, rows * n, -1)
            offset = offset.reshape(n, sets, rows).transpose(1, 2, 0).reshape(sets, rows * n)
            nuisance = np.zeros((sets, rows * n, n * sum(with_offset)))
            if with_offset[i]:
                first = n * sum(with_offset[:i])
                nuisance[..., first : first + n] = np.tile(np.eye(n), (rows, 1))
            at = [self.system.names.index(name) for name in self.numerators]
            gauge = 0.0 if self.scale_told else a_matrix[..., self.system.names.index(self.system.gauge)]
            columns.append(np.concatenate([a_matrix[..., at], nuisance], axis=-1))
            targets.append(-offset - gauge)
        return np.concatenate(columns, axis=1), np.concatenate(targets, axis=1)

    def finite(self, values: Values) -> tuple[np.ndarray, np.ndarray]:
        """The equations on finite differences of displacements (n_dof, sets, n) a record."""
        return self.equations([finite_differences(t, y) for t, y in zip(self.times, values, strict=True)])

    def splines(self, values: Values, smoother: tuple[int, int], which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The equations on smoothing splines (order, trim) at numbers ``which`` (sets,) of the grid of weights."""
        return self.equations(self.motions(values, smoother, which))

    def motions(self, values: Values, smoother: tuple[int, int], which: np.ndarray) -> list[Motion]:
        """The motion of those splines at the samples, less those left out at the ends.

        The force is smoothed alike, from its values at the samples: smoothing that damps some frequency of the motion
        and not of the force would make the system seem heavier and stiffer than it is.
        """
        order, trim = smoother
        motions = []
        for record, times, y in zip(self.records, self.times, values, strict=True):
            spline, inner = smoothing_spline(times, order), times[trim : times.size - trim]
            weights = spline.weights[which]
            motion = spline.motion(spline.fit(y, weights), inner)
            if any(other.forces for other in self.records):
                pushes = np.array(record.force(times, self.system.n_dof))[:, None]
                motion = motion._replace(force=spline.motion(spline.fit(pushes, weights), inner).x)
            motions.append(motion)
        return motions


def solve(columns: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Least-squares unknowns (sets, q) of columns (sets, rows, q), target (sets, rows), by QR; NaN where singular."""
    q = columns.shape[-1]
    if columns.shape[-2] < q:
        return np.full((columns.shape[0], q), np.nan)
    size = np.linalg.norm(columns, axis=-2)
    with np.errstate(all="ignore"):
        scaled = columns / size[:, None, :]
        healthy = np.all(np.isfinite(scaled), axis=(-2, -1)) & np.all(np.isfinite(target), axis=-1)
        scaled = np.where(healthy[:, None, None], scaled, 0.0)
        both = np.concatenate([scaled, np.where(healthy[:, None], target, 0.0)[..., None]], axis=-1)
        triangle = np.asarray(np.linalg.qr(both, "r"))
        square = triangle[:, :q, :q]
        healthy &= np.min(np.abs(np.diagonal(square, axis1=-2, axis2=-1)), axis=-1, initial=1.0) > SINGULAR
        square = np.where(healthy[:, None, None], square, np.eye(q))
        unknowns = np.linalg.solve(square, triangle[:, :q, q:])[..., 0] / size
    return np.where(healthy[:, None], unknowns, np.nan)


# ----------------------------------------------------------------------------- responses simulated from estimates


def responses(
    system: System,
    p: Mapping[str, np.ndarray],
    record: Record,
    y: np.ndarray,
    guess: np.ndarray,
    told: np.ndarray | None = None,
) -> np.ndarray:
    """Displacements (n_dof, sets, n) simulated at parameters (sets,), from ``told`` starts or the best-fitting ones.

    The vectorised twin of :func:`bench.fitted_start`, on data ``y`` (n_dof, sets or 1, n) in place of the record's:
    Gauss-Newton over the start by finite differences, one step for a linear system (exact), two from ``guess``
    (2 n_dof,) for others. Told starts are of shape (2 n_dof, sets); that of the record is not looked at. Estimated
    offsets are in the response. NaN where it diverges.
    """
    sets, n, rig = np.shape(next(iter(p.values())))[0], system.n_dof, record.rig(system)
    usable = np.all([np.isfinite(value) for value in p.values()], axis=0)
    if not system.linear:
        usable &= ~too_fast(rig, p, guess, record.channels[0].times)
    # a set that is not simulated must not slow the others down
    p = {name: np.where(usable, value, 1.0) for name, value in p.items()}
    offset = np.zeros((n, 1, 1))
    offset[[c.dof for c in record.channels if c.offset]] = 1.0

    def at(theta: np.ndarray) -> np.ndarray:
        times = record.channels[0].times
        # starts (2n, trials, sets): the trials of a set share its parameters
        x = simulate(rig, p, (theta[:n], theta[n:]), times, record.forces).displacement
        data = y[:, None] if theta.ndim == 3 else y
        constant = np.mean(x - data, axis=-1, keepdims=True)
        return np.asarray(x - (offset[:, None] if theta.ndim == 3 else offset) * constant)

    with np.errstate(all="ignore"):
        if told is not None:
            return np.where(usable[:, None], at(told), np.nan)
        size = np.repeat([1.0, 1.0 / record.duration], n)[:, None] * np.max(np.abs(y), axis=(0, 2))
        theta = np.repeat(0.0 * guess[:, None] if system.linear else guess[:, None], sets, 1)
        trials = 1e-3 * np.concatenate([np.zeros((1, 2 * n)), np.eye(2 * n)]).T[..., None] * size[:, None]
        for _ in range(1 if system.linear else 2):
            x = at(theta[:, None] + trials)
            jacobian = (x[:, 1:] - x[:, :1]) / 1e-3
            misfit = (y - x[:, 0]).transpose(1, 0, 2).reshape(sets, -1)
            step = _shortest(jacobian.transpose(2, 0, 3, 1).reshape(sets, -1, 2 * n), misfit)
            theta = theta + size * step.T
            if system.linear:  # the response is affine in the start
                response = x[:, 0] + np.einsum("dqsn,sq->dsn", jacobian, step)
                return np.where(usable[:, None], response, np.nan)
        return np.where(usable[:, None], at(theta), np.nan)


def _shortest(jacobian: np.ndarray, misfit: np.ndarray) -> np.ndarray:
    """Least-squares steps (sets, q), the shortest where several fit equally; zero where the response diverged."""
    healthy = np.all(np.isfinite(jacobian), axis=(-2, -1)) & np.all(np.isfinite(misfit), axis=-1)
    jacobian, misfit = np.where(healthy[:, None, None], jacobian, 0.0), np.where(healthy[:, None], misfit, 0.0)
    # in the basis of the columns' own products: far cheaper than a decomposition of the columns
    with np.errstate(over="ignore"):
        products = np.swapaxes(jacobian, -1, -2) @ jacobian
    bounded = np.all(np.isfinite(products), axis=(-2, -1))  # a response of 1e200 has none
    jacobian = np.where(bounded[:, None, None], jacobian, 0.0)
    values, vectors = np.linalg.eigh(np.where(bounded[:, None, None], products, 0.0))
    seen = values > 1e-12 * values[:, -1:]
    along = np.einsum("sqk,snq,sn->sk", vectors, jacobian, misfit, optimize=True)
    return np.asarray(np.einsum("sqk,sk->sq", vectors, np.where(seen, along, 0.0) / np.where(seen, values, 1.0)))


def too_fast(system: System, p: Mapping[str, np.ndarray], state: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Which parameter sets (sets,) move faster than samples can show: over π radians a step, at rest or at a state.

    Not finite counts.
    """
    rates = fastest_rates(system, p, state[:, None])
    return np.asarray(~np.all(rates * np.median(np.diff(times)) <= np.pi, axis=0))


def answer(
    regression: Regression,
    unknowns: np.ndarray,
    covariance: np.ndarray | None,
    message: str = "",
    traces: Mapping[str, np.ndarray] | None = None,
    dimensions: Mapping[str, Sequence[Dimension]] | None = None,
) -> Estimate:
    """Make the Estimate of unknowns (q,): groups, or parameters where the scale is told.

    Nuisance unknowns are dropped. For parameters the covariance goes to the logarithms to first order. Raises
    NoEstimate for unknowns that are not finite, and for parameters that are not positive.
    """
    system, d = regression.system, len(regression.names)
    mean = unknowns[:d]
    if not np.all(np.isfinite(mean)):
        raise NoEstimate("the equations do not determine the parameters: take more samples, or samples of more motion")
    cov = None if covariance is None else covariance[:d, :d]
    fitted_starts = sum(2 * system.n_dof for record in regression.records if record.initial_state is None)
    samples = sum(record.n for record in regression.records)
    dof = float(max(1, samples - unknowns.size - fitted_starts))
    parameters = groups = None
    if not regression.scale_told:
        groups = Normal(regression.names, mean, cov, log=False, dof=dof)
    elif np.any(mean <= 0):
        name = regression.names[int(np.argmin(mean))]
        sentence = f"the estimate of {name} is negative: the derivatives are too noisy; take more samples or less noise"
        raise NoEstimate(sentence)
    else:
        cov = None if cov is None else cov / np.outer(mean, mean)
        parameters = Normal(regression.names, np.log(mean), cov, log=True, dof=dof)
    return Estimate(system, parameters, groups, message=message, traces=traces or {}, dimensions=dimensions or {})
