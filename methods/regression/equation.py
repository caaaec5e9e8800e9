"""What the equation-error methods share: derivatives of sampled displacements, the regression, its covariance.

LS, RLS, DDNN and SINDy put (displacement, velocity, acceleration) at some times into the residual of the system,
which is affine in the parameters, and solve for them. They differ in how they differentiate and how they solve.

* :func:`finite_differences` and :class:`SmoothingSpline` differentiate samples at irregular times.
* :class:`Regression` turns the motion of every degree of freedom (DOF) into ``columns @ unknowns = target``.
* :func:`spline_fit` is the regression on smoothing splines of many smoothing weights; the one is kept whose estimate,
  simulated, explains the record best.
* :func:`bootstrap_covariance` makes records like the one at hand and fits them again. The textbook covariance of a
  regression is wrong here: its columns are noisy too (errors in variables), and the noise of differentiated data is
  correlated.

Arrays hold many data sets at once: displacements of a record have shape (n_dof, sets, n), time last. Everything works
on a problem in its natural units (:meth:`bench.Problem.natural_units`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple, Protocol

import numpy as np
from numpy.linalg import LinAlgError
from scipy.interpolate import BSpline
from scipy.linalg import eigh

from bench import Estimate, Normal, Problem, Record, Status, System, fastest_rates, regression_columns, simulate


class Motion(NamedTuple):
    """Times (rows,), and displacement, velocity, acceleration, each (n_dof, sets, rows).

    ``force`` of that shape is the known force smoothed like the motion; None means the force itself.
    """

    times: np.ndarray
    x: np.ndarray
    v: np.ndarray
    a: np.ndarray
    force: np.ndarray | None = None


Values = Sequence[np.ndarray]
"""Displacements, one array of shape (n_dof, sets, n) a record."""

SMOOTHERS = ((3, 1), (3, 2), (4, 1), (4, 2))
"""Smoothing splines tried, as (order of the penalised derivative, samples left out at each end).

