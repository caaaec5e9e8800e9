"""Output error (single shooting): maximum a posteriori estimation by simulation, from several or one initial guess.

The response is simulated from the initial state; parameters, unknown initial states and offsets are fitted. Objective,
noise estimate and covariance are those of multiple shooting (:mod:`methods.trajectory.shooting`). The misfit has one
minimum for each half cycle that the phase may slip over the record, and a search from more than about half a cycle away
ends in a wrong one. The searches therefore start from the local minima of a scan (:mod:`methods.trajectory.screening`),
and the best end is kept.

``cold=True`` uses one initial guess, to show the effect of the scan: the prior's nominal values; without a prior, under
a known force the equation-error estimate (:mod:`methods.starts.equation_error`) with the best response; otherwise
parameters of unit size in natural units. The initial state is the best-fitting one there. Where a known mass was added
in some records and there is no prior, the records with the lightest and with the heaviest load are first fitted
separately from this guess, and their values of k over the total mass determine the mass. The end of the search is
returned without checks of its basin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from bench import (
    EVERY_PROBLEM,
    FIRST_DAMPING,
    Card,
    Estimate,
    InputError,
    OutputError,
    Problem,
    Scope,
    Status,
    batches,
)
from methods.regression.equation import too_fast
from methods.starts.ambiguity import SearchingIdentifier
from methods.starts.candidates import screening
from methods.starts.equation_error import regression_starts
from methods.starts.scan import records_by_load, unloaded
from methods.trajectory.fit import Maximum, best_maxima, with_wide_prior
from methods.trajectory.screening import Guesses, Rules, screen, screen_alone

COLD_DAMPING = 1.0
"""Initial damping of the search from one guess, since far from a minimum Gauss-Newton steps are unreliable."""
POOR = 0.5
"""A fit is poor if its residuals exceed this fraction of the data's mean square."""
NO_START = "no initial guess gave a finite response; give a prior closer to the system"
BAD_START = "the response at the initial guess is not finite, or too fast; give a prior closer to the system"
STOPPED = "the search was stopped at max_evaluations"


@dataclass(frozen=True)
class SingleShooting(SearchingIdentifier):
    """Output error from at most ``starts`` screened initial guesses, or from a ``cold`` one.

    ``screen_iterations`` and ``margin`` as in multiple shooting. Fit and noise alternate at most ``sigma_rounds``
    times, until the noise changes by less than ``sigma_tolerance``; each fit takes at most ``max_evaluations`` steps.
    """

    cold: bool = False
    starts: int = 3
    screen_iterations: int = 5
    margin: float = 15.0
    sigma_rounds: int = 6
    sigma_tolerance: float = 1e-3
    max_evaluations: int = 200

    card: ClassVar[Card] = Card(
        summary="output error (single shooting) from screened guesses, maximum a posteriori with the noise estimated",
        start="used when known",
        scale="native",
        reconstruction="own",
        uncertainty="inverse Gauss-Newton Hessian in the log-parameters, Student t with N - p degrees of freedom",
        settings_source="guesses of multiple shooting, rounds of the oracle, tolerance below the noise level's error",
        tuning="none",
        title="Output error",
        order=90,
        variants={
            "output_error_cold": {
                "summary": "output error (single shooting) from one initial guess without a scan",
                "title": "Output error, one cold start",
                "order": 95,
            },
        },
    )
    scope: ClassVar[Scope] = EVERY_PROBLEM
    works_in = "natural units"

    def __post_init__(self) -> None:
        for name in ("starts", "screen_iterations", "sigma_rounds", "max_evaluations"):
            if getattr(self, name) < 1:
                raise InputError(f"method.{name}", getattr(self, name), "at least 1")

    @property
    def _rules(self) -> Rules:
        return Rules(
            self.starts,
            self.screen_iterations,
            self.margin,
            self.sigma_rounds,
            self.sigma_tolerance,
            self.max_evaluations,
            COLD_DAMPING if self.cold else FIRST_DAMPING,
        )

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate all parameters, or the groups where the scale is not identifiable. Uses no randomness."""
        return self.estimate_many([problem], [rng])[0]

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Estimate linear systems of one layout in batches, all others one by one."""
        models = [OutputError(problem) for problem in problems]
        if self.cold:
            starts = self._cold_starts(problems)
            ends = self._from([(model, _vector(model, p)) for model, (p, _) in zip(models, starts, strict=True)])
            spent = [iterations for _, iterations in starts]
            maxima = [end and replace(end, iterations=end.iterations + n) for end, n in zip(ends, spent, strict=True)]
            return [_answer(model, end, BAD_START) for model, end in zip(models, maxima, strict=True)]
        answers = dict[int, Estimate]()
        for places in batches(models, [not model.system.linear for model in models]):
            group = [models[i] for i in places]
            for i, end in zip(places, self._screened(group), strict=True):
                answers[i] = _answer(models[i], end, NO_START)
        return [answers[i] for i in range(len(models))]

    def _screened(self, models: Sequence[OutputError]) -> list[Maximum | None]:
        """Return the best end from the screened guesses of linear systems of one layout, or of one other problem.

        A nonlinear system is first fitted with a less accurate integration.
        """
        if models[0].system.linear:
            batch = OutputError.batch(models)
            guesses = screen(models, batch, self._rules)
            ends = best_maxima(models, batch, guesses, self._rules)
        else:
            guesses, quick = screen_alone(models[0], self._rules), screening(models[0])
            ends = best_maxima([quick], _joined([quick]), guesses, self._rules)
            if ends[0] is not None and quick is not models[0]:
                fine = self._from([(models[0], ends[0].theta)])[0]
                ends = [fine and replace(fine, iterations=ends[0].iterations + fine.iterations)]
        return [
            end and (with_wide_prior(end, first, _joined, self._rules) or end)
            for end, first in zip(ends, guesses.first, strict=True)
        ]

    def _from(self, starts: Sequence[tuple[OutputError, np.ndarray]]) -> list[Maximum | None]:
        """Search each problem from its vector; return the ends."""
        maxima: list[Maximum | None] = [None] * len(starts)
        models = [model for model, _ in starts]
        for places in batches(models, [not model.system.linear for model in models]):
            group, thetas = [models[i] for i in places], np.stack([starts[i][1] for i in places])
            guesses = Guesses(np.arange(len(places)), thetas, thetas)
            for i, end in zip(places, best_maxima(group, _joined(group), guesses, self._rules), strict=True):
                maxima[i] = end
        return maxima

    def _cold_starts(self, problems: Sequence[Problem]) -> list[tuple[dict[str, float], int]]:
        """Return the initial guess of each problem, and the iterations of the separate fits to two loads."""
        starts = [(cold_start(problem), 0) for problem in problems]
        for i, problem in enumerate(problems):
            by_load = records_by_load(problem) if problem.prior is None else {}
            if len(by_load) < 2:
                continue
            loads = (min(by_load), max(by_load))
            models = [OutputError(by_load[load]) for load in loads]
            ends = self._from([(model, _vector(model, cold_start(model.problem))) for model in models])
            alone = {
                load: {name: float(value) for name, value in end.model.parameters(end.theta).items()}
                for load, end in zip(loads, ends, strict=True)
                if end is not None
            }
            combined = unloaded(problem, alone) if len(alone) == 2 else None
            starts[i] = (combined or starts[i][0], sum(end.iterations for end in ends if end is not None))
        return starts


