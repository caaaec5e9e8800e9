"""Output error: maximum a posteriori by simulation, single shooting, from several starts or from one cold one.

The response is simulated from the initial state, and parameters, unknown initial states and offsets are moved until it
fits: ``sum ((y - h) / sigma)² + sum ((log p - log nominal) / sd)²``, a trust-region Gauss-Newton method (SciPy's
``least_squares``; J. J. Moré, Lecture Notes in Mathematics 630:105, 1978, for the trust region) in the log-parameters.
It has the same objective, noise estimate and covariance as multiple shooting (:mod:`methods.trajectory.shooting`) and
the oracle; what it lacks is states between the samples.

The misfit has one minimum for each half cycle that the phase may slip over the record, and a search from more than
about half a cycle away ends in one of the others. So it starts where multiple shooting does: from the separate minima
of a scan of the data, screened by a few steps each (:mod:`methods.trajectory.screened`), and the best end is kept.
Where all parameters are told without a prior and the noise hides one of them, it is held as there
(:mod:`methods.trajectory.held`).

``cold=True`` shows what that costs to leave out: it has one start. That is the prior's nominal values or, without a
prior, under a known force the equation error's estimate (:mod:`methods.starts.equation_error`) whose response is
nearest to the data, else parameters of unit size in the natural units of the problem; the initial state is what fits
the data best there. Where a known mass was added in some records and there is no prior, the records of the lightest and
of the heaviest load are first fitted alone, each from that start: their two values of k over the whole mass tell the
mass. Its end is reported as it stands, as it would be by an engineer who trusted the optimiser.

The noise of each channel is not known: fit, ``sigma² = RSS / (N - p)``, fit again from there, until it settles; p is
the number of directions that the data decide, ``trace(H_data H^-1)``. The covariance is the inverse of the Gauss-Newton
Hessian. The searches are :mod:`methods.trajectory.single`; linear systems of one layout are fitted together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bench import (
    EVERY_PROBLEM,
    Card,
    Cost,
    Estimate,
    InputError,
    OutputError,
    Problem,
    Serves,
    Status,
    estimate_at,
)
from methods.starts.ambiguity import SearchingIdentifier
from methods.starts.candidates import screening
from methods.starts.equation_error import regression_starts
from methods.starts.scan import records_by_load, unloaded
from methods.trajectory.ends import ends
from methods.trajectory.held import HELD, held, opened
from methods.trajectory.screened import Screening, screened_starts
from methods.trajectory.single import Found, Searches

POOR = 0.5
"""A response that leaves more than this part of the mean square of the data is said to be poor."""
NO_START = "no start gave a finite response; give a prior nearer to the system"


@dataclass(frozen=True)
class SingleShooting(SearchingIdentifier):
    """Output error from at most ``starts`` screened starts, or from one ``cold`` one.

    ``screen_iterations`` and ``margin`` as in multiple shooting. Fit and noise in turn, at most ``sigma_rounds`` times,
    until the noise changes by less than ``sigma_tolerance``; each fit takes at most ``max_evaluations`` trial steps.
    """

    cold: bool = False
    starts: int = 3
    screen_iterations: int = 5
    margin: float = 15.0
    sigma_rounds: int = 6
    sigma_tolerance: float = 1e-3
    max_evaluations: int = 200

    card: ClassVar[Card] = Card(
        summary="output error (single shooting) from screened starts, maximum a posteriori with the noise estimated",
        start="used when known",
        scale="native",
        reconstruction="own",
        uncertainty="inverse Gauss-Newton Hessian in the log-parameters, Student t with N - p degrees of freedom",
        settings_source="starts of multiple shooting, rounds of the oracle, tolerance below the noise level's error",
        tuning="none",
        title="Output error",
        order=90,
        colour="#4D3559",
        marker="p",
        variants={
            "output_error_cold": {
                "summary": "output error (single shooting) from one cold start",
                "title": "Output error, one cold start",
                "order": 95,
                "colour": "#9A86A4",
                "marker": (6, 2, 0.0),
            },
        },
    )
    serves: ClassVar[Serves] = EVERY_PROBLEM
    works_in = "natural units"

    def __post_init__(self) -> None:
        for name in ("starts", "screen_iterations", "sigma_rounds", "max_evaluations"):
            if getattr(self, name) < 1:
                raise InputError(f"method.{name}", getattr(self, name), "at least 1")

    @property
    def _searches(self) -> Searches:
        return Searches(self.sigma_rounds, self.sigma_tolerance, self.max_evaluations)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate all parameters, or the groups where nothing tells the scale. Uses no randomness."""
        return self.estimate_many([problem], [rng])[0]

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Estimate linear systems of one layout together, all others one by one."""
        models = [OutputError(problem) for problem in problems]
        return self._from_cold(models) if self.cold else self._from_screened(models)

    def _from_screened(self, models: Sequence[OutputError]) -> list[Estimate]:
        """The best end of each problem's screened starts, a nonlinear motion roughly integrated in comparing them."""
        rules = Screening(self.starts, self.screen_iterations, self.margin)
        starts, quick = screened_starts(models, rules), [screening(model) for model in models]
        cases = [i for i, own in enumerate(starts) for _ in own.thetas]
        ends = self._searches.ends([quick[i] for i in cases], [theta for own in starts for theta in own.thetas])
        return [
            self._best(model, own.first, [end for i, end in zip(cases, ends, strict=True) if i == number])
            for number, (model, own) in enumerate(zip(models, starts, strict=True))
        ]

    def _best(self, model: OutputError, first: np.ndarray, ends: Sequence[Found | str]) -> Estimate:
        """The answer that the best of a problem's ends is, held where it leaves a parameter open."""
        good = [end for end in ends if isinstance(end, Found)]
        if not good:
            return Estimate.failed(model.system, Status.DIVERGED, str(ends[0]) if ends else NO_START)
        best = min(good, key=lambda end: model.profile_of(end.theta, end.residuals))
        if screening(model) is not model:
            last = self._searches.ends([model], [best.theta])[0]
            if isinstance(last, str):
                return Estimate.failed(model.system, Status.DIVERGED, last, _spent(good))
            best, good = last, [*good, last]
        spent = _spent(good)
        which = opened(model, _covariance(model, best))
        if np.any(which):
            wide, theta = held(model, best.theta, first, which)
            again = self._searches.ends([wide], [theta])[0]
            if isinstance(again, Found):
                return _answer(wide, again, _spent([*good, again]), HELD)
        objectives = [0.5 * model.profile_of(end.theta, end.residuals) for end in good]
        return _answer(model, best, spent, objectives=objectives)

    def _from_cold(self, models: Sequence[OutputError]) -> list[Estimate]:
        """Where the search from each problem's one start ends."""
        starts = self._cold_starts([model.problem for model in models])
        thetas = [_vector(model, p) for model, (p, _) in zip(models, starts, strict=True)]
        ends = self._searches.ends(models, thetas)
        return [
            Estimate.failed(model.system, Status.DIVERGED, end)
            if isinstance(end, str)
            else _answer(model, end, _spent([*before, end]))
            for model, end, (_, before) in zip(models, ends, starts, strict=True)
        ]

    def _cold_starts(self, problems: Sequence[Problem]) -> list[tuple[dict[str, float], list[Found]]]:
        """The cold start of each problem, and the searches that it took: none but where two loads tell the mass."""
        starts: list[tuple[dict[str, float], list[Found]]] = [(cold_start(problem), []) for problem in problems]
        loads = {i: records_by_load(p) for i, p in enumerate(problems) if p.prior is None}
        pairs = [(i, load, own[load]) for i, own in loads.items() if len(own) > 1 for load in (min(own), max(own))]
        models = [OutputError(part) for _, _, part in pairs]
        vectors = [_vector(model, cold_start(model.problem)) for model in models]
        ends = self._searches.ends(models, vectors)
        for i in {i for i, _, _ in pairs}:
            mine = [j for j, pair in enumerate(pairs) if pair[0] == i]
            good = {pairs[j][1]: (models[j], end) for j in mine if isinstance(end := ends[j], Found)}
            alone = {
                load: {name: float(value) for name, value in model.parameters(end.theta).items()}
                for load, (model, end) in good.items()
            }
            found = unloaded(problems[i], alone) if len(alone) == len(mine) else None
            starts[i] = (found or starts[i][0], [end for _, end in good.values()])
        return starts