Degrees are 5 and 7. A natural spline bends wrongly at the ends of a record, so its derivatives there are not used.
"""
WEIGHTS = 40
NEARBY = np.array([-4, -2, 0, 2, 4])
"""Steps on the grid of weights that a bootstrap sample tries about the chosen one."""
FEW_SAMPLES = 120
"""With more samples the smoothing matters little, and a bootstrap sample keeps it as it is."""
MAX_SAMPLES = 20_000
"""A record of more is refused: the arrays of the bootstrap would fill the memory, and smoothing decides nothing."""
SINGULAR = 1e-9
"""A column that is, up to this part of its length, a combination of the others cannot be told from them."""
MEANINGLESS = 0.9
"""A response that leaves more than this part of the variance of the data unexplained does not describe them."""


class Unusable(ValueError):
    """The problem cannot be put into a regression; ``status`` and the message go into the Estimate."""

    def __init__(self, status: Status, sentence: str) -> None:
        self.status = status
        super().__init__(sentence)


# --------------------------------------------------------------------------------------------------- derivatives


def finite_differences(times: np.ndarray, samples: np.ndarray) -> Motion:
    """Central differences over three samples at uneven times, at the interior samples.

    With steps ``h1`` before and ``h2`` after a sample, the parabola through the three gives
    ``x' = -h2/(h1 (h1+h2)) x₋ + (h2-h1)/(h1 h2) x₀ + h1/(h2 (h1+h2)) x₊`` and
    ``x'' = 2/(h1 (h1+h2)) x₋ - 2/(h1 h2) x₀ + 2/(h2 (h1+h2)) x₊``
    (three-point weights of Fornberg, Mathematics of Computation 51 (1988) 699-706; on even times the usual
    ``(x₊ - x₋)/2h`` and ``(x₊ - 2 x₀ + x₋)/h²``). ``times`` (n,) and ``samples`` (..., n); raises Unusable for n < 3.
    """
    if times.size < 3:
        raise Unusable(Status.UNSUPPORTED, "finite differences need at least 3 samples a record")
    before, here, after = samples[..., :-2], samples[..., 1:-1], samples[..., 2:]
    h1, h2 = np.diff(times)[:-1], np.diff(times)[1:]
    both = h1 + h2
    velocity = -h2 / (h1 * both) * before + (h2 - h1) / (h1 * h2) * here + h1 / (h2 * both) * after
    acceleration = 2.0 / (h1 * both) * before - 2.0 / (h1 * h2) * here + 2.0 / (h2 * both) * after
    return Motion(times[1:-1], here, velocity, acceleration)


class SmoothingSpline:
    """Smoothing splines of degree ``2 order - 1`` through samples at fixed, irregular times.

    Such a spline minimises ``sum (y - x(t))² + w ∫ (d^order x / dt^order)² dt``, time counted in mean sampling steps,
    so that a weight ``w`` means the same at any rate and in any unit: it damps frequencies (radians a step) above
    ``w^(-1/(2 order))`` (Wahba, Spline Models for Observational Data, 1990, chapter 1). In the basis that makes fit
    and penalty diagonal at once (Demmler and Reinsch, Numerische Mathematik 24 (1975) 375-382) a weight costs n
    multiplications, so all weights and all data sets are tried together.

    Knots lie at the samples, thinned to at most ``MAX_KNOTS``. Raises Unusable for n < order + 1.
    """

    MAX_KNOTS = 300

    def __init__(self, times: np.ndarray, order: int) -> None:
        self.times, self.order, self.n = times, order, times.size
        if self.n < order + 1:
            raise Unusable(Status.UNSUPPORTED, f"its smoothing spline needs at least {order + 1} samples a record")
        self.step = float(times[-1] - times[0]) / (self.n - 1)
        at = (times - times[0]) / self.step
        knots = at[np.unique(np.linspace(0, self.n - 1, min(self.n, self.MAX_KNOTS)).round().astype(int))]
        degree = 2 * order - 1
        self._knots = np.concatenate([np.full(degree, knots[0]), knots, np.full(degree, knots[-1])])
        basis = self._basis(at)
        fit, penalty = basis.T @ basis, self._penalty(knots)
        blend = float(np.trace(fit) / np.trace(penalty))
        # fit + blend * penalty is positive definite, where fit alone need not be
        try:
            penalised, vectors = eigh(penalty, fit + blend * penalty)
        except LinAlgError:  # to rounding it is not: some times lie too near to each other for the rest
            sentence = "its smoothing spline cannot be told apart at sample times this uneven; thin the closest ones"
            raise Unusable(Status.DIVERGED, sentence) from None
        seen = np.clip(1.0 - blend * penalised, 0.0, 1.0)
        keep = seen > 1e-9
        keep[np.argsort(seen)[: max(0, seen.size - self.n)]] = False
        self._rough = np.clip(penalised[keep], 0.0, None) / seen[keep]
        self._rough[:order] = 0.0  # polynomials below the order are not penalised
        self._vectors = vectors[:, keep] / np.sqrt(seen[keep])
        self._project = self._vectors.T @ basis.T

    def _basis(self, at: np.ndarray, derivative: int = 0) -> np.ndarray:
        count = self._knots.size - 2 * self.order
        return np.asarray(BSpline(self._knots, np.eye(count), 2 * self.order - 1)(at, nu=derivative))

    def _penalty(self, knots: np.ndarray) -> np.ndarray:
        """Gram matrix of the penalised derivatives, exact by Gauss-Legendre quadrature in each interval."""
        nodes, weights = np.polynomial.legendre.leggauss(self.order)
        half = np.diff(knots) / 2
        at = (knots[:-1] + half)[:, None] + half[:, None] * nodes
        rough = self._basis(at.ravel(), self.order) * np.sqrt((half[:, None] * weights).ravel())[:, None]
        return np.asarray(rough.T @ rough)

    @cached_property
    def weights(self) -> np.ndarray:
        """A grid of weights, shape (WEIGHTS,), from a polynomial (largest) to interpolation (smallest)."""
        corner = np.geomspace(1.0 / self.n, 30.0, WEIGHTS)
        return np.asarray(corner ** (-2.0 * self.order))

    def fit(self, samples: np.ndarray, weights: np.ndarray | float) -> np.ndarray:
        """Spline coefficients (..., n_coefficients) of samples (..., n) at weights that broadcast with (...)."""
        kept = 1.0 / (1.0 + np.asarray(weights)[..., None] * self._rough)
        return np.asarray((samples @ self._project.T * kept) @ self._vectors.T)

    def likely_weights(self, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The most likely weight of the grid and the noise's standard deviation, each (...), for samples (..., n).

        The mode of the restricted likelihood (REML) of: samples = polynomial + integrated white noise + measurement
        noise, both noise levels unknown (Wahba, Annals of Statistics 13 (1985) 1378-1402, where it is called GML). It
        knows nothing of the system, and takes a vibration of fewer than some six samples a cycle for noise.
        """
        parts = samples @ self._project.T
        rough = parts[..., self.order :] ** 2
        outside = np.clip(np.sum(samples**2, -1) - np.sum(parts**2, -1), 0.0, None)
        shrunk = np.maximum(self.weights[:, None] * self._rough[self.order :], 1e-300)
        kept = 1.0 / (1.0 + shrunk)
        # the quadratic form of the likelihood, (..., weights); a floor keeps exact data finite
        form = rough @ (1.0 - kept).T + outside[..., None]
        size = np.maximum(np.sum(rough, -1) + outside, 1e-300)
        dof = self.n - self.order
        log_det = np.sum(np.log1p(1.0 / shrunk), axis=-1)
        best = np.argmin(dof * np.log(np.maximum(form, 1e-28 * size[..., None])) + log_det, axis=-1)
        # residual power over the degrees of freedom that the spline left (Wahba 1990, section 4.7)
        left = 1.0 - kept[best]
        freedom = np.maximum(self.n - self.order - np.sum(kept[best], axis=-1), 1.0)
        return self.weights[best], np.sqrt((np.sum(rough * left**2, axis=-1) + outside) / freedom)

    def motion(self, coefficients: np.ndarray, times: np.ndarray) -> Motion:
        """The splines, their velocities and accelerations at the times (rows,), each (..., rows)."""
        at = (times - self.times[0]) / self.step
        x, v, a = (coefficients @ self._basis(at, i).T / self.step**i for i in range(3))
        return Motion(times, x, v, a)


