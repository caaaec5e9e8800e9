"""Simplified refined instrumental variables for continuous time (SRIVC): one mass under a known force, or free.

With ``a₁ = c/m``, ``a₀ = k/m``, ``b = 1/m`` and ``A(s) = s² + a₁ s + a₀`` the motion from displacement x₀ and velocity
v₀ is ``A(s) X = b F + s x₀ + w₀``, ``w₀ = v₀ + a₁ x₀``. Both sides are passed through 1/A of the parameters at hand
(the prefilter), which makes of displacement y its filtered ``y_f, y_f', y_f''``, of the force ``f_f``, and of the start
the free response S from unit velocity and its derivative S':

    y_f'' = -a₁ y_f' - a₀ y_f + b f_f + x₀ S' + w₀ S

This is linear in a₁, a₀, b, and in x₀ and w₀ where they are not told. Where they are, ``x₀ S' + v₀ S`` goes to the left
and ``a₁ x₀ S`` to the regressor of a₁. Least squares would be biased, y_f being noisy on both sides. The instruments
are the regressors made of the simulated response (the auxiliary model) in place of y, without noise. The answer gives a
new filter and a new simulation, until it stays (P. C. Young, A. J. Jakeman, International Journal of Control 31:741,
1980; H. Garnier, L. Wang, eds., Identification of Continuous-time Models from Sampled Data, 2008, chapter 4).

Where it stays, ``y_f'' + a₁ y_f' + a₀ y_f = y`` at every sample, however y is interpolated between them, and the
instruments are the derivatives of the response by the parameters: the normal equations of the output-error likelihood
for white noise. The force is filtered as the problem says that it runs between its samples, y by a cubic spline, the
simulated response by one through twice as many points. Sampling need not be even. An offset is a constant.

It starts at regressions of the equation of motion on smooth curves (:mod:`methods.starts.equation_error`), at the one
whose response has the least misfit; at the next where the iteration does not stay. Without a force b is left out: k/m
and c/m are estimated. The prior and the noise level are not used. The covariance is ``σ² (Zᵀ Z)⁻¹``, Z the instruments
at the answer, to first order in the logarithms.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bench import (
    Card,
    Cost,
    Estimate,
    InputError,
    NoEstimate,
    Problem,
    Serves,
    SimulatedResponse,
)
from methods.discrete.difference import POOR, POOR_FIT
from methods.modal.free_decay import GROWS
from methods.regression.refined import Model
from methods.starts.ambiguity import SearchingIdentifier
from methods.starts.equation_error import regression_starts

SETTLED = 1e-4
"""The iteration has settled when a round moves it by less than this part of a standard error."""
ROUNDING = 1e-10
"""Or by less than this part of itself: where there is no noise, no standard error is."""
MOST_GROWTH = 4.0
"""A filter of negative damping may grow by e^2 over a record. Beyond, the sign of its damping is turned."""
UNSETTLED = (
    "its iteration did not settle from any of its starts: take a longer record, more samples a cycle or less noise"
)


@dataclass(frozen=True)
class SRIVC(SearchingIdentifier):
    """Refined instrumental variables of at most ``rounds`` rounds from each start."""

    rounds: int = 60

    card: ClassVar[Card] = Card(
        summary="simplified refined instrumental variables for continuous time: prefilter and simulated instruments",
        start="used when known",
        scale="groups",
        reconstruction="own",
        uncertainty="covariance of the instrumental-variable estimate, Student t with N - p degrees of freedom",
        settings_source="rounds: more than any development record took that settled",
        tuning="none; rounds seen on 9 development systems (damping 0.3-80 %, 0.7-40 cycles, 12-300 samples, 40-10 dB)",
        title="SRIVC",
        order=155,
        colour="#3B6FB6",
        marker=(7, 0, 0.0),
    )
    serves: ClassVar[Serves] = Serves(offsets=True, nonlinear=False, max_dof=1)
    works_in = "natural units"

    def __post_init__(self) -> None:
        if self.rounds < 1:
            raise InputError("method.rounds", self.rounds, "at least 1")

    def objection(self, problem: Problem) -> str | None:
        return super().objection(problem) or _objection(problem)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate m, c, k under a force, k/m and c/m without; ``diverged`` with a sentence where nothing settles."""
        model, rounds = Model(problem), 0
        for theta in _starts(model):
            end, spent = self._end(model, theta)
            rounds += spent
            if end is not None:
                return _answer(model, end, Cost(iterations=rounds))
        raise NoEstimate(UNSETTLED, cost=Cost(iterations=rounds))

    def _end(self, model: Model, theta: np.ndarray) -> tuple[np.ndarray | None, int]:
        """Unknowns (q,) at which the iteration stays, None where it does not, and its rounds."""
        for count in range(1, self.rounds + 1):
            if not model.usable(theta):
                return None, count
            equations = model.equations(theta)
            try:
                new = equations.solution()
            except np.linalg.LinAlgError:
                return None, count
            move = new - theta
            settled = move @ equations.information @ move <= SETTLED**2 * equations.noise
            if settled or np.max(np.abs(move)) <= ROUNDING * np.max(np.abs(new)):
                return theta, count
            theta = np.append(abs(new[0]) if new[0] < -MOST_GROWTH else new[0], new[1:])
        return None, self.rounds


def _starts(model: Model) -> list[np.ndarray]:
    """Unknowns (q,) at the regressions on smooth curves, that of least misfit first."""
    problem = model.problem
    by_kind = {p.kind: p.name for p in problem.system.parameters}
    found = []
    for p in regression_starts(replace(problem, prior=None)):
        mass, damping, stiffness = (p[by_kind[kind]] for kind in ("mass", "damping", "stiffness"))
        found.append(model.completed(damping / mass, stiffness / mass))
    return [theta for theta, _ in sorted(found, key=lambda start: start[1])]


def _answer(model: Model, theta: np.ndarray, cost: Cost) -> Estimate:
    system, record = model.problem.system, model.problem.records[0]
    equations, start = model.equations(theta), model.start_of(theta)
    belief = model.belief(theta, equations)
    forced = model.problem.forced
    mass = 1.0 / float(theta[2]) if forced else 1.0
    p = model.parameters(float(theta[0]), float(theta[1]), mass)
    return Estimate(
        system,
        parameters=belief if forced else None,
        groups=None if forced else belief,
        reconstructions=(SimulatedResponse(system, p, start, record.forces),),
        initial_states=(start,),
        offsets=(model.offset_of(theta),),
        message=GROWS if theta[0] <= 0 else POOR_FIT if model.unexplained(equations.residuals) > POOR else "",
        cost=cost,
    )


def _objection(problem: Problem) -> str | None:
    if sorted(p.kind for p in problem.system.parameters) != ["damping", "mass", "stiffness"]:
        return "it needs one mass, one damping and one stiffness"
    if any(set(g.exponents) == {problem.system.gauge} for g in problem.system.groups):
        return "it needs groups that are ratios to the mass"
    if problem.records[0].n <= Model(problem).size:
        return f"it needs more than {Model(problem).size} samples, one an unknown; sample it faster"
    return None
