"""Direct multiple shooting: maximum a posteriori by a sparse nonlinear programme (CasADi, IPOPT).

The record is cut at every sample and at every knot of a known force. The states at the cuts are unknowns beside the
log-parameters, the initial states and the offsets of the sensors; that the motion joins at each cut is a constraint
(H. G. Bock, K.-J. Plitt, IFAC Proceedings 17(2):1603, 1984). So the trajectory can follow the data from the first
iteration on, while a single trajectory from a wrong frequency cannot. Between cuts: classical Runge-Kutta steps of
order four, as many as the frequency seen in the data and the noise seen in it call for. The Hessian is Gauss-Newton's.

Objective: ``sum ((y - h) / sigma)² + sum ((log p - log nominal) / sd)²``. The noise level is not known: fit, then
``sigma² = RSS / (N - p)`` for each channel, then fit again from there, until it settles; p is the number of
parameters that the data decide, ``trace(H_data H^-1)``.

Starts come from the data alone (:mod:`methods.starts.candidates`): the separate minima of a scan over frequency and
decay, a few output-error steps each (on the first samples, where a record of a nonlinear system is long); whatever
could still win is solved by shooting, and the best objective is kept.
Where all parameters are told without a prior (a known force, an added mass), the likelihood may have no maximum at
positive ones, as where the noise hides the damping: then all are solved again with a very wide prior about the first
start, which no output-error step has moved.
The same maximum can be had without cuts, where the search gets there: problems are solved many at a time by
:mod:`methods.trajectory.fit`, linear ones with their exact motion, others by the same steps; and by the programme
where a search there does not end at a maximum, or where the record of a nonlinear system is long. Where the programme
of a linear system has no solution either, as where the likelihood rises towards no damping, the answer is where a
search without cuts ends, and its message says so; that of a nonlinear system, as with dry friction, is found by
continuation (:mod:`methods.trajectory.continuation`).
The covariance is the inverse of the Hessian reduced to the space that satisfies the constraints, with Student's t at
``N - p`` degrees of freedom. The programme itself is :mod:`methods.trajectory.programme`.

Errors are taken to be normal; with ``likelihood="student"``, from the answer so found on, to be Student's t with four
degrees of freedom, so that outliers count for little (:mod:`methods.trajectory.student`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from bench import (
    EVERY_PROBLEM,
    Card,
    Estimate,
    InitialState,
    NoEstimate,
    OutputError,
    Prior,
    Problem,
    Serves,
    batches,
)
from methods.starts.ambiguity import SearchingIdentifier
from methods.starts.candidates import LONGEST, candidates, head, screening
from methods.starts.open_parameters import very_wide
from methods.trajectory.continuation import solve_by_continuation
from methods.trajectory.fineness import Fineness
from methods.trajectory.fit import HELD, Maximum, Rules, best_maxima, held, leaves_open
from methods.trajectory.programme import (
    Plan,
    ProgrammeLayout,
    Shape,
    build_programme,
    first_guess,
    given_to,
    misfit_scale,
    reduced,
)
from methods.trajectory.screening import Guesses, Screening, screen, screened_alone
from methods.trajectory.stepped import SteppedOutputError
from methods.trajectory.student import Likelihood, with_student_errors

MOST_ITERATIONS = 60
"""Trial steps of a search without cuts."""
MOST_ITERATIONS_ALONE = 200
"""The same where the programme has no solution, as output error's."""
NO_PROGRAMME = "the programme has no solution: this is where a search without cuts ends"
POLISH = 3
"""Gauss-Newton steps in the reduced space after IPOPT, at most: they make the answer free of its tolerance."""

AS_GOOD = 0.1
"""A maximum is as good as another where minus twice its log-posterior, the motion integrated exactly, is this close."""


