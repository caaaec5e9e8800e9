"""Simplified refined instrumental variables for continuous time (SRIVC): one mass under a known force, or free.

With ``a₁ = c/m``, ``a₀ = k/m``, ``b = 1/m`` and ``A(s) = s² + a₁ s + a₀`` the motion from displacement x₀ and velocity
v₀ is ``A(s) X = b F + s x₀ + w₀``, ``w₀ = v₀ + a₁ x₀``. Both sides are filtered by 1/A at the current parameters (the
prefilter). This gives the filtered displacement ``y_f, y_f', y_f''``, the filtered force ``f_f``, and for the initial
state the free response S from unit velocity and its derivative S':

    y_f'' = -a₁ y_f' - a₀ y_f + b f_f + x₀ S' + w₀ S

This is linear in a₁, a₀, b, and in x₀ and w₀ where these are unknown. Where they are known, ``x₀ S' + v₀ S`` belongs to
the left-hand side and ``a₁ x₀ S`` to the regressor of a₁. Least squares would be biased, since y_f is noisy on both
sides. The instruments are regressors computed from the simulated response (the auxiliary model) in place of y, which
has no noise. Each estimate gives a new filter and a new simulation, until convergence (P. C. Young, A. J. Jakeman,
International Journal of Control 31:741, 1980; H. Garnier, L. Wang, eds., Identification of Continuous-time Models from
Sampled Data, 2008, chapter 4).

At convergence, ``y_f'' + a₁ y_f' + a₀ y_f = y`` at every sample for any interpolation of y, and the instruments are the
derivatives of the response by the parameters: the normal equations of the output-error likelihood for white noise. The
force is filtered with the interpolation stated in the problem, y with a cubic spline, the simulated response with one
through twice as many points. Sampling may be uneven. An offset is a constant.

The initial guesses are regressions of the equation of motion on smooth curves (:mod:`methods.starts.equation_error`),
in the order of the misfit of their responses, until one converges. Without a force b is omitted: k/m and c/m are
estimated. The prior and the noise level are not used. The covariance is ``σ² (Zᵀ Z)⁻¹`` with the instruments Z at the
estimate, to first order in the logarithms.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from bench import (
    Card,
    Cost,
    Estimate,
    Force,
    InitialState,
    InputError,
    NoEstimate,
    Normal,
    Problem,
    Scope,
    SimulatedResponse,
    simulate,
)
from methods.modal.free_decay import GROWS, POOR, POOR_FIT
from methods.starts.ambiguity import SearchingIdentifier
from methods.starts.equation_error import regression_starts

SETTLED = 1e-4
"""The iteration has converged when a step is below this fraction of a standard error,"""
ROUNDING = 1e-10
"""or below this fraction of the estimate, since without noise the standard error is zero."""
MOST_GROWTH = 4.0
"""Largest negative c/m of the filter (growth by e^2 over a record); beyond it the sign of c/m is changed."""
FINER = 2
"""Points of the simulated response per sample, for the spline of the instruments."""
FASTEST = 1e4
"""Largest rate per record; the simulation of larger ones would overflow."""
UNSETTLED = (
    "its iteration converged from no initial guess: a longer record, more samples per cycle or less noise is required"
)
UNDETERMINED = "the record does not determine the parameters: more samples or a richer force is required"
REST, UNIT_VELOCITY = (np.zeros(1), np.zeros(1)), (np.zeros(1), np.ones(1))


@dataclass(frozen=True)
class SRIVC(SearchingIdentifier):
    """Refined instrumental variables with at most ``rounds`` iterations from each initial guess."""

    rounds: int = 60

    card: ClassVar[Card] = Card(
        summary="simplified refined instrumental variables for continuous time: prefilter and simulated instruments",
        start="used when known",
        scale="groups",
        reconstruction="own",
        uncertainty="covariance of the instrumental-variable estimate, Student t with N - p degrees of freedom",
        settings_source="rounds: more than any converged development record needed",
        tuning="none; rounds checked on 9 systems (damping 0.3-80 %, 0.7-40 cycles, 12-300 samples, 40-10 dB)",
        title="SRIVC",
        order=155,
    )
    scope: ClassVar[Scope] = Scope(offsets=True, nonlinear=False, max_dof=1)
    works_in = "natural units"

    def __post_init__(self) -> None:
        if self.rounds < 1:
            raise InputError("method.rounds", self.rounds, "at least 1")

    def objection(self, problem: Problem) -> str | None:
        return super().objection(problem) or _objection(problem)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate m, c, k under a force, k/m and c/m without; raises NoEstimate where nothing converges."""
        model, rounds = Model(problem), 0
        for theta in _first_unknowns(model):
            end, spent = self._end(model, theta)
            rounds += spent
            if end is not None:
                return _answer(model, end, Cost(iterations=rounds))
        raise NoEstimate(UNSETTLED, cost=Cost(iterations=rounds))

    def _end(self, model: Model, theta: np.ndarray) -> tuple[np.ndarray | None, int]:
        """Iterate from unknowns (q,); return the converged ones, None without convergence, and the number of rounds."""
        for count in range(1, self.rounds + 1):
            if not (np.all(np.isfinite(theta)) and abs(theta[0]) < FASTEST and 0 < theta[1] < FASTEST**2):
                return None, count
            equations = model.equations(theta)
            try:
                new = equations.solution()
            except np.linalg.LinAlgError:
                return None, count
            move = new - theta
            converged = move @ equations.information @ move <= SETTLED**2 * equations.noise
            if converged or np.max(np.abs(move)) <= ROUNDING * np.max(np.abs(new)):
                return theta, count
            theta = np.append(abs(new[0]) if new[0] < -MOST_GROWTH else new[0], new[1:])
        return None, self.rounds


