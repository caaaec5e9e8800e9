"""The likelihood of many problems of a system of any kind at once, by Runge-Kutta steps with their derivatives.

The steps are those of multiple shooting: cuts at every sample and every knot of a force, and between them as many steps
as frequency and noise call for. So the maximum is that of its programme.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bench import Batch, OutputError, Steps
from methods.trajectory.fineness import Fineness, roughly
from methods.trajectory.programme import Plan
from methods.trajectory.stepped_motion import stepped_accelerations, stepped_motion

START_STEPS = 5
"""Gauss-Newton steps of the starts and offsets that fit the data best at given parameters."""


@dataclass(frozen=True, eq=False)
class Stepped(Batch):
    """A :class:`bench.Batch` whose motion is integrated, of problem i by ``substeps[i]`` steps in each interval."""

    substeps: np.ndarray
    fineness: Fineness

    @staticmethod
    def rough(models: Sequence[OutputError], fineness: Fineness) -> Stepped:
        """Problems of one layout, not yet as finely integrated as an answer must be."""
        return Stepped(tuple(models), np.ones(len(models), int), fineness)

    @cached_property
    def _plans(self) -> tuple[Plan, ...]:
        return tuple(Plan(self.first.system, record) for record in self.first.problem.records)

    @property
    def _longest(self) -> float:
        return max(plan.longest for plan in self._plans)

    def readings(
        self, cases: np.ndarray, number: int, p: Mapping[str, np.ndarray], start: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """What the sensors would show, and its derivatives, integrated by each problem's own number of steps."""
        values = np.stack([p[name] for name in self.first.system.names], axis=1)
        counts = self.substeps[cases]
        groups = [np.flatnonzero(counts == count) for count in np.unique(counts)]
        parts = [self._shown(number, int(counts[own[0]]), values[own], start[own]) for own in groups]
        shown = np.concatenate(parts)[np.argsort(np.concatenate(groups))]
        return shown[..., 0], shown[..., 1:]

    def _shown(self, number: int, count: int, p: np.ndarray, start: np.ndarray) -> np.ndarray:
        """Readings and derivatives of some cases by ``count`` steps an interval, shape (cases, N, 1 + q)."""
        plan, record, n = self._plans[number], self.first.problem.records[number], self.first.system.n_dof
        rig = record.rig(self.first.system)
        steps = Steps.over(plan.grid, np.full(plan.steps.size, count), record.forces, n)
        path = stepped_motion(rig, p, start, steps, record.initial_state is None)
        parts = []
        for channel, at, force in zip(record.channels, plan.at, plan.sensor_forces, strict=True):
            states = path[:, at]
            if channel.measures == "acceleration":
                parts.append(stepped_accelerations(rig, p, states, force.T, channel.dof))
            else:
                parts.append(states[..., channel.dof + (n if channel.measures == "velocity" else 0)])
        return np.concatenate(parts, axis=1)

    def for_screening(self, cases: np.ndarray, theta: np.ndarray) -> Stepped:
        """The same with as many steps as it takes to compare starts near ``theta``."""
        counts = roughly(self.first, self._longest, theta, self.starts(cases, theta))
        return self._with(cases, counts, np.ones_like(self.substeps))

    def refined(self, cases: np.ndarray, theta: np.ndarray, sigma: np.ndarray) -> Stepped:
        """The same with as many steps as answers near ``theta`` need, for all cases of a problem alike."""
        return self._with(cases, self._wanted(cases, theta, sigma), self.substeps)

    def coarse(self, cases: np.ndarray, theta: np.ndarray, sigma: np.ndarray) -> np.ndarray:
        """Whether an answer at ``theta`` needs more steps, shape (cases,)."""
        return np.asarray(self._wanted(cases, theta, sigma) > self.substeps[cases])

    def _wanted(self, cases: np.ndarray, theta: np.ndarray, sigma: np.ndarray) -> np.ndarray:
        states = self.starts(cases, theta)
        return self.fineness.substeps(self.first, self._longest, theta, states, sigma, self.rms[cases])

    def _with(self, cases: np.ndarray, counts: np.ndarray, least: np.ndarray) -> Stepped:
        wanted = least.copy()
        np.maximum.at(wanted, cases, counts)
        return self if np.array_equal(wanted, self.substeps) else replace(self, substeps=wanted)

    def with_starts(self, cases: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Vectors with the initial states and offsets that fit the data best at their parameters."""
        k, theta = len(self.first.free), theta.copy()
        for _ in range(START_STEPS if k < self.first.size else 0):
            point = self.point(cases, theta)
            residuals = self.data[cases] - point.predicted
            for i, (left, slopes) in enumerate(zip(residuals, point.slopes[..., k:], strict=True)):
                if np.all(np.isfinite(left)) and np.all(np.isfinite(slopes)):
                    theta[i, k:] += np.linalg.lstsq(slopes, left, rcond=1e-12)[0]
        return theta
