"""Which starts are worth a fit: parameter sets from the data alone, screened by a few output-error steps each.

The misfit of a response has one minimum per half-period that the phase can slip over the record, so a local search
from a wrong frequency stays there. Linear systems are started from a scan (:mod:`methods.starts.scan`). Systems that
are not linear, or have several degrees of freedom, are started from damped sinusoids fitted to each displacement: a
regression of the equation of motion on them gives the parameters (:mod:`methods.starts.equation_error`).

Everything here expects a problem in its natural units (:meth:`bench.Problem.natural_units`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench import OutputError, Record, Start, state_matrix
from methods.starts.equation_error import regression_starts
from methods.starts.rough import RADIANS_A_STEP, rough_readings
from methods.starts.scan import loaded_scan, scan

NOISE_SHARE = 0.05
"""Error of the integration over the standard error that the data allow."""
HALVINGS = 4
"""How often the steps are halved at most."""
ALIAS_MARGIN = 6.0
"""By how much in minus twice the log-posterior: odds of 20 to 1."""


@dataclass(frozen=True, eq=False)
class Stepped(OutputError):
    """The same, for a nonlinear system without hidden states, integrated by steps of at most so many radians."""

    radians: float = RADIANS_A_STEP

    def readings(self, p: dict[str, np.ndarray], start: Start, record: Record) -> np.ndarray:
        """As above; not finite where the response diverges."""
        return rough_readings(self.system, p, start, record, self.radians)


def screening(model: OutputError) -> OutputError:
    """The model for comparing starts: of a nonlinear system without hidden states, less finely integrated."""
    return model if model.system.linear or model.system.n_hidden else Stepped(model.problem)


def as_fine_as_noise(model: OutputError, theta: np.ndarray) -> OutputError:
    """The model for a final answer near ``theta``, integrated to ``NOISE_SHARE`` of the standard error of the data.

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


def screened(model: OutputError, n: int = 3, rounds: int = 2, iterations: int = 8) -> list[tuple[float, np.ndarray]]:
    """The best ``n`` separate starts after a few output-error steps each: (profile, theta), best first.

    The sampling is taken to resolve the motion: where the slowest oscillation of a linear system came to lie above
    half the sampling rate, it is dropped as the alias of a slower one, unless data and prior clearly prefer it.
    """
    found: list[tuple[float, np.ndarray]] = []
    quick = screening(model)
    thetas = np.stack([quick.vector(p) for p in candidates(model, n + 1)])
    for theta in quick.settle(thetas, rounds, iterations):
        value = quick.profile(theta)
        near = [other for _, other in found if np.max(np.abs(other - theta)[: len(model.free)]) < 1e-2]
        if np.isfinite(value) and not near:
            found.append((value, theta))
    found.sort(key=lambda pair: pair[0])
    resolved = [pair for pair in found if not _aliased(model, pair[1])]
    clear = not resolved or found[0][0] + ALIAS_MARGIN < resolved[0][0]
    return (found if clear else resolved)[:n]


def _aliased(model: OutputError, theta: np.ndarray) -> bool:
    if not model.system.linear:
        return False
    rates = np.linalg.eigvals(state_matrix(model.system, model.parameters(theta))[0])
    oscillations = np.abs(rates.imag)[np.abs(rates.imag) > 0]
    gaps = [float(np.median(np.diff(c.times))) for _, c in model.channels if c.n > 1]
    return bool(oscillations.size and gaps and oscillations.min() * min(gaps) > np.pi)


def candidates(model: OutputError, n: int) -> list[dict[str, float]]:
    """Parameter sets to start from, in natural units: from the scan, the regression, and the prior's nominal values."""
    problem = model.problem
    with np.errstate(all="ignore"):
        linear = problem.system.linear
        loaded = any(record.added_mass is not None for record in problem.records)
        found = (loaded_scan(problem, n) if loaded else scan(problem, n)) if linear else []
        if problem.system.n_dof > 1 or not linear:
            found = regression_starts(problem) + found
    if problem.prior is not None and (problem.system.n_dof > 1 or not linear or loaded):
        found.append(dict(problem.prior.nominal))
    good = [p for p in found if all(np.isfinite(v) and v > 0 for v in p.values())]
    return good or [dict(problem.prior.nominal) if problem.prior else dict.fromkeys(problem.system.names, 1.0)]
