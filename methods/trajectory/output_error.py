"""Output error: maximum a posteriori by simulation, single shooting, from several starts or from one cold one.

The response is simulated from the initial state, and parameters, unknown initial states and offsets are moved until it
fits: ``sum ((y - h) / sigma)² + sum ((log p - log nominal) / sd)²``, by Levenberg-Marquardt in the log-parameters
(:mod:`methods.trajectory.fit`). It has the same objective, noise estimate and covariance as multiple shooting
(:mod:`methods.trajectory.shooting`) and the oracle; what it lacks is states between the samples.

The misfit has one minimum for each half cycle that the phase may slip over the record, and a search from more than
about half a cycle away ends in one of the others. So it starts where multiple shooting does: from the separate minima
of a scan of the data, screened by a few steps each (:mod:`methods.trajectory.screening`), and the best end is kept.
Where all parameters are identifiable without a prior and the noise hides one of them, it is held as there.

``cold=True`` shows what that costs to leave out: it has one start. That is the prior's nominal values or, without a
prior, under a known force the equation error's estimate (:mod:`methods.starts.equation_error`) whose response is
nearest to the data, else parameters of unit size in the natural units of the problem; the initial state is what fits
the data best there. Where a known mass was added in some records and there is no prior, the records of the lightest and
of the heaviest load are first fitted alone, each from that start: their two values of k over the whole mass tell the
mass. Its end is reported as it stands, as it would be by an engineer who trusted the optimiser.

The noise of each channel is not known: fit, ``sigma² = RSS / (N - p)``, fit again from there, until it settles; p is
the number of directions that the data decide, ``trace(H_data H^-1)``. The covariance is the inverse of the Gauss-Newton
Hessian. Linear systems of one layout are fitted together.
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
    Serves,
    Status,
    batches,
)
from methods.regression.equation import too_fast
from methods.starts.ambiguity import SearchingIdentifier
from methods.starts.candidates import candidates, head, screening
from methods.starts.equation_error import regression_starts
from methods.starts.scan import records_by_load, unloaded
from methods.trajectory.fit import HELD, Maximum, Rules, best_maxima, held
from methods.trajectory.screening import Guesses, Screening, screen, screened_alone

COLD_DAMPING = 1.0
"""First damping of the search from one start: far from the data a Gauss-Newton step goes anywhere."""
POOR = 0.5
"""A response that leaves more than this part of the mean square of the data is said to be poor."""
NO_START = "no start gave a finite response; give a prior nearer to the system"
BAD_START = "the response at the start values is not finite, or too fast; give a prior nearer to the system"
STOPPED = "it was stopped at max_evaluations"


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
    def _rules(self) -> Rules:
        screening = Screening(self.starts, self.screen_iterations, self.margin)
        damping = COLD_DAMPING if self.cold else FIRST_DAMPING
        return Rules(screening, self.sigma_rounds, self.sigma_tolerance, self.max_evaluations, damping)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate all parameters, or the groups where nothing tells the scale. Uses no randomness."""
        return self.estimate_many([problem], [rng])[0]

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Estimate linear systems of one layout together, all others one by one."""
        models = [OutputError(problem) for problem in problems]
        if self.cold:
            return self._from_cold(models)
        maxima: list[tuple[Maximum | None, np.ndarray]] = [(None, np.zeros(0))] * len(models)
        for places in batches(models, [not model.system.linear for model in models]):
            batch = [models[i] for i in places]
            ends = self._screened(batch) if batch[0].system.linear else [self._screened_alone(batch[0])]
            for i, end in zip(places, ends, strict=True):
                maxima[i] = end
        return [_answer(model, self._closed(*end), NO_START) for model, end in zip(models, maxima, strict=True)]

    def _screened(self, models: Sequence[OutputError]) -> list[tuple[Maximum | None, np.ndarray]]:
        """The best end of each problem's screened guesses, and its first guess, of linear systems of one layout."""
        batch = OutputError.batch(models)
        guesses = screen(models, batch, self._rules.screening)
        return list(zip(best_maxima(models, batch, guesses, self._rules), guesses.first, strict=True))

    def _screened_alone(self, model: OutputError) -> tuple[Maximum | None, np.ndarray]:
        """The same of a nonlinear system, whose motion is roughly integrated in comparing guesses."""
        thetas = screened_alone(model, self._rules.screening)
        nominal = candidates(head(model), self.starts + 1)[0]
        first = np.log([nominal[name] for name in model.free])
        quick = screening(model)
        rough = self._fitted([quick], [thetas])[0] if thetas else None
        if rough is None or quick is model:
            return rough, first
        fine = self._fitted([model], [[rough.theta]])[0]
        return None if fine is None else replace(fine, iterations=rough.iterations + fine.iterations), first

    def _closed(self, maximum: Maximum | None, first: np.ndarray) -> Maximum | None:
        """The maximum, held by a very wide prior where it leaves a parameter open."""
        if maximum is None or (wide := held(maximum, first)) is None:
            return maximum
        again = self._fitted([wide[0]], [[wide[1]]])[0]
        if again is None:
            return maximum
        return replace(again, iterations=maximum.iterations + again.iterations, message=HELD)

    def _fitted(self, models: Sequence[OutputError], thetas: Sequence[Sequence[np.ndarray]]) -> list[Maximum | None]:
        """The best end of the searches of each problem from its vectors."""
        maxima: list[Maximum | None] = [None] * len(models)
        for places in batches(models, [not model.system.linear for model in models]):
            batch = [models[i] for i in places]
            if not batch[0].system.linear:
                batch = [_Reachable(model.problem, model.gauge, model=model) for model in batch]
            cases = np.repeat(np.arange(len(places)), [len(thetas[i]) for i in places])
            vectors = np.stack([theta for i in places for theta in thetas[i]])
            guesses = Guesses(cases, vectors, vectors)
            ends = best_maxima([models[i] for i in places], type(batch[0]).batch(batch), guesses, self._rules)
            for i, end in zip(places, ends, strict=True):
                maxima[i] = end
        return maxima

    def _from_cold(self, models: Sequence[OutputError]) -> list[Estimate]:
        """Where the search from each problem's one start ends."""
        starts = self._cold_starts([model.problem for model in models])
        ends = self._fitted(models, [[_vector(model, p)] for model, (p, _) in zip(models, starts, strict=True)])
        return [
            _answer(model, None if end is None else replace(end, iterations=end.iterations + before), BAD_START)
            for model, end, (_, before) in zip(models, ends, starts, strict=True)
        ]

    def _cold_starts(self, problems: Sequence[Problem]) -> list[tuple[dict[str, float], int]]:
        """The cold start of each problem, and the iterations that it took: none but where two loads give the mass."""
        starts = [(cold_start(problem), 0) for problem in problems]
        loads = {i: records_by_load(p) for i, p in enumerate(problems) if p.prior is None}
        pairs = [(i, load, own[load]) for i, own in loads.items() if len(own) > 1 for load in (min(own), max(own))]
        models = [OutputError(part) for _, _, part in pairs]
        ends = self._fitted(models, [[_vector(model, cold_start(model.problem))] for model in models])
        for i in {i for i, _, _ in pairs}:
            parts = [(pair[1], end) for pair, end in zip(pairs, ends, strict=True) if pair[0] == i]
            alone = {
                load: {name: float(value) for name, value in end.model.parameters(end.theta).items()}
                for load, end in parts
                if end is not None
            }
            together = unloaded(problems[i], alone) if len(alone) == len(parts) else None
            starts[i] = (together or starts[i][0], sum(end.iterations for _, end in parts if end is not None))
        return starts


