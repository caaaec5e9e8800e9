"""Test for forces that a fitted sum of terms lacks: dry friction, quadratic damping, a cubic spring.

The residuals are regressed on the derivatives of the fit and on those by each added force at zero (a score test: C. R.
Rao, Proc. Camb. Phil. Soc. 44:50, 1948). The combination of forces with the smallest Bayesian information criterion,
computed with coloured noise, is reported as missing.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from bench.likelihood.autoregression import even_times
from bench.likelihood.output_error import OutputError
from bench.records.colour import information_criterion
from bench.records.dominant_frequency import dominant_frequency
from bench.records.linearised_fit import LinearisedFit
from bench.systems.sums import TERMS, Sum

NAMES = {"coulomb": "dry friction", "quadratic": "quadratic damping", "cubic": "a cubic spring"}
SHAPED = {"softening", "pendulum"}
"""Springs that are nonlinear already, to which no cubic spring is added."""
SMALL = 1e-3
"""Added force over the spring force, in the finite difference of its derivative."""
TURNS = 0.05
"""Smoothing velocity of dry friction over the largest speed."""
STRONG = 6.0
"""Least decrease of the criterion that is strong evidence (R. E. Kass, A. E. Raftery, J. Am. Stat. Assoc. 90:773,
1995)."""
MOST_SAMPLES, MOST_CYCLES = 2000, 100.0
"""Limits of the samples and cycles used; they bound the time, as motions with added forces are integrated in time."""


def missing_forces(fit: LinearisedFit) -> tuple[str, ...]:
    """Return the forces that a sum of terms lacks according to the residuals of a record of displacements."""
    system, records = fit.model.system, fit.model.problem.records
    if not isinstance(system, Sum) or len(records) > 1 or not {"c", "k"} <= set(system.names):
        return ()
    channel = records[0].channels[0]
    if len(records[0].channels) > 1 or channel.measures != "displacement" or not even_times(channel.times):
        return ()
    cycles = channel.times * dominant_frequency(channel.times, channel.values)
    end = int(np.searchsorted(cycles, MOST_CYCLES))
    kept = slice(0, end, -(-end // MOST_SAMPLES))
    slopes, residuals = fit.slopes[kept], fit.residuals[kept]
    columns = _columns(fit, system, kept)
    first = information_criterion(_residuals(slopes, residuals), fit.theta.size)
    gains: dict[tuple[str, ...], float] = {(): STRONG}
    for count in range(1, len(columns) + 1):
        for terms in combinations(columns, count):
            rows = np.column_stack([slopes, *(columns[term] for term in terms)])
            gains[terms] = first - information_criterion(_residuals(rows, residuals), rows.shape[1])
    return tuple(NAMES[term] for term in max(gains, key=gains.__getitem__))


def _columns(fit: LinearisedFit, system: Sum, kept: slice) -> dict[str, np.ndarray]:
    """Return the change of the predicted samples due to a small force, by name of its term."""
    model, record = fit.model, fit.model.problem.records[0]
    terms = [
        term for term in NAMES if term not in system.terms and not (term == "cubic" and SHAPED & set(system.terms))
    ]
    p = {name: float(value) for name, value in model.parameters(fit.theta).items()}
    size, rate = float(np.ptp(model.data - fit.residuals)) / 2.0, float(np.sqrt(p["k"] / p["m"]))
    force = SMALL * p["k"] * size
    sizes = {"mu": force, "c2": force / (rate * size) ** 2, "k3": force / size**3}
    turn = system.smoothing_velocity if "coulomb" in system.terms else TURNS * rate * size
    channel = record.channels[0]
    thin = replace(channel, times=channel.times[kept], values=channel.values[kept])
    larger = replace(system, terms=(*system.terms, *terms), smoothing_velocity=turn)
    problem = replace(model.problem, system=larger, records=(replace(record, channels=(thin,)),), prior=None)
    extended = OutputError(problem, model.gauge)
    theta = np.zeros((len(terms) + 1, extended.size))
    theta[:, len(extended.free) :] = fit.theta[len(model.free) :]
    for i, name in enumerate(extended.free):
        theta[:, i] = np.log(p.get(name, 1e-9 * sizes.get(name, 1.0)))
        theta[1:, i][[TERMS[term].parameters[0].name == name for term in terms]] = np.log(sizes.get(name, 1.0))
    with np.errstate(all="ignore"):
        predicted = extended.predict(theta)
    differences = predicted[1:] - predicted[0]
    return {term: column for term, column in zip(terms, differences, strict=True) if np.all(np.isfinite(column))}


def _residuals(rows: np.ndarray, residuals: np.ndarray) -> np.ndarray:
    """Return the residuals (n,) of a regression on the columns of ``rows`` (n, p)."""
    norms = np.linalg.norm(rows, axis=0)
    scaled = rows / np.where(norms > 0, norms, 1.0)
    return np.asarray(residuals - scaled @ np.linalg.lstsq(scaled, residuals, rcond=1e-10)[0])
