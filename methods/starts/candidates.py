"""Which starts are worth a fit: parameter sets from the data alone, screened by a few output-error steps each.

The misfit of a response has one minimum per half-period that the phase can slip over the record, so a local search
from a wrong frequency stays there. Linear systems are started from a scan (:mod:`methods.starts.scan`). Systems that
are not linear, or have several degrees of freedom, are started from damped sinusoids fitted to each displacement: a
regression of the equation of motion on them gives the parameters (:mod:`methods.starts.equation_error`).

Everything here expects a problem in its natural units (:meth:`bench.Problem.natural_units`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench import Channel, OutputError, Problem, Record, Start
from methods.starts.equation_error import regression_starts
from methods.starts.long_records import is_long, starts_of_long
from methods.starts.reach import MOST_MODES, is_unresolved
from methods.starts.rough import RADIANS_A_STEP, rough_readings
from methods.starts.scan import is_loaded, scan
from methods.starts.separate import separate
from methods.starts.unresolved import best_draws, best_speeds

NOISE_SHARE = 0.05
"""Error of the integration over the standard error that the data allow."""
HALVINGS = 4
"""How often the steps are halved at most."""
STIFFER = (1.0, 0.6, 1.6)
"""Stiffnesses of the starts of a system with hidden states, over what is stated of it."""
MOST_SCANNED = 2
"""Degrees of freedom up to which a scan is made beside a regression, which sees each stiffness by itself."""
LONGEST = 300
"""Samples of each channel on which initial guesses of a nonlinear system are compared; a longer record is solved
alone."""


@dataclass(frozen=True, eq=False)
class Stepped(OutputError):
    """A nonlinear system without hidden states, integrated by steps of at most so many radians."""

    radians: float = RADIANS_A_STEP

    def readings(self, p: dict[str, np.ndarray], start: Start, record: Record) -> np.ndarray:
        """Simulate what the sensors would show; not finite where the response diverges."""
        return rough_readings(self.system, p, start, record, self.radians)


def screening(model: OutputError) -> OutputError:
    """Return the model for comparing starts: of a nonlinear system without hidden states, less finely integrated."""
    return model if model.system.linear or model.system.n_hidden else Stepped(model.problem)


def as_fine_as_noise(model: OutputError, theta: np.ndarray) -> OutputError:
    """Return the model for a final answer near ``theta``, integrated to ``NOISE_SHARE`` of the data's standard error.

    Steps are halved until that moves no sample by more: no law of the error holds where a force is not smooth.
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
    """Return the first samples of long records of a nonlinear system: ``theta`` means the same for them.

    Its step-by-step simulations would outlast the fit; linear responses are quick at any length.
    """
    if model.system.linear or all(c.n <= LONGEST for _, c in model.channels):
        return model

    def short(c: Channel) -> Channel:
        return replace(c, times=c.times[:LONGEST], values=c.values[:LONGEST])

    records = tuple(replace(r, channels=tuple(short(c) for c in r.channels)) for r in model.problem.records)
    return OutputError(replace(model.problem, records=records))


def screened(model: OutputError, n: int = 3, rounds: int = 2, iterations: int = 8) -> list[tuple[float, np.ndarray]]:
    """Return the best ``n`` separate starts after a few output-error steps each: (profile, theta), best first."""
    quick = screening(model)
    thetas = quick.settle(np.stack([quick.vector(p) for p in candidates(model, n + 1)]), rounds, iterations)
    values = np.array([quick.profile(theta) for theta in thetas])
    return [(float(values[i]), thetas[i]) for i in separate(model, values, thetas)[:n]]


def candidates(model: OutputError, n: int) -> list[dict[str, float]]:
    """Return parameter sets to start from, in natural units: by regression, scan, and the prior's nominal values."""
    problem = model.problem
    if problem.system.linear and is_long(problem):
        return starts_of_long(problem, lambda short: candidates(short, n)) or _nominal(problem)
    several = problem.system.n_dof > 1 or not problem.system.linear
    with np.errstate(all="ignore"):
        found = regression_starts(problem) if several else []
        if problem.system.linear and (problem.system.n_dof <= MOST_SCANNED or not found):
            found = found + _scanned(problem, n)
        if several and is_unresolved(problem) and not problem.system.n_hidden:
            quick = screening(model)
            if problem.system.n_dof == 1:
                found = found + best_speeds(quick, n)
            if problem.system.n_dof <= MOST_MODES:
                found = found + best_draws(quick)
    if problem.prior is not None and (several or is_loaded(problem)):
        found.append(dict(problem.prior.nominal))
    good = [p for p in found if all(np.isfinite(v) and v > 0 for v in p.values())]
    good = good or _nominal(problem)
    if not problem.system.n_hidden:
        return good
    # no regression on measured motions sees hidden states: these are tried at several frequencies
    stiff = [q.name for q in problem.system.parameters if q.kind == "stiffness"]
    return [{name: v * (by if name in stiff else 1.0) for name, v in p.items()} for p in good for by in STIFFER]


def _nominal(problem: Problem) -> list[dict[str, float]]:
    """Return the prior's nominal values; without one, ones."""
    return [dict(problem.prior.nominal) if problem.prior else dict.fromkeys(problem.system.names, 1.0)]


def _scanned(problem: Problem, n: int) -> list[dict[str, float]]:
    """Return the starts of the scan; none where the proportions that it begins with make a singular mass matrix."""
    try:
        return scan(problem, n)
    except np.linalg.LinAlgError:
        return []
