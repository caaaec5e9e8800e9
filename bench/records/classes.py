"""Comparison of model classes: sums of terms that describe records, ranked by an information criterion.

All classes are fitted to each record (:mod:`bench.records.general_law`) and compared by the Bayesian information
criterion, with coloured noise estimated from the residuals of each class; criteria of several records are added. A
class is preferred to a simpler one only on strong evidence, and evidence is discounted by its standard error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bench.contract.problem import Problem
from bench.records.colour import criterion_error
from bench.records.general_law import COEFFICIENTS, ClassFits, LawFitter, excerpt
from bench.records.intervals import HALF
from bench.records.models import TIED, ClassComparison, ModelClass, smoothing_velocity, unit_over_mass
from bench.records.problem import Measured, with_system
from bench.systems.sums import Sum

SPRINGS = {"viscous": ("k",), "cubic": ("k", "k3"), "pendulum": ("pendulum",)}
"""Coefficients of the restoring force, by class."""
DAMPINGS = {"": (), " + Coulomb": ("mu",), " + quadratic": ("c2",), " + Coulomb + quadratic": ("mu", "c2")}
"""Coefficients of damping in addition to viscous damping."""
AXES = {"no spring: viscous": (), "no spring: viscous + Coulomb": ("mu",),
        "no spring: viscous + Coulomb + bias": ("mu", "b")}  # fmt: skip
"""Damping coefficients of classes without a restoring force, such as a driven axis of a machine."""
TERM_OF = {"c": "viscous", "k": "spring", "pendulum": "pendulum", "c2": "quadratic", "mu": "coulomb", "b": "bias"}
STRONG = 6.0
"""Evidence required per additional term: twice the logarithm of a Bayes factor (R. E. Kass, A. E. Raftery, J. Am. Stat.
Assoc. 90:773, 1995, section 3.2)."""
DESCRIBES = 0.3
"""Ratio of residuals to signal below which a class is taken to describe a record."""


def compare_classes(measured: Measured) -> ClassComparison | None:
    """Fit the classes of one degree of freedom to records; None for several degrees of freedom or an added mass."""
    problem = measured.problem
    if problem.system.n_dof > 1 or any(r.added_mass is not None for r in problem.records):
        return None
    wanted = _candidates(problem.forced, measured.angle)
    return _compared(measured, wanted, _fits(problem, list(wanted.values())))


def needless_terms(measured: Measured) -> Mapping[str, float]:
    """Return the terms of a named sum that the first record does not require.

    Returns:
        Upper 95 % limit of each such coefficient over the mass (SI units), by name of the coefficient.
    """
    problem = replace(measured.problem, records=measured.problem.records[:1])
    system = problem.system
    if not isinstance(system, Sum) or any(name != "l" for name, _ in system.fixed):
        return {}
    names = [name for name in COEFFICIENTS[1:-1] if TERM_OF.get(name) in system.terms]
    names += ["k3"] if {"cubic", "softening"} & set(system.terms) else []
    names += ["1/l"] if "l" in system.names else []
    simple = [name for name in names if name not in ("mu", "c2")]
    wanted = {"simple": _free(simple, problem.forced), "named": _free(names, problem.forced)}
    fits = _fits(problem, list(wanted.values()), dict(system.fixed).get("l"))
    zero = fits[0].free[1] != wanted["named"]
    return {name: most for name, most in fits[0].limits_in_si(1).items() if zero[COEFFICIENTS.index(name)]}


def best_class(measured: Measured, comparison: ClassComparison | None) -> Measured:
    """Return the records with the class selected by a comparison, and a note; with sdof if there is no comparison."""
    if comparison is None:
        note = "system=auto compares classes of one degree of freedom only: system=sdof is used"
        return replace(measured, notes=(*measured.notes, note))
    chosen = comparison.chosen
    note = f"system=auto selected system={'+'.join(chosen.system.terms)}"
    tied = ", ".join(model.name for model in comparison.tied)
    note += f"; tied with {tied}" if tied else ""
    zeros = [
        f"{name}/m is zero, at most {most:.3g} {unit_over_mass(name)}"
        for name, most in chosen.zero.items()
        if np.isfinite(most)
    ]
    measured = with_system(measured, chosen.system)
    return replace(measured, notes=(*measured.notes, note, *zeros), comparison=comparison)


def _candidates(forced: bool, angle: bool) -> dict[str, np.ndarray]:
    """Return the free coefficients of each class; pendulums are included for angles only."""
    springs = SPRINGS if angle else {name: SPRINGS[name] for name in ("viscous", "cubic")}
    classes = {
        name + more: _free(("c", *pulls, *damps), forced)
        for name, pulls in springs.items()
        for more, damps in DAMPINGS.items()
    }
    return classes | ({name: _free(("c", *terms), True) for name, terms in AXES.items()} if forced else {})


def _free(names: Sequence[str], forced: bool) -> np.ndarray:
    return np.array([name in names or (forced and name == "1/m") for name in COEFFICIENTS])


def _fits(problem: Problem, wanted: Sequence[np.ndarray], length: float | None = 1.0) -> list[ClassFits]:
    """Fit classes to each record; ``length`` is that of the pendulum (m; 1 for angles), None if unknown."""
    cuts = [excerpt(record) for record in problem.records]
    turns = [0.3 if length is None else cut.size / length for cut in cuts]
    return [LawFitter(cut, np.array(wanted), turn).fitted() for cut, turn in zip(cuts, turns, strict=True)]


def _compared(measured: Measured, wanted: Mapping[str, np.ndarray], fits: Sequence[ClassFits]) -> ClassComparison:
    """Score the classes and sort them by score; of classes with equal free coefficients the simplest is kept."""
    names, free = list(wanted), np.any([fit.free for fit in fits], axis=0)
    terms = [int(np.sum(coefficients)) for coefficients in wanted.values()]
    kept: list[int] = []
    for case in sorted(range(len(names)), key=lambda i: terms[i]):
        repeated = any(np.array_equal(free[case], free[other]) for other in kept)
        if np.any(free[case, 1:]) and not repeated:  # a class whose damping was negative may have no terms left
            kept.append(case)
    rms = np.array(
        [np.sqrt(np.mean(np.concatenate([fit.residuals[i] for fit in fits]) ** 2)) for i in range(len(names))]
    )
    kept = _oscillating(kept, free, rms, fits)
    logs = np.concatenate([fit.log_likelihoods for fit in fits], axis=1)
    criteria = -2.0 * np.sum(logs, axis=1)
    for fit in fits:
        criteria += fit.unknowns * np.log(max(float(np.max(fit.independent[kept])), 2.0))
    best = min(kept, key=lambda i: criteria[i])
    classes = []
    for i in kept:
        difference, error = float(criteria[i] - criteria[best]), criterion_error(logs[best], logs[i])
        evidence = difference * min(1.0, TIED / max(HALF * error, TIED))
        score = evidence + STRONG * (terms[i] - min(terms))
        classes.append(_model_class(measured, names[i], i, fits, (difference, error, score, float(rms[i]))))
    classes.sort(key=lambda model: (model.score, not model.system.linear))
    return ClassComparison(
        tuple(replace(model, told_apart=model.score - classes[0].score >= TIED) for model in classes)
    )


def _oscillating(kept: list[int], free: np.ndarray, rms: np.ndarray, fits: Sequence[ClassFits]) -> list[int]:
    """Remove overdamped classes with a spring if a class without a spring describes the record.

    The position of a driven axis drifts, which a weak spring can imitate.
    """
    springs = [COEFFICIENTS.index(name) for name in ("k", "pendulum", "k3")]
    axes = [i for i in kept if not np.any(free[i, springs])]
    if not axes or min(rms[i] for i in axes) > DESCRIBES:
        return kept
    values = fits[0].coefficients
    overdamped = values[:, 1] ** 2 >= 4.0 * np.maximum(values[:, springs[0]], values[:, springs[1]])
    return [i for i in kept if i in axes or not overdamped[i]]


def _model_class(
    measured: Measured,
    name: str,
    case: int,
    fits: Sequence[ClassFits],
    figures: tuple[float, float, float, float],
) -> ModelClass:
    """Return a fitted class in SI units, with means over the records."""
    free = np.any([fit.free[case] for fit in fits], axis=0)
    each = [fit.in_si(fit.coefficients[case]) for fit in fits]
    values = {key: float(np.mean([si[key] for si in each])) for key in each[0]}
    terms = [term for key, term in TERM_OF.items() if free[COEFFICIENTS.index(key)]]
    if free[COEFFICIENTS.index("k3")]:
        terms.append("cubic" if values["k3"] > 0 else "softening")
        name = name.replace("cubic", "Duffing" if values["k3"] > 0 else "softening")
    channel = measured.problem.records[0].channels[0]
    velocity = smoothing_velocity(channel.times, channel.values, channel.measures)
    fixed = (("l", 1.0),) if "pendulum" in terms else ()
    system = Sum(tuple(terms), velocity, fixed, -1 if values["b"] < 0 else 1)
    mass = values["m"] if measured.problem.forced else 1.0
    known = {"k": values["pendulum"] if "pendulum" in terms else values["k"], "k3s": values["k3"]}
    parameters = {n: abs((values | known)[n]) * (1.0 if n == "m" else mass) for n in system.names if n != "m"}
    parameters |= {"m": mass} if measured.problem.forced else {}
    limits = [fit.limits_in_si(case) for fit in fits]
    zero = {key: max(limit[key] for limit in limits) for key in limits[0] if not free[COEFFICIENTS.index(key)]}
    criterion, error, score, rms = figures
    cut, (x, v) = fits[0].excerpt, fits[0].starts[case]
    start = float(x) * cut.size, float(v) * cut.size * cut.rate
    return ModelClass(name, system, parameters, start, criterion, error, score, rms, zero)
