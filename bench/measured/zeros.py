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
from bench.likelihood.output_error import OutputError
from bench.measured.grown import first_guess
from bench.measured.linearised import Linearised, at_theta, strongest_frequency
from bench.systems.sums import TERMS, Sum

NOTHING = 1e-3
"""A term counts as nothing where its force is less than this part of the spring's at the amplitude."""
SIZES = ("mu", "c2", "k3", "k3s", "c", "b")


def vanishing(at: Linearised, system: Sum) -> list[str]:
    """Parameters of a fitted sum whose force is next to nothing."""
    p = {name: float(value) for name, value in at.model.parameters(at.theta).items()}
    size, rate = _size(at), _rate(at)
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
    model = OutputError(replace(smaller.model.problem, system=system), smaller.model.gauge)
    known = dict(zip(smaller.model.free, smaller.theta, strict=False))
    little = NOTHING * first_guess(system, _rate(smaller), _size(smaller))[name]
    logs = [known.get(one, np.log(little)) for one in model.free]
    theta = np.concatenate([logs, smaller.theta[len(smaller.model.free) :]])
    near = at_theta(model, theta) if theta.size == model.size else None
    covariance = None if near is None else replace(near, told=smaller.noises).coloured
    if near is None or covariance is None:
        return float("inf")
    i = model.free.index(name)
    step = float(np.linalg.lstsq(near.slopes, near.residuals, rcond=None)[0][i])
    most = little * (max(1.0 + step, 0.0) + float(np.sqrt(covariance[i, i])) * float(standard_quantile(0.95, None)))
    dimensions = {p.name: p.dimension for p in system.parameters}
    return most / model.gauge * units.of(dimensions[name]) / units.of(dimensions["m"])


def _size(at: Linearised) -> float:
    return float(np.ptp(at.model.channels[0][1].values)) / 2.0 or 1.0


def _rate(at: Linearised) -> float:
    channel = at.model.channels[0][1]
    return 2 * np.pi * strongest_frequency(channel.times, channel.values)
