"""Direct multiple shooting: maximum a posteriori by a sparse nonlinear programme (CasADi, IPOPT).

There is a shooting node at every sample and at every knot of a known force. The states at the nodes, the
log-parameters, the initial states and the offsets of the sensors are unknowns; continuity at each node is a constraint
(H. G. Bock, K.-J. Plitt, IFAC Proceedings 17(2):1603, 1984; :mod:`methods.trajectory.programme`). The trajectory can
therefore follow the data from the first iteration on, which a single trajectory at a wrong frequency cannot.

The objective is ``sum ((y - h) / sigma)² + sum ((log p - log nominal) / sd)²``. The noise, ``sigma² = RSS / (N - p)``
for each channel, is estimated in alternation with the fit (:mod:`methods.trajectory.fit`). The covariance is the
inverse of the Gauss-Newton Hessian, with Student's t at ``N - p`` degrees of freedom. Initial guesses come from the
data (:mod:`methods.trajectory.screening`).

Single shooting has the same maximum and is tried first, for many problems at once: with the exact motion of linear
systems, and with Runge-Kutta steps for others. The programme is used where these searches do not converge, and for long
records of nonlinear systems. Where the programme of a linear system has no solution either, for instance because the
likelihood increases towards zero damping, the end of single shooting is returned with a message. Nonlinear systems,
for instance with dry friction, are then solved by continuation (:mod:`methods.trajectory.continuation`).

Errors are normal; with ``likelihood="student"`` the estimate is refined under Student's t errors with four degrees of
freedom, which give little weight to outliers (:mod:`methods.trajectory.student`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bench import EVERY_PROBLEM, SIGMA_FLOOR, Card, Estimate, NoEstimate, OutputError, Problem, Scope, batches
from methods.starts.ambiguity import SearchingIdentifier
from methods.starts.candidates import LONGEST
from methods.starts.wide_prior import very_wide
from methods.trajectory.continuation import solve_by_continuation
from methods.trajectory.fit import WIDE_PRIOR, Maximum, best_maxima, leaves_open, with_wide_prior
from methods.trajectory.programme import shoot
from methods.trajectory.runge_kutta import SteppedOutputError
from methods.trajectory.screening import Guesses, Rules, screen, screen_alone
from methods.trajectory.student import Likelihood, with_student_errors

MOST_ITERATIONS = 60
"""Iteration limit of single shooting."""
MOST_ITERATIONS_ALONE = 200
"""The same where the programme has no solution."""
NO_START = "no initial guess gave a finite response; give a prior closer to the system"
NO_SOLUTION = "IPOPT found no solution from any initial guess; raise max_iterations or give a prior"
NO_PROGRAMME = "multiple shooting has no solution: this is the end of single shooting"
TIED = 0.1
"""Maxima are tied if minus twice their log-posteriors differ by less, with an accurate integration."""


@dataclass(frozen=True)
class Shooting(SearchingIdentifier):
    """Multiple shooting with the Gauss-Newton Hessian.

    At most ``starts`` distinct initial guesses get ``screen_iterations`` output-error steps; shooting starts from those
    whose minus twice log-posterior is within ``margin`` of the best. The error of the integration is at most
    ``integration_error`` of the motion, or ``noise_share`` of the data's standard error, whichever is larger. Fit and
    noise alternate at most ``sigma_rounds`` times, until the noise changes by less than ``sigma_tolerance``.
    ``likelihood="student"`` refines the estimate under Student's t errors.
    """

    starts: int = 3
    screen_iterations: int = 5
    margin: float = 15.0
    integration_error: float = 1e-8
    noise_share: float = 0.05
    sigma_rounds: int = 4
    sigma_tolerance: float = 0.01
    max_iterations: int = 60
    likelihood: Likelihood = "normal"

    card: ClassVar[Card] = Card(
        summary="Direct multiple shooting, Gauss-Newton, maximum a posteriori with the noise estimated",
        start="used when known",
        scale="native",
        reconstruction="own",
        uncertainty="inverse reduced Hessian in the log-parameters, Student t with N - p degrees of freedom",
        settings_source="defaults by reasoning on accuracy and cost",
        tuning="two values of noise_share; development systems at 40 to 5 dB, damping ratio 2-20 %, 2-10 cycles",
        title="Multiple shooting",
        order=10,
        variants={
            "shooting_student": {
                "summary": "multiple shooting, then Student t errors in place of normal ones",
                "uncertainty": "expected information of the t errors in the log-parameters, Student t with N - p "
                "degrees of freedom",
                "tuning": "as shooting; 4 degrees of freedom of the errors as in the literature",
                "title": "Multiple shooting, t errors",
                "order": 15,
            },
        },
    )
    scope: ClassVar[Scope] = EVERY_PROBLEM
    requires: ClassVar[tuple[str, ...]] = ("casadi",)
    extra: ClassVar[str] = "casadi"
    works_in = "natural units"

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate all parameters, or groups where the scale is not identifiable, by shooting. Uses no randomness."""
        return self._answer(problem, None)

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Estimate problems in batches by single shooting where it converges, the others one by one."""
        maxima = self.maxima([OutputError(problem) for problem in problems])
        return [self._answer(problem, maximum) for problem, maximum in zip(problems, maxima, strict=True)]

    def maxima(self, models: Sequence[OutputError]) -> list[Maximum | None]:
        """Return the maxima by single shooting; None where multiple shooting is required."""
        maxima: list[Maximum | None] = [None] * len(models)
        short = [m.system.linear or all(c.n <= LONGEST for _, c in m.channels) for m in models]
        for places in batches(models, [not is_short for is_short in short]):
            if not short[places[0]]:
                continue
            group = [models[i] for i in places]
            batch = self._joined(group)
            guesses = screen(group, batch, self._rules)
            ends = best_maxima(group, batch, guesses, self._rules)
            for i, end, first in zip(places, ends, guesses.first, strict=True):
                if end is not None and end.converged:
                    end = with_wide_prior(end, first, self._joined, self._rules)
                    maxima[i] = end if end is not None and end.converged and end.covariance is not None else None
        return maxima

    def _joined(self, models: Sequence[OutputError]) -> OutputError:
        """Return the batch of problems of one layout, with the exact motion of a linear system or Runge-Kutta steps."""
        return OutputError.batch(list(models) if models[0].system.linear else [self._stepped(m) for m in models])

    def _stepped(self, model: OutputError) -> SteppedOutputError:
        return SteppedOutputError(model.problem, model.gauge, self.integration_error, self.noise_share)

    @property
    def _rules(self) -> Rules:
        return Rules(
            self.starts, self.screen_iterations, self.margin, self.sigma_rounds, self.sigma_tolerance, MOST_ITERATIONS
        )

    def _answer(self, problem: Problem, maximum: Maximum | None) -> Estimate:
        """Return the estimate at a given maximum, or by multiple shooting where it is None."""
        try:
            maximum = self._shot(OutputError(problem)) if maximum is None else maximum
            if self.likelihood == "student":
                maximum = with_student_errors(maximum, self._joined([maximum.model]))
            return maximum.estimate()
        except NoEstimate as reason:
            return Estimate.failed(problem.system, reason.status, str(reason), reason.cost)

    def _shot(self, model: OutputError) -> Maximum:
        """Return the maximum with normal errors by multiple shooting."""
        guesses = screen_alone(model, self._rules)
        if not guesses.cases.size:
            raise NoEstimate(NO_START)
        maximum, starts = self._by_programme(model, guesses.thetas), list(guesses.thetas)
        if model.prior is None and model.problem.scale_known and (maximum is None or np.any(leaves_open(maximum))):
            # the likelihood increases towards a parameter of zero or infinity
            first = {name: float(value) for name, value in model.parameters(guesses.first[0]).items()}
            prior, k = very_wide(first), len(first)
            model = OutputError(replace(model.problem, prior=prior))
            for theta in starts:  # some guesses diverged
                theta[:k] = np.clip(theta[:k], prior.log_mean - prior.log_sds, prior.log_mean + prior.log_sds)
            maximum = self._by_programme(model, np.stack(starts), exact=True)
            maximum = None if maximum is None else replace(maximum, message=WIDE_PRIOR)
        if maximum is None or (model.system.linear and maximum.covariance is None):
            return self._by_single_shooting(model, starts)
        if not model.system.linear and maximum.covariance is None:
            # a parameter vanished, without an uncertainty, and a better maximum may exist
            other = solve_by_continuation(self._stepped(model), starts, self._rules, [maximum.theta])
            if other is not None and model.profile(other.theta) < model.profile(maximum.theta) + TIED:
                return other
        return maximum

    def _by_programme(self, model: OutputError, starts: np.ndarray, exact: bool = False) -> Maximum | None:
        """Return the best maximum near the programme's solutions from these guesses; None where there is none."""
        stepped = self._stepped(model)
        batch, cases = SteppedOutputError.batch([stepped]), np.zeros(len(starts), int)
        residuals = model.data - batch.for_screening(cases, starts)[cases].point(starts).predicted
        solutions, noise, spent = [], [], 0
        for theta, residual in zip(starts, residuals, strict=True):
            if not np.all(np.isfinite(residual)):
                continue
            free, sigma = (model.noise(residual, float(model.size), floor=floor) for floor in (0.0, SIGMA_FLOOR))
            substeps = int(batch.needed(cases[:1], theta[None], free[None])[0])
            solution, iterations = shoot(stepped, theta, sigma, substeps, exact, self.max_iterations)
            spent += iterations
            if np.all(np.isfinite(solution)):
                solutions.append(solution)
                noise.append(sigma)
        if not solutions:
            return None
        guesses = replace(Guesses.of_one(solutions), sigma=np.stack(noise))
        maximum = best_maxima([model], batch, guesses, self._rules)[0]
        if maximum is None or not maximum.converged:
            return None
        return replace(maximum, iterations=spent + maximum.iterations)

    def _by_single_shooting(self, model: OutputError, starts: Sequence[np.ndarray]) -> Maximum:
        """Estimate where the programme has no solution: by single shooting, or by continuation for nonlinear systems.

        This occurs where the likelihood increases towards zero damping, and where friction stops the motion. Other
        quantities may still be identifiable.
        """
        if not model.system.linear:
            maximum = solve_by_continuation(self._stepped(model), starts, self._rules)
        else:
            rules = replace(self._rules, iterations=MOST_ITERATIONS_ALONE)
            maximum = best_maxima([model], OutputError.batch([model]), Guesses.of_one(starts), rules)[0]
            maximum = None if maximum is None else replace(maximum, message=NO_PROGRAMME)
        if maximum is None:
            raise NoEstimate(NO_SOLUTION)
        return maximum
