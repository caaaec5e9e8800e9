"""The output-error likelihood of many problems at once: exact derivatives, one search for all.

Linear systems move exactly; a subclass of :class:`Batch` says how others do. It is :class:`bench.OutputError`, problem
by problem. Problems of one *layout* differ in their data, told starts and priors alone: same system, sensors, sample
times and forces, so that one call simulates them all. A *case* is one problem with one vector of unknowns; a problem
may have several cases, one a start of its search.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from bench.contract.problem import InitialState, Problem
from bench.dynamics.linear_motion import linear_readings
from bench.likelihood.output_error import LOG_LIMIT, SIGMA_FLOOR, OutputError

ALIKE = 12
"""Decimals, in natural units, to which times, forces and masses of one layout agree."""
LONGEST_STEP = 1.5
"""Of a log-parameter, in one iteration."""
SETTLED = 1e-8
"""What the search may still gain in minus twice the log-posterior where it ends: next to one that is nothing."""


def layout(problem: Problem) -> Hashable:
    """What problems must have in common to be solved together; of a problem in its natural units."""

    def rounded(values: np.ndarray | None) -> bytes:
        return b"" if values is None else (np.round(values, ALIKE) + 0.0).tobytes()

    records = tuple(
        (
            tuple((rounded(c.times), c.measures, c.dof, c.offset) for c in record.channels),
            tuple((rounded(f.times), rounded(f.values), f.hold, f.dof) for f in record.forces),
            record.initial_state is None,
            rounded(record.added_mass),
        )
        for record in problem.records
    )
    return problem.system, records, problem.prior is None


@dataclass(frozen=True, eq=False)
class Batch:
    """The likelihoods of problems of one layout; a vector ``theta`` is that of OutputError.

    A subclass for systems that are not linear has :meth:`readings` of its own.

    ``cases`` everywhere: the number of the problem of each case, shape (cases,).
    """

    models: tuple[OutputError, ...]

    @cached_property
    def first(self) -> OutputError:
        return self.models[0]

    @cached_property
    def data(self) -> np.ndarray:
        """Shape (problems, N)."""
        return np.stack([model.data for model in self.models])

    @cached_property
    def rms(self) -> np.ndarray:
        """Root mean square of each channel, shape (problems, channels)."""
        return np.stack([model.rms for model in self.models])

    @cached_property
    def _told(self) -> list[np.ndarray | None]:
        """By record, the told starts (problems, 2 n_dof)."""
        records = zip(*(model.problem.records for model in self.models), strict=True)
        return [None if own[0].initial_state is None else np.stack([_state(r.initial_state) for r in own])
                for own in records]  # fmt: skip

    @cached_property
    def _prior(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Means and precisions of the log-parameters, each of shape (problems, parameters)."""
        priors = [model.prior for model in self.models]
        if priors[0] is None:
            return None
        known = [prior for prior in priors if prior is not None]
        return np.stack([prior.log_mean for prior in known]), np.stack([1.0 / prior.log_sds for prior in known])

    def starts(self, cases: np.ndarray, theta: np.ndarray) -> list[np.ndarray]:
        """By record, displacements and velocities at time 0, told or of ``theta``, each of shape (cases, 2 n_dof)."""
        at, n2, found = len(self.first.free), 2 * self.first.system.n_dof, list[np.ndarray]()
        for told in self._told:
            found.append(theta[:, at : at + n2] if told is None else told[cases])
            at += n2 * (told is None)
        return found

    def readings(
        self, cases: np.ndarray, number: int, p: Mapping[str, np.ndarray], start: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """What the sensors of record ``number`` would show, and its derivatives, as :func:`linear_readings`.

        Derivatives by a told start need not be there.
        """
        return linear_readings(self.first.system, p, start, self.first.problem.records[number])

    def for_screening(self, cases: np.ndarray, theta: np.ndarray) -> Self:
        """The same, as exact as comparing starts near ``theta`` (cases, size) asks for; itself where it is exact."""
        return self

    def refined(self, cases: np.ndarray, theta: np.ndarray, sigma: np.ndarray) -> Self:
        """The same, as exact as answers near ``theta`` must be at noise ``sigma`` (cases, channels); maybe itself."""
        return self

    def coarse(self, cases: np.ndarray, theta: np.ndarray, sigma: np.ndarray) -> np.ndarray:
        """Whether an answer at ``theta`` would have to be more exact, shape (cases,)."""
        return np.zeros(cases.size, bool)

    def predict(self, cases: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Simulated measurements (cases, N) and their exact derivatives (cases, N, size)."""
        first, n2 = self.first, 2 * self.first.system.n_dof
        names, k = first.system.names, len(first.free)
        logs = [names.index(name) for name in first.free]
        p = first.parameters(theta)
        values, slopes, at = [], [], k
        for number, (start, told) in enumerate(zip(self.starts(cases, theta), self._told, strict=True)):
            value, slope = self.readings(cases, number, p, start)
            own = np.zeros((*value.shape, first.size))
            own[..., :k] = slope[..., logs]
            if told is None:
                own[..., at : at + n2] = slope[..., len(names) :]
                at += n2
            values.append(value)
            slopes.append(own)
        predicted, derivatives = np.concatenate(values, axis=1), np.concatenate(slopes, axis=1)
        for i, channel in enumerate(first.offset_channels):
            derivatives[:, first.channel_of == channel, at + i] = 1.0
        return predicted + first.offsets(theta)[..., first.channel_of], derivatives

    def noise(self, cases: np.ndarray, residuals: np.ndarray, used: np.ndarray, floor: float) -> np.ndarray:
        """As :meth:`OutputError.noise`, shape (cases, channels); ``used`` (cases,)."""
        first = self.first
        share = np.maximum(1.0 - used / first.data.size, 1.0 / first.data.size)[:, None]
        rss = np.stack([np.sum(residuals[:, first.channel_of == i] ** 2, axis=1) for i in range(first.counts.size)], 1)
        return np.maximum(np.sqrt(rss / (np.maximum(first.counts, 1) * share)), floor * self.rms[cases])

    def penalty(self, cases: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Standardised distances from the prior, shape (cases, parameters); of no length without one."""
        if self._prior is None:
            return np.zeros((len(theta), 0))
        mean, precision = self._prior
        return np.asarray((theta[:, : mean.shape[1]] - mean[cases]) * precision[cases])

    def profile(self, cases: np.ndarray, theta: np.ndarray, residuals: np.ndarray) -> np.ndarray:
        """As :meth:`OutputError.profile_of`, shape (cases,)."""
        finite = np.all(np.isfinite(residuals), axis=1)
        sigma = self.noise(cases, np.where(finite[:, None], residuals, 1.0), np.zeros(len(cases)), SIGMA_FLOOR)
        value = 2 * np.log(sigma) @ self.first.counts + np.sum(self.penalty(cases, theta) ** 2, axis=1)
        return np.where(finite, value, np.inf)

    def rows(self, cases: np.ndarray, at: Point, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Standardised residuals (cases, N + parameters), and minus their derivatives (..., size)."""
        weights = 1.0 / sigma[:, self.first.channel_of]
        r = [weights * (self.data[cases] - at.predicted), -self.penalty(cases, at.theta)]
        j = [weights[..., None] * at.slopes]
        if self._prior is not None:
            own = self._prior[1][cases]
            j.append(own[..., None] * np.eye(own.shape[1], self.first.size))
        return np.concatenate(r, axis=1), np.concatenate(j, axis=1)

    def point(self, cases: np.ndarray, theta: np.ndarray) -> Point:
        """The predictions at vectors of unknowns."""
        with np.errstate(all="ignore"):
            return Point(theta, *self.predict(cases, theta))

    def search(self, cases: np.ndarray, start: Point, sigma: np.ndarray, iterations: int) -> Search:
        """Levenberg-Marquardt at given noise (cases, channels), from a point of each case, all together."""
        search = Search(self, cases, start, sigma)
        for _ in range(iterations):
            going = np.flatnonzero(~search.done)
            if not going.size:
                break
            search.step(going)
        return search


@dataclass(frozen=True, eq=False)
class Point:
    """Vectors of unknowns (cases, size), with their predictions (cases, N) and derivatives (cases, N, size)."""

    theta: np.ndarray
    predicted: np.ndarray
    slopes: np.ndarray

    def at(self, cases: np.ndarray) -> Point:
        """Those of some cases."""
        return Point(self.theta[cases], self.predicted[cases], self.slopes[cases])


class Search:
    """The state of the search: the best point of each case, and how far it is from the minimum.

    ``left`` (cases,): what a Gauss-Newton step would still gain in minus twice the log-posterior; ``done`` where that
    is next to nothing, or where no step is left to try.
    """

    def __init__(self, batch: Batch, cases: np.ndarray, start: Point, sigma: np.ndarray) -> None:
        self.batch, self.cases, self.sigma = batch, cases, sigma
        n, size = start.theta.shape
        self.theta, self.predicted, self.slopes = start.theta.copy(), start.predicted.copy(), start.slopes.copy()
        self.cost, self.damping, self.left = np.full(n, np.inf), np.full(n, 1e-3), np.full(n, np.inf)
        self.hessian, self.gradient = np.zeros((n, size, size)), np.zeros((n, size))
        self.done, self.iterations = np.zeros(n, bool), np.zeros(n, int)
        self._take(np.arange(n), start)

    @property
    def point(self) -> Point:
        return Point(self.theta, self.predicted, self.slopes)

    def _take(self, cases: np.ndarray, point: Point) -> np.ndarray:
        """Keep the points that are better than what there is; returns which."""
        r, j = self.batch.rows(self.cases[cases], point, self.sigma[cases])
        cost = np.sum(r**2, axis=1)
        with np.errstate(invalid="ignore"):
            good = np.isfinite(cost) & np.all(np.isfinite(j), axis=(1, 2)) & (cost < self.cost[cases])
        at, j, r = cases[good], j[good], r[good]
        self.theta[at], self.predicted[at], self.slopes[at] = (
            point.theta[good], point.predicted[good], point.slopes[good]
        )  # fmt: skip
        self.cost[at] = cost[good]
        self.hessian[at] = np.swapaxes(j, 1, 2) @ j
        self.gradient[at] = (np.swapaxes(j, 1, 2) @ r[..., None])[..., 0]
        move = _damped(self.hessian[at], self.gradient[at], np.zeros(at.size))
        self.left[at] = np.sum(move * self.gradient[at], axis=1)
        self.done[at] = self.left[at] < SETTLED
        return good

    def step(self, going: np.ndarray) -> None:
        """One iteration of some cases."""
        move = _damped(self.hessian[going], self.gradient[going], self.damping[going])
        k = len(self.batch.first.free)
        move[:, :k] = np.clip(move[:, :k], -LONGEST_STEP, LONGEST_STEP)
        trial = self.theta[going] + move
        trial[:, :k] = np.clip(trial[:, :k], -LOG_LIMIT, LOG_LIMIT)
        good = self._take(going, self.batch.point(self.cases[going], trial))
        self.iterations[going] += 1
        self.damping[going] *= np.where(good, 0.3, 8.0)
        # a step that rounding undoes, or one that has become next to nothing without a gain
        small = np.max(np.abs(move) / np.maximum(1.0, np.abs(self.theta[going])), axis=1) < 1e-12
        self.done[going] |= small | ~np.isfinite(self.cost[going]) | (self.damping[going] > 1e12)


def _damped(hessian: np.ndarray, gradient: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """Solutions of ``(H + damping diag H) step = gradient``, (cases, size), in units of equal size."""
    sizes = np.sqrt(np.diagonal(hessian, axis1=1, axis2=2)) + 1e-150
    scaled = hessian / (sizes[:, :, None] * sizes[:, None, :])
    scaled = scaled + (damping[:, None, None] + 1e-14) * np.eye(hessian.shape[-1])
    return np.asarray(np.linalg.solve(scaled, (gradient / sizes)[..., None])[..., 0] / sizes)


def used_of(rows: np.ndarray, samples: int) -> np.ndarray:
    """Degrees of freedom that the data spent, ``trace(H_data H^-1)``, of rows (cases, N + parameters, size)."""
    basis, values, _ = np.linalg.svd(rows, full_matrices=False)
    told = values > 1e-12 * values[:, :1]
    return np.asarray(np.sum(np.sum(basis[:, :samples] ** 2, axis=1) * told, axis=1))


def _state(start: InitialState | None) -> np.ndarray:
    assert start is not None
    return np.concatenate([start.displacement, start.velocity])
