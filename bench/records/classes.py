"""Model classes for a record, ranked: which sum of terms describes it, and which terms it does not need.

Each class is fitted by growing windows (:mod:`bench.records.grown`) and judged twice: by the likelihood of its
residuals as an autoregression, less what its unknowns cost (Bayesian information criterion), and by how well the fit of
the first 60 % predicts the last 40 % from its state there. A term whose size the fit runs down to nothing is left out,
with the largest size that the record does not exclude.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.contract.problem import Problem, Units
from bench.likelihood.compiled import compiled_output_error
from bench.likelihood.output_error import OutputError
from bench.records.colour import criterion_error, information_criterion
from bench.records.grown import first_guess, grown_fit, vibration, window
from bench.records.held_out import held_out_fit
from bench.records.intervals import HALF
from bench.records.linearised import Linearised, at_theta
from bench.records.models import candidates, smoothing_velocity
from bench.records.record import Measured, of_system, with_system
from bench.records.strongest import strongest_frequency
from bench.records.zeros import SIZES, linear_start, most_allowed, vanishing, without
from bench.systems.sums import Sum

SIMPLE = ("viscous", "Duffing", "softening", "pendulum")
"""Classes that differ in what pulls back."""
UNSPRUNG = "no spring"
FURTHER = ("cubic", "softening", "quadratic", "coulomb")
"""Terms that may join those that make a system vibrate."""
COARSER = 5.0
"""The smoothing velocity of friction while classes are compared, over that of the answer: steps may be longer."""
MOST_CYCLES = 12
MOST_SAMPLES = 400
"""Of the part of a record on which classes are compared, from its start: tens of fits are made."""
SHARES = (0.2, 0.8)
"""Of the viscous damping's work, what further damping does at first: beside all of it a search runs it down to zero."""
DESCRIBES = 0.3
"""Residuals over signal below which a class describes a record at all."""
SCREEN, SEARCH = 4, 40
"""Iterations of each start, and of the best of them."""
LEVEL, TOLD_APART = 2.0, 10.0
"""Differences of the criterion: up to the first a class is as good as another, and of such the simplest is chosen;
beyond the second it is told from the other (R. E. Kass, A. E. Raftery, J. Am. Stat. Assoc. 90:773, 1995, section 3.2).
"""


@dataclass(frozen=True, eq=False)
class ModelClass:
    """One class fitted to a record: its criterion above the best one's, residuals over signal, and held-out fit (%).

    ``at``: the fit, in ``units``. ``criterion_error``: standard error of that difference, as the samples of this record
    give it. ``zero``: terms that the fit ran down to nothing, and the most of each that the record allows, over the
    mass (SI).
    """

    name: str
    system: Sum
    criterion: float
    left: float
    held_out: float
    zero: Mapping[str, float]
    at: Linearised
    units: Units
    criterion_error: float = 0.0

    @property
    def told_apart(self) -> bool:
        """Whether this record tells the class from the best one: by the criterion, and beyond that of its samples."""
        return self.criterion >= max(TOLD_APART, HALF * self.criterion_error)


def ranked_classes(measured: Measured) -> list[ModelClass]:
    """The classes that could be fitted, the best first; empty for a record that no class of one DOF can take.

    First what pulls back is compared, with viscous damping; then friction and quadratic damping join the best of them.
    """
    problem = measured.problem
    record = problem.records[0]
    channel = record.channels[0]
    if problem.system.n_dof > 1 or len(record.channels) > 1 or channel.measures != "displacement":
        return []
    thinned = _thinned(replace(problem, records=(record,), prior=None))
    velocity = COARSER * smoothing_velocity(channel.times, channel.values)
    every = candidates(problem.forced, measured.angle, velocity)
    pulling = SIMPLE if measured.angle else SIMPLE[:-1]  # in metres a pendulum's length is told by large swings alone
    simple = {name: system for name, system in every.items() if name in pulling or name.startswith(UNSPRUNG)}
    found = _fitted(simple, thinned, [])
    sprung = sorted((one for one in found if not one.name.startswith(UNSPRUNG)), key=lambda one: one.criterion)
    for base in _bases(sprung):
        found += _fitted(_damped(base), thinned, [one for one in found if one is base])
    best = min(found, key=lambda one: one.criterion, default=None)
    return [] if best is None else sorted((_beside(one, best) for one in found), key=lambda one: one.criterion)


