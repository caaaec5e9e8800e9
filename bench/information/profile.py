"""Profile likelihoods of one replicate: how far a quantity can move while everything else makes up for it.

A quantity is held at values around its estimate and the rest is fitted again (Raue et al., Bioinformatics 25:1923,
2009; Bates and Watts, Nonlinear Regression Analysis, Wiley 1988, chapter 6). No prior enters: the profile of a quantity
that the data do not determine is flat, or does not reach the threshold on one side. The noise level of each channel is
profiled out: ``-log L = sum over channels of n log(rss) / 2``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from bench.contract.problem import Problem, Record
from bench.information.fisher import Information
from bench.information.structural import Structure
from bench.likelihood.least_squares import Linearisation, minimise, polish
from bench.likelihood.output_error import OutputError
from bench.scenario.scenario import Scenario
from bench.systems import Quantity, System

THRESHOLD = float(chi2.ppf(0.95, 1)) / 2
"""Drop of the log-likelihood at the ends of a 95 % interval (Wilks, Ann. Math. Statistics 9:60, 1938)."""
POINTS = 8
"""Number of points on each side of the estimate."""
REACH, FARTHEST = 3.2, math.log(4.0)
"""How far from the estimate: bounds on the standard deviation, but no farther than this in the logarithm."""
TOO_FAR = FARTHEST + 2.5
ROUNDS, HALVINGS, ITERATIONS = 8, 6, 60


@dataclass(frozen=True, eq=False)
class Profile:
    """The profile of one quantity: ``drop`` of the log-likelihood below its maximum at ``values``, both (n,)."""

    quantity: Quantity
    estimate: float
    values: np.ndarray
    drop: np.ndarray

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval; 0 or inf for a side on which the profile does not reach the threshold, or breaks off.

        Interpolated in the square root of the drop, which is a straight line for a parabola.
        """
        root, logs, middle = np.sqrt(self.drop), np.log(self.values), int(np.searchsorted(self.values, self.estimate))
        ends = []
        for side, outside in ((range(middle, -1, -1), 0.0), (range(middle, len(root)), math.inf)):
            end = outside
            for i, j in zip(side, list(side)[1:], strict=False):
                if math.isinf(root[j]):
                    break
                if root[i] < math.sqrt(THRESHOLD) <= root[j]:
                    part = (math.sqrt(THRESHOLD) - root[i]) / (root[j] - root[i])
                    end = float(np.exp(logs[i] + part * (logs[j] - logs[i])))
                    break
            ends.append(end)
        return ends[0], ends[1]


@dataclass(frozen=True, eq=False)
class _EveryParameter(OutputError):
    """Likelihood with all parameters free, even if the scale is not identifiable."""

    @property
    def free(self) -> tuple[str, ...]:  # type: ignore[override]
        return self.system.names


