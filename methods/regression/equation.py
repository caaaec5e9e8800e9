"""The equation of motion as a linear regression, for many data sets at once, and the responses at its estimates.

LS, RLS and SINDy insert displacement, velocity and acceleration into the residual of the system, which is affine in the
parameters, and solve for these. They differ in differentiation and solution. :class:`Regression` turns the motion of
every degree of freedom (DOF) into ``columns @ unknowns = target``.

Displacements of a record have shape (n_dof, sets, n), time last. All quantities are in the problem's natural units.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bench import Problem, Record, System, fastest_rates, regression_columns, simulate
from methods.regression.derivatives import Motion, finite_differences, smoothing_spline

Values = Sequence[np.ndarray]
"""Displacements, one array of shape (n_dof, sets, n) per record."""

MAX_SAMPLES = 20_000
"""Largest number of samples per record, set by the memory of the bootstrap."""
SINGULAR = 1e-9
"""Columns are collinear if the part of a column orthogonal to the others is below this fraction of its norm."""


def layout_objection(problem: Problem) -> str | None:
    """Return why a regression does not support the records; None where it does.

    A regression requires the displacement of every DOF, sampled at the same times, and a residual affine in the
    parameters, with groups that are ratios to the gauge mass.
    """
    system = problem.system
    if not system.affine_in_parameters or system.n_hidden:
        return f"its regression requires an equation of motion affine in the parameters; that of {system.name} is not"
    if any(dict(g.exponents) != {_numerator(g.exponents): 1.0, system.gauge: -1.0} for g in system.groups):
        return f"its regression requires groups that are ratios to {system.gauge}; those of {system.name} are not"
    for record in problem.records:
        if sorted(c.dof for c in record.channels if c.measures == "displacement") != list(range(system.n_dof)):
            return "its regression requires one displacement channel for every DOF"
        if any(not np.array_equal(c.times, record.channels[0].times) for c in record.channels):
            return "its regression requires the same sample times in all channels of a record; resample them"
        if record.channels[0].n > MAX_SAMPLES:
            return f"its regression supports at most {MAX_SAMPLES} samples per record; decimate them"
        if any(c.offset for c in record.channels) and not system.linear:
            return "it estimates a sensor's offset for linear systems only; subtract it first"
    return None


def _numerator(exponents: Mapping[str, float]) -> str:
    return next((name for name, power in exponents.items() if power > 0), "")


@dataclass(frozen=True, eq=False)
class Regression:
    """Data sets of one layout as ``columns @ unknowns = target``.

    In free vibration the residual is homogeneous in the parameters: the gauge mass is set to 1, and the unknowns are
    the identifiable groups, in the order of ``system.groups``. Where a known force or an added mass sets the scale,
    the unknowns are all parameters. An unknown sensor offset of a linear system adds a constant to each equation of its
    record, a nuisance unknown that follows these.

    The sets are problems of one layout (:func:`bench.layout`), with the records of the first, or synthetic data like
    theirs: ``values`` are displacements, (n_dof, sets, n) per record, ``starts`` the known displacement and velocity at
    time 0, (2 n_dof, sets) per record, None where they are unknown.
    """

    system: System
    records: tuple[Record, ...]
    scale_known: bool
    values: tuple[np.ndarray, ...]
    starts: tuple[np.ndarray | None, ...]

    @staticmethod
    def of(problems: Sequence[Problem]) -> Regression:
        """Return the regression of problems of one layout, without :func:`layout_objection`."""
        values, starts = [], []
        for same in zip(*(problem.records for problem in problems), strict=True):
            by_dof = [sorted(record.channels, key=lambda c: c.dof) for record in same]
            values.append(np.stack([[c.values for c in channels] for channels in by_dof], axis=1))
            states = [record.initial_state for record in same]
            known = [np.concatenate([s.displacement, s.velocity]) for s in states if s is not None]
            starts.append(np.stack(known, axis=1) if known else None)
        first = problems[0]
        return Regression(first.system, first.records, first.scale_known, tuple(values), tuple(starts))

    @property
    def sets(self) -> int:
        return int(self.values[0].shape[1])

    def __getitem__(self, sets: np.ndarray) -> Regression:
        """Select sets by indices or by a boolean mask."""
        starts = tuple(None if start is None else start[:, sets] for start in self.starts)
        return replace(self, values=tuple(y[:, sets] for y in self.values), starts=starts)

    def repeated(self, count: int) -> Regression:
        """Repeat every set ``count`` times consecutively."""
        return self[np.repeat(np.arange(self.sets), count)]

    def with_values(self, values: Values) -> Regression:
        """Replace the displacements, by equally many consecutive sets for each set."""
        return replace(self.repeated(values[0].shape[1] // self.sets), values=tuple(values))

    @cached_property
    def times(self) -> tuple[np.ndarray, ...]:
        return tuple(record.channels[0].times for record in self.records)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Return the names of the groups, or of the parameters where a force or an added mass is known."""
        return self.system.names if self.scale_known else tuple(g.name for g in self.system.groups)

    @cached_property
    def numerators(self) -> tuple[str, ...]:
        """Return the parameter of each unknown: the numerator of a group, whose denominator is the gauge mass."""
        return self.system.names if self.scale_known else tuple(_numerator(g.exponents) for g in self.system.groups)

    def parameters(self, unknowns: np.ndarray) -> dict[str, np.ndarray]:
        """Return parameters, each (...), of unknowns (..., q); the gauge mass is 1 where nothing sets the scale."""
        values = {self.system.gauge: np.ones(unknowns.shape[:-1])}
        values |= {name: unknowns[..., i] for i, name in enumerate(self.numerators)}
        return {name: values[name] for name in self.system.names}

    def equations(self, motions: Sequence[Motion]) -> tuple[np.ndarray, np.ndarray]:
        """Return columns (sets, rows, q) and target (sets, rows), ordered by record, time and DOF."""
        n = self.system.n_dof
        columns, targets = [], []
        with_offset = [any(c.offset for c in record.channels) for record in self.records]
        for i, (record, motion) in enumerate(zip(self.records, motions, strict=True)):
            force = record.force(motion.times, n) if motion.force is None else motion.force
            matrix, rest = regression_columns(
                record.rig(self.system), list(motion.x), list(motion.v), list(motion.a), list(force)
            )
            sets, rows = motion.x.shape[1:]
            # regression_columns stacks the DOFs on the first axis and the parameters on the second
            matrix = matrix.reshape(n, sets, -1, rows).transpose(1, 3, 0, 2).reshape(sets, rows * n, -1)
            rest = rest.reshape(n, sets, rows).transpose(1, 2, 0).reshape(sets, rows * n)
            nuisance = np.zeros((sets, rows * n, n * sum(with_offset)))
            if with_offset[i]:
                first = n * sum(with_offset[:i])
                nuisance[..., first : first + n] = np.tile(np.eye(n), (rows, 1))
            places = [self.system.names.index(name) for name in self.numerators]
            gauge = 0.0 if self.scale_known else matrix[..., self.system.names.index(self.system.gauge)]
            columns.append(np.concatenate([matrix[..., places], nuisance], axis=-1))
            targets.append(-rest - gauge)
        return np.concatenate(columns, axis=1), np.concatenate(targets, axis=1)

    def finite(self) -> tuple[np.ndarray, np.ndarray]:
        """Return columns and target from finite differences of the displacements."""
        return self.equations([finite_differences(t, y) for t, y in zip(self.times, self.values, strict=True)])

    def splines(self, smoother: tuple[int, int], weights: np.ndarray) -> list[Motion]:
        """Smooth the displacements; return the motion of each record.

        The force is smoothed equally, from its values at the samples: smoothing the motion alone would bias mass and
        stiffness upwards.

        Args:
            smoother: Order of the spline's penalty, and samples left out at each end.
            weights: Index of the smoothing weight on the spline's grid for each set, (sets,).
        """
        order, trim = smoother
        motions = []
        for record, times, y in zip(self.records, self.times, self.values, strict=True):
            spline, inner = smoothing_spline(times, order), times[trim : times.size - trim]
            weight = spline.weights[weights]
            motion = spline.motion(spline.fit(y, weight), inner)
            if any(other.forces for other in self.records):
                force = np.array(record.force(times, self.system.n_dof))[:, None]
                motion = motion._replace(force=spline.motion(spline.fit(force, weight), inner).x)
            motions.append(motion)
        return motions

    def responses(self, unknowns: np.ndarray) -> list[np.ndarray]:
        """Simulate displacements (n_dof, sets, n) per record at unknowns (sets, q); unknown initial states are fitted.

        The responses include estimated offsets. They are NaN where they diverge.
        """
        p = self.parameters(unknowns)
        each = zip(self.records, self.values, self.starts, strict=True)
        return [_response(self.system, p, record, y, start) for record, y, start in each]


