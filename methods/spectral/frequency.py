"""Maximum likelihood in the frequency domain for one mass, free or under a known force, on the lines of the DFT.

``Y(k) = G(s_k) U(k) + T(z_k)/A(z_k) + noise``: the response to the force, a transient over the denominator of the
system, and white noise of unknown level (R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach,
2nd ed. 2012, chapters 6, 7 and 9). The transient accounts for leakage and for the initial and final states without a
window; the force is interpolated between its samples as stated (:mod:`methods.spectral.lines`). Free vibration is a
ratio of polynomials with a free numerator.

All lines are used, so the likelihood and the bound equal those of output error with an unknown initial state. The
initial state is always estimated, through the transient. A sensor's offset frees the line of frequency zero.

The search (:mod:`methods.spectral.fit`) starts at the best minima of the scan (:mod:`methods.starts.candidates`),
without the prior for a free vibration. The covariance is the inverse of the Fisher information with transient and
offset projected out, at the noise level of the residuals.

Free vibration gives k/m and c/m, which may be negative under noise; a force gives m, c and k. The DFT of a free
vibration is the same for a frequency and its aliases; the lowest frequency is returned.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bench import (
    Card,
    Cost,
    Estimate,
    InitialState,
    InputError,
    Linearisation,
    NoEstimate,
    Normal,
    OutputError,
    Problem,
    Scope,
    SimulatedResponse,
    covariances,
    estimate_at,
    fit_initial_state,
)
from methods.modal.free_decay import GROWS, has_offset
from methods.regression.identifier import without_start
from methods.spectral.fit import Objective, search
from methods.spectral.lines import HarmonicLayout, force_harmonics, real_lines
from methods.starts.ambiguity import SearchingIdentifier
from methods.starts.candidates import candidates
from methods.starts.search_range import unevenness

MAX_SAMPLES = 2000
"""Largest number of samples of a record; the cost of a fit is the harmonics times these."""
HARMONICS = 1024
"""Least number of harmonics of the force; the truncation error is below 1 / HARMONICS² of the response."""
PER_SAMPLE = 4
"""Least number of harmonics per sample."""
SCREENING = 6
"""Iterations of each search before the best one is continued."""
SIGMA_ROUNDS = 6
"""Largest number of alternations of fit and noise estimation with a prior."""
POOR = 0.5
"""A fit is poor if its residuals exceed this fraction of the data's mean square."""
NO_VIBRATION = "its best fit has no positive stiffness: the record shows no vibration or is too short"
NO_RESPONSE = "the search diverged: more samples, or a force that causes a larger response, are required"


