"""Terms of a sum that a record does not need: a fit runs their size down to zero, and what the record allows of it.

The logarithm of a size that is zero is not finite, so no search ends there, and no interval can be told. Such a term is
left out, and of its size the largest is said that the record does not exclude.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from bench.contract.belief import standard_quantile
from bench.contract.problem import Units
from bench.likelihood.compiled import compiled_output_error
from bench.likelihood.output_error import OutputError
from bench.records.grown import first_guess, vibration
from bench.records.linearised import Linearised, at_theta
from bench.systems import System
from bench.systems.sums import TERMS, Sum

NOTHING = 1e-3
"""A term counts as nothing where its force is less than this part of the spring's at the amplitude."""
ONE_SIDED = float(standard_quantile(0.95, None))
MOST_STEP = 1.0
"""Of a logarithm."""
SIZES = ("mu", "c2", "k3", "k3s", "c", "b")


def vanishing(at: Linearised, system: Sum) -> list[str]:
    """Parameters of a fitted sum whose force is next to nothing."""
    p = {name: float(value) for name, value in at.model.parameters(at.theta).items()}
    rate, size = vibration(at.model.channels[0][1])
    spring = p.get("k", p["m"] * rate**2) * size
    forces = {
        "mu": p.get("mu", 0.0), "c2": p.get("c2", 0.0) * (rate * size) ** 2, "c": p.get("c", 0.0) * rate * size,
        "k3": p.get("k3", 0.0) * size**3, "k3s": p.get("k3s", 0.0) * size**3, "b": p.get("b", 0.0),
    }  # fmt: skip
    gone = [name for name in SIZES if name in p and forces[name] < NOTHING * spring]
    return gone if len(gone) < len(system.terms) else gone[1:]


def without(system: Sum, zero: Collection[str]) -> Sum:
    """The sum without the terms of some parameters."""
    kept = tuple(term for term in system.terms if TERMS[term].parameters[0].name not in zero)
    return replace(system, terms=kept or system.terms)


def unit_over_mass(system: System, name: str) -> str:
    """The unit of a parameter over the mass."""
    return next((q.unit for q in system.groups if q.name == f"{name}_over_m"), "")


def most_allowed(smaller: Linearised, full: Sum, zero: Collection[str], units: Units) -> Mapping[str, float]:
    """The one-sided 95 % limit of each parameter at zero, over the mass, in SI units.

    One such term at a time beside those of the fit without them: the likelihood is linearised at next to nothing of it,
    with the noise as coloured as it is there. A parameter that may not be negative has its limit at the estimate there,
    or zero where that is negative, and 1.645 standard errors.

    Args:
        smaller: The fit without the terms, in natural units.
        full: The sum with them, in the same units.
        zero: Names of their parameters.
        units: The natural units in SI.
    """
    return {
        name: _most(smaller, without(full, [other for other in zero if other != name]), name, units) for name in zero
    }


def _most(smaller: Linearised, system: Sum, name: str, units: Units) -> float:
    model = compiled_output_error(replace(smaller.model.problem, system=system), smaller.model.gauge)
    near = beside_nothing(smaller, model)
    covariance = None if near is None else replace(near, told=smaller.noises).coloured
    if near is None or covariance is None:
        return float("inf")
    i = model.free.index(name)
    little = float(np.exp(near.theta[i]))
    most = little * (max(1.0 + float(_step(near)[i]), 0.0) + float(np.sqrt(covariance[i, i])) * ONE_SIDED)
    dimensions = {p.name: p.dimension for p in system.parameters}
    return most / model.gauge * units.of(dimensions[name]) / units.of(dimensions["m"])


def beside_nothing(smaller: Linearised, model: OutputError) -> Linearised | None:
    """The likelihood of a system with more terms at the fit without them, with next to nothing of each."""
    known = dict(zip(smaller.model.free, smaller.theta, strict=False))
    sizes = first_guess(model.system, *vibration(smaller.model.channels[0][1]), float(np.exp(known.get("m", 0.0))))
    logs = [known.get(name, np.log(NOTHING * sizes[name])) for name in model.free]
    theta = np.concatenate([logs, smaller.theta[len(smaller.model.free) :]])
    return at_theta(model, theta) if theta.size == model.size else None


def linear_start(smaller: Linearised, model: OutputError) -> np.ndarray | None:
    """Unknowns with more terms, by one step from the fit without them, in which the response is linear in their sizes.

    None where a size comes out negative.
    """
    near = beside_nothing(smaller, model)
    if near is None:
        return None
    theta, step = near.theta.copy(), _step(near)
    for i, name in enumerate(model.free):
        if name in smaller.model.free:
            theta[i] += float(np.clip(step[i], -MOST_STEP, MOST_STEP))
        elif step[i] <= -1.0:
            return None
        else:
            theta[i] += float(np.log1p(step[i]))
    theta[len(model.free) :] += step[len(model.free) :]
    return theta


def _step(at: Linearised) -> np.ndarray:
    """The step (size,) of Gauss and Newton, each derivative to its own scale."""
    sizes = np.maximum(np.linalg.norm(at.slopes, axis=0), 1e-300)
    return np.asarray(np.linalg.lstsq(at.slopes / sizes, at.residuals, rcond=1e-10)[0] / sizes)