def solve(columns: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Solve least squares for columns (sets, rows, q) and target (sets, rows) by QR; NaN where singular, (sets, q)."""
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


def _response(
    system: System, p: Mapping[str, np.ndarray], record: Record, y: np.ndarray, start: np.ndarray | None
) -> np.ndarray:
    """Simulate displacements (n_dof, sets, n) at parameters (sets,), from ``start`` (2 n_dof, sets) or a fitted one.

    The vectorised form of :func:`bench.fit_initial_state`: Gauss-Newton steps for the initial state by finite
    differences, one for a linear system (exact), two for others, from the parabola through the first samples.
    """
    sets, n, rig, times = y.shape[1], system.n_dof, record.rig(system), record.channels[0].times
    guess = np.zeros(2 * n) if system.linear or start is not None else _first_state(times, np.mean(y, axis=1))
    usable = np.all([np.isfinite(value) for value in p.values()], axis=0)
    if not system.linear:
        usable &= ~too_fast(rig, p, guess, times)
    # unusable sets get harmless parameters, so that they do not slow the others down
    p = {name: np.where(usable, value, 1.0) for name, value in p.items()}
    offset = np.zeros((n, 1, 1))
    offset[[c.dof for c in record.channels if c.offset]] = 1.0

    def simulated(theta: np.ndarray) -> np.ndarray:
        # initial states (2n, trials, sets): the trials of a set share its parameters
        x = simulate(rig, p, (theta[:n], theta[n:]), times, record.forces).displacement
        data, with_offset = (y[:, None], offset[:, None]) if theta.ndim == 3 else (y, offset)
        return np.asarray(x - with_offset * np.mean(x - data, axis=-1, keepdims=True))

    with np.errstate(all="ignore"):
        if start is not None:
            return np.where(usable[:, None], simulated(start), np.nan)
        size = np.repeat([1.0, 1.0 / record.duration], n)[:, None] * np.max(np.abs(y), axis=(0, 2))
        theta = np.repeat(guess[:, None], sets, 1)
        trials = 1e-3 * np.concatenate([np.zeros((1, 2 * n)), np.eye(2 * n)]).T[..., None] * size[:, None]
        for _ in range(1 if system.linear else 2):
            x = simulated(theta[:, None] + trials)
            jacobian = (x[:, 1:] - x[:, :1]) / 1e-3
            misfit = (y - x[:, 0]).transpose(1, 0, 2).reshape(sets, -1)
            step = _shortest(jacobian.transpose(2, 0, 3, 1).reshape(sets, -1, 2 * n), misfit)
            theta = theta + size * step.T
        # the response of a linear system is affine in the initial state
        x = x[:, 0] + np.einsum("dqsn,sq->dsn", jacobian, step) if system.linear else simulated(theta)
        return np.where(usable[:, None], x, np.nan)


def _first_state(times: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return displacement and velocity at time 0, (2 n_dof,), from parabolas through the first samples."""
    polynomial = np.linalg.solve(np.vander(times[:3], increasing=True), y[:, :3].T)
    return np.concatenate([polynomial[0], polynomial[1]])


def _shortest(jacobian: np.ndarray, misfit: np.ndarray) -> np.ndarray:
    """Return minimum-norm least-squares steps (sets, q); zero where the response diverged."""
    # eigenvectors of the normal equations are far cheaper than a decomposition of the columns
    with np.errstate(all="ignore"):
        products, moments = np.swapaxes(jacobian, -1, -2) @ jacobian, np.einsum("snq,sn->sq", jacobian, misfit)
    healthy = np.all(np.isfinite(products), axis=(-2, -1)) & np.all(np.isfinite(moments), axis=-1)
    values, vectors = np.linalg.eigh(np.where(healthy[:, None, None], products, 0.0))
    determined = values > 1e-12 * values[:, -1:]
    projected = np.einsum("sqk,sq->sk", vectors, np.where(healthy[:, None], moments, 0.0))
    return np.asarray(
        np.einsum("sqk,sk->sq", vectors, np.where(determined, projected, 0.0) / np.where(determined, values, 1.0))
    )


def too_fast(system: System, p: Mapping[str, np.ndarray], state: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return which sets (sets,) move by more than π radians per sample, at rest or at a state; True if not finite."""
    rates = fastest_rates(system, p, state[:, None])
    return np.asarray(~np.all(rates * np.median(np.diff(times)) <= np.pi, axis=0))