@dataclass(frozen=True, eq=False)
class Equations:
    """The regression at some parameters: ``regressors``, ``instruments`` (n, q); ``target``, ``residuals`` (n,)."""

    regressors: np.ndarray
    target: np.ndarray
    instruments: np.ndarray
    residuals: np.ndarray

    @property
    def information(self) -> np.ndarray:
        """Return the information matrix of the unknowns at unit noise, (q, q)."""
        return np.asarray(self.instruments.T @ self.instruments)

    @property
    def noise(self) -> float:
        """Return the residual variance with n - q degrees of freedom."""
        n, q = self.instruments.shape
        return float(self.residuals @ self.residuals) / max(n - q, 1)

    def solution(self) -> np.ndarray:
        """Return the instrumental-variable estimate (q,); raises LinAlgError for a singular matrix."""
        return np.linalg.solve(self.instruments.T @ self.regressors, self.instruments.T @ self.target)


class Model:
    """The filtered regression of one displacement record of one mass, under forces or free.

    The unknowns are, in this order: ``c/m, k/m`` (always), ``1/m`` (under a force), ``x₀, w₀`` (unknown initial state),
    the offset (if unknown). All quantities are in the natural units of the problem.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem, self.record = problem, problem.records[0]
        channel, self.known_start = self.record.channels[0], self.record.initial_state
        self.times, self.values, self.offset = channel.times, channel.values, channel.offset
        self.size = 2 + problem.forced + 2 * (self.known_start is None) + self.offset
        known = self.known_start
        self.x0, self.v0 = (0.0, 0.0) if known is None else (float(known.displacement[0]), float(known.velocity[0]))

    @cached_property
    def fine(self) -> np.ndarray:
        """Return the sample times, time 0 and points between them; ``samples`` has the indices of the sample times."""
        knots = np.unique(np.append(0.0, self.times))
        return np.interp(np.arange(FINER * (knots.size - 1) + 1) / FINER, np.arange(knots.size), knots)

    @cached_property
    def samples(self) -> np.ndarray:
        """Return the indices of the samples among the fine times."""
        return np.arange(0, self.fine.size, FINER)[-self.times.size :]

    def parameters(self, damping: float, stiffness: float, mass: float = 1.0) -> dict[str, float]:
        """Return the system's parameters by name from c/m, k/m and the mass."""
        values = {"mass": mass, "damping": damping * mass, "stiffness": stiffness * mass}
        return {p.name: values[p.kind] for p in self.problem.system.parameters}

    def _motions(self, damping: float, stiffness: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return S', S, and the columns (n_fine, q - 2) of the linear unknowns of the response, at the fine times."""
        system, p = self.problem.system, self.parameters(damping, stiffness)
        free = simulate(system, p, UNIT_VELOCITY, self.fine)
        slope, response = free.velocity[0], free.displacement[0]
        columns = np.empty((self.fine.size, 0))
        if self.problem.forced:
            forced = simulate(system, p, REST, self.fine, self.record.forces).displacement[0]
            columns = np.column_stack([columns, forced])
        if self.known_start is None:
            columns = np.column_stack([columns, slope, response])
        if self.offset:
            columns = np.column_stack([columns, np.ones_like(response)])
        return slope, response, columns

    def completed(self, damping: float, stiffness: float) -> tuple[np.ndarray, float]:
        """Fit the other unknowns at c/m and k/m by least squares; return all (q,) and the residual sum of squares.

        These are NaN and infinite where the response is not finite.
        """
        slope, free, columns = (motion[self.samples] for motion in self._motions(damping, stiffness))
        if not (np.all(np.isfinite(columns)) and np.all(np.isfinite(free))):
            return np.full(self.size, np.nan), np.inf
        left = self.values - self.x0 * slope - (self.v0 + damping * self.x0) * free
        rest = np.linalg.lstsq(columns, left, rcond=None)[0]
        return np.append([damping, stiffness], rest), float(np.sum((left - columns @ rest) ** 2))

    def equations(self, theta: np.ndarray) -> Equations:
        """Return the regression with prefilter and instruments at unknowns (q,)."""
        damping, stiffness, offset = float(theta[0]), float(theta[1]), float(theta[-1]) if self.offset else 0.0
        slope, free, columns = self._motions(damping, stiffness)
        response = columns @ theta[2:] + self.x0 * slope + (self.v0 + damping * self.x0) * free
        measured = self._filtered(damping, stiffness, self.times, self.values - offset)
        simulated = self._filtered(damping, stiffness, self.fine, response - offset)
        slope, free, columns, response = (part[self.samples] for part in (slope, free, columns, response))
        # A y_f = y holds at every sample and gives the second derivative without a spline
        curvature = self.values - offset - damping * measured[1] - stiffness * measured[0]
        target = curvature - self.x0 * slope - self.v0 * free + offset

        def rows(filtered: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
            return np.column_stack([self.x0 * free - filtered[1], -filtered[0], columns])

        return Equations(rows(measured), target, rows(simulated), self.values - response)

    def _filtered(
        self, damping: float, stiffness: float, times: np.ndarray, values: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Filter values by 1/A; return the result and its derivative at the samples."""
        spline, p = Force(times, values, "cubic"), self.parameters(damping, stiffness)
        motion = simulate(self.problem.system, p, REST, self.times, (spline,))
        return motion.displacement[0], motion.velocity[0]

    def distribution(self, theta: np.ndarray, equations: Equations) -> Normal:
        """Return the distribution of log-parameters, or of k/m and c/m without a force."""
        system = self.problem.system
        try:
            covariance = equations.noise * np.linalg.inv(equations.information)
        except np.linalg.LinAlgError:
            raise NoEstimate(UNDETERMINED) from None
        dof = float(max(1, self.times.size - theta.size))
        if not self.problem.forced:
            damping = next(p.name for p in system.parameters if p.kind == "damping")
            order = [0 if damping in group.exponents else 1 for group in system.groups]
            names = tuple(group.name for group in system.groups)
            return Normal(names, theta[order], covariance[np.ix_(order, order)], log=False, dof=dof)
        if np.any(theta[:3] <= 0):
            name = ("damping", "stiffness", "mass")[int(np.argmin(theta[:3]))]
            raise NoEstimate(f"the estimated {name} is not positive: more samples or less noise are required")
        # exponents of c/m, k/m and 1/m in m, c, k
        powers = {"mass": [0.0, 0.0, -1.0], "damping": [1.0, 0.0, -1.0], "stiffness": [0.0, 1.0, -1.0]}
        rows = np.array([powers[p.kind] for p in system.parameters])
        spread = covariance[:3, :3] / np.outer(theta[:3], theta[:3])
        return Normal(system.names, rows @ np.log(theta[:3]), rows @ spread @ rows.T, log=True, dof=dof)


def _first_unknowns(model: Model) -> list[np.ndarray]:
    """Return initial unknowns (q,) from regressions on smooth curves, that of least misfit first."""
    by_kind = {p.kind: p.name for p in model.problem.system.parameters}
    completed = []
    for p in regression_starts(replace(model.problem, prior=None)):
        mass, damping, stiffness = (p[by_kind[kind]] for kind in ("mass", "damping", "stiffness"))
        completed.append(model.completed(damping / mass, stiffness / mass))
    return [theta for theta, _ in sorted(completed, key=lambda start: start[1])]


def _answer(model: Model, theta: np.ndarray, cost: Cost) -> Estimate:
    system, record, forced = model.problem.system, model.record, model.problem.forced
    equations, start = model.equations(theta), model.known_start
    distribution = model.distribution(theta, equations)
    if start is None:
        x0, w0 = theta[2 + forced :][:2]
        start = InitialState(np.array([x0]), np.array([w0 - theta[0] * x0]))
    p = model.parameters(float(theta[0]), float(theta[1]), 1.0 / float(theta[2]) if forced else 1.0)
    unexplained = np.sum(equations.residuals**2) / np.sum((model.values - np.mean(model.values)) ** 2)
    return Estimate(
        system,
        parameters=distribution if forced else None,
        groups=None if forced else distribution,
        reconstructions=(SimulatedResponse(system, p, start, record.forces),),
        initial_states=(start,),
        offsets=(float(theta[-1]) if model.offset else 0.0,),
        message=GROWS if theta[0] <= 0 else POOR_FIT if unexplained > POOR else "",
        cost=cost,
    )


def _objection(problem: Problem) -> str | None:
    if sorted(p.kind for p in problem.system.parameters) != ["damping", "mass", "stiffness"]:
        return "it requires one mass, one damping and one stiffness"
    if any(set(g.exponents) == {problem.system.gauge} for g in problem.system.groups):
        return "it requires groups that are ratios to the mass"
    if problem.records[0].n <= Model(problem).size:
        return f"it requires more than {Model(problem).size} samples, the number of unknowns"
    return None
