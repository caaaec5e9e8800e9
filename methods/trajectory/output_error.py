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
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.optimize import least_squares

from bench import (
    EVERY_PROBLEM,
    Card,
    Cost,
    Estimate,
    Identifier,
    InitialState,
    InputError,
    NoEstimate,
    OutputError,
    Problem,
    Serves,
    Standardised,
    estimate_at,
)
from methods.regression.equation import too_fast
from methods.starts.scan import records_by_load, unloaded

POOR = 0.5
"""A response that leaves more than this part of the mean square of the data is said to be poor."""


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
        try:
            return self._fitted(OutputError(problem))
        except np.linalg.LinAlgError:
            sentence = "the search ran to parameters without a response; give a prior nearer to the system"
            raise NoEstimate(sentence) from None

    def _fitted(self, model: OutputError) -> Estimate:
        start, spent = self._start(model.problem)
        theta = model.vector(start)
        if not np.all(np.isfinite(model.predict(theta))) or _out_of_reach(model, theta):
            sentence = "the response at the start values is not finite, or too fast; give a prior nearer to the system"
            raise NoEstimate(sentence)
        found = self._settled(model, theta)
        residuals, theta = found.residuals, found.theta
        covariance = model.covariance(model.jacobian(theta)[1], model.noise(residuals, found.used, floor=0.0))
        left = float(np.sum((residuals / model.rms[model.channel_of]) ** 2)) / model.data.size
        message = _message(left, covariance is None, found.stopped)
        cost = Cost(spent.evaluations + found.evaluations, spent.iterations + found.iterations)
        return estimate_at(model, theta, covariance, found.used, cost, message)

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
        return _Found(theta, residuals, used, stopped, evaluations, iterations)

    def _start(self, problem: Problem) -> tuple[dict[str, float], Cost]:
        """The cold start, and what it cost: nothing but where two loads tell the mass."""
        parts = records_by_load(problem)
        if problem.prior is not None or len(parts) == 1:
            return cold_start(problem), Cost(0, 0)
        alone, evaluations, iterations = {}, 0, 0
        for load in (min(parts), max(parts)):
            model = OutputError(parts[load])
            theta = model.vector(cold_start(parts[load]))
            if not np.all(np.isfinite(model.predict(theta))) or _out_of_reach(model, theta):
                return cold_start(problem), Cost(evaluations, iterations)
            found = self._settled(model, theta)
            alone[load] = {name: float(value) for name, value in model.parameters(found.theta).items()}
            evaluations, iterations = evaluations + found.evaluations, iterations + found.iterations
        return unloaded(problem, alone) or cold_start(problem), Cost(evaluations, iterations)


@dataclass(frozen=True)
class _Found:
    """Where a fit ended, the degrees of freedom that it ``used``, and what it took."""

    theta: np.ndarray
    residuals: np.ndarray
    used: float
    stopped: bool
    evaluations: int
    iterations: int


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