@dataclass(frozen=True, eq=False)
class _Reachable(OutputError):
    """A ``model`` of a nonlinear system, not finite where the motion is too fast for the samples.

    Its integration there would outlast every fit; the search takes a shorter step.
    """

    model: OutputError = field(kw_only=True)

    def jacobian(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Predictions (cases, N) and derivatives (cases, N, size); a neighbour that diverged gives no derivative."""
        predicted = np.full((len(theta), self.channel_of.size), np.nan)
        slopes = np.zeros((*predicted.shape, self.size))
        good = np.flatnonzero(~_out_of_reach(self.model, theta))
        if good.size:
            predicted[good], derivatives = self.model.jacobian(theta[good])
            slopes[good] = np.where(np.isfinite(derivatives), derivatives, 0.0)
        return predicted, slopes


def _out_of_reach(model: OutputError, theta: np.ndarray) -> np.ndarray:
    """Return which vectors (cases, size) move a nonlinear system faster than the samples show."""
    p, out = model.parameters(theta), np.zeros(len(theta), bool)
    for state, record in zip(model.states(theta), model.problem.records, strict=True):
        rig = record.rig(model.system)
        for times in {c.times.tobytes(): c.times for c in record.channels if c.n > 1}.values():
            for i, own in enumerate(state):
                out[i] |= bool(too_fast(rig, {name: v[i : i + 1] for name, v in p.items()}, own, times)[0])
    return out


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


def _answer(model: OutputError, maximum: Maximum | None, failure: str) -> Estimate:
    """Return the estimate at a maximum, with a message of what is wrong with it; a failure without one."""
    if maximum is None:
        return Estimate.failed(model.system, Status.DIVERGED, failure)
    left = float(np.sum((maximum.residuals / model.rms[model.channel_of]) ** 2)) / model.data.size
    said = [maximum.message]
    if left > POOR:
        said.append(f"the response leaves {left:.0%} of the data's mean square: a wrong minimum, or mostly noise")
    if not maximum.done:
        said.append(STOPPED)
    return replace(maximum, message="; ".join(part for part in said if part)).estimate()