def _beside(one: ModelClass, best: ModelClass) -> ModelClass:
    """A class with its criterion as the difference from the best one's."""
    error = criterion_error(best.at.residuals, one.at.residuals, (best.at.theta.size, one.at.theta.size))
    return replace(one, criterion=one.criterion - best.criterion, criterion_error=error)


def fitted_class(measured: Measured) -> ModelClass | None:
    """The sum that the records are said to be of, fitted to the first of them without its further terms, then with."""
    problem = measured.problem
    system = problem.system
    if not isinstance(system, Sum) or len(problem.records[0].channels) > 1:
        return None
    thinned = _thinned(replace(problem, records=problem.records[:1], prior=None))
    system = replace(system, smoothing_velocity=COARSER * system.smoothing_velocity)
    simple = replace(system, terms=tuple(term for term in system.terms if term not in FURTHER) or system.terms)
    found = _fitted({"simple": simple}, thinned, []) if simple != system else []
    return next(iter(_fitted({"named": system}, thinned, found)), None)


def _bases(sprung: Sequence[ModelClass]) -> list[ModelClass]:
    """Of what pulls back, best first, the two that friction may join: what is missing may hide which of them is right.

    Of classes that are as good the simplest stands for the others.
    """
    if not sprung:
        return []
    first = simplest(sprung)
    more = [one for one in sprung if one.criterion > first.criterion + LEVEL and one.left < DESCRIBES]
    return [first, *more[:1]]


def _damped(base: ModelClass) -> dict[str, Sum]:
    """A class with further kinds of damping."""
    return {
        base.name + "".join(f" + {names[term]}" for term in more): replace(
            base.system, terms=(*base.system.terms, *more)
        )
        for names in ({"coulomb": "Coulomb", "quadratic": "quadratic"},)
        for more in (("coulomb",), ("quadratic",), ("coulomb", "quadratic"))
    }


def _fitted(systems: Mapping[str, Sum], problem: Problem, before: list[ModelClass]) -> list[ModelClass]:
    """Those of some classes that could be fitted, each from the best simpler one."""
    units, found = problem.natural_units(), list(before)
    for name, system in systems.items():
        own = of_system(problem, system).expressed_in(units)
        fitted = _judged(name, system, own, _simpler(found, own.system.names), units)
        if fitted is not None:
            found.append(fitted)
    return found[len(before) :]


def simplest(classes: Sequence[ModelClass]) -> ModelClass:
    """Of the classes that are as good as the best one that with the fewest parameters."""
    least = min(one.criterion for one in classes)
    level = [one for one in classes if one.criterion < least + LEVEL]
    return min(level, key=lambda one: (len(one.system.parameters) - len(one.zero), len(one.zero), one.criterion))


def best_class(measured: Measured, classes: Sequence[ModelClass] | None = None) -> Measured:
    """The same records, of the simplest of the best classes without terms that it does not need, and a note of it.

    ``classes``: as ranked already; else they are ranked here.
    """
    classes = ranked_classes(measured) if classes is None else classes
    if not classes:
        return replace(measured, notes=(*measured.notes, "system=auto takes one displacement of one DOF: sdof is used"))
    best = simplest(classes)
    system = without(best.system, best.zero)
    system = replace(system, smoothing_velocity=system.smoothing_velocity / COARSER)
    level = [one.name for one in classes if not one.told_apart and one is not best]
    said = f"system=auto chose system={'+'.join(system.terms)}"
    said += f"; not told apart from it: {', '.join(level)}" if level else ""
    zeros = [f"{name}/m is 0, at most {most:.3g}" for name, most in best.zero.items()]
    return replace(with_system(measured, system), notes=(*measured.notes, said, *zeros))


