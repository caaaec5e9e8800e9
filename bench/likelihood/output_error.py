"""Output-error likelihood as a function of one vector of unknowns, and its maximisation.

With Gaussian noise minus twice the log-posterior is ``sum ((y - h) / sigma)² + sum ((log p - log nominal) / sd)²`` plus
a term of the noise level (L. Ljung, System Identification, 2nd ed. 1999, chapters 7 and 10). Problems are in natural
units (:meth:`bench.Problem.natural_units`).
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np

from bench.contract.distribution import Normal
from bench.contract.estimate import Cost, Estimate
from bench.contract.prior import Prior
from bench.contract.problem import Channel, InitialState, Problem, Record
from bench.dynamics.linear_motion import linear_readings
from bench.dynamics.simulate import SimulatedResponse, measurements
from bench.likelihood.least_squares import (
    FIRST_DAMPING,
    Linearisation,
    Minimum,
    StepLimits,
    covariances,
    minimise,
    polish,
)
from bench.systems import System

SIGMA_FLOOR = 1e-4
"""Smallest noise level during a fit, relative to the root mean square of a channel; see ``OutputError.noise``."""
LEAST_NOISE = 1e-8
"""Smallest noise level for a covariance, relative to the root mean square of a channel."""
LOG_LIMIT = 40.0
"""Largest magnitude of a log-parameter in a search."""
LONGEST_STEP = 1.5
"""Largest change of a log-parameter in one iteration; larger steps leave the region where the linearisation holds."""
START_STEPS = 5
"""Number of Gauss-Newton steps for initial states and offsets of a nonlinear system."""

InitialValues = InitialState | tuple[np.ndarray, np.ndarray]
"""Known initial state, or displacement and velocity of several sets, each of shape (n_dof, ...)."""


@dataclass(frozen=True, eq=False)
class SimulatedData:
    """Predictions of a batch.

    Attributes:
        theta: Unknowns, shape (cases, size).
        predicted: Predictions, shape (cases, N).
        slopes: Derivatives of the predictions by the unknowns, shape (cases, N, size).
    """

    theta: np.ndarray
    predicted: np.ndarray
    slopes: np.ndarray

    def __getitem__(self, cases: np.ndarray) -> SimulatedData:
        return SimulatedData(self.theta[cases], self.predicted[cases], self.slopes[cases])

    def put(self, cases: np.ndarray, new: SimulatedData) -> None:
        """Replace some cases in place.

        Args:
            cases: Indices of the cases.
            new: Their new predictions.
        """
        self.theta[cases], self.predicted[cases], self.slopes[cases] = new.theta, new.predicted, new.slopes


@dataclass(frozen=True, eq=False)
class OutputError:
    """Predictions and likelihood of a problem as functions of a vector of unknowns ``theta``, vectorised over vectors.

    ``theta`` consists of the log-parameters (without the gauge mass if the scale is not identifiable), displacement and
    velocity at time 0 of each record with unknown initial state, and the unknown offsets.

    :meth:`batch` combines problems of one layout: the arrays named in ``per_problem`` then have a leading axis over
    problems, and after indexing by ``model[cases]`` over cases, like ``theta``.

    Attributes:
        problem: Problem in natural units.
        gauge: Value of the gauge mass if it is not estimated.
    """

    problem: Problem
    gauge: float = 1.0

    per_problem: ClassVar[tuple[str, ...]] = ("data", "rms", "initial_states", "log_mean", "precision", "mass_unit")

    @classmethod
    def batch(cls, models: Sequence[OutputError]) -> Self:
        """Combine the likelihoods of problems of one layout; ``problem`` is that of the first."""
        joined: Any = copy(models[0])
        for name in joined.per_problem:
            joined.__dict__[name] = np.stack([getattr(model, name) for model in models])
        joined.__dict__["mass_unit"] = joined.mass_unit / joined.mass_unit[0]
        return joined

    def __getitem__(self, cases: np.ndarray) -> Self:
        """Choose problems of a batch by number, for one case each."""
        chosen = copy(self)
        chosen.__dict__.update({name: getattr(self, name)[cases] for name in self.per_problem})
        return chosen

    @property
    def system(self) -> System:
        return self.problem.system

    @property
    def prior(self) -> Prior | None:
        return self.problem.prior

    @cached_property
    def free(self) -> tuple[str, ...]:
        """Names of the estimated parameters."""
        fixed = {self.system.gauge} if self.prior is None and not self.problem.scale_known else set()
        return tuple(name for name in self.system.names if name not in fixed)

    @cached_property
    def unknown_starts(self) -> tuple[int, ...]:
        return tuple(i for i, record in enumerate(self.problem.records) if record.initial_state is None)

    @cached_property
    def channels(self) -> tuple[tuple[int, Channel], ...]:
        """Record number and channel, in the order of the data."""
        return tuple((i, c) for i, record in enumerate(self.problem.records) for c in record.channels)

    @cached_property
    def offset_channels(self) -> tuple[int, ...]:
        return tuple(i for i, (_, channel) in enumerate(self.channels) if channel.offset)

    @cached_property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.free) + 2 * self.system.n_dof * len(self.unknown_starts) + len(self.offset_channels)

    @cached_property
    def channel_of(self) -> np.ndarray:
        """The channel number of each sample, shape (N,)."""
        return np.repeat(np.arange(len(self.channels)), [channel.n for _, channel in self.channels])

    @cached_property
    def counts(self) -> np.ndarray:
        return np.array([channel.n for _, channel in self.channels])

    @cached_property
    def data(self) -> np.ndarray:
        return np.concatenate([channel.values for _, channel in self.channels])

    @cached_property
    def rms(self) -> np.ndarray:
        """Root mean square of each channel; 1 where it is all zeros."""
        sizes = [float(np.sqrt(np.mean(c.values**2))) if c.n else 0.0 for _, c in self.channels]
        return np.array([size if size > 0 else 1.0 for size in sizes])

    @cached_property
    def initial_states(self) -> np.ndarray:
        """Displacements and velocities at time 0 of each record, zero where unknown, shape (records, 2 n_dof)."""
        rows = np.zeros((len(self.problem.records), 2 * self.system.n_dof))
        for row, record in zip(rows, self.problem.records, strict=True):
            if record.initial_state is not None:
                row[:] = np.concatenate([record.initial_state.displacement, record.initial_state.velocity])
        return rows

    @cached_property
    def log_mean(self) -> np.ndarray:
        """Means of the log-parameters in the prior; of no length without one."""
        return np.zeros(0) if self.prior is None else self.prior.log_mean

    @cached_property
    def precision(self) -> np.ndarray:
        """Reciprocal standard deviations of the log-parameters in the prior."""
        return np.zeros(0) if self.prior is None else 1.0 / self.prior.log_sds

    @cached_property
    def mass_unit(self) -> np.ndarray:
        """The unit in which a batch has the same forces and added masses, over the unit of mass of each problem."""
        return np.array(mass_scale(self.problem))

    def parameters(self, theta: np.ndarray) -> dict[str, np.ndarray]:
        """Return the parameters by name, each of the leading shape of ``theta``."""
        values = np.exp(theta[..., : len(self.free)])
        p = {name: values[..., i] for i, name in enumerate(self.free)}
        return {name: p[name] if name in p else np.full(theta.shape[:-1], self.gauge) for name in self.system.names}

    def _parameters_of_batch(self, theta: np.ndarray) -> dict[str, np.ndarray]:
        """Return parameters in the unit of mass in which the forces of all cases equal those of ``problem``."""
        p = self.parameters(theta)
        if not self.mass_unit.ndim:
            return p
        return {q.name: p[q.name] / self.mass_unit**q.dimension.mass for q in self.system.parameters}

    def starts(self, theta: np.ndarray) -> list[InitialValues]:
        """Return the initial state of each record: the known one, or displacement and velocity (n_dof, ...)."""
        n = self.system.n_dof
        states: list[InitialValues] = []
        for record, state in zip(self.problem.records, self.states(theta), strict=True):
            part = np.moveaxis(state, -1, 0)
            known = record.initial_state if self.data.ndim == 1 else None
            states.append((part[:n], part[n:]) if known is None else known)
        return states

    def states(self, theta: np.ndarray) -> list[np.ndarray]:
        """Return displacements and velocities at time 0 of each record, shape (..., 2 n_dof)."""
        place, n2, states = len(self.free), 2 * self.system.n_dof, list[np.ndarray]()
        for number, record in enumerate(self.problem.records):
            if record.initial_state is None:
                states.append(theta[..., place : place + n2])
                place += n2
            else:
                states.append(np.broadcast_to(self.initial_states[..., number, :], (*theta.shape[:-1], n2)))
        return states

    def offsets(self, theta: np.ndarray) -> np.ndarray:
        """Return the offset of each channel (zero if it has none), shape (..., n_channels)."""
        all_offsets = np.zeros((*theta.shape[:-1], len(self.channels)))
        if self.offset_channels:
            all_offsets[..., list(self.offset_channels)] = theta[..., -len(self.offset_channels) :]
        return all_offsets

    def predict(self, theta: np.ndarray) -> np.ndarray:
        """Simulate measurements, shape (..., N); not finite where the response diverges."""
        p = self._parameters_of_batch(theta)
        parts = [
            self.readings(p, start, record)
            for start, record in zip(self.starts(theta), self.problem.records, strict=True)
        ]
        return np.concatenate(parts, -1) + self.offsets(theta)[..., self.channel_of]

    def readings(self, p: dict[str, np.ndarray], start: InitialValues, record: Record) -> np.ndarray:
        """Simulate noise-free measurements of a record without offsets.

        Args:
            p: Parameters by name, arrays of one shape.
            start: Initial state.
            record: The record.

        Returns:
            Values, channel after channel, shape (..., n).
        """
        return measurements(self.system, p, start, record)

    @property
    def exact_slopes(self) -> bool:
        """True if :meth:`readings_and_slopes` is available; otherwise derivatives are central differences."""
        return self.system.linear

    def jacobian(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute predictions (..., N) and their derivatives (..., N, size) at ``theta`` (..., size)."""
        if not self.exact_slopes:
            return self._differences(theta)
        predicted, slopes = self._assembled(theta.reshape(-1, self.size))
        shape = (*theta.shape[:-1], self.channel_of.size)
        return predicted.reshape(shape), slopes.reshape(*shape, self.size)

    def _differences(self, theta: np.ndarray, first: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Compute predictions, and central differences by the unknowns from index ``first`` on."""
        d, k = self.size - first, len(self.free)
        # One step for all log-parameters: without a force, a common change of all has no effect, and only with equal
        # steps do the errors of the differences cancel as well; otherwise they would appear as information.
        step = 1e-5 * np.where(np.arange(self.size) < k, 1.0, np.maximum(1.0, np.abs(theta)))[..., first:]
        moves = step[..., None] * np.eye(self.size)[first:]
        sets = np.concatenate([theta[..., None, :], theta[..., None, :] + moves, theta[..., None, :] - moves], axis=-2)
        cases = self if self.data.ndim == 1 else self[np.repeat(np.arange(len(theta)), 2 * d + 1)]
        with np.errstate(all="ignore"):
            predicted = cases.predict(sets.reshape(-1, self.size)).reshape(*sets.shape[:-1], -1)
            slopes = (predicted[..., 1 : d + 1, :] - predicted[..., d + 1 :, :]) / (2 * step[..., None])
        return predicted[..., 0, :], np.swapaxes(slopes, -1, -2)

    def _assembled(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Assemble predictions and derivatives at ``theta`` (cases, size) from those of each record."""
        n2, names, k = 2 * self.system.n_dof, self.system.names, len(self.free)
        logs = [names.index(name) for name in self.free]
        p = self._parameters_of_batch(theta)
        predicted = np.empty((len(theta), self.channel_of.size))
        derivatives = np.zeros((*predicted.shape, self.size))
        column, row = k, 0
        for number, (record, state) in enumerate(zip(self.problem.records, self.states(theta), strict=True)):
            values, slopes = self.readings_and_slopes(number, p, state)
            rows = slice(row, row := row + record.n)
            predicted[:, rows], derivatives[:, rows, :k] = values, slopes[..., logs]
            if record.initial_state is None:
                derivatives[:, rows, column : column + n2] = slopes[..., len(names) :]
                column += n2
        for i, channel in enumerate(self.offset_channels):
            derivatives[:, self.channel_of == channel, column + i] = 1.0
        if self.offset_channels:
            predicted += self.offsets(theta)[..., self.channel_of]
        return predicted, derivatives

    def readings_and_slopes(
        self, number: int, p: dict[str, np.ndarray], state: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Predict measurements of a record with derivatives (see :func:`linear_readings`).

        Args:
            number: Index of the record.
            p: Parameters by name, each of shape (cases,).
            state: Displacements and velocities at time 0, shape (cases, 2 n_dof).

        Returns:
            Values (cases, n), and derivatives by the log-parameters and, if it is unknown, the initial state.
        """
        return linear_readings(self.system, p, state, self.problem.records[number])

    def for_screening(self, cases: np.ndarray, theta: np.ndarray) -> Self:
        """Return a likelihood accurate enough to compare initial guesses.

        Args:
            cases: Indices of the problems.
            theta: Initial guesses, shape (cases, size).

        Returns:
            The likelihood, by default this one.
        """
        return self

    def refined(self, cases: np.ndarray, theta: np.ndarray, sigma: np.ndarray) -> Self:
        """Return a likelihood accurate enough for estimates.

        Args:
            cases: Indices of the problems.
            theta: Unknowns near the estimates, shape (cases, size).
            sigma: Noise levels, shape (cases, channels).

        Returns:
            The likelihood, by default this one.
        """
        return self

    def coarse(self, cases: np.ndarray, theta: np.ndarray, sigma: np.ndarray) -> np.ndarray:
        """Decide which cases need a more accurate simulation.

        Args:
            cases: Indices of the problems.
            theta: Unknowns, shape (cases, size).
            sigma: Noise levels, shape (cases, channels).

        Returns:
            Booleans, shape (cases,).
        """
        return np.zeros(cases.size, bool)

    def penalty(self, theta: np.ndarray) -> np.ndarray:
        """Return standardised deviations from the prior, shape (..., n_parameters); empty without a prior."""
        k = self.log_mean.shape[-1]
        return np.asarray((theta[..., :k] - self.log_mean) * self.precision)

    def noise(self, residuals: np.ndarray, used: float | np.ndarray, floor: float = SIGMA_FLOOR) -> np.ndarray:
        """Estimate the noise level of each channel, the square root of ``RSS / (N - used)``.

        Args:
            residuals: Residuals, shape (..., N).
            used: Degrees of freedom used, shape (...,), divided among channels in proportion to their samples.
            floor: Smallest level relative to the root mean square of a channel; below it (80 dB), the weight of the
                prior would be lost to rounding.

        Returns:
            Standard deviations, shape (..., channels).
        """
        n = self.channel_of.size
        share = np.maximum(1.0 - np.asarray(used) / n, 1.0 / n)[..., None]
        squares = residuals**2
        if self.counts.size == 1:
            rss = np.sum(squares, axis=-1, keepdims=True)
        else:
            rss = np.stack([np.sum(squares[..., self.channel_of == i], axis=-1) for i in range(self.counts.size)], -1)
        return np.maximum(np.sqrt(rss / (np.maximum(self.counts, 1) * share)), floor * self.rms)

    def profile(self, theta: np.ndarray) -> Any:
        """Return minus twice the log-posterior, profiled over the noise levels, up to a constant, shape (...,)."""
        with np.errstate(all="ignore"):
            return self.profile_of(theta, self.data - self.predict(theta))

    def profile_of(self, theta: np.ndarray, residuals: np.ndarray) -> Any:
        """Compute :meth:`profile` from residuals.

        Args:
            theta: Unknowns, shape (..., size).
            residuals: Residuals, shape (..., N).

        Returns:
            Values, shape (...,); infinite if a residual is not finite.
        """
        finite = np.all(np.isfinite(residuals), axis=-1)
        sigma = self.noise(np.where(finite[..., None], residuals, 1.0), 0.0)
        value = 2 * np.log(sigma) @ self.counts + np.sum(self.penalty(theta) ** 2, axis=-1)
        return np.where(finite, value, np.inf)[()]

    def point(self, theta: np.ndarray) -> SimulatedData:
        """Compute predictions and derivatives at unknowns (cases, size)."""
        with np.errstate(all="ignore"):
            return SimulatedData(theta, *self.jacobian(theta))

    def standardised(self, point: SimulatedData, sigma: np.ndarray) -> Linearisation:
        """Standardise residuals by the noise, and append standardised deviations from the prior.

        Args:
            point: Predictions.
            sigma: Noise levels, shape (cases, channels).

        Returns:
            Standardised residuals with derivatives.
        """
        weights = 1.0 / sigma[..., self.channel_of]
        residuals, slopes = weights * (point.predicted - self.data), weights[..., None] * point.slopes
        if k := self.precision.shape[-1]:
            rows = self.precision[..., None] * np.eye(k, self.size)
            residuals = np.concatenate([residuals, self.penalty(point.theta)], axis=-1)
            slopes = np.concatenate([slopes, np.broadcast_to(rows, (len(slopes), k, self.size))], axis=-2)
        return Linearisation.of(point.theta, residuals, slopes)

    def search(
        self,
        start: SimulatedData,
        sigma: np.ndarray,
        iterations: int,
        damping: float = FIRST_DAMPING,
        polished: bool = False,
    ) -> tuple[SimulatedData, Minimum]:
        """Maximise the posterior at given noise levels.

        Args:
            start: Predictions at the initial guesses.
            sigma: Noise levels, shape (cases, channels).
            iterations: Largest number of trial steps.
            damping: Initial damping.
            polished: True to take one more Gauss-Newton step at the end.

        Returns:
            Predictions at the maxima, and the results of the searches.
        """

        def evaluate(cases: np.ndarray, theta: np.ndarray) -> Linearisation:
            model = self if self.data.ndim == 1 else self[cases]
            return model.standardised(model.point(theta), sigma[cases])

        size = np.where(np.arange(self.size) < len(self.free), LOG_LIMIT, np.inf)
        limits = StepLimits(np.where(np.isfinite(size), LONGEST_STEP, np.inf), size)
        end = minimise(evaluate, self.standardised(start, sigma), iterations, limits, damping)
        reached = polish(evaluate, end.point) if polished else end.point
        scale, n = sigma[..., self.channel_of], self.channel_of.size
        predicted = self.data + scale * reached.residuals[:, :n]
        return SimulatedData(reached.unknowns, predicted, scale[..., None] * reached.slopes[:, :n]), end

    def settle(self, thetas: np.ndarray, rounds: int = 2, iterations: int = 10) -> np.ndarray:
        """Alternate between fits and estimates of the noise levels.

        Args:
            thetas: Initial guesses, shape (cases, size); those with a response that is not finite are kept.
            rounds: Number of alternations.
            iterations: Largest number of trial steps per fit.

        Returns:
            Unknowns, shape (cases, size).
        """
        point = self.point(thetas)
        for _ in range(rounds):
            residuals = self.data - point.predicted
            finite = np.all(np.isfinite(residuals), axis=-1, keepdims=True)
            sigma = self.noise(np.where(finite, residuals, 1.0), 0.0)
            point, _ = self.search(point, sigma, iterations)
        return point.theta

    def covariance(self, slopes: np.ndarray, sigma: np.ndarray, log_sd: float | None = None) -> np.ndarray | None:
        """Invert the Gauss-Newton Hessian.

        Args:
            slopes: Derivatives of the predictions, shape (N, size).
            sigma: Noise levels, shape (channels,).
            log_sd: Standard deviation of a prior on the log-parameters if the problem has no prior.

        Returns:
            Covariance of theta, shape (size, size); None if a direction is not identifiable.
        """
        k, sigma = len(self.free), np.maximum(sigma, LEAST_NOISE * self.rms)
        precision = self.precision if self.prior is not None else np.full(k, 1.0 / (log_sd or np.inf))
        rows = [slopes / sigma[self.channel_of][:, None], precision[:, None] * np.eye(k, slopes.shape[1])]
        return covariances(np.concatenate(rows)[None])[0]

    def covariances(self, point: SimulatedData, sigma: np.ndarray) -> list[np.ndarray | None]:
        """Compute the covariance of theta for every case.

        Args:
            point: Predictions.
            sigma: Noise levels, shape (cases, channels).

        Returns:
            Covariances, shape (size, size); None if a direction is not identifiable.
        """
        return covariances(self.standardised(point, np.maximum(sigma, LEAST_NOISE * self.rms)).slopes)

    def with_initial_states(self, theta: np.ndarray) -> np.ndarray:
        """Fit initial states and offsets at given parameters by Gauss-Newton steps; for a linear system one is exact.

        Cases (cases, size) with values that are not finite are returned unchanged.
        """
        theta, k = theta.copy(), len(self.free)
        for _ in range((1 if self.system.linear else START_STEPS) * (k < self.size)):
            with np.errstate(all="ignore"):
                predicted, slopes = self.jacobian(theta) if self.exact_slopes else self._differences(theta, k)
            residuals, slopes = self.data - predicted, slopes[..., k - self.size :]
            good = np.all(np.isfinite(residuals), axis=1) & np.all(np.isfinite(slopes), axis=(1, 2))
            theta[good, k:] += (np.linalg.pinv(slopes[good], rcond=1e-12) @ residuals[good, :, None])[..., 0]
        return theta

    def vector(self, p: dict[str, float]) -> np.ndarray:
        """Return ``theta`` for parameters given by name, with fitted initial states and offsets."""
        theta = np.zeros((1, self.size))
        theta[0, : len(self.free)] = np.log([p[name] for name in self.free])
        return self.with_initial_states(theta)[0]


def mass_scale(problem: Problem) -> float:
    """Return the largest force of a problem, or the largest added mass, or 1; all scale with the unit of mass."""
    forces = [float(np.max(np.abs(force.values))) for record in problem.records for force in record.forces]
    added = [float(np.max(r.added_mass)) for r in problem.records if r.added_mass is not None]
    return max(forces, default=0.0) or max(added, default=0.0) or 1.0


def estimate_at(
    model: OutputError, theta: np.ndarray, covariance: np.ndarray | None, used: float, cost: Cost, message: str = ""
) -> Estimate:
    """Return the estimate for a vector of unknowns: of all parameters, or of the groups if the gauge mass is fixed.

    Args:
        model: The likelihood.
        theta: Unknowns, shape (size,).
        covariance: Covariance of theta, shape (size, size); None without uncertainty.
        used: Degrees of freedom used; intervals are those of Student's t with ``N - used`` degrees of freedom.
        cost: Effort of the fit.
        message: Message for the user.

    Returns:
        The estimate in the units of the model.
    """
    system, k, dof = model.system, len(model.free), max(model.data.size - used, 1.0)
    p = {name: float(value) for name, value in model.parameters(theta).items()}
    starts = tuple(s if isinstance(s, InitialState) else InitialState(s[0], s[1]) for s in model.starts(theta))
    spread = None if covariance is None else covariance[:k, :k]
    parameters = groups = None
    if k == len(system.names):
        parameters = Normal(system.names, theta[:k], spread, log=True, dof=dof)
    else:
        # with a gauge of 1 a group is exp(weights . logs); its covariance follows by the delta method
        powers = np.array([group.vector(model.free) for group in system.groups])
        values = np.array([group.value(p) for group in system.groups])
        spread = None if spread is None else values[:, None] * (powers @ spread @ powers.T) * values
        groups = Normal(tuple(group.name for group in system.groups), values, spread, log=False, dof=dof)
    responses = (
        SimulatedResponse(record.rig(system), p, start, record.forces)
        for start, record in zip(starts, model.problem.records, strict=True)
    )
    return Estimate(
        system,
        parameters=parameters,
        groups=groups,
        reconstructions=tuple(responses),
        initial_states=starts,
        offsets=tuple(map(float, model.offsets(theta))),
        message=message,
        cost=cost,
    )