def cold_start(problem: Problem) -> dict[str, float]:
    """The one start of a cold fit, in the units of the (scaled) problem; see the module's docstring."""
    if problem.prior is not None:
        return dict(problem.prior.nominal)
    found = regression_starts(problem) if problem.forced else []
    good = [p for p in found if all(np.isfinite(value) and value > 0 for value in p.values())]
    if not good:
        return dict.fromkeys(problem.system.names, 1.0)
    quick = screening(OutputError(problem))
    return min(good, key=lambda p: quick.profile(_vector(quick, p)))


def _vector(model: OutputError, start: dict[str, float]) -> np.ndarray:
    """Theta at a start; not a number where its matrices are singular."""
    try:
        return model.vector(start)
    except np.linalg.LinAlgError:
        return np.full(model.size, np.nan)


def _spent(searches: Sequence[Found]) -> Cost:
    """What searches took together."""
    return Cost(sum(end.evaluations for end in searches), sum(end.iterations for end in searches))


def _covariance(model: OutputError, found: Found) -> np.ndarray | None:
    return model.covariance(found.slopes, model.noise(found.residuals, found.used, floor=0.0))


def _answer(model: OutputError, found: Found, cost: Cost, said: str = "", objectives: Sequence[float] = ()) -> Estimate:
    """The estimate that a fit gives, with a message of what is wrong with it after what is ``said`` already.

    ``objectives``: minus the log posterior where the search from each start ended; its own where there was one start.
    """
    covariance = _covariance(model, found)
    left = float(np.sum((found.residuals / model.rms[model.channel_of]) ** 2)) / model.data.size
    message = "; ".join(part for part in (said, _message(left, covariance is None, found.stopped)) if part)
    estimate = estimate_at(model, found.theta, covariance, found.used, cost, message)
    own = objectives or [0.5 * model.profile_of(found.theta, found.residuals)]
    sigma = model.noise(found.residuals, found.used)
    return replace(estimate, traces=ends(model, found.theta, found.slopes, sigma, own))


def _message(left: float, open_direction: bool, stopped: bool) -> str:
    said = []
    if left > POOR:
        said.append(f"the response leaves {left:.0%} of the data's mean square: a wrong minimum, or mostly noise")
    if open_direction:
        said.append("the data leave a parameter open here, so there is no uncertainty")
    if stopped:
        said.append("it was stopped at max_evaluations")
    return "; ".join(said)