@dataclass(frozen=True)
class Shooting(SearchingIdentifier):
    """CasADi multiple shooting with the Gauss-Newton Hessian; settings below, the method in the module's docstring.

    At most ``starts`` separate starts get ``screen_iterations`` output-error steps; each is then solved by shooting
    if minus twice its log-posterior is within ``margin`` of the best. The integration may err by ``integration_error``
    of the motion, or by ``noise_share`` of the standard error that the data allow, whichever is larger.
    Fit and noise alternate at most ``sigma_rounds`` times, until the noise changes by less than ``sigma_tolerance``.
    ``likelihood="student"`` takes the answer on to the maximum with Student t errors, which expect outliers.
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
        colour="#0072B2",
        marker="o",
        variants={
            "shooting_student": {
                "summary": "multiple shooting, then Student t errors in place of normal ones",
                "uncertainty": "expected information of the t errors in the log-parameters, Student t with N - p "
                "degrees of freedom",
                "tuning": "none beyond shooting's; 4 degrees of freedom of the errors are the literature's",
                "title": "Multiple shooting, t errors",
                "order": 15,
                "colour": "#6BAED6",
                "marker": "8",
            },
        },
    )
    serves: ClassVar[Serves] = EVERY_PROBLEM
    requires: ClassVar[tuple[str, ...]] = ("casadi",)
    extra: ClassVar[str] = "casadi"
    works_in = "natural units"

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Estimate all problems together, where that ends at the same maximum; the others by shooting, one by one."""
        maxima = self.maxima([OutputError(problem) for problem in problems])
        return [self._answer(problem, maximum) for problem, maximum in zip(problems, maxima, strict=True)]

    def maxima(self, models: Sequence[OutputError]) -> list[Maximum | None]:
        """Return the maxima that searches without cuts find, in order; None where shooting has to."""
        maxima: list[Maximum | None] = [None] * len(models)
        short = [m.system.linear or all(c.n <= LONGEST for _, c in m.channels) for m in models]
        for places in batches(models, [not own for own in short]):
            if not short[places[0]]:
                continue
            own = [models[i] for i in places]
            batch = self._joined(own)
            guesses = screen(own, batch, self._rules.screening)
            ends = best_maxima(own, batch, guesses, self._rules)
            for i, end, first in zip(places, ends, guesses.first, strict=True):
                maxima[i] = self._closed(end, first)
        return maxima

    def _joined(self, models: Sequence[OutputError]) -> OutputError:
        """The batch of problems of one layout, by the exact motion of a linear system, or by steps."""
        if models[0].system.linear:
            return OutputError.batch(models)
        stepped = [SteppedOutputError(m.problem, m.gauge, fineness=self._fineness) for m in models]
        return SteppedOutputError.batch(stepped)

    def _closed(self, maximum: Maximum | None, first: np.ndarray) -> Maximum | None:
        """The maximum, or that with a very wide prior where it leaves a parameter open; None: solve by shooting."""
        if maximum is None or not maximum.converged:
            return None
        if (wide := held(maximum, first)) is not None:
            guess = Guesses(np.zeros(1, int), wide[1][None], wide[1][None])
            again = best_maxima([wide[0]], self._joined([wide[0]]), guess, self._rules)[0]
            if again is None or not again.converged:
                return None
            maximum = replace(again, message=HELD)
        return None if maximum.covariance is None else maximum

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate all parameters, or the groups where nothing tells the scale, by shooting. Uses no randomness."""
        return self._answer(problem, None)

    def _answer(self, problem: Problem, found: Maximum | None) -> Estimate:
        """The answer of what was found together with others or else is found by shooting; a failure as a sentence."""
        try:
            found = self._shot(problem) if found is None else found
            if self.likelihood == "student":
                found = with_student_errors(found, self._joined([found.model]))
            return found.estimate()
        except NoEstimate as reason:
            return Estimate.failed(problem.system, reason.status, str(reason), reason.cost)

    def _shot(self, problem: Problem) -> Maximum:
        """The maximum with normal errors, by shooting."""
        model = OutputError(problem)
        used = screened_alone(model, self._rules.screening)
        if not used:
            raise NoEstimate("no start gave a finite response; give a prior nearer to the system")
        good, message = self._fits(model, used), ""
        if model.prior is None and model.problem.scale_told and not _leaves_nothing_open(model, good):
            # the likelihood rises towards a parameter of zero or without limit: the data say that it is small or large
            prior = very_wide(candidates(head(model), self.starts + 1)[0])
            model = OutputError(replace(model.problem, prior=prior))
            good, message = self._fits(model, [_within(prior, theta) for theta in used], exact=True), HELD
        if not good:
            return self._without_cuts(model, used)
        iterations = sum(fit.iterations for fit in good)
        best = min(good, key=lambda fit: fit.profile)
        objectives = tuple(0.5 * fit.profile for fit in good)
        covariance = model.covariance(best.slopes, best.sigma)
        if not model.system.linear and covariance is None:
            # a parameter ran down to zero, where it has no uncertainty; and a better maximum may be elsewhere
            other = solve_by_continuation(model, used, self._rules, self._fineness, [fit.theta for fit in good])
            if other is not None and model.profile(other.theta) < model.profile(best.theta) + AS_GOOD:
                return other
        return Maximum(
            model,
            best.theta,
            best.residuals,
            best.slopes,
            best.sigma,
            covariance,
            best.used,
            iterations,
            message,
            objectives,
        )

    def _without_cuts(self, model: OutputError, starts: Sequence[np.ndarray]) -> Maximum:
        """Search without cuts, where the programme has no solution; a nonlinear system by continuation.

        The programme has none where the likelihood rises towards a parameter of zero, as towards no damping, and where
        friction holds the motion. The other quantities are identifiable all the same.
        """
        if not model.system.linear:
            maximum = solve_by_continuation(model, starts, self._rules, self._fineness)
            if maximum is not None:
                return maximum
        end = None
        if model.system.linear:
            guesses = Guesses(np.zeros(len(starts), int), np.stack(starts), starts[0][None])
            rules = replace(self._rules, iterations=MOST_ITERATIONS_ALONE)
            end = best_maxima([model], OutputError.batch([model]), guesses, rules)[0]
        if end is None:
            raise NoEstimate("IPOPT found no solution from any start; raise max_iterations or give a prior")
        return replace(end, message=NO_PROGRAMME)

    def _fits(self, model: OutputError, starts: Sequence[np.ndarray], exact: bool = False) -> list[_Fit]:
        """The solutions from these starts."""
        return [fit for fit in (self._fit(model, theta, exact) for theta in starts) if fit is not None]

    def _fit(self, model: OutputError, theta: np.ndarray, exact: bool) -> _Fit | None:
        """Fit and noise in turn, from one start; None where IPOPT fails."""
        residuals = model.data - screening(model).predict(theta)
        if not np.all(np.isfinite(residuals)):
            return None
        used, fit, iterations, substeps = float(model.size), None, 0, 1
        sigma = model.noise(residuals, used)
        plans = tuple(Plan(model.system, record) for record in model.problem.records)
        for _ in range(self.sigma_rounds):
            substeps = max(self._substeps(model, theta, plans, model.noise(residuals, used, floor=0.0)), substeps)
            shape = Shape.of(model, plans, substeps, exact)
            last, fit = fit, _shoot(shape, model, plans, theta, sigma, self.max_iterations, fit)
            if fit is None:
                return last
            iterations += fit.iterations
            theta, residuals, used = fit.theta, fit.residuals, fit.used
            fit.sigma, fit.profile = model.noise(residuals, used, floor=0.0), model.profile_of(theta, residuals)
            fit.iterations = iterations
            before, sigma = sigma, model.noise(residuals, used)
            # the solution may be faster than the start was, or fit better: then the steps were too long
            enough = self._substeps(model, theta, plans, fit.sigma) <= substeps
            if enough and np.max(np.abs(np.log(sigma / before))) < self.sigma_tolerance:
                break
        return fit

    def _substeps(self, model: OutputError, theta: np.ndarray, plans: tuple[Plan, ...], sigma: np.ndarray) -> int:
        """Runge-Kutta steps in the longest interval."""
        longest = max(plan.longest for plan in plans)
        parts = [(s.displacement, s.velocity) if isinstance(s, InitialState) else s for s in model.starts(theta)]
        states = [np.concatenate(own)[None] for own in parts]
        return int(self._fineness.substeps(model, longest, theta[None], states, sigma[None], model.rms[None])[0])

    @property
    def _rules(self) -> Rules:
        screening = Screening(self.starts, self.screen_iterations, self.margin)
        return Rules(screening, self.sigma_rounds, self.sigma_tolerance, MOST_ITERATIONS)

    @property
    def _fineness(self) -> Fineness:
        return Fineness(self.integration_error, self.noise_share)


@dataclass
class _Fit:
    """One solved programme: ``theta`` as in OutputError, and what belongs to it."""

    theta: np.ndarray
    unknowns: np.ndarray
    residuals: np.ndarray
    slopes: np.ndarray
    used: float
    iterations: int
    substeps: int
    sigma: np.ndarray = field(default_factory=lambda: np.ones(1))
    """Noise by channel as the residuals have it, without a floor."""
    profile: float = np.inf


def _leaves_nothing_open(model: OutputError, fits: Sequence[_Fit]) -> bool:
    """Whether the best of the solutions leaves no parameter more open than the very wide prior would."""
    if not fits:
        return False
    best = min(fits, key=lambda fit: fit.profile)
    return not np.any(leaves_open(model, model.covariance(best.slopes, best.sigma)))


def _within(prior: Prior, theta: np.ndarray) -> np.ndarray:
    """A start that had run away, back within a standard deviation of the prior on its first entries."""
    k = prior.log_mean.size
    logs = np.clip(theta[:k], prior.log_mean - prior.log_sds, prior.log_mean + prior.log_sds)
    return np.concatenate([logs, theta[k:]])


def _shoot(
    shape: Shape,
    model: OutputError,
    plans: tuple[Plan, ...],
    theta: np.ndarray,
    sigma: np.ndarray,
    max_iterations: int,
    last: _Fit | None,
) -> _Fit | None:
    """Solve the programme at given noise, and linearise it at the solution."""
    programme, layout = build_programme(shape, max_iterations), ProgrammeLayout.of(model, plans)
    w = first_guess(model, plans, theta) if last is None else last.unknowns
    low, high = np.full(w.size, -np.inf), np.full(w.size, np.inf)
    low[layout.fixed] = high[layout.fixed] = w[layout.fixed]
    given = given_to(model, plans, sigma)
    solution = programme.solver(x0=w, p=given, lbx=low, ubx=high, lbg=0.0, ubg=0.0)
    iterations = int(programme.solver.stats()["iter_count"])
    w = np.asarray(solution["x"]).ravel()
    for _ in range(POLISH):
        if not np.all(np.isfinite(w)):
            return None
        try:
            misfit, by_free, move, gap = reduced(programme, layout, w, given)
            q, values, axes = np.linalg.svd(by_free, full_matrices=False)
        except (RuntimeError, np.linalg.LinAlgError):  # a singular system: IPOPT ran away
            return None
        downhill = q.T @ misfit
        # its length in standard errors: the gain in the objective that is left
        left = float(np.linalg.norm(downhill)) / misfit_scale(model, sigma)
        w = w - move @ (axes.T @ np.where(values > 1e-10 * values[0], downhill / np.maximum(values, 1e-300), 0.0))
        if left < 1e-4 and gap < 1e-9:
            break
    if not (left < 0.05 and gap < 1e-6):
        return None
    n, weights = model.data.size, misfit_scale(model, sigma) / sigma[model.channel_of]
    return _Fit(
        theta=w[layout.independent],
        unknowns=w,
        residuals=misfit[:n] / weights,
        slopes=by_free[:n] / weights[:, None],
        used=float(np.sum(q[:n] ** 2)),
        iterations=iterations,
        substeps=shape.substeps,
    )
