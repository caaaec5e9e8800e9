"""The regression that SRIVC repeats (:mod:`methods.regression.srivc`): regressors, target, instruments.

The unknowns are, in this order, those that there are of: ``c/m, k/m`` (always), ``1/m`` (under a force), ``x₀, w₀``
(an untold start), the offset. Everything is in the natural units of the problem.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench import Force, InitialState, NoEstimate, Normal, Problem, Quantity, Record, System, simulate

FINER = 2
"""Points of the simulated response a step of the samples: its spline makes the instruments."""
FASTEST = 1e4
"""Rates beyond this many a record are no answer, and their simulation would overflow."""
REST = (np.zeros(1), np.zeros(1))
PUSHED = (np.zeros(1), np.ones(1))


@dataclass(frozen=True, eq=False)
class Equations:
    """At some parameters: ``regressors`` (n, q), ``target`` (n,), ``instruments`` (n, q), ``residuals`` (n,)."""

    regressors: np.ndarray
    target: np.ndarray
    instruments: np.ndarray
    residuals: np.ndarray

    @property
    def information(self) -> np.ndarray:
        """That of the data on the unknowns at unit noise, (q, q)."""
        return np.asarray(self.instruments.T @ self.instruments)

    @property
    def noise(self) -> float:
        """Variance of the residuals, q degrees of freedom spent."""
        n, q = self.instruments.shape
        return float(self.residuals @ self.residuals) / max(n - q, 1)

    def solution(self) -> np.ndarray:
        """The instrumental-variable estimate (q,); raises LinAlgError where the instruments do not decide it."""
        return np.linalg.solve(self.instruments.T @ self.regressors, self.instruments.T @ self.target)


@dataclass(frozen=True, eq=False)
class Model:
    """One record of one mass, displacements against time, under forces or free."""

    problem: Problem

    @property
    def _record(self) -> Record:
        return self.problem.records[0]

    @property
    def _times(self) -> np.ndarray:
        return self._record.channels[0].times

    @property
    def _values(self) -> np.ndarray:
        return self._record.channels[0].values

    @property
    def _offset(self) -> bool:
        return self._record.channels[0].offset

    @cached_property
    def _fine(self) -> np.ndarray:
        """The samples, time 0 and points between: of which those at ``_samples`` are the samples."""
        knots = np.unique(np.append(0.0, self._times))
        return np.interp(np.arange(FINER * (knots.size - 1) + 1) / FINER, np.arange(knots.size), knots)

    @cached_property
    def _samples(self) -> np.ndarray:
        """Where the samples stand among the fine times."""
        return np.arange(0, self._fine.size, FINER)[-self._times.size :]

    @property
    def size(self) -> int:
        """How many unknowns there are."""
        return 2 + self.problem.forced + 2 * (not self.problem.start_known) + self._offset

    def parameters(self, damping: float, stiffness: float, mass: float = 1.0) -> dict[str, float]:
        """The system's parameters by their own names, of c/m and k/m."""
        values = {"mass": mass, "damping": damping * mass, "stiffness": stiffness * mass}
        return {p.name: values[p.kind] for p in self.problem.system.parameters}

    def _motions(self, damping: float, stiffness: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Displacement under the force from rest at unit mass, S' and S, each at the fine times."""
        system, p = self.problem.system, self.parameters(damping, stiffness)
        free = simulate(system, p, PUSHED, self._fine)
        pushed = np.zeros(self._fine.size)
        if self.problem.forced:
            pushed = simulate(system, p, REST, self._fine, self._record.forces).displacement[0]
        return pushed, free.velocity[0], free.displacement[0]

    def _columns(self, pushed: np.ndarray, slope: np.ndarray, free: np.ndarray) -> np.ndarray:
        """What the response is linear in, (n_times, q - 2)."""
        columns = [pushed] if self.problem.forced else []
        columns += [] if self.problem.start_known else [slope, free]
        columns += [np.ones_like(free)] if self._offset else []
        return np.stack(columns, axis=1) if columns else np.zeros((free.size, 0))

    @property
    def _start(self) -> tuple[float, float]:
        """The told displacement and velocity at time 0; zeros where it is not told."""
        start = self._record.initial_state
        return (0.0, 0.0) if start is None else (float(start.displacement[0]), float(start.velocity[0]))

    def completed(self, damping: float, stiffness: float) -> tuple[np.ndarray, float]:
        """Unknowns (q,) at c/m and k/m, the rest by least squares on the response, and the sum of its squares.

        NaN and infinite where there is no response.
        """
        motions = self._motions(damping, stiffness)
        if not np.all(np.isfinite(motions)):
            return np.full(self.size, np.nan), np.inf
        pushed, slope, free = (own[self._samples] for own in motions)
        x0, v0 = self._start
        left = self._values - x0 * slope - (v0 + damping * x0) * free
        columns = self._columns(pushed, slope, free)
        rest = np.linalg.lstsq(columns, left, rcond=None)[0]
        return np.append([damping, stiffness], rest), float(np.sum((left - columns @ rest) ** 2))

    def usable(self, theta: np.ndarray) -> bool:
        """Whether unknowns (q,) are those of an oscillator to filter with."""
        return bool(np.all(np.isfinite(theta)) and abs(theta[0]) < FASTEST and 0 < theta[1] < FASTEST**2)

    def equations(self, theta: np.ndarray) -> Equations:
        """The regression filtered by, and with instruments simulated at, unknowns (q,)."""
        damping, stiffness = float(theta[0]), float(theta[1])
        pushed, slope, free = self._motions(damping, stiffness)
        columns, (x0, v0) = self._columns(pushed, slope, free), self._start
        offset = float(theta[-1]) if self._offset else 0.0
        response = columns @ theta[2:] + x0 * slope + (v0 + damping * x0) * free
        measured = self._filtered(damping, stiffness, self._times, self._values - offset)
        simulated = self._filtered(damping, stiffness, self._fine, response - offset)
        at = self._samples
        # A y_f = y holds at every sample: the second derivative needs no spline of its own
        curvature = self._values - offset - damping * measured[1] - stiffness * measured[0]
        target = curvature - x0 * slope[at] - v0 * free[at] + offset

        def rows(filtered: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
            return np.column_stack([x0 * free[at] - filtered[1], -filtered[0], columns[at]])

        return Equations(rows(measured), target, rows(simulated), self._values - response[at])

    def _filtered(
        self, damping: float, stiffness: float, times: np.ndarray, values: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Values at times through 1/A, at the samples: with their derivative."""
        spline, p = Force(times, values, "cubic"), self.parameters(damping, stiffness)
        motion = simulate(self.problem.system, p, REST, self._times, (spline,))
        return motion.displacement[0], motion.velocity[0]

    def unexplained(self, residuals: np.ndarray) -> float:
        """The part of the variance of the samples that residuals (n,) leave."""
        return float(np.sum(residuals**2) / np.sum((self._values - np.mean(self._values)) ** 2))

    def start_of(self, theta: np.ndarray) -> InitialState:
        """The state at time 0 of unknowns (q,): the told one where it is told."""
        told = self._record.initial_state
        if told is not None:
            return told
        x0, w0 = theta[2 + self.problem.forced :][:2]
        return InitialState(np.array([x0]), np.array([w0 - theta[0] * x0]))

    def offset_of(self, theta: np.ndarray) -> float:
        """The sensor's constant of unknowns (q,), 0 where there is none."""
        return float(theta[-1]) if self._offset else 0.0

    def belief(self, theta: np.ndarray, equations: Equations) -> Normal:
        """The log-parameters under a force, k/m and c/m without; NoEstimate where a parameter is not positive."""
        system = self.problem.system
        try:
            covariance = equations.noise * np.linalg.inv(equations.information)
        except np.linalg.LinAlgError:
            raise NoEstimate("the record does not decide the parameters: take more samples or a richer force") from None
        dof = float(max(1, self._times.size - theta.size))
        if not self.problem.forced:
            order = [0 if _of_damping(system, group) else 1 for group in system.groups]
            names = tuple(group.name for group in system.groups)
            return Normal(names, theta[order], covariance[np.ix_(order, order)], log=False, dof=dof)
        if np.any(theta[:3] <= 0):
            name = ("damping", "stiffness", "mass")[int(np.argmin(theta[:3]))]
            raise NoEstimate(f"the estimated {name} is not positive: take more samples or less noise")
        # the logarithms of m, c, k by those of c/m, k/m, 1/m
        powers = {"mass": [0.0, 0.0, -1.0], "damping": [1.0, 0.0, -1.0], "stiffness": [0.0, 1.0, -1.0]}
        rows = np.array([powers[p.kind] for p in system.parameters])
        spread = covariance[:3, :3] / np.outer(theta[:3], theta[:3])
        return Normal(system.names, rows @ np.log(theta[:3]), rows @ spread @ rows.T, log=True, dof=dof)


def _of_damping(system: System, group: Quantity) -> bool:
    return any(p.kind == "damping" and p.name in group.exponents for p in system.parameters)