@dataclass(frozen=True)
class Frequency(SearchingIdentifier):
    """Screen ``starts`` initial guesses by a few iterations each, then search from the best for ``iterations``."""

    starts: int = 3
    iterations: int = 100

    card: ClassVar[Card] = Card(
        summary="maximum likelihood on the lines of the DFT, with the transient as an additional numerator",
        start="estimated always",
        scale="native",
        reconstruction="own",
        uncertainty="inverse Fisher information, Student t with N - p degrees of freedom",
        settings_source="only the effort of the search: a few iterations from each guess of the scan, then the best",
        tuning="none",
        title="Frequency domain",
        order=80,
    )
    scope: ClassVar[Scope] = Scope(offsets=True, nonlinear=False, max_dof=1)
    works_in = "natural units"

    def __post_init__(self) -> None:
        for name in ("starts", "iterations"):
            if getattr(self, name) < 1:
                raise InputError(f"method.{name}", getattr(self, name), "at least 1")

    def objection(self, problem: Problem) -> str | None:
        return super().objection(problem) or _objection(problem)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate m, c and k where a force determines the scale, else k/m and c/m. Uses no randomness.

        Raises NoEstimate where the fit has no stiffness, or no response.
        """
        free = without_start(problem if problem.forced else replace(problem, prior=None))
        objective = _objective(free)
        starts = np.stack([_unknowns(free, p) for p in candidates(OutputError(free), self.starts)[: self.starts]])
        screened, spent = search(objective, starts, min(SCREENING, self.iterations))
        end, evaluations = search(objective, screened.unknowns[[np.argmin(screened.cost)]], self.iterations)
        spent += evaluations
        if not np.isfinite(end.cost[0]):
            raise NoEstimate(NO_RESPONSE, cost=Cost(spent, spent))
        return (self._forced if free.forced else self._free)(free, objective, end, spent)

    def _forced(self, problem: Problem, objective: Objective, end: Linearisation, spent: int) -> Estimate:
        """Return the estimate of all parameters; with a prior, alternate fit and noise estimation."""
        names, samples, used = _parameters(problem), objective.y.size, 5 + int(objective.offset)
        sigma = _noise(end, samples, used)
        for _ in range(SIGMA_ROUNDS if problem.prior is not None else 0):
            assert problem.prior is not None
            sds = np.array([problem.prior.log_sd[name] for name in names])
            nominal = np.log([problem.prior.nominal[name] for name in names])
            end, evaluations = search(
                replace(objective, nominal=nominal, width=sds / sigma), end.unknowns, self.iterations
            )
            spent, before, sigma = spent + evaluations, sigma, _noise(end, samples, used)
            if abs(np.log(sigma / before)) < 1e-3:
                break
        model = OutputError(problem)
        covariance = _covariance(end, sigma, [names.index(name) for name in problem.system.names])
        p = dict(zip(names, map(float, np.exp(end.unknowns[0])), strict=True))
        message = _message(end.residuals[0, :samples], objective.y, covariance)
        return estimate_at(model, model.vector(p), covariance, float(used), Cost(spent, spent), message)

    def _free(self, problem: Problem, objective: Objective, end: Linearisation, spent: int) -> Estimate:
        """Return the estimate of k/m and c/m at the lowest of the aliased frequencies."""
        r, g = _lowest(end.unknowns[0], objective.layout.step)
        if not r > 0:
            raise NoEstimate(NO_VIBRATION, cost=Cost(spent, spent))
        end, used, system = objective.linearise(np.array([[r, g]])), 4 + int(objective.offset), problem.system
        mass, damping, stiffness = _parameters(problem)
        order = [0 if stiffness in group.exponents else 1 for group in system.groups]
        covariance = _covariance(end, _noise(end, objective.y.size, used), order)
        names = tuple(group.name for group in system.groups)
        dof = max(float(objective.y.size - used), 1.0)
        p = {mass: 1.0, damping: g, stiffness: r}
        start = fit_initial_state(system, p, problem.records[0])
        return Estimate(
            system,
            groups=Normal(names, end.unknowns[0, order], covariance, log=False, dof=dof),
            reconstructions=(SimulatedResponse(system, p, start),),
            initial_states=(InitialState(start.displacement, start.velocity),),
            message=GROWS if g <= 0 else _message(end.residuals[0], objective.y, covariance),
            cost=Cost(spent, spent),
        )


def _lowest(unknowns: np.ndarray, step: float) -> tuple[float, float]:
    """Return k/m and c/m with the same poles z and a frequency up to half the sampling rate."""
    r, g = map(float, unknowns)
    if r - 0.25 * g**2 <= 0:
        return r, g
    turns = np.sqrt(r - 0.25 * g**2) * step / (2 * np.pi)
    omega = 2 * np.pi * abs(turns - np.round(turns)) / step
    return float(omega**2 + 0.25 * g**2), g


def _objective(problem: Problem) -> Objective:
    record = problem.records[0]
    channel = record.channels[0]
    step = float(channel.times[-1] - channel.times[0]) / (channel.n - 1)
    harmonics = np.zeros(0, complex)
    if problem.forced:
        count = channel.n * -(-max(HARMONICS, PER_SAMPLE * channel.n) // channel.n)
        first, last = float(channel.times[0]), float(channel.times[-1])
        harmonics = force_harmonics(record.forces, first, last, channel.n * step, count)
    return Objective(
        HarmonicLayout(channel.n, step, harmonics),
        real_lines(np.fft.rfft(channel.values, norm="ortho"), channel.n),
        has_offset(problem),
    )


def _parameters(problem: Problem) -> list[str]:
    """Return the names of mass, damping and stiffness."""
    kinds = {p.kind: p.name for p in problem.system.parameters}
    return [kinds["mass"], kinds["damping"], kinds["stiffness"]]


def _unknowns(problem: Problem, p: dict[str, float]) -> np.ndarray:
    m, c, k = (p[name] for name in _parameters(problem))
    return np.log([m, c, k]) if problem.forced else np.array([k / m, c / m])


def _noise(end: Linearisation, samples: int, used: int) -> float:
    """Return the standard deviation of the noise, at least 1e-12."""
    residuals = end.residuals[0, :samples]
    return max(float(np.sqrt(residuals @ residuals / max(samples - used, 1))), 1e-12)


def _covariance(end: Linearisation, sigma: float, order: list[int]) -> np.ndarray | None:
    """Return the covariance of the unknowns in the given order; None where the information is singular."""
    covariance = covariances(end.slopes / sigma)[0]
    return None if covariance is None else covariance[np.ix_(order, order)]


def _message(residuals: np.ndarray, y: np.ndarray, covariance: np.ndarray | None) -> str:
    share = float(residuals @ residuals) / float(y @ y)
    poor = f"residuals are {share:.0%} of the data's mean square: a wrong minimum, or mostly noise"
    no_interval = "the data do not determine a parameter, so no uncertainty is given"
    return "; ".join(filter(None, [poor if share > POOR else "", no_interval if covariance is None else ""]))


def _objection(problem: Problem) -> str | None:
    if sorted(p.kind for p in problem.system.parameters) != ["damping", "mass", "stiffness"]:
        return "it requires one mass, one damping and one stiffness"
    record = problem.records[0]
    times = record.channels[0].times
    least = 5 + int(problem.forced) + int(has_offset(problem))
    if not least <= times.size <= MAX_SAMPLES:
        return f"it supports {least} to {MAX_SAMPLES} samples per record; decimate a longer one"
    if problem.forced and max(force.times.size for force in record.forces) > 10 * MAX_SAMPLES:
        return f"it supports at most {10 * MAX_SAMPLES} samples of a force; decimate it"
    return unevenness(times)
