"""Initial guesses from the data, screened by a few output-error iterations each.

The misfit of a response has one minimum per half-period that the phase can slip over the record, so a local search
from a wrong frequency stays there. The guesses of linear systems come from a scan (:mod:`methods.starts.scan`); those
of nonlinear systems and of several degrees of freedom from a regression of the equation of motion on damped sinusoids
fitted to each displacement (:mod:`methods.starts.equation_error`).

All functions take problems in natural units (:meth:`bench.Problem.natural_units`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench import Channel, InitialValues, OutputError, Problem, Record
from methods.starts.distinct_minima import distinct_minima
from methods.starts.equation_error import regression_starts
from methods.starts.integration import RADIANS_A_STEP, integrated_readings
from methods.starts.long_records import is_long, starts_of_long
from methods.starts.prior_guesses import best_draws, best_speeds
from methods.starts.scan import is_loaded, scan
from methods.starts.search_range import MOST_MODES, is_unresolved

NOISE_SHARE = 0.05
"""Largest error of the integration, relative to the standard error of the data."""
HALVINGS = 4
"""Largest number of halvings of the integration step."""
STIFFER = (1.0, 0.6, 1.6)
"""Factors by which the stiffnesses of the initial guesses of a system with hidden states are multiplied."""
MOST_SCANNED = 2
"""Degrees of freedom up to which a scan complements the regression, which estimates each stiffness separately."""
LONGEST = 300
"""Samples per channel on which initial guesses of a nonlinear system are compared; longer records are not batched."""


@dataclass(frozen=True, eq=False)
class Stepped(OutputError):
    """Output-error model of a nonlinear system without hidden states, integrated by steps of at most ``radians``."""

    radians: float = RADIANS_A_STEP

    def readings(self, p: dict[str, np.ndarray], start: InitialValues, record: Record) -> np.ndarray:
        """Simulate the measurements; not finite where the response diverges."""
        return integrated_readings(self.system, p, start, record, self.radians)


def screening(model: OutputError) -> OutputError:
    """Return the model that compares guesses; nonlinear ones without hidden states are integrated less accurately."""
    return model if model.system.linear or model.system.n_hidden else Stepped(model.problem)


def as_fine_as_noise(model: OutputError, theta: np.ndarray) -> OutputError:
    """Return the model for the final fit near ``theta``, integrated to ``NOISE_SHARE`` of the data's standard error.

    Steps are halved until no sample changes by more, since error estimates by order fail where a force is not smooth.
    """
    quick = screening(model)
    if not isinstance(quick, Stepped):
        return model
    predicted = quick.predict(theta)
    sigma = model.noise(model.data - predicted, 0.0)
    allowed = NOISE_SHARE * sigma[model.channel_of] / np.sqrt(model.data.size)
    for _ in range(HALVINGS):
        finer = Stepped(model.problem, radians=0.5 * quick.radians)
        before, predicted = predicted, finer.predict(theta)
        if np.all(np.abs(predicted - before) <= allowed):
            break
        quick = finer
    return quick


def head(model: OutputError) -> OutputError:
    """Return the model of the first ``LONGEST`` samples of a nonlinear system; ``theta`` keeps its meaning."""
    if model.system.linear or all(c.n <= LONGEST for _, c in model.channels):
        return model

    def short(c: Channel) -> Channel:
        return replace(c, times=c.times[:LONGEST], values=c.values[:LONGEST])

    records = tuple(replace(r, channels=tuple(short(c) for c in r.channels)) for r in model.problem.records)
    return OutputError(replace(model.problem, records=records))


def screened(model: OutputError, n: int = 3, rounds: int = 2, iterations: int = 8) -> list[tuple[float, np.ndarray]]:
    """Return the best ``n`` distinct ends of a few output-error iterations from each guess: (profile, theta)."""
    quick = screening(model)
    thetas = quick.settle(np.stack([quick.vector(p) for p in candidates(model, n + 1)]), rounds, iterations)
    values = np.array([quick.profile(theta) for theta in thetas])
    return [(float(values[i]), thetas[i]) for i in distinct_minima(model, values, thetas)[:n]]


def candidates(model: OutputError, n: int) -> list[dict[str, float]]:
    """Return initial guesses in natural units: by regression, scan, and the prior's nominal values."""
    problem = model.problem
    if problem.system.linear and is_long(problem):
        return starts_of_long(problem, lambda short: candidates(short, n)) or _nominal(problem)
    several = problem.system.n_dof > 1 or not problem.system.linear
    with np.errstate(all="ignore"):
        guesses = regression_starts(problem) if several else []
        if problem.system.linear and (problem.system.n_dof <= MOST_SCANNED or not guesses):
            guesses = guesses + _scanned(problem, n)
        if several and is_unresolved(problem) and not problem.system.n_hidden:
            quick = screening(model)
            if problem.system.n_dof == 1:
                guesses = guesses + best_speeds(quick, n)
            if problem.system.n_dof <= MOST_MODES:
                guesses = guesses + best_draws(quick)
    if problem.prior is not None and (several or is_loaded(problem)):
        guesses.append(dict(problem.prior.nominal))
    positive = [p for p in guesses if all(np.isfinite(v) and v > 0 for v in p.values())]
    positive = positive or _nominal(problem)
    if not problem.system.n_hidden:
        return positive
    # a regression on measured motions omits the hidden states, so several stiffnesses are tried
    stiff = [q.name for q in problem.system.parameters if q.kind == "stiffness"]
    return [{name: v * (by if name in stiff else 1.0) for name, v in p.items()} for p in positive for by in STIFFER]


def _nominal(problem: Problem) -> list[dict[str, float]]:
    """Return the prior's nominal values, or ones without a prior."""
    return [dict(problem.prior.nominal) if problem.prior else dict.fromkeys(problem.system.names, 1.0)]


def _scanned(problem: Problem, n: int) -> list[dict[str, float]]:
    """Return the guesses of the scan; none where the prior's proportions make a singular mass matrix."""
    try:
        return scan(problem, n)
    except np.linalg.LinAlgError:
        return []