def _thinned(problem: Problem) -> Problem:
    """The first cycles, every so many samples; a forced record whole, and the force with all of its own samples."""
    record = problem.records[0]
    if not problem.forced:
        first = record.channels[0]
        record = window(record, MOST_CYCLES / strongest_frequency(first.times, first.values))
    step = -(-max(c.n for c in record.channels) // MOST_SAMPLES)
    channels = tuple(replace(c, times=c.times[::step], values=c.values[::step]) for c in record.channels)
    return replace(problem, records=(replace(record, channels=channels),))


def _simpler(found: list[ModelClass], names: tuple[str, ...]) -> ModelClass | None:
    """The best of the classes whose parameters are among these, if it describes the record at all."""
    inside = [one for one in found if set(one.at.model.system.names) < set(names) and one.left < DESCRIBES]
    return min(inside, key=lambda one: one.criterion, default=None)


def _judged(name: str, system: Sum, problem: Problem, simpler: ModelClass | None, units: Units) -> ModelClass | None:
    with np.errstate(all="ignore"):
        at = grown_fit(problem) if simpler is None else _from_simpler(problem, simpler.at)
    if at is None:
        return None
    assert isinstance(problem.system, Sum)
    zero = vanishing(at, problem.system)
    if simpler is not None and _left(simpler.at) < _left(at):  # the search found no use for what is new
        zero = [name for name in SIZES if name in problem.system.names and name not in simpler.at.model.system.names]
    smaller = _refitted(of_system(problem, without(problem.system, zero)), simpler) if zero else at
    if smaller is None:
        return None
    if _criterion(at) < _criterion(smaller):  # it is small, but the record needs it
        zero, smaller = [], at
    left = float(np.std(smaller.residuals) / (np.std(smaller.model.data) or 1.0))
    allowed = most_allowed(smaller, problem.system, zero, units)
    return ModelClass(name, system, _criterion(smaller), left, held_out_fit(smaller), allowed, smaller, units)


def _criterion(at: Linearised) -> float:
    return information_criterion(at.residuals, at.theta.size)


def _refitted(problem: Problem, simpler: ModelClass | None) -> Linearised | None:
    """The fit without the terms at zero; the units are those of the problem already."""
    if simpler is not None and simpler.at.model.system.names == problem.system.names:
        return simpler.at
    inside = simpler is not None and set(simpler.at.model.system.names) < set(problem.system.names)
    with np.errstate(all="ignore"):
        found = _from_simpler(problem, simpler.at) if inside and simpler is not None else None
        return found or grown_fit(problem)


def _left(at: Linearised) -> float:
    return float(at.residuals @ at.residuals)


def _from_simpler(problem: Problem, simpler: Linearised) -> Linearised | None:
    """The best of searches from a simpler fit, whose viscous damping does part of the work of the further terms."""
    model = compiled_output_error(problem)
    known = {name: float(value) for name, value in simpler.model.parameters(simpler.theta).items()}
    rate, amplitude = vibration(model.channels[0][1])
    guess = first_guess(problem.system, rate, amplitude, known.get("m", 1.0))
    p = guess | {name: value for name, value in known.items() if name in guess}
    trials = [start for one in (p, *_shared_out(p, known, rate, amplitude)) for start in _starts(model, one, simpler)]
    if (stepped := linear_start(simpler, model)) is not None:
        trials.append(stepped)
    if not trials:
        return None
    ends = model.settle(np.stack(trials), rounds=1, iterations=SCREEN)
    best = min(ends, key=model.profile)
    return at_theta(model, model.settle(best[None], iterations=SEARCH)[0])


def _shared_out(
    p: dict[str, float], known: Mapping[str, float], rate: float, amplitude: float
) -> list[dict[str, float]]:
    """Parameters whose further damping does some of the work of all damping that is known, in parts of :data:`SHARES`.

    Friction and quadratic damping by their equivalents in harmonic balance (see :mod:`bench.records.model_error`).
    """
    of_mu, of_c2 = 4.0 / (np.pi * rate * amplitude), 8.0 * rate * amplitude / (3.0 * np.pi)
    further = [name for name in ("mu", "c2") if name in p]
    total = known.get("c", 0.0) + of_mu * known.get("mu", 0.0) + of_c2 * known.get("c2", 0.0)
    if not further or "c" not in p or total <= 0:
        return []
    each = {"mu": total / of_mu / len(further), "c2": total / of_c2 / len(further)}
    return [p | {"c": (1.0 - share) * total} | {name: share * each[name] for name in further} for share in SHARES]


def _starts(model: OutputError, p: dict[str, float], simpler: Linearised) -> list[np.ndarray]:
    """Parameters with the initial state and offset that fit best there, or else those of the simpler fit."""
    best = model.vector(p)
    tail = simpler.theta[len(simpler.model.free) :]
    same = np.concatenate([best[: len(model.free)], tail])
    found = [theta for theta in (best, same) if theta.size == model.size and np.all(np.isfinite(theta))]
    return sorted(found, key=model.profile)[:1]
