"""Output error from one cold start: maximum a posteriori by simulation, single shooting.

The response is simulated from the initial state, and parameters, unknown initial states and offsets are moved until it
fits: ``sum ((y - h) / sigma)² + sum ((log p - log nominal) / sd)²``, a trust-region Gauss-Newton method (SciPy's
``least_squares``; J. J. Moré, Lecture Notes in Mathematics 630:105, 1978, for the trust region) in the log-parameters.
It has the same objective, noise estimate and covariance as multiple shooting (:mod:`methods.trajectory.shooting`) and
the oracle.

What it lacks is on purpose, so that their gain shows: no scan for a start, no second start, no states between the
samples. It starts at the prior's nominal values or, without a prior, at parameters of unit size in the natural units
of the problem; the initial state at what fits the data best there. Where a known mass was added in some records and
there is no prior, the records of the lightest and of the heaviest load are first fitted alone, each from that start:
their two values of k over the whole mass tell the mass. The misfit has one minimum for each half cycle that
the phase may slip over the record, and a start from more than about half a cycle away ends in one of the others. Such
an end is reported as it stands, as it would be by an engineer who trusted the optimiser.

The noise of each channel is not known: fit, ``sigma² = RSS / (N - p)``, fit again from there, until it settles; p is
the number of directions that the data decide, ``trace(H_data H^-1)``. The covariance is the inverse of the Gauss-Newton
Hessian.

Linear systems of one layout are fitted together, by the same steps with exact derivatives
(:mod:`methods.trajectory.trust_region`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.optimize import least_squares

from bench import (
    EVERY_PROBLEM,
    SIGMA_FLOOR,
    Batch,
    Card,
    Cost,
    Estimate,
    Identifier,
    InitialState,
    InputError,
    OutputError,
    Problem,
    Serves,
    Standardised,
    Status,
    estimate_at,
    layout,
    used_of,
)
from methods.regression.equation import too_fast
from methods.starts.scan import records_by_load, unloaded
from methods.trajectory.trust_region import TrustRegion, within_reach

POOR = 0.5
"""A response that leaves more than this part of the mean square of the data is said to be poor."""
MOST_AT_ONCE = 1_000_000
"""Derivatives of predictions that are held together."""
TOGETHER = 0.3
"""The part of the searches that must have ended before the next ones begin: a few at a time would cost as much."""
BAD_START = "the response at the start values is not finite, or too fast; give a prior nearer to the system"
NO_RESPONSE = "the search ran to parameters without a response; give a prior nearer to the system"


@dataclass(frozen=True)
class SingleShooting(Identifier):
    """Fit and noise in turn, at most ``sigma_rounds`` times, until the noise changes by less than ``sigma_tolerance``.

    Each fit takes at most ``max_evaluations`` trial steps.
    """

    sigma_rounds: int = 6
    sigma_tolerance: float = 1e-3
    max_evaluations: int = 200

    card: ClassVar[Card] = Card(
        summary="output error (single shooting) from one cold start, maximum a posteriori with the noise estimated",
        start="used when known",
        scale="native",
        reconstruction="own",
        uncertainty="inverse Gauss-Newton Hessian in the log-parameters, Student t with N - p degrees of freedom",
        settings_source="rounds of the oracle, tolerance below the noise level's own error; SciPy's defaults else",
        tuning="none",
        title="Output error, one cold start",
        order=90,
        colour="#4D3559",
        marker="p",
    )
    serves: ClassVar[Serves] = EVERY_PROBLEM
    works_in = "natural units"

    def __post_init__(self) -> None:
        for name in ("sigma_rounds", "max_evaluations"):
            if getattr(self, name) < 1:
                raise InputError(f"method.{name}", getattr(self, name), "at least 1")

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate all parameters, or the groups where nothing tells the scale. Uses no randomness."""
        return self.estimate_many([problem], [rng])[0]

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Estimate linear systems of one layout together, all others one by one."""
        models, starts = [OutputError(problem) for problem in problems], self._starts(problems)
        ends = self._ends(models, [p for p, _ in starts])
        return [_answer(model, end, spent) for model, end, (_, spent) in zip(models, ends, starts, strict=True)]

    def _starts(self, problems: Sequence[Problem]) -> list[tuple[dict[str, float], Cost]]:
        """The cold start of each problem, and what it cost: nothing but where two loads tell the mass."""
        starts = [(cold_start(problem), Cost(0, 0)) for problem in problems]
        loads = {i: records_by_load(p) for i, p in enumerate(problems) if p.prior is None}
        pairs = [(i, load, own[load]) for i, own in loads.items() if len(own) > 1 for load in (min(own), max(own))]
        models = [OutputError(part) for _, _, part in pairs]
        ends = self._ends(models, [cold_start(part) for _, _, part in pairs])
        for i in {i for i, _, _ in pairs}:
            mine = [j for j, pair in enumerate(pairs) if pair[0] == i]
            good = {pairs[j][1]: (models[j], end) for j in mine if isinstance(end := ends[j], _Found)}
            spent = [end for _, end in good.values()]
            cost = Cost(sum(end.evaluations for end in spent), sum(end.iterations for end in spent))
            alone = {
                load: {name: float(value) for name, value in model.parameters(end.theta).items()}
                for load, (model, end) in good.items()
            }
            found = unloaded(problems[i], alone) if len(alone) == len(mine) else None
            starts[i] = (found or starts[i][0], cost)
        return starts

    def _ends(self, models: Sequence[OutputError], starts: Sequence[dict[str, float]]) -> list[_Found | str]:
        """Where the fits from these starts end, or a sentence where they cannot."""
        groups: dict[object, list[int]] = {}
        for i, model in enumerate(models):
            groups.setdefault(layout(model.problem) if model.system.linear else i, []).append(i)
        thetas = [_vector(model, start) for model, start in zip(models, starts, strict=True)]
        found: dict[int, _Found | str] = {}
        for places in groups.values():
            first = models[places[0]]
            size = max(1, MOST_AT_ONCE // (first.data.size * first.size)) if first.system.linear else 1
            for at in range(0, len(places), size):
                own = places[at : at + size]
                found |= zip(own, self._fitted([models[i] for i in own], [thetas[i] for i in own]), strict=True)
        return [found[i] for i in range(len(models))]

    def _fitted(self, models: Sequence[OutputError], thetas: Sequence[np.ndarray]) -> Sequence[_Found | str]:
        """Those of linear systems of one layout, or of a single problem."""
        model = models[0]
        if model.system.linear:
            return self._settled_together(Batch(tuple(models)), np.stack(thetas))
        if not np.all(np.isfinite(model.predict(thetas[0]))) or _out_of_reach(model, thetas[0]):
            return [BAD_START]
        try:
            return [self._settled(model, thetas[0])]
        except np.linalg.LinAlgError:
            return [NO_RESPONSE]

    def _settled_together(self, batch: Batch, thetas: np.ndarray) -> list[_Found | str]:
        """Fit and noise in turn, of linear systems of one layout: each goes on to its next fit by itself."""
        every, samples = np.arange(len(thetas)), batch.first.data.size
        search = TrustRegion(batch, within_reach(batch, every, thetas), self.max_evaluations)
        used, rounds = np.full(every.size, float(batch.first.size)), np.ones(every.size, int)
        residuals = batch.data - search.predicted
        started = np.all(np.isfinite(residuals), axis=1)
        going = every[started]
        if going.size:
            search.begin(going, batch.noise(going, residuals[going], used[going], SIGMA_FLOOR))
        while (going := going[~search.lost[going]]).size:
            search.step()
            ended = going[search.done[going] & ~search.lost[going]]
            if ended.size <= TOGETHER * going.size:
                continue
            used[ended] = used_of(search.jacobian(ended), samples)
            before = search.sigma[ended]
            sigma = batch.noise(ended, batch.data[ended] - search.predicted[ended], used[ended], SIGMA_FLOOR)
            moved = np.max(np.abs(np.log(sigma / before)), axis=1) >= self.sigma_tolerance
            again = moved & (rounds[ended] < self.sigma_rounds)
            going = np.setdiff1d(going, ended[~again])
            rounds[ended[again]] += 1
            search.begin(ended[again], sigma[again])
        residuals = batch.data - search.predicted
        ends: list[_Found | str] = [
            _Found(
                theta=search.theta[i],
                residuals=residuals[i],
                slopes=search.slopes[i],
                used=float(used[i]),
                stopped=bool(search.stopped[i]),
                evaluations=int(search.evaluations[i]),
                iterations=int(search.iterations[i]),
            )
            for i in every
        ]
        return [BAD_START if not started[i] else NO_RESPONSE if search.lost[i] else end for i, end in enumerate(ends)]

    def _settled(self, model: OutputError, theta: np.ndarray) -> _Found:
        """Fit and noise in turn, from ``theta``."""
        residuals, used = model.data - model.predict(theta), float(model.size)
        evaluations, iterations, stopped = 1, 0, False
        sigma = model.noise(residuals, used)
        for _ in range(self.sigma_rounds):
            aim = _Reachable(model, sigma)
            fit = least_squares(aim.residuals, theta, aim.jacobian, x_scale="jac", max_nfev=self.max_evaluations)
            theta, residuals, used = fit.x, model.data - model.predict(fit.x), _used(fit.jac, model.data.size)
            evaluations += aim.evaluations + 1
            iterations += fit.njev
            stopped = fit.status == 0
            before, sigma = sigma, model.noise(residuals, used)
            if np.max(np.abs(np.log(sigma / before))) < self.sigma_tolerance:
                break
        return _Found(theta, residuals, model.jacobian(theta)[1], used, stopped, evaluations, iterations)


@dataclass(frozen=True)
class _Found:
    """Where a fit ended, the degrees of freedom that it ``used``, and what it took."""

    theta: np.ndarray
    residuals: np.ndarray
    slopes: np.ndarray
    used: float
    stopped: bool
    evaluations: int
    iterations: int


def _answer(model: OutputError, found: _Found | str, spent: Cost) -> Estimate:
    """The estimate that a fit gives; of a sentence, a failure that says it."""
    if isinstance(found, str):
        return Estimate.failed(model.system, Status.DIVERGED, found)
    covariance = model.covariance(found.slopes, model.noise(found.residuals, found.used, floor=0.0))
    left = float(np.sum((found.residuals / model.rms[model.channel_of]) ** 2)) / model.data.size
    message = _message(left, covariance is None, found.stopped)
    cost = Cost(spent.evaluations + found.evaluations, spent.iterations + found.iterations)
    return estimate_at(model, found.theta, covariance, found.used, cost, message)


def _vector(model: OutputError, start: dict[str, float]) -> np.ndarray:
    """Theta at a start; not a number where its matrices are singular."""
    try:
        return model.vector(start)
    except np.linalg.LinAlgError:
        return np.full(model.size, np.nan)


def cold_start(problem: Problem) -> dict[str, float]:
    """The nominal values of the prior, or 1 for every parameter, in the units of the (scaled) problem."""
    return dict(problem.prior.nominal) if problem.prior else dict.fromkeys(problem.system.names, 1.0)


class _Reachable(Standardised):
    """Standardised residuals, not finite where the motion is too fast for the samples: the step is shortened."""

    def residuals(self, theta: np.ndarray) -> np.ndarray:
        if _out_of_reach(self.model, theta):
            return np.full(self.model.data.size + self.model.penalty(theta).size, np.nan)
        return super().residuals(theta)


def _out_of_reach(model: OutputError, theta: np.ndarray) -> bool:
    """Whether a nonlinear system moves faster than the samples show: its integration would outlast every fit."""
    if model.system.linear:
        return False
    p = {name: value[None] for name, value in model.parameters(theta).items()}
    return any(
        bool(too_fast(record.rig(model.system), p, np.concatenate([s.displacement, s.velocity]), c.times)[0])
        for s, record in zip(_states(model, theta), model.problem.records, strict=True)
        for c in record.channels
        if c.n > 1
    )


def _states(model: OutputError, theta: np.ndarray) -> list[InitialState]:
    return [s if isinstance(s, InitialState) else InitialState(s[0], s[1]) for s in model.starts(theta)]


def _used(slopes: np.ndarray, samples: int) -> float:
    """Degrees of freedom that the data spent: ``trace(H_data H^-1)``, in an orthogonal basis of the slopes."""
    basis, values, _ = np.linalg.svd(slopes, full_matrices=False)
    return float(np.sum(basis[:samples, values > 1e-12 * values[0]] ** 2))


def _message(left: float, open_direction: bool, stopped: bool) -> str:
    said = []
    if left > POOR:
        said.append(f"the response leaves {left:.0%} of the data's mean square: a wrong minimum, or mostly noise")
    if open_direction:
        said.append("the data leave a parameter open here, so there is no uncertainty")
    if stopped:
        said.append("it was stopped at max_evaluations")
    return "; ".join(said)