class _Likelihood:
    """The log-likelihood over ``phi``: log-parameters, then the initial state over its scale where it is unknown.

    Log-parameters stay within TOO_FAR of ``centre``.
    """

    def __init__(self, system: System, record: Record, centre: np.ndarray) -> None:
        self.system, self.centre = system, centre
        self.model = _EveryParameter(Problem(system, (record,)))
        size = float(np.max(np.abs(self.model.data))) or 1.0
        self.scale = np.repeat([size, size / record.duration], system.n_dof)
        self.units = np.ones(self.model.size)
        self.units[len(system.names) :] = self.scale[: self.model.size - len(system.names)]

    def residuals(self, phi: np.ndarray) -> np.ndarray:
        """Compute residuals (n_samples,) at ``phi`` (n_phi,)."""
        return self.model.predict(phi * self.units) - self.model.data

    def _levels(self, residuals: np.ndarray) -> np.ndarray:
        """Return the noise level of each channel by its residuals, never quite zero."""
        return self.model.noise(residuals, 0.0, floor=1e-14)

    def maximise(self, base: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the best point of ``base + directions @ u`` near u = 0, directions (n_phi, n_free), and its height.

        Least squares with the channels weighted by their own residuals, until the weights stay: where they do, the
        gradient is that of the likelihood with the noise levels profiled out. The height is the log-likelihood, -inf
        where ``base`` is too far or its response diverges.
        """
        residuals = self.residuals(base)
        if self._too_far(base) or not np.all(np.isfinite(residuals)):
            return base, -math.inf
        levels = self._levels(residuals)
        for _ in range(ROUNDS if directions.size else 0):
            base = self._fitted(base, directions, levels)
            before, levels = levels, self._levels(self.residuals(base))
            if len(levels) == 1 or np.allclose(levels, before, rtol=1e-5, atol=0):
                break
        return base, -float(np.dot(self.model.counts, np.log(levels)))

    def _fitted(self, base: np.ndarray, directions: np.ndarray, levels: np.ndarray) -> np.ndarray:
        """Return the point of least squares at given noise levels."""

        def evaluate(_: np.ndarray, u: np.ndarray) -> Linearisation:
            phi = base + directions @ u[0]
            point = self.model.point(phi[None] * self.units)
            found = self.model.standardised(point, levels[None])
            cost = np.where(self._too_far(phi), np.inf, found.cost)
            return Linearisation(u, found.residuals, found.slopes @ (self.units[:, None] * directions), cost)

        start = evaluate(np.zeros(1, int), np.zeros((1, directions.shape[1])))
        end = minimise(evaluate, start, ITERATIONS)
        return base + directions @ polish(evaluate, end.point).unknowns[0]

    def _too_far(self, phi: np.ndarray) -> bool:
        return bool(np.any(np.abs(phi[: len(self.centre)] - self.centre) > TOO_FAR))


def profiles(
    scenario: Scenario,
    structure: Structure,
    information: Information,
    quantities: Sequence[Quantity],
    seed: int = 0,
    measured: Sequence[int] = (),
) -> list[Profile]:
    """Compute the profiles of quantities on the first replicate of a seed, over the ``measured`` DOFs (default: all).

    ``information`` sets how far to look. The first fit starts at the truth, as the oracle's does: this is no method.
    Along the scalings of ``structure``, on which the response does not depend, it stays where it starts.
    """
    system = scenario.make_system()
    problem, _ = scenario.replicates(seed, 1)[0]
    record = problem.records[0]
    if measured:
        record = replace(record, channels=tuple(c for c in record.channels if c.dof in measured))
    first = np.log([scenario.parameters[name] for name in system.names])
    likelihood = _Likelihood(system, record, first)
    if scenario.initial_state == "unknown":
        start = np.concatenate([scenario.start.displacement, scenario.start.velocity])
        first = np.concatenate([first, start / likelihood.scale])
    scalings = np.zeros((len(structure.scalings), len(first)))
    scalings[:, : len(system.names)] = np.reshape(structure.scalings, (-1, len(system.names)))
    best, highest = likelihood.maximise(first, _complement(scalings))
    data = replace(information, precision=np.zeros_like(information.precision))
    return [_profile(likelihood, q, best, highest, scalings, math.sqrt(data.variance(q))) for q in quantities]


def _complement(rows: np.ndarray) -> np.ndarray:
    """Return orthonormal columns that span everything orthogonal to independent rows."""
    return np.asarray(np.linalg.svd(rows)[2][len(rows) :].T)


def _profile(
    likelihood: _Likelihood, quantity: Quantity, best: np.ndarray, highest: float, scalings: np.ndarray, sd: float
) -> Profile:
    """Walk from the best point to both sides, by steps of the quantity's logarithm, and close in on the interval."""
    names = likelihood.system.names
    w = np.zeros((1, len(best)))
    w[0, : len(names)] = quantity.vector(names)
    step = min(REACH * sd, FARTHEST) / POINTS
    direction = w[0] @ scalings.T @ scalings
    if np.any(direction):
        # along a scaling that changes the quantity the response, hence the maximum, stays: no fit is needed
        free = np.zeros((len(best), 0))
    else:
        direction, free = w[0], _complement(np.concatenate([w, scalings]))
    move = step * direction / (w @ direction).item()
    drops, fitted = {0.0: 0.0}, {0.0: best}

    def visit(place: float, *starts: np.ndarray) -> None:
        for start in starts:
            fitted[place], height = likelihood.maximise(start, free)
            drops[place] = highest - height
            if math.isfinite(height):
                break

    for side in (-1.0, 1.0):
        before = best - side * move
        for i in range(POINTS):
            point = fitted[side * i]
            visit(side * (i + 1), 2 * point - before, point + side * move)
            before = point
        low = next((i for i in range(POINTS) if drops[side * (i + 1)] >= THRESHOLD), None)
        if low is None:
            continue
        inner, outer = side * low, side * (low + 1)
        for _ in range(HALVINGS):  # a fit that comes to an end, at a parameter of zero, has a kink there
            if math.sqrt(max(drops[outer], 0)) - math.sqrt(max(drops[inner], 0)) < 1.0:
                break
            middle = (inner + outer) / 2
            visit(middle, fitted[inner] + (middle - inner) * move)
            inner, outer = (middle, outer) if drops[middle] < THRESHOLD else (inner, middle)
    estimate = float(quantity.value({n: math.exp(v) for n, v in zip(names, best, strict=False)}))
    order = sorted(drops)
    drop = np.array([drops[i] for i in order])
    # a fit on the way that found more than the first one did is the maximum
    return Profile(quantity, estimate, estimate * np.exp(step * np.array(order)), drop - drop.min())