@lru_cache(maxsize=64)
def _spline_at(times: bytes, order: int) -> SmoothingSpline:
    return SmoothingSpline(np.frombuffer(times), order)


def smoothing_spline(times: np.ndarray, order: int) -> SmoothingSpline:
    """The smoother for these times (n,); made once and kept, since replicates share their times."""
    return _spline_at(np.ascontiguousarray(times, float).tobytes(), order)


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


def _numerator(exponents: Mapping[str, float]) -> str:
    return next((name for name, power in exponents.items() if power > 0), "")


@dataclass(frozen=True, eq=False)
class Regression:
    """A problem as ``columns @ unknowns = target``.

    In free vibration the residual is homogeneous in the parameters: the gauge mass is set to 1, and the unknowns are
    the identifiable groups, in the order of ``system.groups``. Where a known force or an added mass tells the scale
    they are all parameters. An unknown sensor offset of a linear system adds a constant to each equation of its record:
    a nuisance unknown after those.
    """

    system: System
    records: tuple[Record, ...]
    scale_told: bool

    @staticmethod
    def of(problem: Problem) -> Regression:
        """The regression of a problem; raises Unusable with a sentence where it has none."""
        objection = layout_objection(problem)
        if objection:
            raise Unusable(Status.UNSUPPORTED, objection)
        regression = Regression(problem.system, problem.records, problem.scale_told)
        for values in regression.values:
            dead = [i for i, series in enumerate(values[:, 0]) if not np.any(series != series[0])]
            if dead:
                where = f"the measured displacement of DOF {dead[0] + 1}"
                raise Unusable(Status.INVALID, f"{where} never changes: check the sensor and its cable")
        return regression

    @cached_property
    def times(self) -> tuple[np.ndarray, ...]:
        return tuple(record.channels[0].times for record in self.records)

    @cached_property
    def values(self) -> tuple[np.ndarray, ...]:
        """The measured displacements, (n_dof, 1, n) a record."""
        by_dof = [sorted(record.channels, key=lambda c: c.dof) for record in self.records]
        return tuple(np.stack([c.values for c in channels])[:, None] for channels in by_dof)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """What is identified: group names, or parameter names where a force or an added mass is known."""
        return self.system.names if self.scale_told else tuple(g.name for g in self.system.groups)

    @cached_property
    def _unknown(self) -> tuple[str, ...]:
        return self.system.names if self.scale_told else tuple(_numerator(g.exponents) for g in self.system.groups)

    def parameters(self, unknowns: np.ndarray) -> dict[str, np.ndarray]:
        """Parameters, each (...), from unknowns (..., q); the gauge mass is 1 where nothing tells it."""
        values = {self.system.gauge: np.ones(unknowns.shape[:-1])}
        values |= {name: unknowns[..., i] for i, name in enumerate(self._unknown)}
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
            at = [self.system.names.index(name) for name in self._unknown]
            gauge = 0.0 if self.scale_told else a_matrix[..., self.system.names.index(self.system.gauge)]
            columns.append(np.concatenate([a_matrix[..., at], nuisance], axis=-1))
            targets.append(-offset - gauge)
        return np.concatenate(columns, axis=1), np.concatenate(targets, axis=1)

    def finite(self, values: Values) -> tuple[np.ndarray, np.ndarray]:
        """The equations on finite differences of displacements (n_dof, sets, n) a record."""
        return self.equations([finite_differences(t, y) for t, y in zip(self.times, values, strict=True)])

    def splines(self, values: Values, smoother: tuple[int, int], which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The equations on smoothing splines (see SMOOTHERS) at numbers ``which`` (sets,) of the grid of weights."""
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
    system: System, p: Mapping[str, np.ndarray], record: Record, y: np.ndarray, guess: np.ndarray
) -> np.ndarray:
    """Displacements (n_dof, sets, n) simulated at parameters (sets,), from the told start or the best-fitting one.

    The vectorised twin of :func:`bench.fitted_start`, on data ``y`` (n_dof, sets or 1, n) in place of the record's:
    Gauss-Newton over the start by finite differences, one step for a linear system (exact), two from ``guess``
    (2 n_dof,) for others. Estimated offsets are in the response. NaN where it diverges.
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
        if record.initial_state is not None:
            told = np.concatenate([record.initial_state.displacement, record.initial_state.velocity])
            return np.where(usable[:, None], at(np.repeat(told[:, None], sets, 1)), np.nan)
        size = np.max(np.abs(y)) * np.repeat([1.0, 1.0 / record.duration], n)
        theta = np.repeat(0.0 * guess[:, None] if system.linear else guess[:, None], sets, 1)
        trials = 1e-3 * np.concatenate([np.zeros((2 * n, 1)), np.diag(size)], axis=1)[..., None]
        for _ in range(1 if system.linear else 2):
            x = at(theta[:, None] + trials)
            jacobian = (x[:, 1:] - x[:, :1]) / 1e-3
            misfit = (y - x[:, 0]).transpose(1, 0, 2).reshape(sets, -1)
            step = _shortest(jacobian.transpose(2, 0, 3, 1).reshape(sets, -1, 2 * n), misfit)
            theta = theta + size[:, None] * step.T
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


# ------------------------------------------------------------------------------- the spline fit, and the bootstrap


class World(Protocol):
    """What synthetic records are drawn from: a response (n_dof, n) a record, and its noise (n_dof,) a record."""

    @property
    def centres(self) -> tuple[np.ndarray, ...]: ...

    @property
    def noise(self) -> tuple[np.ndarray, ...]: ...


@dataclass(frozen=True, eq=False)
class SplineFit:
    """The regression on smoothing splines: unknowns (q,), the smoother and weight used, and what the data look like.

    ``centres`` (n_dof, n) a record is the response that the unknowns give (or, where none describes the data, the most
    likely spline), ``noise`` (n_dof,) a record the standard deviation of the data about it: a bootstrap's world.
    """

    unknowns: np.ndarray
    smoother: tuple[int, int]
    which: int
    centres: tuple[np.ndarray, ...]
    noise: tuple[np.ndarray, ...]
    explained: bool = True


@dataclass(frozen=True, eq=False)
class _Trial:
    """Estimates (sets, candidates, q) on splines, their deviance (sets, candidates), their responses a record."""

    unknowns: np.ndarray
    deviance: np.ndarray
    responses: tuple[np.ndarray, ...]


def _try(regression: Regression, values: Values, smoothers: Sequence[tuple[int, int]], which: np.ndarray) -> _Trial:
    """Every smoother at every weight number ``which`` (w,), on displacements (n_dof, sets, n) a record.

    The deviance is minus twice the log-likelihood of the simulated response, the noise level of each channel unknown:
    ``sum n log(mean squared misfit)``. It is infinite for a response that describes nothing.
    """
    sets, found = values[0].shape[1], []
    for smoother in smoothers:
        repeated = [np.repeat(y, which.size, axis=1) for y in values]
        unknowns = solve(*regression.splines(repeated, smoother, np.tile(which, sets)))
        found.append(unknowns.reshape(sets, which.size, -1))
    candidates = np.concatenate(found, axis=1)
    count = candidates.shape[1]
    p = regression.parameters(candidates.reshape(sets * count, -1))
    simulated, deviance = [], np.zeros(sets * count)
    for record, times, y in zip(regression.records, regression.times, values, strict=True):
        repeated_y = np.repeat(y, count, axis=1)
        x = responses(regression.system, p, record, repeated_y, _start_guess(times, np.mean(y, axis=1)))
        with np.errstate(all="ignore"):
            square, power = np.mean((x - repeated_y) ** 2, axis=-1), np.var(repeated_y, axis=-1)
            deviance += np.sum(times.size * np.log(np.maximum(square, 1e-28 * power)), axis=0)
            deviance = np.where(np.all(square < MEANINGLESS * power, axis=0), deviance, np.inf)
        simulated.append(x.reshape(x.shape[0], sets, count, -1))
    return _Trial(candidates, deviance.reshape(sets, count), tuple(simulated))


def _start_guess(times: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Displacement and velocity at time 0, (2 n_dof,), by the parabola through the first samples of y (n_dof, n)."""
    polynomial = np.linalg.solve(np.vander(times[:3], increasing=True), y[:, :3].T)
    return np.concatenate([polynomial[0], polynomial[1]])


def spline_fit(regression: Regression) -> SplineFit:
    """The regression on splines of each smoother and weight; kept is the one that explains the record best.

    How much to smooth cannot be told from the samples alone where a cycle has few of them (the likelihood of a spline
    without a system takes such a vibration for noise). The system can tell: each smoother and weight gives an
    estimate, each estimate a simulated response, and the response of largest likelihood names the smoothing.
    """
    usable = _usable(regression)
    # integrating a nonlinear system, or a long record, takes its time: fewer weights
    quick = regression.system.linear and max(t.size for t in regression.times) <= 1000
    which = np.arange(0, WEIGHTS, 1 if quick else 3)
    trial = _try(regression, regression.values, usable, which)
    best = int(np.argmin(trial.deviance[0]))
    if not np.isfinite(trial.deviance[0, best]):
        return _unexplained(regression, usable[0])
    centres = tuple(x[:, 0, best] for x in trial.responses)
    noise = tuple(
        np.sqrt(np.sum((centre - y[:, 0]) ** 2, axis=-1) / _left(regression, record))
        for record, centre, y in zip(regression.records, centres, regression.values, strict=True)
    )
    smoother, weight = usable[best // which.size], int(which[best % which.size])
    return SplineFit(trial.unknowns[0, best], smoother, weight, centres, noise)


def _usable(regression: Regression) -> list[tuple[int, int]]:
    """The smoothers that the shortest record can bear; raises Unusable where there is none."""
    usable = [s for s in SMOOTHERS if all(t.size > max(s[0], 2 * s[1]) for t in regression.times)]
    if not usable:
        needed = min(order for order, _ in SMOOTHERS) + 1
        raise Unusable(Status.UNSUPPORTED, f"its smoothing spline needs at least {needed} samples a record")
    return usable


def _left(regression: Regression, record: Record) -> float:
    """Degrees of freedom that a channel of a record keeps when each pays its share of what was fitted."""
    n_dof = regression.system.n_dof
    shared = len(regression.names) / (len(regression.records) * n_dof)
    own = (0 if record.initial_state is not None else 2) + sum(c.offset for c in record.channels) / n_dof
    return float(max(1.0, record.n / n_dof - shared - own))


def _unexplained(regression: Regression, smoother: tuple[int, int]) -> SplineFit:
    """No smoothing gives a response like the data: fall back on the likelihood of the spline alone."""
    centres, noise, numbers = [], [], []
    for times, y in zip(regression.times, regression.values, strict=True):
        spline = smoothing_spline(times, smoother[0])
        weights, sd = spline.likely_weights(y[:, 0])
        centres.append(spline.motion(spline.fit(y[:, 0], weights), times).x)
        noise.append(sd)
        numbers.append(np.flatnonzero(np.isin(spline.weights, weights)))
    which = int(np.median(np.concatenate(numbers)))
    unknowns = solve(*regression.splines(regression.values, smoother, np.array([which])))[0]
    return SplineFit(unknowns, smoother, which, tuple(centres), tuple(noise), explained=False)


def spline_refit(regression: Regression, fit: SplineFit, values: Values) -> np.ndarray:
    """Unknowns (sets, q) of other data (n_dof, sets, n) a record, each smoothed as :func:`smoothings` says."""
    found = np.full((values[0].shape[1], fit.unknowns.size), np.nan)
    chosen = smoothings(regression, fit, values)
    for smoother in set(s for s, _ in chosen):
        mine = np.array([s == smoother for s, _ in chosen])
        which = np.array([w for _, w in chosen])[mine]
        found[mine] = solve(*regression.splines([y[:, mine] for y in values], smoother, which))
    return found


def smoothings(regression: Regression, fit: SplineFit, values: Values) -> list[tuple[tuple[int, int], int]]:
    """Smoother and number of the weight for each set of other data (n_dof, sets, n) a record.

    For a linear system and few samples each set chooses anew, by its simulated response, among all smoothers and the
    weights near the fit's; else the fit's own is kept.
    """
    sets = values[0].shape[1]
    own = (fit.smoother, fit.which)
    if not regression.system.linear or not fit.explained or max(t.size for t in regression.times) > FEW_SAMPLES:
        return [own] * sets
    usable = _usable(regression)
    which = np.unique(np.clip(fit.which + NEARBY, 0, WEIGHTS - 1))
    deviance = _try(regression, values, usable, which).deviance
    best = np.argmin(deviance, axis=1)
    return [
        (usable[b // which.size], int(which[b % which.size])) if np.isfinite(deviance[i, b]) else own
        for i, b in enumerate(best)
    ]


def bootstrap_covariance(
    fit: World, fitter: Callable[[Values], np.ndarray], rng: np.random.Generator, count: int
) -> np.ndarray | None:
    """Covariance (q, q) of what ``fitter`` finds in ``count`` synthetic data sets; None where too few can be fitted.

    The parametric bootstrap (Efron and Tibshirani, An Introduction to the Bootstrap, 1993, section 6.5): records are
    drawn from the response of a fit plus white noise of its misfit, and fitted like the data.
    ``fitter`` maps displacements (n_dof, count, n) a record to unknowns (count, q). It measures spread, not bias.
    """
    drawn = [
        centre[:, None] + sd[:, None, None] * rng.standard_normal((centre.shape[0], count, centre.shape[1]))
        for centre, sd in zip(fit.centres, fit.noise, strict=True)
    ]
    found = fitter(drawn)
    found = found[np.all(np.isfinite(found), axis=1)]
    if found.shape[0] <= max(found.shape[1] + 1, count // 2):
        return None
    return np.atleast_2d(np.cov(found, rowvar=False))


def answer(
    regression: Regression,
    unknowns: np.ndarray,
    covariance: np.ndarray | None,
    message: str = "",
    traces: Mapping[str, np.ndarray] | None = None,
) -> Estimate:
    """The Estimate of unknowns (q,) in the problem's units: groups, or parameters where the scale is told.

    Nuisance unknowns are dropped. For parameters the covariance goes to the logarithms to first order, and all
    parameters must be positive.
    """
    system, d = regression.system, len(regression.names)
    mean = unknowns[:d]
    if not np.all(np.isfinite(mean)):
        sentence = "the equations do not determine the parameters: take more samples, or samples of more motion"
        return Estimate.failed(system, Status.DIVERGED, sentence)
    cov = None if covariance is None else covariance[:d, :d]
    fitted_starts = sum(2 * system.n_dof for record in regression.records if record.initial_state is None)
    samples = sum(record.n for record in regression.records)
    dof = float(max(1, samples - unknowns.size - fitted_starts))
    if not regression.scale_told:
        groups = Normal(regression.names, mean, cov, log=False, dof=dof)
        return Estimate(system, groups=groups, message=message, traces=traces or {})
    if np.any(mean <= 0):
        name = regression.names[int(np.argmin(mean))]
        sentence = f"the estimate of {name} is negative: the derivatives are too noisy; take more samples or less noise"
        return Estimate.failed(system, Status.DIVERGED, sentence)
    cov = None if cov is None else cov / np.outer(mean, mean)
    parameters = Normal(regression.names, np.log(mean), cov, log=True, dof=dof)
    return Estimate(system, parameters=parameters, message=message, traces=traces or {})


def scales(problem: Problem, regression: Regression) -> np.ndarray:
    """How much one natural unit of each identified quantity is in the units of the (unscaled) problem, shape (d,)."""
    units, system = problem.natural_units(), regression.system
    return np.array([units.of(system.dimension(system.quantity(name))) for name in regression.names])