def _joined(models: Sequence[OutputError]) -> OutputError:
    """Return the batch of problems of one layout; that of a nonlinear system excludes motions that are too fast."""
    if models[0].system.linear:
        return OutputError.batch(models)
    return LimitedOutputError.batch([LimitedOutputError(m.problem, m.gauge, model=m) for m in models])


@dataclass(frozen=True, eq=False)
class LimitedOutputError(OutputError):
    """A ``model`` of a nonlinear system whose predictions are NaN where the motion is too fast for the samples.

    The integration there would be too slow; the search takes a shorter step instead.
    """

    model: OutputError = field(kw_only=True)

    def jacobian(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return predictions (cases, N) and slopes (cases, N, size); slopes that are not finite are set to zero."""
        predicted = np.full((len(theta), self.channel_of.size), np.nan)
        slopes = np.zeros((*predicted.shape, self.size))
        good = np.flatnonzero(~_are_too_fast(self.model, theta))
        if good.size:
            predicted[good], derivatives = self.model.jacobian(theta[good])
            slopes[good] = np.where(np.isfinite(derivatives), derivatives, 0.0)
        return predicted, slopes


def _are_too_fast(model: OutputError, theta: np.ndarray) -> np.ndarray:
    """Return which vectors (cases, size) cause motions faster than the samples resolve."""
    p, out = model.parameters(theta), np.zeros(len(theta), bool)
    for state, record in zip(model.states(theta), model.problem.records, strict=True):
        rig = record.rig(model.system)
        for times in {c.times.tobytes(): c.times for c in record.channels if c.n > 1}.values():
            for i, initial in enumerate(state):
                out[i] |= bool(too_fast(rig, {name: v[i : i + 1] for name, v in p.items()}, initial, times)[0])
    return out


def cold_start(problem: Problem) -> dict[str, float]:
    """Return the initial guess of a cold fit, in the units of the (scaled) problem; see the module."""
    if problem.prior is not None:
        return dict(problem.prior.nominal)
    regression = regression_starts(problem) if problem.forced else []
    positive = [p for p in regression if all(np.isfinite(value) and value > 0 for value in p.values())]
    if not positive:
        return dict.fromkeys(problem.system.names, 1.0)
    quick = screening(OutputError(problem))
    return min(positive, key=lambda p: quick.profile(_vector(quick, p)))


def _vector(model: OutputError, start: dict[str, float]) -> np.ndarray:
    """Return the vector of unknowns for parameters; NaN where their matrices are singular."""
    try:
        return model.vector(start)
    except np.linalg.LinAlgError:
        return np.full(model.size, np.nan)


def _answer(model: OutputError, maximum: Maximum | None, failure: str) -> Estimate:
    """Return the estimate at a maximum, with messages; a failure without a maximum."""
    if maximum is None:
        return Estimate.failed(model.system, Status.DIVERGED, failure)
    share = float(np.sum((maximum.residuals / model.rms[model.channel_of]) ** 2)) / model.data.size
    poor = f"residuals are {share:.0%} of the data's mean square: a wrong minimum, or mostly noise"
    sentences = [maximum.message, poor if share > POOR else "", "" if maximum.done else STOPPED]
    return replace(maximum, message="; ".join(filter(None, sentences))).estimate()
